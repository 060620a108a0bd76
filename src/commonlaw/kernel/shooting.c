/* Initial value problems with derivatives of their solutions: Radau IIA of order 5 (Hairer and Wanner 1996, Solving
   Ordinary Differential Equations II, IV.8), whose steps end at the times that are wanted and where inputs change their
   course. Each step is solved by Newton's method with exact Jacobians; derivatives are those of the step itself.

   Switches are variables of the program, 0 or 1 and constant in a step, which ends where one of them changes: where the
   value that says whether it is 1 crosses zero. There, derivatives jump as f does, times how the crossing moves. The last
   switches are events, which give the states new values when they turn on.

   D states, U inputs, P parameters, K switches, E of them events, V = D + U + 1 + P + K variables of the program, whose
   outputs are the rates, what decides the switches, and the D states after each event; Q = P + D columns of derivatives. */
#include "kernel.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

enum { STAGES = 3, MOST_ROUNDS = 10 };

static const double FAR = 1e15; /* Of a state, in absolute over relative tolerances */

static const double ROOT = 2.449489742783178; /* of 6 */
#define NODE_1 ((4 - ROOT) / 10)
#define NODE_2 ((4 + ROOT) / 10)

typedef struct {
    const Program *program;
    int64_t D, U, P, K, E, V, Q;
    const double *parameters;
    int64_t pieces, powers, columns; /* of inputs */
    const double *knots, *polynomials;
    const int64_t *column, *delay; /* U: which input it is, and the parameter by which it comes later, or -1 */
    uint8_t *depends;              /* registers x V */
    double *registers, *slopes;    /* registers x LANES, registers x V x LANES */
    double weights[STAGES][STAGES];
} Shooting;

/* Fill f at the lanes, D x LANES, and with `linear` its slopes by all variables, D x V x LANES; the variables' registers
   are set. */
static void run_program(Shooting *s, bool linear) {
    const Program *program = s->program;
    int64_t first = program->variables + program->constants, V = s->V;
    double left[LANES], right[LANES];
    for (int64_t m = 0; m < program->operations; ++m) {
        const int64_t *code = program->code + 3 * m;
        bool binary = code[0] <= ARCTAN2;
        operate(code[0], s->registers + code[1] * LANES, s->registers + code[2] * LANES,
                s->registers + (first + m) * LANES, left, right, linear);
        if (!linear) continue;
        for (int64_t v = 0; v < V; ++v) {
            if (!s->depends[(first + m) * V + v]) continue;
            const double *a = s->slopes + (code[1] * V + v) * LANES, *b = s->slopes + (code[2] * V + v) * LANES;
            double *out = s->slopes + ((first + m) * V + v) * LANES;
            bool by_left = s->depends[code[1] * V + v], by_right = binary && s->depends[code[2] * V + v];
            EACH_LANE out[l] = (by_left ? a[l] * left[l] : 0.0) + (by_right ? b[l] * right[l] : 0.0);
        }
    }
}

static double delay_of(const Shooting *s, int64_t u) { return s->delay[u] < 0 ? 0.0 : s->parameters[s->delay[u]]; }

/* Set an input and its rate of change, at a time of the step whose middle says which polynomial holds. */
static void input_at(const Shooting *s, int64_t u, double middle, double time, double *value, double *rate) {
    double delay = delay_of(s, u);
    int64_t low = 0, high = s->pieces; /* knots[low] <= middle - delay < knots[high], or low = 0 */
    while (high - low > 1) {
        int64_t between = (low + high) / 2;
        if (s->knots[between] <= middle - delay) low = between; else high = between;
    }
    bool before = middle - delay < s->knots[0];
    double since = before ? 0.0 : time - delay - s->knots[low], sum = 0, slope = 0;
    const double *own = s->polynomials + low * s->powers * s->columns + s->column[u];
    for (int64_t k = s->powers - 1; k >= 0; --k) {
        slope = slope * since + sum;
        sum = sum * since + own[k * s->columns];
    }
    *value = sum;
    *rate = before ? 0.0 : slope;
}

