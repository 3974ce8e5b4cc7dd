/* The motion at the windows of a fit (`estimators/model_error/turning.py`). */

#ifndef MAGYC_MOTION_H
#define MAGYC_MOTION_H

#include "arguments.h"
#include "directions.h"
#include "gyroscope.h"

#define LEAST_LENGTH 1e-9

/* Field M g, its derivative M' g, and rate of turn, half the axis of M' Mᵀ (3, n each), of M and M' (3, 3, n). */
WIDE_VECTORS static void turning(size n, in_t rotation, in_t change, in_t g, out_t unit, out_t slope, out_t rate)
{
    for (int i = 0; i < 3; i++) {
        int j = (i + 1) % 3, k = (i + 2) % 3;
        const double *m = rotation + 3 * i * n, *d = change + 3 * i * n;
        const double *mj = rotation + 3 * j * n, *dj = change + 3 * j * n;
        const double *mk = rotation + 3 * k * n, *dk = change + 3 * k * n;
        for (size t = 0; t < n; t++) {
            unit[i * n + t] = m[t] * g[t] + m[n + t] * g[n + t] + m[2 * n + t] * g[2 * n + t];
            slope[i * n + t] = d[t] * g[t] + d[n + t] * g[n + t] + d[2 * n + t] * g[2 * n + t];
            rate[i * n + t] = 0.5 * (dk[t] * mj[t] + dk[n + t] * mj[n + t] + dk[2 * n + t] * mj[2 * n + t] -
                                     (dj[t] * mk[t] + dj[n + t] * mk[n + t] + dj[2 * n + t] * mk[2 * n + t]));
        }
    }
}

/* The least turn between two vectors with the cross product v and the inner product c. */
static inline void least_turn(double v[3], double c, double turn[9])
{
    double square = v[0] * v[0] + v[1] * v[1] + v[2] * v[2], length = sqrt(square + c * c);
    if (c > 0) { /* (1 − cos φ) / |v|² by the product of what is added and what is subtracted */
        turn_about(v, square, 1 / length, 1 / (length * (length + c)), turn);
        return;
    }
    double sine = sqrt(square), angle = atan2(sine, c);
    for (int i = 0; i < 3; i++)
        v[i] *= angle / fmax(sine, LEAST_LENGTH);
    exponential_of(v, turn);
}

/* Rotations (3, 3, n) from pairs (n,), each followed by the least turn that gives directions (3, n) their mean. */
static void aligned(size n, in_t p, in_t q, in_t g, out_t world)
{
    double mean[3] = {0};
    for (size t = 0; t < n; t++) {
        double r[9];
        matrix_of(p + 2 * t, q + 2 * t, r);
        for (int i = 0; i < 3; i++)
            mean[i] += r[3 * i] * g[t] + r[3 * i + 1] * g[n + t] + r[3 * i + 2] * g[2 * n + t];
    }
    double length = sqrt(mean[0] * mean[0] + mean[1] * mean[1] + mean[2] * mean[2]) / (double)n;
    for (int i = 0; i < 3; i++)
        mean[i] /= (double)n * fmax(length, LEAST_LENGTH);
    for (size t = 0; t < n; t++) {
        double r[9], there[3], axis[3], turn[9];
        matrix_of(p + 2 * t, q + 2 * t, r);
        for (int i = 0; i < 3; i++)
            there[i] = r[3 * i] * g[t] + r[3 * i + 1] * g[n + t] + r[3 * i + 2] * g[2 * n + t];
        for (int i = 0; i < 3; i++)
            axis[i] = there[(i + 1) % 3] * mean[(i + 2) % 3] - there[(i + 2) % 3] * mean[(i + 1) % 3];
        least_turn(axis, mean[0] * there[0] + mean[1] * there[1] + mean[2] * there[2], turn);
        for (int i = 0; i < 3; i++)
            for (int k = 0; k < 3; k++)
                world[(3 * i + k) * n + t] =
                    turn[3 * i] * r[k] + turn[3 * i + 1] * r[3 + k] + turn[3 * i + 2] * r[6 + k];
    }
}

/* Angles (n − 1,) rad between neighbours of rotations (3, 3, n). */
WIDE_VECTORS static void angles_between(size n, in_t rotation, out_t angle)
{
    for (size t = 0; t < n - 1; t++) {
        double trace = 0.0;
        for (int i = 0; i < 9; i++)
            trace += rotation[i * n + t + 1] * rotation[i * n + t];
        angle[t] = acos(fmin(fmax(0.5 * (trace - 1), -1.0), 1.0));
    }
}

/* rotation, change (3, 3, n), direction (3, n); unit, slope, rate (3, n) */
static double turn_rates(size n, Arrays *a)
{
    turning(n, a->at[0], a->at[1], a->at[2], a->at[3], a->at[4], a->at[5]);
    return 0.0;
}
TO_PYTHON(turn_rates, 6, 3)

/* p, q, direction (3, n); world (3, 3, n) */
static double align(size n, Arrays *a)
{
    aligned(n, a->at[0], a->at[1], a->at[2], a->at[3]);
    return 0.0;
}
TO_PYTHON(align, 4, 1)

/* rotation (3, 3, n); angle (n − 1,) */
static double angles(size n, Arrays *a)
{
    angles_between(n, a->at[0], a->at[1]);
    return 0.0;
}
TO_PYTHON(angles, 2, 1)

#endif
