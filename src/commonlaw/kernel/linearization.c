/* The likelihood about an estimate as rows of unit covariance, as in linearization.py. */
#include "kernel.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

/* Fill the defects of all steps (n - 1 x W) and their derivatives, as collocation.py's jacobians. */
EXPORTED int commonlaw_jacobians(const Model *model, const Mesh *mesh, const uint8_t *free_ones, const double *states,
                                 const double *coefficients, double *defects, double *start, double *end,
                                 double *border) {
    Workspace work;
    void *memory = NULL;
    if (!open_workspace(&work, model, free_ones, coefficients, mesh->points, 1, &memory)) return NO_MEMORY;
    const int64_t F = work.F, D = work.D, p = work.p, steps = mesh->points - 1;
    collocate(&work, mesh, states, coefficients, true);
    memset(defects, 0, sizeof(double) * (size_t)(steps * F));
    memset(start, 0, sizeof(double) * (size_t)(steps * F * F));
    memset(end, 0, sizeof(double) * (size_t)(steps * F * F));
    memset(border, 0, sizeof(double) * (size_t)(steps * F * p));
    for (int64_t i = 0; i < steps; ++i) {
        if (!mesh->contiguous[i]) continue;
        step_jacobians(&work, mesh, i, start + i * F * F, end + i * F * F, border + i * F * p, p);
        for (int64_t a = 0; a < D; ++a) defects[i * F + a] = defect(&work, mesh, states, i, a);
        for (int64_t l = 0; l < F - D; ++l) defects[i * F + D + l] = latent_defect(&work, mesh, states, i, l);
    }
    free(memory);
    return DONE;
}

/* Fill how the states at the wanted points change with the first state of their segment and with the free coefficients,
   D x (D + p) of each. */
EXPORTED int commonlaw_sensitivities(const Model *model, const Mesh *mesh, const uint8_t *free_ones,
                                     const double *states, const double *coefficients, const uint8_t *wanted,
                                     double *out) {
    Workspace work;
    void *memory = NULL;
    if (!open_workspace(&work, model, free_ones, coefficients, mesh->points, 1, &memory)) return NO_MEMORY;
    const int64_t D = work.D, p = work.p, columns = D + p, size = D * columns;
    double *now = malloc(sizeof(double) * (size_t)(2 * D * D + D * p + 2 * size));
    if (!now) {
        free(memory);
        return NO_MEMORY;
    }
    double *next = now + size, *start = next + size, *end = start + D * D, *border = end + D * D;
    collocate(&work, mesh, states, coefficients, true);
    for (int64_t i = 0; i < mesh->points; ++i) {
        if (i > 0 && mesh->contiguous[i - 1]) {
            law_jacobians(&work, mesh, i - 1, start, end, border, p);
            for (int64_t a = 0; a < D; ++a) {
                double *restrict row = next + a * columns;
                for (int64_t r = 0; r < columns; ++r) row[r] = r < D ? 0 : -border[a * p + r - D];
                for (int64_t b = 0; b < D; ++b)
                    for (int64_t r = 0; r < columns; ++r) row[r] -= start[a * D + b] * now[b * columns + r];
            }
            if (!solve_columns(end, D, next, columns))
                for (int64_t r = 0; r < size; ++r) next[r] = NAN;
            double *before = now;
            now = next;
            next = before;
        } else {
            memset(now, 0, sizeof(double) * (size_t)size);
            for (int64_t a = 0; a < D; ++a) now[a * columns + a] = 1;
        }
        if (!wanted[i]) continue;
        memcpy(out, now, sizeof(double) * (size_t)size);
        out += size;
    }
    free(now < next ? now : next);
    free(memory);
    return DONE;
}

/* How large the standard deviations of what was not measured are, in its units, see linearization.py. */
typedef struct {
    double missing, rate, hidden;
} Vagueness;

/* Variances of states and latent processes that were not measured, their logarithms at the ends of steps, and of first
   points those of their ratios to the prior variances of initial states; W each. */
typedef struct {
    double *variances, *logs, *ratios;
} Vague;

