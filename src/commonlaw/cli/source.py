"""Where trials come from: options of a table, files that a cluster goes through, and commands that look at tables."""

import json
import re
import tomllib
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, fields, replace
from functools import partial, reduce
from itertools import islice
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, TypeVar, get_args

import click
import msgspec

from commonlaw.cli.main import Commands, working
from commonlaw.cli.options import (
    AS_JSON,
    DATASET,
    Decorator,
    ReadFile,
    ReadTable,
    by_name,
    in_options,
    numbers,
    option,
    pairs,
    saving,
    taking,
)
from commonlaw.cli.output import print_frame, print_json, print_notes, say
from commonlaw.errors import CommonlawError
from commonlaw.runtime.cluster import connected, current_cluster, on_cluster
from commonlaw.runtime.files import DEEPEST, checked_file, read_file, write_whole
from commonlaw.runtime.progress import ProgressCallback
from commonlaw.text import counted, in_line, number_or_text
from commonlaw.trials import Schema, Trial, Trials, TrialStream
from commonlaw.trials.cells import DecimalMark
from commonlaw.trials.files import files_of, read_table, table_files
from commonlaw.trials.headers import join_header
from commonlaw.trials.reading import READ_AS, DateOrder, Restarts, WrittenReading, checked
from commonlaw.trials.roles import GUESSED
from commonlaw.trials.transformations import without_notes_on
from commonlaw.trials.trial import property_names

if TYPE_CHECKING:
    from commonlaw.law.script import Source as Program


S = TypeVar("S", Trials, TrialStream)


_table: Callable[..., partial[Decorator]] = partial(partial, option, group="Table")

_OPTIONS = {
    "schema": _table(
        "--schema SCHEMA.toml",
        "Roles of columns and how the table is read, as written by commonlaw data check --save; other "
        "options take precedence.",
        type=ReadFile(),
    ),
    "object": _table("--object COLUMN", "Column that names the object; '' if there is none."),
    "trial": _table("--trial COLUMN", "Column that labels the trial of an object; '' if there is none."),
    "time": _table("--time COLUMN", "Column of times."),
    "states": _table("--state COLUMN...", "Column of a measured state", "states"),
    "inputs": _table("--input COLUMN...", "Column of a measured input", "inputs"),
    "properties": _table("--property COLUMN...", "Column of an object's property", "properties"),
    "noise_columns": _table(
        "--noise-column STATE=COLUMN...",
        "Column of the standard deviations of a state's measurements, '' if there is none",
        "noise_columns",
    ),
    "units": _table(
        "--unit COLUMN=UNIT...", "Unit of a column, height=m; a header such as 'height [m]' says it too", "units"
    ),
    "object_name": _table("--object-name NAME", "Name of the object, if no column names it.  [default: the file's]"),
    "wide": _table(
        "--wide NAME",
        "Read a column for each object, as for the wells of a plate; NAME is what was measured: 'OD [OD]'.",
    ),
    "restarts": _table(
        "--restarts",
        "Where times go back, a trial begins, or rows are out of order.  [default: refused if not shuffled]",
        type=click.Choice(get_args(Restarts)),
    ),
    "missing": _table(
        "--missing MARK...", "Cells that are missing values, such as -999 or '<0.5', besides empty ones, NA, -, n.d."
    ),
    "below": _table("--below MARK=LIMIT...", "Cells below a limit of quantification, BLQ=0.5, besides <0.5"),
    "decimal": _table(
        "--decimal", "Decimal mark.  [default: as the cells show]", type=click.Choice(get_args(DecimalMark))
    ),
    "dates": _table(
        "--dates",
        "Order of day, month and year, or what 1:30 is.  [default: as the cells show]",
        type=click.Choice(get_args(DateOrder)),
    ),
    "sheet": _table("--sheet NAME", "Sheet of a workbook.  [default: all that hold measurements]"),
    "clip": _table(
        "--clip", "Cut each trial at its last irregular time step (7.5 % off the median step).", is_flag=True
    ),
    "exclude": _table(
        "--exclude NAME=VALUE...", "Leave trials out that fit, written as for --where; of several, those that fit all"
    ),
    "where": _table(
        "--where NAME=VALUE...",
        "Only trials that fit: trial=1, ball=Golf Ball, or a property; commas between several, and a name "
        "with a comma in double quotes",
    ),
}
"""All that can be said of a table, by field of `Source`."""

