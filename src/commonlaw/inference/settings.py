"""Every number by which inference decides, with its unit, its meaning and its source."""

from commonlaw.differentiation.noise import MIN_SAMPLES as MIN_SAMPLES
from commonlaw.likelihood.mesh import MIN_NOISE as MIN_NOISE
from commonlaw.likelihood.observation_model import VERY_STRONG as VERY_STRONG

# Rounding and iterations
ROUNDING = 1e-6
"""Relative difference, or change in units of a scale, up to which two numbers are equal."""
MIN_SINGULAR_VALUE = 1e-7
"""Singular value of normalized columns below which they are collinear, about half of the digits of a number."""
COLLINEAR = 1e-10
"""Squared norm outside of the span of others up to which a column of unit norm is collinear with them."""
MAX_ITERATIONS = 30
"""Newton, Gauss-Newton or Levenberg-Marquardt steps of a minimization."""
MAX_SWEEPS = 4
"""Rounds of alternating choices, or Gauss-Newton steps, before the final fit."""
PROMISING = 0.25
"""Share of what the model error of a law explains, below which richer terms are not sought any further in its place."""

# Comparisons of fits, in twice the log-likelihood
SAME_DEVIANCE = 0.01
"""Difference below which fits are equal, and at which iterations end."""
INDIFFERENT = 2.0
"""2 log B up to which evidence is not worth more than a bare mention (Kass and Raftery 1995)."""

# Noise before any law
RESOLVED_NOISE = 0.1
"""Share of the noise that steps resolve: a smaller one would take much finer meshes."""
ASSUMED_NOISE = 0.05
"""Noise, in standard deviations of a state, where a trial has too few samples for an estimate."""
MIN_FREEDOM = 4
"""Degrees of freedom of an estimate of noise: its relative standard error is then a third."""
MIN_SAMPLES_OF_MANY = 30
"""Samples by which noise at some stride or size of a state is estimated, to a tenth."""
VAGUE = 100.0
"""Standard deviation of free initial values of latent states, in scales of the states."""

# Samples, objects and trials
MAX_SCREENED_SAMPLES = 10_000
"""Samples by which terms are screened, and strides of samples compared."""
MIN_RESOLUTION = 8
"""Strides of samples that the stride from which differences still estimate the noise must hold; at half of it, errors
of the mesh exceed those of coefficients by noise."""
MAX_CURVE_POINTS = 200
"""Points in a row that represent a trial, a window or a segment."""
MAX_WINDOWS = 4
"""Windows of an object, trials and objects, or trials of an object left out in turn, in expensive computations."""
MAX_OBJECTS = 12
"""Objects, segments of an object, or trials, that represent all."""

# Models
MAX_TERMS = 20
"""Terms of an equation, for legibility."""
MIN_SMOOTHED = 5
"""Samples that a curve is smoothed from: the least that a spline takes."""
MIN_SAMPLES_PER_TERM = 5
"""Samples of all objects for each term of an equation; with fewer, terms follow the noise."""
MAX_TERMS_OF_SIMPLE_LAW = 3
"""An equation with more coefficients may approximate richer terms, of two numbers or more, or a law of lower order."""
MAX_TERMS_WITHOUT_LATENT_STATE = 5
"""An equation with more coefficients may lack a latent state."""
MAX_REDUCED_CHI_SQUARED = 1.5
"""Sum of squares with all terms, in its degrees of freedom, from which on terms are missing."""
MAX_SEARCHED_TERMS = 70
"""Candidate terms of an equation that are searched unscreened: beyond, the search takes minutes."""
MAX_SCREENED_TERMS = 40
"""Candidate terms that screening keeps, about, and those that are tested or limited at a time on a law."""
MAX_NUMBERS = 7
"""Coefficients and nonlinear parameters of an equation with parametric or rational terms."""
MAX_SUM_TERMS = (4, 3, 4, 2)
"""Terms without parameters of such an equation; in the numerator, in the denominator of a ratio, and added to it."""
MAX_VARIABLES = 8
"""Variables whose subsets are all compared."""

