/* What coefficients cost by their scatter over objects, as random_effects.py's marginal_deviance.

   LANES objects go through each step together. */
#include "kernel.h"

#include <float.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

#define EACH_LANE for (int l = 0; l < LANES; ++l)

static void swap(double *restrict one, double *restrict other, int64_t count) {
    for (int64_t b = 0; b < count; ++b) {
        const double spare = one[b];
        one[b] = other[b];
        other[b] = spare;
    }
}

/* Solve for several columns in place by elimination with pivots, which leaves the matrix triangular; false if singular. */
bool solve_columns(double *restrict matrix, int64_t k, double *restrict rows, int64_t columns) {
    for (int64_t c = 0; c < k; ++c) {
        int64_t pivot = c;
        for (int64_t a = c + 1; a < k; ++a)
            if (fabs(matrix[a * k + c]) > fabs(matrix[pivot * k + c])) pivot = a;
        if (matrix[pivot * k + c] == 0) return false;
        if (pivot != c) {
            swap(matrix + c * k, matrix + pivot * k, k);
            swap(rows + c * columns, rows + pivot * columns, columns);
        }
        for (int64_t a = c + 1; a < k; ++a) {
            const double factor = matrix[a * k + c] / matrix[c * k + c];
            for (int64_t b = c + 1; b < k; ++b) matrix[a * k + b] -= factor * matrix[c * k + b];
            for (int64_t r = 0; r < columns; ++r) rows[a * columns + r] -= factor * rows[c * columns + r];
        }
    }
    for (int64_t a = k - 1; a >= 0; --a)
        for (int64_t r = 0; r < columns; ++r) {
            double t = rows[a * columns + r];
            for (int64_t c = a + 1; c < k; ++c) t -= matrix[a * k + c] * rows[c * columns + r];
            rows[a * columns + r] = t / matrix[a * k + a];
        }
    return true;
}

/* Arrays of blocks have LANES numbers for each that is named; objects that fill up the last block know nothing. */
typedef struct {
    int64_t blocks, k;
    double *information, *gaps;    /* blocks x k x k, blocks x k: of estimates from the means if none scatters */
    double *column, *own, *along;  /* blocks x k, blocks, blocks: as in random_effects.py's deviances, along gaps */
    double *matrix, *rest, *sums;  /* k x k of one block; k (k + 1) / 2 + k + 1 over blocks */
    double *total, *solved, *rest_total, *rest_weighted, *weighted, *means; /* three k x k, three k */
    double rest_square, logarithm;
} Effects;

static double over_lanes(const double *values) {
    double sum = 0;
    EACH_LANE sum += values[l];
    return sum;
}

/* Solve (I + information variances) rest = information, and add up the logarithms of the determinants.

   Elimination without pivots is stable, as variances to the half on both sides make the matrix symmetric and positive. */
static void solve_block(Effects *e, const double *information, const double *variances) {
    const int64_t k = e->k;
    double *matrix = e->matrix, *rest = e->rest, factor[LANES], product[LANES], logarithm[LANES];
    memcpy(rest, information, sizeof(double) * (size_t)(k * k * LANES));
    for (int64_t a = 0; a < k; ++a)
        for (int64_t b = 0; b < k; ++b) {
            double *restrict at = matrix + (a * k + b) * LANES;
            const double *from = information + (a * k + b) * LANES, one = a == b;
            EACH_LANE at[l] = one + from[l] * variances[b];
        }
    EACH_LANE product[l] = 1, logarithm[l] = 0;
    for (int64_t c = 0; c < k; ++c) {
        const double *pivot = matrix + (c * k + c) * LANES;
        EACH_LANE product[l] *= pivot[l];
        if (c % 2 || c == k - 1) EACH_LANE logarithm[l] += log(product[l]), product[l] = 1;
        for (int64_t a = c + 1; a < k; ++a) {
            const double *beside = matrix + (a * k + c) * LANES;
            EACH_LANE factor[l] = beside[l] / pivot[l];
            for (int64_t b = c + 1; b < k; ++b) {
                double *restrict at = matrix + (a * k + b) * LANES;
                const double *above = matrix + (c * k + b) * LANES;
                EACH_LANE at[l] -= factor[l] * above[l];
            }
            for (int64_t b = 0; b < k; ++b) {
                double *restrict at = rest + (a * k + b) * LANES;
                const double *above = rest + (c * k + b) * LANES;
                EACH_LANE at[l] -= factor[l] * above[l];
            }
        }
    }
    for (int64_t a = k - 1; a >= 0; --a)
        for (int64_t b = 0; b < k; ++b) {
            double *restrict at = rest + (a * k + b) * LANES;
            for (int64_t c = a + 1; c < k; ++c) {
                const double *beside = matrix + (a * k + c) * LANES, *below = rest + (c * k + b) * LANES;
                EACH_LANE at[l] -= beside[l] * below[l];
            }
            const double *pivot = matrix + (a * k + a) * LANES;
            EACH_LANE at[l] /= pivot[l];
        }
    /* Not below zero, but where coefficients can hardly be told apart rounding may leave it far below */
    EACH_LANE e->logarithm += logarithm[l] < 0 ? 0 : logarithm[l];
}

