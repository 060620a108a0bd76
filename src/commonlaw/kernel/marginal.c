/* What coefficients cost by their scatter over objects, as random_effects.py's marginal_deviance. */
#include "kernel.h"

#include <float.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

static const double RIDGE = 1e-12;

/* Solve in place by elimination with pivots; adds the logarithm of the determinant's size; false if singular. */
static bool solve_square(double *matrix, int64_t k, double *right, int64_t columns, double *logarithm) {
    for (int64_t c = 0; c < k; ++c) {
        int64_t pivot = c;
        for (int64_t a = c + 1; a < k; ++a)
            if (fabs(matrix[a * k + c]) > fabs(matrix[pivot * k + c])) pivot = a;
        if (matrix[pivot * k + c] == 0) return false;
        for (int64_t b = 0; pivot != c && b < k; ++b) {
            const double spare = matrix[c * k + b];
            matrix[c * k + b] = matrix[pivot * k + b];
            matrix[pivot * k + b] = spare;
        }
        for (int64_t r = 0; pivot != c && r < columns; ++r) {
            const double spare = right[c * columns + r];
            right[c * columns + r] = right[pivot * columns + r];
            right[pivot * columns + r] = spare;
        }
        *logarithm += log(fabs(matrix[c * k + c]));
        for (int64_t a = c + 1; a < k; ++a) {
            const double factor = matrix[a * k + c] / matrix[c * k + c];
            for (int64_t b = c + 1; b < k; ++b) matrix[a * k + b] -= factor * matrix[c * k + b];
            for (int64_t r = 0; r < columns; ++r) right[a * columns + r] -= factor * right[c * columns + r];
        }
    }
    for (int64_t a = k - 1; a >= 0; --a)
        for (int64_t r = 0; r < columns; ++r) {
            double t = right[a * columns + r];
            for (int64_t c = a + 1; c < k; ++c) t -= matrix[a * k + c] * right[c * columns + r];
            right[a * columns + r] = t / matrix[a * k + a];
        }
    return true;
}

typedef struct {
    int64_t objects, k;
    const double *estimates, *information;
    double *rest, *column, *own, *logarithm, *along; /* of each object, as in random_effects.py's deviances */
    double *rest_total, *rest_weighted, *total, *means, *matrix;
} Effects;

/* Prepare for variances of one parameter; those of the others are given. */
static bool prepare(Effects *e, const double *variances, int64_t parameter) {
    const int64_t k = e->k;
    memset(e->rest_total, 0, sizeof(double) * (size_t)(k * k));
    memset(e->rest_weighted, 0, sizeof(double) * (size_t)k);
    for (int64_t o = 0; o < e->objects; ++o) {
        const double *information = e->information + o * k * k, *estimates = e->estimates + o * k;
        double *rest = e->rest + o * k * k, *column = e->column + o * k;
        for (int64_t a = 0; a < k; ++a)
            for (int64_t b = 0; b < k; ++b)
                e->matrix[a * k + b] =
                    (double)(a == b) + (b == parameter ? 0.0 : information[a * k + b] * variances[b]);
        memcpy(rest, information, sizeof(double) * (size_t)(k * k));
        e->logarithm[o] = 0;
        if (!solve_square(e->matrix, k, rest, k, &e->logarithm[o])) return false;
        for (int64_t a = 0; a < k; ++a)
            for (int64_t b = 0; b < a; ++b)
                rest[a * k + b] = rest[b * k + a] = (rest[a * k + b] + rest[b * k + a]) / 2;
        e->along[o] = 0;
        for (int64_t a = 0; a < k; ++a) {
            column[a] = rest[a * k + parameter];
            e->along[o] += column[a] * estimates[a];
        }
        e->own[o] = column[parameter] < DBL_MIN ? DBL_MIN : column[parameter];
        for (int64_t a = 0; a < k; ++a)
            for (int64_t b = 0; b < k; ++b) {
                double *at = &rest[a * k + b];
                *at = a == parameter || b == parameter ? 0.0 : *at - column[a] * (column[b] / e->own[o]);
                e->rest_total[a * k + b] += *at;
                e->rest_weighted[a] += *at * estimates[b];
            }
    }
    return true;
}

