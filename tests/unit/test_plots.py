"""Figures show the data they are given, say what they show, and are the same bytes every time."""

from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PolyCollection, QuadMesh
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from scipy.stats import t

import commonlaw as cl
from commonlaw import datasets
from commonlaw.differentiation import parse_differentiation
from commonlaw.formulation import StrongForm, law_variables
from commonlaw.law import Law, Provenance, Uncertainty, select_objects
from commonlaw.law.uncertainty import IntervalInflation
from commonlaw.library import PolynomialLibrary
from commonlaw.plots import (
    plot_coefficients,
    plot_forecast,
    plot_law,
    plot_library,
    plot_relations,
    plot_trials,
    render,
)
from commonlaw.plots.style import COLORS, MARKERS
from commonlaw.trials import Schema, Trial, Trials
from tests.refusals import refused

DRAG = tuple(np.linspace(-0.1, -0.7, 10))
FORM = StrongForm(parse_differentiation("savgol:35:3"), order=2)


def drops(balls: int = 3, **options: float) -> Trials:
    return datasets.linear_drag(drag=DRAG[:balls], **options)


def law_of(trials: Trials, degree: int = 2) -> Law:
    """The law ``x'' = -9.5 + 0.9 drag v`` over a polynomial library, close to the truth and not equal to it."""
    terms = PolynomialLibrary(degree).bind(law_variables(trials.schema, FORM.order))
    coefficients = np.zeros((len(trials.objects), 1, len(terms)))
    coefficients[:, 0, terms.index("1")] = -9.5
    coefficients[:, 0, terms.index("v")] = 0.9 * np.array(DRAG[: len(trials.objects)])
    provenance = Provenance(FORM.differentiation)
    return Law(terms, trials.schema, 2, trials.objects, coefficients, provenance=provenance)


def pairs(count: int) -> tuple[Law, Trials]:
    """The law of pairs of prey and predators, and trials of some of them."""
    trials = datasets.lotka_volterra()
    names = trials.objects[:count]
    return select_objects(datasets.lotka_volterra.truth(), names), trials.select(object=names)


def legend_of(figure: Figure) -> list[str]:
    return [text.get_text().strip() for legend in figure.legends for text in legend.get_texts()]


def xy(panel: Axes, i: int) -> tuple[np.ndarray, np.ndarray]:
    line = panel.get_lines()[i]
    return np.asarray(line.get_xdata()), np.asarray(line.get_ydata())


def unsure(law: Law) -> Law:
    """The law with standard errors of 4 %, neighbours correlated by a half, and noise."""
    values = 0.04 * np.abs(law.coefficients[:, law.support])
    size = values.shape[1]
    links = np.eye(size) + 0.5 * (np.eye(size, k=1) + np.eye(size, k=-1))
    covariance = values[:, :, np.newaxis] * links * values[:, np.newaxis]
    return replace(
        law, uncertainty=replace(law.uncertainty, covariance=covariance, noise=np.full(len(law.schema.states), 0.05))
    )


def diverging() -> tuple[Law, Trials]:
    trials = drops(1, trials=1)
    law = law_of(trials)
    return replace(law, coefficients=np.where(np.array(law.terms.names) == "v^2", -1.0, law.coefficients)), trials


def with_inflated_intervals(law: Law) -> Law:
    """The law with bands that are wider the farther ahead they forecast."""
    wider = IntervalInflation(np.array([0.5, 2.0]), np.array([1.0, 3.0]))
    return replace(law, uncertainty=replace(law.uncertainty, interval_inflation=wider))


EVERY: dict[str, Callable[[], Figure]] = {
    "one trial": lambda: plot_trials(drops(1, trials=1)),
    "references": lambda: plot_trials(drops(), references={"free fall": (np.arange(3.0), 47 - np.arange(3.0))}),
    "library": lambda: plot_library(drops(1)[0], FORM, law_of(drops(1)).terms),
    "many coefficients": lambda: plot_coefficients(law_of(drops(5), degree=6)),
    "one unsure law": lambda: plot_law(unsure(law_of(drops(1))), drops(1)),
    "unsure law": lambda: plot_law(unsure(law_of(drops(6))), drops(6), datasets.linear_drag.truth(drag=DRAG[:6])),
    "unsure about chaos": lambda: plot_forecast(
        unsure(datasets.lorenz.truth()).predict(datasets.lorenz(), return_std=True)
    ),
    "some objects, bands that widen": lambda: plot_forecast(
        with_inflated_intervals(unsure(law_of(drops(3)))).predict(drops(3), return_std=True), ["Ball 1", "Ball 3"]
    ),
    "unsure and diverged": lambda: plot_forecast(unsure(diverging()[0]).predict(diverging()[1], return_std=True)),
}


