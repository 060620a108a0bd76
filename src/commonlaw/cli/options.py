"""Options in groups, their values, and the files that they name: which a command reads, and which it writes."""

import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import fields
from functools import wraps
from pathlib import Path
from typing import Any

import click
from click.shell_completion import CompletionItem
from click.types import StringParamType

from commonlaw.diagnostics import Dialect
from commonlaw.errors import CommonlawError
from commonlaw.runtime.files import check_targets, is_file, is_folder
from commonlaw.runtime.packages import optional_import
from commonlaw.text import as_text, in_line

Decorator = Callable[[Callable[..., None]], Callable[..., None]]


class GroupedOption(click.Option):
    """An option that stands under a heading; the short help lists only everyday ones.

    One that takes settings by name has `settings`: by heading, rows of name and text.
    """

    def __init__(
        self,
        *args: Any,
        group: str,
        everyday: bool,
        settings: Callable[[], Mapping[str, Sequence[tuple[str, str]]]] = dict,
        **others: Any,
    ) -> None:
        super().__init__(*args, **others)
        self.group, self.everyday, self.settings = group, everyday, settings


OTHERS = "Options"
"""The heading of options that have no other."""


def option(
    spec: str,
    help: str,
    *names: str,
    group: str = OTHERS,
    everyday: bool | None = None,
    **settings: Any,
) -> Decorator:
    """Return the decorator that adds an option under a heading, by default an everyday one under that of others.

    The `spec` is the option with what stands for its value, ``--state COLUMN``; with dots behind it is repeated.
    """
    flag, _, metavar = spec.partition(" ")
    if metavar.endswith("..."):
        text, mark, default = help.partition("  [default: ")
        help, metavar, settings["multiple"] = f"{text}; repeat for more.{mark}{default}", metavar[:-3], True
    settings |= {"group": group, "everyday": group == OTHERS if everyday is None else everyday}
    return click.option(flag, *names, cls=GroupedOption, metavar=metavar or None, help=help, **settings)


AS_JSON = option("--json", "Print the result as JSON.", "as_json", group="Output", is_flag=True, everyday=True)
"""Adds the option to a command, which receives it as `as_json`."""


def taking(options: Sequence[Decorator], convert: Callable[[dict[str, Any]], dict[str, Any]] = dict) -> Decorator:
    """Return the decorator that adds options to a command; its help lists them in this order.

    The command receives their values, by name, as `convert` makes them.
    """

    def decorate(command: Callable[..., None]) -> Callable[..., None]:
        @wraps(command)
        def wrapped(**values: Any) -> None:
            command(**convert(values))

        made: Callable[..., None] = wrapped
        for add in reversed(options):
            made = add(made)
        return made

    return decorate


def as_one(name: str, kind: type, options: Sequence[Decorator]) -> Decorator:
    """Return the decorator that adds options to a command, which receives them as one argument of this name.

    It is a dataclass with a field for each of them; what adds its own argument to a command may be among the options.
    """

    def convert(values: dict[str, Any]) -> dict[str, Any]:
        return {
            name: kind(**{field.name: values.pop(field.name) for field in fields(kind) if field.name in values}),
            **values,
        }

    return taking(options, convert)


_OF_CHECK = " of commonlaw data check --save"
"""After options of tables that other commands read from a schema."""


def options_of_check(command: click.Command) -> Mapping[str, str]:
    """Return the options of ``commonlaw data check`` that a command with ``--schema`` reads from that file, by name."""
    tables = (param.type for param in command.params if isinstance(param.type, ReadTable))
    options = next((table.in_schema for table in tables), {})
    return {} if "schema" in options else options


def dialect(command: click.Command, has_schema: bool = False) -> Dialect:
    """Return what writes settings as the options of a command: ``time='t'`` is ``--time t``.

    A list is an option that is repeated, a mapping one of ``NAME=VALUE``. What only a schema says stands as in the one
    that was given, or else is an option of the command that writes schemas. A setting without an option of its own goes
    with ``--set``, and anything else stays Python.
    """
    by_name = {str(param.name): param for param in command.params}
    lists = [param.settings().values() for param in command.params if isinstance(param, GroupedOption)]
    settings = {row[0] for rows in lists for group in rows for row in group}

    def write(code: str) -> str:
        name, _, value = code.partition("=")
        name, value = ("clip", "true") if code == "clip_irregular()" else (name, value)
        if name == "name" and name not in by_name:  # An object, which commands choose in the table
            name, value = "where", f"{{'object': {value}}}"
        of_check = {} if name in by_name else options_of_check(command)
        if name in of_check and has_schema:
            toml = re.sub(r"('[^']*'): ", r"\1 = ", value)
            return f"{name} = {toml} in the --schema file"
        if name in by_name or name in of_check:
            option = max(by_name[name].opts, key=len) if name in by_name else of_check[name]
            written = option if name == "clip" else " ".join(f"{option} {text}" for text in _texts(value, write))
            return f"{written}{_OF_CHECK}" if name in of_check else written
        if name == "doses":  # That other commands do not take
            return f"{' '.join(f'--dose {text}' for text in _texts(value, write))} of commonlaw fit"
        return " ".join(f"--set {name}={text}" for text in _texts(value, write)) if name in settings else code

    return write


