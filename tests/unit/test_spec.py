"""Choices written as short texts or as options of a fit, and names that are nearly right."""

import inspect
import re
from dataclasses import dataclass
from typing import get_args

import click
import numpy as np
import pytest
from hypothesis import given, strategies as st

import commonlaw as cl
from commonlaw.app.question import Question, in_page, settings_form
from commonlaw.cli.options import GroupedOption, taking
from commonlaw.cli.question import setting_options
from commonlaw.errors import CommonlawError, unknown
from commonlaw.law.script import written
from commonlaw.runtime.arguments import format_spec, parse_spec
from commonlaw.runtime.digest import digest
from commonlaw.runtime.fit_options import (
    CovarianceKind,
    ErrorKind,
    FitOptions,
    changed_settings,
    documented,
    read_settings,
    setting,
    setting_rows,
    settings_of,
)
from tests.refusals import refused


@dataclass(frozen=True)
class Savgol:
    window: int
    degree: int = 3
    gain: float = 1.0
    mode: str = "interp"
    again: bool = False
    limit: float | None = 2.0

    def __post_init__(self) -> None:
        if self.window < 3:
            raise CommonlawError("other", text=f"the window must hold at least 3 samples, not {self.window}")


MAKERS = {"savgol": Savgol}


@pytest.mark.parametrize(
    ("text", "made"),
    [
        ("savgol:35", Savgol(35)),
        ("savgol:35:2:0.5", Savgol(35, 2, 0.5)),
        ("savgol:35:mode=nearest", Savgol(35, mode="nearest")),
        ("savgol:window=35:again=True", Savgol(35, again=True)),
        ("savgol:35:gain=1e-3:limit=None", Savgol(35, gain=0.001, limit=None)),
    ],
)
def test_arguments_go_by_position_or_name_as_numbers_truths_or_text(text: str, made: Savgol) -> None:
    assert parse_spec("differentiation", text, MAKERS) == made


@given(
    st.builds(
        Savgol,
        window=st.integers(min_value=3),
        degree=st.integers(),
        gain=st.floats(allow_nan=False),
        mode=st.sampled_from(["interp", "nearest", "mirror"]),
        again=st.booleans(),
        limit=st.none() | st.floats(allow_nan=False),
    )
)
def test_what_is_formatted_is_read_back_the_same(made: Savgol) -> None:
    assert parse_spec("differentiation", format_spec("savgol", made), MAKERS) == made


def test_defaults_are_written_out() -> None:
    assert format_spec("savgol", Savgol(35, again=True)) == "savgol:35:3:1.0:interp:True:2.0"


@pytest.mark.parametrize(
    "text",
    ["savgol", "savgol:35:gian=2", "savgol:5:3:1.0:interp:False:2.0:7", "savgol:35:window=5", "savgol:wide",
     "savgol:35:gain=2:gain=3"],
)  # fmt: skip
def test_arguments_that_do_not_fit_are_answered_with_the_usage(text: str) -> None:
    with refused("unknown-name", kind="differentiation", name="savgil"):
        parse_spec("differentiation", "savgil:35", MAKERS)
    with refused("spec-syntax", text=text):
        parse_spec("differentiation", text, MAKERS)


def test_a_value_that_is_refused_names_the_choice_and_is_a_value_error() -> None:
    with refused("other", where="differentiation 'savgol:1'"):
        parse_spec("differentiation", "savgol:1", MAKERS)
    assert issubclass(CommonlawError, ValueError)


@pytest.mark.parametrize(
    ("kind", "name", "known", "sentence"),
    [
        ("solver", "qqq", ["stlsq", "group-stlsq"], "unknown solver 'qqq': Known: stlsq, group-stlsq [unknown-name]"),
        *(("column", near, ["t", "Height"], "did you mean 'Height'?") for near in ("hieght", "HEIGHT", "heigth")),
        ("column", "bal", ["Ball", "ball"], "did you mean 'Ball'?"),
        ("object", 3, [], "unknown object '3': Known: none [unknown-name]"),
        ("object", 7, iter([11, 2]), "unknown object '7': Known: 11, 2 [unknown-name]"),
    ],
)
def test_an_unknown_name_is_answered_with_the_nearest_or_all_known_ones(kind, name, known, sentence) -> None:
    assert sentence in str(unknown(kind, name, known))


FUNCTIONS = {"fit": cl.fit, "refine": cl.refine, "compare": cl.compare}


@pytest.mark.parametrize("name", FUNCTIONS)
def test_a_function_takes_its_settings_by_name_in_order_and_with_their_defaults(name):
    known = settings_of(FitOptions, name)
    taken = {
        parameter.name: parameter
        for parameter in inspect.signature(FUNCTIONS[name]).parameters.values()
        if parameter.name in known
    }
    assert list(taken) == list(known)
    for each, (own, about) in known.items():
        assert taken[each].default == about.default_of(name, own.default), each
        assert taken[each].kind is inspect.Parameter.KEYWORD_ONLY, each


def test_what_functions_and_methods_take_are_the_settings():
    assert list(inspect.signature(cl.TrajectoryLikelihood).parameters) == list(settings_of(FitOptions))
    ours, estimators = inspect.signature(cl.discover).parameters, inspect.signature(cl.LawDiscovery).parameters
    assert list(ours) == ["trials", *estimators, "x_dot", "resume"]
    assert all(ours[name].default == estimators[name].default for name in estimators)
    choices = {name: [*about.choices] for name, (_, about) in settings_of(FitOptions).items() if about.choices}
    assert choices["errors"] == ["auto", *get_args(ErrorKind)]
    assert choices["covariance"] == [*get_args(CovarianceKind)]


