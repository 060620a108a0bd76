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
    const int64_t d = work->d, D = work->D, F = work->F;
    for (int64_t j = 0; j < d; ++j) {
        double residual = mesh->measured[i * d + j] - states[j];
        if (model->correlated || model->drift) residual -= states[D + j];
        const double std = mesh->std[i * d + j], size = fabs(residual / std);
        if (isnan(size)) continue;
        const double weight = relative_weight(model, size) / (std * std);
        block[j * F + j] += weight;
        gradient[j * stride] -= residual * weight;
        if (!model->correlated) continue;
        block[(D + j) * F + D + j] += weight;
        block[(D + j) * F + j] += weight;
        block[j * F + D + j] += weight;
        gradient[(D + j) * stride] -= residual * weight;
    }
    for (int64_t l = 0; l < F - D; ++l) {
        const double anchor = mesh->anchors[i * work->w + l];
        block[(D + l) * F + D + l] += anchor;
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
    const int64_t F = work->F;
    double *at = work->blocks;
    return (Blocks){at,
                    at + F * F,
                    at + 2 * F * F,
                    at + 3 * F * F,
                    at + 4 * F * F,
                    at + 5 * F * F,
                    at + 5 * F * F + F,
                    at + 5 * F * F + 2 * F};
}

/* Fill one step's derivatives, precisions, and rows [drift | border | defect]; its segment began at that time. */
static void fill_step(const Workspace *work, const Mesh *mesh, const double *states, int64_t i, double begun,
                      double model_error, Blocks own) {
    const int64_t D = work->D, last = work->q + work->p, columns = last + 1;
    step_jacobians(work, mesh, i, own.start, own.end, own.rows + work->q, columns);
    if (work->q) drift_columns(work->model, mesh, i, begun, own.start, own.end, own.rows, columns);
    for (int64_t a = 0; a < D; ++a) {
        const double allowed = model_error * work->model->unit[a];
        own.precision[a] = 1 / (allowed * allowed) / walk(work, mesh, i, a);
        own.rows[a * columns + last] = defect(work, mesh, states, i, a);
    }
    for (int64_t l = 0; l < work->F - D; ++l) {
        own.precision[D + l] = 1;
        own.rows[(D + l) * columns + last] = latent_defect(work, mesh, states, i, l);
    }
}

/* Add the rows of defects, in units of their errors, and take those after elimination, when enough came together. */
static void add_rows(Workspace *work, const Blocks *own, int64_t *waiting, const double *border, int64_t point,
                     int64_t *taken, bool now) {
    const int64_t last = work->q + work->p, columns = last + 1, F = work->F;
    double *sums = work->q ? work->of_segment : work->of_mesh;
    if (own != NULL)
        for (int64_t a = 0; a < work->D; ++a, ++*waiting) {
            const double scale = sqrt(own->precision[a]);
            for (int64_t r = 0; r < columns; ++r)
                work->rows[*waiting * columns + r] = scale * own->rows[a * columns + r];
        }
    if (!now && *waiting < TOGETHER) return;
    add_products(sums, last, work->rows, *waiting, 1);
    add_products(sums, last, border + *taken * F * columns, (point + 1 - *taken) * F, -1);
    *waiting = 0;
    *taken = point + 1;
}

/* Eliminate the drift of a segment, given the latent processes at its first point, and add the rest to that of the mesh;
   `kept` are the rows of the drift. False if the matrix is not positive. */
static bool eliminate_drift(Workspace *work, const double *latent, double *kept) {
    const int64_t q = work->q, p = work->p, last = q + p, columns = last + 1;
    double *sums = work->of_segment;
    for (int64_t k = 0; k < q; ++k) {
        sums[k * columns + k] += 1;
        sums[last * columns + k] += (latent[k] - work->model->latent_mean[k]) / work->model->latent_std[k];
    }
    for (int64_t k = 0; k < q; ++k) {
        const double pivot = sums[k * columns + k];
        if (!(pivot > 0 && pivot < INFINITY)) return false;
        for (int64_t r = k; r <= last; ++r) kept[k * columns + r] = sums[r * columns + k];
        for (int64_t r = k + 1; r <= last; ++r)
            for (int64_t b = k + 1; b <= r && b < last; ++b)
                sums[r * columns + b] -= sums[r * columns + k] / pivot * sums[b * columns + k];
    }
    for (int64_t r = q; r <= last; ++r)
        for (int64_t b = q; b <= r && b < last; ++b)
            work->of_mesh[(r - q) * (p + 1) + b - q] += sums[r * columns + b];
    memset(sums, 0, sizeof(double) * (size_t)(columns * columns));
    return true;
}

