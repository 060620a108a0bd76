"""`commonlaw fit`: from equations in mind and a table to a law."""

import re
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import click

from commonlaw.cli.command import command
from commonlaw.cli.learned import Learned, Outputs, with_outputs
from commonlaw.cli.methods import with_likelihood
from commonlaw.cli.options import option
from commonlaw.cli.output import working
from commonlaw.cli.paths import ReadFile
from commonlaw.cli.source import Source, with_training_source
from commonlaw.errors import CommonlawError

if TYPE_CHECKING:
    from commonlaw.law import Law
    from commonlaw.trials import Trials


@command
@click.argument("equations")
@with_training_source
@with_likelihood
@option(
    "Output",
    "--against",
    metavar="LAW.json",
    type=ReadFile(),
    help="Say how the fitted law stands in evidence beside another.",
)
@with_outputs
def fit(equations: str, source: Source, settings: dict[str, Any], against: str | None, outputs: Outputs) -> None:
    """Fit a law that you have in mind to the trials in FILE.

    EQUATIONS has one for each state, between semicolons: "T' = a + b T", "x'' = -9.81 - c v", "dH/dt = a H - b H P;
    dP/dt = c H P - d P". Letters that multiply or divide terms are coefficients to be found, numbers are known;
    v is the rate of x. Unless --state says otherwise, columns with an equation are states, and others that occur are
    inputs. The law is checked like one of `commonlaw discover`.

    \b
    Examples:
      commonlaw fit "T' = -k (T - 20)" cups.csv --save law.json
      commonlaw fit "T' = a + b T" cups.csv --against discovered.json
      commonlaw fit "x'' = -g - c v" --dataset linear-drag:noise=0.05
    """
    import commonlaw as cl

    with working("Fitting ..."):
        other = cl.Law.load(against) if against else None
        trials = _load(source, equations, other.schema.inputs if other else ())
        training = source.select(trials)
        law = cl.fit(equations, training, **settings)
        learned = Learned.check(law, source, trials, training, bands=bool(outputs.plot))
        if against and other:
            learned = _compared(learned, {"fitted": law, against: other}, settings)
    outputs.give(learned)


def _compared(learned: Learned, laws: "dict[str, Law]", settings: dict[str, Any]) -> Learned:
    """Return what was learned, beside other laws; if they cannot be compared, with the reason."""
    from commonlaw.inference import compare

    same = {name: settings[name] for name in ("noise", "errors", "huber_threshold") if name in settings}
    try:
        return replace(learned, compared=compare(laws, learned.training, **same))
    except CommonlawError as error:
        return replace(learned, lacking=(*learned.lacking, f"the laws were not compared: {error}"))


def _load(source: Source, equations: str, more: Sequence[str]) -> "Trials":
    """Return the trials, their columns in the roles that equations give them; more of them are inputs too."""
    from commonlaw.library.equation import split_equations

    trials, states = source.load(), tuple(each.state for each in split_equations(equations))
    if source.dataset or source.states or {*states} == {*trials.schema.states}:
        return trials
    others = [name for name in trials.schema.states if name not in states]
    inputs = tuple(name for name in others if name in more or _occurs(name, equations))
    return replace(source, states=states, inputs=source.inputs or inputs).load()


def _occurs(name: str, equations: str) -> bool:
    return re.search(rf"(?<!\w){re.escape(name)}(?!\w)", equations) is not None
