"""Commands that learn laws from tables, their options, and the search in each of several tables."""

import warnings
from collections.abc import Callable, Generator, Mapping, Sequence
from contextlib import closing, suppress
from dataclasses import dataclass, replace
from functools import partial
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar, cast

import click

from commonlaw.cli.main import command, working
from commonlaw.cli.options import (
    AS_JSON,
    HISTORY,
    LAW_ARGUMENT,
    Decorator,
    ReadFile,
    ReadLaw,
    as_one,
    by_name,
    in_options,
    is_of_kind,
    numbers,
    option,
    pairs,
    saving,
    taking,
)
from commonlaw.cli.output import Artifacts, in_words, print_history, print_json, print_law, print_table, say
from commonlaw.cli.results import FitResult, Outputs, compared, find_law, load, over_table, print_compared, with_outputs
from commonlaw.cli.source import (
    WITH_LAW,
    WITHOUT_LAW,
    Source,
    guesses,
    on_cluster_at,
    stream_of,
    with_cluster,
    with_table,
)
from commonlaw.errors import CommonlawError, check_choice
from commonlaw.law.alignment import measured_schema
from commonlaw.law.models import named_models
from commonlaw.law.observation import ALL
from commonlaw.runtime.arguments import RENAMED_ARGUMENTS
from commonlaw.runtime.cluster import counting, current_cluster
from commonlaw.runtime.fit_options import FitOptions, read_settings, setting_rows, settings_of, shown_value
from commonlaw.runtime.parallel import threads
from commonlaw.runtime.progress import ProgressCallback, Stage, part
from commonlaw.runtime.shutdown import begun, end_with_parent
from commonlaw.text import as_text, counted, number_or_text, shown
from commonlaw.trials import Trials
from commonlaw.trials.transformations import without_notes_on
from commonlaw.trials.trial import property_names

if TYPE_CHECKING:
    from commonlaw.discovery import AbstractMethod
    from commonlaw.discovery.known_physics import Base
    from commonlaw.discovery.orders import AskedOrder
    from commonlaw.law import Law
    from commonlaw.trials import TrialStream


METHODS = {
    "trajectory-likelihood": "TrajectoryLikelihood",
    "derivative-regression": "DerivativeRegression",
    "weak-regression": "WeakRegression",
    "discrete-time-regression": "DiscreteTimeRegression",
}

_SEARCH = "Settings of a fit, --set NAME=VALUE"


def _settings_help(function: str, options: type) -> dict[str, list[tuple[str, str]]]:
    """Return the settings of a function by headings, each with its documentation and default."""
    if function != "discover":
        return {_SEARCH: _rows(options, function)}
    rows_by_title = {f"{_SEARCH}, --method trajectory-likelihood": _rows(options, function)}
    for name, method in _methods().items():
        taken = {row for rows in rows_by_title.values() for row, _ in rows}
        if name != "trajectory-likelihood":
            rows_by_title[f"Settings of --method {name}"] = [
                row for row in _rows(method, function) if row[0] not in taken
            ]
    return {title: rows for title, rows in rows_by_title.items() if rows}


def _rows(options: type, function: str) -> list[tuple[str, str]]:
    rows = setting_rows(options, function)
    return [(name, f"{text}{f'  [default: {default}]' if default else ''}") for name, default, text in rows]


def _methods() -> dict[str, Any]:
    from commonlaw import discovery

    return {name: getattr(discovery, class_name) for name, class_name in METHODS.items()}


def setting_options(function: str, options: type = FitOptions) -> list[Decorator]:
    """Return the options of a command for the settings that a function takes: everyday ones, and one for any."""
    made = partial(option, group="Method", everyday=True)
    result = list[Decorator]()
    for name, (field, about) in settings_of(options, function).items():
        if about.everyday:
            default = shown_value(about.default_of(function, field.default))
            help = f"{about.text}{f'  [default: {default}]' if default else ''}"
            result.append(made(f"--{name.replace('_', '-')} {about.metavar}", help, name, multiple=True))
    text = "A setting of the fit by its name, such as errors=white, of those that --help-all lists"
    rows = partial(_settings_help, function, options)
    return [*result, made("--set NAME=VALUE...", text, "settings", settings=rows)]


