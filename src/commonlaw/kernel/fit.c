/* States and coefficients of one object by Gauss-Newton steps, as in fitting.py. */
#include "kernel.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

static const double lifts[] = {LIFTS};
static const double SMALLEST = 2.2250738585072014e-308;
static const double SAFE = 1e-9; /* Pivots of a scaled matrix from which Cholesky's way is as good as any */

typedef struct {
    double gain, shortest; /* see fitting.py */
    int64_t steps;
} Rules;

typedef struct {
    double deviance, objective;
} Fitness;

typedef struct {
    Workspace work;
    const Mesh *meshes;
    int64_t count, points;
    LeastNorm least_norm;
    double *states, *moved, *direction, *coefficients, *changed, *own, *scaled, *triangle, *right;
} Fit;

static double deviance_at(const Model *model, const Mesh *mesh, int64_t i, const double *states) {
    double total = 0;
    for (int64_t j = 0; j < model->equations; ++j) {
        double residual = mesh->measured[i * model->equations + j] - states[j];
        if (model->correlated || model->drift) residual -= states[model->equations + model->rates + j];
        const double size = fabs(residual / mesh->std[i * model->equations + j]), bound = model->huber_threshold;
        if (isnan(size)) continue;
        const double beyond = model->rejects ? bound * bound : 2 * bound * size - bound * bound;
        total += size > bound ? beyond : size * size;
    }
    return total;
}

static double missed_at(const Workspace *work, const Mesh *mesh, int64_t i, const double *states, double model_error) {
    double total = 0;
    for (int64_t a = 0; a < work->D; ++a) {
        const double missed = defect(work, mesh, states, i, a), allowed = model_error * work->model->unit[a];
        total += missed * missed / (allowed * allowed) / walk(work, mesh, i, a);
    }
    for (int64_t l = 0; l < work->F - work->D; ++l) {
        const double missed = latent_defect(work, mesh, states, i, l);
        total += missed * missed;
    }
    return total;
}

static Fitness evaluate(Fit *fit, const double *states, const double *coefficients, double model_error) {
    Workspace *work = &fit->work;
    double deviance = 0, missed = 0;
    for (int64_t m = 0; m < fit->count; ++m) {
        const Mesh *mesh = &fit->meshes[m];
        collocate(work, mesh, states, coefficients, false);
        for (int64_t i = 0; i < mesh->points; ++i) {
            deviance += deviance_at(work->model, mesh, i, states + i * work->W);
            for (int64_t l = 0; l < work->w; ++l) {
                const double own = states[i * work->W + work->D + l] - work->model->latent_mean[l];
                missed += mesh->anchors[i * work->w + l] * own * own;
            }
            if (i + 1 < mesh->points && mesh->contiguous[i])
                missed += missed_at(work, mesh, i, states, model_error);
        }
        states += mesh->points * work->W;
    }
    const Model *model = work->model;
    for (int64_t k = 0; model->precision && k < model->equations * model->program.terms; ++k) {
        const double away = coefficients[k] - model->typical[k];
        missed += model->precision[k] * away * away;
    }
    const double objective = missed + deviance;
    return (Fitness){deviance, isfinite(objective) ? objective : INFINITY};
}

/* Eliminate the states of all meshes and sum what is left. */
static bool eliminate_all(Fit *fit, double model_error) {
    Workspace *work = &fit->work;
    const int64_t size = (work->p + 1) * (work->p + 1);
    const double *states = fit->states;
    int64_t first = 0;
    memset(work->information, 0, sizeof(double) * (size_t)size);
    for (int64_t m = 0; m < fit->count; ++m) {
        const Mesh *mesh = &fit->meshes[m];
        bool done = false;
        collocate(work, mesh, states, fit->coefficients, true);
        for (size_t each = 0; each < sizeof lifts / sizeof *lifts && !done; ++each)
            done = eliminate(work, mesh, states, model_error, lifts[each], first);
        if (!done) return false;
        for (int64_t k = 0; k < size; ++k) work->information[k] += work->of_mesh[k];
        first += mesh->points;
        states += mesh->points * work->W;
    }
    for (int64_t r = 0; work->model->precision && r < work->p; ++r) {
        const int64_t k = work->equation[r] * work->model->program.terms + work->kept.chosen[work->column[r]];
        const double precision = work->model->precision[k];
        work->information[r * (work->p + 1) + r] += precision;
        work->information[work->p * (work->p + 1) + r] += precision * (fit->coefficients[k] - work->model->typical[k]);
    }
    return true;
}

/* Solve by a factor where that is safe: `triangle` and `own` are filled. */
static bool solve_by_factor(Fit *fit) {
    const int64_t p = fit->work.p;
    double *l = fit->triangle, *own = fit->own;
    for (int64_t a = 0; a < p; ++a)
        for (int64_t b = 0; b <= a; ++b) {
            double t = fit->scaled[a * p + b];
            for (int64_t c = 0; c < b; ++c) t -= l[a * p + c] * l[b * p + c];
            if (a == b && !(t > SAFE)) return false;
            l[a * p + b] = a == b ? sqrt(t) : t / l[b * p + b];
        }
    for (int64_t a = 0; a < p; ++a) {
        own[a] = fit->right[a];
        for (int64_t c = 0; c < a; ++c) own[a] -= l[a * p + c] * own[c];
        own[a] /= l[a * p + a];
    }
    for (int64_t a = p - 1; a >= 0; --a) {
        for (int64_t c = a + 1; c < p; ++c) own[a] -= l[c * p + a] * own[c];
        own[a] /= l[a * p + a];
    }
    return true;
}

