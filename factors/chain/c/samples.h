/* Passes over all samples (n, 3) of a sensor, one row after the other. */

#ifndef MAGYC_SAMPLES_H
#define MAGYC_SAMPLES_H

#include "arguments.h"

/* value (n, 3); square (m,), of the second differences of every stride-th sample: returns the mean square of the
   samples in their middles. */
static double second_differences(size stride, Arrays *a)
{
    size count = entries(a, 1);
    double sum = 0.0;
    for (size t = 0; t < count; t++) {
        const double *x = a->at[0] + 3 * stride * t;
        double square = 0.0;
        for (int i = 0; i < 3; i++) {
            double second = x[i] - 2 * x[3 + i] + x[6 + i];
            square += second * second;
            sum += x[3 + i] * x[3 + i];
        }
        a->at[1][t] = square;
    }
    return sum / (double)(3 * count);
}
TO_PYTHON(second_differences, 2, 1)

/* value (n, 3); third, fourth: the squared norms of every stride-th difference of those orders */
static double higher_differences(size stride, Arrays *a)
{
    double *third = a->at[1], *fourth = a->at[2];
    for (size t = 0; t < entries(a, 1); t++) {
        const double *x = a->at[0] + 3 * stride * t;
        double square = 0.0;
        for (int i = 0; i < 3; i++) {
            double difference = (x[9 + i] - x[i]) - 3 * (x[6 + i] - x[3 + i]);
            square += difference * difference;
        }
        third[t] = square;
    }
    for (size t = 0; t < entries(a, 2); t++) {
        const double *x = a->at[0] + 3 * stride * t;
        double square = 0.0;
        for (int i = 0; i < 3; i++) {
            double difference = (x[12 + i] + x[i]) - 4 * (x[9 + i] + x[3 + i]) + 6 * x[6 + i];
            square += difference * difference;
        }
        fourth[t] = square;
    }
    return 0.0;
}
TO_PYTHON(higher_differences, 3, 2)

#define AXES 12 /* entries in lanes: three axes of four samples */

/* Of the axes (3,) of m entries, three of each sample: the sums. */
WIDE_VECTORS static void sums(size m, in_t x, double sum[3])
{
    double lane[AXES] = {0};
    for (size k = 0; k + AXES <= m; k += AXES)
        for (int i = 0; i < AXES; i++)
            lane[i] += x[k + i];
    for (size k = m - m % AXES; k < m; k++)
        lane[k % 3] += x[k];
    for (int i = 0; i < 3; i++)
        sum[i] = (lane[i] + lane[i + 3]) + (lane[i + 6] + lane[i + 9]);
}

/* The sums of the squares about a mean. */
WIDE_VECTORS static void squares_about(size m, in_t x, const double mean[3], double sum[3])
{
    double lane[AXES] = {0}, of[AXES];
    for (int i = 0; i < AXES; i++)
        of[i] = mean[i % 3];
    for (size k = 0; k + AXES <= m; k += AXES)
        for (int i = 0; i < AXES; i++)
            lane[i] += (x[k + i] - of[i]) * (x[k + i] - of[i]);
    for (size k = m - m % AXES; k < m; k++)
        lane[k % 3] += (x[k] - mean[k % 3]) * (x[k] - mean[k % 3]);
    for (int i = 0; i < 3; i++)
        sum[i] = (lane[i] + lane[i + 3]) + (lane[i + 6] + lane[i + 9]);
}

WIDE_VECTORS static double squared_second_differences(size m, in_t x)
{
    double sum = 0.0;
#pragma omp simd reduction(+ : sum)
    for (size k = 0; k < m; k++) {
        double second = x[k] - 2 * x[k + 3] + x[k + 6];
        sum += second * second;
    }
    return sum;
}

/* value (n, 3); result (2,): the mean squared norm of the second differences, and the variance of all axes together */
static double roughness(size n, Arrays *a)
{
    double mean[3], whole[3];
    sums(3 * n, a->at[0], mean);
    for (int i = 0; i < 3; i++)
        mean[i] /= (double)n;
    squares_about(3 * n, a->at[0], mean, whole);
    a->at[1][0] = squared_second_differences(3 * (n - 2), a->at[0]) / (double)(n - 2);
    a->at[1][1] = (whole[0] + whole[1] + whole[2]) / (double)n;
    return 0.0;
}
TO_PYTHON(roughness, 2, 1)

