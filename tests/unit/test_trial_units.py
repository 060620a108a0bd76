"""Units of trials, and objects without a name."""

import sys
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from time import sleep

import numpy as np
import pandas as pd
import pytest

from commonlaw.law import Law, Uncertainty
from commonlaw.library import Variables, parse_library
from commonlaw.trials import Schema, Trial, Trials, headers
from commonlaw.trials.headers import known_unit, registry
from commonlaw.trials.transformations import in_units, with_logarithms, with_starts, without_rates
from commonlaw.trials.units import Conversion
from tests.refusals import refused


def test_units_without_a_unit_column_are_only_missing_where_used():
    times = np.arange(30) / 15
    (finding,) = Trials.from_arrays(times, 50 - 4.9 * times**2, names=["h"], units={"h": "m"}).check().findings
    assert finding.startswith("no unit is known for t:")


@pytest.mark.parametrize("unit", ["cells", "individuals", "CFU", "OD", "IU", "counts", "people", "copies", "ind"])
def test_counts_are_units_without_a_dimension(unit):
    assert known_unit(unit).dimensionless
    trials = Trials.from_frame(pd.DataFrame({f"N [{unit}/mL]": [1.0, 2.0], "t [min]": [0.0, 1.0]}))
    assert trials.schema.states == ("N",)
    assert trials.schema.units == {"N": f"{unit}/mL", "t": "min"}


@pytest.mark.parametrize(
    ("header", "name", "unit", "size"),
    [
        ("NH4 mg/l", "NH4", "kg/m^3", 1e-3),
        ("Conc. in mg/L", "Conc.", "kg/m^3", 1e-3),
        ("c(A) / mol L-1", "c(A)", "mol/m^3", 1e3),
        ("v/m s-1", "v", "m/s", 1.0),
        ("volume (mm3)", "volume", "m^3", 1e-9),
        ("cells (x10^6/mL)", "cells", "1/m^3", 1e12),
        ("cells [10⁹ CFU/L]", "cells", "1/m^3", 1e12),
    ],
)
def test_units_are_read_as_laboratories_write_them(header, name, unit, size):
    trials = Trials.from_frame(pd.DataFrame({"t/s": [0.0, 1.0], header: [1.0, 2.0]}))
    assert trials.schema.states == (name,)
    assert registry().Quantity(1, known_unit(trials.schema.units[name])).m_as(unit) == pytest.approx(size)


@pytest.mark.parametrize(
    "header", ["x (t-1)", "plate (A-1)", "glucose 2 g/L", "ratio A/V", "sensor (s2)", "w (kg/kg dm)"]
)
def test_labels_and_conditions_are_no_units(header):
    assert headers.split_header(header) == (header, "")


def test_years_are_written_yr_and_read_by_any_name():
    assert [f"{known_unit(unit):~P}" for unit in ("1/a", "1/year", "1/yr")] == ["1/yr"] * 3


def test_counts_are_converted_as_numbers():
    assert registry().Quantity(120, "CPM").m_as("counts/s") == pytest.approx(2)
    assert registry().Quantity(1, "cells/mL").m_as("1/L") == pytest.approx(1000)
    assert registry().Quantity(0.01, "OD/min").m_as("OD/h") == pytest.approx(0.6)


@pytest.mark.parametrize(("unit", "name"), [("m", "meter"), ("cd", "candela"), ("pF", "picofarad"), ("P", "poise")])
def test_counts_take_no_unit_of_physics_away(unit, name):
    assert str(known_unit(unit)) == name


def test_units_can_be_compared_where_several_threads_use_them_first(monkeypatch):
    made = []

    @cache
    def slow():
        sleep(0.02)
        made.append(object())
        return made[-1]

    monkeypatch.setattr(headers, "_registry", slow)
    with ThreadPoolExecutor(8) as pool:
        assert len({*pool.map(lambda _: registry(), range(8))}) == len(made) == 1


def test_limits_of_quantification_change_with_their_state():
    states, below = np.array([[3.0, 0.0], [np.nan, 1.0], [2.0, 1.0]]), np.full((3, 2), np.nan)
    below[1, 0] = 500.0
    trial = Trial("a", "1", [0.0, 1.0, 2.0], states, below=below)
    trials = Trials((trial,), Schema(("m", "v"), units={"m": "mg"}))
    assert in_units(trials, {"m": "g"})[0].below[1, 0] == pytest.approx(0.5)
    logarithmic = with_logarithms(trials, ["m"])
    assert logarithmic[0].below[1, 0] == pytest.approx(np.log(500))
    assert in_units(logarithmic, {"m": "g"})[0].below[1, 0] == pytest.approx(np.log(0.5))
    np.testing.assert_array_equal(without_rates(trials, {"m": "v"})[0].below, below[:, :1])
    assert with_starts(trials, {"s": 1.0}, -1.0)[0].below[2, 0] == 500.0


