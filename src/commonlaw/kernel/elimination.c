/* One Gauss-Newton step: the states are eliminated point by point, as in normal_equations.py.

   The matrix of the states is block tridiagonal. Its factor has lower triangles on the diagonal (`factor`) and blocks
   beside it (`beside`); `border` holds what is left of the coefficients' columns and of the gradient, after the factor.
   Both information and gradient are sums over points of what was added less what was taken by elimination. */
#include "kernel.h"

#include <math.h>
#include <string.h>

/* Add (or with a minus sign take) the products of the columns of some rows, width p + 1, to a lower triangle. */
static void add_products(double *restrict matrix, int64_t p, const double *restrict rows, int64_t count, double sign) {
    const int64_t wide = p + 1;
    for (int64_t r = 0; r < wide; ++r) {
        double *restrict sums = matrix + r * wide;
        const int64_t stop = r < p ? r + 1 : p; /* The product of the gradient with itself is not needed */
        for (int64_t each = 0; each < count; ++each) {
            const double *restrict row = rows + each * wide;
            const double x = sign * row[r];
            for (int64_t b = 0; b < stop; ++b) sums[b] += x * row[b];
        }
    }
}

/* Add what the measurements and stationary latent processes say of one point. */
static void observe(const Workspace *work, const Mesh *mesh, const double *states, int64_t i, double *block,
                    double *gradient, int64_t stride) {
    const Model *model = work->model;
    const int64_t d = work->d, D = work->D, W = work->W;
    for (int64_t j = 0; j < d; ++j) {
        double residual = mesh->measured[i * d + j] - states[j];
        if (model->correlated) residual -= states[D + j];
        const double std = mesh->std[i * d + j], size = fabs(residual / std);
        if (isnan(size)) continue;
        const double weight = relative_weight(model, size) / (std * std);
        block[j * W + j] += weight;
        gradient[j * stride] -= residual * weight;
        if (!model->correlated) continue;
        block[(D + j) * W + D + j] += weight;
        block[(D + j) * W + j] += weight;
        block[j * W + D + j] += weight;
        gradient[(D + j) * stride] -= residual * weight;
    }
    for (int64_t l = 0; l < work->w; ++l) {
        const double anchor = mesh->anchors[i * work->w + l];
        block[(D + l) * W + D + l] += anchor;
        gradient[(D + l) * stride] += anchor * states[D + l];
    }
}

/* Factor one block, less what was taken of it, in `factor`; false if it is not positive. */
INLINED bool factorize(const double *restrict block, const double *restrict taken, double lift,
                       double *restrict factor, double *restrict inverse, const int64_t W) {
    for (int64_t a = 0; a < W; ++a)
        for (int64_t b = 0; b <= a; ++b) {
            double t = (a == b ? block[a * W + b] * (1 + lift) : block[a * W + b]) - taken[a * W + b];
            for (int64_t c = 0; c < b; ++c) t -= factor[a * W + c] * factor[b * W + c];
            if (a == b) {
                if (!(t > 0 && t < INFINITY)) return false;
                factor[a * W + a] = sqrt(t);
                inverse[a] = 1 / factor[a * W + a];
            } else {
                factor[a * W + b] = t * inverse[b];
            }
        }
    return true;
}

/* Solve with the factor, in place: W rows of so many columns. */
INLINED void forward(const double *restrict factor, const double *restrict inverse, double *restrict rows,
                     int64_t columns, const int64_t W) {
    for (int64_t a = 0; a < W; ++a) {
        double *restrict own = rows + a * columns;
        for (int64_t c = 0; c < a; ++c) {
            const double x = factor[a * W + c], *restrict before = rows + c * columns;
            for (int64_t r = 0; r < columns; ++r) own[r] -= x * before[r];
        }
        for (int64_t r = 0; r < columns; ++r) own[r] *= inverse[a];
    }
}

