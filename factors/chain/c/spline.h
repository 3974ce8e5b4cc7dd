/* Cubic splines through the values of windows. */

#ifndef MAGYC_SPLINE_H
#define MAGYC_SPLINE_H

#include "arguments.h"
#include "lanes.h"

#define FEW 4

/* Slopes of a cubic spline through some rows of n values, by the factors (dpttrf) of the symmetric tridiagonal matrix of
   the inner ones: below, and the reciprocals of the diagonal. The first and the last slope are those of the first and
   the last step. So many `lanes` go together; `work` holds (n, lanes). */
ALWAYS_INLINE void slopes_in_lanes(int lanes, size n, in_t values, in_t inverse, in_t share, in_t below, size some,
                                   out_t slopes, out_t work)
{
    into_lanes(n, some, values, n, work, lanes);
    double first[TOGETHER], last[TOGETHER], right[TOGETHER] = {0}, after[TOGETHER];
    for (int c = 0; c < lanes; c++) {
        first[c] = (work[lanes + c] - work[c]) * inverse[0];
        last[c] = after[c] = (work[lanes * (n - 1) + c] - work[lanes * (n - 2) + c]) * inverse[n - 2];
    }
    double previous[TOGETHER]; /* value at t − 1, which the right side replaces */
    memcpy(previous, work, sizeof(double) * (size_t)lanes);
    for (size t = 1; t < n - 1; t++) {
        double u = 3 * inverse[t - 1] * inverse[t - 1], v = 3 * inverse[t] * inverse[t];
        double factor = t > 1 ? below[t - 2] : 0.0;
        double *own = work + lanes * t;
        for (int c = 0; c < lanes; c++) {
            double value = own[c];
            double ends = (t == 1 ? inverse[0] * first[c] : 0.0) + (t == n - 2 ? inverse[n - 2] * last[c] : 0.0);
            right[c] = u * (value - previous[c]) + v * (own[lanes + c] - value) - ends - factor * right[c];
            previous[c] = value;
            own[c] = right[c];
        }
    }
    for (size t = n - 2; t > 0; t--) {
        double *own = work + lanes * t, factor = t < n - 2 ? below[t - 1] : 0.0;
        for (int c = 0; c < lanes; c++)
            own[c] = after[c] = own[c] * share[t - 1] - factor * after[c];
    }
    memcpy(work, first, sizeof(double) * (size_t)lanes);
    memcpy(work + lanes * (n - 1), last, sizeof(double) * (size_t)lanes);
    from_lanes(n, some, work, lanes, slopes, n);
}

WIDE_VECTORS static void slopes_together(size n, in_t values, in_t inverse, in_t share, in_t below, size some,
                                         out_t slopes, out_t work)
{
    if (some <= FEW)
        slopes_in_lanes(FEW, n, values, inverse, share, below, some, slopes, work);
    else
        slopes_in_lanes(TOGETHER, n, values, inverse, share, below, some, slopes, work);
}

/* result (3, m) = direction (3, n) × the integrals over m = n − 1 steps of the splines through values (3, n), with the
   slopes (3, n); those of the trapezoids where there are none. */
WIDE_VECTORS static void crossed_integrals(size n, in_t values, in_t slopes, in_t step, in_t direction, out_t result)
{
    size m = n - 1;
    for (size t = 0; t < m; t++) {
        double half = 0.5 * step[t], bend = step[t] * step[t] / 12;
        double x = half * (values[t + 1] + values[t]);
        double y = half * (values[n + t + 1] + values[n + t]);
        double z = half * (values[2 * n + t + 1] + values[2 * n + t]);
        if (slopes) {
            x -= bend * (slopes[t + 1] - slopes[t]);
            y -= bend * (slopes[n + t + 1] - slopes[n + t]);
            z -= bend * (slopes[2 * n + t + 1] - slopes[2 * n + t]);
        }
        double a = direction[t], b = direction[n + t], c = direction[2 * n + t];
        result[t] = b * z - c * y;
        result[m + t] = c * x - a * z;
        result[2 * m + t] = a * y - b * x;
    }
}

/* values (k, n), inverse (n − 1,) of the steps, share (n − 2,) and below (n − 3,) of `Spline`; slopes (k, n), n > 3 */
static double spline_slopes(size n, Arrays *a)
{
    size count = entries(a, 0) / n;
    double *work = room(a, TOGETHER * n);
    if (!work)
        return 0.0;
    memset(work, 0, sizeof(double) * TOGETHER * (size_t)n);
    for (size own = 0; own < count; own += TOGETHER)
        slopes_together(n, a->at[0] + own * n, a->at[1], a->at[2], a->at[3], LEAST(TOGETHER, count - own),
                        a->at[4] + own * n, work);
    PyMem_RawFree(work);
    return 0.0;
}
TO_PYTHON(spline_slopes, 5, 1)

/* values (k, 3, n), slopes (k, 3, n) or none, step (n − 1,), direction (3, n); result (k, 3, n − 1) */
static double cross_integrals(size n, Arrays *a)
{
    for (size c = 0; c < entries(a, 0) / (3 * n); c++)
        crossed_integrals(n, a->at[0] + 3 * n * c, a->at[1] ? a->at[1] + 3 * n * c : NULL, a->at[2], a->at[3],
                          a->at[4] + 3 * (n - 1) * c);
    return 0.0;
}
TO_PYTHON(cross_integrals, 5, 1)

#endif
