/* The directions of a field chain at fixed θ: their equations, and a step. `directions.py` names the quantities. */

#ifndef MAGYC_SETTLING_H
#define MAGYC_SETTLING_H

#include "banded.h"
#include "directions.h"
#include "linearisation.h"

/* What the sphere adds to the diagonal of window t: −(residual + field) · residual, at least minus half the smaller
   eigenvalue of the Gauss–Newton matrix (one, mixed; mixed, other). */
static double of_sphere(in_t residual, in_t field, size n, double one, double mixed, double other)
{
    double apart = 0.5 * (one - other), smaller = 0.5 * (one + other) - sqrt(apart * apart + mixed * mixed), sum = 0.0;
    for (int i = 0; i < 3; i++)
        sum -= (residual[i * n] + field[i * n]) * residual[i * n];
    return fmax(sum, -0.5 * smaller);
}

/* The equations of the directions: `k` with the arrays of the directions, and the room that they need in its columns
   (3, n) for the residuals of the windows, links (3, n − 1) for those of the links, and border (2, n) for the gradient.
 */
WIDE_VECTORS static void direction_equations(const Chain *k)
{
    size n = k->n, m = n - 1;
    double *gradient = k->border, body[3 * STRETCH];
    memset(gradient, 0, sizeof(double) * 2 * (size_t)n);
    for (size first = 0; first < n; first += STRETCH) {
        size some = LEAST(STRETCH, n - first);
        double *residual = k->columns + first;
        directions_of_stretch(k, first, some, body, residual);
        for (int i = 0; i < 3; i++)
            for (size t = 0; t < some; t++)
                residual[i * n + t] -= k->field[i * n + first + t];
        onto_tangents(some, 1.0, k->on_direction + first, n, residual, n, gradient + first, n);
    }
    for (size first = 0; first < m; first += STRETCH) {
        size some = LEAST(STRETCH, m - first);
        links_of_stretch(k, first, some, body, k->links + first);
        onto_tangents(some, 1.0, k->before + first, m, k->links + first, m, gradient + first, n);
        onto_tangents(some, 1.0, k->after + first, m, k->links + first, m, gradient + first + 1, n);
    }
    band_of(k);
    for (size t = 0; t < n; t++) {
        double one = 0.0, mixed = 0.0, other = 0.0;
        for (int i = 0; i < 3; i++) {
            double x = k->on_direction[2 * i * n + t], y = k->on_direction[(2 * i + 1) * n + t];
            one += x * x;
            mixed += x * y;
            other += y * y;
        }
        double more = of_sphere(k->columns + t, k->field + t, n, one, mixed, other);
        k->band[8 * t] += more;
        k->band[8 * t + 4] += more;
    }
}

/* A step of the directions by their equations; returns its largest square, or minus the number of the row that has no
   factor. `room` holds 12 n numbers. */
static double step_of_directions(size n, in_t band, in_t gradient, in_t basis, in_t direction, double *room,
                                 double *moved)
{
    double *factor = room, *inverse = room + 8 * n, *pull = inverse + 2 * n, most = 0.0;
    size failed = factorise(2 * n, band, factor, inverse);
    if (failed)
        return -(double)failed;
    for (size t = 0; t < n; t++) { /* forward: L y = gradient */
        for (int a = 0; a < 2; a++) {
            size r = 2 * t + a;
            const double *f = factor + 4 * r;
            double x = gradient[a * n + t];
            x -= (r > 0 ? f[-3] * pull[r - 1] : 0.0) + (r > 1 ? f[-6] * pull[r - 2] : 0.0) +
                 (r > 2 ? f[-9] * pull[r - 3] : 0.0);
            pull[r] = x * inverse[r];
        }
    }
    back_and_moved(n, factor, inverse, basis, direction, pull, moved);
    for (size t = 0; t < 3 * n; t++) {
        double away = moved[t] - direction[t];
        most = away * away > most || isnan(away) ? away * away : most;
    }
    return most;
}

#endif
