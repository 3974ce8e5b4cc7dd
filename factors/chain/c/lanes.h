/* Columns side by side in lanes of vectors, and back: `some` columns of a tile go through a recursion together. */

#ifndef MAGYC_LANES_H
#define MAGYC_LANES_H

#include "common.h"

#if defined(__clang__) || (defined(__GNUC__) && __GNUC__ >= 12)
typedef double Four __attribute__((vector_size(32), aligned(8), may_alias));

/* Transpose four rows of four. */
#define TRANSPOSED(a, b, c, d, to)                                                                                     \
    do {                                                                                                               \
        Four even = __builtin_shufflevector(a, b, 0, 4, 2, 6), odd = __builtin_shufflevector(a, b, 1, 5, 3, 7);        \
        Four more = __builtin_shufflevector(c, d, 0, 4, 2, 6), rest = __builtin_shufflevector(c, d, 1, 5, 3, 7);       \
        to[0] = __builtin_shufflevector(even, more, 0, 1, 4, 5);                                                       \
        to[1] = __builtin_shufflevector(odd, rest, 0, 1, 4, 5);                                                        \
        to[2] = __builtin_shufflevector(even, more, 2, 3, 6, 7);                                                       \
        to[3] = __builtin_shufflevector(odd, rest, 2, 3, 6, 7);                                                        \
    } while (0)
#define FOUR_AT(x) (*(const Four *)(x))
#endif

/* lanes (count, some), whose rows are `row` apart, from columns of count entries that are `step` apart. */
WIDE_VECTORS static void into_lanes(size count, size some, in_t columns, size step, out_t lanes, size row)
{
    size done = 0;
#ifdef FOUR_AT
    for (; done + 4 <= some; done += 4) {
        const double *x = columns + done * step;
        size t = 0;
        for (; t + 4 <= count; t += 4) {
            Four to[4];
            TRANSPOSED(FOUR_AT(x + t), FOUR_AT(x + step + t), FOUR_AT(x + 2 * step + t), FOUR_AT(x + 3 * step + t), to);
            for (int i = 0; i < 4; i++)
                *(Four *)(lanes + (t + i) * row + done) = to[i];
        }
        for (; t < count; t++)
            for (int c = 0; c < 4; c++)
                lanes[t * row + done + c] = x[c * step + t];
    }
#endif
    for (; done < some; done++)
        for (size t = 0; t < count; t++)
            lanes[t * row + done] = columns[done * step + t];
}

/* The same the other way. */
WIDE_VECTORS static void from_lanes(size count, size some, in_t lanes, size row, out_t columns, size step)
{
    size done = 0;
#ifdef FOUR_AT
    for (; done + 4 <= some; done += 4) {
        double *y = columns + done * step;
        const double *x = lanes + done;
        size t = 0;
        for (; t + 4 <= count; t += 4) {
            Four to[4];
            TRANSPOSED(FOUR_AT(x + t * row), FOUR_AT(x + (t + 1) * row), FOUR_AT(x + (t + 2) * row),
                       FOUR_AT(x + (t + 3) * row), to);
            for (int i = 0; i < 4; i++)
                *(Four *)(y + i * step + t) = to[i];
        }
        for (; t < count; t++)
            for (int c = 0; c < 4; c++)
                y[c * step + t] = x[t * row + c];
    }
#endif
    for (; done < some; done++)
        for (size t = 0; t < count; t++)
            columns[done * step + t] = lanes[t * row + done];
}

#endif