_HELD_OUT = {
    "hold_out": option(
        "--hold-out NAME=VALUE...",
        "Learn nothing from trials that fit, written as for --where, and check the law on them; ball=Golf "
        "Ball holds an object out",
        group="Table",
        everyday=True,
    ),
    "learn_until": option(
        "--learn-until TIME", "Learn from samples up to this time, check on the others.", group="Table", type=float
    ),
}

_READING = ("object_name", "wide", "restarts", "missing", "below", "decimal", "dates")
"""Arguments of `Trials.read` that tables of text take alone."""


def with_table(*names: str, training: bool = False, required: bool = True) -> Decorator:
    """Return the decorator that adds the table and these options; a command receives all as `source`.

    In `training` are those, too, by which trials to learn from differ from those to check the law on. Other options of
    a table are in its schema.
    """
    metavar = "TABLE" if required else "[TABLE]"
    in_schema = {name: made.args[0].partition(" ")[0] for name, made in _OPTIONS.items() if name not in names}
    argument = click.argument("path", required=required, metavar=metavar, type=ReadTable(in_schema))
    everyday = ("schema", "object", "trial", "time", "states", "where")
    shown = [made(everyday=name in everyday) for name, made in _OPTIONS.items() if name in names]
    options = [argument, *shown, *(_HELD_OUT.values() if training else ())]

    def convert(values: dict[str, Any]) -> dict[str, Any]:
        given = {name: values.pop(name) for name in (*_OPTIONS, *_HELD_OUT) if name in values}
        return {"source": Source.of(values.pop("path"), given), **values}

    return taking(options, convert)


WITHOUT_LAW = ("schema", "object", "trial", "time", "restarts", "sheet", "where")
"""Options of commands that learn from a table."""

WITH_LAW = ("schema", "where")
"""Options of commands that take a law, which has the names of columns."""

EVERY_OPTION = tuple(_OPTIONS)

_COMMA = re.compile(r',(?=(?:[^"]*"[^"]*")*[^"]*$)')
"""A comma that is not in quotes."""


