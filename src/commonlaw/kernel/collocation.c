/* How far states on a mesh are from a solution of a law, as in collocation.py. */
#include "kernel.h"

#include <string.h>

static const Values *ends(const Workspace *work, int64_t *shift) {
    *shift = work->model->held ? 0 : 1;
    return &work->at[work->model->held ? END : START];
}

/* Evaluate the law at the points, at the ends of steps where inputs are held, and in the middles; forces are added. */
void collocate(Workspace *work, const Mesh *mesh, const double *states, const double *coefficients, bool linear) {
    const Model *model = work->model;
    const int64_t n = mesh->points, d = work->d, D = work->D, W = work->W, *highest = model->highest;
    Plan *plan = linear ? &work->kept : &work->other;
    plan_terms(work, plan, coefficients, linear);
    field(work, plan, linear, n, states, W, mesh->inputs, mesh->times, coefficients, &work->at[START]);
    if (model->held)
        field(work, plan, linear, n - 1, states + W, W, mesh->inputs, mesh->times + 1, coefficients, &work->at[END]);
    double *first = work->at[START].derivatives;
    if (model->force >= 0) {
        const double *force = states + D + model->force;
        for (int64_t i = 0; i < n; ++i)
            for (int64_t e = 0; e < d; ++e) {
                first[i * D + highest[e]] += force[i * W + e];
                if (model->held && i + 1 < n) work->at[END].derivatives[i * D + highest[e]] += force[(i + 1) * W + e];
            }
    }
    int64_t shift;
    const double *last = ends(work, &shift)->derivatives + shift * D;
    for (int64_t i = 0; i + 1 < n; ++i)
        for (int64_t s = 0; s < D; ++s)
            work->middle_states[i * D + s] = (states[i * W + s] + states[(i + 1) * W + s]) / 2 +
                                             mesh->steps[i] / 8 * (first[i * D + s] - last[i * D + s]);
    field(work, plan, linear, n - 1, work->middle_states, D, mesh->middle_inputs, mesh->middle_times, coefficients,
          &work->at[MIDDLE]);
    if (model->force >= 0) {
        const double *force = states + D + model->force;
        for (int64_t i = 0; i + 1 < n; ++i)
            for (int64_t e = 0; e < d; ++e)
                work->at[MIDDLE].derivatives[i * D + highest[e]] += (force[i * W + e] + force[(i + 1) * W + e]) / 2;
    }
}

/* The defect of one state in one step. */
double defect(const Workspace *work, const Mesh *mesh, const double *states, int64_t i, int64_t a) {
    const int64_t D = work->D, W = work->W;
    int64_t shift;
    double last = ends(work, &shift)->derivatives[(i + shift) * D + a];
    double total = work->at[START].derivatives[i * D + a] + 4 * work->at[MIDDLE].derivatives[i * D + a] + last;
    return states[(i + 1) * W + a] - states[i * W + a] - mesh->steps[i] / 6 * total;
}

/* The variance of a random walk of a state, or of a rate as of its state, relative to that in a usual step. */
double walk(const Workspace *work, const Mesh *mesh, int64_t i, int64_t a) {
    return mesh->walk[i * work->d + (a < work->d ? a : work->model->second[a - work->d])];
}

/* The time at which the segment of a point begins, given that of the point before. */
double segment_start(const Mesh *mesh, int64_t i, double before) {
    return i > 0 && mesh->contiguous[i - 1] ? before : mesh->times[i];
}

/* Fill how the defects of one step, of a solution less the drift of a segment that begins at that time, change with the
   drift in units of its standard deviations: D rows of q numbers, `stride` apart. See fitting.py. */
void drift_columns(const Model *model, const Mesh *mesh, int64_t i, double begun, const double *start,
                   const double *end, double *out, int64_t stride) {
    const int64_t d = model->equations, D = d + model->rates;
    const double before = mesh->times[i] - begun, after = mesh->times[i + 1] - begun;
    for (int64_t a = 0; a < D; ++a, start += D, end += D, out += stride) {
        for (int64_t j = 0; j < d; ++j) {
            out[j] = -(start[j] + end[j]) * model->latent_std[j];
            out[d + j] = -(start[j] * before + end[j] * after) * model->latent_std[d + j];
        }
        for (int64_t k = d; k < D; ++k) {
            const int64_t slope = d + model->second[k - d];
            out[slope] -= (start[k] + end[k]) * model->latent_std[slope];
        }
    }
}

/* The defect of one latent process. */
double latent_defect(const Workspace *work, const Mesh *mesh, const double *states, int64_t i, int64_t l) {
    const int64_t w = work->w, W = work->W;
    const double *before = mesh->latent_start + (i * w + l) * w, *after = mesh->latent_end + (i * w + l) * w;
    const double *own = states + i * W + work->D;
    double total = 0;
    for (int64_t k = 0; k < w; ++k) total += before[k] * own[k] + after[k] * own[W + k];
    return total;
}

