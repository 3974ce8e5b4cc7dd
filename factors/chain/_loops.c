/* Inner loops of the field chain, for Python. Each has a version in numpy beside its caller, which gives the same
   numbers up to rounding and is used where no compiler was at hand (`compiled.py`). The callers guarantee the shapes. */

#include "c/arguments.h"
#include "c/banded.h"
#include "c/columns.h"
#include "c/directions.h"
#include "c/gyroscope.h"
#include "c/hashes.h"
#include "c/innovations.h"
#include "c/linearisation.h"
#include "c/moments.h"
#include "c/motion.h"
#include "c/play.h"
#include "c/products.h"
#include "c/rate_errors.h"
#include "c/settling.h"
#include "c/samples.h"
#include "c/spline.h"
#include "c/start.h"

/* factor, inverse, right (k, 2, n), solution (k, 2n) */
static double forward(size n, Arrays *a)
{
    solve_all(n, 0, a->at[0], a->at[1], a->at[2], entries(a, 3) / (2 * n), a->at[3]);
    return 0.0;
}
TO_PYTHON(forward, 4, 1)

/* factor, inverse, right (k, 2n), solution (k, 2, n) */
static double backward(size n, Arrays *a)
{
    solve_all(n, 1, a->at[0], a->at[1], a->at[2], entries(a, 3) / (2 * n), a->at[3]);
    return 0.0;
}
TO_PYTHON(backward, 4, 1)

/* matrix, swing, axes, rotation, turn, rotation_bias, rotation_rate, lever, scale, field, link_scale, answer,
   direction; basis, on_direction, before, after, columns, links, band, border */
static double linearise(size n, Arrays *a)
{
    double **at = a->at;
    Chain k = {n,     entries(a, 17) / (3 * n) - 1, at[0],  at[1],  at[2],  at[3],  at[4],  at[5],
               at[6], at[7],                        at[8],  at[9],  at[10], at[11], at[12], at[13],
               at[14], at[15],                      at[16], at[17], at[18], at[19], at[20]};
    for (size first = 0; first < n; first += STRETCH)
        of_stretch(&k, first, LEAST(STRETCH, n - first));
    for (size first = 0; first < n - 1; first += STRETCH)
        of_link_stretch(&k, first, LEAST(STRETCH, n - 1 - first));
    band_of(&k);
    return 0.0;
}
TO_PYTHON(linearise, 21, 8)

/* matrix, rotation, turn, field, hard iron (3,), direction; window (3, n), link (3, n − 1) */
static double residuals(size n, Arrays *a)
{
    double **at = a->at;
    plain_residuals(n, at[0], at[1], at[2], at[3], at[4], at[5], at[6], at[7]);
    return 0.0;
}
TO_PYTHON(residuals, 8, 2)

/* band, border, columns, links; factor, inverse, absorbed, products: the Cholesky factor of the band, the border
   absorbed (p + 1, 2n), and the products (p + 1, p + 1) of the columns and links less those of what is absorbed; they
   hold zeros before. Returns the residual's squared norm, or minus the number of the row that has no factor. */
static double eliminate(size n, Arrays *a)
{
    size p = entries(a, 2) / (3 * n), failed = factorise(2 * n, a->at[0], a->at[4], a->at[5]);
    double of_links[16] = {0}, *products = a->at[7];
    if (failed)
        return -(double)failed;
    solve_all(n, 0, a->at[4], a->at[5], a->at[1], p, a->at[6]);
    add_whole_gram(3 * n, 1.0, a->at[2], p, products);
    add_whole_gram(3 * (n - 1), 1.0, a->at[3], 4, of_links);
    for (size i = 0; i < 4; i++) /* of the bias, rows 9 to 11, and of the residual */
        for (size j = 0; j <= i; j++)
            products[(i < 3 ? 9 + i : p - 1) * p + (j < 3 ? 9 + j : p - 1)] += of_links[4 * i + j];
    double square = products[p * p - 1];
    add_whole_gram(2 * n, -1.0, a->at[6], p, products);
    for (size i = 0; i < p; i++)
        for (size j = 0; j < i; j++)
            products[j * p + i] = products[i * p + j];
    return square;
}
TO_PYTHON(eliminate, 8, 4)

/* factor, inverse, on_direction, columns (p, 3, n), half (p, 2n), covariance (p, p): returns `Reduced.absorbed` */
static double absorbed(size n, Arrays *a)
{
    size p = entries(a, 3) / (3 * n);
    double *solved = room(a, 5 * n * p + p * p), *across = solved + 2 * n * p, *gram = across + 3 * n * p;
    if (!solved)
        return 0.0;
    double sum = explained_by_directions(n, a->at[0], a->at[1], a->at[2]);
    solve_all(n, 1, a->at[0], a->at[1], a->at[4], p, solved);
    memcpy(across, a->at[3], sizeof(double) * (size_t)(3 * n * p));
    less_directions(n, p, a->at[2], solved, across);
    memset(gram, 0, sizeof(double) * (size_t)(p * p));
    add_whole_gram(3 * n, 1.0, across, p, gram);
    for (size i = 0; i < p; i++)
        for (size j = 0; j <= i; j++)
            sum += (i == j ? 1.0 : 2.0) * gram[i * p + j] * a->at[5][i * p + j];
    PyMem_RawFree(solved);
    return sum;
}
TO_PYTHON(absorbed, 6, 0)

/* factor, inverse, half (p + 1, 2n), step (p,), basis, direction; room (2n,), moved (3, n) */
static double move(size n, Arrays *a)
{
    step_directions(n, entries(a, 3), a->at[0], a->at[1], a->at[2], a->at[3], a->at[4], a->at[5], a->at[6], a->at[7]);
    return 0.0;
}
TO_PYTHON(move, 8, 2)