/* Fill them. */
static void fill_vague(const Model *model, const Mesh *mesh, Vagueness beyond, Vague vague) {
    const int64_t d = model->equations, D = d + model->rates, W = D + model->latent;
    const double rate = beyond.rate / mesh->typical_step, step = model->walks ? mesh->typical_step : 1;
    const double span = model->walks ? (double)mesh->points * step : 1; /* After which Wiener processes are vague */
    memset(vague.ratios, 0, sizeof(double) * (size_t)W);
    for (int64_t j = 0; j < d; ++j) {
        double variance = 0;
        for (int64_t i = 0; i < mesh->points; ++i) variance += mesh->std[i * d + j] * mesh->std[i * d + j];
        variance /= (double)mesh->points;
        const double correlated = model->correlated ? model->latent_std[j] : 0;
        const double error = beyond.hidden * correlated * sqrt(span);
        variance += correlated * correlated * step;
        const double prior = beyond.missing * beyond.missing * variance, prior_of_rate = rate * rate * variance;
        const int64_t a = model->highest[j];
        vague.variances[j] = prior + error * error;
        vague.ratios[j] = log(vague.variances[j] / prior);
        if (a == j) continue;
        vague.variances[a] = prior_of_rate + error * error / (mesh->typical_step * mesh->typical_step);
        vague.ratios[a] = log(vague.variances[a] / prior_of_rate);
    }
    for (int64_t l = 0; l < model->latent; ++l) {
        const double std = beyond.hidden * model->latent_std[l];
        vague.variances[D + l] = std * std * (model->correlated && l < d ? span : 1);
    }
    for (int64_t a = 0; a < W; ++a) vague.logs[a] = log(vague.variances[a]);
}

/* Fill what is known of one point: the covariance of its states and latent processes, F x F, and their centre less the
   estimate; with a drift these are of solutions plus drift, less estimated solutions. Returns the sum of the logarithms of variances of what was not measured, or at first points of ratios. */
static double measured_at(const Model *model, const Mesh *mesh, Vague vague, int64_t i, const double *states,
                          double *covariance, double *offset) {
    const int64_t d = model->equations, D = d + model->rates, w = model->latent, W = model->drift ? D : D + w;
    const double *logs = i > 0 && mesh->contiguous[i - 1] ? vague.logs : vague.ratios;
    double unmeasured = 0;
    memset(covariance, 0, sizeof(double) * (size_t)(W * W));
    for (int64_t a = 0; a < W; ++a) {
        const double anchor = a >= D ? mesh->anchors[i * w + a - D] : 0;
        covariance[a * W + a] = anchor > 0 ? 1 / anchor : vague.variances[a];
        offset[a] = a >= D ? -states[a] : 0;
        if (model->drift) offset[a] = states[D + (a < d ? a : d + model->second[a - d])];
    }
    for (int64_t a = d; a < W; ++a) unmeasured += logs[a];
    for (int64_t j = 0; j < d; ++j) {
        const double std = mesh->std[i * d + j], difference = mesh->measured[i * d + j] - states[j];
        const bool shifted = model->correlated || model->drift;
        const double size = fabs((shifted ? difference - states[D + j] : difference) / std);
        const double weight = isnan(size) ? 0 : relative_weight(model, size) / (std * std);
        if (isfinite(mesh->measured[i * d + j])) offset[j] = difference;
        if (!(weight > 0)) {
            unmeasured += logs[j];
            continue;
        }
        covariance[j * W + j] = 1 / weight;
        if (!model->correlated) continue; /* The less an error is, the more the state */
        const double shared = covariance[(D + j) * W + D + j];
        covariance[j * W + j] += shared;
        covariance[j * W + D + j] = covariance[(D + j) * W + j] = -shared;
    }
    return unmeasured;
}

/* Fill left times a symmetric matrix; all W x W. */
static void times(const double *restrict left, const double *restrict matrix, double *restrict out, int64_t W) {
    for (int64_t a = 0; a < W; ++a)
        for (int64_t b = 0; b < W; ++b) {
            double t = 0;
            for (int64_t c = 0; c < W; ++c) t += left[a * W + c] * matrix[c * W + b];
            out[a * W + b] = t;
        }
}

/* Add left times the transpose of right. */
static void add_times_transposed(const double *restrict left, const double *restrict right, double *restrict sum,
                                 double sign, int64_t W) {
    for (int64_t a = 0; a < W; ++a)
        for (int64_t b = 0; b < W; ++b) {
            double t = 0;
            for (int64_t c = 0; c < W; ++c) t += left[a * W + c] * right[b * W + c];
            sum[a * W + b] += sign * t;
        }
}

