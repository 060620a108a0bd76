/* The compiled fit of one object: what fitting.py and linearization.py do, for terms that are programs.

   Arrays are in C order. Sizes: d equations, D states (d, and the rates of some), w latent processes, W = D + w, n points of
   a mesh, K terms, p parameters (the free coefficients), c constants inside of terms, S = D + c, q numbers of the drift
   of a segment (2 d, or none), F what is eliminated point by point (D with a drift, else W). Structures are those of
   Python, field by field. */
#ifndef COMMONLAW_KERNEL_H
#define COMMONLAW_KERNEL_H

#include "constants.h"

#include <stdbool.h>
#include <stdint.h>

#if defined(_WIN32)
#define EXPORTED __declspec(dllexport)
#else
#define EXPORTED __attribute__((visibility("default")))
#endif

#define EACH_LANE for (int l = 0; l < LANES; ++l)

#if defined(__GNUC__)
#define INLINED static inline __attribute__((always_inline))
#else
#define INLINED static inline
#endif

enum { DONE = 0, NO_MEMORY = 1, NOT_POSITIVE = 2 };

enum {
    LANES = 8,    /* points that go through the terms together */
    TOGETHER = 32 /* rows that are added to the information together, so that it is seldom loaded */
};

/* Terms, see library/program.py. */
typedef struct {
    int64_t variables, constants, operations, terms;
    const double *values;   /* constants */
    const int64_t *code;    /* operations x 3 */
    const int64_t *outputs; /* terms */
} Program;

/* What is the same for all meshes of an object. */
typedef struct {
    int64_t equations, rates, inputs, latent, held, correlated;
    int64_t walks;              /* whether autocorrelated errors are Wiener processes, zero at first points */
    int64_t drift;              /* whether latent processes are those of a drift, d errors and d slopes */
    int64_t rejects;            /* whether outliers have no weight */
    int64_t force;              /* the first latent process that is a force; negative without any */
    int64_t inside;             /* constants inside of terms, the last variables */
    double huber_threshold;
    const double *unit;         /* D: of the model error */
    const double *latent_std;   /* w: of latent processes, of Wiener processes after a unit of time */
    const double *latent_mean;  /* w: at first points */
    const uint8_t *logarithmic; /* D: which states are logarithms */
    const int64_t *inside_term; /* inside: the term whose coefficient each such constant is */
    const int64_t *second;      /* rates: the state of each rate, which are the last D - d states */
    const int64_t *highest;     /* d: the state whose derivative each equation gives */
    const double *typical, *precision; /* d x K: of the prior of coefficients; no addresses without one */
    Program program;
} Model;

/* One mesh: points of one or several segments. */
typedef struct {
    int64_t points;
    double typical_step;
    const double *times, *middle_times, *steps;
    const double *walk;                                /* n - 1 x d: variances relative to that in a usual step */
    const double *measured;                            /* n x d; not a number where nothing was measured */
    const double *inputs, *middle_inputs;              /* n x inputs */
    const uint8_t *contiguous;                         /* n - 1 */
    const double *std;                                 /* n x d */
    const double *latent_start, *latent_end, *anchors; /* n - 1 x w x w twice, n x w */
} Mesh;

/* The weight of a measurement by its standardized residual, relative to that of one within the threshold. */
INLINED double relative_weight(const Model *model, double size) {
    if (!(size > model->huber_threshold)) return 1;
    return model->rejects ? 0 : model->huber_threshold / size;
}

/* How surely measurements tell the scale of all noise, see evidence.py. */
typedef struct {
    double count, freedom, prior, outliers, least;
} Measured;

/* Fills the solution of least norm of a symmetric system of p rows; returns whether there is one. */
typedef int (*LeastNorm)(int64_t p, const double *matrix, const double *right, double *solution);

/* The law and its derivatives at a row of points. */
typedef struct {
    double *terms;       /* n x kept: of the kept terms */
    double *derivatives; /* n x D */
    double *by_states;   /* n x D x D */
    double *share;       /* n x d: what a term adds to the derivative of its state; 1 unless that is a logarithm */
    double *by_inside;   /* n x d x c: of the sums of terms by the constants inside of them */
} Values;

