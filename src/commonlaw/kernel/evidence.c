/* The evidence for a support that all objects share, as evidence.py's minus_twice_log_evidence. */
#include "kernel.h"

#include <float.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

static double of_noise(Measured measured, double squares) {
    return fmax(squares - measured.outliers, 0) + measured.prior;
}

static double variance_of(Measured measured, double squares, double coefficients) {
    if (isinf(measured.freedom)) return 1;
    return fmax(of_noise(measured, squares) / fmax(measured.freedom - coefficients, 1), measured.least);
}

static double deviance_of(Measured measured, double squares, double coefficients) {
    if (isinf(measured.freedom)) return squares;
    const double variance = variance_of(measured, squares, coefficients);
    return measured.freedom * log(variance) + of_noise(measured, squares) / variance;
}

typedef struct {
    int64_t objects, k, common; /* of the k columns the last so many have one coefficient for all objects */
    double *reduced;     /* objects x (k + 1) x (k + 1): triangular factors of the support's columns and the target */
    double *columns;     /* objects x k x k: upper triangles of these columns, of mean square one, or mixed */
    double *information; /* objects x k x k */
    double *estimates;   /* objects x k */
    double *scale, *rows, *mixed, *total;
} Support;

/* Fill the triangular factors; returns what is left of the squares. */
static double reduce(Support *s, const double *factors, int64_t terms, const int64_t *indices) {
    const int64_t size = s->k + 1;
    double squares = 0;
    for (int64_t o = 0; o < s->objects; ++o) {
        double *reduced = s->reduced + o * size * size;
        for (int64_t i = 0; i <= terms; ++i)
            for (int64_t a = 0; a < size; ++a)
                s->rows[i * size + a] = factors[(o * (terms + 1) + i) * (terms + 1) + (a < s->k ? indices[a] : terms)];
        orthogonalize(s->rows, terms + 1, size, size, reduced);
        squares += reduced[size * size - 1] * reduced[size * size - 1];
    }
    return squares;
}

/* Fill the columns, which all objects together have with a mean square of one. */
static void scale_columns(Support *s) {
    const int64_t k = s->k, size = k + 1;
    for (int64_t b = 0; b < k; ++b) {
        double square = 0;
        for (int64_t o = 0; o < s->objects; ++o)
            for (int64_t a = 0; a <= b; ++a) {
                const double value = s->reduced[(o * size + a) * size + b];
                square += value * value;
            }
        const double norm = sqrt(square / (double)s->objects), scale = norm > 0 ? norm : 1;
        for (int64_t o = 0; o < s->objects; ++o)
            for (int64_t a = 0; a < k; ++a)
                s->columns[(o * k + a) * k + b] = s->reduced[(o * size + a) * size + b] / scale;
    }
}

/* Mix the columns so that those of all objects together are orthogonal, each to the ones before it; false if some
   depend on others. */
static bool mix_columns(Support *s) {
    const int64_t k = s->k;
    memcpy(s->rows, s->columns, sizeof(double) * (size_t)(s->objects * k * k));
    orthogonalize(s->rows, s->objects * k, k, k, s->mixed);
    for (int64_t b = 0; b < k; ++b)
        if (s->mixed[b * k + b] == 0) return false;
    for (int64_t row = 0; row < s->objects * k; ++row) {
        double *own = s->columns + row * k;
        for (int64_t b = 0; b < k; ++b) {
            for (int64_t c = 0; c < b; ++c) own[b] -= own[c] * s->mixed[c * k + b];
            own[b] /= s->mixed[b * k + b];
        }
    }
    return true;
}

/* Reflect k numbers, so far apart, by an axis; scale is two over its square. */
static void reflect(double *values, int64_t k, int64_t stride, const double *axis, double scale) {
    double along = 0;
    for (int64_t a = 0; a < k; ++a) along += axis[a] * values[a * stride];
    for (int64_t a = 0; a < k; ++a) values[a * stride] -= scale * along * axis[a];
}

