/* Second moments of groups of coefficients, and of the parameters that they move. */

#ifndef MAGYC_MOMENTS_H
#define MAGYC_MOMENTS_H

#include "common.h"

/* result (rows, rows) = left (rows, k) · inner (k, k), symmetric · leftᵀ; work holds (rows, k). */
static void congruence(size rows, size k, in_t left, size step, in_t inner, out_t work, out_t result)
{
    for (size r = 0; r < rows; r++)
        for (size i = 0; i < k; i++) {
            double sum = 0.0;
            for (size j = 0; j < k; j++)
                sum += left[r * step + j] * inner[i * k + j];
            work[r * k + i] = sum;
        }
    for (size r = 0; r < rows; r++)
        for (size s = 0; s <= r; s++) {
            double sum = 0.0;
            for (size j = 0; j < k; j++)
                sum += work[r * k + j] * left[s * step + j];
            result[r * rows + s] = result[s * rows + r] = sum;
        }
}

/* E[β βᵀ] (k, k) of a group with eigenvalues, eigenvectors (k, k), and s along them, averaged over m variances with
   weights, and their levels φ times the weights; `work` holds k (k + k + m). */
static void averaged_moment(size k, size m, in_t value, in_t vector, in_t pull, in_t variance, in_t weight, in_t level,
                            out_t work, out_t second)
{
    double *inner = work, *mean = inner + k * k, *room = mean + k * m;
    for (size i = 0; i < k; i++) {
        double sum = 0.0;
        for (size j = 0; j < m; j++) {
            double known = variance[j] / (1 + variance[j] * value[i]);
            mean[i * m + j] = known * pull[i];
            sum += level[j] * known;
        }
        for (size l = 0; l <= i; l++) {
            double both = l == i ? sum : 0.0;
            for (size j = 0; j < m; j++)
                both += weight[j] * mean[i * m + j] * mean[l * m + j];
            inner[i * k + l] = inner[l * k + i] = both;
        }
    }
    congruence(k, k, vector, k, inner, room, second);
}

#endif