def given_settings(values: dict[str, Any], function: str) -> dict[str, list[str]]:
    """Take the texts of settings out of a command's values, by name."""
    result = dict[str, list[str]]()
    for name, (_, about) in settings_of(FitOptions, function).items():
        if about.everyday and (texts := values.pop(name)):
            result[name] = list(texts)
    for name, text in pairs("--set", values.pop("settings")):
        result.setdefault(RENAMED_ARGUMENTS.get(name, name), []).append(text)
    return result


def with_settings(function: str) -> Decorator:
    """Return the decorator that adds the settings of a fit; a command receives those that are given as `settings`."""

    def convert(values: dict[str, Any]) -> dict[str, Any]:
        texts = given_settings(values, function)
        for name in texts:
            check_choice("setting", name, settings_of(FitOptions, function))
        return {"settings": _read(FitOptions, texts, function), **values}

    return taking(setting_options(function), convert)


def _read(options: type, texts: dict[str, list[str]], function: str = "discover") -> dict[str, Any]:
    try:
        return read_settings(options, texts, function)
    except CommonlawError as error:
        raise click.UsageError(error.sentence()) from None


_METHOD = option(
    "--method",
    "How the law is found: by the likelihood of whole trajectories, with standard errors; by regression "
    "on estimated derivatives; in the weak form; in discrete time.  [default: trajectory-likelihood, for "
    "hundreds of objects with long trials derivative-regression, for --order 0 discrete-time-regression; "
    "or the one whose settings are given]",
    group="Method",
    type=click.Choice(list(METHODS)),
)


def _chosen_method(values: dict[str, Any]) -> dict[str, Any]:
    """Return the values of a command with the `method` of its settings, None if none is given.

    Where each of several files is worked on by itself, so many at a time as ``n_jobs`` says, there are `processes`.
    """
    texts, method, order = given_settings(values, "discover"), values["method"], values["order"]
    jobs = _read(FitOptions, {"n_jobs": texts.pop("n_jobs")} if values["each"] and "n_jobs" in texts else {})
    values["processes"] = FitOptions(**jobs).n_jobs if jobs.get("n_jobs", -1) != -1 else None
    methods = _methods()
    takes = {name: settings_of(options) for name, options in methods.items()}
    if method is None and texts:  # That whose settings are given
        needs_regression = any(name == "solver" or name not in takes["trajectory-likelihood"] for name in texts)
        method = "derivative-regression" if needs_regression else "trajectory-likelihood"
        method = "weak-regression" if "radii" in texts else method
        method = "discrete-time-regression" if order == 0 else method
    for name in texts:
        others = [candidate for candidate in methods if name in takes[candidate]]
        if others and method not in others:
            able = " or ".join(candidate for candidate in others if (order == 0) == (0 in methods[candidate].orders))
            instead = f", or use --method {able}" if able else ""
            raise click.UsageError(f"the setting {name} does not go with --method {method}: leave it out{instead}")
    return values | {"method": None if method is None else methods[method](**_read(methods[method], texts))}


with_method = taking((_METHOD, *setting_options("discover")), _chosen_method)
"""Adds --method and the settings of all methods to a command; it receives `method`, and with --each `processes`."""


_law = partial(option, group="Law")