static inline double lesser(double x, double y) { return x < y ? x : y; }
static inline double larger(double x, double y) { return x > y ? x : y; }

/* Each of m entries less the median of the five around it, 3 apart, the first of which begins at x. */
WIDE_VECTORS static void beside_medians(size m, in_t x, out_t result)
{
    for (size k = 0; k < m; k++) {
        double a = x[k], b = x[k + 3], c = x[k + 6], d = x[k + 9], e = x[k + 12];
        double low = larger(lesser(a, b), lesser(c, d)), high = lesser(larger(a, b), larger(c, d));
        result[k] = c - larger(lesser(low, high), lesser(larger(low, high), e));
    }
}

/* value (n, 3); mean (3,), scatter (3,): of each sample less the median of the five around it */
static double stand_out(size n, Arrays *a)
{
    size m = n - 4;
    double *apart = room(a, 3 * m), *mean = a->at[1], *scatter = a->at[2];
    if (!apart)
        return 0.0;
    beside_medians(3 * m, a->at[0], apart);
    sums(3 * m, apart, mean);
    for (int i = 0; i < 3; i++)
        mean[i] /= (double)m;
    squares_about(3 * m, apart, mean, scatter);
    for (int i = 0; i < 3; i++)
        scatter[i] = sqrt(scatter[i] / (double)m);
    PyMem_RawFree(apart);
    return 0.0;
}
TO_PYTHON(stand_out, 3, 2)

/* m entries less the mean of their neighbours, 3 apart, with the signs given. */
WIDE_VECTORS static void beside_neighbours(size m, in_t x, in_t sign, out_t apart)
{
    for (size k = 0; k < m; k++)
        apart[k] = sign[k] * (0.5 * x[k + 3] - 0.25 * (x[k] + x[k + 6]));
}

/* value (N, 3), first (blocks,) of int64; mean, inside (3, blocks): of n samples less the mean of their neighbours, with
   alternating signs, the mean and the sum of the squares about it */
static double alternate(size n, Arrays *a)
{
    size blocks = entries(a, 1);
    double *sign = room(a, 6 * n), *apart = sign + 3 * n;
    if (!sign)
        return 0.0;
    for (size k = 0; k < 3 * n; k++)
        sign[k] = k / 3 % 2 ? -1.0 : 1.0;
    for (size block = 0; block < blocks; block++) {
        double mean[3], inside[3];
        beside_neighbours(3 * n, a->at[0] + 3 * (size)((const int64_t *)a->at[1])[block], sign, apart);
        sums(3 * n, apart, mean);
        for (int i = 0; i < 3; i++)
            mean[i] /= (double)n;
        squares_about(3 * n, apart, mean, inside);
        for (int i = 0; i < 3; i++) {
            a->at[2][i * blocks + block] = mean[i];
            a->at[3][i * blocks + block] = inside[i];
        }
    }
    PyMem_RawFree(sign);
    return 0.0;
}
TO_PYTHON(alternate, 4, 2)

/* The largest and least entries of each axis. */
WIDE_VECTORS static void extremes(size m, in_t x, double top[3], double low[3])
{
    double most[AXES], least[AXES];
    for (int i = 0; i < AXES; i++)
        most[i] = least[i] = x[i % 3];
    for (size k = 0; k + AXES <= m; k += AXES)
        for (int i = 0; i < AXES; i++) {
            most[i] = x[k + i] > most[i] ? x[k + i] : most[i];
            least[i] = x[k + i] < least[i] ? x[k + i] : least[i];
        }
    for (size k = m - m % AXES; k < m; k++) {
        most[k % 3] = larger(most[k % 3], x[k]);
        least[k % 3] = lesser(least[k % 3], x[k]);
    }
    for (int i = 0; i < 3; i++) {
        top[i] = larger(larger(most[i], most[i + 3]), larger(most[i + 6], most[i + 9]));
        low[i] = lesser(lesser(least[i], least[i + 3]), lesser(least[i + 6], least[i + 9]));
    }
}

/* How many entries are equal to a value of their axis. */
WIDE_VECTORS static void equal_to(size m, in_t x, const double value[3], int64_t count[3])
{
    double of[AXES];
    int64_t equal[AXES] = {0};
    for (int i = 0; i < AXES; i++)
        of[i] = value[i % 3];
    for (size k = 0; k + AXES <= m; k += AXES)
        for (int i = 0; i < AXES; i++)
            equal[i] += x[k + i] == of[i];
    for (size k = m - m % AXES; k < m; k++)
        equal[k % 3] += x[k] == value[k % 3];
    for (int i = 0; i < 3; i++)
        count[i] = equal[i] + equal[i + 3] + equal[i + 6] + equal[i + 9];
}