/* The logarithm of the size of the determinant of a matrix, which is lost. */
static double log_determinant(double *matrix, int64_t W) {
    double total = 0;
    if (!solve_columns(matrix, W, NULL, 0)) return -INFINITY;
    for (int64_t c = 0; c < W; ++c) total += log(fabs(matrix[c * W + c]));
    return total;
}

/* Factor a block in place and divide rows by it; adds the logarithm of its determinant. */
static bool divide(double *block, double *rows, int64_t columns, int64_t W, double *total) {
    for (int64_t a = 0; a < W; ++a) {
        for (int64_t b = 0; b <= a; ++b) {
            double t = block[a * W + b];
            for (int64_t c = 0; c < b; ++c) t -= block[a * W + c] * block[b * W + c];
            if (a == b && !(t > 0 && t < INFINITY)) return false;
            block[a * W + b] = a == b ? sqrt(t) : t / block[b * W + b];
        }
        *total += 2 * log(block[a * W + a]);
        double *restrict own = rows + a * columns;
        for (int64_t c = 0; c < a; ++c)
            for (int64_t r = 0; r < columns; ++r) own[r] -= block[a * W + c] * rows[c * columns + r];
        for (int64_t r = 0; r < columns; ++r) own[r] /= block[a * W + a];
    }
    return true;
}

typedef struct {
    double *before, *after, *block, *beside, *by_start, *by_end, *offset, *next;
} Parts;

/* Fill the covariance of one step's defects and that with the step before; the first is not linked to any. */
static void covariance_of(const Workspace *work, const Mesh *mesh, int64_t i, const double *start, const double *end,
                          double model_error, Parts own) {
    const int64_t W = work->F, D = work->D;
    times(start, own.before, own.by_start, W);
    memset(own.beside, 0, sizeof(double) * (size_t)(W * W));
    if (i > 0) add_times_transposed(own.by_start, end - W * W, own.beside, 1, W);
    times(end, own.after, own.by_end, W);
    memset(own.block, 0, sizeof(double) * (size_t)(W * W));
    add_times_transposed(own.by_start, start, own.block, 1, W);
    add_times_transposed(own.by_end, end, own.block, 1, W);
    for (int64_t a = 0; a < W; ++a) {
        const double allowed = a < D ? model_error * work->model->unit[a] : 1;
        const double variance = a < D ? allowed * allowed * walk(work, mesh, i, a) : 1;
        own.block[a * W + a] += mesh->contiguous[i] ? variance : 1;
    }
}

/* Divide the link to the step before by that one's factor, from the right, and take what it explains. */
static void take_before(const double *factor, Parts own, const double *rows_before, double *rows, int64_t columns,
                        int64_t W) {
    double *link = own.beside;
    for (int64_t a = 0; a < W; ++a)
        for (int64_t b = 0; b < W; ++b) {
            for (int64_t c = 0; c < b; ++c) link[a * W + b] -= link[a * W + c] * factor[b * W + c];
            link[a * W + b] /= factor[b * W + b];
        }
    add_times_transposed(link, link, own.block, -1, W);
    for (int64_t a = 0; a < W; ++a)
        for (int64_t c = 0; c < W; ++c)
            for (int64_t r = 0; r < columns; ++r)
                rows[a * columns + r] -= link[a * W + c] * rows_before[c * columns + r];
}

/* Eliminate the drift of each segment from rows [drift | any columns | target] of unit covariance, F of each step, by
   rotations: what is left are innovations. `triangle` is q x columns. Returns the logarithm of the determinant of the
   covariance by the drift. */
static double without_drift(const Model *model, const Mesh *mesh, int64_t q, int64_t F, int64_t columns, double *rows,
                            double *triangle) {
    double total = 0;
    for (int64_t i = 0; i + 1 < mesh->points; ++i) {
        if (i == 0 || !mesh->contiguous[i - 1]) {
            memset(triangle, 0, sizeof(double) * (size_t)(q * columns));
            for (int64_t k = 0; k < q; ++k) {
                triangle[k * columns + k] = 1;
                triangle[(k + 1) * columns - 1] = model->latent_mean[k] / model->latent_std[k];
            }
        }
        for (int64_t a = 0; a < F; ++a, rows += columns)
            for (int64_t k = 0; k < q; ++k) {
                double *restrict kept = triangle + k * columns;
                const double size = hypot(kept[k], rows[k]), c = kept[k] / size, s = rows[k] / size;
                for (int64_t r = k; r < columns; ++r) {
                    const double before = kept[r];
                    kept[r] = c * before + s * rows[r];
                    rows[r] = c * rows[r] - s * before;
                }
            }
        if (i + 2 == mesh->points || !mesh->contiguous[i + 1])
            for (int64_t k = 0; k < q; ++k) total += 2 * log(triangle[k * columns + k]);
    }
    return total;
}