/* matrix, rotation, scale, field, turn, link_scale, answer, direction; basis, band, gradient */
static double directions(size n, Arrays *a)
{
    double **at = a->at, *work = room(a, 24 * n);
    if (!work)
        return 0.0;
    Chain k = {.n = n, .matrix = at[0], .rotation = at[1], .scale = at[2], .field = at[3], .turn = at[4],
               .link_scale = at[5], .answer = at[6], .direction = at[7], .basis = at[8], .band = at[9],
               .border = at[10], .on_direction = work, .before = work + 6 * n, .after = work + 12 * n,
               .columns = work + 18 * n, .links = work + 21 * n};
    direction_equations(&k);
    PyMem_RawFree(work);
    return 0.0;
}
TO_PYTHON(directions, 11, 3)

/* band, gradient, basis, direction; moved: returns the largest squared step, or minus the number of a row without
   factor */
static double step(size n, Arrays *a)
{
    double *work = room(a, 12 * n);
    if (!work)
        return 0.0;
    double most = step_of_directions(n, a->at[0], a->at[1], a->at[2], a->at[3], work, a->at[4]);
    PyMem_RawFree(work);
    return most;
}
TO_PYTHON(step, 5, 1)

/* rotation, rotation_bias, rotation_rate, change (4,) of the bias and of the delay; result */
static double rotate(size n, Arrays *a)
{
    moved_rotations(n, a->at[0], a->at[1], a->at[2], a->at[3], a->at[4]);
    return 0.0;
}
TO_PYTHON(rotate, 5, 1)

/* lever, change (3,); result */
static double turn(size n, Arrays *a)
{
    turns(n, a->at[0], a->at[1], a->at[2]);
    return 0.0;
}
TO_PYTHON(turn, 3, 1)

/* factor, inverse, on_direction, before, after, half (k, 2n); window (k, 3, n), link (k, 3, n − 1): rows, less what the
   directions explain of them by L⁻¹ of their products with these */
static double beside_directions(size n, Arrays *a)
{
    size k = entries(a, 5) / (2 * n);
    double *solved = room(a, 2 * n * k);
    if (!solved)
        return 0.0;
    solve_all(n, 1, a->at[0], a->at[1], a->at[5], k, solved);
    less_directions(n, k, a->at[2], solved, a->at[6]);
    less_linked(n, k, a->at[3], a->at[4], solved, a->at[7]);
    PyMem_RawFree(solved);
    return 0.0;
}
TO_PYTHON(beside_directions, 8, 2)

/* vector (3, n); p, q */
static double chain(size n, Arrays *a)
{
    chained(n, a->at[0], a->at[1], a->at[2]);
    return 0.0;
}
TO_PYTHON(chain, 3, 2)

/* p, q, step, start; lever */
static double lever(size n, Arrays *a)
{
    levers(n, a->at[0], a->at[1], a->at[2], a->at[3], a->at[4]);
    return 0.0;
}
TO_PYTHON(lever, 5, 1)

/* start (windows,) of int64, p, q, lever, rate; sums: of n samples */
static double sum_windows(size n, Arrays *a)
{
    window_sums(entries(a, 0), (const int64_t *)a->at[0], n, a->at[1], a->at[2], a->at[3], a->at[4], a->at[5]);
    return 0.0;
}
TO_PYTHON(sum_windows, 6, 1)

/* start (windows,) of int64, mean (windows,), time (n,), field (n, 3); field (3, windows), spread (windows,) */
static double average_samples(size n, Arrays *a)
{
    averages(entries(a, 0), (const int64_t *)a->at[0], n, a->at[1], a->at[2], a->at[3], a->at[4], a->at[5]);
    return 0.0;
}
TO_PYTHON(average_samples, 6, 2)

/* sums (27, n), count, spread (n,); rotation, rotation_bias, rotation_rate, lever */
static double window_motion(size n, Arrays *a)
{
    motion_of_windows(n, a->at[0], a->at[1], a->at[2], a->at[3], a->at[4], a->at[5], a->at[6]);
    return 0.0;
}
TO_PYTHON(window_motion, 7, 4)

static PyMethodDef methods[] = {
    METHOD(forward), METHOD(backward), METHOD(linearise), METHOD(eliminate),   METHOD(absorbed),
    METHOD(move),    METHOD(rotate),   METHOD(turn),      METHOD(whiten),      METHOD(score),
    METHOD(chain),   METHOD(lever),    METHOD(sum_windows), METHOD(spline_slopes),
    METHOD(directions), METHOD(step), METHOD(beside_directions),
    METHOD(cross_integrals), METHOD(follow), METHOD(stop), METHOD(innovations), METHOD(increments),
    METHOD(windows_passed), METHOD(average_moments), METHOD(propagate),
    METHOD(start_from), METHOD(start_left), METHOD(turn_rates), METHOD(align),
    METHOD(angles), METHOD(motion_at), METHOD(second_differences), METHOD(higher_differences),
    METHOD(stand_out), METHOD(alternate), METHOD(calm_blocks),
    METHOD(hash_cells), METHOD(hash_runs), METHOD(roughness), METHOD(window_motion), METHOD(residuals),
    METHOD(log_likelihoods), METHOD(look), METHOD(average_samples), METHOD(rate_errors), {NULL, NULL, 0, NULL},
};

static struct PyModuleDef module = {PyModuleDef_HEAD_INIT, "_loops", NULL, -1, methods, NULL, NULL, NULL, NULL};

PyMODINIT_FUNC PyInit__loops(void) { return PyModule_Create(&module); }