def test_trials_are_drawn_sample_by_sample_with_units_and_a_legend_outside_the_data() -> None:
    trials = drops()
    figure = plot_trials(trials)
    (panel,) = figure.axes
    assert (panel.get_xlabel(), panel.get_ylabel()) == ("t (s)", "x (m)")
    for i, trial in enumerate(trials):
        np.testing.assert_array_equal(xy(panel, i), (trial.times, trial.states[:, 0]))
    assert len(panel.get_lines()) == len(trials) == 6
    assert legend_of(figure) == [*trials.objects, "trial 1", "trial 2"]
    figure.draw_without_rendering()
    assert figure.legends[0].get_window_extent().x0 > panel.bbox.x1


def test_each_object_has_its_own_look_and_keeps_it_in_a_selection() -> None:
    trials = drops(10)
    looks = {(line.get_color(), line.get_marker()) for line in plot_trials(trials).axes[0].get_lines()}
    chosen = plot_trials(trials, objects=["Ball 3"])
    assert len(looks) == 10
    lines = chosen.axes[0].get_lines()
    assert {line.get_color() for line in lines} == {plot_trials(trials).axes[0].get_lines()[4].get_color()}
    assert [line.get_linestyle() for line in lines] == ["-", "--"]
    assert legend_of(chosen)[0] == "Ball 3"


def test_unknown_states_and_objects_are_named() -> None:
    with refused("unknown-name", kind="state", name="y"):
        plot_trials(drops(1), state="y")
    with refused("unknown-name", kind="object", name="ball 1"):
        plot_trials(drops(1), objects=["ball 1"])
    with refused("unknown-name", kind="object", name="Bal 1"):
        plot_forecast(law_of(drops(1)).predict(drops(1)), objects=["Bal 1"])


def test_reference_curves_are_black_in_their_own_line_styles_and_change_nothing_else() -> None:
    times, trials = np.arange(20) / 15, drops(3)
    curves = {"free fall": (times, 47 - 4.9 * times**2), "drag": (times, 47 - times)}
    plain, figure = plot_trials(trials), plot_trials(trials, references=curves)
    count = len(plain.axes[0].lines)
    assert len(figure.axes[0].lines) == count + 2
    for i in range(count):
        np.testing.assert_array_equal(xy(figure.axes[0], i), xy(plain.axes[0], i))
    for i, curve in enumerate(curves.values()):
        np.testing.assert_array_equal(xy(figure.axes[0], count + i), curve)
    lines = figure.axes[0].lines[-2:]
    assert [(line.get_color(), line.get_linestyle()) for line in lines] == [("black", "-"), ("black", "--")]
    assert legend_of(figure) == [*legend_of(plain), "free fall", "drag"]


def test_heat_maps_colour_magnitudes_blank_zeros_and_print_values() -> None:
    law = law_of(drops())
    panel, bar = plot_coefficients(law).axes
    (mesh,) = [collection for collection in panel.collections if isinstance(collection, QuadMesh)]
    cells = np.ma.asarray(mesh.get_array())
    np.testing.assert_array_equal(cells.filled(0), np.abs(law.coefficients[:, 0]))
    np.testing.assert_array_equal(cells.mask, law.coefficients[:, 0] == 0)
    assert [text.get_text() for text in panel.texts[:2]] == ["−9.5", "−0.09"]
    assert [label.get_text() for label in panel.get_yticklabels()] == list(law.objects)
    assert "grey: term absent" in bar.get_xlabel()


def test_heat_maps_show_all_terms_or_those_of_the_law_one_panel_for_each_equation() -> None:
    law = datasets.lorenz.truth()
    coefficients = np.zeros((1, 3, 10))
    coefficients[0, 0, 1] = 2.0
    wide = replace(law, terms=PolynomialLibrary(2).bind(law.terms.variables), coefficients=coefficients)
    for terms, columns in (("all", 10), ("support", 1)):
        panels = plot_coefficients(wide, terms).axes[:3]
        assert [len(panel.get_xticks()) for panel in panels] == [columns] * 3
    assert panels[0].get_title(loc="left") == r"terms of $\dot{x}$"
    assert panels[1].get_title(loc="left") == r"terms of $\dot{y}$: none is there"
    with refused("unknown-name", kind="choice of terms", name="some"):
        plot_coefficients(law, "some")