@dataclass(frozen=True)
class Source:
    """A table or data set, how it is read, and which of its trials are taken.

    `roles` has the arguments of `Trials.read` that are given.
    """

    path: str | None
    more: tuple[str, ...] = ()
    """Further files with the same columns."""
    roles: Mapping[str, Any] = field(default_factory=dict)
    sheet: str | None = None
    clip: bool = False
    exclude: tuple[str, ...] = ()
    where: tuple[str, ...] = ()
    hold_out: tuple[str, ...] = ()
    learn_until: float | None = None
    dataset: str = ""

    @classmethod
    def of(cls, table: str | None, given: Mapping[str, Any]) -> "Source":
        """Return what options say, by their names; what none says is taken from the file of ``--schema``."""
        options = {name: value for name, value in given.items() if value not in ((), None) and value is not False}
        for name, flag in (("noise_columns", "--noise-column"), ("units", "--unit")):
            if name in options:
                options[name] = by_name(flag, options[name]) if any(options[name]) else {}
        if "below" in options:
            options["below"] = numbers("--below", options["below"])
        if "properties" in options:
            options["properties"] = list(options["properties"])
        schema = options.pop("schema", None)
        options = (read_schema(schema) if schema else {}) | options
        attributes = {member.name: options.pop(member.name) for member in fields(cls) if member.name in options}
        dataset = table.removeprefix(DATASET) if table and table.startswith(DATASET) else ""
        return cls(None if dataset else table, roles=options, dataset=dataset, **attributes)

    def reading(self, **roles: Any) -> "Source":
        """Return the same, read with other arguments."""
        return replace(self, roles={**self.roles, **roles})

    @property
    def name(self) -> str:
        """The file or data set, as shown."""
        return self.dataset or str(self.path)

    @property
    def files(self) -> str | list[str]:
        """The file, folder or pattern, or all files."""
        return [str(self.path), *self.more] if self.more else str(self.path)

    def load(self, schema: Schema | None = None) -> Trials:
        """Return all trials but those excluded; names that no option gives are taken from `schema`."""
        if self.is_stream:
            return self.stream(schema).read()
        if self.dataset:
            from commonlaw.datasets import DATASETS
            from commonlaw.runtime.arguments import parse_spec

            whole = parse_spec("data set", self.dataset, DATASETS)
        else:
            whole = self._from_file(schema)
        trials = self._without_excluded(whole)
        if schema is not None:  # The law names the columns
            trials = replace(trials, notes=tuple(note for note in trials.notes if not note.startswith(GUESSED)))
        return trials.clip_irregular() if self.clip else trials

    def chosen(self, schema: Schema | None = None) -> Trials:
        """Return what `select` does of the trials that `load` does; of a folder or a pattern no others are held."""
        return self.select(self.stream(schema)).read() if self.is_stream else self.select(self.load(schema))

    @property
    def is_stream(self) -> bool:
        """Whether the file is a folder of Parquet files, or a pattern of them."""
        if not self.path or self.more or files_of(Path(self.path), ()) is None:
            return False
        return not table_files(self.path)

    def check_streams(self, others: Mapping[str, object] = MappingProxyType({})) -> None:
        """Refuse what does not go with files that are streamed, `others` of the options among it."""
        given: dict[str, object] = {name: name in self.roles for name in _READING}
        given |= {"sheet": self.sheet, "clip": self.clip, **others}
        if refused := [name for name, value in given.items() if value]:
            raise click.UsageError(f"{', '.join(refused)} with a stream of files: leave it out, or give single files")
        if not self.path:
            raise click.UsageError("give Parquet files, such as 'runs/*.parquet'")

    def stream(self, schema: Schema | None = None) -> TrialStream:
        """Return the trials of Parquet files as a stream; names that no option gives are taken from `schema`."""
        self.check_streams()
        roles = (_names_of(schema) if schema else {}) | {**self.roles}
        given = {name: value for name, value in roles.items() if value}
        return self._without_excluded(TrialStream.from_parquet(str(self.path), **given))

    @property
    def holds_out(self) -> bool:
        """Whether something is left for checking the law."""
        return bool(self.where or self.hold_out) or self.learn_until is not None

    def held_out(self, stream: TrialStream) -> TrialStream:
        """Return the trials that ``--where`` leaves out or ``--hold-out`` names, all if there is neither."""
        left_out = list[TrialStream]()
        if self.where:
            stream, others = stream.split(**_conditions("--where", self.where, stream))
            left_out.append(others)
        if self.hold_out:
            left_out.append(stream.split(**_conditions("--hold-out", self.hold_out, stream))[0])
        return reduce(TrialStream.joined, left_out) if left_out else stream

    def select(self, trials: S) -> S:
        """Return the trials that fit ``--where`` and not ``--hold-out``, up to the time of ``--learn-until``."""
        if self.where:
            trials = trials.select(**_conditions("--where", self.where, trials))
        if self.hold_out:
            trials = trials.split(**_conditions("--hold-out", self.hold_out, trials))[1]
        return trials if self.learn_until is None else trials.until(self.learn_until)

    def streamed_program(self) -> "Program":
        """Return where a program finds the stream."""
        from commonlaw.law.script import Source as Program

        return Program(self.path or "", properties=tuple(self.roles.get("properties", ())), stream=True)

    def program(self, trials: Trials) -> "Program":
        """Return where a program finds these trials, and which of a table it learns from."""
        from commonlaw.law.script import Source as Program

        def conditions(name: str, texts: Sequence[str]) -> str:
            return "**" + repr(_conditions(name, texts, trials)) if texts else ""

        excluded, where = conditions("--exclude", self.exclude), conditions("--where", self.where)
        held_out = conditions("--hold-out", self.hold_out)
        kept = (f".split({excluded})[1]" if excluded else "") + ".clip_irregular()" * self.clip
        learned = (f".select({where})" if where else "") + (f".split({held_out})[1]" if held_out else "")
        learned += "" if self.learn_until is None else f".until({self.learn_until!r})"
        reading = {name: self.roles[name] for name in _READING if name in self.roles}
        reading |= {"sheet": self.sheet} if self.sheet else {}
        reading |= {"noise_columns": {}} if self.roles.get("noise_columns") == {} else {}
        training = f"measured{learned}" if learned else ""
        properties = tuple(self.roles.get("properties", ()))
        return Program(self.files, properties=properties, training=training, reading=reading, kept=kept)

    def _without_excluded(self, trials: S) -> S:
        return trials.split(**_conditions("--exclude", self.exclude, trials))[1] if self.exclude else trials

    def _from_file(self, schema: Schema | None) -> Trials:
        roles: dict[str, Any] = {**self.roles}
        if schema:
            there = read_table(self.files, self.sheet).columns if schema.wide or schema.noise_columns else {}
            roles = _names_of(schema) | roles
            deviations = {state: name for state, name in schema.noise_columns.items() if name in there}
            roles.setdefault("noise_columns", deviations or None)
            if schema.wide and "wide" not in roles and schema.measured[0] not in there:
                roles["wide"] = join_header(schema.measured[0], schema.units.get(schema.measured[0], ""))
            if roles.get("wide") and "states" not in self.roles:
                del roles["states"]
        trials = Trials.read(self.files, sheet=self.sheet, **roles)
        return without_notes_on(schema.doses if schema else (), trials)


