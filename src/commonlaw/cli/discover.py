"""`commonlaw discover`: from a table to a law."""

import json
from dataclasses import asdict, dataclass
from functools import partial
from typing import TYPE_CHECKING

import click
import numpy as np

from commonlaw.cli.methods import with_method
from commonlaw.cli.options import GroupedCommand, numbers, option
from commonlaw.cli.output import print_frame, print_history, print_json, print_notes, print_table, working
from commonlaw.cli.source import Source, with_source
from commonlaw.errors import CommonlawError
from commonlaw.files import write_all

if TYPE_CHECKING:
    import pandas as pd

    from commonlaw.discovery import AbstractMethod
    from commonlaw.forecast import Forecast
    from commonlaw.law import Law
    from commonlaw.trials import Trials


_law, _output = partial(option, "Law"), partial(option, "Output")

_MORE_TERMS = 2

_MEASURES = ("held-out error", "standard error", "BIC", "stability", "2 log B", "probability")
"""What is shown of a candidate, as far as it is there."""


@click.command(cls=GroupedCommand)
@with_source
@_law(
    "--order",
    type=click.IntRange(0, 2),
    default=1,
    help="Order of the law: 1 for x' = ..., 2 for x'' = ..., 0 for x[k+1] = ...",
)
@_law(
    "--library",
    metavar="SPEC",
    help="Candidate terms: poly:3, fourier:2, terms:1,v,v*abs(v), or sums such as 'poly:2 + fourier:1'.  "
    "[default: poly:3]",
)
@_law(
    "--known",
    metavar="TERM=VALUE",
    multiple=True,
    help="A known coefficient, 1=-9.8; with several states say the equation, x:1=-9.8; repeat for more.",
)
@_law(
    "--universal",
    metavar="TERM",
    multiple=True,
    help="A term with one coefficient for all objects: 1 for gravity; with several states x:1; repeat for more.",
)
@with_method
@_output("--save", metavar="LAW.json", help="Write the law.")
@_output("--plot", metavar="FIGURE", help="Write a figure of the law and its forecasts (.png, .svg, .pdf).")
@_output("--history", is_flag=True, help="Print every choice on the way to the law, and why.")
@_output("--json", "as_json", is_flag=True, help="Print the result as JSON.")
def discover(
    source: Source,
    order: int,
    library: str | None,
    known: tuple[str, ...],
    universal: tuple[str, ...],
    method: "AbstractMethod | None",
    save: str | None,
    plot: str | None,
    history: bool,
    as_json: bool,
) -> None:
    """Find the law that the objects in FILE share.

    FILE is a table (CSV, TSV, Parquet, Excel) with one row for each sample. The law is checked by forecasting: the
    trials that --where leaves out, or if it leaves none, those that it was learned from.

    \b
    Examples:
      commonlaw discover drops.csv --object ball --trial drop --time t --state height --order 2 \\
          --save law.json --plot law.png
      commonlaw discover --dataset ball-drops --where trial=1 --order 2 --solver group-stlsq:1.5
    """
    import commonlaw as cl
    from commonlaw.datasets import truth_of

    with working("Discovering ...") as show:
        trials = source.load()
        training, held_out = source.split(trials)
        law = cl.discover(
            training,
            order=order,
            library=library,
            method=method,
            known={_key(name): value for name, value in numbers("--known", known).items()},
            universal=[_key(name) for name in universal],
            progress=show,
        )
        of_known = [trial for trial in held_out or () if trial.object in law.objects]
        checked = training if held_out is None or not of_known else held_out.with_trials(of_known)
        forecast, lacking = None, []
        try:
            forecast = law.predict(checked, return_std=bool(plot) and law.has_std)
        except (CommonlawError, ArithmeticError, np.linalg.LinAlgError) as error:
            lacking.append(f"the law was not checked by forecasts, nor drawn: {error}")
        discovery = _Discovery(training, law, forecast, truth_of(source.dataset) if source.dataset else None)
        outputs = discovery.files(save, plot)
    write_all(outputs)
    if as_json:
        print_json(discovery.document())
    else:
        discovery.show()
        if history:
            print_history(law)
        for path in outputs:
            click.echo(f"Wrote {path}")
    print_notes([*training.notes, *law.outcomes, *lacking, *(forecast.outcomes if forecast else ())])


def _key(name: str) -> str | tuple[str, str]:
    """Return a term, or state and term of ``state:term``."""
    state, colon, term = name.partition(":")
    return (state, term) if colon else name


