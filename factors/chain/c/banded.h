/* Banded Cholesky factors: L (2n, 4) by columns, the diagonal first; two rows to a window, blocks of two by two on and
   below the diagonal. */

#ifndef MAGYC_BANDED_H
#define MAGYC_BANDED_H

#include "lanes.h"

/* Cholesky factor of a band (m, 4), lower, by columns; returns 0, or the number of the first row that has no root.

   A row waits for those before it, so what it takes of them are their entries before the division by the root, and the
   reciprocal of its square: no root is waited for. */
static size factorise(size m, in_t band, out_t factor, out_t inverse)
{
    double one[4] = {0}, two[4] = {0}, three[4] = {0}; /* of columns j − 1 to j − 3: that reciprocal, and the entries */
    for (size j = 0; j < m; j++) {
        const double *own = band + 4 * j;
        double a = one[1] * one[0], b = two[2] * two[0], c = three[3] * three[0];
        double square = own[0] - a * one[1] - b * two[2] - c * three[3];
        if (square <= 0.0)
            return j + 1;
        double column[4] = {1 / square, own[1] - a * one[2] - b * two[3], own[2] - a * one[3], own[3]};
        double root = sqrt(square), *f = factor + 4 * j;
        inverse[j] = 1 / root;
        f[0] = root;
        for (int i = 1; i < 4; i++)
            f[i] = column[i] * inverse[j];
        memcpy(three, two, sizeof three);
        memcpy(two, one, sizeof two);
        memcpy(one, column, sizeof one);
    }
    return 0;
}

/* Forward substitution on `some` windows from `first` on, for TOGETHER columns; rows (2 some, TOGETHER) hold the right
   side, then the solution; `last` the two rows before. */
WIDE_VECTORS static void forward_rows(size first, size some, in_t factor, in_t inverse, out_t rows, out_t last)
{
    for (size t = 0; t < some; t++) {
        size r = 2 * (first + t);
        const double *own = factor + 4 * r, *past = r ? own - 8 : own;
        double a2 = r ? past[2] : 0.0, a1 = r ? past[5] : 0.0, b3 = r ? past[3] : 0.0, b2 = r ? past[6] : 0.0;
        double b1 = own[1], even = inverse[r], odd = inverse[r + 1];
        double *y = rows + 2 * TOGETHER * t;
        for (int c = 0; c < TOGETHER; c++) {
            double p = last[c], q = last[TOGETHER + c];
            double u = (y[c] - a2 * p - a1 * q) * even;
            double v = (y[TOGETHER + c] - b3 * p - b2 * q - b1 * u) * odd;
            y[c] = last[c] = u;
            y[TOGETHER + c] = last[TOGETHER + c] = v;
        }
    }
}

/* The same backwards: Lᵀ x = y, from window first + some − 1 down; `last` holds the two rows after. */
WIDE_VECTORS static void backward_rows(size first, size some, in_t factor, in_t inverse, out_t rows, out_t last)
{
    for (size t = some - 1; t >= 0; t--) {
        size r = 2 * (first + t);
        const double *own = factor + 4 * r;
        double a1 = own[1], a2 = own[2], a3 = own[3], b1 = own[5], b2 = own[6];
        double even = inverse[r], odd = inverse[r + 1];
        double *y = rows + 2 * TOGETHER * t;
        for (int c = 0; c < TOGETHER; c++) {
            double p = last[c], q = last[TOGETHER + c];
            double v = (y[TOGETHER + c] - b1 * p - b2 * q) * odd;
            double u = (y[c] - a1 * v - a2 * p - a3 * q) * even;
            y[c] = last[c] = u;
            y[TOGETHER + c] = last[TOGETHER + c] = v;
        }
    }
}

/* Solutions of all columns: right (count, 2, n) and solution (count, 2n) forward, and the other way round backward. */
static void solve_all(size n, int backward, const double *factor, const double *inverse, const double *right,
                      size count, double *solution)
{
    double tile[2 * STRETCH * TOGETHER];
    size pieces = (n + STRETCH - 1) / STRETCH;
    for (size own = 0; own < count; own += TOGETHER) {
        double last[2 * TOGETHER] = {0};
        size some = LEAST(TOGETHER, count - own);
        if (some < TOGETHER)
            memset(tile, 0, sizeof tile);
        for (size piece = 0; piece < pieces; piece++) {
            size first = STRETCH * (backward ? pieces - 1 - piece : piece), length = LEAST(STRETCH, n - first);
            size from = 2 * n * own + (backward ? 2 * first : first), to = 2 * n * own + (backward ? first : 2 * first);
            if (backward) {
                into_lanes(2 * length, some, right + from, 2 * n, tile, TOGETHER);
                backward_rows(first, length, factor, inverse, tile, last);
                for (int a = 0; a < 2; a++)
                    from_lanes(length, some, tile + a * TOGETHER, 2 * TOGETHER, solution + to + a * n, 2 * n);
            } else {
                for (int a = 0; a < 2; a++)
                    into_lanes(length, some, right + from + a * n, 2 * n, tile + a * TOGETHER, 2 * TOGETHER);
                forward_rows(first, length, factor, inverse, tile, last);
                from_lanes(2 * length, some, tile, TOGETHER, solution + to, 2 * n);
            }
        }
    }
}

/* Sum over the windows of the products of their Jacobian on the two tangents with the covariance of these, which are the
   blocks of the inverse, from the last window down. */
static double explained_by_directions(size n, in_t factor, in_t inverse, in_t jacobian)
{
    double c00 = 0.0, c01 = 0.0, c11 = 0.0, sum = 0.0;
    for (size t = n - 1; t >= 0; t--) {
        const double *f = factor + 8 * t;
        double a = f[2], b = f[5], c = f[3], d = f[6]; /* rows (a, b) and (c, d) of L between the windows t + 1 and t */
        double x00 = 1.0, x01 = 0.0, x11 = 1.0;
        if (t < n - 1) {
            x00 += a * a * c00 + 2 * a * c * c01 + c * c * c11;
            x01 = a * b * c00 + (a * d + b * c) * c01 + c * d * c11;
            x11 += b * b * c00 + 2 * b * d * c01 + d * d * c11;
        }
        double u = inverse[2 * t], w = inverse[2 * t + 1], v = -f[1] * u * w;
        c00 = u * u * x00 + 2 * u * v * x01 + v * v * x11;
        c01 = (u * x01 + v * x11) * w;
        c11 = w * w * x11;
        for (int i = 0; i < 3; i++) {
            double x = jacobian[2 * i * n + t], y = jacobian[(2 * i + 1) * n + t];
            sum += x * x * c00 + 2 * x * y * c01 + y * y * c11;
        }
    }
    return sum;
}

#endif
