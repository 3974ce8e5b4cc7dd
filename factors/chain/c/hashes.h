/* The hashes of a fingerprint (`recording/fingerprint.py`). */

#ifndef MAGYC_HASHES_H
#define MAGYC_HASHES_H

#include "arguments.h"

static inline uint64_t mixed(uint64_t total, uint64_t part, uint64_t factor)
{
    uint64_t own = (part ^ (part >> 32)) * factor;
    return (total ^ (total >> 29)) * factor + (own ^ (own >> 31));
}

WIDE_VECTORS static void cells_of(size n, in_t value, double width, const uint64_t *factor, uint64_t *cells)
{
    for (size t = 0; t < n; t++) {
        uint64_t total = 0;
        for (int i = 0; i < 3; i++)
            total = mixed(total, (uint64_t)(int64_t)rint(value[3 * t + i] / width), factor[i]);
        cells[t] = total ^ (total >> 32);
    }
}

/* value (n, 3), cell (1,), factors (3,) of uint64; cells (n,) of uint64: `fingerprint._cells` */
static double hash_cells(size n, Arrays *a)
{
    cells_of(n, a->at[0], a->at[1][0], (const uint64_t *)a->at[2], (uint64_t *)a->at[3]);
    return 0.0;
}
TO_PYTHON(hash_cells, 4, 1)

/* again (n,): whether a cell is one of those 2 to `back` before it. */
WIDE_VECTORS static void returns_to(size n, size back, const uint64_t *cell, uint64_t *again)
{
    memset(again, 0, sizeof(uint64_t) * (size_t)n);
    for (size k = 2; k <= back; k++)
        for (size t = back; t < n; t++)
            again[t] |= cell[t] == cell[t - k];
}

/* Put a value among the `kept` smallest different ones, ascending, at most so many; returns how many are kept now. */
static inline size put_in_order(uint64_t value, uint64_t *smallest, size kept, size most)
{
    size place = kept;
    while (place > 0 && smallest[place - 1] > value)
        place--;
    if (place == most || (place > 0 && smallest[place - 1] == value))
        return kept;
    size now = LEAST(kept + 1, most);
    memmove(smallest + place + 1, smallest + place, sizeof(uint64_t) * (size_t)(now - 1 - place));
    smallest[place] = value;
    return now;
}

/* cells (n,) of uint64, factors (3,) of uint64, rules (4,): run, back, most and bits; hashes (few,) of uint64: the
   smallest different ones, ascending, as `fingerprint._smallest`. Returns their number. */
static double hash_runs(size n, Arrays *a)
{
    const uint64_t *cell = (const uint64_t *)a->at[0], factor = *(const uint64_t *)a->at[1];
    size run = (size)a->at[2][0], back = (size)a->at[2][1], kept = 0, returned = 0;
    size few = entries(a, 3);
    uint64_t *hash = (uint64_t *)a->at[3], total = 0, power = 1;
    int bits = (int)a->at[2][3];
    double *work = room(a, n);
    if (!work)
        return 0.0;
    uint64_t *again = (uint64_t *)work;
    returns_to(n, back, cell, again);
    for (size k = 0; k < run; k++)
        power *= factor;
    for (size t = n - 1; t >= back; t--) { /* of cells t to t + run − 1, as far as there are so many */
        total = cell[t] + factor * total;
        returned += (size)again[t];
        if (t + run < n) {
            total -= power * cell[t + run];
            returned -= (size)again[t + run];
        }
        if (t + run <= n && returned <= (size)a->at[2][2]) {
            uint64_t whole = mixed(0, total, factor);
            kept = put_in_order((whole ^ (whole >> 32)) >> (64 - bits), hash, kept, few);
        }
    }
    PyMem_RawFree(work);
    return (double)kept;
}
TO_PYTHON(hash_runs, 4, 1)

#endif
