/* The gyroscope: rotations as pairs (w + i x, y + i z), see `rotations.py`, and sums over windows. */

#ifndef MAGYC_GYROSCOPE_H
#define MAGYC_GYROSCOPE_H

#include "arguments.h"

#define RENORMALISED 64 /* steps after which a product is given unit norm again */

#define HOLE 10.0 /* ratio of two neighbouring steps from which the longer one is a hole */

/* The m steps between stamps, their reciprocals, and the share of each in what it and the next one last; returns the
   number of those that are much longer or shorter than one beside them. */
WIDE_VECTORS static size steps_between(size m, in_t time, out_t step, out_t inverse, out_t share)
{
    int64_t uneven = 0;
    for (size t = 0; t < m; t++) {
        step[t] = time[t + 1] - time[t];
        inverse[t] = 1 / step[t];
    }
    for (size t = 0; t < m - 1; t++) {
        share[t] = step[t] / (step[t] + step[t + 1]);
        uneven += step[t] >= HOLE * step[t + 1] || step[t + 1] >= HOLE * step[t];
    }
    return (size)uneven;
}

/* Turns (m,) about one axis by its rates (m + 1,): the trapezoid rule with its end correction, by parabolas. */
WIDE_VECTORS static void about_axis(size m, in_t rate, in_t step, in_t inverse, in_t share, out_t slope, out_t turn)
{
    for (size t = 0; t < m; t++)
        turn[t] = 0.5 * step[t] * (rate[t] + rate[t + 1]);
    for (size t = 0; t < m - 1; t++) {
        double change = (rate[t + 1] - rate[t]) * inverse[t], next = (rate[t + 2] - rate[t + 1]) * inverse[t + 1];
        slope[t] = change + share[t] * (next - change);
    }
    for (size t = 1; t < m - 1; t++)
        turn[t] -= step[t] * step[t] / 12 * (slope[t] - slope[t - 1]);
}

/* Coning: what the turn of the axes themselves in m steps adds to one component of the turns (m,). */
WIDE_VECTORS static void add_coning(size m, in_t y, in_t z, in_t step, out_t turn)
{
    for (size t = 0; t < m; t++)
        turn[t] += step[t] * step[t] / 12 * (y[t] * z[t + 1] - z[t] * y[t + 1]);
}

/* Rotation vectors (3, n − 1) from each of n rates (n, 3) to the next, as `rotations.increments` gives them if all steps
   are even; returns the number of those that are not, and then computes none. `work` holds 7 n. */
static double turns_between(size n, in_t time, in_t rate, in_t bias, double *work, double *result)
{
    size m = n - 1;
    double *axes = work, *step = work + 3 * n, *inverse = step + n, *share = inverse + n, *slope = share + n;
    size uneven = steps_between(m, time, step, inverse, share);
    if (uneven)
        return (double)uneven;
    for (size t = 0; t < n; t++)
        for (int i = 0; i < 3; i++)
            axes[n * i + t] = rate[3 * t + i] - bias[i];
    for (int i = 0; i < 3; i++)
        about_axis(m, axes + n * i, step, inverse, share, slope, result + m * i);
    for (int i = 0; i < 3; i++)
        add_coning(m, axes + n * ((i + 1) % 3), axes + n * ((i + 2) % 3), step, result + m * i);
    return 0.0;
}

/* time (n,), rate (n, 3), bias (3,); result (3, n − 1): as `rotations.increments`, n > 3. Returns the number of uneven
   steps, where the result is another. */
static double increments(size n, Arrays *a)
{
    double *work = room(a, 7 * n);
    double uneven = work ? turns_between(n, a->at[0], a->at[1], a->at[2], work, a->at[3]) : 0.0;
    PyMem_RawFree(work);
    return uneven;
}
TO_PYTHON(increments, 4, 1)

/* Fractions (m,) of a window that pass in m steps between rates (m + 1, 3), as `preintegration.windows_passed`. */
WIDE_VECTORS static void passed_in_steps(size m, in_t step, in_t rate, double turn, double length, out_t passed)
{
    double speed[STRETCH + 1], least = 1 / length;
    for (size first = 0; first < m; first += STRETCH) {
        size some = LEAST(STRETCH, m - first);
        const double *w = rate + 3 * first;
        for (size t = 0; t <= some; t++)
            speed[t] = sqrt(w[3 * t] * w[3 * t] + w[3 * t + 1] * w[3 * t + 1] + w[3 * t + 2] * w[3 * t + 2]);
        for (size t = 0; t < some; t++) {
            double share = 0.5 * (speed[t + 1] + speed[t]) / turn;
            passed[first + t] = (share < least ? least : share) * step[first + t];
        }
    }
}

/* step (m,), rate (m + 1, 3), limits (2,): turn and length of a window; passed (m,) */
static double windows_passed(size m, Arrays *a)
{
    passed_in_steps(m, a->at[0], a->at[1], a->at[2][0], a->at[2][1], a->at[3]);
    return 0.0;
}
TO_PYTHON(windows_passed, 4, 1)

