/* Orthogonal columns of few rows, and what they explain, as explained.py. */
#include "kernel.h"

#include <math.h>
#include <stdlib.h>

/* Turn some columns of rows, `stride` numbers apart, into orthonormal ones by the modified way of Gram and Schmidt (Bjorck
   1967), and take what they explain out of the others. The upper triangle (pivots x columns) is as good as that of
   reflections. */
static void sweep(double *rows, int64_t count, int64_t pivots, int64_t columns, int64_t stride, double *triangle) {
    for (int64_t k = 0; k < pivots; ++k) {
        double *restrict shares = triangle + k * columns, square = 0;
        for (int64_t b = 0; b < columns; ++b) shares[b] = 0;
        for (int64_t i = 0; i < count; ++i) square += rows[i * stride + k] * rows[i * stride + k];
        const double norm = sqrt(square), scale = norm > 0 ? 1 / norm : 0;
        for (int64_t i = 0; i < count; ++i) {
            double *restrict row = rows + i * stride;
            row[k] *= scale;
            for (int64_t b = k + 1; b < columns; ++b) shares[b] += row[k] * row[b];
        }
        for (int64_t i = 0; i < count; ++i) {
            double *restrict row = rows + i * stride;
            for (int64_t b = k + 1; b < columns; ++b) row[b] -= row[k] * shares[b];
        }
        shares[k] = norm;
    }
}

/* Turn all columns into orthonormal ones and their upper triangle. */
void orthogonalize(double *rows, int64_t count, int64_t columns, int64_t stride, double *triangle) {
    sweep(rows, count, columns, columns, stride, triangle);
}

/* Fill what each column of several objects' factors (objects x rows x columns, the last one the target) explains of the
   squares that the columns inside leave, and last these squares themselves. Of columns that have less than a share `near` of
   their squares left it is nothing, or all if that is `bound`. */
EXPORTED int commonlaw_explained(int64_t objects, int64_t rows, int64_t columns, const double *factors, int64_t count,
                                 const int64_t *inside, double near, int64_t bound, double *out) {
    const size_t numbers = (size_t)(rows * columns + count * columns + 3 * columns);
    double *work = malloc(sizeof(double) * numbers + sizeof(int64_t) * (size_t)columns);
    if (!work) return NO_MEMORY;
    double *triangle = work + rows * columns, *before = triangle + count * columns, *after = before + columns;
    double *inner = after + columns;
    int64_t *order = (int64_t *)(inner + columns);
    for (int64_t b = 0; b < columns; ++b) out[b] = 0;
    for (int64_t k = 0; k < count; ++k) order[k] = inside[k], out[inside[k]] = 1;
    for (int64_t b = 0, next = count; b < columns; ++b)
        if (out[b] == 0) order[next++] = b;
    for (int64_t b = 0; b < columns; ++b) out[b] = 0;
    for (int64_t o = 0; o < objects; ++o, factors += rows * columns) {
        for (int64_t b = 0; b < columns; ++b) before[b] = after[b] = inner[b] = 0;
        for (int64_t i = 0; i < rows; ++i)
            for (int64_t b = 0; b < columns; ++b) {
                const double value = factors[i * columns + order[b]];
                work[i * columns + b] = value;
                before[b] += value * value;
            }
        sweep(work, rows, count, columns, columns, triangle);
        for (int64_t i = 0; i < rows; ++i) {
            const double *row = work + i * columns, target = row[columns - 1];
            for (int64_t b = count; b < columns; ++b) {
                after[b] += row[b] * row[b];
                inner[b] += row[b] * target;
            }
        }
        const double left = after[columns - 1];
        for (int64_t b = count; b + 1 < columns; ++b)
            out[order[b]] += after[b] > near * before[b] ? inner[b] * inner[b] / after[b] : bound ? left : 0;
        for (int64_t b = 0; bound && b < count; ++b) out[order[b]] += left;
        out[columns - 1] += left;
    }
    free(work);
    return DONE;
}
