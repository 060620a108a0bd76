"""What goes out to a file comes back bit for bit, whatever the trials."""

import dataclasses
from contextlib import suppress

import numpy as np
from hypothesis import HealthCheck, given, settings, strategies as st
from hypothesis.extra.numpy import arrays

from commonlaw.errors import CommonlawError
from commonlaw.trials import Schema, Trial, Trials
from commonlaw.trials.headers import join_header, label, plain, split_header
from commonlaw.trials.trial import EXTREME

_TEXT = st.text(st.characters(categories=["L", "N", "P", "S", "Zs"], include_characters="\n"), min_size=1, max_size=8)
_LABELS = _TEXT.map(label).filter(bool)
_NAMES = st.one_of(_TEXT, _TEXT.map("{} (m)".format), _TEXT.map("{} [m/s] []".format)).map(plain).filter(bool)
_WORDS = st.text(st.characters(categories=["Ll"]), min_size=1, max_size=8).map("so {}".format)
_UNITS = st.sampled_from(["m", "m/s^2", "kg m^2", "degC", "percent", "1/s"])
_FLOATS = st.floats(-EXTREME, EXTREME).map(lambda value: 0.0 if abs(value) < 1 / EXTREME else value)
_TIMES = st.floats(-1e50, 1e50).map(lambda time: 0.0 if abs(time) < 1e-30 else time)


@st.composite
def schemas_and_properties(draw):
    """Return a schema and the names of numeric and of text properties."""
    names = draw(st.lists(_NAMES, min_size=4, max_size=10, unique=True))
    object_, trial, time, *rest = names
    roles = draw(
        st.lists(st.sampled_from(["state", "input", "number", "word"]), min_size=len(rest), max_size=len(rest))
    )
    roles[0] = "state"
    chosen = {role: tuple(name for name, each in zip(rest, roles, strict=True) if each == role) for role in set(roles)}
    numbers, words = chosen.get("number", ()), chosen.get("word", ())
    measured = (time, *chosen["state"], *chosen.get("input", ()), *numbers)
    units = {name: draw(_UNITS) for name in measured if draw(st.booleans())}
    return Schema(chosen["state"], chosen.get("input", ()), object_, trial, time, units), numbers, words


@st.composite
def collections(draw):
    schema, numbers, words = draw(schemas_and_properties())
    pairs = draw(st.lists(st.tuples(_LABELS, _LABELS), min_size=1, max_size=4, unique=True))
    trials = []
    for name, run in pairs:
        times = sorted(draw(st.lists(_TIMES, min_size=1, max_size=7, unique=True)))
        values = draw(arrays(np.float64, (len(times), len(schema.states) + len(schema.inputs)), elements=_FLOATS))
        states, inputs = np.split(values, [len(schema.states)], axis=1)
        for gap in draw(st.lists(st.tuples(*(st.integers(0, size - 1) for size in states.shape)), max_size=4)):
            measured = ~np.isnan(states)
            measured[gap] = False
            # As many as a trial needs, in each sample and of each state
            if measured.any(axis=1).all() and measured.sum(axis=0).min() >= min(5, len(times)):
                states[gap] = np.nan
        trials.append(Trial(name, run, times, states, inputs))
    properties = {}
    for name in dict.fromkeys(name for name, _ in pairs):
        values = {key: draw(_FLOATS) for key in numbers if draw(st.booleans())}
        properties[name] = values | {key: draw(_WORDS) for key in words if draw(st.booleans())}
    known = {key for values in properties.values() for key in values}
    units = {key: unit for key, unit in schema.units.items() if key in known or key not in numbers}
    schema = dataclasses.replace(schema, units=units)
    notes = draw(st.lists(_TEXT, max_size=2))
    return Trials(tuple(trials), schema, properties, tuple(notes))


def same(one, other):
    assert one.schema == other.schema
    assert one.properties == other.properties
    assert [trial.label for trial in one] == [trial.label for trial in other]
    for mine, theirs in zip(one, other, strict=True):
        for name in ("times", "states", "inputs"):
            assert getattr(mine, name).tobytes() == getattr(theirs, name).tobytes()
            assert getattr(mine, name).shape == getattr(theirs, name).shape


_SLOW = settings(max_examples=25, suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large])
_MANY = settings(_SLOW, max_examples=50)


@_SLOW
@given(collections())
def test_trials_come_back_from_parquet_without_a_keyword(tmp_path_factory, trials):
    path = tmp_path_factory.mktemp("parquet") / "trials.parquet"
    trials.to_parquet(path)
    read = Trials.read(path)
    same(read, trials)
    more = [note for note in read.notes if note not in trials.notes]
    assert [note for note in read.notes if note in trials.notes] == list(trials.notes)
    assert [each.split(" is zero but for single samples")[0] for each in more] == pulsed(trials)


def pulsed(trials):
    """The inputs that are above zero in the mean, and zero before and after each sample in which they are not."""
    found = []
    for name, *columns in zip(trials.schema.inputs, *(trial.inputs.T for trial in trials), strict=True):
        whole, given = np.concatenate(columns), [column != 0 for column in columns]
        neighbours = np.concatenate([each[1:] & each[:-1] for each in given])
        if not (whole.all() or neighbours.any()) and (whole / len(whole)).sum() > 0:
            found.append(name)
    return found


def roles(trials):
    """The columns of a table of these trials, by what they are."""
    names = "object", "trial", "time", "states", "inputs"
    properties = list(dict.fromkeys(name for values in trials.properties.values() for name in values))
    return {name: getattr(trials.schema, name) for name in names} | {"properties": properties}


@_SLOW
@given(collections())
def test_trials_come_back_from_csv_with_the_roles_named(tmp_path_factory, trials):
    path = tmp_path_factory.mktemp("csv") / "trials.csv"
    trials.to_csv(path)
    same(Trials.read(path, **roles(trials)), trials)


@_SLOW
@given(collections())
def test_trials_come_back_from_their_frame(trials):
    frame = trials.to_frame().rename(columns=lambda name: join_header(name, trials.schema.units.get(name, "")))
    same(Trials.from_frame(frame, **roles(trials)), trials)


@_SLOW
@given(_NAMES, st.one_of(st.just(""), _UNITS))
def test_headers_come_apart_as_they_were_joined(name, unit):
    assert split_header(join_header(name, unit)) == (name, unit)


@_SLOW
@given(st.text(max_size=12))
def test_any_header_is_read_and_its_reading_is_settled(header):
    name, unit = split_header(header)
    assert split_header(join_header(name, unit)) == (name, unit)


@_MANY
@given(st.one_of(st.binary(max_size=40), st.text('tx ,;\t"\n\r01.5ab', max_size=40).map(str.encode)))
def test_any_file_is_read_or_refused_in_words(tmp_path_factory, content):
    path = tmp_path_factory.mktemp("any") / "trials.csv"
    path.write_bytes(content)
    with suppress(CommonlawError):
        assert len(Trials.read(path)) > 0