/* Set the registers of one lane; `rates` has those of the inputs, U x LANES. */
static void set_lane(const Shooting *s, int lane, double middle, double time, const double *states, double *rates) {
    for (int64_t i = 0; i < s->D; ++i) s->registers[i * LANES + lane] = states[i];
    for (int64_t u = 0; u < s->U; ++u)
        input_at(s, u, middle, time, s->registers + (s->D + u) * LANES + lane, rates + u * LANES + lane);
    s->registers[(s->D + s->U) * LANES + lane] = time;
}

static double value_of(const Shooting *s, int64_t i, int lane) {
    return s->registers[s->program->outputs[i] * LANES + lane];
}

static double slope_of(const Shooting *s, int64_t i, int64_t v, int lane) {
    int64_t at = s->program->outputs[i] * s->V + v;
    return s->depends[at] ? s->slopes[at * LANES + lane] : 0.0;
}

/* The derivative of f by parameter p, which may be the delay of inputs. */
static double by_parameter(const Shooting *s, int64_t i, int64_t p, int lane, const double *rates) {
    double found = slope_of(s, i, s->D + s->U + 1 + p, lane);
    for (int64_t u = 0; u < s->U; ++u)
        if (s->delay[u] == p) found -= slope_of(s, i, s->D + u, lane) * rates[u * LANES + lane];
    return found;
}

static bool factor(double *matrix, int64_t n, int64_t *pivots) {
    for (int64_t k = 0; k < n; ++k) {
        int64_t best = k;
        for (int64_t i = k + 1; i < n; ++i)
            if (fabs(matrix[i * n + k]) > fabs(matrix[best * n + k])) best = i;
        pivots[k] = best;
        double pivot = matrix[best * n + k];
        if (!(fabs(pivot) > 0) || !isfinite(pivot)) return false;
        if (best != k)
            for (int64_t j = 0; j < n; ++j) {
                double kept = matrix[k * n + j];
                matrix[k * n + j] = matrix[best * n + j];
                matrix[best * n + j] = kept;
            }
        for (int64_t i = k + 1; i < n; ++i) {
            double share = matrix[i * n + k] /= pivot;
            if (share == 0) continue;
            for (int64_t j = k + 1; j < n; ++j) matrix[i * n + j] -= share * matrix[k * n + j];
        }
    }
    return true;
}

/* Solve for several right-hand sides, n x columns, in place. */
static void substitute(const double *matrix, int64_t n, const int64_t *pivots, double *right, int64_t columns) {
    for (int64_t k = 0; k < n; ++k)
        if (pivots[k] != k)
            for (int64_t j = 0; j < columns; ++j) {
                double kept = right[k * columns + j];
                right[k * columns + j] = right[pivots[k] * columns + j];
                right[pivots[k] * columns + j] = kept;
            }
    for (int64_t k = 0; k < n; ++k)
        for (int64_t i = k + 1; i < n; ++i) {
            double share = matrix[i * n + k];
            if (share != 0)
                for (int64_t j = 0; j < columns; ++j) right[i * columns + j] -= share * right[k * columns + j];
        }
    for (int64_t k = n - 1; k >= 0; --k) {
        for (int64_t j = 0; j < columns; ++j) right[k * columns + j] /= matrix[k * n + k];
        for (int64_t i = 0; i < k; ++i) {
            double share = matrix[i * n + k];
            if (share != 0)
                for (int64_t j = 0; j < columns; ++j) right[i * columns + j] -= share * right[k * columns + j];
        }
    }
}

/* Run the program at the start of a step and at its stages. */
static void run_stages(Shooting *s, double time, double step, const double *states, const double *stages, double *rates,
                       double *point, bool linear) {
    const double nodes[STAGES] = {NODE_1, NODE_2, 1.0};
    double middle = time + step / 2;
    set_lane(s, 0, middle, time, states, rates);
    for (int a = 0; a < STAGES; ++a) {
        for (int64_t i = 0; i < s->D; ++i) point[i] = states[i] + stages[a * s->D + i];
        set_lane(s, a + 1, middle, time + nodes[a] * step, point, rates);
    }
    run_program(s, linear);
}