/* Fill those of the defects of one step by a constant inside of terms, numbers `stride` apart. */
static void derivatives_by_constant(const Workspace *work, double h, int64_t i, double *border, int64_t stride,
                                    int64_t q) {
    const int64_t d = work->d, D = work->D, c = work->c, *highest = work->model->highest;
    int64_t shift;
    const Values *final = ends(work, &shift), *first = &work->at[START], *middle = &work->at[MIDDLE];
    const double *fm = middle->by_states + i * D * D;
    for (int64_t a = 0; a < D; ++a) border[a * stride] = 0;
    for (int64_t e = 0; e < d; ++e) {
        const int64_t now = i * d + e, then = (i + shift) * d + e;
        const double begun = first->by_inside[now * c + q] * first->share[now];
        const double ended = final->by_inside[then * c + q] * final->share[then];
        const double sum = begun + 4 * middle->by_inside[now * c + q] * middle->share[now] + ended;
        const double gap = h / 2 * (begun - ended);
        for (int64_t a = 0; a < D; ++a)
            border[a * stride] -= h / 6 * (fm[a * D + highest[e]] * gap + (a == highest[e] ? sum : 0.0));
    }
}

/* Fill the derivatives of the defects of one step: by the states at its start and at its end, W x W, and those of the
   law by the parameters, D rows `stride` apart. Zeros beside the blocks must be there already. */
INLINED void derivatives_of_law(const Workspace *work, double h, int64_t i, double *restrict start,
                                double *restrict end, double *restrict border, int64_t stride, const int64_t D,
                                const int64_t W) {
    const int64_t d = work->d, terms = work->kept.terms, *highest = work->model->highest;
    int64_t shift;
    const Values *final = ends(work, &shift), *first = &work->at[START], *middle = &work->at[MIDDLE];
    const double *f0 = first->by_states + i * D * D, *f1 = final->by_states + (i + shift) * D * D;
    const double *fm = middle->by_states + i * D * D;
    for (int64_t a = 0; a < D; ++a)
        for (int64_t b = 0; b < D; ++b) {
            double by_start = 0.5 * fm[a * D + b], by_end = by_start;
            for (int64_t c = 0; c < D; ++c) {
                by_start += h / 8 * fm[a * D + c] * f0[c * D + b];
                by_end -= h / 8 * fm[a * D + c] * f1[c * D + b];
            }
            start[a * W + b] = -(double)(a == b) - h / 6 * (f0[a * D + b] + 4 * by_start);
            end[a * W + b] = (double)(a == b) - h / 6 * (f1[a * D + b] + 4 * by_end);
        }
    const double *t0 = first->terms + i * terms, *t1 = final->terms + (i + shift) * terms;
    const double *tm = middle->terms + i * terms;
    for (int64_t r = 0; r < work->p; ++r) {
        const int64_t k = work->column[r], e = work->equation[r];
        const int64_t at = highest[e], q = work->constant[work->kept.chosen[k]];
        if (q >= 0) {
            derivatives_by_constant(work, h, i, border + r, stride, q);
            continue;
        }
        const double begun = t0[k] * first->share[i * d + e], ended = t1[k] * final->share[(i + shift) * d + e];
        const double sum = begun + 4 * tm[k] * middle->share[i * d + e] + ended, gap = h / 2 * (begun - ended);
        for (int64_t a = 0; a < D; ++a)
            border[a * stride + r] = -h / 6 * (fm[a * D + at] * gap + (a == at ? sum : 0.0));
    }
}

static void derivatives_by_latent(const Workspace *work, const Mesh *mesh, int64_t i, double *start, double *end) {
    const int64_t d = work->d, D = work->D, w = work->w, W = work->W, force = work->model->force;
    const int64_t *highest = work->model->highest;
    const double h = mesh->steps[i], *fm = work->at[MIDDLE].by_states + i * D * D;
    for (int64_t a = 0; force >= 0 && a < D; ++a)
        for (int64_t e = 0; e < d; ++e) {
            double own = a == highest[e] ? 3.0 : 0.0, across = h / 2 * fm[a * D + highest[e]];
            start[a * W + D + force + e] = -h / 6 * (own + across);
            end[a * W + D + force + e] = -h / 6 * (own - across);
        }
    for (int64_t l = 0; l < w; ++l)
        for (int64_t k = 0; k < w; ++k) {
            start[(D + l) * W + D + k] = mesh->latent_start[(i * w + l) * w + k];
            end[(D + l) * W + D + k] = mesh->latent_end[(i * w + l) * w + k];
        }
}

/* The same with the law's blocks alone, D x D and D rows of the border. */
void law_jacobians(const Workspace *work, const Mesh *mesh, int64_t i, double *start, double *end, double *border,
                   int64_t stride) {
    const double h = mesh->steps[i];
    switch (work->D) {
    case 1: derivatives_of_law(work, h, i, start, end, border, stride, 1, 1); return;
    case 2: derivatives_of_law(work, h, i, start, end, border, stride, 2, 2); return;
    case 3: derivatives_of_law(work, h, i, start, end, border, stride, 3, 3); return;
    case 4: derivatives_of_law(work, h, i, start, end, border, stride, 4, 4); return;
    default: derivatives_of_law(work, h, i, start, end, border, stride, work->D, work->D); return;
    }
}

void step_jacobians(const Workspace *work, const Mesh *mesh, int64_t i, double *start, double *end, double *border,
                    int64_t stride) {
    if (work->F == work->D) {
        law_jacobians(work, mesh, i, start, end, border, stride);
        return;
    }
    derivatives_of_law(work, mesh->steps[i], i, start, end, border, stride, work->D, work->F);
    derivatives_by_latent(work, mesh, i, start, end);
}
