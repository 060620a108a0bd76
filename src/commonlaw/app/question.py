"""What the page sends: a table, roles of its columns, which law is sought; and messages in the words of the page."""

import re
from collections.abc import Mapping
from functools import reduce
from pathlib import Path
from traceback import extract_tb
from typing import TYPE_CHECKING, Any, Literal, cast

import msgspec
import numpy as np

from commonlaw.errors import CommonlawError
from commonlaw.estimation import beyond_collocation
from commonlaw.estimation.beginning import InitialGiven
from commonlaw.estimation.model import ModelText
from commonlaw.law import Law
from commonlaw.law.script import Source
from commonlaw.library.bounds import limits_of, parts_of
from commonlaw.runtime.fit_options import FitOptions, read_settings, settings_of, shown_value
from commonlaw.runtime.time_limit import DEFAULT_TIME_LIMIT
from commonlaw.text import number_or_text
from commonlaw.trials import Trials
from commonlaw.trials.columns import Table as Cells
from commonlaw.trials.files import table_in
from commonlaw.trials.reading import Reading, WrittenReading
from commonlaw.trials.roles import ROLES, ColumnRoles, named_roles
from commonlaw.trials.tables import column_roles_of, rows_of
from commonlaw.trials.transformations import with_doses
from commonlaw.trials.wide import quantity

if TYPE_CHECKING:
    from commonlaw.discovery import TrajectoryLikelihood

MAX_DRAWN_TRIALS = 60
"""Trials whose curves the page is sent."""

_READING = {
    "dates": "the date format",
    "decimal": "the decimal mark",
    "missing": "a mark of missing values",
    "wide": "the quantity measured",
}
"""The same of other settings of how a table is read."""

_OTHERS = {
    "restarts='trials'": "the box 'Each decrease of time starts a new trial' under Columns",
    "restarts='sort'": "the option --restarts sort of the command",
    "clip_irregular()": "the option --clip of the command",
    "order=0": "the option --order 0 of the command",
    "units=...": "the option --unit of the command",
}
"""Settings that the page has no field for."""


LONGEST_TEXT = 10_000
"""Characters of a text in a request or a session, but for a law."""


def check_lengths(value: Any, field: str = "") -> None:
    """Refuse plain values with a text of more than `LONGEST_TEXT` characters; laws have limits of their own."""
    if isinstance(value, str) and len(value) > LONGEST_TEXT and field != "law":
        raise CommonlawError("text-too-long", text=value[:40], characters=len(value), limit=LONGEST_TEXT)
    if isinstance(value, dict):
        check_lengths([*value])
        for name, part in value.items():
            check_lengths(part, name)
    elif isinstance(value, list | tuple):
        for part in value:
            check_lengths(part)


def in_page(code: str) -> str:
    """Return a setting, written as an argument of a function, as the page calls it; the dialect of the page.

    >>> in_page("time=..."), in_page("trial='run'"), in_page("decimal=','")
    ("'time' under Columns", "trial 'run'", "',' as the decimal mark under Columns")
    >>> in_page("order=0")
    'the option --order 0 of the command'
    """
    name, _, value = code.partition("=")
    if code in _OTHERS:
        return _OTHERS[code]
    if name in ROLES and name != "noise_columns":
        return f"{ROLES[name]!r} under Columns" if value in ("...", "[...]") else f"{ROLES[name]} {value}"
    if name in _READING:
        return f"{_READING[name]} under Columns" if value == "..." else f"{value} as {_READING[name]} under Columns"
    if name == "doses":
        return f"{value.strip('[]')} as a dose under Latent states and doses"
    if name in (known := settings_of(FitOptions)):
        label = f"{known[name][1].label!r} under More choices"
        return label if value == "..." else f"{value} as {label}"
    return code


def text_in_page(text: str) -> str:
    """Return a text whose code, between backticks, is in the words of the page."""
    return re.sub(r"`(\w+=[^`]*|clip_irregular\(\))`", lambda match: in_page(match[1]), text)


def message(error: CommonlawError) -> str:
    """Return an error in the words of the page, with its code, which the page shows as a link to its explanation."""
    sentence = error.sentence(in_page)
    return f"{sentence} [{error.code}]" if error.explained == error.code else sentence


def fault(error: Exception) -> CommonlawError:
    """Return what the page is sent of an exception that is no refusal: a fault of commonlaw, with its line."""
    if isinstance(error, MemoryError):
        return CommonlawError("work-out-of-memory")
    package = str(Path(__file__).parents[1])
    frames = [frame for frame in extract_tb(error.__traceback__) if frame.filename.startswith(package)]
    place = f"{Path(frames[-1].filename).name}, line {frames[-1].lineno}"
    return CommonlawError("work-failed", kind=type(error).__name__, error=str(error)[:200], place=place)