static bool whiten(const Workspace *work, const Mesh *mesh, Vague vague, const double *states, double model_error,
                   const double *start, const double *end, double *rows, int64_t columns, Parts own, double *factor,
                   double *result) {
    const int64_t W = work->F, stride = work->W;
    double total = 0, turned = 0, begun = 0;
    double unmeasured = measured_at(work->model, mesh, vague, 0, states, own.before, own.offset);
    for (int64_t i = 0; i + 1 < mesh->points; ++i, start += W * W, end += W * W, rows += W * columns) {
        unmeasured += measured_at(work->model, mesh, vague, i + 1, states + (i + 1) * stride, own.after, own.next);
        begun = segment_start(mesh, i, begun);
        if (work->q) drift_columns(work->model, mesh, i, begun, start, end, rows, columns);
        for (int64_t a = 0; a < W; ++a)
            for (int64_t b = 0; b < W; ++b)
                rows[a * columns + columns - 1] -= start[a * W + b] * own.offset[b] + end[a * W + b] * own.next[b];
        covariance_of(work, mesh, i, start, end, model_error, own);
        if (i > 0) take_before(factor, own, rows - W * columns, rows, columns, W);
        if (!divide(own.block, rows, columns, W, &total)) return false;
        memcpy(factor, own.block, sizeof(double) * (size_t)(W * W));
        if (mesh->contiguous[i]) {
            memcpy(own.by_end, end, sizeof(double) * (size_t)(W * W));
            turned += log_determinant(own.by_end, W);
        }
        double *spare = own.before;
        own.before = own.after;
        own.after = spare;
        spare = own.offset;
        own.offset = own.next;
        own.next = spare;
    }
    *result = total - 2 * turned - unmeasured;
    return true;
}

/* Free rows [any columns | target], (n - 1) F of them, of the covariance of defects about an estimate, in place; the
   target is that about the estimate, and moved to the centre of the measurements. `result` is the log-determinant. With
   a drift the first q columns are its own: they are filled and eliminated. */
EXPORTED int commonlaw_whiten(const Model *model, const Mesh *mesh, const double *states, double model_error,
                              Vagueness beyond, const double *start, const double *end, double *rows, int64_t columns,
                              double *result) {
    Workspace work = {.model = model, .d = model->equations, .D = model->equations + model->rates, .w = model->latent};
    const int64_t W = work.W = work.D + work.w, q = work.q = model->drift ? work.w : 0;
    work.F = W - q;
    double *memory = malloc(sizeof(double) * (size_t)(7 * W * W + 5 * W + q * columns));
    if (!memory) return NO_MEMORY;
    double *vectors = memory + 7 * W * W;
    const Vague vague = {vectors + 2 * W, vectors + 3 * W, vectors + 4 * W};
    Parts own = {memory,
                 memory + W * W,
                 memory + 2 * W * W,
                 memory + 3 * W * W,
                 memory + 4 * W * W,
                 memory + 5 * W * W,
                 vectors,
                 vectors + W};
    fill_vague(model, mesh, beyond, vague);
    const bool done =
        whiten(&work, mesh, vague, states, model_error, start, end, rows, columns, own, memory + 6 * W * W, result);
    if (done && q) *result += without_drift(model, mesh, q, work.F, columns, rows, vectors + 5 * W);
    free(memory);
    return done ? DONE : NOT_POSITIVE;
}

/* Fill rows with the columns of the free coefficients and the target about the estimate; false if not finite. */
static bool fill_rows(const double *border, const double *defects, const double *own, int64_t count, int64_t p,
                      double *rows, int64_t stride) {
    double total = 0;
    for (int64_t i = 0; i < count; ++i) {
        double target = -defects[i], *row = rows + i * stride;
        for (int64_t r = 0; r < p; ++r) {
            row[r] = border[i * p + r];
            target += row[r] * own[r];
            total += row[r] * 0;
        }
        row[p] = target;
        total += target * 0;
    }
    return total == 0;
}

/* Fill the triangular factor of [columns | target] that are freed of the covariance: `basis` is that of the columns
   before, and `white` that of [basis | target] after that. */