def _names_of(schema: Schema) -> dict[str, Any]:
    names: dict[str, Any] = {"object": schema.object, "trial": schema.trial, "time": schema.time}
    return names | {"states": schema.measured, "inputs": schema.inputs}


class _SchemaFile(WrittenReading, total=False):
    """What a TOML file says of a table."""

    sheet: str
    exclude: tuple[str, ...]
    clip: bool


_TEXT_OF_TOML = re.compile(
    r"""#[^\n]*|\"{3}(?:\\.|[^\\])*?\"{3}|'{3}.*?'{3}|"(?:\\.|[^"\\\n])*"|'[^'\n]*'""", re.DOTALL
)
"""Comments and texts, in which points separate no keys."""
_DEEP_KEY = re.compile(rf"(?:(?<![\w-])[\w-]++[ \t]*+\.[ \t]*+){{{DEEPEST}}}")
"""A key of more parts, a.b.c ..., than `DEEPEST`, each of which is looked up with all before it."""


def read_schema(path: str) -> dict[str, Any]:
    """Return the options that a schema file gives, by field of `Source`; refuse other keys and values."""
    content = read_file(checked_file(path, 2**20))
    try:
        text = content.decode()
        if _DEEP_KEY.search(_TEXT_OF_TOML.sub("s", text)):
            raise CommonlawError("toml-too-deep", limit=DEEPEST)
        options = checked(tomllib.loads(text), _SchemaFile)
        lists = {name: options[name] for name in ("states", "inputs") if name in options}
        return {**msgspec.convert(options, _SchemaFile), **msgspec.convert(lists, dict[str, tuple[str, ...]])}
    except (ValueError, RecursionError, CommonlawError) as error:
        raise CommonlawError("table-schema", path=path, problem=error) from None


