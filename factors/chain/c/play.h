/* A play, in which what follows stays behind, and its complement, which stops at a limit. */

#ifndef MAGYC_PLAY_H
#define MAGYC_PLAY_H

#include "arguments.h"

ALWAYS_INLINE double within(double x, double low, double high) { return x < low ? low : x > high ? high : x; }

/* What follows values x (n,) in a play of half width `width`, started at the first. */
static void followed(size n, double width, in_t x, out_t y)
{
    double last = x[0];
    for (size t = 0; t < n; t++)
        y[t] = last = within(last, x[t] - width, x[t] + width);
}

#define LIMITS 8

/* Mean (n,) over limits (LIMITS,) of what moves with values x (n,) from 0 on and stops at plus and minus each. */
WIDE_VECTORS static void stopped(size n, in_t limits, in_t x, out_t mean)
{
    double state[LIMITS] = {0};
    mean[0] = 0.0;
    for (size t = 1; t < n; t++) {
        double change = x[t] - x[t - 1], sum = 0.0;
        for (int i = 0; i < LIMITS; i++) {
            state[i] = within(state[i] + change, -limits[i], limits[i]);
            sum += state[i];
        }
        mean[t] = sum / LIMITS;
    }
}

/* values (k, n), width (1,); result (k, n) */
static double follow(size n, Arrays *a)
{
    for (size c = 0; c < entries(a, 0) / n; c++)
        followed(n, a->at[1][0], a->at[0] + n * c, a->at[2] + n * c);
    return 0.0;
}
TO_PYTHON(follow, 3, 1)

/* values (k, n), limits (LIMITS,); mean (k, n) */
static double stop(size n, Arrays *a)
{
    for (size c = 0; c < entries(a, 0) / n; c++)
        stopped(n, a->at[1], a->at[0] + n * c, a->at[2] + n * c);
    return 0.0;
}
TO_PYTHON(stop, 3, 1)

#endif