/* Prepare for variances of one parameter; those of the others are given. */
static void prepare(Effects *e, const double *variances, int64_t parameter) {
    const int64_t k = e->k;
    memset(e->rest_total, 0, sizeof(double) * (size_t)(k * k));
    memset(e->rest_weighted, 0, sizeof(double) * (size_t)k);
    e->rest_square = e->logarithm = 0;
    for (int64_t block = 0; block < e->blocks; ++block) {
        const double *gaps = e->gaps + block * k * LANES;
        double *column = e->column + block * k * LANES, *own = e->own + block * LANES, *along = e->along + block * LANES;
        double square[LANES] = {0};
        solve_block(e, e->information + block * k * k * LANES, variances);
        EACH_LANE along[l] = 0;
        for (int64_t a = 0; a < k; ++a) {
            const double *one = e->rest + (a * k + parameter) * LANES, *other = e->rest + (parameter * k + a) * LANES;
            EACH_LANE column[a * LANES + l] = (one[l] + other[l]) / 2;
            EACH_LANE along[l] += column[a * LANES + l] * gaps[a * LANES + l];
        }
        EACH_LANE own[l] = column[parameter * LANES + l] < DBL_MIN ? DBL_MIN : column[parameter * LANES + l];
        for (int64_t a = 0; a < k; ++a) {
            double weighted[LANES] = {0};
            for (int64_t b = 0; b < k; ++b) {
                if (a == parameter || b == parameter) continue;
                const double *one = e->rest + (a * k + b) * LANES, *other = e->rest + (b * k + a) * LANES;
                double value[LANES];
                EACH_LANE value[l] =
                    (one[l] + other[l]) / 2 - column[a * LANES + l] * (column[b * LANES + l] / own[l]);
                EACH_LANE weighted[l] += value[l] * gaps[b * LANES + l];
                e->rest_total[a * k + b] += over_lanes(value);
            }
            EACH_LANE square[l] += weighted[l] * gaps[a * LANES + l];
            e->rest_weighted[a] += over_lanes(weighted);
        }
        EACH_LANE e->rest_square += square[l] < 0 ? 0 : square[l];
    }
}

/* The deviance with one variance of the parameter; false if the objects together are singular. */
static bool deviance(Effects *e, double tried, double *found) {
    const int64_t k = e->k, size = k * (k + 1) / 2 + k + 1;
    double logarithm = e->logarithm;
    memset(e->sums, 0, sizeof(double) * (size_t)(size * LANES));
    for (int64_t block = 0; block < e->blocks; ++block) {
        const double *column = e->column + block * k * LANES, *own = e->own + block * LANES;
        const double *along = e->along + block * LANES;
        double share[LANES], shared[LANES], product = 1, *restrict at = e->sums;
        EACH_LANE share[l] = 1 / (own[l] * (1 + tried * own[l]));
        for (int l = 0; l < LANES; ++l) {
            product *= 1 + tried * own[l];
            if (l % 2) logarithm += log(product), product = 1;
        }
        for (int64_t a = 0; a < k; ++a) {
            EACH_LANE shared[l] = share[l] * column[a * LANES + l];
            for (int64_t b = 0; b <= a; ++b, at += LANES) EACH_LANE at[l] += shared[l] * column[b * LANES + l];
            EACH_LANE at[l] += shared[l] * along[l];
            at += LANES;
        }
        EACH_LANE at[l] += share[l] * along[l] * along[l];
    }
    const double *at = e->sums;
    for (int64_t a = 0; a < k; ++a) {
        for (int64_t b = 0; b <= a; ++b, at += LANES)
            e->total[a * k + b] = e->total[b * k + a] = e->rest_total[a * k + b] + over_lanes(at);
        e->means[a] = e->weighted[a] = e->rest_weighted[a] + over_lanes(at);
        at += LANES;
    }
    double square = e->rest_square + over_lanes(at);
    memcpy(e->solved, e->total, sizeof(double) * (size_t)(k * k));
    for (int64_t a = 0; a < k; ++a) e->solved[a * k + a] *= 1 + RIDGE;
    if (!solve_columns(e->solved, k, e->means, 1)) return false;
    for (int64_t a = 0; a < k; ++a) {
        double moved = 0;
        for (int64_t b = 0; b < k; ++b) moved += e->total[a * k + b] * e->means[b];
        square += e->means[a] * (moved - 2 * e->weighted[a]);
    }
    *found = (square < 0 ? 0 : square) + logarithm;
    return true;
}

