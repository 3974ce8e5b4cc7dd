/* Columns beside a fit: whitened (`WhitenedFit.whiten`), and their score and information (`ColumnProducts.of_each`). */

#ifndef MAGYC_COLUMNS_H
#define MAGYC_COLUMNS_H

#include "banded.h"
#include "products.h"

/* White windows w (3, n) = x times scale, and their products with the Jacobian (3, 2, n) of the directions. */
WIDE_VECTORS static void of_windows(size n, size first, size stop, in_t x, in_t scale, size axis, in_t jacobian,
                                    out_t w, out_t b0, out_t b1)
{
    const double *s1 = scale + axis, *s2 = s1 + axis;
    for (size t = first; t < stop; t++) {
        double a = x[t] * scale[t], b = x[n + t] * s1[t], c = x[2 * n + t] * s2[t];
        w[t] = a;
        w[n + t] = b;
        w[2 * n + t] = c;
        b0[t - first] = jacobian[t] * a + jacobian[2 * n + t] * b + jacobian[4 * n + t] * c;
        b1[t - first] = jacobian[n + t] * a + jacobian[3 * n + t] * b + jacobian[5 * n + t] * c;
    }
}

/* White links (3, m), m = n − 1, and what they add to these products; link t joins the windows t and t + 1. */
WIDE_VECTORS static void of_links(size m, size first, size stop, in_t x, in_t scale, in_t before, in_t after, out_t w,
                                  out_t b0, out_t b1)
{
    size last = LEAST(stop, m);
    for (size t = first; t < last; t++) {
        double a = x[t] * scale[t], b = x[m + t] * scale[t], c = x[2 * m + t] * scale[t];
        w[t] = a;
        w[m + t] = b;
        w[2 * m + t] = c;
        b0[t - first] += before[t] * a + before[2 * m + t] * b + before[4 * m + t] * c;
        b1[t - first] += before[m + t] * a + before[3 * m + t] * b + before[5 * m + t] * c;
    }
    for (size t = first ? first - 1 : 0; t < stop - 1; t++) {
        double a = w[t], b = w[m + t], c = w[2 * m + t];
        b0[t + 1 - first] += after[t] * a + after[2 * m + t] * b + after[4 * m + t] * c;
        b1[t + 1 - first] += after[m + t] * a + after[3 * m + t] * b + after[5 * m + t] * c;
    }
}

typedef struct {
    size n, axis;
    const double *window, *window_scale, *link, *link_scale, *on_direction, *before, *after, *factor, *inverse;
    double *white_window, *white_link, *absorbed;
} Columns;

/* From the first arrays of `whiten` and of `score`, and the room for what is whitened. */
static Columns whitening(size n, int each_axis, double *const *at, double *window, double *link, double *absorbed)
{
    Columns result = {n,     each_axis ? n : 0, at[0], at[1], at[2],  at[3], at[4],
                      at[5], at[6],             at[7], at[8], window, link,  absorbed};
    return result;
}

static void whiten_together(const Columns *k, size own, size some)
{
    double tile[2 * STRETCH * TOGETHER], last[2 * TOGETHER] = {0}, b[2 * STRETCH];
    size n = k->n, m = n - 1;
    if (some < TOGETHER)
        memset(tile, 0, sizeof tile);
    for (size first = 0; first < n; first += STRETCH) {
        size stop = LEAST(n, first + STRETCH);
        for (size c = 0; c < some; c++) {
            size window = 3 * n * (own + c), link = 3 * m * (own + c);
            if (k->window)
                of_windows(n, first, stop, k->window + window, k->window_scale, k->axis, k->on_direction,
                           k->white_window + window, b, b + STRETCH);
            else
                memset(b, 0, sizeof b);
            if (k->link)
                of_links(m, first, stop, k->link + link, k->link_scale, k->before, k->after, k->white_link + link, b,
                         b + STRETCH);
            into_tile(tile, (int)c, stop - first, b, STRETCH, 1);
        }
        forward_rows(first, stop - first, k->factor, k->inverse, tile, last);
        for (size c = 0; c < some; c++)
            from_tile(tile, (int)c, stop - first, k->absorbed + 2 * n * (own + c) + 2 * first, 1, 2);
    }
}

typedef struct {
    Columns columns;                /* white_window, white_link and absorbed are room for `together` columns */
    size parameters, links, free;   /* rows of the parameters with the residual below them; of those on the links */
    const int64_t *linked;          /* row of the parameters of each row on the links */
    const double *half, *of_window, *of_link, *root, *residual; /* root (free, parameters − 1), residual (free,) */
    double *pull;                   /* (parameters + links, together) */
} Fit;

/* The rows own to own + some (of `count` in all) of one group or more; `together` columns at most. */
static void pull_together(const Fit *f, size own, size some, size count, double *explained, double *score)
{
    const Columns *k = &f->columns;
    size n = k->n, m = n - 1, p = f->parameters;
    Columns part = *k; /* read from `own` on, written from the start */
    part.window = k->window ? k->window + 3 * n * own : NULL;
    part.link = k->link ? k->link + 3 * m * own : NULL;
    for (size first = 0; first < some; first += TOGETHER)
        whiten_together(&part, first, LEAST(TOGETHER, some - first));
    memset(f->pull, 0, sizeof(double) * (size_t)(some * (p + f->links)));
    add_products(2 * n, -1.0, f->half, p, k->absorbed, some, f->pull);
    if (k->window)
        add_products(3 * n, 1.0, f->of_window, p, k->white_window, some, f->pull);
    if (k->link) {
        double *on_links = f->pull + p * some;
        add_products(3 * m, 1.0, f->of_link, f->links, k->white_link, some, on_links);
        for (size i = 0; i < f->links; i++)
            for (size c = 0; c < some; c++)
                f->pull[(size)f->linked[i] * some + c] += on_links[i * some + c];
    }
    for (size c = 0; c < some; c++) {
        double sum = -f->pull[(p - 1) * some + c];
        for (size i = 0; i < f->free; i++) {
            double kept = 0.0;
            for (size j = 0; j < p - 1; j++)
                kept += f->root[i * (p - 1) + j] * f->pull[j * some + c];
            explained[i * count + own + c] = kept;
            sum += f->residual[i] * kept;
        }
        score[own + c] = sum;
    }
}

/* G (k, k) of one group, whose whitened rows begin at `first` and whose columns at `own` of `count`. */
static void information(const Fit *f, size first, size k, const double *explained, size own, size count,
                        double rounding, double *normal)
{
    const Columns *c = &f->columns;
    size n = c->n, m = n - 1;
    memset(normal, 0, sizeof(double) * (size_t)(k * k));
    add_gram(2 * n, -1.0, c->absorbed + 2 * n * first, k, normal);
    for (size i = 0; i < k; i++) /* half of the ridge, of what is absorbed */
        f->pull[i] = -normal[i * k + i];
    if (c->window)
        add_gram(3 * n, 1.0, c->white_window + 3 * n * first, k, normal);
    if (c->link)
        add_gram(3 * m, 1.0, c->white_link + 3 * m * first, k, normal);
    for (size i = 0; i < k; i++) {
        normal[i * k + i] += rounding * (normal[i * k + i] + f->pull[i]);
        for (size j = 0; j <= i; j++) {
            double kept = 0.0;
            for (size r = 0; r < f->free; r++)
                kept += explained[r * count + own + i] * explained[r * count + own + j];
            normal[i * k + j] -= kept;
            normal[j * k + i] = normal[i * k + j];
        }
    }
}

#endif
