/* Inner products of many rows. */

#ifndef MAGYC_PRODUCTS_H
#define MAGYC_PRODUCTS_H

#include "common.h"

/* out += sign a bᵀ for one or two rows a with some of four rows b, all of m entries and one below the other. The sums
   stay in registers, which hides their latency and halves what is read. */
WIDE_VECTORS static void dots(size m, double sign, in_t a, int pair, in_t b, int some, out_t out, size row)
{
    const double *other = a + pair * m, *b1 = b + (some > 1) * m, *b2 = b1 + (some > 2) * m, *b3 = b2 + (some > 3) * m;
    double s0 = 0, s1 = 0, s2 = 0, s3 = 0, r0 = 0, r1 = 0, r2 = 0, r3 = 0;
#pragma omp simd reduction(+ : s0, s1, s2, s3, r0, r1, r2, r3)
    for (size t = 0; t < m; t++) {
        double x = a[t], y = other[t];
        s0 += x * b[t];
        s1 += x * b1[t];
        s2 += x * b2[t];
        s3 += x * b3[t];
        r0 += y * b[t];
        r1 += y * b1[t];
        r2 += y * b2[t];
        r3 += y * b3[t];
    }
    double s[4] = {s0, s1, s2, s3}, r[4] = {r0, r1, r2, r3};
    for (int c = 0; c < some; c++) {
        out[c] += sign * s[c];
        if (pair)
            out[row + c] += sign * r[c];
    }
}

/* out (rows, columns) += sign a bᵀ of rows a (rows, m) and b (columns, m). */
static void add_products(size m, double sign, const double *a, size rows, const double *b, size columns, double *out)
{
    for (size j = 0; j < columns; j += 4)
        for (size i = 0; i < rows; i += 2)
            dots(m, sign, a + i * m, i + 1 < rows, b + j * m, (int)LEAST(4, columns - j), out + i * columns + j,
                 columns);
}

/* gram (k, k) += sign a aᵀ of rows a (k, m); above the diagonal it is not complete. */
static void add_gram(size m, double sign, const double *a, size k, double *gram)
{
    for (size j = 0; j < k; j += 4)
        for (size i = j; i < k; i += 2)
            dots(m, sign, a + i * m, i + 1 < k, a + j * m, (int)LEAST(4, k - j), gram + i * k + j, k);
}

#endif
