"""Every setting of the study: the paper's, and what the study adds to them."""

from collections.abc import Mapping
from typing import Any

from commonlaw.datasets.sphere_drag import AIR_DENSITY

# The authors' method

DIFFERENTIATION = "savgol:35:3"
LIBRARY = "poly:3"
SEED = 100
"""Of the authors' simulated noise (NumPy's legacy generator)."""

# The balls and their drops

BASKETBALLS = ("Blue Basketball", "Green Basketball")
WHIFFLE_BALLS = ("Whiffle Ball 1", "Whiffle Ball 2", "Yellow Whiffle Ball", "Orange Whiffle Ball")
GOLF_BALL_OUNCES: Mapping[str, float] = {"printed": 1.6, "measured": 1.62}
FASTER_AT_FIRST = ("Golf Ball", "Blue Basketball", "Orange Whiffle Ball")
"""Balls that land earlier in the first drop, says the paper."""
STROBE = 3
"""Samples from one marker to the next."""
REFERENCE_DRAGS = (-0.1, -0.7)
"""Of the falls drawn beside the drops, 1/s: the least and the largest drag of the simulated balls."""

# Drag on a sphere

PRINTED_COUNTS: Mapping[int, str] = {3: "1", 4: "13", 5: "33"}
"""Samples of an average drop by the order of magnitude of their Reynolds number: 10 to the key."""
PRINTED_SAMPLES = "49"

# Candidate terms

LIBRARY_BALL, LIBRARY_DROP = "Green Basketball", "2"

# Learned terms, and simulated drops

SINGLE_THRESHOLD = 0.04
GROUP_THRESHOLD = 1.5
SIMULATED_SINGLE_THRESHOLD = 0.05
NOISES = (0.0, 0.01, 0.1, 0.5, 1.0, 2.0)
"""Standard deviations, m."""
RATE = 15
"""Samples in a second."""
LINEAR_AVERAGES: tuple[Mapping[str, float], ...] = (
    {"1": -9.611605, "v": -0.366283},
    {"1": -9.611840, "v": -0.366587},
    {"1": -9.741560, "v": -0.378919},
    {"1": -9.296190, "v": -0.326685},
    {"1": 13.905271, "x": -0.392446, "v": 0.474940},
    {"1": -15.694411, "x": 0.082543, "v": -0.608288},
)
"""What the authors' program gives for each of these noises with the seed 100: the group model, averaged over balls."""
AVERAGE_DIGITS = 6
"""Decimals to which averages are known."""

RECOVERY_NOISES = (0.01, 0.03, 0.1, 0.2, 0.5, 1.0, 2.0)
"""m."""
RECOVERY_SEEDS = 50
GOOD_UP_TO = 0.5
"""Noise up to which the paper says that the group method identifies the correct terms, m."""
RELIABLE = 0.9
"""Share of the seeds above which something is called reliable."""

QUADRATIC = 0.1
"""Coefficient of v^2 that the paper tried, 1/m."""
QUADRATIC_THRESHOLDS = (1.5, 0.5, 0.3, 0.1, 0.05, 0.02, 0.01)
"""Of the group method, from the paper's own on downwards."""
FINDING_LIBRARY = "terms:1,v,v^2,v^3"
FINDING: Mapping[str, Any] = {"solver": "group-stlsq", "rule": "bic", "trim": 5, "n_resamples": 0}
"""A method that finds v^2: forces of the velocity only, no rates from the ends of a drop, choice by the BIC."""
FINDING_DIFFERENTIATION = "savgol:15:3"
FINDING_COEFFICIENTS = (0.0, 0.003, 0.01, 0.03, 0.1, 0.3)
"""1/m."""
FINDING_NOISES = (0.01, 0.03, 0.1)
"""m."""
FINDING_TRIALS = (1, 4)
"""Drops of each ball."""
FINDING_SEEDS = 10

# Reynolds-dependent drag: as printed, and as the authors' program ran

