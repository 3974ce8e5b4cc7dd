/* The linearisation of a field chain: `linearisation.py` names the quantities. */

#ifndef MAGYC_LINEARISATION_H
#define MAGYC_LINEARISATION_H

#include "common.h"

typedef struct {
    size n, parameters;
    const double *matrix, *swing, *axes; /* B (3, 3); Exp(ε) (3, 3); Jacobians B [J]x (3, 3, 3), or NULL without ε */
    const double *rotation, *turn, *rotation_bias, *rotation_rate, *lever;
    const double *scale, *field, *link_scale, *answer, *direction;
    double *basis, *on_direction, *before, *after, *columns, *links, *band, *border;
} Chain;

/* y = A x for a constant A and vectors (3, some) with the given strides. */
WIDE_VECTORS static void turned_by(size some, in_t matrix, in_t x, size from, out_t y, size to)
{
    for (int i = 0; i < 3; i++)
        for (size t = 0; t < some; t++)
            y[i * to + t] =
                matrix[3 * i] * x[t] + matrix[3 * i + 1] * x[from + t] + matrix[3 * i + 2] * x[2 * from + t];
}

/* y = A x for matrices A (3, 3, ·) whose entries are `entry` apart, times a scale. */
WIDE_VECTORS static void turned_each(size some, in_t matrix, size row, size entry, in_t x, size from, in_t scale,
                                     out_t y, size to)
{
    for (int i = 0; i < 3; i++) {
        const double *a = matrix + i * row, *b = a + entry, *c = b + entry;
        for (size t = 0; t < some; t++)
            y[i * to + t] = (a[t] * x[t] + b[t] * x[from + t] + c[t] * x[2 * from + t]) * scale[t];
    }
}

/* Tangent bases (3, 2, some) of directions (Duff et al. 2017), as `rotations.tangent_frame`. */
WIDE_VECTORS static void tangents(size some, in_t g, size from, out_t basis, size to)
{
    for (size t = 0; t < some; t++) {
        double x = g[t], y = g[from + t], z = g[2 * from + t], sign = copysign(1.0, z), a = -1 / (sign + z);
        double b = y * (x * a);
        basis[t] = 1 + sign * x * (x * a);
        basis[to + t] = b;
        basis[2 * to + t] = sign * b;
        basis[3 * to + t] = sign + y * y * a;
        basis[4 * to + t] = -sign * x;
        basis[5 * to + t] = -y;
    }
}

/* b += ± Jᵀ x for Jacobians J (3, 2, ·) and vectors x (3, ·). */
WIDE_VECTORS static void onto_tangents(size some, double sign, in_t jacobian, size from, in_t x, size of, out_t b,
                                       size to)
{
    for (int a = 0; a < 2; a++) {
        const double *j = jacobian + a * from;
        for (size t = 0; t < some; t++)
            b[a * to + t] +=
                sign * (j[t] * x[t] + j[2 * from + t] * x[of + t] + j[4 * from + t] * x[2 * of + t]);
    }
}

WIDE_VECTORS static void times(size some, in_t scale, out_t y)
{
    for (size t = 0; t < some; t++)
        y[t] *= scale[t];
}

/* The windows `first` to first + some: their tangent bases and Jacobians on the directions, M g (3, STRETCH), whitened,
   and B M g, which starts the residual (3, n). */
static void directions_of_stretch(const Chain *k, size first, size some, double *body, double *residual)
{
    size n = k->n;
    const double *g = k->direction + first, *scale = k->scale + first;
    double *basis = k->basis + first, *on_direction = k->on_direction + first;
    tangents(some, g, n, basis, n);
    for (int a = 0; a < 2; a++) { /* B M times each tangent */
        turned_each(some, k->rotation + first, 3 * n, n, basis + a * n, 2 * n, scale, body, STRETCH);
        turned_by(some, k->matrix, body, STRETCH, on_direction + a * n, 2 * n);
    }
    turned_each(some, k->rotation + first, 3 * n, n, g, n, scale, body, STRETCH);
    turned_by(some, k->matrix, body, STRETCH, residual, n);
    for (int i = 0; k->answer && i < 3; i++) {
        const double *answer = k->answer + i * n + first;
        for (int a = 0; a < 2; a++)
            times(some, answer, on_direction + (2 * i + a) * n);
        times(some, answer, residual + i * n);
    }
}

