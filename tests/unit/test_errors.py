"""Unknown names are answered with the nearest known one."""

import pytest

from commonlaw.errors import CommonlawError, unknown


def test_an_unknown_name_is_quoted_with_its_kind_and_all_known_names() -> None:
    assert (
        str(unknown("solver", "qqq", ["stlsq", "group-stlsq"]))
        == "unknown solver 'qqq': Known: stlsq, group-stlsq [unknown-name]"
    )


@pytest.mark.parametrize("misspelt", ["hieght", "HEIGHT", "heigth"])
def test_a_near_miss_is_suggested_in_its_known_spelling(misspelt: str) -> None:
    assert "did you mean 'Height'?" in str(unknown("column", misspelt, ["t", "Height"]))


def test_of_names_that_differ_in_case_only_the_first_is_suggested() -> None:
    assert "did you mean 'Ball'?" in str(unknown("column", "bal", ["Ball", "ball"]))


def test_nothing_known_is_said_so() -> None:
    assert str(unknown("object", 3, [])) == "unknown object '3': Known: none [unknown-name]"


def test_names_need_not_be_text() -> None:
    assert str(unknown("object", 7, iter([11, 2]))) == "unknown object '7': Known: 11, 2 [unknown-name]"


def test_a_user_error_is_a_value_error_for_those_who_catch_that() -> None:
    assert issubclass(CommonlawError, ValueError)
