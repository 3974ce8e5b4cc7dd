/* Cubic splines through the values of windows. */

#ifndef MAGYC_SPLINE_H
#define MAGYC_SPLINE_H

#include "common.h"

/* Slopes of a cubic spline through rows of n values, by the factors (dpttrf) of the symmetric tridiagonal
   matrix of the inner ones; the first and the last slope are those of the first and the last step. */

WIDE_VECTORS static void slopes_together(size n, in_t values, in_t inverse, in_t diagonal, in_t below, size some,
                                         out_t slopes, out_t work)
{
    for (size t = 0; t < n; t++)
        for (size c = 0; c < some; c++)
            work[TOGETHER * t + c] = values[c * n + t];
    double first[TOGETHER], last[TOGETHER], right[TOGETHER] = {0}, after[TOGETHER];
    for (int c = 0; c < TOGETHER; c++) {
        first[c] = (work[TOGETHER + c] - work[c]) * inverse[0];
        last[c] = after[c] = (work[TOGETHER * (n - 1) + c] - work[TOGETHER * (n - 2) + c]) * inverse[n - 2];
    }
    double previous[TOGETHER]; /* value at t − 1, which the right side replaces */
    memcpy(previous, work, sizeof previous);
    for (size t = 1; t < n - 1; t++) {
        double u = 3 * inverse[t - 1] * inverse[t - 1], v = 3 * inverse[t] * inverse[t];
        double factor = t > 1 ? below[t - 2] : 0.0;
        double *own = work + TOGETHER * t;
        for (int c = 0; c < TOGETHER; c++) {
            double value = own[c];
            right[c] = u * (value - previous[c]) + v * (own[TOGETHER + c] - value) - factor * right[c] -
                       (t == 1 ? inverse[0] * first[c] : 0.0) - (t == n - 2 ? inverse[n - 2] * last[c] : 0.0);
            previous[c] = value;
            own[c] = right[c];
        }
    }
    for (size t = n - 2; t > 0; t--) {
        double *own = work + TOGETHER * t, factor = t < n - 2 ? below[t - 1] : 0.0;
        for (int c = 0; c < TOGETHER; c++)
            own[c] = after[c] = own[c] / diagonal[t - 1] - factor * after[c];
    }
    memcpy(work, first, sizeof first);
    memcpy(work + TOGETHER * (n - 1), last, sizeof last);
    for (size c = 0; c < some; c++)
        for (size t = 0; t < n; t++)
            slopes[c * n + t] = work[TOGETHER * t + c];
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

#endif
