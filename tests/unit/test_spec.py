"""Choices written as short texts."""

from dataclasses import dataclass

import pytest
from hypothesis import given, strategies as st

from commonlaw.errors import CommonlawError
from commonlaw.runtime.arguments import format_spec, parse_spec
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


def test_an_unknown_name_is_answered_with_the_nearest() -> None:
    with refused("unknown-name", kind="differentiation", name="savgil"):
        parse_spec("differentiation", "savgil:35", MAKERS)


@pytest.mark.parametrize(
    "text", ["savgol", "savgol:35:gian=2", "savgol:5:3:1.0:interp:False:2.0:7", "savgol:35:window=5", "savgol:wide"]
)
def test_arguments_that_do_not_fit_are_answered_with_the_usage(text: str) -> None:
    with refused("spec-syntax"):
        parse_spec("differentiation", text, MAKERS)


def test_an_option_given_twice_is_refused() -> None:
    with refused("spec-syntax", text="savgol:35:gain=2:gain=3"):
        parse_spec("differentiation", "savgol:35:gain=2:gain=3", MAKERS)


def test_a_value_that_is_refused_names_the_choice_and_the_reason() -> None:
    with refused("other", where="differentiation 'savgol:1'"):
        parse_spec("differentiation", "savgol:1", MAKERS)