/* The 2-norm condition number of a symmetric matrix, which is lost, by Jacobi's rotations. */
static double condition(double *matrix, int64_t k) {
    double least = INFINITY, largest = 0, off = 1, all = 1;
    for (int sweep = 0; sweep < 30 && off > DBL_EPSILON * DBL_EPSILON * all; ++sweep) {
        off = all = 0;
        for (int64_t a = 0; a < k; ++a)
            for (int64_t b = 0; b <= a; ++b) {
                const double square = matrix[a * k + b] * matrix[a * k + b];
                all += square;
                if (b < a) off += square;
            }
        for (int64_t a = 0; a < k; ++a)
            for (int64_t b = 0; b < a; ++b) {
                const double beside = matrix[a * k + b];
                if (beside == 0) continue;
                const double turn = (matrix[b * k + b] - matrix[a * k + a]) / (2 * beside);
                const double t = (turn < 0 ? -1 : 1) / (fabs(turn) + sqrt(turn * turn + 1));
                const double c = 1 / sqrt(t * t + 1), s = t * c;
                for (int64_t i = 0; i < k; ++i) {
                    const double one = matrix[i * k + a], other = matrix[i * k + b];
                    matrix[i * k + a] = c * one - s * other;
                    matrix[i * k + b] = s * one + c * other;
                }
                for (int64_t i = 0; i < k; ++i) {
                    const double one = matrix[a * k + i], other = matrix[b * k + i];
                    matrix[a * k + i] = c * one - s * other;
                    matrix[b * k + i] = s * one + c * other;
                }
            }
    }
    for (int64_t a = 0; a < k; ++a) {
        const double size = fabs(matrix[a * k + a]);
        if (isnan(size)) return NAN;
        least = fmin(least, size);
        largest = fmax(largest, size);
    }
    return largest / least;
}

/* Estimate the coefficients of an object whose trials do not tell all of them: what they do not tell is zero. */
static bool estimate_told(const Support *s, const double *columns, const double *reduced, double *estimates) {
    const int64_t k = s->k, size = k + 1;
    double *matrix = s->mixed;
    for (int64_t a = 0; a < k; ++a) {
        estimates[a] = 0;
        for (int64_t c = 0; c <= a; ++c) estimates[a] += columns[c * k + a] * reduced[c * size + k];
        for (int64_t b = 0; b < k; ++b) {
            matrix[a * k + b] = a == b ? MIN_COLUMN * MIN_COLUMN : 0;
            for (int64_t c = 0; c < k; ++c) matrix[a * k + b] += columns[c * k + a] * columns[c * k + b];
        }
    }
    return solve_columns(matrix, k, estimates, 1);
}

/* Fill the information on the columns' coefficients and their estimates. */
static bool estimate(Support *s, double variance) {
    const int64_t k = s->k, size = k + 1;
    for (int64_t o = 0; o < s->objects; ++o) {
        const double *columns = s->columns + o * k * k, *reduced = s->reduced + o * size * size;
        double *estimates = s->estimates + o * k, *information = s->information + o * k * k;
        bool told = true;
        for (int64_t a = 0; a < k; ++a) told = told && fabs(columns[a * k + a]) > MIN_COLUMN;
        if (!told && !estimate_told(s, columns, reduced, estimates)) return false;
        for (int64_t a = k - 1; told && a >= 0; --a) {
            double t = reduced[a * size + k];
            for (int64_t b = a + 1; b < k; ++b) t -= columns[a * k + b] * estimates[b];
            estimates[a] = t / columns[a * k + a];
        }
        for (int64_t a = 0; a < k; ++a)
            for (int64_t b = 0; b <= a; ++b) {
                double t = 0;
                for (int64_t c = 0; c <= b; ++c) t += columns[c * k + a] * columns[c * k + b];
                information[a * k + b] = information[b * k + a] = t / variance;
            }
    }
    return true;
}

/* Whether the trials of an object identify the coefficients that it has to itself. */
static bool one_identifies(const Support *s) {
    const int64_t k = s->k;
    for (int64_t o = 0; o < s->objects; ++o) {
        bool told = true;
        for (int64_t a = 0; a < k - s->common; ++a) told = told && fabs(s->columns[(o * k + a) * k + a]) > MIN_COLUMN;
        if (told) return true;
    }
    return false;
}

/* Reflect the estimates so that the mean of those that scatter, which objects weigh by the trace of their covariance, is
   along the first axis; false without one. */
static bool turn_to_mean(Support *s) {
    const int64_t k = s->k;
    double *axis = s->scale, square = 0;
    for (int64_t a = 0; a < k; ++a) axis[a] = 0;
    for (int64_t o = 0; o < s->objects; ++o) {
        double trace = 0;
        for (int64_t a = 0; a < k; ++a) {
            memcpy(s->mixed, s->information + o * k * k, sizeof(double) * (size_t)(k * k));
            for (int64_t b = 0; b < k; ++b) {
                s->mixed[b * k + b] += RIDGE;
                s->rows[b] = a == b;
            }
            if (!solve_columns(s->mixed, k, s->rows, 1)) return false;
            trace += s->rows[a];
        }
        for (int64_t a = 0; a < k - s->common; ++a) axis[a] += s->estimates[o * k + a] / trace;
    }
    for (int64_t a = 0; a < k; ++a) square += axis[a] * axis[a];
    if (!(square > 0)) return false;
    axis[0] += copysign(sqrt(square), axis[0]);
    square = 0;
    for (int64_t a = 0; a < k; ++a) square += axis[a] * axis[a];
    for (int64_t o = 0; o < s->objects; ++o) {
        reflect(s->estimates + o * k, k, 1, axis, 2 / square);
        for (int64_t a = 0; a < k; ++a) reflect(s->information + o * k * k + a * k, k, 1, axis, 2 / square);
        for (int64_t a = 0; a < k; ++a) reflect(s->information + o * k * k + a, k, k, axis, 2 / square);
    }
    return true;
}