WIDE_VECTORS static size repeats(size m, in_t x)
{
    int64_t again = 0;
    for (size k = 3; k < m; k++)
        again += x[k] == x[k - 3];
    return (size)again;
}

/* value (n, 3); found (4,): `screen._seen`, by blocks of `half` samples */
static double look(size half, Arrays *a)
{
    const double *value = a->at[0], none[3] = {0};
    double top[3], low[3], *found = a->at[1];
    size m = entries(a, 0);
    int64_t count[3];
    memset(found, 0, 4 * sizeof(double));
    found[2] = (double)repeats(m, value);
    for (size k = 0; found[2] && k + 3 * half <= m; k += 3 * half)
        for (int i = 0; i < 3; i++) {
            size same = 1;
            while (same < half && value[k + 3 * same + i] == value[k + i])
                same++;
            found[1] += same == half;
        }
    extremes(m, value, top, low);
    for (int side = 0; side < 2; side++) {
        equal_to(m, value, side ? low : top, count);
        for (int i = 0; i < 3; i++)
            found[3] = larger(found[3], (double)count[i]);
    }
    equal_to(m, value, none, count);
    for (size k = 0; count[0] && count[1] && count[2] && k < m; k += 3)
        found[0] += value[k] == 0 && value[k + 1] == 0 && value[k + 2] == 0;
    return 0.0;
}
TO_PYTHON(look, 2, 1)

/* The largest change of each axis. */
WIDE_VECTORS static void largest_changes(size m, in_t x, double most[3])
{
    double lane[AXES] = {0};
    for (size k = 0; k + AXES + 3 <= m; k += AXES)
        for (int i = 0; i < AXES; i++) {
            double change = fabs(x[k + 3 + i] - x[k + i]);
            lane[i] = change > lane[i] ? change : lane[i];
        }
    for (size k = (m - 3) - (m - 3) % AXES; k < m - 3; k++)
        lane[k % 3] = larger(lane[k % 3], fabs(x[k + 3] - x[k]));
    for (int i = 0; i < 3; i++)
        most[i] = larger(larger(lane[i], lane[i + 3]), larger(lane[i + 6], lane[i + 9]));
}

/* How many of m second differences of each axis are not zero, and how many of those are below its limit. */
WIDE_VECTORS static void count_seconds(size m, in_t x, const double limit[3], int64_t some[3], int64_t low[3])
{
    int64_t other[AXES] = {0}, below[AXES] = {0};
    double of[AXES];
    for (int i = 0; i < AXES; i++)
        of[i] = limit[i % 3];
    for (size k = 0; k + AXES <= m; k += AXES)
        for (int i = 0; i < AXES; i++) {
            double second = fabs((x[k + 6 + i] - x[k + 3 + i]) - (x[k + 3 + i] - x[k + i]));
            other[i] += second > 0;
            below[i] += (second > 0) & (second < of[i]);
        }
    for (size k = m - m % AXES; k < m; k++) {
        double second = fabs((x[k + 6] - x[k + 3]) - (x[k + 3] - x[k]));
        other[k % 3] += second > 0;
        below[k % 3] += second > 0 && second < limit[k % 3];
    }
    for (int i = 0; i < 3; i++) {
        some[i] = other[i] + other[i + 3] + other[i + 6] + other[i + 9];
        low[i] = below[i] + below[i + 3] + below[i + 6] + below[i + 9];
    }
}

/* value (n, 3), share (1,) of the largest change; block (1,): returns whether in any block of so many samples more than
   a quarter of an axis' second differences that are not zero are smaller than this share */
static double calm_blocks(size n, Arrays *a)
{
    const double *value = a->at[0];
    size length = (size)a->at[2][0];
    double limit[3];
    largest_changes(3 * n, value, limit);
    for (int i = 0; i < 3; i++)
        limit[i] *= a->at[1][0];
    for (size first = 0; first + length <= n; first += length) {
        int64_t some[3], low[3];
        count_seconds(3 * (length - 2), value + 3 * first, limit, some, low);
        for (int i = 0; i < 3; i++)
            if (low[i] > some[i] / 4)
                return 1.0;
    }
    return 0.0;
}
TO_PYTHON(calm_blocks, 3, 0)

#endif