/* Add one step's defects: to the block of its start, beside it, to that of its end, and to both right-hand sides. */
INLINED void add_step(const double *restrict start, const double *restrict end, const double *restrict precision,
                      const double *restrict rows, double *restrict block, double *restrict beside,
                      double *restrict following, double *restrict right, double *restrict next, int64_t columns,
                      const int64_t W) {
    for (int64_t a = 0; a < W; ++a) {
        double *restrict own = right + a * columns, *restrict after = next + a * columns;
        for (int64_t r = 0; r < columns; ++r) after[r] = 0;
        for (int64_t b = 0; b < W; ++b) {
            double by_start = 0, across = 0, by_end = 0;
            for (int64_t c = 0; c < W; ++c) {
                by_start += start[c * W + a] * precision[c] * start[c * W + b];
                across += start[c * W + a] * precision[c] * end[c * W + b];
                by_end += end[c * W + a] * precision[c] * end[c * W + b];
            }
            block[a * W + b] += by_start;
            beside[a * W + b] = across;
            following[a * W + b] = by_end;
        }
        for (int64_t c = 0; c < W; ++c) {
            const double x = start[c * W + a] * precision[c], y = end[c * W + a] * precision[c];
            const double *restrict row = rows + c * columns;
            for (int64_t r = 0; r < columns; ++r) {
                own[r] += x * row[r];
                after[r] += y * row[r];
            }
        }
    }
}

/* Take from the next block and its right-hand side what the factor says. */
INLINED void take_on(const double *restrict beside, const double *restrict border, double *restrict taken,
                     double *restrict right, int64_t columns, const int64_t W) {
    for (int64_t a = 0; a < W; ++a) {
        for (int64_t b = 0; b < W; ++b) {
            double t = 0;
            for (int64_t c = 0; c < W; ++c) t += beside[c * W + a] * beside[c * W + b];
            taken[a * W + b] = t;
        }
        double *restrict own = right + a * columns;
        for (int64_t c = 0; c < W; ++c) {
            const double x = beside[c * W + a], *restrict row = border + c * columns;
            for (int64_t r = 0; r < columns; ++r) own[r] -= x * row[r];
        }
    }
}

typedef struct {
    double *start, *end, *block, *following, *taken, *precision, *inverse, *rows;
} Blocks;

static Blocks blocks_of(const Workspace *work) {
    const int64_t W = work->W;
    double *at = work->blocks;
    return (Blocks){at,
                    at + W * W,
                    at + 2 * W * W,
                    at + 3 * W * W,
                    at + 4 * W * W,
                    at + 5 * W * W,
                    at + 5 * W * W + W,
                    at + 5 * W * W + 2 * W};
}

/* Fill one step's derivatives, precisions, and rows [border | defect]. */
static void fill_step(const Workspace *work, const Mesh *mesh, const double *states, int64_t i, double model_error,
                      Blocks own) {
    const int64_t D = work->D, columns = work->p + 1;
    step_jacobians(work, mesh, i, own.start, own.end, own.rows, columns);
    for (int64_t a = 0; a < D; ++a) {
        const double allowed = model_error * work->model->unit[a];
        own.precision[a] = 1 / (allowed * allowed) / walk(work, mesh, i, a);
        own.rows[a * columns + work->p] = defect(work, mesh, states, i, a);
    }
    for (int64_t l = 0; l < work->w; ++l) {
        own.precision[D + l] = 1;
        own.rows[(D + l) * columns + work->p] = latent_defect(work, mesh, states, i, l);
    }
}

/* Add the rows of defects, in units of their errors, and take those after elimination, when enough came together. */
static void add_rows(Workspace *work, const Blocks *own, int64_t *waiting, const double *border, int64_t point,
                     int64_t *taken, bool now) {
    const int64_t columns = work->p + 1, W = work->W;
    if (own != NULL)
        for (int64_t a = 0; a < work->D; ++a, ++*waiting) {
            const double scale = sqrt(own->precision[a]);
            for (int64_t r = 0; r < columns; ++r)
                work->rows[*waiting * columns + r] = scale * own->rows[a * columns + r];
        }
    if (!now && *waiting < TOGETHER) return;
    add_products(work->of_mesh, work->p, work->rows, *waiting, 1);
    add_products(work->of_mesh, work->p, border + *taken * W * columns, (point + 1 - *taken) * W, -1);
    *waiting = 0;
    *taken = point + 1;
}

