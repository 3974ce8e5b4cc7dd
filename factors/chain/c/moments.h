/* Groups of coefficients with one amplitude each: the likelihoods of amplitudes, the second moments of the coefficients
   averaged over them, and those of the parameters that they move. */

#ifndef MAGYC_MOMENTS_H
#define MAGYC_MOMENTS_H

#include "arguments.h"

#define LARGE 1e100 /* of a product, whose logarithm is then taken */

/* gain, left (m,): `components.log_likelihoods` of one group at its variances, by its k eigenvalues and s along their
   vectors; rules: yᵀy, the degrees of freedom, and the least that is left. */
static void likelihoods(size k, size m, in_t value, in_t pull, in_t variance, in_t rules, out_t gain, out_t left)
{
    for (size j = 0; j < m; j++) {
        double product = 1.0, logs = 0.0, explained = 0.0;
        for (size i = 0; i < k; i++) {
            double spread = 1 + variance[j] * value[i];
            explained += pull[i] * pull[i] / spread;
            product *= spread;
            if (product > LARGE) {
                logs += log(product);
                product = 1.0;
            }
        }
        double rest = rules[0] - variance[j] * explained;
        left[j] = rest < rules[2] ? rules[2] : rest;
        gain[j] = -0.5 * (logs + log(product) + rules[1] * log(left[j] / rules[0]));
    }
}

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

/* count (groups,) of int64, value, pull (K,), variance (groups, m), rules (3,); gain, left (groups, m) */
static double log_likelihoods(size m, Arrays *a)
{
    const int64_t *count = (const int64_t *)a->at[0];
    for (size g = 0, row = 0; g < entries(a, 0); row += (size)count[g++])
        likelihoods((size)count[g], m, a->at[1] + row, a->at[2] + row, a->at[3] + g * m, a->at[4], a->at[5] + g * m,
                    a->at[6] + g * m);
    return 0.0;
}
TO_PYTHON(log_likelihoods, 7, 2)

/* count (groups,) of int64, value (K,), vector (K k), pull (K,), variance, weight, level (groups, m); second (K k) */
static double average_moments(size m, Arrays *a)
{
    const int64_t *count = (const int64_t *)a->at[0];
    size most = 0, row = 0, entry = 0;
    for (size g = 0; g < entries(a, 0); g++)
        most = count[g] > most ? (size)count[g] : most;
    double *work = room(a, most * (2 * most + m));
    if (!work)
        return 0.0;
    for (size g = 0; g < entries(a, 0); g++) {
        size k = (size)count[g];
        averaged_moment(k, m, a->at[1] + row, a->at[2] + entry, a->at[3] + row, a->at[4] + g * m, a->at[5] + g * m,
                        a->at[6] + g * m, work, a->at[7] + entry);
        row += k;
        entry += k * k;
    }
    PyMem_RawFree(work);
    return 0.0;
}
TO_PYTHON(average_moments, 8, 1)

/* p; count (groups,) of int64, moves (p, K), second (K k); covariance (groups, p, p) */
static double propagate(size p, Arrays *a)
{
    const int64_t *count = (const int64_t *)a->at[0];
    size all = entries(a, 1) / p, row = 0, entry = 0;
    double *work = room(a, p * all);
    if (!work)
        return 0.0;
    for (size g = 0; g < entries(a, 0); g++) {
        congruence(p, (size)count[g], a->at[1] + row, all, a->at[2] + entry, work, a->at[3] + g * p * p);
        row += (size)count[g];
        entry += (size)(count[g] * count[g]);
    }
    PyMem_RawFree(work);
    return 0.0;
}
TO_PYTHON(propagate, 4, 1)

#endif