def settings_form(options: type = FitOptions) -> list[dict[str, Any]]:
    """Return what the page shows of each setting of a fit that may change a law, in the order of the form."""
    fitted = settings_of(options, "fit")
    return [
        {
            "name": name,
            "label": about.label,
            "text": about.text.partition(". ")[0].rstrip(".").replace("`", ""),
            "choices": {"true": "yes", "false": "no"}
            if field.type is bool
            else {value: f"{value}: {meaning}" for value, meaning in about.choices.items()},
            "default": shown_value(field.default),
            "example": about.metavar,
            "of_fit": name in fitted,
        }
        for name, (field, about) in settings_of(options).items()
        if field.compare
    ]


class Edit(msgspec.Struct, forbid_unknown_fields=True, frozen=True):
    """A change of the measurements: some are left out, or blanks subtracted.

    Parameters
    ----------
    object, trial
        Names; all by default.
    between
        First and last time.
    blanks
        Objects whose mean is subtracted from the others, in place of what is left out.
    """

    object: str | None = None
    trial: str | None = None
    between: tuple[float, float] | None = None
    blanks: tuple[str, ...] = ()

    def of(self, trials: Trials) -> Trials:
        """Return the trials with this change."""
        if self.blanks:
            return trials.subtract_blanks(*self.blanks)
        return trials.exclude(object=self.object, trial=self.trial, between=self.between)

    @property
    def written(self) -> str:
        """The change as Python, behind trials."""
        if self.blanks:
            return f".subtract_blanks({', '.join(map(repr, self.blanks))})"
        conditions = {"object": self.object, "trial": self.trial, "between": self.between}
        return f".exclude({', '.join(f'{name}={value!r}' for name, value in conditions.items() if value is not None)})"


class Columns(WrittenReading, total=False):
    """How a table is read, and changed; what is empty the table says itself, but an empty text is no column."""

    edits: tuple[Edit, ...]
    """Changes of the measurements, one after another."""


def as_asked(columns: Columns) -> Reading:
    """Return what is said of how a table is read."""
    reading: Any = {name: value for name, value in columns.items() if name != "edits" and (value or value == "")}
    if reading.get("states") and not reading.get("wide"):
        reading.setdefault("properties", [])
    return cast(Reading, reading)


def edited(trials: Trials, columns: Columns) -> Trials:
    """Return trials with all changes."""
    return reduce(lambda changed, edit: edit.of(changed), columns.get("edits", ()), trials)


def recognized(cells: Cells, columns: Columns) -> dict[str, Any]:
    """Return the columns by role as far as they are clear, also where the rows make no trials."""
    try:
        return shown_roles(column_roles_of(cells, as_asked(columns)))
    except CommonlawError:
        return named_roles(cells, as_asked(columns))


def shown_roles(columns: ColumnRoles) -> dict[str, Any]:
    """Return the columns by role."""
    return {
        **{role: getattr(columns, role) for role in ("object", "trial", "time", "states", "inputs")},
        "properties": columns.properties or (),
        "deviations": tuple(columns.noise_columns.values()),
        "wide": columns.wide and quantity(columns.states, columns.wide),
    }


class HoldOut(msgspec.Struct, forbid_unknown_fields=True, frozen=True):
    """What is kept from learning: nothing, an object, the trials of a label, or samples after a time."""

    kind: Literal["nothing", "object", "trial", "after"] = "nothing"
    value: str = ""

    def training(self, trials: Trials) -> Trials:
        """Return the trials to learn from."""
        if self.kind == "nothing":
            return trials
        if self.kind == "after":
            try:
                return trials.until(float(self.value))
            except ValueError:
                raise CommonlawError("hold-out-time", value=self.value) from None
        return trials.split(**{self.kind: [self.value]})[1]

    @property
    def written(self) -> str:
        """The trials to learn from as Python, of those `measured`; nothing if it is all of them."""
        if self.kind == "nothing":
            return ""
        if self.kind == "after":
            return f"measured.until({float(self.value)!r})"
        return f"measured.split({self.kind}=[{self.value!r}])[1]"


