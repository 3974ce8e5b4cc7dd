/* The linear start of a calibration (`smoother/starts.py`): its columns, normal equations and misfit. */

#ifndef MAGYC_START_H
#define MAGYC_START_H

#include "arguments.h"
#include "products.h"

typedef struct {
    size n, count; /* pairs of windows; columns: of hard iron and bias, and of five units of D if there are eleven */
    const double *before, *after, *lever, *turned_back, *field_before, *field_after, *hard_iron, *units;
} Pairs;

/* The columns (count, 3, n). */
WIDE_VECTORS static void start_columns(const Pairs *p, out_t columns)
{
    size n = p->n;
    const double *h = p->hard_iron;
    for (size t = 0; t < 9 * n; t++)
        columns[t] = p->after[t] - p->before[t];
    for (size t = 0; t < n; t++) {
        double still[3];
        for (int j = 0; j < 3; j++) {
            const double *r = p->before + j * n + t;
            still[j] = p->turned_back[j * n + t] - (r[0] * h[0] + r[3 * n] * h[1] + r[6 * n] * h[2]);
        }
        for (int k = 0; k < 3; k++) {
            const double *l = p->lever + k * n + t;
            double *own = columns + (9 + 3 * k) * n + t;
            own[0] = still[1] * l[6 * n] - still[2] * l[3 * n];
            own[n] = still[2] * l[0] - still[0] * l[6 * n];
            own[2 * n] = still[0] * l[3 * n] - still[1] * l[0];
        }
    }
    for (size e = 6; e < p->count; e++)
        for (size t = 0; t < n; t++) {
            const double *unit = p->units + 9 * (e - 6);
            double after[3], before[3];
            for (int i = 0; i < 3; i++) {
                after[i] = before[i] = 0.0;
                for (int k = 0; k < 3; k++) {
                    after[i] += unit[3 * i + k] * (p->field_after[k * n + t] - h[k]);
                    before[i] += unit[3 * i + k] * (p->field_before[k * n + t] - h[k]);
                }
            }
            for (int j = 0; j < 3; j++) {
                double sum = 0.0;
                for (int i = 0; i < 3; i++)
                    sum += p->after[(3 * i + j) * n + t] * after[i] - p->before[(3 * i + j) * n + t] * before[i];
                columns[(3 * e + j) * n + t] = sum;
            }
        }
}

/* normal (count, count) and right (count,) of the columns, each pair with its weight; `weighted` holds them. */
static void start_equations(const Pairs *p, const double *columns, const double *constant, const double *weight,
                            double *weighted, double *normal, double *right)
{
    size n = p->n, k = p->count;
    for (size r = 0; r < 3 * k; r++)
        for (size t = 0; t < n; t++)
            weighted[r * n + t] = columns[r * n + t] * weight[t];
    memset(normal, 0, sizeof(double) * (size_t)(k * k));
    memset(right, 0, sizeof(double) * (size_t)k);
    Rows rows = {columns, 3 * n, k, NULL, 0}, white = {weighted, 3 * n, k, NULL, 0}, one = {constant, 3 * n, 1, NULL, 0};
    add_products(3 * n, 1.0, rows, white, normal, k);
    add_products(3 * n, 1.0, white, one, right, 1);
}

/* Squares (n,) of what a solution leaves of the constant (3, n). */
WIDE_VECTORS static void start_misfit(size n, size count, in_t columns, in_t solution, in_t constant, out_t square)
{
    memset(square, 0, sizeof(double) * (size_t)n);
    for (int i = 0; i < 3; i++)
        for (size t = 0; t < n; t++) {
            double left = constant[i * n + t];
            for (size c = 0; c < count; c++)
                left -= solution[c] * columns[(3 * c + i) * n + t];
            square[t] += left * left;
        }
}

/* before, after, lever (3, 3, n), turned_back, field_before, field_after (3, n), hard_iron (3,), units (5, 3, 3), constant
   (3, n), weight (n,); columns (k, 3, n), normal (k, k), right (k,) */
static double start_from(size n, Arrays *a)
{
    double **at = a->at;
    Pairs p = {n, entries(a, 12), at[0], at[1], at[2], at[3], at[4], at[5], at[6], at[7]};
    double *weighted = room(a, 3 * n * p.count);
    if (!weighted)
        return 0.0;
    start_columns(&p, at[10]);
    start_equations(&p, at[10], at[8], at[9], weighted, at[11], at[12]);
    PyMem_RawFree(weighted);
    return 0.0;
}
TO_PYTHON(start_from, 13, 3)

/* columns (k, 3, n), solution (k,), constant (3, n); square (n,) */
static double start_left(size n, Arrays *a)
{
    start_misfit(n, entries(a, 1), a->at[0], a->at[1], a->at[2], a->at[3]);
    return 0.0;
}
TO_PYTHON(start_left, 4, 1)

#endif
