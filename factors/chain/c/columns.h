/* Columns beside a fit: whitened (`WhitenedFit.whiten`), and their score and information (`ColumnProducts.of_each`). */

#ifndef MAGYC_COLUMNS_H
#define MAGYC_COLUMNS_H

#include "arguments.h"
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

/* White windows w (n,) = x times scale of a column on one axis, and their products with the Jacobian. */
WIDE_VECTORS static void of_axis(size first, size stop, in_t x, in_t scale, in_t j0, in_t j1, out_t w, out_t b0, out_t b1)
{
    for (size t = first; t < stop; t++) {
        double a = x[t] * scale[t];
        w[t] = a;
        b0[t - first] = j0[t] * a;
        b1[t - first] = j1[t] * a;
    }
}

typedef struct {
    size n, axis;
    const size *on; /* the axis of the windows of each column, or NULL if they are on all */
    const double *const *window, *const *link; /* where those of each column are, or NULL if no column has any */
    const double *window_scale, *link_scale, *on_direction, *before, *after, *factor, *inverse;
    double *white_window, *white_link, *absorbed;
} Columns;

/* From the arrays of a fit, which `whiten` and `score` take, and the room for what is whitened. */
static Columns whitening(size n, int each_axis, const double *const *window, const double *const *link,
                         double *const *at, double *white_window, double *white_link, double *absorbed)
{
    Columns result = {n,     each_axis ? n : 0, NULL,  window, link,         at[0],      at[1],   at[2],
                      at[3], at[4],             at[5], at[6],  white_window, white_link, absorbed};
    return result;
}

/* Where the columns of groups are, given the number of the first of their arrays, one of each group with rows of so many
   entries, and the numbers of their columns; each row is as many columns as there are more of these. NULL if there are
   none. */
static const double **places(const Arrays *a, int array, size groups, const int64_t *count, size length,
                             const double **place)
{
    const double **next = place;
    for (size g = 0; g < groups; g++, array++)
        if (a->at[array])
            for (size c = 0, each = (size)count[g] * length / entries(a, array); c < (size)count[g]; c++)
                *next++ = a->at[array] + c / each * length;
    return next > place ? place : NULL;
}

/* The stretch `first` to `stop` of column c, whitened, and its products b (2, STRETCH) with the directions' Jacobian. */
static void whiten_stretch(const Columns *k, size c, size first, size stop, double *b)
{
    size n = k->n, m = n - 1;
    if (k->on) {
        size i = k->on[c];
        const double *j = k->on_direction + 2 * i * n;
        of_axis(first, stop, k->window[c], k->window_scale + i * k->axis, j, j + n, k->white_window + n * c, b,
                b + STRETCH);
    } else if (k->window)
        of_windows(n, first, stop, k->window[c], k->window_scale, k->axis, k->on_direction,
                   k->white_window + 3 * n * c, b, b + STRETCH);
    else
        memset(b, 0, 2 * STRETCH * sizeof(double));
    if (k->link)
        of_links(m, first, stop, k->link[c], k->link_scale, k->before, k->after, k->white_link + 3 * m * c, b,
                 b + STRETCH);
}

static void whiten_together(const Columns *k, size own, size some)
{
    double tile[2 * STRETCH * TOGETHER], last[2 * TOGETHER] = {0}, b[4 * 2 * STRETCH];
    size n = k->n;
    if (some < TOGETHER)
        memset(tile, 0, sizeof tile);
    for (size first = 0; first < n; first += STRETCH) {
        size stop = LEAST(n, first + STRETCH), length = stop - first;
        for (size c = 0; c < some; c += 4) {
            size few = LEAST(4, some - c);
            for (size i = 0; i < few; i++)
                whiten_stretch(k, own + c + i, first, stop, b + 2 * STRETCH * i);
            for (int a = 0; a < 2; a++)
                into_lanes(length, few, b + a * STRETCH, 2 * STRETCH, tile + a * TOGETHER + c, 2 * TOGETHER);
        }
        forward_rows(first, length, k->factor, k->inverse, tile, last);
        from_lanes(2 * length, some, tile, TOGETHER, k->absorbed + 2 * n * own + 2 * first, 2 * n);
    }
}

/* Products of whitened columns with rows (rows, 3n) on the windows and (rows, 3n − 3) on the links. */
typedef struct {
    Columns columns; /* white_window, white_link and absorbed are room for some columns */
    size rows;
    const double *of_window, *of_link;
    size *place[3], count[3]; /* numbers of the columns there on each axis, if they are on one */
} Fit;

/* The white columns own to own + some of `all`, and their products (rows, all). */
static void products_of(Fit *f, size own, size some, size all, double *products)
{
    const Columns *k = &f->columns;
    size n = k->n, m = n - 1;
    Columns part = *k; /* read from `own` on, written from the start */
    part.window = k->window ? k->window + own : NULL;
    part.link = k->link ? k->link + own : NULL;
    part.on = k->on ? k->on + own : NULL;
    for (size first = 0; first < some; first += TOGETHER)
        whiten_together(&part, first, LEAST(TOGETHER, some - first));
    for (size i = 0; i < f->rows; i++)
        memset(products + i * all + own, 0, sizeof(double) * (size_t)some);
    for (size i = 0; part.on && i < 3; i++) {
        f->count[i] = 0;
        for (size c = 0; c < some; c++)
            if (part.on[c] == i)
                f->place[i][f->count[i]++] = c;
        Rows rows = {f->of_window + i * n, 3 * n, f->rows, NULL, 0};
        Rows columns = {k->white_window, n, f->count[i], f->place[i], 0};
        add_products(n, 1.0, rows, columns, products + own, all);
    }
    if (k->window && !part.on) {
        Rows rows = {f->of_window, 3 * n, f->rows, NULL, 0}, columns = {k->white_window, 3 * n, some, NULL, 0};
        add_products(3 * n, 1.0, rows, columns, products + own, all);
    }
    if (k->link) {
        Rows rows = {f->of_link, 3 * m, f->rows, NULL, 0}, columns = {k->white_link, 3 * m, some, NULL, 0};
        add_products(3 * m, 1.0, rows, columns, products + own, all);
    }
}