enum { START, END, MIDDLE };

/* Operations, in the order of library/grammar.py; those up to ARCTAN2 have two operands. */
enum {
    ADD, SUBTRACT, MULTIPLY, DIVIDE, POWER, ARCTAN2, NEGATE, ABS, SQRT, EXP, LOG, SIN, COS, TAN, SINH, COSH, TANH, ARCTAN,
    SIGN, STEP, ARCSIN, ARCCOS, ARCSINH, ARCCOSH, ARCTANH, LOG10, LOG2, ERF, ERFC, FLOOR, CEIL
};

/* Which operations have to be done for some coefficients. */
typedef struct {
    int64_t count, terms;
    int64_t *operations;
    int64_t *chosen;   /* the terms */
    uint8_t *values;   /* registers whose value is wanted */
    uint8_t *slopes;   /* registers whose derivatives are wanted */
} Plan;

typedef struct {
    const Model *model;
    int64_t d, D, w, W, p, c, S, q, F;
    int64_t *equation, *column; /* p: of each parameter, the column among the kept terms */
    int64_t *constant;          /* K: which constant a term is the value of, negative for those that are factors */
    Plan kept, other;
    const uint8_t *free;
    bool polynomial;
    uint8_t *depends; /* registers x S: on which states and constants a register depends */
    double *registers, *slopes, *lanes;
    double *middle_states;
    Values at[3];
    double *factor, *beside, *border;          /* of all points: F x F, F x F, F x (q + p + 1) */
    double *drift;                             /* q x (q + p + 1), of all segments at their last points */
    double *information;                       /* (p + 1) x (p + 1): the last row is the gradient */
    double *of_mesh;                           /* the same of one mesh */
    double *of_segment;                        /* the same of one segment with its drift, (q + p + 1) x (q + p + 1) */
    double *rows, *blocks, *right, *next;      /* what elimination.c works on */
} Workspace;

/* workspace.c */
bool open_workspace(Workspace *work, const Model *model, const uint8_t *free, const double *coefficients,
                    int64_t longest, int64_t points, void **memory);

/* field.c */
void plan_terms(Workspace *work, Plan *plan, const double *coefficients, bool with_free);
void field(Workspace *work, const Plan *plan, bool linear, int64_t n, const double *states, int64_t stride,
           const double *inputs, const double *times, const double *coefficients, Values *out);

void operate(int64_t operation, const double *x, const double *y, double *restrict out, double *restrict left,
             double *restrict right, bool sloped);

/* collocation.c */
void collocate(Workspace *work, const Mesh *mesh, const double *states, const double *coefficients, bool linear);
double defect(const Workspace *work, const Mesh *mesh, const double *states, int64_t i, int64_t a);
double latent_defect(const Workspace *work, const Mesh *mesh, const double *states, int64_t i, int64_t l);
double walk(const Workspace *work, const Mesh *mesh, int64_t i, int64_t a);
double segment_start(const Mesh *mesh, int64_t i, double before);
void drift_columns(const Model *model, const Mesh *mesh, int64_t i, double begun, const double *start,
                   const double *end, double *out, int64_t stride);
void law_jacobians(const Workspace *work, const Mesh *mesh, int64_t i, double *start, double *end, double *border,
                   int64_t stride);
void step_jacobians(const Workspace *work, const Mesh *mesh, int64_t i, double *start, double *end, double *border,
                    int64_t stride);

/* elimination.c */
bool eliminate(Workspace *work, const Mesh *mesh, const double *states, double model_error, double lift,
               int64_t first);
void follow(const Workspace *work, const Mesh *mesh, int64_t first, const double *own, double *direction);

/* orthogonalization.c */
void orthogonalize(double *rows, int64_t count, int64_t columns, int64_t stride, double *triangle);

/* marginal.c */
bool solve_columns(double *matrix, int64_t k, double *rows, int64_t columns);
int marginal_deviance(int64_t objects, int64_t k, const double *estimates, const double *information, const double *scale,
                      int64_t count, const double *grid, int64_t sweeps, double *result);

#endif