def _texts(value: str, write: Dialect) -> list[str]:
    """Return the texts that an option takes for a value in Python; settings within it are written by `write`."""
    if value.startswith("["):
        return value[1:-1].split(", ")
    if value.startswith("{"):
        texts = re.sub(r"'([^']*)': ", r"\1=", value[1:-1]).split(", ") if value != "{}" else ["''"]
        return [f"'{text}'" if re.search(r"[\s<>&|;()]", text) and "'" not in text else text for text in texts]
    if made := re.fullmatch(r"(\w+(?:Regression|Likelihood))\((.*)\)", value):
        words = re.sub(r"(?<!^)(?=[A-Z])", "-", made[1]).lower()
        return [" ".join([words, *(write(setting) for setting in made[2].split(", ") if setting)])]
    return [value[1:-1] if re.fullmatch(r"'[\w-]+'", value) else value]


def in_options(text: str) -> str:
    """Return a message whose code, between backticks, is in the words of the command that runs.

    In threads of its own a command is not known, and a message stays as it is.
    """
    context = click.get_current_context(silent=True)
    write = dialect(context.command, bool(context.params.get("schema"))) if context else str
    written = re.sub(r"`(\w+=[^`]*|clip_irregular\(\))`", lambda match: write(match[1]), text)
    return re.sub(rf"{_OF_CHECK}(?=, --[\w-]+ \.\.\.{_OF_CHECK})", "", written)


def pairs(name: str, texts: Sequence[str]) -> Iterator[tuple[str, str]]:
    """Yield name and value of texts like ``NAME=VALUE`` that an option got; any other text is wrong usage."""
    for text in texts:
        key, sign, value = text.partition("=")
        if not (key and sign and value):
            raise click.UsageError(f"{name} {text!r} is not of the form NAME=VALUE")
        yield key.strip(), value.strip()


def by_name(name: str, texts: Sequence[str]) -> dict[str, str]:
    """Return the values that an option gives by name; two for one name are wrong usage."""
    values: dict[str, str] = {}
    for key, value in pairs(name, texts):
        if key in values:
            raise click.UsageError(f"{name} gives {key} twice, {values[key]} and {value}: give it once")
        values[key] = value
    return values


def numbers(name: str, texts: Sequence[str]) -> dict[str, float]:
    """Return the numbers that an option gives by name."""
    result = {}
    for key, text in by_name(name, texts).items():
        try:
            result[key] = float(text)
        except ValueError:
            raise click.UsageError(f"{name} {key}={text}: {text!r} is not a number") from None
    return result


_EQUATION = re.compile(r"('|\]|/\s*d\s*\w+(\s*\^?\s*2)?)\s*=")
"""The left-hand side of an equation: of ``x''``, ``x[k+1]``, ``dx/dt``."""


class _File(StringParamType):
    """A name of a file; a shell completes it."""

    name = "file"

    def shell_complete(self, ctx: click.Context, param: click.Parameter, incomplete: str) -> list[CompletionItem]:
        """Leave the names to the shell."""
        return [CompletionItem(incomplete, type="file")]


class ReadFile(_File):
    """A file that is read, and that no option may have written over."""

    def files(self, value: str) -> list[str]:
        """Return the files that a value names."""
        return [value]


class ReadLaw(ReadFile):
    """The file of a law, or else the text of one."""

    def files(self, value: str) -> list[str]:
        """Return the file if a value names one."""
        return [value] if is_of_kind(value, "law") else []


DATASET = "dataset:"
"""Begins a table that is a data set of the package: ``dataset:linear-drag:noise=0.1``."""


class ReadTable(ReadFile):
    """A table: a file, or a data set with its options, some of which may name a file or a folder of files.

    Options that describe it in a schema, and are none of a command, are `in_schema`, by name.
    """

    def __init__(self, in_schema: Mapping[str, str]) -> None:
        self.in_schema = in_schema

    def get_missing_message(self, param: click.Parameter, ctx: click.Context | None = None) -> str:
        """Return what may be given where it is missing."""
        return "Give a file, or a data set, dataset:NAME (see: commonlaw data list)."

    def files(self, value: str) -> list[str]:
        """Return the file, or what is in the folders that options of a data set name."""
        if not value.startswith(DATASET):
            return [value]
        named = [Path(option) for option in re.findall(r"=([^:]+)", value)]
        inside = (path.iterdir() if is_folder(path) else [path] for path in named)
        return [str(file) for listed in inside for file in listed if is_file(file)]


ENDINGS = {
    "law": (".json", ".parquet"),
    "figure": (".png", ".svg", ".pdf"),
    "report": (".html", "report.pdf"),
    "table": (".csv", ".parquet"),
    "schema": (".toml",),
    "program": (".c", ".py", ".m", ".mo", ".xml", ".sbml", ".xlsx"),
}
"""Endings of the files that a result is written to, by its kind."""


