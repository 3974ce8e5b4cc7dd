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

#endif