# Rankings on integrals along curves
MAX_SETS = (1500, 60, 400)
"""Sets of terms compared, smaller ones first: with at most one parametric term, with two, and with each
denominator."""
MAX_LINEARIZED = 80
"""Sets of as many numbers that are compared to first order about values of a grid."""
MAX_REFINED = 8
"""Sets of as many numbers, or values of a grid, that Gauss-Newton steps refine."""
MAX_KEPT = 3
"""Best terms of a step, sets of as many numbers, or values, that go on to the next stage."""
MAX_SQUARES_RATIO = 30.0
"""Sum of squares over the least one, up to which a set of terms is fitted: curves are biased towards their law."""

# Parameter grids
MAX_DECADES = 1.5
"""Decades from the size that a parameter is expected to have, up and down."""
PER_DECADE = (8, 4, 2)
"""Values in a decade for one, two and more parameters of a term."""
PER_CYCLE = 8
"""Frequencies in a cycle over the range of a variable, and phases of a cycle."""
EXPONENTS = (-3.0, -2.0, -1.5, -1.0, -0.5, 0.25, 0.5, 0.75, 1.25, 1.5, 2.0, 3.0, 4.0, 6.0)
"""Exponents that are tried."""
MAX_COMBINATIONS = 3000
"""Combinations of values of all parameters, or frequencies; of more, as many are drawn."""
MAX_BELOW_ZERO = 0.2
"""Share of the size of a variable by which noise may take it below zero."""
MIN_ABOVE_ZERO = 1e-3
"""Share of the size of a variable that stands for its values about zero under roots and logarithms."""

# Latent states
MIN_DRAWS = (32, 128)
"""Draws for each two parameters where initial values are given, and where they are drawn: a tenth or
ten times as many give the same optimum."""
GENERIC_POINTS = 16
"""Random points at which terms are compared or averaged."""
LATENT_MODEL_ERRORS = (1.0, 0.1, 0.01)
"""Model errors relative to the noise, from the measurements to the law."""
MAX_RELATIVE_DIFFERENCE = 0.2
"""Relative difference up to which coefficients of objects, or of unconverged fits, are equal."""

# Search and comparison of models
STRONG = 6.0
"""2 log B from which evidence is strong (Kass and Raftery 1995)."""
MIN_PROBABILITY = 0.01
"""Posterior probability of a model that is kept."""
MAX_MODELS = 12
"""Models that are kept besides the best, and fitted in vain before a search ends."""
MAX_PROPOSED = 4
"""Supports or sets of terms that one source proposes, and that are fitted by each kind of errors."""
MAX_RIVALS = 2
"""Rivals of the best model that are treated as this is."""
ALTERNATIONS = 2
"""Rounds of what is chosen in turn: supports and levels of errors, or variances of initial conditions."""
MAX_TRIED_SETS = 30
"""Sets of terms of an equation, or combinations of those of all equations, that are fitted from where they were
proposed."""
MAX_DEVIANCE = (2.0, 100.0)
"""Twice the log-likelihood that a typical object may lose for a law to be fitted in all ways: relative to the least
one so far, and besides it."""

# Model errors (random walk in each step) relative to the noise
MODEL_ERRORS = (10.0, 3.0, 1.0, 0.3, 0.1)
"""Compared where the measurements follow no law."""
FINAL_MODEL_ERRORS = (0.03, 0.003, 0.0003)
"""Down to which laws without one are fitted: the last times the samples of a trial should be below one, as what is
allowed in each step adds up."""
SOLVER_ERROR = 0.1
"""The last where nothing is measured but the least noise, relative to that: 1e-5 of the standard deviation of a state
in each step, a usual tolerance of solvers, from which such data come."""
SCHEDULES = ((3.0, 1.0, 0.3, 0.1, 0.0), (0.3, 0.0), (0.1, 0.0))
"""At which supports are chosen, in turn. Different ways find different supports; the best is kept."""
SHORT_SCHEDULE = (3.0, 0.3, *FINAL_MODEL_ERRORS)
"""From measurements to a law, for most objects as good as all model errors."""

