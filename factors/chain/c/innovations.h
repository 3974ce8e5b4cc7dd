/* Innovations of columns by the forward filter of a chain (`ForwardFilter`). */

#ifndef MAGYC_INNOVATIONS_H
#define MAGYC_INNOVATIONS_H

#include "arguments.h"
#include "banded.h"

typedef struct {
    size n;
    const double *window, *link, *seen, *before, *after, *factor, *inverse, *whitener, *from_half, *from_link;
    double *result;
} Filter;

/* Products b0, b1 of a column's windows x (3, n) and links (3, n − 1) with the Jacobian on the two directions. */
WIDE_VECTORS static void onto_directions(size n, size first, size stop, in_t x, const double *link, in_t seen,
                                         in_t before, in_t after, out_t b0, out_t b1)
{
    size m = n - 1, last = LEAST(stop, m), from = first ? first : 1;
    for (size t = first; t < stop; t++) {
        double a = x[t], b = x[n + t], c = x[2 * n + t];
        b0[t - first] = seen[t] * a + seen[2 * n + t] * b + seen[4 * n + t] * c;
        b1[t - first] = seen[n + t] * a + seen[3 * n + t] * b + seen[5 * n + t] * c;
    }
    for (size t = first; link && t < last; t++) {
        double a = link[t], b = link[m + t], c = link[2 * m + t];
        b0[t - first] += before[t] * a + before[2 * m + t] * b + before[4 * m + t] * c;
        b1[t - first] += before[m + t] * a + before[3 * m + t] * b + before[5 * m + t] * c;
    }
    for (size t = from - 1; link && t < stop - 1; t++) {
        double a = link[t], b = link[m + t], c = link[2 * m + t];
        b0[t + 1 - first] += after[t] * a + after[2 * m + t] * b + after[4 * m + t] * c;
        b1[t + 1 - first] += after[m + t] * a + after[3 * m + t] * b + after[5 * m + t] * c;
    }
}

/* Innovations y (3, n) of a column; h0 and h1 are L⁻¹ of its products with the directions, from the window before
   `first` on. */
WIDE_VECTORS static void whitened_innovations(size n, size first, size stop, in_t x, const double *link, in_t whitener,
                                              in_t from_half, in_t from_link, in_t h0, in_t h1, out_t y)
{
    size m = n - 1, from = first ? first : 1;
    for (size b = 0; b < 3; b++) {
        const double *w = whitener + b * n, *f = from_half + b * m, *k = from_link + b * m;
        double *own = y + b * n;
        for (size t = first; t < stop; t++)
            own[t] = w[t] * x[t] + w[3 * n + t] * x[n + t] + w[6 * n + t] * x[2 * n + t];
        for (size t = from - 1; t < stop - 1; t++)
            own[t + 1] += f[t] * h0[t + 1 - first] + f[3 * m + t] * h1[t + 1 - first];
        for (size t = from - 1; link && t < stop - 1; t++)
            own[t + 1] += k[t] * link[t] + k[3 * m + t] * link[m + t] + k[6 * m + t] * link[2 * m + t];
    }
}

/* Of `some` columns from `own` on, at most TOGETHER. */
static void innovations_together(const Filter *k, size own, size some)
{
    double b[TOGETHER][2][STRETCH], tile[2 * STRETCH * TOGETHER] = {0}, last[2 * TOGETHER] = {0};
    double half[TOGETHER][2][STRETCH + 1] = {{{0.0}}};
    size n = k->n, m = n - 1;
    const double *window = k->window + 3 * n * own, *link = k->link ? k->link + 3 * m * own : NULL;
    double *result = k->result + 3 * n * own;
    for (size first = 0, stop; first < n; first = stop) {
        stop = LEAST(n, first + STRETCH);
        for (size c = 0; c < some; c++)
            onto_directions(n, first, stop, window + 3 * n * c, link ? link + 3 * m * c : NULL, k->seen, k->before,
                            k->after, b[c][0], b[c][1]);
        for (int a = 0; a < 2; a++)
            into_lanes(stop - first, some, b[0][a], 2 * STRETCH, tile + a * TOGETHER, 2 * TOGETHER);
        forward_rows(first, stop - first, k->factor, k->inverse, tile, last);
        for (int a = 0; a < 2; a++)
            from_lanes(stop - first, some, tile + a * TOGETHER, 2 * TOGETHER, &half[0][a][1], 2 * (STRETCH + 1));
        for (size c = 0; c < some; c++) {
            whitened_innovations(n, first, stop, window + 3 * n * c, link ? link + 3 * m * c : NULL, k->whitener,
                                 k->from_half, k->from_link, half[c][0], half[c][1], result + 3 * n * c);
            for (int a = 0; a < 2; a++)
                half[c][a][0] = half[c][a][stop - first];
        }
    }
}

/* window (k, 3, n), link (k, 3, n − 1) or none, seen, before, after, factor, inverse, whitener, from_half, from_link;
   result (k, 3, n) */
static double innovations(size n, Arrays *a)
{
    Filter f = {n,        a->at[0], a->at[1], a->at[2], a->at[3], a->at[4],
                a->at[5], a->at[6], a->at[7], a->at[8], a->at[9], a->at[10]};
    for (size count = entries(a, 0) / (3 * n), own = 0; own < count; own += TOGETHER)
        innovations_together(&f, own, LEAST(TOGETHER, count - own));
    return 0.0;
}
TO_PYTHON(innovations, 11, 1)

#endif