class Equations(msgspec.Struct, forbid_unknown_fields=True, frozen=True):
    """Equations, and what is given about their parameters, by name.

    Parameters
    ----------
    values
        Of each object, in the order of the trials.
    fixed
        Parameters that are not estimated; all objects have one value.
    bounds
        Lower and upper limit, None for none.
    shared
        What has one value of a parameter, see ``shared`` of `commonlaw.fit`: all trials, each trial, or those
        with one value of a property or an input.
    priors
        Mean and standard deviation.
    starts, initial_time, doses
        See `commonlaw.fit`; a start is a number, a property, an expression, or ``free``.
    """

    text: str
    values: Mapping[str, tuple[float, ...]] = {}
    fixed: tuple[str, ...] = ()
    bounds: Mapping[str, tuple[float | None, float | None]] = {}
    shared: Mapping[str, str] = {}
    priors: Mapping[str, tuple[float, float]] = {}
    starts: Mapping[str, str] = {}
    initial_time: float | str | None = None
    doses: tuple[str, ...] = ()

    @property
    def initial(self) -> dict[str, InitialGiven]:
        """The initial values as `commonlaw.fit` takes them."""
        return {name: number_or_text(text) for name, text in self.starts.items()}

    @property
    def written(self) -> str:
        """The equations with numbers in place of fixed parameters, and with bounds."""
        text = self.text
        for name in self.fixed:
            value = float(np.mean(self.values[name]))
            number = f"({value!r})" if value < 0 else repr(value)
            text = re.sub(rf"(?<![\w`]){re.escape(name)}(?![\w`])", number, text)
        limits = [
            f"{'' if low is None else f'{low!r} < '}{name}{'' if high is None else f' < {high!r}'}"
            for name, (low, high) in self.bounds.items()
            if name not in self.fixed and not (low is None and high is None)
        ]
        return "; ".join([*parts_of(text), *limits])

    def fit(self, trials: Trials, settings: Mapping[str, Any]) -> Law:
        """Return the law of these equations, fitted from the values."""
        from commonlaw.discovery import fit

        text = ModelText.of(self.written)
        guesses = dict[str, float]()
        for name, values in self.values.items():
            value, (low, high) = float(np.mean(values)), limits_of(name, text.bounds)
            if name not in self.fixed and value != 0 and low <= value <= high:
                guesses[name] = float(f"{value:.6g}")
        groups = {name: by for name, by in self.shared.items() if name not in self.fixed}
        is_shot = bool(trials.schema.administered) or beyond_collocation(
            text, with_doses(trials, self.doses), self.initial, groups, self.priors
        )
        return fit(
            self.written,
            trials,
            initial_values=self.initial or None,
            initial_time=cast(float | Literal["first"] | None, self.initial_time),
            doses=self.doses,
            shared=groups,
            # Fits with latent states alone look for values themselves
            guesses=guesses if is_shot or not self.starts else None,
            priors=self.priors or None,
            **settings,
        )


class Question(msgspec.Struct, forbid_unknown_fields=True, frozen=True):
    """All that a search is asked."""

    table: str
    columns: Columns = {}
    order: Literal[1, 2, "auto"] = "auto"
    library: str = "auto"
    hold_out: HoldOut = HoldOut()
    known: Mapping[str, float] = {}
    explain: bool = False
    settings: Mapping[str, tuple[str, ...]] = {}
    """Texts of settings of the fit, by name, see `settings_form`."""
    equations: Equations | None = None
    """Fitted as they are, in place of a search."""
    law: str | None = None
    """A saved law, which is then shown with these trials, and nothing is learned."""
    time_limit: float | None = DEFAULT_TIME_LIMIT
    """Seconds after which a search ends with the best law so far, None for no limit."""

    @property
    def method(self) -> "TrajectoryLikelihood | None":
        """The method with these settings, None without any.

        Raises `CommonlawError` if a text is no value of its setting.
        """
        from commonlaw.discovery import TrajectoryLikelihood

        return TrajectoryLikelihood(**read_settings(FitOptions, self.settings)) if self.settings else None

    @property
    def fit_settings(self) -> dict[str, Any]:
        """The settings that fits of given equations take."""
        known = settings_of(FitOptions, "fit")
        return {name: value for name, value in read_settings(FitOptions, self.settings).items() if name in known}

    def source(self, table: "Table") -> Source:
        """Return where a program finds the trials of its law in a table."""
        learned = self.hold_out if self.law is None else HoldOut()
        asked = as_asked(self.columns)
        reading = {name: asked.get(name) for name in ("wide", "restarts")}
        reading |= {name: asked[name] for name in ("missing", "decimal", "dates", "below") if name in asked}
        reading |= {role: "" for role in ("object", "trial") if asked.get(role) == ""}
        return Source(
            table.name,
            table.dataset,
            tuple(self.columns.get("properties") or ()),
            learned.written,
            reading,
            kept="".join(edit.written for edit in self.columns.get("edits", ())),
        )


class Table(msgspec.Struct, frozen=True):
    """A file that the page sent, or a data set: its name as shown, and what is in it."""

    name: str
    content: bytes
    dataset: str = ""
    """As Python."""

    def cells(self) -> Cells:
        """Return what is in it."""
        return table_in(self.name, self.content)

    def trials(self, columns: Columns) -> Trials:
        """Return the trials in it."""
        return edited(Trials(*rows_of(self.cells(), as_asked(columns)).data), columns)


def named(name: str, content: bytes) -> Table:
    """Return what was sent under a name, of which only the last part is taken."""
    return Table(Path(name.replace("\\", "/")).name[:120] or "table", content)