def written_schema(source: Source, trials: Trials) -> bytes:
    """Return the schema file of a table: its columns in the roles that they have in its trials, and how it is read."""
    schema, roles = trials.schema, source.roles
    options: dict[str, Any] = {"time": schema.time}
    if schema.wide:
        (state,) = schema.measured
        options["wide"] = roles.get("wide") or join_header(state, schema.units.get(state, ""))
    else:
        options |= {"object": schema.object, "trial": schema.trial, "states": schema.measured, "inputs": schema.inputs}
        options |= {"properties": property_names(trials.properties), "noise_columns": schema.noise_columns}
    options |= {name: roles[name] for name in (*_READING, "units") if name in roles and name != "wide"}
    options |= {"sheet": source.sheet, "exclude": source.exclude, "clip": source.clip}
    options |= {name: "" for name in ("object", "trial") if roles.get(name) == ""}
    kept = {name: value for name, value in options.items() if value or value == ""}
    kept |= {"noise_columns": {}} if roles.get("noise_columns") == {} else {}
    return "".join(f"{name} = {_toml(value)}\n" for name, value in kept.items()).encode()


def _toml(value: Any) -> str:
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{_toml(name)} = {_toml(entry)}" for name, entry in value.items()) + "}"
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, float):
        return repr(value)
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    return f"[{', '.join(map(_toml, value))}]"


def layouts(trials: Trials) -> list[str]:
    """Return the line that says how the file was read, if it is no plain table."""
    return [note for note in trials.notes if note.startswith(READ_AS)]


def print_layouts(trials: Trials) -> None:
    """Print how the file was read, before anything else."""
    for line in layouts(trials):
        say(in_line(in_options(f"{line[0].upper()}{line[1:]}")))


def guesses(trials: Trials) -> list[str]:
    """Return the lines that say how the file was read, and what columns were taken for, if something was guessed."""
    return [*layouts(trials), *(note for note in trials.notes if note.startswith(GUESSED))]


def _conditions(name: str, texts: Sequence[str], trials: Trials | TrialStream) -> dict[str, list[float | str]]:
    """Return what an option asks of trials, in the words of `Trials.select`; of one name, all values count.

    A stream does not tell its names beforehand, so that commas always stand between several.
    """
    schema, names, conditions = trials.schema, ("object", "trial"), dict[str, list[float | str]]()
    roles = {schema.object: "object", schema.trial: "trial"}
    known = dict[str, set[object]]()  # None of a stream
    if isinstance(trials, Trials):
        for owned in trials.properties.values():
            for name_, value in owned.items():
                known.setdefault(name_, set()).add(value)
        known |= {"object": {trial.object for trial in trials}, "trial": {trial.name for trial in trials}}
    for key, text in pairs(name, texts):
        role = roles.get(key, key)
        if not known and role not in names:
            raise click.UsageError(
                f"{name} {key}=... with a stream of files: say which trials by {schema.object} or {schema.trial}"
            )
        parts = _parts(text, known.get(role, ()))
        conditions.setdefault(role, []).extend(parts if role in names else map(number_or_text, parts))
    return conditions


def _parts(text: str, present: Collection[object]) -> list[str]:
    """Return the values in a text with commas between them, which is one value if there is such a one.

    >>> _parts("Ball,blue", ["Ball,blue", "Ball", "blue"]), _parts('"Ball,blue",Golf', [])
    (['Ball,blue'], ['Ball,blue', 'Golf'])
    """
    if text in present:
        return [text]
    return [re.sub(r'^"(.*)"$', r"\1", part, flags=re.DOTALL) for part in re.split(_COMMA, text)]


T = TypeVar("T")
R = TypeVar("R")


with_cluster = option(
    "--cluster ADDRESS",
    "Have the workers of a dask cluster do the work: tcp://host:8786 or tls://host:8786, the address that its "
    "scheduler shows, or local:4 for four processes of this machine. They read the files themselves, so name them as "
    "the workers see them. Without it a folder or a pattern of Parquet files is gone through here, file by file.",
    group="Cluster",
)
"""Adds the option to a command, which receives it as `cluster`."""


@contextmanager
def on_cluster_at(address: str | None, show: ProgressCallback) -> Iterator[None]:
    """Let what is within be done by the cluster at an address, if there is one."""
    if address is None:
        yield
        return
    show(f"connecting to {address}")
    with connected(address) as client, on_cluster(client):
        yield