PRINTED_THRESHOLDS: Mapping[str, float] = {"single": 0.05, "group": 0.3}
RUN_THRESHOLDS: Mapping[str, float] = {"single": 0.15, "group": 1.0}
REYNOLDS_AVERAGES: tuple[Mapping[str, float], ...] = (
    {"1": -11.529829, "v": -0.427742},
    {"1": -11.529528, "v": -0.427961},
    {"1": -11.640894, "v": -0.440551},
    {"1": -11.282549, "v": -0.411736},
    {"1": 13.867141, "x": -0.422922, "v": 0.418991},
    {"1": -16.522958, "x": 0.072483, "v": -0.506983},
)
"""What the authors' program gives for each of the noises with the seed 100 and the thresholds that it ran with."""
CIRCUMFERENCES = (13.8, 20.75, 22.8, 22.25, 75.0)
"""Of the simulated balls, measured on the real ones, cm."""
OUNCES = (1.6, 2.0, 1.0, 5.0, 18.0)
OUNCE = 0.0283495
"""As the authors' program had it, kg."""
TENNIS_BALL = 1
"""Its index among these balls."""
LONG_FALL = (49, 900)
"""Samples of the short and the long comparison of linear with Reynolds-dependent drag."""
LINEAR_RIVALS: Mapping[str, Mapping[str, float]] = {
    "linear drag": {"drag": -0.125, "gravity": -9.8},
    "modified linear drag": {"drag": -0.53, "gravity": -12.7},
}
VARIANTS: Mapping[str, Mapping[str, Any]] = {
    "15 Hz over 3.2 s, as in the paper": {},
    "15 Hz over 10 s": {"samples": 151},
    "60 Hz over 3.33 s": {"samples": 201, "rate": 60.0},
    "fluid twice as dense as air": {"density": 2 * AIR_DENSITY},
    "fluid five times as dense": {"density": 5 * AIR_DENSITY},
    "fluid twenty times as dense": {"density": 20 * AIR_DENSITY},
}
"""Other experiments, as options of the data set; the kinematic viscosity stays that of the simulations."""
EXTREME = "fluid twenty times as dense"
"""Beyond what the paper may have tried; it does not say how dense."""

# Model error

MODELS: Mapping[str, Mapping[str, Any]] = {
    "1": {"library": "poly:3", "threshold": 5.0, "group": True},
    "2": {"library": "poly:3", "threshold": 2.0, "group": True},
    "3": {"library": "terms:1,v,v^2,v^3,v^4", "threshold": 0.05, "group": True},
    "4": {"library": "poly:3", "threshold": 0.01, "group": False},
}
MODEL_NAMES: Mapping[str, str] = {
    "1": "1: constant acceleration",
    "2": "2: + linear drag",
    "3": "3: + quadratic drag",
    "4": "4: overfit",
}
HORIZON = 42
"""Samples of the shortest drop: predictions are judged at the last of them."""

LONG_MODELS: Mapping[str, Mapping[str, Any]] = {
    "1": {"library": "terms:1,v,v^2,v^3,v^4", "threshold": 2.0},
    "2": {"library": "terms:1,v,v^2,v^3,v^4", "threshold": 0.01},
    "3": {"library": "terms:1,v,v^2,v^3,v^4", "threshold": 0.0006},
    "4": {"library": "poly:3", "threshold": 0.0035},
}
LONG_STARTS: Mapping[str, float] = {"Golf Ball": 1000.0, "Whiffle Ball 2": 500.0}
"""Heights to which the forecasts of 15 s are raised at their start, m."""
LONG_TIME = 15.0
"""s."""
LONG_DROP = "2"
"""The drop that the long forecasts learn from and start from."""
LONG_LIMITS = (-100.0, 1050.0)
"""Heights that the figure of the long forecasts shows, m."""
ERROR_LIMITS = (1e-3, 20.0)
"""Errors that the figure of the learned drop shows, m."""
UNBOUNDED_AFTER = (7.0, 8.0)
"""When the overfit model of the golf ball must run away to do so "after seven seconds", s."""

MODEL_TERMS: Mapping[str, tuple[str, ...]] = {"1": ("1",), "2": ("1", "v"), "3": ("1", "v", "v^2")}
"""What the templates of the group models ask for."""
SIMILAR = 0.1
"""Models 2 and 3 are similar if their medians differ by less than this share of what model 2 gains on model 1."""
LONG_AGREEMENT = 0.05
"""Long forecasts agree if they end within this share of the height fallen."""
RATE_SAMPLES = 15
"""Samples, about one second, to which an initial rate is fitted."""

# What the default method says of the drops