/* Fill 1 - h A x J. */
static void fill_matrix(const Shooting *s, double step, double *matrix) {
    int64_t D = s->D, n = STAGES * D;
    for (int a = 0; a < STAGES; ++a)
        for (int64_t i = 0; i < D; ++i)
            for (int b = 0; b < STAGES; ++b)
                for (int64_t j = 0; j < D; ++j)
                    matrix[(a * D + i) * n + b * D + j] =
                        (a == b && i == j) - step * s->weights[a][b] * slope_of(s, i, j, b + 1);
}

/* Where inputs change their course, between two times. */
static double next_stop(const Shooting *s, double time, double until) {
    for (int64_t u = 0; u < s->U; ++u)
        for (int64_t k = 0; k < s->pieces; ++k) {
            double at = s->knots[k] + delay_of(s, u);
            if (at > time && at < until) until = at;
        }
    return until;
}

/* Add what a stop that moves with a delay does to the derivatives: f before less f after, by the delay. */
static void cross_stop(Shooting *s, double time, double step, const double *states, double *by, double *rates,
                       double *change) {
    for (int64_t u = 0; u < s->U; ++u) {
        if (s->delay[u] < 0) continue;
        bool here = false;
        for (int64_t k = 0; k < s->pieces; ++k) here |= s->knots[k] + delay_of(s, u) == time;
        if (!here) continue;
        set_lane(s, 0, time - step / 2, time, states, rates);
        set_lane(s, 1, time + step / 2, time, states, rates);
        double after, ignored; /* Of this input alone */
        input_at(s, u, time + step / 2, time, &after, &ignored);
        for (int64_t v = 0; v < s->U; ++v)
            s->registers[(s->D + v) * LANES + 1] = s->registers[(s->D + v) * LANES];
        s->registers[(s->D + u) * LANES + 1] = after;
        run_program(s, false);
        for (int64_t i = 0; i < s->D; ++i) change[i] = value_of(s, i, 0) - value_of(s, i, 1);
        for (int64_t i = 0; i < s->D; ++i) by[i * s->Q + s->delay[u]] += change[i];
    }
}

static double *switch_at(const Shooting *s, int64_t k) { return s->registers + (s->D + s->U + 1 + s->P + k) * LANES; }

static bool is_event(const Shooting *s, int64_t k) { return k >= s->K - s->E; }

/* The derivative of an output by time along the solution, the program being run with slopes. */
static double along(const Shooting *s, int64_t output, const double *rates) {
    double found = slope_of(s, output, s->D + s->U, 0);
    for (int64_t i = 0; i < s->D; ++i) found += slope_of(s, output, i, 0) * value_of(s, i, 0);
    for (int64_t u = 0; u < s->U; ++u) found += slope_of(s, output, s->D + u, 0) * rates[u * LANES];
    return found;
}

/* The derivative of an output by parameter or start q, through the states whose derivatives are given, too. */
static double total(const Shooting *s, int64_t output, int64_t q, const double *by, const double *rates) {
    double found = q < s->P ? by_parameter(s, output, q, 0, rates) : 0.0;
    for (int64_t i = 0; i < s->D; ++i) found += slope_of(s, output, i, 0) * by[i * s->Q + q];
    return found;
}

/* Set the switches where the solution is at the first time and afterwards, or after an event; what decides one may depend
   on others. Events turn off only: what turns one on is that it occurs. */
static void set_switches(Shooting *s, double time, double until, const double *states, double *rates) {
    for (int64_t round = 0; round < s->K + 1; ++round) {
        set_lane(s, 0, (time + until) / 2, time, states, rates);
        run_program(s, true);
        for (int64_t k = 0; k < s->K; ++k) {
            double value = value_of(s, s->D + k, 0);
            bool on = value > 0 || (value == 0 && along(s, s->D + k, rates) > 0);
            if (is_event(s, k)) on = value > 0 && switch_at(s, k)[0] > 0;
            EACH_LANE switch_at(s, k)[l] = on;
        }
    }
}

/* Which switch has changed at the end of a step, and by which share of the step, at a first guess; or -1. It has `jumped` if
   an input made it change before the step. */
