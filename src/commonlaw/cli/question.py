"""What law is looked for, and how: the options that `discover` and `report` share."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

import click

from commonlaw.cli.later import LaterSteps
from commonlaw.cli.methods import with_method
from commonlaw.cli.options import as_one, by_name, numbers, option
from commonlaw.cli.paths import ReadLaw, is_law_file

if TYPE_CHECKING:
    from commonlaw.discovery import AbstractMethod
    from commonlaw.discovery.known_physics import Base
    from commonlaw.discovery.orders import AskedOrder
    from commonlaw.law import Law
    from commonlaw.trials import Trials, TrialStream

_law = partial(option, "Law")


class _Order(click.IntRange):
    """The order of a law, those of its states, or the word that leaves it to the measurements."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        if isinstance(value, str) and "=" in value:
            by_state: dict[str, Any] = {**by_name("--order", value.split(","))}
            return {state: super(_Order, self).convert(each, param, ctx) for state, each in by_state.items()}
        return value if value == "auto" else super().convert(value, param, ctx)


_OPTIONS = (
    _law(
        "--order",
        type=_Order(0, 2),
        metavar="ORDER",
        default="auto",
        help="Order of the law: 1 for x' = ..., 2 for x'' = ..., 0 for x[k+1] = ...; where equations differ by state, "
        "theta=2,i=1; auto for 1 where such a law fits within the noise, otherwise 1 or 2 for each state, by evidence; "
        "1 for streams and regressions.",
    ),
    _law(
        "--library",
        metavar="SPEC",
        default="auto",
        help="Candidate terms: poly:3, fourier:2, terms:1,v,v*abs(v), families with constants inside such as "
        "saturating, sums such as 'poly:2 + saturating', ratios of sums as in 'ratio(poly:2, poly:2)', or auto for "
        "poly:3, and for all of these where it shows lack of fit; poly:3 only for streams and regressions.",
    ),
    _law(
        "--known",
        metavar="TERM=VALUE",
        type=ReadLaw(),
        multiple=True,
        help="A known coefficient, 1=-9.8; with several states say the equation, x:1=-9.8; repeat for more. Or a base, "
        "and the law is what is left: an equation with numbers, \"x'' = -9.8\", or a law, LAW.json.",
    ),
    _law(
        "--universal",
        metavar="TERM",
        multiple=True,
        help="A term with one coefficient for all objects: 1 for gravity; with several states x:1; repeat for more.",
    ),
    _law(
        "--unmeasured",
        type=click.IntRange(0, 1),
        default=0,
        help="1 to ask, too, for a state that nobody measured, such as a depot, a compartment, or a drive. Goes with "
        "trajectory-likelihood.",
    ),
    _law(
        "--explain",
        is_flag=True,
        help="Say what in the law is universal, what follows the objects' properties, and what is each object's own.",
    ),
    _law(
        "--no-cache",
        is_flag=True,
        help="Find the law anew, even if the same was asked of the same trials before, and keep it nowhere.",
    ),
)


@dataclass(frozen=True)
class Question:
    """What these options say."""

    order: "AskedOrder"
    library: str
    known: tuple[str, ...]
    universal: tuple[str, ...]
    unmeasured: int
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
            known=_known(self.known),
            universal=[_key(name) for name in self.universal],
            unmeasured=self.unmeasured,
            progress=show,
            cache=not self.no_cache,
        )

    def explained(self, law: "Law", show: Callable[[str], None], later: LaterSteps) -> "Law":
        """Return the law with what decides its coefficients if that is asked for and can be said."""
        if not self.explain:
            return law
        show("explaining coefficients")
        return later.take("the coefficients were not explained", law.explain, law)


with_question = as_one("question", Question, (*_OPTIONS, with_method))
"""Adds the options of the law and of the methods to a command, which receives them as `question`."""


def _known(texts: Sequence[str]) -> "Base":
    """Return what is known: coefficients by term, equations, or the law in a file."""
    from commonlaw.law import Law

    if len(texts) == 1 and is_law_file(texts[0]):
        return Law.load(texts[0])
    if any(set("'[") & set(each.partition("=")[0]) for each in texts):
        return "; ".join(texts)
    return {_key(name): value for name, value in numbers("--known", texts).items()}


def _key(name: str) -> str | tuple[str, str]:
    """Return a term, or state and term of ``state:term``."""
    state, colon, term = name.partition(":")
    return (state, term) if colon else name