OFFERED = "terms:1,v,v^2"
DRAG_FORMS: Mapping[str, tuple[str, ...]] = {
    "constant acceleration": ("1",),
    "linear drag": ("1", "v"),
    "quadratic drag": ("1", "v^2"),
    "both drags": ("1", "v", "v^2"),
}
DENSEST = ("Golf Ball", "Baseball")
OTHERS = ("Tennis Ball", "Volleyball")
ALL_BALLS = "ten balls together"
BALL_GROUPS: Mapping[str, tuple[str, ...]] = {
    ALL_BALLS: (*DENSEST, *OTHERS, *BASKETBALLS, *WHIFFLE_BALLS),
    "whiffle balls": WHIFFLE_BALLS,
    "closed balls": (*DENSEST, *OTHERS, *BASKETBALLS),
    "basketballs": BASKETBALLS,
    "golf ball and baseball": DENSEST,
    "tennis ball and volleyball": OTHERS,
}
EVIDENCE_WORDS: Mapping[float, str] = {
    2.0: "hardly worth a mention",
    6.0: "positive evidence",
    10.0: "strong evidence",
    float("inf"): "very strong evidence",
}
"""What twice the log-evidence below these bounds is called (Kass and Raftery 1995)."""
REDRAWS = 2000
"""Draws of the forecasts, with repetition, that tell how sure a difference of medians is."""

# How the threshold decides

PATH_BALL, PATH_DROP = "Tennis Ball", "1"
"""Of the printed tables: the single-trial one is of this ball and drop, the group one of all balls and this drop."""
CHOICES: Mapping[str, str] = {
    "held-out": "least error on the held-out drop",
    "one-standard-error": "fewest terms within one standard error of that",
    "aic": "least AIC",
    "bic": "least BIC",
}

# Numerical differentiation

WINDOWS = tuple(range(7, 36, 4))
"""Samples in the smoothing window."""
STUDIED_FALL: Mapping[str, Any] = {"drag": -0.5, "gravity": -9.8, "height": 40.0, "samples": 49}
STUDIED_NOISES = (1e-3, 1.0, 200)
"""The least and the largest, m, and how many, spaced logarithmically."""
STUDIED_DRAWS = 40
"""Of noise at each level; the paper has one."""
END_SAMPLES = 5
"""At each end of a fall."""
REPORTED_NOISES = (1e-3, 1e-2, 1e-1, 1.0)
"""m."""
SHOWN_NOISES = (0.01, 0.1, 1.0)
"""m."""
LINEAR_FROM = 0.5
"""Noise from which on errors are to grow in proportion to it, m."""
LINEAR_WITHIN = 0.2
"""How far the logarithmic slope may be from one."""
PRINTED_NOISE = (0.035, 0.065)
"""Ends of the noise of all drops, m."""
PRINTED_HARM = 1e-2
"""Noise below which smoothing with the largest window does harm, m."""
PRINTED_ORDERS: Mapping[int, int] = {1: -3, 2: -2}
"""Powers of ten of the relative errors of velocity and acceleration at that noise."""

# Worked examples

OSCILLATOR_LIBRARY = "poly:5"
OSCILLATOR: Mapping[str, Any] = {"differentiation": "centered", "solver": "stlsq:0.05"}
OSCILLATOR_SAMPLES = (501, 2501)
"""Learned from, and with the unseen part; a hundred in a unit of time."""
PRINTED_DAMPING = "-0.100"
"""Of x and of y, in the paper's text; its other coefficients have the digits of the table."""
EXAMPLE_FALL: Mapping[str, Any] = {"height": 40.0, "noise": 0.0, "trials": 1}
EXAMPLE_BALL: Mapping[str, Any] = {"radius": 0.0335, "mass": 0.057}
"""m and kg."""
EXAMPLE_SAMPLES = (50, 100)
"""Learned from, and with the unseen part."""
EXAMPLE_THRESHOLDS: Mapping[str, float] = {
    "drag-free fall, threshold 0.1": 0.1,
    "linear-drag fall, threshold 0.1": 0.1,
    "Reynolds-drag fall, threshold 0.1": 0.1,
    "Reynolds-drag fall, threshold 0.004": 0.004,
}
CLOSE = 0.01
"""Trajectories agree closely if they part by less than this share of their size."""

# Findings

STANDARD_GRAVITY = 9.8
"""m/s^2, as in the paper."""