static int64_t crossed_switch(Shooting *s, double time, double end, const double *states, const double *change,
                              double *rates, double *point, double *share, bool *jumped) {
    int64_t found = -1;
    *share = 1;
    set_lane(s, 0, (time + end) / 2, time, states, rates);
    for (int64_t i = 0; i < s->D; ++i) point[i] = states[i] + change[i];
    set_lane(s, 1, (time + end) / 2, end, point, rates);
    run_program(s, false);
    for (int64_t k = 0; k < s->K; ++k) {
        double before = value_of(s, s->D + k, 0), after = value_of(s, s->D + k, 1);
        bool on = switch_at(s, k)[0] > 0;
        if (on ? after > 0 : after <= 0) continue;
        double own = on == (before > 0) && before != after ? before / (before - after) : 0;
        if (found < 0 || own < *share) *share = own, found = k, *jumped = on ? before < 0 : before > 0;
    }
    return found;
}

/* Change a switch where its value g crosses zero. There x becomes r(x, u, t, p), which is x itself but in events, and the
   derivatives S become r_x S + r_q + (dr/dt - f_after) dt/dq, where dt/dq = -(g_x S + g_q) / (dg/dt), or zero for a jump.
   Events that the new states bring about occur at once; returns how many changes there were. An event turns off without one. */
static int64_t cross_switch(Shooting *s, int64_t k, bool jumped, double time, double step, double *states, double *by,
                            double *rates, double *after, double *shift, double *moved) {
    int64_t D = s->D, Q = s->Q, count = 0;
    double middle = time - step / 2;
    bool on = switch_at(s, k)[0] > 0, occurs = is_event(s, k) && !on;
    if (on && is_event(s, k)) {
        EACH_LANE switch_at(s, k)[l] = 0.0;
        return 0;
    }
    for (; k >= 0 && count < MAX_CROSSINGS; ++count) {
        int64_t first = D + s->K + (k - s->K + s->E) * D;
        set_lane(s, 0, middle, time, states, rates);
        run_program(s, true);
        double speed = along(s, D + k, rates);
        for (int64_t q = 0; q < Q && by && count == 0; ++q)
            shift[q] = jumped || speed == 0 ? 0.0 : -total(s, D + k, q, by, rates) / speed;
        for (int64_t i = 0; i < D; ++i) {
            after[i] = occurs ? value_of(s, first + i, 0) : states[i];
            double rate = occurs ? along(s, first + i, rates) : value_of(s, i, 0);
            for (int64_t q = 0; q < Q && by; ++q)
                moved[i * Q + q] = (occurs ? total(s, first + i, q, by, rates) : by[i * Q + q]) + rate * shift[q];
        }
        memcpy(states, after, sizeof(double) * (size_t)D);
        EACH_LANE switch_at(s, k)[l] = !on;
        k = -1;
        if (occurs) set_switches(s, time, time - step, states, rates);
        set_lane(s, 0, middle, time, states, rates);
        run_program(s, false);
        for (int64_t i = 0; i < D && by; ++i)
            for (int64_t q = 0; q < Q; ++q) by[i * Q + q] = moved[i * Q + q] - value_of(s, i, 0) * shift[q];
        for (int64_t e = s->K - s->E; e < s->K && occurs; ++e)
            if (value_of(s, D + e, 0) > 0 && switch_at(s, e)[0] == 0) k = e;
    }
    return count;
}

/* Fill the states at increasing times, n x D, from those at the first, and unless `by` is empty their derivatives by
   parameters and starts, n x D x Q; returns how many times were reached, or minus that before infinitely many crossings. */