/* G (k, k) of the white columns from `first` on, one group, whose products with all rows but the last, `explained`, are
   `all` apart. */
static void information(const Fit *f, size first, size k, const double *explained, size all, double rounding,
                        double *normal)
{
    const Columns *c = &f->columns;
    size n = c->n, m = n - 1;
    memset(normal, 0, sizeof(double) * (size_t)(k * k));
    add_whole_gram(2 * n, -1.0, c->absorbed + 2 * n * first, k, normal);
    for (size i = 0; i < k; i++) /* the ridge below is of the columns themselves */
        normal[i * k + i] /= 1 + rounding;
    for (int i = 0; c->on && i < 3; i++) {
        size begin = 0, stop;
        while (begin < f->count[i] && f->place[i][begin] < first)
            begin++;
        for (stop = begin; stop < f->count[i] && f->place[i][stop] < first + k;)
            stop++;
        Rows rows = {c->white_window + n * first, n, stop - begin, f->place[i] + begin, first};
        add_gram(n, 1.0, rows, normal, k);
    }
    if (c->window && !c->on)
        add_whole_gram(3 * n, 1.0, c->white_window + 3 * n * first, k, normal);
    if (c->link)
        add_whole_gram(3 * m, 1.0, c->white_link + 3 * m * first, k, normal);
    for (size i = 0; i < k; i++) {
        normal[i * k + i] *= 1 + rounding;
        for (size j = 0; j <= i; j++) {
            double kept = 0.0;
            for (size r = 0; r < f->rows - 1; r++)
                kept += explained[r * all + i] * explained[r * all + j];
            normal[i * k + j] -= kept;
            normal[j * k + i] = normal[i * k + j];
        }
    }
}

/* window, link, window_scale, link_scale, on_direction, before, after, factor, inverse; white_window, white_link,
   absorbed */
static double whiten(size n, Arrays *a)
{
    int64_t count = entries(a, 11) / (2 * n);
    double *room_of_places = room(a, 2 * (size)count);
    if (!room_of_places)
        return 0.0;
    const double **of_window = (const double **)room_of_places, **of_link = of_window + count;
    of_window = places(a, 0, 1, &count, 3 * n, of_window);
    of_link = places(a, 1, 1, &count, 3 * (n - 1), of_link);
    Columns k = whitening(n, entries(a, 2) > n, of_window, of_link, a->at + 2, a->at[9], a->at[10], a->at[11]);
    for (size own = 0; own < (size)count; own += TOGETHER)
        whiten_together(&k, own, LEAST(TOGETHER, (size)count - own));
    PyMem_RawFree(room_of_places);
    return 0.0;
}
TO_PYTHON(whiten, 12, 3)

/* The windows of each group, the links of each group; as `whiten` from window_scale to inverse, of_window, of_link,
   rounding (1,), count (groups,) of int64; products, normal: those of the columns with the rows (rows, 3n) of_window and
   (rows, 3n − 3) of_link, and the information of each group. Windows that have fewer than 3n entries for each column are
   rows of n for one axis each, x, y, z, x, … */
static double score(size n, Arrays *a)
{
    int fit = a->count - 13; /* the number of the first array after those of the groups */
    double **at = a->at + fit;
    const int64_t *count = (const int64_t *)at[10];
    size groups = fit / 2, rows = entries(a, fit + 7) / (3 * n), all = entries(a, fit + 11) / rows;
    int on_one_axis = a->at[0] && entries(a, 0) < 3 * n * (size)count[0];
    size together = LEAST(TOGETHER, all), window = a->at[0] ? (on_one_axis ? n : 3 * n) : 0;
    size link = a->at[groups] ? 3 * (n - 1) : 0;
    for (size g = 0; g < groups; g++)
        if (count[g] > together)
            together = (size)count[g];
    double *white = room(a, together * (window + link + 2 * n + 3) + 3 * all);
    if (!white)
        return 0.0;
    double *white_link = white + window * together, *half = white_link + link * together;
    size *place = (size *)(half + 2 * n * together), *axis = place + 3 * together;
    const double **of_window = (const double **)(axis + all), **of_link = of_window + all;
    of_window = places(a, 0, groups, count, window, of_window);
    of_link = places(a, (int)groups, groups, count, link, of_link);
    for (size g = 0, own = 0; g < groups; own += (size)count[g++])
        for (size c = 0; c < (size)count[g]; c++)
            axis[own + c] = c % 3;
    Fit f = {.columns = whitening(n, entries(a, fit) > n, of_window, of_link, at, white, white_link, half),
             .rows = rows, .of_window = at[7], .of_link = at[8],
             .place = {place, place + together, place + 2 * together}};
    f.columns.on = on_one_axis ? axis : NULL;
    double *normal = at[12];
    for (size g = 0, own = 0; g < groups;) {
        size stop = g, some = 0;
        while (stop < groups && some + (size)count[stop] <= together)
            some += (size)count[stop++];
        products_of(&f, own, some, all, at[11]);
        for (size first = 0; g < stop; first += (size)count[g++]) {
            size k = (size)count[g];
            information(&f, first, k, at[11] + own + first, all, at[9][0], normal);
            normal += k * k;
        }
        own += some;
    }
    PyMem_RawFree(white);
    return 0.0;
}
TO_PYTHON_MANY(score, 13, 2)

#endif