class _Order(click.IntRange):
    """The order of a law, those of its states, or the word that leaves it to the measurements."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        if isinstance(value, str) and "=" in value:
            by_state: dict[str, Any] = {**by_name("--order", value.split(","))}
            return {state: super(_Order, self).convert(order, param, ctx) for state, order in by_state.items()}
        return value if value == "auto" else super().convert(value, param, ctx)


_LAW_OPTIONS = (
    _law(
        "--order ORDER",
        "Order of the law: 1 for x' = ..., 2 for x'' = ..., 0 for x[k+1] = ...; where equations differ by "
        "state, theta=2,i=1; auto for 1 where such a law fits within the noise, otherwise 1 or 2 for each "
        "state, by evidence; 1 for streams and regressions.",
        everyday=True,
        type=_Order(0, 2),
        default="auto",
    ),
    _law(
        "--library SPEC",
        "Candidate terms: poly:3, fourier:2, terms:1,v,v*abs(v), which may hold properties of the objects, "
        "families with parameters inside such as saturating, sums such as 'poly:2 + saturating', ratios of "
        "sums as in 'ratio(poly:2, poly:2)', or auto for poly:3, and for all of these where it shows lack of "
        "fit; poly:3 only for streams and regressions.",
        everyday=True,
        default="auto",
    ),
    _law(
        "--known TERM=VALUE...",
        "A known coefficient, 1=-9.8; with several states say the equation, x:1=-9.8; repeat for more. Or a "
        "base, and the law is what is left: an equation with numbers, \"x'' = -9.8\", or a law, LAW.json",
        type=ReadLaw(),
    ),
    _law("--shared TERM...", "A term with one coefficient for all objects: 1 for gravity; with several states x:1"),
    _law("--observe EQUATION...", 'What a column measures in place of a state, "y = s (x + z) + b"'),
    _law("--latent NAME...", "A state without a column, one for each --observe: z"),
    _law(
        "--explain",
        "Say what in the law is shared, what follows the objects' properties, and what is each object's own.",
        is_flag=True,
    ),
    _law("--no-cache", "", is_flag=True, replaced_by="set the environment variable COMMONLAW_CACHE=off"),
)


@dataclass(frozen=True)
class Question:
    """What these options say."""

    order: "AskedOrder"
    library: str
    known: tuple[str, ...]
    shared: tuple[str, ...]
    observe: tuple[str, ...]
    latent: tuple[str, ...]
    explain: bool
    no_cache: bool
    method: "AbstractMethod | None"

    def answer(self, training: "Trials | TrialStream", show: Callable[[str], None]) -> "Law":
        """Return the law of trials; `show` takes the text of each step."""
        import commonlaw as cl

        return cl.discover(
            training,
            order=self.order,
            library=self.library,
            method=self.method,
            known=_known_physics(self.known),
            shared=[_key(name) for name in self.shared],
            observe=dict(pairs("--observe", self.observe)),
            latent_states=self.latent,
            progress=show,
            cache=not self.no_cache,
        )

    def explained(self, law: "Law", show: Callable[[str], None], later: Artifacts) -> "Law":
        """Return the law with what decides its coefficients if that is asked for and can be said."""
        if not self.explain:
            return law
        show("explaining coefficients")
        return later.take("the coefficients were not explained", law.explain, law)


with_question = as_one("question", Question, (*_LAW_OPTIONS, with_method))
"""Adds the options of the law and of the methods to a command, which receives them as `question`."""


def _known_physics(texts: Sequence[str]) -> "Base":
    """Return what is known: coefficients by term, equations, or the law in a file."""
    from commonlaw.law import Law

    if len(texts) == 1 and is_of_kind(texts[0], "law"):
        return Law.load(texts[0])
    if any(set("'[") & set(text.partition("=")[0]) for text in texts):
        return "; ".join(texts)
    return {_key(name): value for name, value in numbers("--known", texts).items()}


def _key(name: str) -> str | tuple[str, str]:
    """Return a term, or state and term of ``state:term``."""
    state, colon, term = name.partition(":")
    return (state, term) if colon else name


T = TypeVar("T")
R = TypeVar("R")


def in_processes(
    work: Callable[[T], R], pieces: Sequence[T], at_once: int
) -> Generator[tuple[int, R | None, str], None, None]:
    """Yield the number of each piece of work as soon as it is done, with what it gave or why there is nothing.

    So many processes at once do one piece after the other: what the first of them loads, the others have. Work and
    pieces must be possible to pickle. All processes end with this one, and when the generator is closed.
    """
    waiting, idle = list(enumerate(pieces))[::-1], list[tuple[BaseProcess, Connection]]()
    busy = dict[Connection, tuple[BaseProcess, int]]()
    try:
        while waiting or busy:
            while waiting and len(busy) < at_once:
                process, connection = idle.pop() if idle else begun(_serve, work, preload=("commonlaw.discovery",))
                number, piece = waiting.pop()
                busy[connection] = process, number
                with suppress(OSError):  # Its process has ended; receiving the answer fails, too
                    connection.send(piece)
            for connection in cast(list[Connection], wait([*busy])):
                process, number = busy.pop(connection)
                try:
                    answer = connection.recv()
                    idle.append((process, connection))
                except (EOFError, OSError):
                    process.join()
                    connection.close()
                    code = process.exitcode
                    answer = None, f"its process ended by itself, with code {code}: is there enough memory?"
                yield number, *answer
    finally:
        for process, connection in (*idle, *((process, connection) for connection, (process, _) in busy.items())):
            process.kill()
            process.join()
            connection.close()


def _serve(connection: Connection, work: Callable[[Any], object]) -> None:
    """Do pieces of work as they come; the main function of a process."""
    end_with_parent()
    warnings.simplefilter("ignore")
    with threads(1):  # The other processes have the other cores
        while True:
            try:
                piece = connection.recv()
                try:
                    answer: tuple[object, str] = work(piece), ""
                except Exception as error:  # A fault of ours or of others is no reason to lose what the others find
                    answer = None, in_words(error)
                connection.send(answer)
            except (EOFError, OSError):
                return


Piece = tuple[Source, Question]

COLUMNS = (
    "file", "object", "equation", "term", "value", "standard error", "low", "high", "unit", "verdict", "error",
)  # fmt: skip
"""Of the table of all files, which has a row for each coefficient, or for a file without a law."""

_BATCH_OPTIONS = (
    click.argument("more", nargs=-1, metavar="[MORE TABLES]...", type=ReadFile()),
    option(
        "--each",
        "Find a law in each TABLE by itself, instead of one in a single TABLE, several at a time (--set "
        "n_jobs=4); --save then writes one table (.csv, .parquet) with a row for each coefficient of each "
        "file: its value, standard error, 95 % interval and unit, the verdict on the law, or what was wrong "
        "with the file.",
        group="Several files",
        is_flag=True,
    ),
)


@dataclass(frozen=True)
class FileResult:
    """What was found in a file: the form of the law, whether it can be used, rows of the table, and guesses; or not."""

    path: str
    failure: str = ""
    law: str = ""
    usable: bool | None = None
    rows: Sequence[Mapping[str, object]] = ()
    guesses: Sequence[str] = ()


@dataclass(frozen=True)
class Batch:
    """What is said of several files."""

    more: tuple[str, ...]
    each: bool
    processes: int | None

    def check(self, source: Source, outputs: Outputs, cluster: str | None) -> None:
        """Refuse what does not go together."""
        others = [file for file in outputs.save if not is_of_kind(file, "table")]
        given = [*(f"--save {file}" for file in others), *(["--json"] if outputs.as_json else [])]
        if not self.each:
            return
        if cluster and self.processes:
            raise click.UsageError("--set n_jobs is for this machine: leave it out, --cluster has its own workers")
        if not source.path:
            raise click.UsageError("--each takes files: commonlaw discover a.csv b.csv --each --save results.csv")
        if given:
            raise click.UsageError(
                f"{' and '.join(given)} for a single file: with --each, results go to a table, --save results.csv"
            )

    def run(self, source: Source, question: Question, show: ProgressCallback) -> list[FileResult]:
        """Find the laws of all files, by the workers of a cluster if there is one."""
        paths = [path for path in (source.path, *self.more) if path]
        pieces = [(replace(source, path=str(Path(path).absolute())), question) for path in paths]
        results = [*map(FileResult, paths)]
        with closing(self._ended(pieces, show)) as ended:
            for number, result, failure in ended:
                path = paths[number]
                results[number] = replace(result, path=path) if result else FileResult(path, in_options(failure))
        return results

    def _ended(self, pieces: Sequence[Piece], show: ProgressCallback) -> Generator[tuple[int, FileResult | None, str]]:
        """Yield the number of each file as soon as it is done, with what was found or why nothing was."""
        cluster = current_cluster()
        if cluster is not None:
            tell = counting(show, "files", len(pieces), cluster)
            for done, (number, result, error) in enumerate(cluster.each(_found_in_file, pieces), start=1):
                yield number, result, in_words(error) if error else ""
                tell(done)
            return
        from joblib import cpu_count

        at_once = min(self.processes or cpu_count(), len(pieces))
        show(Stage(f"{at_once} processes for {len(pieces)} files", 0.0))
        with closing(in_processes(_found_in_file, pieces, at_once)) as ended:
            for done, outcome in enumerate(ended, start=1):
                yield outcome
                show(Stage(f"{done} of {len(pieces)} files", done / len(pieces)))


def give(results: Sequence[FileResult], paths: Sequence[str]) -> None:
    """Write the table, print a line for each file, and say in how many there is a law."""
    import pandas as pd

    later = Artifacts()
    rows = [
        {"file": as_text(result.path), **row}
        for result in results
        for row in result.rows or [{"error": result.failure}]
    ]
    later.save(paths, table=lambda: pd.DataFrame(rows, columns=COLUMNS))
    words = {True: "can be used", False: "cannot be used", None: "could not be assessed"}
    print_table(
        ["file", "law", "forecasts by it, or what is wrong"],
        [[result.path, result.law, words[result.usable] if result.law else result.failure] for result in results],
    )
    laws = sum(bool(result.law) for result in results)
    say(f"\n{counted(laws, 'law')} in {counted(len(results), 'file')}")
    files = dict[str, list[str]]()
    for result in results:
        for guess in result.guesses:
            files.setdefault(guess, []).append(result.path)
    notes = [f"in {shown(names)}: {guess}" for guess, names in files.items()]
    later.end(notes, reasons=() if laws else ("no file has a law",))


with_batch = as_one("batch", Batch, _BATCH_OPTIONS)
"""Adds further files and the options for them to a command, which receives them as `batch`."""


def _found_in_file(piece: Piece) -> FileResult:
    from commonlaw.law.tables import coefficient_rows

    source, question = piece
    trials, later = source.load(), Artifacts()
    training = source.select(trials)
    law = question.explained(question.answer(training, lambda _: None), lambda _: None, later)
    verdict = later.take("the forecast assessment failed", lambda: law.assess(trials, training), None)
    summary: dict[str, object] = {
        "verdict": verdict.sentences[0] if verdict else None,
        "error": "; ".join(later.failures) or None,
    }
    rows = coefficient_rows(law).to_dict(orient="records") or [{}]
    return FileResult(
        source.name,
        law="; ".join(law.structure),
        usable=verdict.usable if verdict else None,
        rows=[{str(name): value for name, value in row.items()} | summary for row in rows],
        guesses=guesses(trials),
    )


@command
@with_table(*WITHOUT_LAW, "states", "inputs", "properties", "exclude", training=True)
@with_question
@with_outputs
@with_batch
@with_cluster
def discover(source: Source, question: Question, outputs: Outputs, batch: Batch, cluster: str | None) -> None:
    """Discover the law that the objects in TABLE share.

    TABLE has one row for each sample (CSV, TSV, Parquet, Excel). Several tables, or a folder of them, are read as
    one, and named after objects and trials: golf_1.csv, golf_2.csv, tennis_1.csv. The law is checked by forecasts of
    the trials that --hold-out names or --where leaves out, or if there are none, of its training data. Parquet files
    in a folder or a quoted pattern are streamed one by one, with --cluster by its workers.

    \b
    Examples:
      commonlaw discover drops.csv --object ball --trial drop --time t --state height --order 2 \\
          --save law.json --save law.png --save report.html
      commonlaw discover drops.csv --schema drops.toml --order 2 --exclude trial=3 --learn-until 1.5
      commonlaw discover drops/*.csv --save report.html
      commonlaw discover monday.csv tuesday.csv --each --order 2 --save results.csv
      commonlaw discover 'runs/*.parquet' --object car --trial run --time t --state x --cluster tcp://host:8786
      commonlaw discover dataset:ball-drops --where trial=1 --order 2 --set solver=group-stlsq:1.5
    """
    if not batch.each:
        source = replace(source, more=batch.more)
    streams = bool(cluster) or source.is_stream
    batch.check(source, outputs, cluster)
    if streams and not batch.each:
        source.check_streams()
    with working("Discovering ...") as show, on_cluster_at(cluster, show):
        if batch.each:
            results = batch.run(source, question, show)
        else:
            learned, later = find_law(source, outputs, show, streams, question.answer, question.explained)
    if batch.each:
        give(results, outputs.save)
    else:
        outputs.give(learned, later)


@command
@with_table(*WITHOUT_LAW, "states", "inputs", "exclude", training=True)
@click.argument("equations", required=False)
@option(
    "--initial-value STATE=VALUE...",
    "Initial value of a state, at the first sample of each trial: a number, a property of the objects, "
    "depot=dose, a parameter, x=x0, or depot=free to estimate it",
    "initial_values",
    group="Law",
    everyday=True,
)
@option(
    "--initial-time TIME",
    "Time of these initial values, if before the first sample of a trial, such as that of an injection.",
    "initial_time",
    group="Law",
    type=float,
)
@option(
    "--dose COLUMN...",
    'An input that holds amounts which are added at once, at the times of their rows, "c\' = -k c + dose/V"',
    "doses",
    group="Law",
)
@option(
    "--shared PARAMETER[=COLUMN]...",
    "A coefficient of the equations that all objects have in common, k, or objects and trials with one "
    "value of a column, k=strain; k=trial is one for each trial",
    group="Law",
    everyday=True,
)
@option(
    "--guess PARAMETER=VALUE...",
    "Initial guess of a nonlinear parameter, a frequency w=0.3  [default: a grid of values]",
    "guesses",
    group="Law",
)
@with_settings("fit")
@option(
    "--against LAW.json",
    "",
    group="Output",
    type=ReadFile(),
    replaced_by="write commonlaw compare TABLE LAW LAW afterwards",
)
@with_outputs
@with_cluster
def fit(
    source: Source,
    equations: str,
    initial_values: tuple[str, ...],
    initial_time: float | None,
    doses: tuple[str, ...],
    shared: tuple[str, ...],
    guesses: tuple[str, ...],
    settings: dict[str, Any],
    against: str | None,
    outputs: Outputs,
    cluster: str | None,
) -> None:
    """Fit given equations to the trials in TABLE.

    EQUATIONS has one for each state, between semicolons: "T' = a + b T", "x'' = -9.81 - c v", "dH/dt = a H - b H P;
    dP/dt = c H P - d P", "s' = -V s/(K + s)". Letters are parameters to be estimated, numbers are fixed; v is
    the rate of x. By default, columns with an equation are states, and others that occur are inputs. Observation
    equations, initial values, events and bounds may follow. In place of equations, the name of a model that `commonlaw
    models` lists: logistic. Forecasts are checked as by `commonlaw discover`. With --cluster Parquet files are fitted
    one by one.

    \b
    Examples:
      commonlaw fit cups.csv "T' = -k (T - 20)" --save law.json
      commonlaw fit enzymes.csv "s' = -V s/(K + s)"
      commonlaw fit mice.csv logistic:x=weight
      commonlaw fit doses.csv "d' = -a d; c' = b d - k c" --initial-value d=dose
      commonlaw fit cells.csv "x' = -k x; signal = c x (1 + x); x(0) = 1"
      commonlaw fit ball.csv "x'' = -g; x < 0: x = 0, v = -c v"
      commonlaw fit dataset:linear-drag:noise=0.05 "x'' = -g - c v"
    """
    import commonlaw as cl

    if cluster:
        alone = {"--initial-value": initial_values, "--initial-time": initial_time, "--dose": doses}
        source.check_streams(alone | {"--against": against, "--shared": shared, "--guess": guesses})
        with working("Fitting ...") as show, on_cluster_at(cluster, show):
            outcome = find_law(
                source, outputs, show, True, lambda trials, tell: cl.fit(equations, trials, **settings, progress=tell)
            )
        outputs.give(*outcome)
        return
    with working("Fitting ...") as show:
        equations, of_model = over_table(source, equations)
        doses = doses or of_model
        rival = cl.Law.load(against) if against else None
        if doses:
            source = source.reading(inputs=tuple(dict.fromkeys((*source.roles.get("inputs", ()), *doses))))
        later = Artifacts()
        known = {name: number_or_text(value) for name, value in by_name("--initial-value", initial_values).items()}
        groups = {name: by or ALL for name, _, by in (group.partition("=") for group in shared)}
        others = [rival] if rival else []
        trials = without_notes_on(doses, load(source, [equations], others, known, groups.values()))
        training = source.select(trials)
        settings |= {
            "initial_time": initial_time,
            "doses": doses,
            "shared": groups if any("=" in group for group in shared) else shared,
        }
        settings |= {"guesses": numbers("--guess", guesses) or None}
        law = cl.fit(equations, training, initial_values=known, **settings, progress=show)
        later.save(outputs.save, law=law)
        learned = FitResult.check(law, source, trials, training, outputs.draws, later)
        if against and rival:
            laws = {"fitted": law, against: rival}
            comparison = later.take("the laws were not compared", lambda: compared(laws, training, settings), None)
            learned = replace(learned, compared=comparison)
    outputs.give(learned, later)


_GRADES = (
    (2.0, "Not distinguishable from it with these data"),
    (6.0, "Positive evidence against"),
    (10.0, "Strong evidence against"),
    (float("inf"), "Very strong evidence against"),
)
"""Of 2 log B, up to which (Kass and Raftery 1995)."""


@command
@with_table(*WITHOUT_LAW)
@click.argument("laws", nargs=-1, metavar="LAW LAW...", type=ReadLaw())
@with_settings("fit")
@saving(table="the table")
@AS_JSON
def compare(
    source: Source, laws: tuple[str, ...], settings: dict[str, Any], save: tuple[str, ...], as_json: bool
) -> None:
    """Compare laws by their evidence in TABLE.

    A LAW is equations as for `commonlaw fit`, or a saved law, LAW.json. All coefficients are fitted to the same
    trials under the same noise, so that only the equations differ. The most probable law comes first.
    Saved laws keep their observation equations, shared parameters and bounds.

    \b
    Examples:
      commonlaw compare drops.csv "x'' = -g" "x'' = -g - c v" "x'' = -g - c v*abs(v)"
      commonlaw compare drops.csv discovered.json "x'' = -9.81 - c v"
      commonlaw compare dataset:linear-drag:noise=0.05 "x'' = -g" "x'' = -g - c v"
      commonlaw compare cells.csv "x' = -k x; signal = c x; x(0) = 1" "x' = -k x^2; signal = c x; x(0) = 1"
    """
    import commonlaw as cl

    if len({*laws}) < max(2, len(laws)):
        raise click.UsageError("give TABLE and two laws or more that differ: \"x'' = -g\" \"x'' = -g - c v\"")
    later = Artifacts()
    with working("Comparing ...") as show:
        saved = {law: cl.Law.load(law) for law in laws if is_of_kind(law, "law")}
        texts = {law: over_table(source, law)[0] for law in laws if law not in saved}
        training = source.select(load(source, [*texts.values()], saved.values()))
        for text in texts.values():  # What cannot be read is refused before the others are fitted
            _naming(text, _check_readable, training)
        fitted = {}
        for number, law in enumerate(laws):
            share = part(show, number / (len(laws) + 1), (number + 1) / (len(laws) + 1))
            share(f"fitting {law}")
            fitted[law] = saved.get(law) or _naming(texts[law], cl.fit, training, **settings, progress=share)
        show(Stage("comparing evidence", len(laws) / (len(laws) + 1)))
        frame = compared(fitted, training, settings)
        later.save(save, table=lambda: frame)
    if as_json:
        print_json({"laws": frame.to_dict(orient="records")})
    else:
        first, *others = zip(frame["law"], frame["2 log B"], strict=True)
        against = dict[str, list[str]]()
        for name, below in others:
            against.setdefault(next(grade for most, grade in _GRADES if below <= most), []).append(name)
        say(f"{first[0]} is the most probable of these laws.")
        for grade, names in against.items():
            say(f"{grade}: {', '.join(names)}.")
        print_compared(frame if any(is_of_kind(law, "law") for law in laws) else frame.drop(columns="equations"))
    later.end(training.notes, silent=as_json)


def _check_readable(equations: str, trials: Trials) -> None:
    """Refuse equations, with observation equations or not, that cannot be read."""
    from commonlaw.estimation.model import ModelText, read_model
    from commonlaw.law.parse import read_equations

    if (text := ModelText.of(equations)).is_plain:
        read_equations(equations, trials.schema)
    else:
        read_model(text, trials.schema, property_names(trials.properties))


def _naming(law: str, work: Callable[..., T], *given: Any, **settings: Any) -> T:
    """Return what work makes of a law; an error says of which law it is."""
    try:
        return work(law, *given, **settings)
    except CommonlawError as error:
        raise error.at(law) from error


@command
@with_table(*WITH_LAW)
@LAW_ARGUMENT
@with_settings("refine")
@saving(law="the law", program="the law as a program or workbook")
@HISTORY
@with_cluster
def refine(
    source: Source, law_path: str, settings: dict[str, Any], save: tuple[str, ...], history: bool, cluster: str | None
) -> None:
    """Refit the coefficients of LAW.json to TABLE.

    They are estimated by maximum likelihood of the trajectories. The terms are fixed; the law gets standard errors.
    With --cluster Parquet files are fitted one by one; their objects need not be in the law.

    \b
    Example:
      commonlaw discover drops.csv --order 2 --set solver=group-stlsq:1.5 --save law.json
      commonlaw refine drops.csv law.json --save refined.json
      commonlaw refine 'runs/*.parquet' law.json --save refined.parquet --cluster local:4
    """
    import commonlaw as cl

    law = cl.Law.load(law_path)
    if cluster:
        source.check_streams()
    with working("Refining ...") as show, on_cluster_at(cluster, show):
        trials = source.select(stream_of(source, law.schema)) if cluster else source.chosen(measured_schema(law))
        law = cl.refine(law, trials, **settings, progress=show)
        later = Artifacts()
        later.save(save, law=law)
    print_law(law)
    if history:
        print_history(law)
    later.end((*(trials.notes if isinstance(trials, cl.Trials) else ()), *law.diagnostics))


@command
@click.argument("names", nargs=-1, metavar="[NAME...]")
def models(names: tuple[str, ...]) -> None:
    """List the textbook models that `commonlaw fit` takes by name, or describe some of them.

    \b
    Example:
      commonlaw models logistic
      commonlaw fit mice.csv logistic:x=weight
    """

    for name in names:
        check_choice("named model", name, named_models)
    for name in names:
        model = named_models[name]
        say(f"{name}: {model.title}\n  {model.equations}")
        for symbol, meaning in {**model.variables, **model.parameters}.items():
            say(f"  {symbol}: {meaning}")
        say(f"  source: {model.source}\n")
    if not names:
        width, heading = max(map(len, named_models)), ""
        for model in named_models.values():
            if model.field != heading:
                heading = model.field
                say(f"\n{heading}:")
            say(f"  {model.name:{width}}  {'; '.join(model.without_bounds)}")
