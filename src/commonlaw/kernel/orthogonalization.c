/* Orthogonal columns of few rows. */
#include "kernel.h"

#include <math.h>

/* Turn columns of rows, `stride` numbers apart, into orthonormal ones by the modified way of Gram and Schmidt (Bjorck 1967).
   The upper triangle (columns x columns) is as good as that of reflections. */
void orthogonalize(double *rows, int64_t count, int64_t columns, int64_t stride, double *triangle) {
    for (int64_t k = 0; k < columns; ++k) {
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