/* cos and sin(φ)/2φ of half the angles of `some` rotation vectors (3, n), whose series are exact to rounding. */
WIDE_VECTORS static void half_angles(size some, in_t vector, size n, out_t cosine, out_t half)
{
    for (size t = 0; t < some; t++) {
        double a = vector[t], b = vector[n + t], c = vector[2 * n + t], square = a * a + b * b + c * c;
        cosine[t] = 1 - square * (1. / 8 - square * (1. / 384 - square * (1. / 46080 - square * (1. / 10321920))));
        half[t] = 0.5 - square * (1. / 48 - square * (1. / 3840 - square * (1. / 645120 - square * (1. / 185794560))));
    }
}

/* The rotation p, q followed by the exponential of a vector (3,), whose entries are n apart, given `half_angles` of it. */
ALWAYS_INLINE void turned_by_vector(const double *p, const double *q, const double *vector, size n, double cosine,
                                    double half, double *p1, double *q1)
{
    double w = p[0], x = p[1], y = q[0], z = q[1];
    double a = vector[0], b = vector[n], c = vector[2 * n], square = a * a + b * b + c * c, v = cosine;
    if (!(square < 0.05)) {
        double angle = sqrt(square);
        v = cos(0.5 * angle);
        half = sin(0.5 * angle) / angle;
    }
    a *= half;
    b *= half;
    c *= half;
    p1[0] = w * v - x * a - y * b - z * c;
    p1[1] = w * a + x * v + y * c - z * b;
    q1[0] = w * b - x * c + y * v + z * a;
    q1[1] = w * c + x * b - y * a + z * v;
}

/* Products of the exponentials of n rotation vectors (3, n), n + 1 of them, the first one. */
static void chained(size n, in_t vector, out_t p, out_t q)
{
    double cosine[STRETCH], half[STRETCH];
    p[0] = 1.0;
    p[1] = q[0] = q[1] = 0.0;
    for (size t = 0; t < n; t++) {
        if (t % STRETCH == 0)
            half_angles(LEAST(STRETCH, n - t), vector + t, n, cosine, half);
        double *p1 = p + 2 * t + 2, *q1 = q + 2 * t + 2;
        turned_by_vector(p + 2 * t, q + 2 * t, vector + t, n, cosine[t % STRETCH], half[t % STRETCH], p1, q1);
        if (t % RENORMALISED == RENORMALISED - 1) {
            double norm = 1.5 - 0.5 * (p1[0] * p1[0] + p1[1] * p1[1] + q1[0] * q1[0] + q1[1] * q1[1]);
            for (int i = 0; i < 2; i++) {
                p1[i] *= norm;
                q1[i] *= norm;
            }
        }
    }
}

static inline void matrix_of(const double *p, const double *q, double r[9])
{
    double w = p[0], x = p[1], y = q[0], z = q[1], x2 = x + x, y2 = y + y, z2 = z + z;
    r[0] = 1 - y * y2 - z * z2;
    r[1] = x * y2 - w * z2;
    r[2] = x * z2 + w * y2;
    r[3] = x * y2 + w * z2;
    r[4] = 1 - x * x2 - z * z2;
    r[5] = y * z2 - w * x2;
    r[6] = x * z2 - w * y2;
    r[7] = y * z2 + w * x2;
    r[8] = 1 - x * x2 - y * y2;
}

/* lever (9, n) = start − ∫ R dt by the trapezoid rule over n − 1 steps. */
static void levers(size n, in_t p, in_t q, in_t step, in_t start, out_t lever)
{
    double before[9], after[9], sum[9];
    matrix_of(p, q, before);
    for (int i = 0; i < 9; i++)
        lever[i * n] = sum[i] = start[i];
    for (size t = 1; t < n; t++) {
        double half = -0.5 * step[t - 1];
        matrix_of(p + 2 * t, q + 2 * t, after);
        for (int i = 0; i < 9; i++) {
            lever[i * n + t] = sum[i] += half * (before[i] + after[i]);
            before[i] = after[i];
        }
    }
}

/* Of n stamps: their times, rotations p and q, rates (n, 3), turns (3, n − 1) from each to the next and levers (9, n);
   bias (3,); 1 if rates are means since the stamp before, else 0. At times (m,): rotations, levers (9, m), rates (m, 3). */