INLINED bool eliminate_wide(Workspace *work, const Mesh *mesh, const double *states, double model_error, double lift,
                            int64_t first, const int64_t W) {
    const int64_t n = mesh->points, q = work->q, p = work->p, columns = q + p + 1;
    const size_t wide = sizeof(double) * (size_t)(W * columns), square = sizeof(double) * (size_t)(W * W);
    Blocks own = blocks_of(work);
    double *right = work->right, *next = work->next, *border = work->border + first * W * columns;
    int64_t waiting = 0, taken = 0, begins = 0;
    double begun = 0;
    memset(work->blocks, 0, 5 * square);
    memset(own.rows, 0, wide);
    memset(right, 0, wide);
    memset(work->of_mesh, 0, sizeof(double) * (size_t)((p + 1) * (p + 1)));
    memset(work->of_segment, 0, sizeof(double) * (size_t)(q ? columns * columns : 0));
    for (int64_t i = 0; i < n; ++i) {
        double *factor = work->factor + (first + i) * W * W, *beside = work->beside + (first + i) * W * W;
        const bool step = i + 1 < n && mesh->contiguous[i];
        begun = segment_start(mesh, i, begun);
        observe(work, mesh, states + i * work->W, i, own.block, right + q + p, columns);
        if (step) {
            fill_step(work, mesh, states, i, begun, model_error, own);
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
        add_rows(work, step ? &own : NULL, &waiting, border, i, &taken, i + 1 == n || (q && !step));
        if (!q || step) continue;
        const double *latent = states + begins * work->W + work->D;
        if (!eliminate_drift(work, latent, work->drift + (first + i) * q * columns)) return false;
        begins = i + 1;
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
    switch (work->F) {
    case 1: done = eliminate_wide(work, mesh, states, model_error, lift, first, 1); break;
    case 2: done = eliminate_wide(work, mesh, states, model_error, lift, first, 2); break;
    case 3: done = eliminate_wide(work, mesh, states, model_error, lift, first, 3); break;
    case 4: done = eliminate_wide(work, mesh, states, model_error, lift, first, 4); break;
    default: done = eliminate_wide(work, mesh, states, model_error, lift, first, work->F); break;
    }
    const int64_t wide = work->p + 1, columns = work->q + wide;
    if (!done || !finite(work->of_mesh, wide * wide)) return false;
    return finite(work->border + first * work->F * columns, mesh->points * work->F * columns);
}

/* Fill how the drift of a segment moves, in units of its standard deviations, when the coefficients move by `own`. */
static void follow_drift(const Workspace *work, const double *kept, const double *own, double *moved) {
    const int64_t q = work->q, p = work->p, columns = q + p + 1;
    for (int64_t k = q - 1; k >= 0; --k) {
        const double *row = kept + k * columns;
        double t = -row[q + p];
        for (int64_t r = 0; r < p; ++r) t -= row[q + r] * own[r];
        for (int64_t l = k + 1; l < q; ++l) t -= row[l] * moved[l];
        moved[k] = t / row[k];
    }
}

/* Turn how solutions plus drift move into how solutions and latent processes move. */
static void part_drift(const Workspace *work, const Mesh *mesh, double *direction) {
    const Model *model = work->model;
    const int64_t d = work->d, D = work->D, W = work->W;
    double begun = 0;
    for (int64_t i = 0; i < mesh->points; ++i) {
        begun = segment_start(mesh, i, begun);
        double *state = direction + i * W, *latent = state + D;
        for (int64_t j = 0; j < d; ++j) {
            latent[d + j] *= model->latent_std[d + j];
            latent[j] = latent[j] * model->latent_std[j] + (mesh->times[i] - begun) * latent[d + j];
            state[j] -= latent[j];
        }
        for (int64_t a = d; a < D; ++a) state[a] -= latent[d + model->second[a - d]];
    }
}

/* Fill how the states of a mesh move when the coefficients move by `own`. */
void follow(const Workspace *work, const Mesh *mesh, int64_t first, const double *own, double *direction) {
    const int64_t W = work->W, F = work->F, D = work->D, q = work->q, p = work->p, columns = q + p + 1;
    for (int64_t i = mesh->points - 1; i >= 0; --i) {
        const double *factor = work->factor + (first + i) * F * F, *beside = work->beside + (first + i) * F * F;
        const bool step = i + 1 < mesh->points && mesh->contiguous[i];
        double *moved = direction + i * W;
        if (q && step) memcpy(moved + D, moved + W + D, sizeof(double) * (size_t)q);
        if (q && !step) follow_drift(work, work->drift + (first + i) * q * columns, own, moved + D);
        for (int64_t a = 0; a < F; ++a) {
            const double *border = work->border + ((first + i) * F + a) * columns;
            double t = -border[q + p];
            for (int64_t k = 0; k < q; ++k) t -= border[k] * moved[D + k];
            for (int64_t r = 0; r < p; ++r) t -= border[q + r] * own[r];
            for (int64_t b = 0; step && b < F; ++b) t -= beside[a * F + b] * moved[W + b];
            moved[a] = t;
        }
        for (int64_t a = F - 1; a >= 0; --a) {
            for (int64_t c = a + 1; c < F; ++c) moved[a] -= factor[c * F + a] * moved[c];
            moved[a] /= factor[a * F + a];
        }
    }
    if (q) part_drift(work, mesh, direction);
}