@pytest.mark.parametrize("function", [cl.discover, cl.TrajectoryLikelihood, FitOptions, *FUNCTIONS.values()])
def test_a_docstring_describes_every_parameter_in_order(function):
    described = (inspect.getdoc(function) or "").partition("Parameters\n----------\n")[2]
    described = re.split(r"\n\n(?:Raises|Returns)\n", described)[0]
    names = [name for line in re.findall(r"(?m)^(\w[\w, ]*)$", described) for name in line.split(", ")]
    taken = list(inspect.signature(function).parameters)
    assert [name for name in names if name in taken] == taken


@pytest.mark.parametrize(
    ("texts", "values"),
    [
        ({"log_states": ["x", "y"]}, {"log_states": ("x", "y")}),
        ({"noise": ["x=0.1", "y=2"]}, {"noise": {"x": 0.1, "y": 2.0}}),
        ({"huber_threshold": ["inf"], "max_samples": ["500"]}, {"huber_threshold": np.inf, "max_samples": 500}),
        ({"partial_pooling": ["false"], "solver": ["forward"]}, {"partial_pooling": False, "solver": "forward"}),
    ],
)
def test_texts_are_read_as_values_of_their_types(texts, values):
    assert read_settings(FitOptions, texts) == values


@pytest.mark.parametrize(
    ("texts", "code"),
    [
        ({"huber": ["3"]}, "unknown-name"),
        ({"huber_threshold": ["three"]}, "setting-not-a-number"),
        ({"huber_threshold": ["3", "4"]}, "setting-twice"),
        ({"noise": ["x=1", "x=2"]}, "setting-twice"),
        ({"noise": ["0.1"]}, "setting-not-a-number"),
        ({"partial_pooling": ["maybe"]}, "unknown-name"),
    ],
)
def test_texts_that_are_no_settings_are_refused(texts, code):
    with refused(code):
        read_settings(FitOptions, texts)


@pytest.mark.parametrize("name", FUNCTIONS)
def test_a_function_refuses_a_setting_that_does_not_fit(name):
    drops = cl.datasets.linear_drag(drag=(-0.1,), trials=1, noise=0.05)
    for threshold in (0.0, 1.345, np.nan):
        with refused("huber-threshold"):
            FUNCTIONS[name]("x'' = -g", drops, huber_threshold=threshold)
    with refused("noise-not-by-state", value=0.05):
        FUNCTIONS[name]("x'' = -g", drops, noise=0.05)


def test_tables_of_settings_have_defaults_and_changed_ones_differ_from_them():
    values = {"errors": "white", "seed": 0, "partial_pooling": False}
    assert changed_settings("discover", values) == {"errors": "white", "partial_pooling": False}
    assert changed_settings("fit", values) == {"errors": "white"}
    defaults = {name: default for name, default, _ in setting_rows(FitOptions)}
    assert defaults["partial_pooling"] == "true"
    assert defaults["noise"] == ""
    assert {name: default for name, default, _ in setting_rows(FitOptions, "refine")}["partial_pooling"] == "false"


@documented
@dataclass(frozen=True, kw_only=True)
class Extended(FitOptions):
    """Settings, and one more.

    Parameters
    ----------
    {parameters}
    """

    gain: float = setting(default=2.0, label="Gain", text="Gain of the amplifier.", metavar="RATIO", everyday=True)


Extended.__module__ = FitOptions.__module__


@pytest.mark.parametrize("function", ["discover", "fit", "refine"])
def test_a_new_setting_is_an_option_of_commands(function):
    made = click.command()(taking(setting_options(function, Extended))(lambda **_: None))
    (option,) = [param for param in made.params if param.name == "gain"]
    assert (option.opts, option.metavar) == (["--gain"], "RATIO")
    assert "Gain of the amplifier." in option.help
    (take,) = [param for param in made.params if isinstance(param, GroupedOption) and param.name == "settings"]
    assert any(("gain", "Gain of the amplifier.  [default: 2.0]") in rows for rows in take.settings().values())
    assert read_settings(Extended, {"gain": ["3"]}) == {"gain": 3.0}


def test_a_new_setting_is_in_the_form_the_program_the_key_and_the_tables():
    assert settings_form(Extended)[-1] == {
        "name": "gain", "label": "Gain", "text": "Gain of the amplifier", "choices": {}, "default": "2.0",
        "example": "RATIO", "of_fit": True,
    }  # fmt: skip
    assert written(Extended(gain=3.0)) == "cl.runtime.Extended(gain=3.0)"
    assert digest(Extended()) != digest(Extended(gain=3.0))
    assert digest(Extended()) == digest(Extended(n_jobs=2))
    assert [*setting_rows(Extended)][-1] == ("gain", "2.0", "Gain of the amplifier.")
    assert "gain\n    Gain of the amplifier. Default: 2.0." in inspect.getdoc(Extended)


def test_the_page_asks_for_the_method_with_its_settings():
    assert Question("table").method is None
    asked = Question("table", settings={"noise": ("x=0.1",), "errors": ("white",)})
    assert asked.method == cl.TrajectoryLikelihood(noise={"x": 0.1}, errors="white")
    assert in_page("noise=...") == "'Measurement noise' under More choices"