static double motion_at(size n, Arrays *a)
{
    const double *time = a->at[0], *rate = a->at[3], *turn = a->at[4], *lever = a->at[5], *bias = a->at[6];
    const double *when = a->at[8], means = a->at[7][0];
    double *p = a->at[9], *q = a->at[10], *of_lever = a->at[11], *of_rate = a->at[12];
    double vector[3 * STRETCH], cosine[STRETCH], half[STRETCH];
    size m = entries(a, 8), place[STRETCH], left = 0;
    for (size first = 0; first < m; first += STRETCH) {
        size some = LEAST(STRETCH, m - first);
        for (size k = 0; k < some; k++) {
            size t = first + k;
            while (left > 0 && time[left] > when[t])
                left--;
            while (left < n - 2 && time[left + 1] <= when[t])
                left++;
            place[k] = left;
            double step = time[left + 1] - time[left], since = when[t] - time[left], share = since / step;
            for (int i = 0; i < 3; i++) {
                double before = rate[3 * left + i], after = rate[3 * left + 3 + i], whole = turn[i * (n - 1) + left];
                double there = before + (after - before) * share;
                double rest = whole - (0.5 * (before + after) - bias[i]) * step;
                vector[i * STRETCH + k] =
                    means ? whole * share : (0.5 * (before + there) - bias[i]) * since + rest * share;
                of_rate[3 * t + i] = (means ? after : there + rest / step) - bias[i];
            }
            for (int i = 0; i < 9; i++) {
                const double *own = lever + i * n + left;
                of_lever[i * m + t] = own[0] + (own[1] - own[0]) * share;
            }
        }
        half_angles(some, vector, STRETCH, cosine, half);
        for (size k = 0; k < some; k++)
            turned_by_vector(a->at[1] + 2 * place[k], a->at[2] + 2 * place[k], vector + k, STRETCH, cosine[k], half[k],
                             p + 2 * (first + k), q + 2 * (first + k));
    }
    return 0.0;
}
TO_PYTHON(motion_at, 13, 4)

/* Sums (27, windows) over the samples of each window, from its start to the next: R and K row by row, and
   d/dτ R(t − τ)ᵀ = [ω]× Rᵀ. Samples (m): p, q, lever (9, m), rate (m, 3). */
static void window_sums(size windows, const int64_t *start, size m, in_t p, in_t q, in_t lever, in_t rate, out_t sums)
{
    for (size k = 0; k < windows; k++) {
        size stop = k + 1 < windows ? (size)start[k + 1] : m;
        double sum[27] = {0}, r[9];
        for (size t = (size)start[k]; t < stop; t++) {
            const double *w = rate + 3 * t;
            matrix_of(p + 2 * t, q + 2 * t, r);
            for (int i = 0; i < 9; i++) {
                sum[i] += r[i];
                sum[9 + i] += lever[i * m + t];
            }
            for (int j = 0; j < 3; j++) { /* column j of Rᵀ is row j of R */
                const double *v = r + 3 * j;
                sum[18 + j] += w[1] * v[2] - w[2] * v[1];
                sum[21 + j] += w[2] * v[0] - w[0] * v[2];
                sum[24 + j] += w[0] * v[1] - w[1] * v[0];
            }
        }
        for (int i = 0; i < 27; i++)
            sums[i * windows + k] = sum[i];
    }
}

/* The mean field (3, windows) of the samples of each window, and the variance of their stamps about their mean. */
static void averages(size windows, const int64_t *start, size m, in_t mean, in_t time, in_t field, out_t of_field,
                     out_t spread)
{
    for (size k = 0; k < windows; k++) {
        size first = (size)start[k], stop = k + 1 < windows ? (size)start[k + 1] : m;
        double count = (double)(stop - first), square = 0.0, x[3] = {0};
        for (size t = first; t < stop; t++) {
            square += (time[t] - mean[k]) * (time[t] - mean[k]);
            for (int i = 0; i < 3; i++)
                x[i] += field[3 * t + i];
        }
        spread[k] = square / count;
        for (int i = 0; i < 3; i++)
            of_field[i * windows + k] = x[i] / count;
    }
}

/* From sums (27, n) over windows, their counts and the variances of their stamps (n,): the mean rotation to the sensor
   (3, 3, n), its derivatives by the bias (3, 3, 3, n) and by the delay (3, 3, n), and the levers (3, 3, n − 1). */
static void motion_of_windows(size n, in_t sums, in_t count, in_t spread, out_t rotation, out_t by_bias, out_t by_delay,
                              out_t lever)
{
    for (size t = 0; t < n; t++) {
        double share = 1 / count[t], world[3][3], swung[3][3]; /* world: rows of the rotation to the world */
        for (int i = 0; i < 3; i++)
            for (int j = 0; j < 3; j++) {
                double rate = sums[(18 + 3 * i + j) * n + t] * share;
                world[i][j] = sums[(3 * i + j) * n + t] * share;
                rotation[(3 * j + i) * n + t] = world[i][j];
                by_delay[(3 * i + j) * n + t] = rate;
                swung[i][j] = rate * spread[t];
                if (t)
                    lever[(3 * i + j) * (n - 1) + t - 1] =
                        sums[(9 + 3 * i + j) * n + t] * share - sums[(9 + 3 * i + j) * n + t - 1] / count[t - 1];
            }
        for (int k = 0; k < 3; k++) /* [row k of M']: column b of the world's rotation × this row */
            for (int b = 0; b < 3; b++)
                for (int i = 0; i < 3; i++) {
                    int j = (i + 1) % 3, l = (i + 2) % 3;
                    by_bias[((3 * k + i) * 3 + b) * n + t] = world[j][b] * swung[k][l] - world[l][b] * swung[k][j];
                }
    }
}

#endif
