/* Memory of one fit, taken once. */
#include "kernel.h"

#include <stdlib.h>
#include <string.h>

/* Hands out parts of one allocation; with nothing to hand out, only counts. */
typedef struct {
    char *start;
    size_t used;
} Arena;

static void *part(Arena *arena, int64_t count, size_t size) {
    void *found = arena->start ? arena->start + arena->used : NULL;
    arena->used += ((size_t)count * size + 63) / 64 * 64;
    return found;
}

static double *numbers(Arena *arena, int64_t count) { return part(arena, count, sizeof(double)); }

static void lay_out_plan(Plan *plan, Arena *arena, const Program *program) {
    int64_t registers = program->variables + program->constants + program->operations;
    plan->operations = part(arena, program->operations, sizeof(int64_t));
    plan->chosen = part(arena, program->terms, sizeof(int64_t));
    plan->values = part(arena, registers, 1);
    plan->slopes = part(arena, registers, 1);
}

static void lay_out(Workspace *work, Arena *arena, int64_t terms, int64_t longest, int64_t points) {
    const Program *program = &work->model->program;
    const int64_t d = work->d, D = work->D, c = work->c, S = work->S;
    const int64_t F = work->F, columns = work->q + work->p + 1, wide = work->p + 1;
    const int64_t registers = program->variables + program->constants + program->operations;
    work->equation = part(arena, work->p, sizeof(int64_t));
    work->column = part(arena, work->p, sizeof(int64_t));
    work->constant = part(arena, program->terms, sizeof(int64_t));
    lay_out_plan(&work->kept, arena, program);
    lay_out_plan(&work->other, arena, program);
    work->depends = part(arena, registers * S, 1);
    work->registers = numbers(arena, registers * LANES);
    work->slopes = numbers(arena, registers * S * LANES);
    work->lanes = numbers(arena, (d + d * S) * LANES);
    work->middle_states = numbers(arena, longest * D);
    for (int each = 0; each < 3; ++each) {
        work->at[each].terms = numbers(arena, longest * terms);
        work->at[each].derivatives = numbers(arena, longest * D);
        work->at[each].by_states = numbers(arena, longest * D * D);
        work->at[each].share = numbers(arena, longest * d);
        work->at[each].by_inside = numbers(arena, longest * d * c);
    }
    work->factor = numbers(arena, points * F * F);
    work->beside = numbers(arena, points * F * F);
    work->border = numbers(arena, points * F * columns);
    work->drift = numbers(arena, points * work->q * columns);
    work->information = numbers(arena, wide * wide);
    work->of_mesh = numbers(arena, wide * wide);
    work->of_segment = numbers(arena, work->q ? columns * columns : 0);
    work->rows = numbers(arena, (TOGETHER + D) * columns);
    work->blocks = numbers(arena, 5 * F * F + 2 * F + F * columns);
    work->right = numbers(arena, F * columns);
    work->next = numbers(arena, F * columns);
}

/* Set what never changes: numbers, the slopes of the variables, and on which of these each register depends. */
static void begin_registers(Workspace *work) {
    const Program *program = &work->model->program;
    const int64_t D = work->D, c = work->c, S = work->S, first = program->variables + program->constants;
    memset(work->depends, 0, (size_t)((first + program->operations) * S));
    memset(work->slopes, 0, sizeof(double) * (size_t)((first + program->operations) * S * LANES));
    for (int64_t s = 0; s < S; ++s) {
        const int64_t at = s < D ? s : program->variables - c + s - D;
        work->depends[at * S + s] = 1;
        for (int64_t l = 0; l < LANES; ++l) work->slopes[(at * S + s) * LANES + l] = 1;
    }
    for (int64_t k = 0; k < program->terms; ++k) work->constant[k] = -1;
    for (int64_t q = 0; q < c; ++q) work->constant[work->model->inside_term[q]] = q;
    for (int64_t k = 0; k < program->constants; ++k)
        for (int64_t l = 0; l < LANES; ++l) work->registers[(program->variables + k) * LANES + l] = program->values[k];
    work->polynomial = true;
    for (int64_t m = 0; m < program->operations; ++m) {
        const int64_t *code = program->code + 3 * m;
        work->polynomial &= code[0] <= 2; /* Sums, differences, products */
        for (int64_t s = 0; s < S; ++s)
            work->depends[(first + m) * S + s] = work->depends[code[1] * S + s] | work->depends[code[2] * S + s];
    }
}

/* Take memory for fits of a model with these free coefficients; `memory` is to be freed. */
bool open_workspace(Workspace *work, const Model *model, const uint8_t *free_ones, const double *coefficients,
                    int64_t longest, int64_t points, void **memory) {
    const int64_t d = model->equations, terms = model->program.terms;
    memset(work, 0, sizeof *work);
    work->model = model;
    work->free = free_ones;
    work->d = d;
    work->D = d + model->rates;
    work->w = model->latent;
    work->W = work->D + work->w;
    work->q = model->drift ? work->w : 0;
    work->F = work->W - work->q;
    work->c = model->inside;
    work->S = work->D + work->c;
    for (int64_t k = 0; k < d * terms; ++k) work->p += free_ones[k] != 0;
    Arena arena = {NULL, 0};
    lay_out(work, &arena, terms, longest, points);
    arena.start = *memory = malloc(arena.used ? arena.used : 1);
    if (!arena.start) return false;
    arena.used = 0;
    lay_out(work, &arena, terms, longest, points);
    begin_registers(work);
    plan_terms(work, &work->kept, coefficients, true);
    int64_t r = 0;
    for (int64_t e = 0; e < d; ++e)
        for (int64_t each = 0; each < work->kept.terms; ++each) {
            if (!free_ones[e * terms + work->kept.chosen[each]]) continue;
            work->equation[r] = e;
            work->column[r++] = each;
        }
    return true;
}

#ifndef SOURCES
#define SOURCES ""
#endif

/* What tells of which sources the kernel was built, see hatch_build.py. */
EXPORTED const char *commonlaw_sources(void) { return SOURCES; }

/* How large structures are, so that callers can see whether theirs are the same. */
EXPORTED void commonlaw_sizes(int64_t *out) {
    out[0] = sizeof(Program);
    out[1] = sizeof(Model);
    out[2] = sizeof(Mesh);
    out[3] = sizeof(Measured);
}
