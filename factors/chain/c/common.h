/* What all inner loops share. Arrays are float64 and C-contiguous, with the windows along the last axis. */

#ifndef MAGYC_COMMON_H
#define MAGYC_COMMON_H

#define PY_SSIZE_T_CLEAN
#include <Python.h>
#include <math.h>
#include <stdint.h>
#include <string.h>

#if defined(__x86_64__) && defined(__GLIBC__) && __GNUC__ >= 12 && !defined(__clang__)
#define WIDE_VECTORS __attribute__((target_clones("arch=x86-64-v3", "default"))) /* chosen when the library is loaded */
#else
#define WIDE_VECTORS
#endif
#if defined(_MSC_VER)
#define restrict __restrict
#define ALWAYS_INLINE static __forceinline
#else
#define ALWAYS_INLINE static inline __attribute__((always_inline))
#endif

typedef Py_ssize_t size;
typedef double *restrict out_t;
typedef const double *restrict in_t;

#define TOGETHER 16 /* columns that are solved together: the latency of one hides behind the others */
#define STRETCH 128 /* windows at a time, whose products stay in the first cache */
#define LEAST(a, b) ((a) < (b) ? (a) : (b))

#endif