FRAME = pd.DataFrame({"t": np.arange(8.0), "x": np.exp(-np.arange(8.0))})


def law_of(*objects):
    terms, count = parse_library("terms:x").bind(Variables(("x",))), len(objects)
    rates = -np.arange(1.0, count + 1).reshape(-1, 1, 1)
    return Law(
        terms, Schema(("x",)), 1, objects, rates, uncertainty=Uncertainty(1e-4 * np.ones((count, 1, 1)), noise=[0.1])
    )


def test_an_object_is_nameless_where_neither_table_nor_user_names_it():
    assert Trials.from_frame(FRAME).nameless
    assert Trials.from_arrays(FRAME["t"], FRAME["x"]).nameless
    assert Trials.from_frame(FRAME)[[0]].nameless
    assert not Trials.from_frame(FRAME, object_name="cup").nameless
    assert Trials.from_frame(FRAME, object_name="cup").objects == ("cup",)
    assert not Trials.from_frame(FRAME.assign(object="cup")).nameless
    assert not Trials.from_arrays(FRAME["t"], FRAME["x"], object="cup").nameless
    with refused("object-column-and-name", column="object"):
        Trials.from_frame(FRAME.assign(object="cup"), object_name="cup")


def test_a_nameless_object_is_the_only_one_of_a_law_or_refused():
    nameless, named = Trials.from_frame(FRAME), Trials.from_frame(FRAME, object_name="cup")
    forecast, expected = (law_of("cup").predict(each, return_std=True) for each in (nameless, named))
    np.testing.assert_array_equal(forecast.trajectories[0].states, expected.trajectories[0].states)
    np.testing.assert_array_equal(forecast.std[0], expected.std[0])
    assert forecast.trials.objects == ("object",)
    remark = "no object is named: object has the coefficients of cup, the only object of the law"
    assert forecast.trials.notes == (remark,)
    assert expected.trials.notes == ()
    assert law_of("object", "cup").predict(nameless).trials.notes == ()
    with refused("object-unnamed", objects="cup, pot"):
        law_of("cup", "pot").predict(Trials.from_frame(FRAME))
    with refused("unknown-name", kind="object of this law", name="mug"):
        law_of("cup").predict(Trials.from_frame(FRAME, object_name="mug"))


@pytest.mark.parametrize(
    ("written", "usual"),
    [
        ("kOhm", "kohm"), ("Volts", "V"), ("Sec", "s"), ("RPM", "rpm"), ("m/s2", "m/s^2"), ("W m-2", "W/m^2"),
        ("ms-1", "m/s"), ("deg C", "degC"), ("ºC", "degC"), ("Nm", "N*m"), ("mNm", "mN*m"), ("amps", "A"),
        ("dps", "deg/s"), ("pct", "percent"), ("Min", "min"),
    ],
)  # fmt: skip
def test_units_as_people_write_them(written, usual):
    assert known_unit(written) == known_unit(usual)


@pytest.mark.parametrize("text", ["Mean", "Run", "Total", "MPA", "CO2", "x2", "1e3"])
def test_other_words_are_no_units(text):
    assert known_unit(text) is None


def test_temperatures_are_not_in_coulombs():
    frame = pd.DataFrame({"t (s)": [0.0, 1.0], "Temperature(C)": [20.0, 21.0], "T_out (F)": [1, 2], "Q (C)": [1, 2]})
    units = Trials.from_frame(frame).schema.units
    assert units == {"t": "s", "Temperature": "°C", "T_out": "°F", "Q": "C"}


@pytest.mark.parametrize(("given", "wanted"), [("1", "dB"), ("cell", "dB"), ("dB", "1")])
def test_a_unit_on_a_logarithmic_scale_is_refused_without_a_warning(given, wanted):
    with refused("units-incompatible", name="x", unit=given, law_unit=wanted):
        Conversion.between("x", given, wanted)


@pytest.mark.parametrize(("given", "wanted"), [(None, "m"), ("m", None), ("m", "m"), (None, None)])
def test_equal_units_need_no_registry(monkeypatch, given, wanted):
    monkeypatch.setitem(sys.modules, "pint", None)
    assert not Conversion.between("x", given, wanted)