def test_a_law_without_any_term_is_drawn_as_all_absent() -> None:
    law = law_of(drops(1))
    empty = replace(law, coefficients=0 * law.coefficients)
    (panel,) = plot_coefficients(empty, "support").axes
    assert len(panel.get_xticks()) == len(law.terms)
    assert plot_law(empty, drops(1)).get_suptitle().startswith(r"$\ddot{x}$ $=$ 0")


def test_forecasts_are_lines_through_measured_points_with_their_errors_below() -> None:
    trials = drops(6)
    forecast = law_of(trials).predict(trials)
    figure = plot_forecast(forecast)
    assert len(figure.axes) == 12
    assert [panel.get_title() for panel in figure.axes[::2]] == list(trials.objects)
    assert legend_of(figure) == ["measured", "forecast from the first sample", "trial 1", "trial 2"]
    for i, (trial, trajectory) in enumerate(zip(trials, forecast.trajectories, strict=True)):
        state, error = figure.axes[2 * (i // 2) : 2 * (i // 2) + 2]
        np.testing.assert_array_equal(xy(state, i % 2), (trial.times, trial.states[:, 0]))
        times, curve = xy(state, 2 + i % 2)
        assert np.diff(times).max() < np.ptp(times) / 299
        at_samples = np.isin(times, trial.times)
        assert at_samples.sum() == len(trial)
        np.testing.assert_allclose(curve[at_samples], trajectory.states[:, 0], rtol=1e-7)
        start = {trial.object: [*trajectory.states[0]]}
        between = law_of(trials).simulate(times, start)[trial.object].states[:, 0]
        np.testing.assert_allclose(curve, between, rtol=1e-6)
        np.testing.assert_array_equal(xy(error, 1 + i % 2)[1], trajectory.states[:, 0] - trial.states[:, 0])
    labels = [(panel.get_xlabel(), panel.get_ylabel()) for panel in figure.axes]
    assert labels[:4] == [("", "x (m)"), ("", "error (m)"), ("", ""), ("", "")]
    assert labels[-1] == ("t (s)", "")
    assert len({panel.get_ylim() for panel in figure.axes[::2]}) == 1


def test_only_the_objects_asked_for_are_forecast_and_each_state_has_its_own_scale() -> None:
    trials = drops()
    figure = plot_forecast(law_of(trials).predict(trials), objects=["Ball 1", "Ball 3"])
    assert [panel.get_title() for panel in figure.axes[::2]] == ["Ball 1", "Ball 3"]
    law, trials = pairs(1)
    figure = plot_forecast(law.predict(trials))
    assert [panel.get_ylabel() for panel in figure.axes[::2]] == list(trials.schema.states)


def test_a_diverged_forecast_is_marked_where_it_ends_and_does_not_stretch_the_axes() -> None:
    law, trials = diverging()
    forecast = law.predict(trials)
    figure = plot_forecast(forecast)
    state, error = figure.axes
    reached = int(np.isfinite(forecast.trajectories[0].states[:, 0]).sum())
    assert 0 < reached < len(trials[0])
    times, values = xy(state, 1)
    ends = times[-1]
    assert trials[0].times[reached - 1] <= ends <= forecast.trajectories[0].ended
    assert np.isin(trials[0].times[:reached], times).all()
    assert np.all(np.isfinite(values))
    for panel in (state, error):
        crosses = [line for line in panel.get_lines() if line.get_marker() == "X"]
        assert [list(line.get_xdata()) for line in crosses] == [[ends]]
    assert "diverged" in legend_of(figure)
    span = np.ptp(trials[0].states)
    low, high = state.get_ylim()
    assert span < high - low < 2.2 * span


def test_a_law_has_its_equation_above_and_the_true_coefficients_beside_its_own() -> None:
    trials = drops(2)
    law, truth = law_of(trials), datasets.linear_drag.truth(drag=DRAG[:2])
    figure = plot_law(law, trials, truth)
    assert figure.get_suptitle() == "$\\ddot{x}$ $=$ $a$ $+$ $b$ $v$\nwith $v$ $=$ $\\dot{x}$"
    constant, drag = figure.axes[:2]
    assert [panel.get_title() for panel in (constant, drag)] == ["constant term", "$v$ term"]
    assert [panel.get_xlabel() for panel in (constant, drag)] == ["$a$ (m/s²)", "$b$ (1/s)"]
    np.testing.assert_array_equal(xy(drag, 0), (0.9 * np.array(DRAG[:2]), np.arange(2)))
    np.testing.assert_array_equal(xy(drag, 1)[0], DRAG[:2])
    np.testing.assert_array_equal(xy(constant, 1)[0], [-9.8] * 2)
    assert drag.get_lines()[1].get_markerfacecolor() == "none"
    assert legend_of(figure)[:3] == ["estimate", "true", "measured"]
    without = replace(law, coefficients=np.where(np.array(law.terms.names) == "v", 0, law.coefficients))
    drag = plot_law(without, trials, truth).axes[1]
    assert np.all(np.isnan(xy(drag, 0)[0]))
    np.testing.assert_array_equal(xy(drag, 1)[0], DRAG[:2])


def test_coefficients_whose_errors_are_known_have_95_percent_intervals() -> None:
    trials = drops(2)
    law = unsure(law_of(trials))
    figure = plot_law(law, trials)
    for k, panel in enumerate(figure.axes[:2]):
        (bars,) = [collection for collection in panel.collections if isinstance(collection, LineCollection)]
        frame = law.conf_int()[k::2]
        for ends, low, high in zip(bars.get_segments(), frame["low"], frame["high"], strict=True):
            np.testing.assert_allclose(ends[:, 0], [low, high])
    assert legend_of(figure)[:2] == ["estimate", "95 % interval"]
    one = drawn("one unsure law")
    assert [text.get_text() for text in one.axes[0].texts] == ["−9.50 ± 0.38 m/s²", "−0.0900 ± 0.0036 1/s"]
    assert one.get_suptitle().startswith(r"$\ddot{x}$ $=$ $-$9.5 $-$ 0.09 $v$")


def test_forecasts_with_a_spread_have_bands_of_measurements_and_around_no_error() -> None:
    trials = drops(1)
    forecast = unsure(law_of(trials)).predict(trials, return_std=True)
    figure = plot_forecast(forecast)
    assert legend_of(figure)[:3] == ["measured", "forecast from the first 38 samples", "95 % band (measured)"]
    margins = forecast.margins(measured=True)
    for panel, middles in zip(
        figure.axes, ([trajectory.states[:, 0] for trajectory in forecast.trajectories], [0, 0]), strict=True
    ):
        bands = [collection for collection in panel.collections if isinstance(collection, PolyCollection)]
        for band, middle, margin in zip(bands, middles, margins, strict=True):
            low, high = middle - margin[:, 0], middle + margin[:, 0]
            drawn = band.get_paths()[0].get_extents()
            np.testing.assert_allclose([drawn.y0, drawn.y1], [low.min(), high.max()])
    chosen = plot_forecast(unsure(law_of(drops(2))).predict(drops(2), return_std=True), objects=["Ball 2"])
    assert "95 % band (measured)" in legend_of(chosen)


def test_many_coefficients_are_drawn_as_a_heat_map_with_the_true_terms_framed() -> None:
    trials = drops(2)
    law = law_of(trials, degree=4)
    full = replace(law, coefficients=np.where(law.coefficients == 0, 1e-9, law.coefficients))
    figure = plot_law(full, trials, datasets.linear_drag.truth(drag=DRAG[:2]))
    frames = {patch.get_xy() for patch in figure.axes[0].patches if isinstance(patch, Rectangle)}
    assert frames == {(column, row) for column in (0, law.terms.index("v")) for row in (0, 1)}
    assert figure.get_suptitle().splitlines()[1].endswith("…")
    assert legend_of(figure)[0] == "true term"


def test_a_law_is_drawn_with_its_fit_and_the_residuals_in_the_unit_of_the_state() -> None:
    """Logistic growth whose first sample is far off: the fitted curve passes it, a forecast starts there."""
    times = np.linspace(0, 12, 40)
    states = 1 / (1 + 20 * np.exp(-times)) + 0.002 * np.random.default_rng(0).standard_normal(40)
    states[0] = 0.1
    trials = Trials.from_arrays(times, states, names=["OD"], units={"t": "h", "OD": "mg"})
    law = replace(Law.from_text("OD' = OD - OD^2"), uncertainty=Uncertainty(noise=np.array([0.002])))
    figure = plot_law(law, trials)
    above, below = figure.axes[-2:]
    assert legend_of(figure)[-2:] == ["measured", "fit"]
    drawn_at, curve = xy(above, 1)
    begin = curve[0]
    np.testing.assert_allclose(curve, 1 / (1 + (1 / begin - 1) * np.exp(-drawn_at)), atol=1e-6)
    assert begin == pytest.approx(1 / 21, abs=1e-3)
    np.testing.assert_allclose(xy(below, 1)[1], states - curve[np.isin(drawn_at, times)], atol=1e-8)
    assert (below.get_xlabel(), below.get_ylabel()) == ("t (h)", "residual (mg)")
    forecast = plot_law(law, law.predict(trials))
    assert legend_of(forecast)[-1] == "forecast from the first sample"
    assert xy(forecast.axes[-2], 1)[1][0] == states[0]


@cache
def drawn(name: str) -> Figure:
    return EVERY[name]()


@pytest.mark.parametrize("name", EVERY)
def test_nothing_is_clipped_and_no_title_runs_into_another(name: str) -> None:
    figure = drawn(name)
    figure.draw_without_rendering()
    box, (width, height) = figure.get_tightbbox(), figure.get_size_inches()
    assert min(box.x0, box.y0, width - box.x1, height - box.y1) > -0.02
    assert width <= 9
    titles = [panel.title.get_window_extent() for panel in figure.axes if panel.get_title()]
    legends = [legend.get_window_extent() for legend in figure.legends]
    assert all(not a.overlaps(b) for i, a in enumerate(titles) for b in [*titles[:i], *legends])


def test_bands_of_chaos_do_not_stretch_the_axes() -> None:
    for j, panel in enumerate(drawn("unsure about chaos").axes[::2]):
        low, high = panel.get_ylim()
        assert high - low < 2.3 * np.ptp([trial.states[:, j] for trial in datasets.lorenz()])


@pytest.mark.slow
@pytest.mark.parametrize("name", EVERY)
def test_the_same_data_give_the_same_bytes_without_warnings(name: str) -> None:
    first = render(drawn(name), "svg")
    assert first == render(drawn(name), "svg") == render(EVERY[name](), "svg")


@pytest.mark.slow
def test_names_of_any_kind_are_shown_as_they_are() -> None:
    names = ["_hidden", "US$ 5 $x$", r"\frac{", "мяч №1", "球", "a long name " * 8]
    times = np.arange(40) / 15
    trials = Trials(
        tuple(Trial(name, "$1_", times, 40 - 4.9 * times**2) for name in names), Schema(("the height_$",), trial="run")
    )
    law = law_of(trials)
    for figure in (
        plot_trials(trials),
        plot_forecast(law.predict(trials)),
        plot_coefficients(law),
        plot_law(law, trials),
    ):
        assert render(figure, "png")
        assert render(figure, "svg")
    assert legend_of(plot_trials(trials))[:5] == ["_hidden", r"US\$ 5 \$x\$", *names[2:5]]
    assert legend_of(plot_trials(trials))[5].endswith("…")


def test_ticks_on_both_sides_of_zero_keep_their_distance() -> None:
    law = law_of(drops(balls=1), degree=2)
    coefficients = law.coefficients.copy()
    coefficients[0, 0, :3] = -9.5, 1e-3, 0.4
    figure = plot_law(replace(law, coefficients=coefficients), drops(balls=1, noise=0.05))
    figure.draw_without_rendering()
    (panel,) = (axis for axis in figure.axes if axis.get_xscale() == "symlog")
    ticks = [tick.label1 for tick in panel.xaxis.get_major_ticks() if tick.label1.get_text()]
    low, high = panel.get_xlim()
    boxes = [tick.get_window_extent() for tick in ticks if low <= tick.get_position()[0] <= high]
    assert len(boxes) >= 2
    assert not any(a.overlaps(b) for i, a in enumerate(boxes) for b in boxes[:i])


MASSES = (0.3, 0.15, 0.1, 0.06, 0.043)


@pytest.fixture(scope="module")
def law():
    """Drag by mass, and gravity that is universal."""
    drops = cl.datasets.linear_drag(drag=tuple(-0.03 / each for each in MASSES), noise=0.01)
    law = cl.fit("x'' = -g - c v", drops, errors="white")
    return law.explain({name: {"mass": mass} for name, mass in zip(law.objects, MASSES, strict=True)})


def test_coefficients_stand_against_what_they_follow_with_their_intervals(law):
    gravity, drag = plot_relations(law).axes
    assert (gravity.get_title(loc="left"), drag.get_title(loc="left")) == (
        r"$1$ in $\ddot{x}$: universal",
        r"$v$ in $\ddot{x}$: power law",
    )
    assert (drag.get_xlabel(), drag.get_ylabel(), drag.get_xscale()) == ("mass", "−coefficient (1/s)", "log")
    own = law.uncertainty.unpooled
    points = np.array([each.get_xydata()[0] for each in drag.lines if each.get_marker() in MARKERS])
    np.testing.assert_allclose(points, np.column_stack([MASSES, -own.coefficients[:, 1]]))
    (line,) = [each for each in drag.lines if len(each.get_xdata()) > 2]
    np.testing.assert_allclose(
        line.get_ydata(), -law.uncertainty.explanation.relations[1].factors[0] / line.get_xdata()
    )
    bars = next(collection for collection in gravity.collections if isinstance(collection, LineCollection))
    reach = t.ppf(0.975, law.uncertainty.degrees_of_freedom[0])
    np.testing.assert_allclose(np.ptp(bars.get_segments()[0][:, 1]), 2 * reach * np.sqrt(own.covariance[0, 0, 0]))


def test_objects_collapse_onto_one_line_where_several_properties_decide(law):
    charges = np.array([1.0, 3.0, 2.0, 5.0, 4.0])
    changed = {
        name: {"mass": mass * charge, "charge": charge}
        for name, mass, charge in zip(law.objects, MASSES, charges, strict=True)
    }
    both = law.explain(changed)
    assert [str(exponent) for exponent in both.uncertainty.explanation.relations[1].exponents] == ["-1", "1"]
    figure = plot_relations(both)
    assert [panel.get_xlabel() for panel in figure.axes[1:]] == ["mass", "charge", "charge/mass"]
    lines = [sum(len(line.get_xdata()) > 2 for line in panel.lines) for panel in figure.axes[1:]]
    assert lines == [0, 0, 1]


def test_each_objects_own_coefficients_have_the_range_of_their_scatter(law):
    own = law.explain([])
    panel = plot_relations(own).axes[1]
    relation = own.uncertainty.explanation.relations[1]
    (band,) = [collection for collection in panel.collections if isinstance(collection, PolyCollection)]
    ends = band.get_paths()[0].vertices[:, 1]
    expected = relation.factors[0] * np.exp(1.96 * relation.scatter * np.array([1, -1]))
    np.testing.assert_allclose([ends.min(), ends.max()], expected, rtol=1e-3)


def test_a_law_that_was_not_explained_is_refused():
    with refused("relations-missing-to-draw"):
        plot_relations(cl.datasets.linear_drag.truth())


def test_very_many_objects_are_not_told_apart(law, monkeypatch):
    monkeypatch.setattr("commonlaw.plots.relations.MANY", len(MASSES) - 1)
    figure = plot_relations(law)
    gravity = figure.axes[0]
    assert gravity.get_xlabel() == "objects"
    assert {line.get_color() for line in gravity.lines if len(line.get_xdata()) == 1} == {COLORS[0]}
    assert [each.get_text() for each in figure.legends[0].get_texts()] == ["relation"]


def test_an_object_that_says_next_to_nothing_does_not_set_the_scales():
    generator, times = np.random.default_rng(0), [np.linspace(0, 9, 19)] * 4 + [np.array([0.0, 0.5])]
    states = [np.exp(-(0.3 + 0.05 * i) * t) + 0.01 * generator.standard_normal(len(t)) for i, t in enumerate(times)]
    trials = cl.Trials.from_arrays(times, states, object=list("abcde"), names=["x"])
    law = cl.fit("x' = a x + b x^2", trials)
    figure = cl.plots.plot_law(law, trials)
    panels = [panel for panel in figure.axes if panel.get_xlabel() in ("$a$", "$b$")]
    errors = law.params["standard error"].to_numpy().reshape(5, 2)
    for panel, error in zip(panels, errors.T, strict=True):
        assert error[-1] > 1e3 * error[:-1].max()
        assert np.ptp(panel.get_xlim()) < 20 * error[:-1].max()