def is_of_kind(path: str, kind: str) -> bool:
    """Return whether a file has an ending of a kind."""
    return path.lower().endswith(ENDINGS[kind])


LAW_ARGUMENT = click.argument("law_path", required=False, metavar="LAW.json", type=ReadFile())
"""Adds the law to a command, after its table; it receives it as `law_path`."""


class WrittenFile(_File):
    """A file that is written, of one of some kinds, see `ENDINGS`."""

    def __init__(self, *kinds: str) -> None:
        self.kinds = kinds

    def check(self, path: str) -> None:
        """Refuse a name that says none of the kinds."""
        if not any(is_of_kind(path, kind) for kind in self.kinds):
            endings = dict.fromkeys(ending for kind in self.kinds for ending in ENDINGS[kind])
            raise CommonlawError("result-format", path=path, endings=[*endings])
        if path.endswith(".parquet"):
            optional_import("pyarrow.parquet", "writing Parquet files", "parquet")
        if is_of_kind(path, "figure"):
            from commonlaw.plots import figure_format

            figure_format(path)  # Refuses an environment that cannot draw, too
        if is_of_kind(path, "report"):
            from commonlaw.report import browser, check_packages

            check_packages()
            if path.lower().endswith(".pdf"):
                browser()


def saving(required: bool = False, default: tuple[str, ...] | None = None, **content: str) -> Decorator:
    """Return the decorator that adds ``--save`` for files of some kinds, each with what is in it, as `save`."""
    texts, taken = list[str](), set[str]()
    for kind, what in content.items():
        texts.append(f"{what} ({' '.join(ending for ending in ENDINGS[kind] if ending not in taken)})")
        taken |= {*ENDINGS[kind]}
    settings: dict[str, Any] = {"required": required, "default": default, "type": WrittenFile(*content)}
    return option("--save FILE...", f"Write {', or '.join(texts)}", group="Output", everyday=True, **settings)


def usage(context: click.Context) -> str:
    """Return a command with its arguments in their order: ``commonlaw predict TABLE LAW.json``."""
    arguments = [param.metavar for param in context.command.params if isinstance(param, click.Argument)]
    return " ".join([context.command_path, *filter(None, arguments)])


def take_law_alone(command: click.Command, values: dict[str, Any]) -> None:
    """Take an argument alone as the law where the table may be left out."""
    may_lack_table = any(param.name == "path" and not param.required for param in command.params)
    if may_lack_table and "law_path" in values and not values["law_path"]:
        values["path"], values["law_path"] = None, values["path"]


def check_order(context: click.Context) -> None:
    """Refuse a table in the place of a law, and a law in that of a table.

    Raises `click.UsageError`, with the right order, if the value of an argument is plainly what another one takes, or
    one is missing.
    """
    values = context.params
    law, equations, path = (str(values.get(name) or "") for name in ("law_path", "equations", "path"))
    is_many = is_of_kind(path, "law") and not is_file(law) and bool({*"*?["} & {*law})
    if is_many or (_is_there(law) and not is_of_kind(law, "law")):
        problem = f"{law} is a table, not a saved law"
    elif _is_there(equations) and not _EQUATION.search(equations):
        problem = f"{equations} is a table, not an equation"
    elif _EQUATION.search(path) and not is_file(path):
        problem = f"{path} is an equation, not a table"
    elif path.endswith(".json"):
        problem = f"{path} is a saved law, not a table"
    elif "law_path" in values and not law:
        problem = "Missing argument 'LAW.json'"
    elif "equations" in values and not equations:
        problem = "Missing argument 'EQUATIONS'"
    else:
        return
    raise click.UsageError(in_line(f"{problem}: write {usage(context)}"))


def _is_there(text: str) -> bool:
    """Return whether a text names a file, a folder or a data set."""
    return bool(text) and (text.startswith(DATASET) or is_file(text) or is_folder(text))


def check_text(params: Iterable[click.Parameter], values: dict[str, Any]) -> None:
    """Refuse words that are no text in UTF-8; names of files may be any bytes."""
    for param in params:
        for text in (given for given in _values(values.get(str(param.name))) if isinstance(given, str)):
            is_read = isinstance(param.type, ReadFile) and text in param.type.files(text)
            if as_text(text) != text and not is_read and not isinstance(param.type, WrittenFile):
                raise click.UsageError(f"{param.opts[0]}: '{in_line(text)}' is not text in UTF-8: write it so")


def check_files(params: Iterable[click.Parameter], values: dict[str, Any]) -> None:
    """Refuse files that are to be written and cannot, or must not, as they are read.

    Raises `CommonlawError` as `check_targets` does, or if the name of a figure or table says no format.
    """
    given = [(param.type, text) for param in params for text in _values(values.get(str(param.name)))]
    written = [(kind, path) for kind, path in given if isinstance(kind, WrittenFile)]
    read = [file for kind, text in given if isinstance(kind, ReadFile) for file in kind.files(text)]
    check_targets([path for _, path in written], read)
    for kind, path in written:
        kind.check(path)


def _values(given: Any) -> list[Any]:
    return [] if given is None else list(given) if isinstance(given, tuple) else [given]