static void join_factors(const double *basis, const double *white, int64_t p, double *factor) {
    const int64_t columns = p + 1;
    memset(factor, 0, sizeof(double) * (size_t)(columns * columns));
    for (int64_t a = 0; a < columns; ++a) {
        for (int64_t c = a; c < p; ++c)
            for (int64_t b = c; b < p; ++b) factor[a * columns + b] += white[a * columns + c] * basis[c * p + b];
        factor[a * columns + p] = white[a * columns + p];
    }
}

/* Multiply the columns of each row with a power of 1 or -1 of the unit of its state. */
static void times_units(const Model *model, double power, int64_t count, int64_t p, double *rows, int64_t stride) {
    const int64_t D = model->equations + model->rates, W = model->drift ? D : D + model->latent;
    for (int64_t i = 0; i < count; ++i) {
        const int64_t a = i % W;
        if (a >= D) continue;
        const double unit = model->unit[a] > 0 ? model->unit[a] : 1;
        double *row = rows + i * stride;
        for (int64_t r = 0; r < p; ++r) row[r] = power > 0 ? row[r] * unit : row[r] / unit;
    }
}

/* Linearise the likelihood of one mesh: the factor of its rows, (p + 1) x (p + 1), and the log-determinant. */
static int linearize(const Model *model, const Mesh *mesh, const uint8_t *free_ones, const double *states,
                     const double *coefficients, double model_error, Vagueness beyond, int64_t p, double *factor,
                     double *result) {
    const int64_t q = model->drift ? model->latent : 0, W = model->equations + model->rates + model->latent - q;
    const int64_t steps = mesh->points - 1, count = steps * W, columns = q + p + 1;
    const int64_t all = model->equations * model->program.terms;
    const int64_t size = count + 2 * count * W + count * p + count * columns + p * p + (p + 1) * (p + 1) + p;
    double *defects = malloc(sizeof(double) * (size_t)(size + 1));
    if (!defects) return NO_MEMORY;
    double *start = defects + count, *end = start + count * W, *border = end + count * W, *rows = border + count * p;
    double *basis = rows + count * columns, *white = basis + p * p, *own = white + (p + 1) * (p + 1);
    for (int64_t k = 0, r = 0; k < all; ++k)
        if (free_ones[k]) own[r++] = coefficients[k];
    int failed = commonlaw_jacobians(model, mesh, free_ones, states, coefficients, defects, start, end, border);
    if (!failed && !fill_rows(border, defects, own, count, p, rows + q, columns)) failed = NOT_POSITIVE;
    if (!failed) {
        /* Far from the origin terms are nearly alike: rounding in what follows would spoil what they differ in */
        times_units(model, -1, count, p, rows + q, columns);
        orthogonalize(rows + q, count, p, columns, basis);
        times_units(model, 1, count, p, rows + q, columns);
        failed = commonlaw_whiten(model, mesh, states, model_error, beyond, start, end, rows, columns, result);
    }
    if (!failed) {
        for (int64_t i = 0; i < steps; ++i)
            if (!mesh->contiguous[i]) memset(rows + i * W * columns, 0, sizeof(double) * (size_t)(W * columns));
        orthogonalize(rows + q, count, p + 1, columns, white);
        join_factors(basis, white, p, factor);
    }
    free(defects);
    return failed;
}

/* Linearise the likelihood of several meshes, each with a model and coefficients of its own: the factors of their rows,
   each (p + 1) x (p + 1), and the log-determinants. States of all meshes stand one behind the other. */
EXPORTED int commonlaw_linearize(const Model *const *models, const Mesh *meshes, int64_t count,
                                 const uint8_t *free_ones, const double *states, const double *coefficients,
                                 double model_error, Vagueness beyond, double *factors, double *results) {
    int failed = DONE;
    for (int64_t each = 0; each < count && !failed; ++each) {
        const Model *model = models[each];
        const int64_t all = model->equations * model->program.terms;
        int64_t p = 0;
        for (int64_t k = 0; k < all; ++k) p += free_ones[k] != 0;
        failed = linearize(model, meshes + each, free_ones, states, coefficients, model_error, beyond, p, factors,
                           results + each);
        states += meshes[each].points * (model->equations + model->rates + model->latent);
        coefficients += all;
        factors += (p + 1) * (p + 1);
    }
    return failed;
}