def stream_of(source: Source, schema: Schema | None = None) -> TrialStream:
    """Return the stream of a source; a worker lists its files if there is one, as they need not be here."""
    absolute = replace(source, path=str(Path(str(source.path)).absolute()))
    return _by_a_worker(partial(Source.stream, schema=schema), absolute)


def few_trials(stream: TrialStream) -> Trials:
    """Return the first trials of the first file of a stream, read by a worker if there is one."""
    return Trials(_by_a_worker(_first_trials, stream.parts[0]), stream.schema)


def _by_a_worker(function: Callable[[T], R], item: T) -> R:
    cluster = current_cluster()
    return function(item) if cluster is None else cluster.merged(function, [item], lambda results: results[0])


def _first_trials(stream: TrialStream) -> tuple[Trial, ...]:
    return tuple(trial.cut(2000) for trial in islice(stream, 10))


@click.group(cls=Commands)
def data() -> None:
    """Look at measurements before learning from them."""


@data.command()
@with_table(*EVERY_OPTION)
@option(
    "--order",
    "Order of the laws that are tested for confounded variables; 0 for no test.  [default: 2 for a "
    "single state, 1 for several]",
    type=click.IntRange(0, 2),
)
@option("--library SPEC", "Their candidate terms, as in discover.  [default: poly:3]")
@saving(schema="the roles of the columns and how the table is read, for --schema of all commands")
@AS_JSON
def check(source: Source, order: int | None, library: str | None, save: tuple[str, ...], as_json: bool) -> None:
    """Summarize TABLE, run the data checks, and list what --clip would cut.

    The check also lists confounded variables: in these trials one determines the other, so that laws in either fit
    equally well; and initial values that would separate them.

    \b
    Example:
      commonlaw data check drops.csv --object ball --trial drop --time t --state height --save schema.toml
      commonlaw discover drops.csv --schema schema.toml --order 2
    """
    with working("Checking ...") as show:
        show("reading the table")
        trials = source.chosen()
        show(f"{counted(len(trials), 'trial')} of {counted(len(trials.objects), 'object')}")
        report = trials.check(order=order, library=library)
    for path in save:
        write_whole(path, written_schema(source, trials))
    if as_json:
        print_json(report.to_dict())
        return
    print_layouts(trials)
    say(
        f"{in_line(source.name)}: {counted(len(trials), 'trial')} of {counted(len(trials.objects), 'object')}, "
        f"measured: {in_line(', '.join(trials.schema.states))}"
    )
    for line in report.lines():
        say(in_line(f"Data check: {in_options(line)}"))
    if not report.findings:
        say("Data checks: no problem found.")
    say("")
    frame = report.to_frame()
    if not any("`clip_irregular()`" in text for text in report.findings):
        frame = frame.drop(columns="clipped")  # Where no frame is out of the ordinary it is no advice
    headings = {name: name.replace("_", " ") for name in map(str, frame)}
    print_frame(frame, headings | {"clipped": "cut by --clip"})
    for path in save:
        say(f"Wrote {path}")
    print_notes(note for note in trials.notes if note not in layouts(trials))


@data.command(name="list")
def list_() -> None:
    """List the data sets that can be used as a table, dataset:NAME, with their options and sources."""
    from inspect import signature

    from commonlaw.datasets import DATASETS

    for name, dataset in DATASETS.items():
        parameters = signature(dataset.load).parameters.values()
        options = ", ".join(f"{parameter.name}={parameter.default}" for parameter in parameters)
        say(f"{name}: {dataset.summary}\n    options: {options}\n    source: {dataset.citation}\n")


@data.command()
@with_table(*WITH_LAW)
@saving(table="the table", required=True)
def export(source: Source, save: tuple[str, ...]) -> None:
    """Write trials as a table, without loss.

    \b
    Example:
      commonlaw data export dataset:linear-drag:noise=0.05 --save drops.csv
    """
    with working("Reading ..."):
        trials = source.chosen()
    for path in save:
        write = trials.to_csv if path.lower().endswith(".csv") else trials.to_parquet
        write(path)
        say(f"Wrote {path}")
    print_notes(trials.notes)