/* The windows `first` to first + some: their Jacobians, and what they add to the border. */
static void of_stretch(const Chain *k, size first, size some)
{
    size n = k->n, last = k->parameters;
    const double *g = k->direction + first, *scale = k->scale + first;
    double white[3 * STRETCH], body[3 * STRETCH], swung[3 * STRETCH];
    double *on_direction = k->on_direction + first, *columns = k->columns + first, *residual = columns + 3 * n * last;
    directions_of_stretch(k, first, some, body, residual);
    turned_by(some, k->swing, body, STRETCH, swung, STRETCH);
    /* On vech(S): Exp(ε) M g where the entry of S meets it; on h the scale. */
    static const int meets[6][2] = {{0, 0}, {0, 1}, {0, 2}, {1, 1}, {1, 2}, {2, 2}};
    for (int p = 0; p < 9; p++)
        for (int i = 0; i < 3; i++)
            memset(columns + (3 * p + i) * n, 0, some * sizeof(double));
    for (int p = 0; p < 6; p++) {
        int i = meets[p][0], j = meets[p][1];
        memcpy(columns + (3 * p + i) * n, swung + j * STRETCH, some * sizeof(double));
        memcpy(columns + (3 * p + j) * n, swung + i * STRETCH, some * sizeof(double));
    }
    for (int i = 0; i < 3; i++) {
        memcpy(columns + (3 * (6 + i) + i) * n, scale, some * sizeof(double));
        memcpy(white + i * STRETCH, g + i * n, some * sizeof(double));
        times(some, scale, white + i * STRETCH);
    }
    double *ones = swung; /* no longer needed */
    for (size t = 0; t < some; t++)
        ones[t] = 1.0;
    for (int p = 0; p < 3; p++) { /* on b */
        double part[3 * STRETCH];
        turned_each(some, k->rotation_bias + p * n + first, 9 * n, 3 * n, white, STRETCH, ones, part, STRETCH);
        turned_by(some, k->matrix, part, STRETCH, columns + 3 * n * (9 + p), n);
    }
    double part[3 * STRETCH]; /* on τ */
    turned_each(some, k->rotation_rate + first, 3 * n, n, white, STRETCH, ones, part, STRETCH);
    turned_by(some, k->matrix, part, STRETCH, columns + 3 * n * 12, n);
    if (k->axes)
        for (int p = 0; p < 3; p++)
            turned_by(some, k->axes + 9 * p, body, STRETCH, columns + 3 * n * (13 + p), n);
    for (int i = 0; i < 3; i++) {
        const double *field = k->field + i * n + first;
        if (k->answer) {
            const double *answer = k->answer + i * n + first;
            for (size p = 0; p < last; p++)
                times(some, answer, columns + (3 * p + i) * n);
        }
        for (size t = 0; t < some; t++)
            residual[i * n + t] -= field[t];
    }
    for (size p = 0; p <= last; p++) {
        memset(k->border + 2 * n * p + first, 0, some * sizeof(double));
        memset(k->border + 2 * n * p + n + first, 0, some * sizeof(double));
        onto_tangents(some, 1.0, on_direction, n, columns + 3 * n * p, n, k->border + 2 * n * p + first, n);
    }
}

/* The links `first` to first + some: their Jacobians on the directions, E g (3, STRETCH), whitened, and the residual
   (3, n − 1). `before` is minus the rotated tangents. */
WIDE_VECTORS static void links_of_stretch(const Chain *k, size first, size some, double *turned, double *residual)
{
    size n = k->n, m = n - 1;
    const double *g = k->direction + first, *scale = k->link_scale + first, *basis = k->basis + first;
    double *before = k->before + first, *after = k->after + first, minus[STRETCH];
    for (size t = 0; t < some; t++)
        minus[t] = -scale[t];
    turned_each(some, k->turn + first, 3 * m, m, g, n, scale, turned, STRETCH);
    for (int a = 0; a < 2; a++)
        turned_each(some, k->turn + first, 3 * m, m, basis + a * n, 2 * n, minus, before + a * m, 2 * m);
    for (int i = 0; i < 3; i++) {
        for (int a = 0; a < 2; a++)
            for (size t = 0; t < some; t++)
                after[(2 * i + a) * m + t] = basis[(2 * i + a) * n + t + 1] * scale[t];
        for (size t = 0; t < some; t++)
            residual[i * m + t] = g[i * n + t + 1] * scale[t] - turned[i * STRETCH + t];
    }
}