/* The deviance with one variance of the parameter; false if the objects together are singular. */
static bool deviance(Effects *e, double tried, double *found) {
    const int64_t k = e->k;
    double unused = 0;
    memcpy(e->total, e->rest_total, sizeof(double) * (size_t)(k * k));
    memcpy(e->means, e->rest_weighted, sizeof(double) * (size_t)k);
    for (int64_t o = 0; o < e->objects; ++o) {
        const double share = 1 / (e->own[o] * (1 + tried * e->own[o])), *column = e->column + o * k;
        for (int64_t a = 0; a < k; ++a) {
            for (int64_t b = 0; b < k; ++b) e->total[a * k + b] += share * (column[a] * column[b]);
            e->means[a] += share * e->along[o] * column[a];
        }
    }
    for (int64_t a = 0; a < k; ++a) e->total[a * k + a] *= 1 + RIDGE;
    if (!solve_square(e->total, k, e->means, 1, &unused)) return false;
    *found = 0;
    for (int64_t o = 0; o < e->objects; ++o) {
        const double *rest = e->rest + o * k * k, *column = e->column + o * k, *estimates = e->estimates + o * k;
        double square = 0, across = 0;
        for (int64_t a = 0; a < k; ++a) {
            double moved = 0;
            for (int64_t b = 0; b < k; ++b) moved += rest[a * k + b] * (estimates[b] - e->means[b]);
            square += moved * (estimates[a] - e->means[a]);
            across += column[a] * (estimates[a] - e->means[a]);
        }
        square += across * across / (e->own[o] * (1 + tried * e->own[o]));
        const double logarithm = e->logarithm[o] + log1p(tried * e->own[o]);
        /* Neither is below zero; where coefficients can hardly be told apart, rounding may leave it far below */
        *found += (square < 0 ? 0 : square) + (logarithm < 0 ? 0 : logarithm);
    }
    return true;
}

/* Choose each variance, given the others, until none changes. */
static bool sweep(Effects *e, const double *scale, const double *grid, int64_t count, int64_t sweeps, double *variances,
                  double *result) {
    memcpy(variances, scale, sizeof(double) * (size_t)e->k);
    bool changed = true;
    for (int64_t each = 0; each < sweeps && changed; ++each) {
        changed = false;
        for (int64_t parameter = 0; parameter < e->k; ++parameter) {
            double least = INFINITY, chosen = variances[parameter], own;
            if (!prepare(e, variances, parameter)) return false;
            for (int64_t m = 0; m < count; ++m) {
                if (!deviance(e, scale[parameter] * grid[m], &own)) return false;
                if (m > 0 && (isnan(least) || !(own < least || isnan(own)))) continue;
                least = own;
                chosen = scale[parameter] * grid[m];
            }
            changed |= chosen != variances[parameter];
            variances[parameter] = chosen;
            *result = least;
        }
    }
    return true;
}

/* Minus twice the log marginal likelihood of estimates (objects x k) with information (objects x k x k) at the best means
   and variances; these are tried relative to a scale of each coefficient. */
EXPORTED int commonlaw_marginal_deviance(int64_t objects, int64_t k, const double *estimates, const double *information,
                                         const double *scale, int64_t count, const double *grid, int64_t sweeps,
                                         double *result) {
    const int64_t size = objects * (k * k + k + 3) + 3 * k * k + 3 * k;
    double *memory = malloc(sizeof(double) * (size_t)(size + 1));
    if (!memory) return NO_MEMORY;
    Effects effects = {.objects = objects, .k = k, .estimates = estimates, .information = information};
    effects.rest = memory;
    effects.column = effects.rest + objects * k * k;
    effects.own = effects.column + objects * k;
    effects.logarithm = effects.own + objects;
    effects.along = effects.logarithm + objects;
    effects.rest_total = effects.along + objects;
    effects.total = effects.rest_total + k * k;
    effects.matrix = effects.total + k * k;
    effects.rest_weighted = effects.matrix + k * k;
    effects.means = effects.rest_weighted + k;
    const bool done = sweep(&effects, scale, grid, count, sweeps, effects.means + k, result);
    free(memory);
    return done ? DONE : NOT_POSITIVE;
}