/* Take information in lanes, and the gaps of estimates from the means that objects have together if none scatters:
   about these squares have most digits. */
static bool begin(Effects *e, int64_t objects, const double *estimates, const double *information) {
    const int64_t k = e->k;
    memset(e->information, 0, sizeof(double) * (size_t)(e->blocks * k * k * LANES));
    memset(e->gaps, 0, sizeof(double) * (size_t)(e->blocks * k * LANES));
    memset(e->total, 0, sizeof(double) * (size_t)(k * k));
    memset(e->means, 0, sizeof(double) * (size_t)k);
    for (int64_t o = 0; o < objects; ++o)
        for (int64_t a = 0; a < k; ++a)
            for (int64_t b = 0; b < k; ++b) {
                const double value = information[(o * k + a) * k + b];
                e->information[((o / LANES * k + a) * k + b) * LANES + o % LANES] = value;
                e->total[a * k + b] += value;
                e->means[a] += value * estimates[o * k + b];
            }
    for (int64_t a = 0; a < k; ++a) e->total[a * k + a] *= 1 + RIDGE;
    if (!solve_columns(e->total, k, e->means, 1)) return false;
    for (int64_t o = 0; o < objects; ++o)
        for (int64_t a = 0; a < k; ++a)
            e->gaps[(o / LANES * k + a) * LANES + o % LANES] = estimates[o * k + a] - e->means[a];
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
            const double before = variances[parameter];
            variances[parameter] = 0;
            prepare(e, variances, parameter);
            for (int64_t m = 0; m < count; ++m) {
                if (!deviance(e, scale[parameter] * grid[m], &own)) return false;
                if (m > 0 && (isnan(least) || !(own < least || isnan(own)))) continue;
                least = own;
                chosen = scale[parameter] * grid[m];
            }
            changed |= chosen != before;
            variances[parameter] = chosen;
            *result = least;
        }
    }
    return true;
}

/* Minus twice the log marginal likelihood of estimates (objects x k) with information (objects x k x k) at the best means
   and variances; these are tried relative to a scale of each coefficient. */
int marginal_deviance(int64_t objects, int64_t k, const double *estimates, const double *information, const double *scale,
                      int64_t count, const double *grid, int64_t sweeps, double *result) {
    const int64_t blocks = (objects + LANES - 1) / LANES, square = k * k, sums = k * (k + 1) / 2 + k + 1;
    const int64_t size = LANES * (blocks * (square + 2 * k + 2) + 2 * square + sums) + 3 * square + 4 * k;
    double *memory = malloc(sizeof(double) * (size_t)(size + 1));
    if (!memory) return NO_MEMORY;
    Effects effects = {.blocks = blocks, .k = k};
    effects.information = memory;
    effects.gaps = effects.information + blocks * square * LANES;
    effects.column = effects.gaps + blocks * k * LANES;
    effects.own = effects.column + blocks * k * LANES;
    effects.along = effects.own + blocks * LANES;
    effects.matrix = effects.along + blocks * LANES;
    effects.rest = effects.matrix + square * LANES;
    effects.sums = effects.rest + square * LANES;
    effects.total = effects.sums + sums * LANES;
    effects.solved = effects.total + square;
    effects.rest_total = effects.solved + square;
    effects.rest_weighted = effects.rest_total + square;
    effects.weighted = effects.rest_weighted + k;
    effects.means = effects.weighted + k;
    const bool done = begin(&effects, objects, estimates, information) &&
                      sweep(&effects, scale, grid, count, sweeps, effects.means + k, result);
    free(memory);
    return done ? DONE : NOT_POSITIVE;
}