/* The links `first` to first + some: their Jacobians on the bias, too, and what they add to the border. */
static void of_link_stretch(const Chain *k, size first, size some)
{
    size n = k->n, m = n - 1, last = k->parameters;
    double *links = k->links + first, *before = k->before + first, *after = k->after + first;
    double turned[3 * STRETCH];
    links_of_stretch(k, first, some, turned, links + 9 * m);
    for (int p = 0; p < 3; p++) /* lever × E g */
        for (int i = 0; i < 3; i++) {
            int j = (i + 1) % 3, l = (i + 2) % 3;
            const double *one = k->lever + (3 * j + p) * m + first, *other = k->lever + (3 * l + p) * m + first;
            for (size t = 0; t < some; t++)
                links[(3 * p + i) * m + t] = one[t] * turned[l * STRETCH + t] - other[t] * turned[j * STRETCH + t];
        }
    for (int p = 0; p < 4; p++) {
        double *border = k->border + 2 * n * (p < 3 ? 9 + p : last) + first;
        onto_tangents(some, 1.0, before, m, links + 3 * m * p, m, border, n);
        onto_tangents(some, 1.0, after, m, links + 3 * m * p, m, border + 1, n);
    }
}

/* Residuals that are not whitened: of the windows (3, n), B M g + h less the field, and of the links (3, n − 1). */
WIDE_VECTORS static void plain_residuals(size n, in_t matrix, in_t rotation, in_t turn, in_t field, in_t iron, in_t g,
                                         out_t window, out_t link)
{
    size m = n - 1;
    for (size t = 0; t < n; t++) {
        double body[3];
        for (int i = 0; i < 3; i++) {
            const double *r = rotation + 3 * i * n + t;
            body[i] = r[0] * g[t] + r[n] * g[n + t] + r[2 * n] * g[2 * n + t];
        }
        for (int i = 0; i < 3; i++)
            window[i * n + t] = matrix[3 * i] * body[0] + matrix[3 * i + 1] * body[1] + matrix[3 * i + 2] * body[2] -
                                (field[i * n + t] - iron[i]);
    }
    for (int i = 0; i < 3; i++) {
        const double *r = turn + 3 * i * m;
        for (size t = 0; t < m; t++)
            link[i * m + t] =
                g[i * n + t + 1] - (r[t] * g[t] + r[m + t] * g[n + t] + r[2 * m + t] * g[2 * n + t]);
    }
}

/* The matrix of the directions, (2n, 4): its lower band. */
WIDE_VECTORS static void band_of(const Chain *k)
{
    size n = k->n, m = n - 1;
    const double *j = k->on_direction, *b = k->before, *a = k->after;
    for (size t = 0; t < n; t++) {
        double own[3] = {0}, square = 0.0, *row = k->band + 8 * t;
        for (int i = 0; i < 3; i++) {
            double x = j[2 * i * n + t], y = j[(2 * i + 1) * n + t];
            own[0] += x * x;
            own[1] += x * y;
            own[2] += y * y;
        }
        if (t)
            square += k->link_scale[t - 1] * k->link_scale[t - 1];
        if (t < m)
            square += k->link_scale[t] * k->link_scale[t];
        double across[4] = {0};
        if (t < m)
            for (int i = 0; i < 3; i++)
                for (int c = 0; c < 4; c++)
                    across[c] += b[(2 * i + c / 2) * m + t] * a[(2 * i + c % 2) * m + t];
        row[0] = own[0] + square; /* the tangent bases are orthonormal */
        row[1] = own[1];
        row[2] = across[0];
        row[3] = across[1];
        row[4] = own[2] + square;
        row[5] = across[2];
        row[6] = across[3];
        row[7] = 0.0;
    }
}

#endif