# Meshes and convergence
MAX_MESH_POINTS = (4, 8, 64)
"""Points for each sampling step: with a random walk, in a search, and of the estimate that is reported."""
MAX_MESH_CHANGE = 1.0
"""Change of twice the log-likelihood on a finer mesh that is negligible compared with that by a term."""
MIN_GAIN = 0.1
"""Twice the log-likelihood (for each object) that a further fit gains, and that one of a latent state may be short of
its maximum."""
CONVERGED = 0.01
"""Standard errors by which a converged estimate moves with another mesh or iteration."""
RESOLVED = 1.5e-3
"""Standard errors by which an estimate that is reported moves on half the steps: Hermite-Simpson collocation, of order
4, then has a fifteenth of it left."""
MAX_GROWING_MOVES = 3
"""Moves of estimates on finer meshes in a row, each larger than the one before, after which no finer one is tried."""
CONVERGED_NOISE = 1e-3
"""Relative change of the noise, and change of estimates in standard errors, at which their iteration ends."""

# Objects, trials and samples of checks
MIN_OBJECTS = 3
"""Objects, or trials, from which on their scatter is estimated."""
MIN_OBJECTS_WITH_STRANGE = 4
"""Objects from which on one of them may be strange: the others show that they share a law."""
STRANGE_ODDS = (9.0, 1.0)
"""Parameters of the beta distribution of the shares of objects that follow the shared law, and of strange ones: one
in ten is expected to be strange, and 1 % to 30 % are likely."""
MAX_CHECKED_OBJECTS = 30
"""Objects whose forecasts, trials and trajectories are checked, evenly spread."""
MAX_PAIRS = 500
"""Samples of an object, or pairs of them, that are compared."""
FEW_SAMPLES = 4000
"""Samples in which supports are sought first, where there are more than twice as many."""
OBJECT_GROUPS = (10, 2)
"""Objects of a group, and groups, in which supports are sought first where there are more objects."""
LEVEL_MEASUREMENTS = 300
"""Measurements of the objects by which levels of errors are estimated."""

# Estimates
SIGNIFICANT = 2.0
"""Standard errors from which on a coefficient differs from zero or from its optimum, a forecast error from its
prediction, and an initial value from zero."""
MISFIT_LEVEL = 0.001
"""Probability by chance below which residuals show lack of fit of a compared law."""
EXACT = 0.01
"""Mean square of residuals, relative to their noise, below which this is the least that is assumed for exact data."""
PRIOR_OBSERVATIONS = 2.0
"""Prior observations of a first estimate: of the noise, and of predicted forecast errors."""
MAX_DEVIANCE_RATIO = 1.2
"""Ratio of the deviance of an object with pooled coefficients to that with object-specific ones."""
PRIOR_WIDTH = (3.0, 0.1)
"""Scatter of parameters between objects as a prior: times the observed one, and at least this share of the median."""
BOOTSTRAP = (30, 500)
"""Blocks of an object's trials, and resamples, which give standard errors to 3 %."""
MIN_SMOOTHNESS = 2.0
"""Mean square leave-one-out error of straight lines, in that of cubics, above which an input counts as smooth: of a
kink at a sample it is 1.5, of a step 0.9, of white noise 0.8, and of a sine of four samples a cycle 2.25."""

# Orders
TWO_RATES = (0.03, 0.1, 0.25, 0.1)
"""Shares of the range up to which states are the same, and from which times and rates are not; and the share of samples
at the same state whose rates may differ where these change steeply."""

# Interval calibration
LEVEL = 0.95
"""Of intervals that are calibrated."""
FITTED_SHARES = (0.5, 0.75)
"""Shares of the samples of a trial that a law is fitted to before it forecasts the rest."""
MAX_RELATIVE_ERROR = 10.0
"""Standard errors of a coefficient, in its size by all trials, up to which some trials identify it."""
