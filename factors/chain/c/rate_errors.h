/* What an error of the angular rate does to the windows and links of a field chain, see `rate_columns.py`. */

#ifndef MAGYC_RATE_ERRORS_H
#define MAGYC_RATE_ERRORS_H

#include "arguments.h"

/* Of rotations (3, 3, m) and vectors (3, m), component i of the vectors rotated. */
WIDE_VECTORS static void rotated(size m, in_t rotation, in_t vector, size i, out_t result)
{
    in_t x = rotation + 3 * i * m, y = x + m, z = y + m;
    for (size t = 0; t < m; t++)
        result[t] = x[t] * vector[t] + y[t] * vector[m + t] + z[t] * vector[2 * m + t];
}

/* The steps (m,), weighted, of an angle between the m + 1 rates about one axis: half of both, or all of the second. */
WIDE_VECTORS static void angle_steps(size m, in_t rate, in_t step, double first, double second, out_t result)
{
    for (size t = 0; t < m; t++)
        result[t] = -step[t] * (first * rate[t] + second * rate[t + 1]);
}

/* The running sums of three rows of m steps; the latency of one sum hides behind the others. */
static void running_sums(size m, double *x, double *y, double *z)
{
    double a = 0.0, b = 0.0, c = 0.0;
    for (size t = 0; t < m; t++) {
        x[t] = a += x[t];
        y[t] = b += y[t];
        z[t] = c += z[t];
    }
}

/* The mean of values of m samples, which are left less it. */
WIDE_VECTORS static double less_mean(size m, out_t value)
{
    double sum = 0.0;
#pragma omp simd reduction(+ : sum)
    for (size t = 0; t < m; t++)
        sum += value[t];
    sum /= (double)m;
    for (size t = 0; t < m; t++)
        value[t] -= sum;
    return sum;
}

/* The mean over m samples of the products of a rotation's row, `all` entries apart, with g × angle. */
WIDE_VECTORS static double swung(size m, in_t back, in_t angle, size all, const double g[3])
{
    in_t x = back, y = back + all, z = y + all, a = angle, b = angle + all, c = b + all;
    double g0 = g[0], g1 = g[1], g2 = g[2], sum = 0.0;
#pragma omp simd reduction(+ : sum)
    for (size t = 0; t < m; t++)
        sum += x[t] * (g1 * c[t] - g2 * b[t]) + y[t] * (g2 * a[t] - g0 * c[t]) + z[t] * (g0 * b[t] - g1 * a[t]);
    return sum / (double)m;
}

/* turn (3, 3, G), step (G − 1,), shares (2,) of two neighbouring rates in a step, before (M,) and start (n,) of int64,
   share (M,), back (3, 3, M), direction (3, n), error (k, 3, G); window (k, 3, n), link (k, 3, n − 1) */
static double rate_errors(size n, Arrays *a)
{
    const double *shares = a->at[2], *share = a->at[5], *direction = a->at[7];
    const int64_t *before = (const int64_t *)a->at[3], *start = (const int64_t *)a->at[4];
    size g = entries(a, 1) + 1, m = entries(a, 3), count = entries(a, 8) / (3 * g);
    double *angle = room(a, 4 * g + 3 * m + 3 * n), *rate = angle + 3 * g, *inside = rate + g, *mean = inside + 3 * m;
    if (!angle)
        return 0.0;
    for (size k = 0; k < count; k++) {
        for (size i = 0; i < 3; i++) {
            rotated(g, a->at[0], a->at[8] + 3 * g * k, i, rate);
            angle[i * g] = 0.0;
            angle_steps(g - 1, rate, a->at[1], shares[0], shares[1], angle + i * g + 1);
        }
        running_sums(g, angle, angle + g, angle + 2 * g);
        for (size i = 0; i < 3; i++)
            for (size t = 0; t < m; t++) {
                const double *at = angle + i * g + before[t];
                inside[i * m + t] = at[0] + share[t] * (at[1] - at[0]);
            }
        for (size w = 0; w < n; w++) {
            size first = (size)start[w], own = (w + 1 < n ? (size)start[w + 1] : m) - first;
            const double g_of[3] = {direction[w], direction[n + w], direction[2 * n + w]};
            for (size i = 0; i < 3; i++)
                mean[i * n + w] = less_mean(own, inside + i * m + first);
            for (size i = 0; i < 3; i++)
                a->at[9][(3 * k + i) * n + w] = swung(own, a->at[6] + 3 * i * m + first, inside + first, m, g_of);
        }
        for (size i = 0; i < 3; i++) { /* the change of the mean angle × direction */
            const double *b = mean + (i + 1) % 3 * n, *c = mean + (i + 2) % 3 * n;
            const double *y = direction + (i + 1) % 3 * n, *z = direction + (i + 2) % 3 * n;
            double *link = a->at[10] + (3 * k + i) * (n - 1);
            for (size w = 0; w < n - 1; w++)
                link[w] = (b[w + 1] - b[w]) * z[w] - (c[w + 1] - c[w]) * y[w];
        }
    }
    PyMem_RawFree(angle);
    return 0.0;
}
TO_PYTHON(rate_errors, 11, 2)

#endif