/* What the estimates cost by their scatter. */
static int cost_of_estimates(Support *s, int64_t tried, const double *grid, int64_t sweeps, double *found) {
    const int64_t k = s->k;
    for (int64_t a = 0; a < k; ++a) {
        double square = 0;
        for (int64_t o = 0; o < s->objects; ++o) square += s->estimates[o * k + a] * s->estimates[o * k + a];
        s->scale[a] = a < k - s->common ? fmax(square / (double)s->objects, DBL_MIN) : 0;
    }
    return marginal_deviance(s->objects, k, s->estimates, s->information, s->scale, tried, grid, sweeps, found);
}

/* What the coefficients of columns cost by their scatter; infinite if they are not identifiable. */
static int cost(Support *s, double variance, double worst, int64_t tried, const double *grid, int64_t sweeps,
                double *found) {
    const int64_t k = s->k;
    *found = INFINITY;
    if (!estimate(s, variance)) return NOT_POSITIVE;
    for (int64_t i = 0; i < k * k; ++i) {
        s->total[i] = 0;
        for (int64_t o = 0; o < s->objects; ++o) s->total[i] += s->information[o * k * k + i];
    }
    if (!(condition(s->total, k) < worst) || (s->objects > 1 && !one_identifies(s))) return DONE;
    *found = 0;
    return s->objects == 1 ? DONE : cost_of_estimates(s, tried, grid, sweeps, found);
}

/* The three ways of scattering, equally probable beforehand; see evidence.py. */
static int scatter(Support *s, double variance, double worst, int64_t tried, const double *grid, int64_t sweeps,
                   double *found) {
    double costs[3] = {INFINITY, INFINITY, INFINITY}, total = 0;
    scale_columns(s);
    int failed = cost(s, variance, worst, tried, grid, sweeps, costs);
    *found = isnan(*costs) ? INFINITY : *costs;
    if (failed || s->k == 1 || s->objects == 1) return failed;
    if (!mix_columns(s)) return NOT_POSITIVE;
    failed = cost(s, variance, worst, tried, grid, sweeps, costs + 1);
    if (!failed && costs[1] < INFINITY && turn_to_mean(s)) failed = cost_of_estimates(s, tried, grid, sweeps, costs + 2);
    for (int each = 1; each < 3; ++each) *found = fmin(*found, isnan(costs[each]) ? INFINITY : costs[each]);
    for (int each = 0; each < 3; ++each) total += isnan(costs[each]) ? 0 : exp((*found - costs[each]) / 2);
    if (*found < INFINITY) *found -= 2 * log(total / 3);
    return failed;
}

/* Minus twice the log-evidence of a support, its terms by their indices, on triangular factors, objects x (terms + 1) x
   (terms + 1); a lower bound where it is not below what is needed. The last terms may be common to all objects. */
EXPORTED int commonlaw_evidence(int64_t objects, int64_t terms, const double *factors, int64_t k,
                                const int64_t *indices, int64_t common, Measured measured, double needed, double worst,
                                int64_t tried, const double *grid, int64_t sweeps, double *result) {
    const int64_t size = k + 1, square = k * k, own = k * objects;
    const int64_t rows = (terms + 1) * size > own * k ? (terms + 1) * size : own * k;
    double *memory = malloc(sizeof(double) * (size_t)(objects * (size * size + 2 * square + k) + k + rows + 2 * square));
    if (!memory) return NO_MEMORY;
    Support s = {.objects = objects, .k = k, .common = common, .reduced = memory};
    s.columns = s.reduced + objects * size * size;
    s.information = s.columns + objects * square;
    s.estimates = s.information + objects * square;
    s.scale = s.estimates + own;
    s.mixed = s.scale + k;
    s.total = s.mixed + square;
    s.rows = s.total + square;
    const double squares = reduce(&s, factors, terms, indices);
    double found = 0;
    int failed = DONE;
    *result = deviance_of(measured, squares, (double)own) + (double)k * (log(measured.count) + log((double)objects));
    if (k > 0 && *result < needed) {
        const double variance = fmax(variance_of(measured, squares, (double)own), DBL_MIN);
        failed = scatter(&s, variance, worst, tried, grid, sweeps, &found);
        *result += found;
        if (failed == NOT_POSITIVE || !isfinite(*result)) *result = INFINITY;
    }
    free(memory);
    return failed == NO_MEMORY ? NO_MEMORY : DONE;
}
