/* From Python to a loop and back: every loop takes the number of windows (or samples) n and arrays, writes to the last
   of these, and returns a number. Only the buffer protocol is used, so that one build fits every numpy. */

#ifndef MAGYC_ARGUMENTS_H
#define MAGYC_ARGUMENTS_H

#include "common.h"

#define MOST_ARRAYS 128

typedef struct {
    Py_buffer buffer[MOST_ARRAYS];
    double *at[MOST_ARRAYS]; /* NULL where the array is empty, which stands for None */
    int count, no_memory;
} Arrays;

typedef double (*Loop)(size n, Arrays *a);

static size entries(const Arrays *a, int i) { return a->buffer[i].len / (size)sizeof(double); }

static double *room(Arrays *a, size count)
{
    double *result = PyMem_RawMalloc(sizeof(double) * (size_t)count);
    a->no_memory = !result;
    return result;
}

static int take(Arrays *a, PyObject *array, int written)
{
    Py_buffer *b = &a->buffer[a->count];
    if (PyObject_GetBuffer(array, b, PyBUF_C_CONTIGUOUS | PyBUF_FORMAT | (written ? PyBUF_WRITABLE : 0)))
        return 0;
    a->at[a->count++] = b->len ? b->buf : NULL;
    if (b->itemsize % (size)sizeof(double)) {
        PyErr_SetString(PyExc_TypeError, "an array of a compiled loop is of no type of eight bytes");
        return 0;
    }
    return 1;
}

static PyObject *run(Loop loop, PyObject *const *args, size given, int arrays, int more, int written)
{
    Arrays a; /* not initialised, since it is large */
    a.count = a.no_memory = 0;
    double result = 0.0;
    if (given - 1 < arrays || given - 1 > (more ? MOST_ARRAYS : arrays)) {
        PyErr_Format(PyExc_TypeError, "%d arrays are expected, got %zd", arrays, given - 1);
        return NULL;
    }
    size n = PyLong_AsSsize_t(args[0]);
    int fit = !PyErr_Occurred();
    for (size i = 1; fit && i < given; i++)
        fit = take(&a, args[i], i >= given - written);
    if (fit) {
        Py_BEGIN_ALLOW_THREADS
        result = loop(n, &a);
        Py_END_ALLOW_THREADS
    }
    while (a.count)
        PyBuffer_Release(&a.buffer[--a.count]);
    if (a.no_memory)
        return PyErr_NoMemory();
    return fit ? PyFloat_FromDouble(result) : NULL;
}

/* Give Python a loop of this many arrays, or of others before them, of which the last are written to. */
#define AS_METHOD(loop, arrays, more, written)                                                                         \
    static PyObject *py_##loop(PyObject *self, PyObject *const *args, size given)                                      \
    {                                                                                                                  \
        return run(loop, args, given, arrays, more, written);                                                          \
    }
#define TO_PYTHON(loop, arrays, written) AS_METHOD(loop, arrays, 0, written)
#define TO_PYTHON_MANY(loop, arrays, written) AS_METHOD(loop, arrays, 1, written)
#define METHOD(loop) {#loop, (PyCFunction)(void (*)(void))py_##loop, METH_FASTCALL, NULL}

#endif
