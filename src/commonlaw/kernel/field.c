/* Terms and the law at rows of points: a few points, the lanes, go through each operation together. */
#include "kernel.h"

#include <math.h>
#include <string.h>

static double sign(double x) { return x > 0 ? 1.0 : x < 0 ? -1.0 : x; }

/* Mark what the terms of these coefficients need: those that are not zero, and if wanted those that are free. */
void plan_terms(Workspace *work, Plan *plan, const double *coefficients, bool with_free) {
    const Program *program = &work->model->program;
    int64_t first = program->variables + program->constants;
    memset(plan->values, 0, (size_t)(first + program->operations));
    memset(plan->slopes, 0, (size_t)(first + program->operations));
    plan->terms = plan->count = 0;
    for (int64_t k = 0; k < program->terms; ++k) {
        bool wanted = false, sloped = false;
        for (int64_t e = 0; e < work->d; ++e) {
            wanted |= coefficients[e * program->terms + k] != 0 || (with_free && work->free[e * program->terms + k]);
            sloped |= coefficients[e * program->terms + k] != 0;
        }
        if (!wanted) continue;
        plan->chosen[plan->terms++] = k;
        plan->values[program->outputs[k]] = 1;
        /* Slopes of polynomials are finite; others times zero are as in NumPy */
        if (sloped || !work->polynomial) plan->slopes[program->outputs[k]] = 1;
    }
    for (int64_t m = program->operations - 1; m >= 0; --m) {
        const int64_t *code = program->code + 3 * m;
        if (!plan->values[first + m]) continue;
        for (int each = 1; each < 3; ++each) {
            plan->values[code[each]] = 1;
            plan->slopes[code[each]] |= plan->slopes[first + m];
        }
    }
    for (int64_t m = 0; m < program->operations; ++m)
        if (plan->values[first + m]) plan->operations[plan->count++] = m;
}

/* Fill the value of an operation and, by its operands, its slopes: of the left one, and of the right one. */
void operate(int64_t operation, const double *x, const double *y, double *restrict out, double *restrict left,
             double *restrict right, bool sloped) {
    switch (operation) {
    case ADD: EACH_LANE { out[l] = x[l] + y[l]; left[l] = 1; right[l] = 1; } return;
    case SUBTRACT: EACH_LANE { out[l] = x[l] - y[l]; left[l] = 1; right[l] = -1; } return;
    case MULTIPLY: EACH_LANE { out[l] = x[l] * y[l]; left[l] = y[l]; right[l] = x[l]; } return;
    case DIVIDE: EACH_LANE { out[l] = x[l] / y[l]; left[l] = 1 / y[l]; right[l] = -out[l] / y[l]; } return;
    case NEGATE: EACH_LANE { out[l] = -x[l]; left[l] = -1; } return;
    case ABS: EACH_LANE { out[l] = fabs(x[l]); left[l] = sign(x[l]); } return;
    case SQRT: EACH_LANE { out[l] = sqrt(x[l]); left[l] = out[l] == 0 ? 0.0 : 0.5 / out[l]; } return;
    case EXP: EACH_LANE { out[l] = exp(x[l]); left[l] = out[l]; } return;
    case LOG: EACH_LANE { out[l] = log(x[l]); left[l] = 1 / x[l]; } return;
    case SIGN: EACH_LANE { out[l] = sign(x[l]); left[l] = 0; } return;
    case STEP: EACH_LANE { out[l] = x[l] > 0 ? 1.0 : x[l] <= 0 ? 0.0 : x[l]; left[l] = 0; } return;
    case TAN: EACH_LANE { out[l] = tan(x[l]); left[l] = 1 + out[l] * out[l]; } return;
    case ARCTAN: EACH_LANE { out[l] = atan(x[l]); left[l] = 1 / (1 + x[l] * x[l]); } return;
    case LOG10: EACH_LANE { out[l] = log10(x[l]); left[l] = 1 / (log(10) * x[l]); } return;
    case LOG2: EACH_LANE { out[l] = log2(x[l]); left[l] = 1 / (log(2) * x[l]); } return;
    case FLOOR: EACH_LANE { out[l] = floor(x[l]); left[l] = 0; } return;
    case CEIL: EACH_LANE { out[l] = ceil(x[l]); left[l] = 0; } return;
    case ARCSIN: EACH_LANE { out[l] = asin(x[l]); left[l] = 1 / sqrt((1 - x[l]) * (1 + x[l])); } return;
    case ARCCOS: EACH_LANE { out[l] = acos(x[l]); left[l] = -1 / sqrt((1 - x[l]) * (1 + x[l])); } return;
    case ARCSINH: EACH_LANE { out[l] = asinh(x[l]); left[l] = 1 / sqrt(1 + x[l] * x[l]); } return;
    case ARCCOSH: EACH_LANE { out[l] = acosh(x[l]); left[l] = 1 / (sqrt(x[l] - 1) * sqrt(x[l] + 1)); } return;
    case ARCTANH: EACH_LANE { out[l] = atanh(x[l]); left[l] = 1 / ((1 - x[l]) * (1 + x[l])); } return;
    case ARCTAN2:
        EACH_LANE {
            double square = x[l] * x[l] + y[l] * y[l];
            out[l] = atan2(x[l], y[l]);
            left[l] = y[l] / square;
            right[l] = -x[l] / square;
        }
        return;
    case ERF: EACH_LANE out[l] = erf(x[l]); break;
    case ERFC: EACH_LANE out[l] = erfc(x[l]); break;
    case POWER: EACH_LANE out[l] = pow(x[l], y[l]); break;
    case SIN: EACH_LANE out[l] = sin(x[l]); break;
    case COS: EACH_LANE out[l] = cos(x[l]); break;
    case SINH: EACH_LANE out[l] = sinh(x[l]); break;
    case COSH: EACH_LANE out[l] = cosh(x[l]); break;
    case TANH: EACH_LANE out[l] = tanh(x[l]); break;
    default: EACH_LANE out[l] = NAN; break;
    }
    if (!sloped) return;
    switch (operation) {
    case POWER:
        EACH_LANE {
            bool is_root = y[l] > 0 && y[l] < 1;
            left[l] = x[l] == 0 && is_root ? 0.0 : y[l] * pow(x[l], y[l] - 1);
            right[l] = out[l] == 0 ? 0.0 : out[l] * log(x[l]);
        }
        return;
    case ERF: EACH_LANE left[l] = 2 / sqrt(acos(-1)) * exp(-x[l] * x[l]); return;
    case ERFC: EACH_LANE left[l] = -2 / sqrt(acos(-1)) * exp(-x[l] * x[l]); return;
    case SIN: EACH_LANE left[l] = cos(x[l]); return;
    case COS: EACH_LANE left[l] = -sin(x[l]); return;
    case SINH: EACH_LANE left[l] = cosh(x[l]); return;
    case COSH: EACH_LANE left[l] = sinh(x[l]); return;
    case TANH: EACH_LANE { double c = cosh(x[l]); left[l] = 1 / (c * c); } return;
    default: EACH_LANE left[l] = NAN; return;
    }
}

