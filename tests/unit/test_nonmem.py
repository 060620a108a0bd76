"""NONMEM data sets: what their columns mean, and fits of them against independent least squares."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from scipy.optimize import least_squares

import commonlaw as cl
from commonlaw import CommonlawError
from commonlaw.app.equations import solved
from commonlaw.app.question import Equations, Table
from commonlaw.cli.results import load
from commonlaw.cli.source import Source
from commonlaw.law.models import model_named
from commonlaw.law.observation import Observation
from commonlaw.law.parameters import named_parameters
from commonlaw.law.printing import start_lines
from commonlaw.trials.trial import Dose
from commonlaw.verdict import find
from tests.refusals import refused

pytestmark = pytest.mark.usefixtures("few_starts")

ONE = "DV' = -k DV + AMT/V"


def data_set(*rows: tuple[float, ...], columns: str) -> pd.DataFrame:
    """Return a table of rows, of one individual unless the columns have an ID."""
    frame = pd.DataFrame(rows, columns=columns.split())
    return frame if "ID" in frame else frame.assign(ID=1)


def bolus(time: float, amount: float, k: float, volume: float) -> Callable[[np.ndarray], np.ndarray]:
    return lambda t: np.where(t > time, amount / volume * np.exp(-k * np.clip(t - time, 0, None)), 0.0)


def infusion(time: float, amount: float, long: float, k: float, volume: float) -> Callable[[np.ndarray], np.ndarray]:
    def level(t: np.ndarray) -> np.ndarray:
        since, after = np.clip(t - time, 0, long), np.clip(t - time - long, 0, None)
        return amount / (long * volume * k) * (1 - np.exp(-k * since)) * np.exp(-k * after)

    return level


def test_rows_that_are_no_measurements() -> None:
    table = data_set(
        (0, 100, 0, 1, 1), (1, 0, 8, 0, 0), (2, 0, 0, 1, 2), (3, 0, 5, 0, 0), (4, 0, 9, 1, 0), (5, 0, 4, 0, 0),
        columns="TIME AMT DV MDV EVID",
    )  # fmt: skip
    (trial,) = cl.Trials.from_frame(table)
    seen = np.isfinite(trial.states[:, 0])
    assert trial.times[seen].tolist() == [1, 3, 5]
    assert trial.doses == (Dose(0, 100),)


@pytest.mark.parametrize("filled", [0.0, np.nan])
def test_amounts_alone_mark_doses(filled: float) -> None:
    table = data_set((0, 100, filled), (1, 0, 8), (2, 0, 5), (3, 50, filled), (4, 0, 6), columns="TIME AMT DV")
    (trial,) = cl.Trials.from_frame(table)
    assert trial.times.tolist() == [1, 2, 4]
    assert [dose.amount for dose in trial.doses] == [100, 50]


def test_amounts_may_be_called_doses_and_measurements_concentrations() -> None:
    table = data_set((0, 100, 0, 1), (1, 0, 8, 0), (2, 0, 5, 0), (3, 0, 4, 0), columns="TIME dose conc MDV")
    (trial,) = trials = cl.Trials.from_frame(table)
    assert (trials.schema.states, trial.times.tolist(), trial.doses) == (("conc",), [1, 2, 3], (Dose(0, 100),))


def test_amounts_are_doses_where_their_rows_lack_measurements() -> None:
    time, dose = np.arange(6.0), [100, np.nan, np.nan, 40, np.nan, np.nan]
    conc, effect = [np.nan, 8, 5, np.nan, 7, np.nan], [np.nan, np.nan, 2, np.nan, np.nan, 1]
    table = pd.DataFrame({"time": time, "dose": dose, "conc": conc, "effect": effect, "weight": 70.0})
    (trial,) = trials = cl.Trials.from_frame(table)
    assert [(given.time, given.amount) for given in trial.doses] == [(0, 100), (3, 40)]
    assert (trials.schema.states, trial.times.tolist()) == (("conc", "effect"), [1, 2, 4, 5])
    assert cl.Trials.from_frame(table, inputs="dose").schema.inputs == ("dose",)


def test_amounts_between_samples_are_doses_by_name_alone() -> None:
    """A measurement in the row of a dose may have been before or after it."""
    dose = [100.0, np.nan, np.nan, 40, np.nan, np.nan]
    trials = cl.Trials.from_frame({"time": np.arange(6.0), "dose": dose, "conc": [0.0, 8, 5, 3, 7, 4]})
    assert trials.schema.inputs == ("dose",)
    with pytest.raises(CommonlawError) as caught:
        cl.fit("conc' = -k conc + dose/V", trials)
    assert (caught.value.code, caught.value.parameters["name"]) == ("doses-interpolated", "dose")


def test_infusions_repeats_and_compartments() -> None:
    table = data_set(
        (0, 100, 50, 2, 12, 1, 1), (1, 0, 0, 0, 0, 0, 2), (30, 60, 0, 0, 0, 1, 2), (31, 0, 0, 0, 0, 0, 2),
        columns="TIME AMT RATE ADDL II EVID CMT",
    ).assign(DV=[0, 5, 0, 3])  # fmt: skip
    (trial,) = cl.Trials.from_frame(table)
    expected = [Dose(time, 100, 2, 1) for time in (0, 12, 24)] + [Dose(30, 60, 0, 2)]
    assert trial.doses == tuple(expected)


def test_resets_begin_trials() -> None:
    rows = (0, 100, 1), (1, 0, 0), (2, 0, 0), (5, 0, 3), (6, 50, 1), (7, 0, 0), (9, 80, 4), (10, 0, 0)
    trials = cl.Trials.from_frame(data_set(*rows, columns="TIME AMT EVID").assign(DV=1.0))
    assert [trial.name for trial in trials] == ["1", "2", "3"]
    assert [trial.times.tolist() for trial in trials] == [[1, 2], [7], [10]]
    assert [[(dose.time, dose.amount) for dose in trial.doses] for trial in trials] == [
        [(0, 100)],
        [(5, 0), (6, 50)],
        [(9, 80)],
    ]


@pytest.mark.parametrize(("column", "names"), [("DVID", ("DV1", "DV2")), ("CMT", ("DV1", "DV2"))])
def test_quantities_are_columns(column: str, names: tuple[str, ...]) -> None:
    rows = (0, 100, 0, 1, 1), (1, 0, 8, 0, 1), (1, 0, 80, 0, 2), (2, 0, 5, 0, 1), (3, 0, 60, 0, 2)
    (trial,) = trials = cl.Trials.from_frame(data_set(*rows, columns=f"TIME AMT DV EVID {column}"))
    assert trials.schema.states == names
    assert np.array_equal(trial.states, [[8, 80], [5, np.nan], [np.nan, 60]], equal_nan=True)


def test_columns_of_records_and_codes_have_no_other_role() -> None:
    rng, rows = np.random.default_rng(0), []
    for patient in range(1, 7):
        for time in range(5):
            given = {"AMT": 100.0 * (time == 0), "EVID": int(time == 0), "MDV": int(time == 0), "CMT": 1 + (time > 0)}
            rows.append({"ID": patient, "TIME": float(time), "DV": rng.uniform(1, 9), "SEX": 1 + patient % 2} | given)
            rows[-1] |= {"RACE": patient % 3, "CRCL": rng.uniform(50, 90), "OCC": 1 + (time > 2)}
    trials = cl.Trials.from_frame(pd.DataFrame(rows))
    assert (trials.schema.object, trials.schema.states, trials.schema.inputs) == ("ID", ("DV",), ())
    assert len(trials) == len(trials.objects) == 6
    assert trials.properties["1"] == {"SEX": 2.0, "RACE": 1.0}


REFUSED: dict[str, dict[str, float]] = {
    "nonmem-event": {"EVID": 101},
    "nonmem-amount-negative": {"AMT": -5},
    "nonmem-amount-of-no-dose": {"EVID": 0},
    "nonmem-rate-of-model": {"RATE": -2},
    "nonmem-infusion-endless": {"AMT": 0, "RATE": 5, "SS": 1},
    "nonmem-steady-state": {"SS": 2, "II": 12},
    "nonmem-repeats": {"ADDL": 1.5, "II": 12},
    "nonmem-interval": {"ADDL": 3},
    "nonmem-compartment": {"CMT": -1},
    "nonmem-doses-too-many": {"ADDL": 10**9, "II": 12},
}


@pytest.mark.parametrize("code", REFUSED)
def test_what_is_not_supported_is_refused_by_its_row(code: str) -> None:
    table = pd.DataFrame({"ID": 1, "TIME": [0.0, 1, 2, 3], "DV": [0.0, 9, 7, 5], "EVID": [1, 0, 0, 0]})
    table = table.assign(AMT=100.0 * table.EVID, RATE=0.0, ADDL=0.0, II=0.0, SS=0, CMT=1)
    for name, value in REFUSED[code].items():
        table[name] = table[name].astype(float)
        table.loc[0, name] = value
    with pytest.raises(CommonlawError) as caught:
        cl.Trials.from_frame(table)
    assert caught.value.code == code
    assert "row 1" in str(caught.value) or code == "nonmem-doses-too-many"


TWICE = [1, 0, 0, 0, 1, 0, 0, 0, 0]


def oral(**changes: object) -> cl.Trials:
    table = pd.DataFrame({"ID": 1, "TIME": np.arange(9.0), "EVID": [1, *[0] * 8]})
    table = table.assign(**{name: value for name, value in changes.items() if name == "EVID"})
    table = table.assign(DV=0.9**table.TIME, AMT=100.0 * table.EVID, CMT=2 - table.EVID)
    return cl.Trials.from_frame(table.assign(**changes))


@pytest.mark.parametrize(
    ("equations", "changes", "code"),
    [
        ("DV' = -k DV", {}, "dose-into-measured"),
        ("DV' = -k DV", {"CMT": 0}, "doses-in-no-equation"),
        ("C' = -k C; DV = C/V; C(0) = 0.0", {"CMT": 0}, "doses-in-no-equation"),
        ("DV' = -k DV + AMT/V; DV(0) = AMT/V", {}, "dose-outside-equation"),
        ("depot' = -ka depot; DV' = ka depot/V - k DV", {"CMT": 3}, "dose-into-no-equation"),
        ("depot' = -ka depot + AMT; DV' = ka depot/V - k DV + AMT/V", {}, "dose-elsewhere"),
        ("DV' = -k DV + AMT/V + RATE/V", {"RATE": 0}, "dose-twice"),
        ("DV' = -k DV + RATE/V", {"RATE": 0}, "doses-without-rate"),
        ("DV' = -k DV + AMT2/V", {}, "dose-into-measured"),
    ],
)
def test_doses_whose_place_is_unclear_are_refused(equations: str, changes: dict[str, object], code: str) -> None:
    trials = oral(EVID=TWICE, **changes)
    with pytest.raises(CommonlawError) as caught:
        cl.fit(equations, trials)
    assert caught.value.code == code


def test_a_dose_before_all_samples_is_in_an_equation_where_starts_are_zero() -> None:
    table = pd.DataFrame({"ID": 1, "TIME": [0.0, 1, 2, 4], "AMT": [100.0, 0, 0, 0], "DV": [np.nan, 9, 8, 6]})
    trials = cl.Trials.from_frame(table.assign(EVID=[1, 0, 0, 0]))
    with pytest.raises(CommonlawError) as caught:
        cl.fit("C' = -k C; DV = C/V; C(0) = 0", trials)
    assert caught.value.code == "doses-in-no-equation"


def test_searches_and_laws_without_doses_refuse_them() -> None:
    trials = oral(EVID=TWICE)
    law = cl.Law.from_text("DV' = -k DV", {"k": {"1": 0.1}})
    for use in (cl.discover, law.predict):
        with pytest.raises(CommonlawError) as caught:
            use(trials)
        assert caught.value.code == "doses-recorded"


def five(kind: str) -> tuple[pd.DataFrame, dict[int, tuple[Any, Any, Any]]]:
    """Return a table of five subjects with errors of 3 %, and of each its times, values and doses."""
    rng, rows, subjects = np.random.default_rng(5), [], {}
    for subject in range(1, 6):
        k, volume = rng.uniform(0.06, 0.2), rng.uniform(8, 30)
        if kind == "neonates":  # A loading dose, maintenance doses, and few samples at odd times
            doses = [(0.0, 25.0, 0.0), *((12.5 + 12 * i, 3.5, 0.0) for i in range(4))]
            times = np.sort(rng.choice(np.arange(2.0, 60, 1.7), 4, replace=False))
        else:
            doses = [(0.0, 200.0, 2.0), (24.0, 150.0, 1.5)]
            times = np.array([0.5, 1, 2, 3, 6, 10, 24, 25, 26, 30, 40])
        level = modelled(times, doses, k, volume)
        values = level * (1 + 0.03 * rng.standard_normal(len(times)))
        subjects[subject] = times, values, doses
        for time, amount, long in doses:
            rate = amount / long if long else 0.0
            rows.append({"ID": subject, "TIME": time, "AMT": amount, "RATE": rate, "DV": 0.0, "MDV": 1})
        rows += [
            {"ID": subject, "TIME": t, "AMT": 0.0, "RATE": 0.0, "DV": y, "MDV": 0}
            for t, y in zip(times, values, strict=True)
        ]
    table = pd.DataFrame(rows).sort_values(["ID", "TIME", "AMT"], kind="stable")
    return table if kind == "infusions" else table.drop(columns="RATE"), subjects


def modelled(times: np.ndarray, doses: list[tuple[float, ...]], k: float, volume: float) -> np.ndarray:
    parts = [infusion(t, a, long, k, volume) if long else bolus(t, a, k, volume) for t, a, long in doses]
    return np.sum([part(times) for part in parts], axis=0)


@pytest.mark.parametrize(
    ("kind", "equation"),
    [pytest.param("neonates", ONE, marks=pytest.mark.slow), ("infusions", "DV' = -k DV + RATE/V")],
)
def test_estimates_are_those_of_least_squares(kind: str, equation: str) -> None:
    table, subjects = five(kind)
    law = cl.fit(equation, cl.Trials.from_frame(table), errors="white")
    estimates = law.params.pivot_table(index="object", columns="parameter", values="estimate")
    for subject, (times, values, doses) in subjects.items():
        best = least_squares(
            lambda p, t=times, y=values, d=doses: modelled(t, d, *np.exp(p)) - y, np.log([0.1, 15.0]), xtol=1e-12
        )
        variance = 2 * best.cost / (len(times) - 2)
        errors = np.exp(best.x) * np.sqrt(variance * np.diag(np.linalg.inv(best.jac.T @ best.jac)))
        found = estimates.loc[str(subject), ["k", "V"]].to_numpy(dtype=float)
        assert np.abs(found - np.exp(best.x)).max() < 1.0
        assert (np.abs(found - np.exp(best.x)) / errors).max() < 0.1
    forecast = find(law, cl.Trials.from_frame(table), bands=False).forecast
    assert forecast is not None
    assert not forecast.is_fit


def test_doses_in_alternate_rows_are_those_of_records() -> None:
    table, _ = five("neonates")
    is_dose = table.MDV == 1
    columns = {"dose": table.AMT.where(is_dose), "weight": table.ID / 4, "conc": table.DV.where(~is_dose)}
    alternate = cl.Trials.from_frame(pd.DataFrame({"Subject": table.ID, "time": table.TIME, **columns}))
    for trial, other in zip(cl.Trials.from_frame(table), alternate, strict=True):
        assert (trial.object, trial.doses, trial.times.tolist()) == (other.object, other.doses, other.times.tolist())
        assert np.array_equal(trial.states, other.states)


def test_tables_of_forecasts_have_times_measured_or_wanted_and_states_after_doses() -> None:
    measured, wanted = [1.0, 2.0, 4.0, 5.0, 7.0], [0.0, 3.0, 9.0]
    doses = [(0.0, 100.0, 0.0), (3.0, 50.0, 0.0)]
    table = pd.DataFrame({"TIME": measured, "DV": modelled(np.array(measured), doses, 0.4, 8.0)})
    given = pd.DataFrame({"TIME": [0.0, 3.0], "AMT": [100.0, 50.0]})
    trials = cl.Trials.from_frame(pd.concat([table, given]).sort_values("TIME", ignore_index=True))
    law = cl.fit(ONE, trials)
    assert law.predict(trials).to_frame()["TIME"].tolist() == measured
    frame = law.predict(trials, times=wanted).to_frame()
    after = modelled(np.array(wanted) + 1e-9, doses, 0.4, 8.0)
    assert frame["TIME"].tolist() == sorted(measured + wanted)
    assert np.allclose(frame["DV forecast"][frame["TIME"].isin(wanted)], after, rtol=1e-3)
    bands = law.predict(trials, times=wanted, return_std=True).interval()
    assert bands["TIME"].tolist() == sorted(measured + wanted)
    assert (bands["high"] > bands["low"]).all()
    with refused("option-without-effect", option="from_time=3"):  # All is zero before the first dose
        law.predict(trials, from_time=3.0)


@pytest.mark.parametrize("given", [{}, {"inputs": ("dose",)}])
def test_compartments_need_no_column_where_there_are_doses(given: dict[str, tuple[str, ...]], tmp_path: Path) -> None:
    (tmp_path / "oral.csv").write_text("patient,h,dose,conc\n1,0,320,\n1,1,,4\n1,2,,5\n1,4,,3\n1,9,,1\n")
    source = Source.of(str(tmp_path / "oral.csv"), given)
    trials = load(source, ["depot' = -ka depot + dose; conc' = ka depot/V - k conc"], dosed=bool(given))
    assert (trials.schema.states, trials.schema.inputs) == (("conc",), given.get("inputs", ()))


def test_other_verbs_take_the_doses(tmp_path: Path) -> None:
    table, _ = five("infusions")
    trials = cl.Trials.from_frame(table[table.ID == 1])
    law = cl.fit(ONE, trials)
    law.save(tmp_path / "law.json")
    assert cl.Law.load(tmp_path / "law.json").predict(trials).errors()["rms error"].max() < 0.3
    other = cl.fit("DV' = -k DV + c + AMT/V", trials)
    assert cl.compare({"decay": law, "inflow": other}, trials)["law"].tolist() == ["decay", "inflow"]
    assert np.allclose(cl.refine(law, trials).params.estimate, law.params.estimate, rtol=1e-4)
    assert cl.Trials.from_frame(trials.to_frame(), time="TIME", object="ID").schema == trials.schema


def test_forecasts_refuse_doses_into_other_compartments() -> None:
    law = cl.fit("DV' = -k DV + AMT1/V", oral())
    with pytest.raises(CommonlawError) as caught:
        law.predict(oral(CMT=2))
    assert caught.value.code == "doses-into-other-compartments"


def test_amounts_are_converted_to_the_units_of_a_law() -> None:
    table, _ = five("neonates")
    named = {"TIME": "TIME [h]", "AMT": "AMT [mg]", "DV": "DV [mg/L]"}
    table = table[table.ID == 1]
    law = cl.fit(ONE, cl.Trials.from_frame(table.rename(columns=named)))
    grams = table.assign(AMT=table.AMT / 1000, TIME=table.TIME * 60)
    named |= {"AMT": "AMT [g]", "TIME": "TIME [min]"}
    one, two = (law.predict(cl.Trials.from_frame(t.rename(columns=named | units))) for t, units in (
        (table, {"AMT": "AMT [mg]", "TIME": "TIME [h]"}), (grams, {}),
    ))  # fmt: skip
    assert np.allclose(one.errors()["rms error"], two.errors()["rms error"], rtol=1e-4)


def test_measurements_in_rows_after_a_dose_at_the_same_time_show_it() -> None:
    rows = (0, 100, 0, 1), (0, 0, 10, 0), (1, 0, 9.1, 0), (2, 0, 8.2, 0), (3, 0, 7.4, 0), (4, 0, 6.7, 0)
    law = cl.fit(ONE, cl.Trials.from_frame(data_set(*rows, columns="TIME AMT DV EVID")))
    assert law.params.set_index("parameter").estimate["V"] == pytest.approx(10, rel=0.01)


def test_the_app_reads_and_fits_equations_with_recorded_doses() -> None:
    table, _ = five("infusions")
    page_table = Table("pk.csv", table[table.ID == 1].to_csv(index=False).encode())
    equations = Equations("DV' = -k DV + RATE/V", values={"k": (0.1,), "V": (15.0,)}, doses=("RATE",))
    drawn = solved(page_table, {}, equations)
    assert drawn["problem"] == ""
    assert [*drawn["values"]] == ["k", "V"]
    trials = page_table.trials({})
    fitted = equations.fit(trials, {})
    assert np.allclose(fitted.params.estimate, cl.fit(ONE, trials).params.estimate, rtol=1e-4)


@pytest.mark.parametrize(
    ("name", "equations"),
    [
        ("one-compartment-with-doses", "DV' = -k DV + AMT/V"),
        ("one-compartment", "DV' = -k DV + AMT/V"),
        ("two-compartments", "DV' = -(k + f) DV + b p + AMT/V; p' = f DV - b p"),
        ("one-compartment-with-absorption", "depot' = -a depot + AMT; DV' = a depot/V - k DV"),
    ],
)
def test_named_models_take_recorded_doses(name: str, equations: str) -> None:
    """Also where a property is called like the doses of the model."""
    schema = oral().schema
    for changes in ("", ":dose=AMT", ":c=DV:dose=AMT"):
        named = model_named(name + changes)
        assert named is not None
        model = named[0].over_columns(schema, ["dose"], named[1])
        assert [part for part in model.equations.split("; ") if ">" not in part] == equations.split("; ")
        assert (model.doses, model.properties) == (("AMT",), ())
    named = model_named("one-compartment:dose=dose")
    assert named is not None
    assert "DV(0) = dose/V" in named[0].over_columns(schema, ["dose"], named[1]).equations


def test_a_named_model_is_fitted_to_recorded_doses() -> None:
    times = np.array([0.0, 0.25, 0.5, 1, 1.5, 2, 3, 4, 6, 9])
    table = pd.DataFrame({"ID": 1, "TIME": times, "AMT": [80.0, *[0] * 9], "EVID": [1, *[0] * 9], "MDV": 0, "CMT": 2})
    for name, level in {
        "one-compartment": 8 * np.exp(-0.3 * times),
        "one-compartment-with-absorption": 8 * 1.2 / 0.9 * (np.exp(-0.3 * times) - np.exp(-1.2 * times)),
    }.items():
        values = level * (1 + 0.01 * np.cos(7 * times))
        estimates = cl.fit(name, cl.Trials.from_frame(table.assign(DV=values))).params.set_index("parameter").estimate
        assert (estimates["k"], estimates["V"]) == pytest.approx((0.3, 10), rel=0.02)


def test_streams_refuse_recorded_doses(tmp_path: Path) -> None:
    pytest.importorskip("pyarrow")
    table, _ = five("infusions")
    table.assign(trial="1").to_parquet(tmp_path / "pk.parquet")
    with pytest.raises(CommonlawError) as caught:
        cl.TrialStream.from_parquet(tmp_path / "pk.parquet", object="ID", trial="trial", time="TIME", states=["DV"])
    assert caught.value.code == "doses-in-stream"


def test_codes_of_sex_are_no_labels_and_no_states() -> None:
    rng = np.random.default_rng(1)
    rows = [(day, sex, value) for sex in (1, 2) for day, value in enumerate(rng.uniform(1, 2, 9))]
    table = pd.DataFrame(rows, columns=["day", "sex", "weight"])
    with pytest.raises(CommonlawError) as caught:
        cl.Trials.from_frame(table)
    assert caught.value.code == "time-repeated"
    assert "sex" not in str(caught.value)
    trials = cl.Trials.from_frame(table.assign(day=np.arange(18.0)))
    assert (trials.schema.states, trials.schema.inputs, len(trials)) == (("weight",), (), 1)


def test_rates_are_not_proposed_as_doses() -> None:
    table = pd.DataFrame({"t": np.arange(9.0), "c": np.exp(-np.arange(9.0)), "RATE": [5.0, 0, 0, 0, 5, 0, 0, 0, 0]})
    assert not any("doses=" in note for note in cl.Trials.from_frame(table, inputs=["RATE"]).notes)


def test_starts_of_trials_that_a_dose_begins_are_at_the_dose() -> None:
    law = cl.Law.from_text("c' = -k c + dose", {"k": 0.2}, inputs=("dose",))
    observation = Observation(cl.Schema(("y",)), {"y": "2 c"}, {"c": "0"})
    for doses, when in (("dose",), "dose or sample"), ((), "sample"):
        schema = replace(law.schema, doses=doses)
        of_doses = replace(law, schema=schema, observation=observation, scheme="shooting")
        assert start_lines(of_doses) == [f"c(0) at the first {when} of each trial"]


def test_starts_in_a_steady_state_are_noted_and_are_no_zeros() -> None:
    rows = [(0, 100, 12, 1, 1, 0), *((t, 0, 0, 0, 0, 8 * np.exp(-0.1 * t)) for t in (1.0, 2, 4, 6, 9, 11))]
    table = data_set(*rows, columns="TIME AMT II SS EVID DV")
    law = cl.fit("DV' = -0.1 DV + AMT/V", cl.Trials.from_frame(table))
    assert "starts-in-steady-state" in {diagnostic.code for diagnostic in law.diagnostics}
    assert not [step for step in law.history if step.stage == "start"]
    law = cl.fit("DV' = -0.1 DV + AMT/V", cl.Trials.from_frame(table.assign(SS=0)))
    assert "starts-in-steady-state" not in {diagnostic.code for diagnostic in law.diagnostics}
    assert [step.choice for step in law.history if step.stage == "start"] == ["DV = 0"]


def test_absorption_of_repeated_doses_is_found_from_the_steady_state():
    """Times of trials that are many half-lives long: rates lie between those of a trial and of a sampling step."""
    true, rows = {1: (1.58, 0.30, 16.0), 2: (0.93, 0.20, 25.0), 3: (1.80, 0.13, 9.5)}, list[dict[str, object]]()
    times = np.array([0.5, 1.25, 2, 2.75, 3.5, 6, 9, 11, 13, 14, 16.5, 20.5, 25, 30, 37])
    source = np.random.default_rng(6)
    for subject, (ka, k, volume) in true.items():
        since = np.maximum(times[:, np.newaxis] - 12.0 * np.arange(-80, 4), 0.0)
        curve = 200 * ka / volume / (ka - k) * (np.exp(-k * since) - np.exp(-ka * since)).sum(axis=1)
        curve += 0.03 * curve.mean() * source.standard_normal(len(times))
        rows.append({"ID": subject, "TIME": 0.0, "AMT": 200.0, "EVID": 1, "CMT": 1, "II": 12.0, "ADDL": 3, "SS": 1})
        rows += [{"ID": subject, "TIME": at, "DV": y, "EVID": 0, "CMT": 2} for at, y in zip(times, curve, strict=True)]
    trials = cl.Trials.from_frame(pd.DataFrame(rows))
    named = named_parameters(cl.fit("depot' = -ka depot; DV' = ka depot/V - k DV", trials, errors="white"))
    values = [[row[named.names.index(name)] for name in ("ka", "k", "V")] for row in named.values]
    np.testing.assert_allclose(values, [*true.values()], rtol=0.25)
