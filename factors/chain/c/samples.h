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

/* value (n, 3); result (2,): the mean squared norm of the second differences, and the variance of all axes together */
static double roughness(size n, Arrays *a)
{
    const double *x = a->at[0];
    double mean[3] = {0}, rough = 0.0, whole = 0.0;
    for (size k = 0; k < 3 * n; k++)
        mean[k % 3] += x[k] / (double)n;
    for (size t = 0; t < n; t++)
        for (int i = 0; i < 3; i++)
            whole += (x[3 * t + i] - mean[i]) * (x[3 * t + i] - mean[i]);
    for (size k = 0; k < 3 * (n - 2); k++) {
        double second = x[k] - 2 * x[k + 3] + x[k + 6];
        rough += second * second;
    }
    a->at[1][0] = rough / (double)(n - 2);
    a->at[1][1] = whole / (double)n;
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
    for (int i = 0; i < 3; i++)
        mean[i] = scatter[i] = 0.0;
    for (size k = 0; k < 3 * m; k++)
        mean[k % 3] += apart[k];
    for (int i = 0; i < 3; i++)
        mean[i] /= (double)m;
    for (size k = 0; k < 3 * m; k++)
        scatter[k % 3] += (apart[k] - mean[k % 3]) * (apart[k] - mean[k % 3]);
    for (int i = 0; i < 3; i++)
        scatter[i] = sqrt(scatter[i] / (double)m);
    PyMem_RawFree(apart);
    return 0.0;
}
TO_PYTHON(stand_out, 3, 2)

/* value (N, 3), first (blocks,) of int64; mean, inside (3, blocks): of n samples less the mean of their neighbours, with
   alternating signs, the mean and the sum of the squares about it */
static double alternate(size n, Arrays *a)
{
    size blocks = entries(a, 1);
    for (size block = 0; block < blocks; block++)
        for (int i = 0; i < 3; i++) {
            const double *x = a->at[0] + 3 * (size)((const int64_t *)a->at[1])[block] + i;
            double sum = 0.0, square = 0.0, *mean = a->at[2] + i * blocks + block;
            for (size k = 0; k < n; k++) {
                double apart = 0.5 * x[3 * k + 3] - 0.25 * (x[3 * k] + x[3 * k + 6]);
                sum += k % 2 ? -apart : apart;
            }
            *mean = sum / (double)n;
            for (size k = 0; k < n; k++) {
                double apart = 0.5 * x[3 * k + 3] - 0.25 * (x[3 * k] + x[3 * k + 6]);
                double away = (k % 2 ? -apart : apart) - *mean;
                square += away * away;
            }
            a->at[3][i * blocks + block] = square;
        }
    return 0.0;
}
TO_PYTHON(alternate, 4, 2)

#define AXES 12 /* samples in lanes: three axes of four samples */

/* Of the axes (3,) of m entries, three of each sample: the largest and least. */
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

/* value (n, 3), share (1,) of the largest change; block (1,): returns whether in any block of so many samples more than
   a quarter of an axis' second differences that are not zero are smaller than this share */
static double calm_blocks(size n, Arrays *a)
{
    const double *value = a->at[0];
    size length = (size)a->at[2][0];
    double limit[3] = {0};
    for (size k = 0; k < 3 * (n - 1); k++)
        limit[k % 3] = larger(limit[k % 3], fabs(value[k + 3] - value[k]));
    for (size first = 0; first + length <= n; first += length)
        for (int i = 0; i < 3; i++) {
            const double *x = value + 3 * first + i;
            size low = 0, some = 0;
            for (size k = 0; k < length - 2; k++) {
                double second = fabs((x[3 * k + 6] - x[3 * k + 3]) - (x[3 * k + 3] - x[3 * k]));
                some += second > 0;
                low += second > 0 && second < limit[i] * a->at[1][0];
            }
            if (low > some / 4)
                return 1.0;
        }
    return 0.0;
}
TO_PYTHON(calm_blocks, 3, 0)

static inline uint64_t mixed(uint64_t total, uint64_t part, uint64_t factor)
{
    uint64_t own = (part ^ (part >> 32)) * factor;
    return (total ^ (total >> 29)) * factor + (own ^ (own >> 31));
}

WIDE_VECTORS static void cells_of(size n, in_t value, double width, const uint64_t *factor, uint64_t *cells)
{
    for (size t = 0; t < n; t++) {
        uint64_t total = 0;
        for (int i = 0; i < 3; i++)
            total = mixed(total, (uint64_t)(int64_t)rint(value[3 * t + i] / width), factor[i]);
        cells[t] = total ^ (total >> 32);
    }
}

/* value (n, 3), cell (1,), factors (3,) of uint64; cells (n,) of uint64: `fingerprint._cells` */
static double hash_cells(size n, Arrays *a)
{
    cells_of(n, a->at[0], a->at[1][0], (const uint64_t *)a->at[2], (uint64_t *)a->at[3]);
    return 0.0;
}
TO_PYTHON(hash_cells, 4, 1)

/* again (n,): whether a cell is one of those 2 to `back` before it. */
WIDE_VECTORS static void returns_to(size n, size back, const uint64_t *cell, uint64_t *again)
{
    memset(again, 0, sizeof(uint64_t) * (size_t)n);
    for (size k = 2; k <= back; k++)
        for (size t = back; t < n; t++)
            again[t] |= cell[t] == cell[t - k];
}

/* Put a value among the `kept` smallest ones, ascending, of which there are `most`; returns how many are kept now. */
static inline size put_in_order(uint64_t value, uint64_t *smallest, size kept, size most)
{
    if (kept == most && value >= smallest[most - 1])
        return kept;
    size k = kept < most ? kept : most - 1, now = k + 1;
    for (; k > 0 && smallest[k - 1] > value; k--)
        smallest[k] = smallest[k - 1];
    smallest[k] = value;
    return now;
}

/* cells (n,) of uint64, factors (3,) of uint64, rules (4,): run, back, most and bits; hashes (few,) of uint64: the
   smallest, ascending, of the runs that `fingerprint._kept_runs` keeps. Returns their number. */
static double hash_runs(size n, Arrays *a)
{
    const uint64_t *cell = (const uint64_t *)a->at[0], factor = *(const uint64_t *)a->at[1];
    size run = (size)a->at[2][0], back = (size)a->at[2][1], kept = 0, returned = 0;
    size few = entries(a, 3);
    uint64_t *hash = (uint64_t *)a->at[3], total = 0, power = 1;
    int bits = (int)a->at[2][3];
    double *work = room(a, n);
    if (!work)
        return 0.0;
    uint64_t *again = (uint64_t *)work;
    returns_to(n, back, cell, again);
    for (size k = 0; k < run; k++)
        power *= factor;
    for (size t = n - 1; t >= back; t--) { /* of cells t to t + run − 1, as far as there are so many */
        total = cell[t] + factor * total;
        returned += (size)again[t];
        if (t + run < n) {
            total -= power * cell[t + run];
            returned -= (size)again[t + run];
        }
        if (t + run <= n && returned <= (size)a->at[2][2]) {
            uint64_t whole = mixed(0, total, factor);
            kept = put_in_order((whole ^ (whole >> 32)) >> (64 - bits), hash, kept, few);
        }
    }
    PyMem_RawFree(work);
    return (double)kept;
}
TO_PYTHON(hash_runs, 4, 1)

#endif