/* Solve for the coefficients, of least norm in units in which the matrix has a diagonal of ones. */
static bool solve(Fit *fit) {
    const int64_t p = fit->work.p, columns = p + 1;
    const double *information = fit->work.information;
    for (int64_t a = 0; a < p; ++a) {
        const double own = sqrt(fmax(information[a * columns + a], SMALLEST));
        fit->right[a] = -information[p * columns + a] / own;
        for (int64_t b = 0; b <= a; ++b) {
            const double other = sqrt(fmax(information[b * columns + b], SMALLEST));
            const double value = information[a * columns + b] / (own * other);
            if (!isfinite(value)) return false;
            fit->scaled[a * p + b] = fit->scaled[b * p + a] = value;
        }
    }
    if (!solve_by_factor(fit) && !fit->least_norm(p, fit->scaled, fit->right, fit->own)) return false;
    for (int64_t a = 0; a < p; ++a) fit->own[a] /= sqrt(fmax(information[a * columns + a], SMALLEST));
    return true;
}

/* Take one step, shortened until it is better; false if none is. */
static bool step(Fit *fit, Fitness *reached, double model_error, double shortest) {
    Workspace *work = &fit->work;
    const int64_t size = fit->points * work->W, terms = work->model->program.terms;
    if (!eliminate_all(fit, model_error) || !solve(fit)) return false;
    for (int64_t m = 0, first = 0; m < fit->count; first += fit->meshes[m++].points)
        follow(work, &fit->meshes[m], first, fit->own, fit->direction + first * work->W);
    for (double fraction = 1; fraction > shortest; fraction *= SHORTER) {
        for (int64_t k = 0; k < size; ++k) fit->moved[k] = fit->states[k] + fraction * fit->direction[k];
        memcpy(fit->changed, fit->coefficients, sizeof(double) * (size_t)(work->d * terms));
        for (int64_t r = 0; r < work->p; ++r)
            fit->changed[work->equation[r] * terms + work->kept.chosen[work->column[r]]] += fraction * fit->own[r];
        const Fitness found = evaluate(fit, fit->moved, fit->changed, model_error);
        if (!(found.objective < reached->objective)) continue;
        memcpy(fit->states, fit->moved, sizeof(double) * (size_t)size);
        memcpy(fit->coefficients, fit->changed, sizeof(double) * (size_t)(work->d * terms));
        *reached = found;
        return true;
    }
    return false;
}

static void descend(Fit *fit, const double *model_errors, int64_t levels, Rules rules, double *out) {
    Fitness reached = {INFINITY, INFINITY};
    for (int64_t level = 0; level < levels; ++level) {
        reached = evaluate(fit, fit->states, fit->coefficients, model_errors[level]);
        for (int64_t each = 0; each < rules.steps; ++each) {
            const double before = reached.objective;
            if (!step(fit, &reached, model_errors[level], rules.shortest)) break;
            if (before - reached.objective < rules.gain * (1 + RELATIVE_GAIN * reached.objective)) break;
        }
    }
    out[0] = reached.deviance;
    out[1] = reached.objective;
}

/* Fit states (N x W, of all meshes) and the free coefficients (d x K) of one object in place. */
static int fit_object(Fit *fit, const Model *model, const uint8_t *free_ones, const double *model_errors,
                      int64_t levels, Rules rules, double *out) {
    void *memory = NULL, *own = NULL;
    int64_t longest = 0;
    for (int64_t m = 0; m < fit->count; ++m) {
        fit->points += fit->meshes[m].points;
        if (fit->meshes[m].points > longest) longest = fit->meshes[m].points;
    }
    const bool open = open_workspace(&fit->work, model, free_ones, fit->coefficients, longest, fit->points, &memory);
    const size_t size = (size_t)(fit->points * fit->work.W), p = (size_t)fit->work.p;
    const size_t all = (size_t)(model->equations * model->program.terms);
    if (open) own = malloc(sizeof(double) * (2 * size + all + 2 * p + 2 * p * p + 1));
    if (own) {
        fit->moved = own;
        fit->direction = fit->moved + size;
        fit->changed = fit->direction + size;
        fit->own = fit->changed + all;
        fit->right = fit->own + p;
        fit->scaled = fit->right + p;
        fit->triangle = fit->scaled + p * p;
        descend(fit, model_errors, levels, rules, out);
    }
    free(own);
    free(memory);
    return own ? DONE : NO_MEMORY;
}

/* Fit states and the free coefficients of several objects in place, each with meshes of its own, as many as counts say;
   everything of one object stands behind that of another. `out` is deviance and objective of each. */
EXPORTED int commonlaw_fit(const Model *const *models, int64_t objects, const Mesh *meshes, const int64_t *counts,
                           const uint8_t *free_ones, const double *model_errors, int64_t levels, int64_t steps,
                           double gain, double shortest, LeastNorm least_norm, double *states, double *coefficients,
                           double *out) {
    int failed = DONE;
    for (int64_t o = 0; o < objects && !failed; ++o) {
        Fit fit = {.meshes = meshes, .count = counts[o], .least_norm = least_norm, .states = states,
                   .coefficients = coefficients};
        failed = fit_object(&fit, models[o], free_ones, model_errors, levels, (Rules){gain, shortest, steps}, out);
        meshes += counts[o];
        states += fit.points * fit.work.W;
        coefficients += models[o]->equations * models[o]->program.terms;
        out += 2;
    }
    return failed;
}
