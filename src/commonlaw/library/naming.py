"""How the name of a variable is written: in a text, in an expression, in LaTeX."""

import re

from commonlaw.names import in_latex

_WORD = re.compile(r"[^\W\d]\w*")
_GREEK = re.compile(
    "alpha|beta|(var)?epsilon|zeta|eta|iota|kappa|mu|nu|rho|tau|chi|[Gg]amma|[Dd]elta|[Tt]heta|[Ll]ambda|[Xx]i|[Pp]i"
    "|[Ss]igma|[Uu]psilon|(var)?[Pp]hi|[Pp]si|[Oo]mega"
)


def quoted(name: str) -> str:
    """Return the name as an expression holds it: between backticks unless it is a plain word.

    >>> quoted("v_x"), quoted("wind speed")
    ('v_x', '`wind speed`')
    """
    return name if _WORD.fullmatch(name) else "`" + name.replace("`", "``") + "`"


def powered(name: str, power: int, sign: str = "^") -> str:
    """Return a power of a variable, in parentheses where its name is neither plain nor quoted.

    >>> powered("v", 1), powered("v", 2), powered("dx/dt", 2), powered("`dx/dt`", 2, "**")
    ('v', 'v^2', '(dx/dt)^2', '`dx/dt`**2')
    """
    if power == 1:
        return name
    plain = _WORD.fullmatch(name.rstrip("'")) or name.startswith("`")
    return f"{name}{sign}{power}" if plain else f"({name}){sign}{power}"


def latex_name(name: str) -> str:
    r"""Return the name in LaTeX: Greek letters by their name, what follows a letter's underscore or is a digit below.

    >>> print(latex_name("theta"), latex_name("x1"), latex_name("v_x"), latex_name("height"))
    \theta x_{1} v_{x} \mathrm{height}
    """
    match = re.fullmatch(r"([^\W\d_]+)(?:_?(\d+)|_([^\W_]+))?('*)", name)
    if match is None:
        return rf"\mathrm{{{in_latex(name)}}}"
    stem, number, index, primes = match.groups()
    below = number or (_stem(index) if index else "")
    return _stem(stem) + (f"_{{{below}}}" if below else "") + primes


def _stem(word: str) -> str:
    if _GREEK.fullmatch(word):
        return f"\\{word}"
    return word if len(word) == 1 else rf"\mathrm{{{word}}}"
