/* Inner products of many rows. */

#ifndef MAGYC_PRODUCTS_H
#define MAGYC_PRODUCTS_H

#include "common.h"

/* Rows of m entries: the first at `at`, each `step` after the one before; if `place` is given, those with its numbers,
   counted from `origin`. */
typedef struct {
    const double *at;
    size step, count;
    const size *place;
    size origin;
} Rows;

static size number_of(const Rows *rows, size i) { return rows->place ? rows->place[i] - rows->origin : i; }

/* Products of two rows with four; the sums stay in registers, which hides their latency and halves what is read. */
WIDE_VECTORS static void dots(size m, in_t a, in_t other, const double *const b[4], double sum[8])
{
    const double *b0 = b[0], *b1 = b[1], *b2 = b[2], *b3 = b[3];
    double s0 = 0, s1 = 0, s2 = 0, s3 = 0, r0 = 0, r1 = 0, r2 = 0, r3 = 0;
#pragma omp simd reduction(+ : s0, s1, s2, s3, r0, r1, r2, r3)
    for (size t = 0; t < m; t++) {
        double x = a[t], y = other[t];
        s0 += x * b0[t];
        s1 += x * b1[t];
        s2 += x * b2[t];
        s3 += x * b3[t];
        r0 += y * b0[t];
        r1 += y * b1[t];
        r2 += y * b2[t];
        r3 += y * b3[t];
    }
    double s[8] = {s0, s1, s2, s3, r0, r1, r2, r3};
    memcpy(sum, s, sizeof s);
}

/* out (·, columns) += sign a bᵀ of rows a and b, at their numbers; of rows a from that of b on if they are the same. */
static void add_some(size m, double sign, Rows a, Rows b, int same, double *out, size columns)
{
    for (size j = 0; j < b.count; j += 4) {
        const double *some[4];
        size to[4], stop = LEAST(4, b.count - j);
        for (size c = 0; c < 4; c++) {
            to[c] = number_of(&b, j + LEAST(c, stop - 1));
            some[c] = b.at + to[c] * b.step;
        }
        for (size i = same ? j : 0; i < a.count; i += 2) {
            int pair = i + 1 < a.count;
            size one = number_of(&a, i), two = number_of(&a, i + pair);
            double sum[8];
            dots(m, a.at + one * a.step, a.at + two * a.step, some, sum);
            for (size c = 0; c < stop; c++) {
                out[one * columns + to[c]] += sign * sum[c];
                if (pair)
                    out[two * columns + to[c]] += sign * sum[4 + c];
            }
        }
    }
}

/* out (·, columns) += sign a bᵀ. */
static void add_products(size m, double sign, Rows a, Rows b, double *out, size columns)
{
    add_some(m, sign, a, b, 0, out, columns);
}

/* gram (k, k) += sign a aᵀ of rows a; above the diagonal it is not complete. */
static void add_gram(size m, double sign, Rows a, double *gram, size k) { add_some(m, sign, a, a, 1, gram, k); }

/* The same of all k rows (k, m). */
static void add_whole_gram(size m, double sign, const double *a, size k, double *gram)
{
    Rows rows = {a, m, k, NULL, 0};
    add_gram(m, sign, rows, gram, k);
}

#endif