static void differentiate(const Workspace *work, const int64_t *code, int64_t into, const double *left,
                          const double *right) {
    int64_t S = work->S;
    bool binary = code[0] <= ARCTAN2;
    for (int64_t s = 0; s < S; ++s) {
        if (!work->depends[into * S + s]) continue;
        const double *a = work->slopes + (code[1] * S + s) * LANES, *b = work->slopes + (code[2] * S + s) * LANES;
        double *restrict out = work->slopes + (into * S + s) * LANES;
        bool by_left = work->depends[code[1] * S + s], by_right = binary && work->depends[code[2] * S + s];
        if (by_left && by_right)
            EACH_LANE out[l] = a[l] * left[l] + right[l] * b[l];
        else if (by_left)
            EACH_LANE out[l] = a[l] * left[l];
        else
            EACH_LANE out[l] = right[l] * b[l];
    }
}

static void run(const Workspace *work, const Plan *plan, bool linear) {
    const Program *program = &work->model->program;
    int64_t first = program->variables + program->constants;
    double left[LANES], right[LANES];
    for (int64_t each = 0; each < plan->count; ++each) {
        int64_t into = first + plan->operations[each];
        const int64_t *code = program->code + 3 * plan->operations[each];
        const double *x = work->registers + code[1] * LANES, *y = work->registers + code[2] * LANES;
        double *restrict out = work->registers + into * LANES;
        bool sloped = linear && plan->slopes[into];
        if (code[0] == MULTIPLY) { /* By far the most */
            EACH_LANE out[l] = x[l] * y[l];
            if (sloped) differentiate(work, code, into, y, x);
            continue;
        }
        operate(code[0], x, y, out, left, right, sloped);
        if (sloped) differentiate(work, code, into, left, right);
    }
}

/* Sum the law of the lanes: derivatives (d x lanes), and with `linear` those by states and constants, `slopes`
   (d x S x lanes). */
static void sum_terms(const Workspace *work, const Plan *plan, const double *coefficients, bool linear,
                      double *restrict derivatives, double *restrict slopes) {
    const Program *program = &work->model->program;
    int64_t d = work->d, S = work->S;
    memset(derivatives, 0, sizeof(double) * (size_t)(d * LANES));
    if (linear) memset(slopes, 0, sizeof(double) * (size_t)(d * S * LANES));
    for (int64_t each = 0; each < plan->terms; ++each) {
        int64_t k = plan->chosen[each], at = program->outputs[k];
        const double *value = work->registers + at * LANES;
        for (int64_t e = 0; e < d; ++e) {
            double c = coefficients[e * program->terms + k], *restrict sum = derivatives + e * LANES;
            if (c == 0 && work->polynomial) continue;
            EACH_LANE sum[l] += c * value[l];
            if (!linear) continue;
            for (int64_t s = 0; s < S; ++s) {
                if (!work->depends[at * S + s]) continue;
                const double *slope = work->slopes + (at * S + s) * LANES;
                double *restrict total = slopes + (e * S + s) * LANES;
                EACH_LANE total[l] += c * slope[l];
            }
        }
    }
}