EXPORTED int64_t commonlaw_shoot(const Program *program, int64_t states, int64_t inputs, int64_t parameters,
                                 const double *values, int64_t count, const double *times, int64_t pieces, int64_t powers,
                                 int64_t columns, const double *knots, const double *polynomials, const int64_t *column,
                                 const int64_t *delay, double relative, const double *absolute, int64_t most_steps,
                                 double *solution, double *by) {
    Shooting own = {0}, *s = &own;
    s->program = program;
    s->D = states, s->U = inputs, s->P = parameters, s->V = program->variables, s->Q = parameters + states;
    s->K = s->V - states - inputs - 1 - parameters, s->E = states ? (program->terms - states - s->K) / states : 0;
    s->parameters = values;
    s->pieces = pieces, s->powers = powers, s->columns = columns;
    s->knots = knots, s->polynomials = polynomials, s->column = column, s->delay = delay;
    int64_t D = s->D, V = s->V, Q = s->Q, n = STAGES * D;
    int64_t registers = program->variables + program->constants + program->operations;
    const double weights[STAGES][STAGES] = {
        {(88 - 7 * ROOT) / 360, (296 - 169 * ROOT) / 1800, (-2 + 3 * ROOT) / 225},
        {(296 + 169 * ROOT) / 1800, (88 + 7 * ROOT) / 360, (-2 - 3 * ROOT) / 225},
        {(16 - ROOT) / 36, (16 + ROOT) / 36, 1.0 / 9},
    };
    memcpy(s->weights, weights, sizeof weights);
    const double slow = 1 / ((6 + cbrt(81.0) - cbrt(9.0)) / 30); /* the real eigenvalue of the inverse of the weights */
    const double errors[STAGES] = {-(13 + 7 * ROOT) / 3, (-13 + 7 * ROOT) / 3, -1.0 / 3};

    int64_t doubles = registers * LANES * (1 + V) + inputs * LANES + 8 * D + 4 * n + n * n + D * D + n * Q + 2 * D * Q + Q;
    double *memory = malloc(sizeof(double) * (size_t)(doubles > 0 ? doubles : 1));
    uint8_t *depends = calloc((size_t)(registers * V), 1);
    int64_t *pivots = malloc(sizeof(int64_t) * (size_t)n);
    int64_t reached = 0;
    if (!memory || !depends || !pivots) goto end;
    double *at = memory;
    s->registers = at, at += registers * LANES;
    s->slopes = at, at += registers * LANES * V;
    double *rates = at; at += inputs * LANES;
    double *here = at; at += D;
    double *point = at; at += D;
    double *scale = at; at += D;
    double *error = at; at += D;
    double *first = at; at += D;
    double *stages = at; at += n;
    double *kept = at; at += n;
    double *residual = at; at += n;
    double *matrix = at; at += n * n;
    double *small = at; at += D * D;
    double *right = at; at += n * Q;
    double *derivatives = at; at += D * Q;
    double *moved = at; at += D * Q;
    double *shift = at;
    s->depends = depends;
    for (int64_t v = 0; v < V; ++v) {
        depends[v * V + v] = 1;
        EACH_LANE s->slopes[(v * V + v) * LANES + l] = 1.0;
    }
    for (int64_t m = 0; m < program->operations; ++m) {
        const int64_t *code = program->code + 3 * m;
        int64_t into = program->variables + program->constants + m;
        for (int64_t v = 0; v < V; ++v) depends[into * V + v] = depends[code[1] * V + v] | depends[code[2] * V + v];
    }
    EACH_LANE {
        for (int64_t v = 0; v < V; ++v) s->registers[v * LANES + l] = 0.0;
        for (int64_t p = 0; p < parameters; ++p) s->registers[(D + inputs + 1 + p) * LANES + l] = values[p];
        for (int64_t c = 0; c < program->constants; ++c)
            s->registers[(program->variables + c) * LANES + l] = program->values[c];
    }

    memcpy(here, solution, sizeof(double) * (size_t)D);
    reached = 1;
    if (by) { /* Those at the first time are given: by starts they are one */
        memset(by, 0, sizeof(double) * (size_t)(D * Q));
        for (int64_t i = 0; i < D; ++i) by[i * Q + parameters + i] = 1.0;
        memcpy(derivatives, by, sizeof(double) * (size_t)(D * Q));
    }
    double time = times[0], step = 0, last_step = 0, before_crossing = INFINITY;
    double span = fmax(fabs(time), times[count - 1] - time);
    int64_t crossings = 0, last_event = -1;
    double last_occurrence = 0;
    bool stopped = false, endless = false;
    for (int64_t k = s->K - s->E; k < s->K; ++k) EACH_LANE switch_at(s, k)[l] = 1.0;
    if (s->K && count > 1) set_switches(s, time, times[1], here, rates);
    for (int64_t taken = 0, k = 1; k < count && taken < most_steps; ++taken) {
        double stop = next_stop(s, time, times[k]);
        for (int64_t i = 0; i < D; ++i) scale[i] = absolute[i] + relative * fabs(here[i]);
        if (step == 0) { /* A hundredth of what the first rates need to change the states */
            memset(stages, 0, sizeof(double) * (size_t)n);
            run_stages(s, time, stop - time, here, stages, rates, point, false);
            double size = 0, speed = 0;
            for (int64_t i = 0; i < D; ++i) {
                size = fmax(size, fabs(here[i]) / scale[i]);
                speed = fmax(speed, fabs(value_of(s, i, 0)) / scale[i]);
            }
            step = size > 0 && speed > 0 ? 0.01 * size / speed : 1e-3 * (stop - time);
            if (!isfinite(step) || step <= 0) break;
        }
        double length = fmin(fmin(step, stop - time), before_crossing);
        if (length < before_crossing && stop - time < 1.1 * length) length = stop - time;
        bool full = length == stop - time;
        if (stopped && by) cross_stop(s, time, fmin(length, 1e-6 * length), here, derivatives, rates, point);
        stopped = false;

        /* The polynomial of the last step, continued, begins Newton's method */
        if (last_step > 0) {
            const double c[4] = {0, NODE_1, NODE_2, 1.0};
            memcpy(kept, stages, sizeof(double) * (size_t)n);
            for (int a = 0; a < STAGES; ++a) {
                double where = 1 + c[a + 1] * length / last_step, share[STAGES];
                for (int b = 0; b < STAGES; ++b) {
                    share[b] = 1;
                    for (int e = 0; e < 4; ++e)
                        if (e != b + 1) share[b] *= (where - c[e]) / (c[b + 1] - c[e]);
                }
                for (int64_t i = 0; i < D; ++i) {
                    double sum = -kept[2 * D + i];
                    for (int b = 0; b < STAGES; ++b) sum += share[b] * kept[b * D + i];
                    stages[a * D + i] = sum;
                }
            }
        } else memset(stages, 0, sizeof(double) * (size_t)n);

        /* The matrix of the first round serves the others, unless these converge slowly */
        bool solved = false, fresh = true;
        double ratio = INFINITY, before = INFINITY;
        for (int round = 0; round < MOST_ROUNDS && !solved; ++round) {
            run_stages(s, time, length, here, stages, rates, point, fresh);
            if (round == 0)
                for (int64_t i = 0; i < D; ++i) {
                    first[i] = value_of(s, i, 0);
                    for (int64_t j = 0; j < D; ++j) small[i * D + j] = (i == j) * slow / length - slope_of(s, i, j, 0);
                }
            if (fresh) {
                fill_matrix(s, length, matrix);
                if (!factor(matrix, n, pivots)) break;
            }
            for (int a = 0; a < STAGES; ++a)
                for (int64_t i = 0; i < D; ++i) {
                    double sum = -stages[a * D + i];
                    for (int b = 0; b < STAGES; ++b) sum += length * s->weights[a][b] * value_of(s, i, b + 1);
                    residual[a * D + i] = sum;
                }
            substitute(matrix, n, pivots, residual, 1);
            double size = 0;
            for (int64_t i = 0; i < n; ++i) {
                stages[i] += residual[i];
                size = fmax(size, fabs(residual[i]) / scale[i % D]);
            }
            if (!isfinite(size)) break;
            double rate = size / before;
            solved = size < 1e-2 && (fresh || rate < 0.1 || size < 1e-4);
            fresh = !solved && rate > 0.1 && round > 0;
            before = size;
        }
        if (solved) {
            for (int64_t i = 0; i < D; ++i) {
                error[i] = first[i];
                for (int a = 0; a < STAGES; ++a) error[i] += errors[a] / length * stages[a * D + i];
            }
            if (factor(small, D, pivots)) {
                substitute(small, D, pivots, error, 1);
                double sum = 0;
                for (int64_t i = 0; i < D; ++i) {
                    double end = fabs(here[i] + stages[2 * D + i]);
                    double one = error[i] / (absolute[i] + relative * fmax(fabs(here[i]), end));
                    sum += one * one;
                }
                ratio = sqrt(sum / (double)D);
            }
        }
        if (!(ratio <= 1)) {
            step = length * (isfinite(ratio) ? fmax(0.2, 0.9 * pow(ratio, -0.25)) : 0.25);
            last_step = 0;
            if (step < 1e-13 * fmax(fabs(time), times[count - 1] - times[0])) break;
            continue;
        }
        int64_t crossed = -1;
        bool jumped = false;
        if (s->K) {
            double share;
            crossed = crossed_switch(s, time, full ? stop : time + length, here, stages + 2 * D, rates, point, &share, &jumped);
            if (crossed >= 0 && (1 - share) * length > CROSSING * span) { /* It should end there: regula falsi, bisection */
                before_crossing = length * (taken % 4 == 3 ? 0.5 : share) + 0.5 * CROSSING * span;
                last_step = 0;
                continue;
            }
            before_crossing = INFINITY;
        }
        if (by) {
            run_stages(s, time, length, here, stages, rates, point, true);
            fill_matrix(s, length, matrix);
            if (!factor(matrix, n, pivots)) break;
            for (int a = 0; a < STAGES; ++a)
                for (int64_t i = 0; i < D; ++i)
                    memset(right + (a * D + i) * Q, 0, sizeof(double) * (size_t)Q);
            for (int b = 0; b < STAGES; ++b)
                for (int64_t i = 0; i < D; ++i)
                    for (int64_t q = 0; q < Q; ++q) {
                        double push = q < parameters ? by_parameter(s, i, q, b + 1, rates) : 0.0;
                        for (int64_t j = 0; j < D; ++j)
                            push += slope_of(s, i, j, b + 1) * derivatives[j * Q + q];
                        for (int a = 0; a < STAGES; ++a)
                            right[(a * D + i) * Q + q] += length * s->weights[a][b] * push;
                    }
            substitute(matrix, n, pivots, right, Q);
            for (int64_t i = 0; i < D * Q; ++i) derivatives[i] += right[2 * D * Q + i];
        }
        bool far = false;
        for (int64_t i = 0; i < D; ++i) {
            here[i] += stages[2 * D + i];
            far |= fabs(here[i]) > FAR * absolute[i] / relative;
        }
        if (far) break; /* It runs away */
        time = full ? stop : time + length;
        last_step = length;
        double factor_of_step = fmin(8.0, 0.9 * pow(fmax(ratio, 1e-10), -0.25));
        if (!full || factor_of_step < 1 || length * factor_of_step > step) step = length * fmax(0.2, factor_of_step);
        if (crossed >= 0) {
            bool occurs = is_event(s, crossed) && switch_at(s, crossed)[0] == 0;
            endless = occurs && crossed == last_event && time - last_occurrence < MIN_INTERVAL * (times[count - 1] - times[0]);
            if (occurs) last_event = crossed, last_occurrence = time;
            crossings += cross_switch(s, crossed, jumped, time, length, here, by ? derivatives : NULL, rates, point, shift,
                                      moved);
            step = last_step = 0;
            endless |= crossings > MAX_CROSSINGS; /* It slides along the switch */
            if (endless) break;
        }
        if (full && stop < times[k]) {
            stopped = true;
            last_step = 0;
        }
        if (full && stop == times[k]) {
            memcpy(solution + k * D, here, sizeof(double) * (size_t)D);
            if (by) memcpy(by + k * D * Q, derivatives, sizeof(double) * (size_t)(D * Q));
            reached = ++k;
            for (int64_t u = 0; u < inputs && !stopped; ++u)
                for (int64_t p = 0; p < pieces; ++p) stopped |= knots[p] + delay_of(s, u) == time;
            if (stopped) last_step = 0;
        }
    }
end:
    free(memory);
    free(depends);
    free(pivots);
    return endless ? -reached : reached;
}
