/* The directions of a field chain: moved by a step, and turned at a changed bias and delay. */

#ifndef MAGYC_DIRECTIONS_H
#define MAGYC_DIRECTIONS_H

#include "common.h"

/* columns (p, 3, n) −= Jacobian (3, 2, n) of solved (p, 2, n). */
WIDE_VECTORS static void less_directions(size n, size p, in_t jacobian, in_t solved, out_t columns)
{
    for (size c = 0; c < p; c++)
        for (int i = 0; i < 3; i++) {
            const double *x = solved + 2 * n * c, *j = jacobian + 2 * i * n;
            double *y = columns + (3 * c + i) * n;
            for (size t = 0; t < n; t++)
                y[t] -= j[t] * x[t] + j[n + t] * x[n + t];
        }
}

/* columns (p, 3, n − 1) −= Jacobians (3, 2, n − 1) of the links on the directions before and after them, of solved. */
WIDE_VECTORS static void less_linked(size n, size p, in_t before, in_t after, in_t solved, out_t columns)
{
    size m = n - 1;
    for (size c = 0; c < p; c++)
        for (int i = 0; i < 3; i++) {
            const double *x = solved + 2 * n * c, *b = before + 2 * i * m, *a = after + 2 * i * m;
            double *y = columns + (3 * c + i) * m;
            for (size t = 0; t < m; t++)
                y[t] -= b[t] * x[t] + b[m + t] * x[n + t] + a[t] * x[t + 1] + a[m + t] * x[n + t + 1];
        }
}

/* The directions moved by a step in their tangent planes that solves Lᵀ x = pull (2n,), which becomes x. */
WIDE_VECTORS static void back_and_moved(size n, in_t factor, in_t inverse, in_t basis, in_t direction, out_t pull,
                                        out_t moved)
{
    double one = 0.0, two = 0.0, three = 0.0; /* the rows below */
    for (size r = 2 * n - 1; r >= 0; r--) {
        const double *f = factor + 4 * r;
        double x = (pull[r] - f[1] * one - f[2] * two - f[3] * three) * inverse[r];
        three = two;
        two = one;
        pull[r] = one = x;
    }
    for (size t = 0; t < n; t++) {
        double a = pull[2 * t], b = pull[2 * t + 1];
        double x = direction[t] - basis[t] * a - basis[n + t] * b;
        double y = direction[n + t] - basis[2 * n + t] * a - basis[3 * n + t] * b;
        double z = direction[2 * n + t] - basis[4 * n + t] * a - basis[5 * n + t] * b;
        double norm = sqrt(x * x + y * y + z * z);
        moved[t] = x / norm;
        moved[n + t] = y / norm;
        moved[2 * n + t] = z / norm;
    }
}

/* The directions after a step on θ: of half (p + 1, 2n), the last row is of the gradient. */
WIDE_VECTORS static void step_directions(size n, size p, in_t factor, in_t inverse, in_t half, in_t step, in_t basis,
                                         in_t direction, out_t pull, out_t moved)
{
    memcpy(pull, half + 2 * n * p, sizeof(double) * 2 * (size_t)n);
    for (size i = 0; i < p; i++)
        for (size t = 0; t < 2 * n; t++)
            pull[t] += step[i] * half[2 * n * i + t];
    back_and_moved(n, factor, inverse, basis, direction, pull, moved);
}

/* result (9, n) = rotation + its derivatives (3, 3, 3, n) by the bias and (9, n) by the delay times their changes. */
WIDE_VECTORS static void moved_rotations(size n, in_t rotation, in_t by_bias, in_t by_delay, in_t change, out_t result)
{
    for (int i = 0; i < 9; i++) {
        const double *b = by_bias + 3 * n * i;
        for (size t = 0; t < n; t++)
            result[n * i + t] = rotation[n * i + t] + b[t] * change[0] + b[n + t] * change[1] +
                                b[2 * n + t] * change[2] + by_delay[n * i + t] * change[3];
    }
}

/* The rotation matrix of a vector, as `rotations.exponential_matrices`. */
/* result = I + a [v]x + b [v]x² */
static inline void turn_about(const double v[3], double square, double a, double b, double result[9])
{
    for (int i = 0; i < 3; i++) {
        int j = (i + 1) % 3, k = (i + 2) % 3;
        result[4 * i] = 1 - b * square + b * v[i] * v[i];
        result[3 * i + j] = b * v[i] * v[j] - a * v[k];
        result[3 * j + i] = b * v[i] * v[j] + a * v[k];
    }
}

static inline void exponential_of(const double v[3], double result[9])
{
    double square = v[0] * v[0] + v[1] * v[1] + v[2] * v[2], a, b;
    if (square < 1e-3) { /* series, exact to rounding */
        a = 1 - square * (1. / 6 - square * (1. / 120 - square / 5040));
        b = 0.5 - square * (1. / 24 - square * (1. / 720 - square / 40320));
    } else {
        double angle = sqrt(square), half = sin(0.5 * angle) / (0.5 * angle);
        a = sin(angle) / angle;
        b = 0.5 * half * half;
    }
    turn_about(v, square, a, b, result);
}

/* result (9, n) = Exp of the vectors lever (3, 3, n) times change (3,). */
static void turns(size n, in_t lever, in_t change, out_t result)
{
    for (size t = 0; t < n; t++) {
        double v[3], turn[9];
        for (int i = 0; i < 3; i++)
            v[i] = lever[3 * i * n + t] * change[0] + lever[(3 * i + 1) * n + t] * change[1] +
                   lever[(3 * i + 2) * n + t] * change[2];
        exponential_of(v, turn);
        for (int i = 0; i < 9; i++)
            result[i * n + t] = turn[i];
    }
}

#endif