/* Turn the law of states into that of their logarithms; the first d registers hold the states. */
static void follow_logarithms(const Workspace *work, bool linear, double *derivatives, double *slopes) {
    int64_t d = work->d, D = work->D, S = work->S;
    const uint8_t *logarithmic = work->model->logarithmic;
    for (int64_t e = 0; e < d; ++e) {
        if (!logarithmic[e]) continue;
        const double *state = work->registers + e * LANES;
        EACH_LANE derivatives[e * LANES + l] /= state[l];
        for (int64_t s = 0; linear && s < D; ++s) EACH_LANE slopes[(e * S + s) * LANES + l] /= state[l];
    }
    for (int64_t s = 0; linear && s < D; ++s) {
        if (!logarithmic[s]) continue;
        const double *state = work->registers + s * LANES;
        for (int64_t e = 0; e < d; ++e) EACH_LANE slopes[(e * S + s) * LANES + l] *= state[l];
        EACH_LANE slopes[(s * S + s) * LANES + l] -= derivatives[s * LANES + l];
    }
}

/* Set the registers of the constants inside of terms, whose values are coefficients. */
static void set_constants(const Workspace *work, const double *coefficients) {
    const Program *program = &work->model->program;
    for (int64_t q = 0; q < work->c; ++q) {
        double own = 0, *registers = work->registers + (program->variables - work->c + q) * LANES;
        for (int64_t e = 0; e < work->d; ++e) own += coefficients[e * program->terms + work->model->inside_term[q]];
        EACH_LANE registers[l] = own;
    }
}

static void gather(const Workspace *work, int64_t first, int64_t n, const double *states, int64_t stride,
                   const double *inputs, const double *times) {
    int64_t D = work->D, count = work->model->inputs;
    double *registers = work->registers;
    EACH_LANE {
        int64_t i = first + l < n ? first + l : n - 1;
        for (int64_t s = 0; s < D; ++s) registers[s * LANES + l] = states[i * stride + s];
        for (int64_t u = 0; u < count; ++u) registers[(D + u) * LANES + l] = inputs[i * count + u];
        registers[(D + count) * LANES + l] = times[i];
    }
    for (int64_t s = 0; s < D; ++s)
        if (work->model->logarithmic[s]) EACH_LANE registers[s * LANES + l] = exp(registers[s * LANES + l]);
}

/* Put what was found in the lanes into the rows of the points. */
static void scatter(const Workspace *work, const Plan *plan, bool linear, int64_t i, int64_t l, const double *state,
                    const double *derivatives, const double *slopes, Values *out) {
    int64_t d = work->d, D = work->D, c = work->c, S = work->S, rates = D - d;
    const int64_t *second = work->model->second, *highest = work->model->highest;
    for (int64_t e = 0; e < rates; ++e) out->derivatives[i * D + second[e]] = state[d + e];
    for (int64_t e = 0; e < d; ++e) out->derivatives[i * D + highest[e]] = derivatives[e * LANES + l];
    if (!linear) return;
    double *own = out->by_states + i * D * D;
    for (int64_t e = 0; e < rates; ++e) {
        memset(own + second[e] * D, 0, sizeof(double) * (size_t)D);
        own[second[e] * D + d + e] = 1;
    }
    for (int64_t e = 0; e < d; ++e) {
        for (int64_t s = 0; s < D; ++s) own[highest[e] * D + s] = slopes[(e * S + s) * LANES + l];
        for (int64_t q = 0; q < c; ++q) out->by_inside[(i * d + e) * c + q] = slopes[(e * S + D + q) * LANES + l];
    }
    for (int64_t each = 0; each < plan->terms; ++each)
        out->terms[i * plan->terms + each] =
            work->registers[work->model->program.outputs[plan->chosen[each]] * LANES + l];
    for (int64_t e = 0; e < d; ++e)
        out->share[i * d + e] = work->model->logarithmic[e] ? 1 / work->registers[e * LANES + l] : 1.0;
}

/* Fill the law at n points; states stand `stride` numbers apart. */
void field(Workspace *work, const Plan *plan, bool linear, int64_t n, const double *states, int64_t stride,
           const double *inputs, const double *times, const double *coefficients, Values *out) {
    double *derivatives = work->lanes, *slopes = work->lanes + work->d * LANES;
    bool logarithmic = false;
    set_constants(work, coefficients);
    for (int64_t s = 0; s < work->D; ++s) logarithmic |= work->model->logarithmic[s] != 0;
    for (int64_t first = 0; first < n; first += LANES) {
        gather(work, first, n, states, stride, inputs, times);
        run(work, plan, linear);
        sum_terms(work, plan, coefficients, linear, derivatives, slopes);
        if (logarithmic) follow_logarithms(work, linear, derivatives, slopes);
        for (int64_t l = 0; l < LANES && first + l < n; ++l)
            scatter(work, plan, linear, first + l, l, states + (first + l) * stride, derivatives, slopes, out);
    }
}