INLINED bool eliminate_wide(Workspace *work, const Mesh *mesh, const double *states, double model_error, double lift,
                            int64_t first, const int64_t W) {
    const int64_t n = mesh->points, columns = work->p + 1;
    const size_t wide = sizeof(double) * (size_t)(W * columns), square = sizeof(double) * (size_t)(W * W);
    Blocks own = blocks_of(work);
    double *right = work->right, *next = work->next, *border = work->border + first * W * columns;
    int64_t waiting = 0, taken = 0;
    memset(work->blocks, 0, 5 * square);
    memset(own.rows, 0, wide);
    memset(right, 0, wide);
    memset(work->of_mesh, 0, sizeof(double) * (size_t)(columns * columns));
    for (int64_t i = 0; i < n; ++i) {
        double *factor = work->factor + (first + i) * W * W, *beside = work->beside + (first + i) * W * W;
        const bool step = i + 1 < n && mesh->contiguous[i];
        observe(work, mesh, states + i * W, i, own.block, right + work->p, columns);
        if (step) {
            fill_step(work, mesh, states, i, model_error, own);
            add_step(own.start, own.end, own.precision, own.rows, own.block, beside, own.following, right, next,
                     columns, W);
        }
        if (!factorize(own.block, own.taken, lift, factor, own.inverse, W)) return false;
        memcpy(border + i * W * columns, right, wide);
        forward(factor, own.inverse, border + i * W * columns, columns, W);
        if (step) {
            forward(factor, own.inverse, beside, W, W);
            double *spare = right;
            right = next;
            next = spare;
            take_on(beside, border + i * W * columns, own.taken, right, columns, W);
            memcpy(own.block, own.following, square);
        } else {
            memset(beside, 0, square);
            memset(own.block, 0, square);
            memset(own.taken, 0, square);
            memset(right, 0, wide);
        }
        add_rows(work, step ? &own : NULL, &waiting, border, i, &taken, i + 1 == n);
    }
    return true;
}

static bool finite(const double *values, int64_t count) {
    double total = 0; /* Of zeros, unless something is not finite */
    for (int64_t i = 0; i < count; ++i) total += values[i] * 0;
    return total == 0;
}

/* Eliminate the states of a mesh whose law was evaluated; its first point is at that place among those of all meshes.
   Returns whether numbers are finite and the factorisation succeeded. */
bool eliminate(Workspace *work, const Mesh *mesh, const double *states, double model_error, double lift,
               int64_t first) {
    bool done;
    switch (work->W) {
    case 1: done = eliminate_wide(work, mesh, states, model_error, lift, first, 1); break;
    case 2: done = eliminate_wide(work, mesh, states, model_error, lift, first, 2); break;
    case 3: done = eliminate_wide(work, mesh, states, model_error, lift, first, 3); break;
    case 4: done = eliminate_wide(work, mesh, states, model_error, lift, first, 4); break;
    default: done = eliminate_wide(work, mesh, states, model_error, lift, first, work->W); break;
    }
    const int64_t columns = work->p + 1;
    if (!done || !finite(work->of_mesh, columns * columns)) return false;
    return finite(work->border + first * work->W * columns, mesh->points * work->W * columns);
}

/* Fill how the states of a mesh move when the coefficients move by `own`. */
void follow(const Workspace *work, int64_t points, int64_t first, const double *own, double *direction) {
    const int64_t W = work->W, columns = work->p + 1;
    for (int64_t i = points - 1; i >= 0; --i) {
        const double *factor = work->factor + (first + i) * W * W, *beside = work->beside + (first + i) * W * W;
        double *step = direction + i * W;
        for (int64_t a = 0; a < W; ++a) {
            const double *border = work->border + ((first + i) * W + a) * columns;
            double t = -border[work->p];
            for (int64_t r = 0; r < work->p; ++r) t -= border[r] * own[r];
            for (int64_t b = 0; i + 1 < points && b < W; ++b) t -= beside[a * W + b] * step[W + b];
            step[a] = t;
        }
        for (int64_t a = W - 1; a >= 0; --a) {
            for (int64_t c = a + 1; c < W; ++c) step[a] -= factor[c * W + a] * step[c];
            step[a] /= factor[a * W + a];
        }
    }
}
