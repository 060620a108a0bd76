"""The one kind of error that a user of commonlaw can cause and mend."""

from collections.abc import Iterable, Mapping
from difflib import get_close_matches

from commonlaw.diagnostics import Diagnostic, Dialect
from commonlaw.text import in_line

_LONGEST = 100
"""Characters of an unknown name that a message shows and a suggestion is looked for."""


class CommonlawError(ValueError):
    """Input that cannot be used; the message says in one line what is wrong, where, and what to do.

    It ends with its code in brackets, which ``commonlaw help CODE`` explains.

    Parameters
    ----------
    code
        Names the sentence of the catalogue, see `commonlaw.diagnostics`.
    where
        The file, object or trial concerned.
    parameters
        Fill in the sentence.
    """

    def __init__(self, code: str, /, where: str = "", **parameters: object) -> None:
        super().__init__(code)
        self.diagnostic = Diagnostic(code, {name: _plain(value) for name, value in parameters.items()}, where)

    @classmethod
    def of(cls, diagnostic: Diagnostic) -> "CommonlawError":
        """Return the error that says this."""
        return cls(diagnostic.code, diagnostic.where, **diagnostic.parameters)

    @property
    def code(self) -> str:
        """Names the sentence of the catalogue."""
        return self.diagnostic.code

    @property
    def codes(self) -> tuple[str, ...]:
        """This code, and those of the messages that it holds."""
        return self.diagnostic.codes

    @property
    def parameters(self) -> Mapping[str, object]:
        """What fills in the sentence."""
        return self.diagnostic.parameters

    def at(self, where: str) -> "CommonlawError":
        """Return the same error, with a further place before it."""
        return self.of(self.diagnostic.at(where))

    def sentence(self, dialect: Dialect = str) -> str:
        """Return the message in one line, in the dialect of a front end; by default as Python."""
        return in_line(self.diagnostic.sentence(dialect))

    @property
    def explained(self) -> str:
        """The first of its codes with an explanation; empty for several errors, and those of other programs."""
        return next((code for code in self.codes if code not in ("several", "other")), "")

    def __str__(self) -> str:
        return self.sentence() if self.code in ("several", "other") else f"{self.sentence()} [{self.code}]"

    def __reduce__(self) -> tuple[object, ...]:
        return type(self).of, (self.diagnostic,)


def _plain(value: object) -> object:
    """Return a parameter as a message holds it: without what cannot be sent between processes or changes later."""
    if isinstance(value, CommonlawError):
        return value.diagnostic
    if isinstance(value, float):
        return float(value)  # Not one of NumPy, which is shown as np.float64(...)
    if isinstance(value, str | int | Diagnostic | None):
        return value
    if isinstance(value, list):
        return [*map(_plain, value)]
    if isinstance(value, Mapping):
        return {key: _plain(part) for key, part in value.items()}
    return tuple(map(_plain, value)) if isinstance(value, Iterable) else str(value)


def unknown(kind: str, name: object, known: Iterable[object]) -> CommonlawError:
    """Return the error for a name that is not among the known ones, with the nearest suggestion.

    >>> print(unknown("column", "hieght", ["t", "height"]))
    unknown column 'hieght': did you mean 'height'? Known: t, height [unknown-name]
    """
    names = [str(known_name) for known_name in known]
    folded = {known_name.casefold(): known_name for known_name in reversed(names)}
    shown = name if len(name := str(name)) <= _LONGEST else f"{name[:_LONGEST]}..."
    near = get_close_matches(shown.casefold(), folded, n=1, cutoff=0.6)
    hint = f"did you mean {folded[near[0]]!r}? " if near else ""
    return CommonlawError("unknown-name", kind=kind, name=shown, hint=hint, known=names or ["none"])


def check_choice(name: str, value: object, choices: Iterable[object]) -> None:
    """Refuse a value that is not among the choices of a setting, with the nearest suggestion."""
    known = list(choices)
    try:
        hash(value)
        is_known = value in known
    except TypeError:  # An array or a frame, whose equality is one of its entries
        is_known = False
    if not is_known:
        raise unknown(name, value, known)