@dataclass(frozen=True)
class _Discovery:
    """What was learned from, the law, its forecasts of trials held out or learned from, and the true law if known."""

    training: "Trials"
    law: "Law"
    forecast: "Forecast | None"
    truth: "Law | None"

    @property
    def is_held_out(self) -> bool:
        """Whether the forecasts are of trials that the law was not learned from."""
        return self.forecast is not None and self.forecast.trials is not self.training

    def files(self, save: str | None, plot: str | None) -> dict[str, bytes]:
        """Return the contents of the files to write, all made before the first is written."""
        outputs = {}
        if save:
            outputs[save] = self.law.to_json().encode()
        if plot and self.forecast:
            from commonlaw.plots import plot_law, render

            outputs[plot] = render(plot_law(self.law, self.forecast, truth=self.truth), plot)
        return outputs

    def show(self) -> None:
        """Print the law and how well it forecasts."""
        law, training = self.law, self.training
        click.echo(f"{len(training)} trials of {len(law.objects)} objects, {sum(map(len, training))} samples\n")
        if law.shared:
            click.echo("\n".join((*law.structure(), "")))
            columns = self._coefficient_columns()
            print_table(list(columns), zip(*columns.values(), strict=True))
        else:
            click.echo(str(law))
        if law.alternatives:
            click.echo("\nChosen (*) from these candidates; larger ones are left out:\n")
            print_frame(_shown_candidates(law))
        where = "held-out trials" if self.is_held_out else "trials it was learned from"
        if self.forecast:
            click.echo(
                f"\nForecasts of {len(self.forecast.trials)} {where}, each from its own initial state: "
                f"R^2 = {self.forecast.score():.5g}"
            )

    def document(self) -> dict[str, object]:
        """Return all results for ``--json``."""
        law, forecast = self.law, self.forecast
        return {
            "law": json.loads(law.to_json()),
            "equations": {name: list(law.equations(name)) for name in law.objects},
            "intervals": None if law.covariance is None else law.intervals().to_dict(orient="records"),
            "history": [asdict(step) for step in law.history],
            "truth": None if self.truth is None else json.loads(self.truth.to_json()),
            "forecast": forecast
            and {
                "of": "held out" if self.is_held_out else "training",
                "score": forecast.score(),
                "errors": forecast.errors().to_dict(orient="records"),
            },
            "notes": list(self.training.notes),
            "outcomes": [str(outcome) for outcome in (*law.outcomes, *(forecast.outcomes if forecast else ()))],
        }

    def _coefficient_columns(self) -> dict[str, list[object]]:
        """Return coefficients, with standard errors where they are known and true ones beside, and forecast errors."""
        law, truth = self.law, self.truth
        units, columns = law.coefficient_units(), {law.schema.object: list[object](law.objects)}
        errors = np.nan_to_num(law.standard_errors)
        for letter, (j, k) in zip(law.letters, np.argwhere(law.support), strict=True):
            equation, term = law.left_hand_sides[j], law.terms.names[k]
            pairs = zip(law.coefficients[:, j, k].tolist(), errors[:, j, k].tolist(), strict=True)
            head = _with_unit(letter, units.get((equation, term)))
            columns[head] = [(value, error) if error else value for value, error in pairs]
            if truth is not None:
                columns[f"true {letter}"] = [_true_value(truth, name, j, term) for name in law.objects]
        if self.forecast is None:
            return columns
        missed = self.forecast.errors().pivot_table(
            index=law.schema.object, columns="state", values="rms error", aggfunc=lambda each: np.sqrt(np.mean(each**2))
        )
        for state in law.states:
            head = _with_unit(f"rms error of {state}", law.schema.units.get(state))
            columns[head] = missed[state].reindex(law.objects).tolist()
        return columns


def _shown_candidates(law: "Law") -> "pd.DataFrame":
    """Return the candidates up to a few terms more than were chosen, with the measures that are there."""
    frame = law.candidates()
    chosen = frame[frame["chosen"]].groupby("equation")["size"].first()
    measures = [name for name in _MEASURES if name in frame and frame[name].notna().any()]
    frame["terms"] = [" + ".join(each.terms) or "0" for each in law.alternatives]
    frame[""] = np.where(frame["chosen"], "*", "")
    few = frame["size"] <= frame["equation"].map(chosen) + _MORE_TERMS
    return frame.loc[few, ["", "equation", "terms", *measures]]


def _with_unit(name: str, unit: str | None) -> str:
    return f"{name} ({unit})" if unit else name


def _true_value(truth: "Law", name: str, equation: int, term: str) -> float:
    """Return a true coefficient; zero where the true law has no such term."""
    if term not in truth.terms.names:
        return 0.0
    return float(truth.coefficients_of(name)[equation, truth.terms.index(term)])
