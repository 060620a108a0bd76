"""What commands say of a law that they learned: on the terminal, in files, as JSON."""

import json
from collections.abc import Callable
from dataclasses import asdict, dataclass, fields, replace
from functools import partial, wraps
from typing import TYPE_CHECKING, Any

import numpy as np

from commonlaw.cli.comparing import print_compared
from commonlaw.cli.later import LaterSteps
from commonlaw.cli.options import option, with_options
from commonlaw.cli.output import print_frame, print_history, print_json, print_notes, print_table, say
from commonlaw.cli.paths import WrittenFigure, WrittenFile
from commonlaw.cli.source import Source
from commonlaw.names import in_line
from commonlaw.wording import counted

if TYPE_CHECKING:
    import pandas as pd

    from commonlaw.forecast import Forecast
    from commonlaw.law import Law
    from commonlaw.law.verdict import LawVerdict
    from commonlaw.plots import Figure
    from commonlaw.trials import Trials

_output = partial(option, "Output")

_OPTIONS = (
    _output("--save", metavar="LAW.json", type=WrittenFile(), help="Write the law."),
    _output(
        "--plot",
        metavar="FIGURE",
        type=WrittenFigure(),
        help="Write a figure of the law and its forecasts (.png, .svg, .pdf).",
    ),
    _output("--history", is_flag=True, help="Print every choice on the way to the law, and why."),
    _output("--json", "as_json", is_flag=True, help="Print the result as JSON."),
)


@dataclass(frozen=True)
class Outputs:
    """What is wanted of a law that was learned."""

    save: str | None
    plot: str | None
    history: bool
    as_json: bool

    @property
    def named(self) -> list[str]:
        """The options that are given."""
        values = {"--save": self.save, "--plot": self.plot, "--history": self.history, "--json": self.as_json}
        return [name for name, value in values.items() if value]

    def keep(self, law: "Law", later: LaterSteps) -> None:
        """Write the law as it is so far."""
        later.write(self.save, lambda: law.to_json().encode())

    def give(self, learned: "Learned", later: LaterSteps) -> None:
        """Write the files and print the rest."""
        self.keep(learned.law, later)
        later.draw(self.plot, learned.figure)
        if self.as_json:
            print_json(learned.document())
        else:
            learned.show()
            if self.history:
                print_history(learned.law)
            for path in later.written:
                say(f"Wrote {path}")
        print_notes([*learned.notes(), *later.failures])
        later.end()


def with_outputs(command: Callable[..., None]) -> Callable[..., None]:
    """Add the options that say what is wanted of a law to a command; it receives them as `outputs`."""

    @wraps(command)
    def wrapped(**options: Any) -> None:
        outputs = Outputs(**{field.name: options.pop(field.name) for field in fields(Outputs)})
        command(outputs=outputs, **options)

    return with_options(wrapped, _OPTIONS)


@dataclass(frozen=True)
class Learned:
    """What was learned from, the law, its forecasts of trials held out or learned from, and the true law if known.

    A verdict says what the law is good for, the start how many first samples told where forecasts start, None for those
    that `Law.predict` takes, and words what the check lacked; laws may be compared, see
    `commonlaw.compare`.
    """

    training: "Trials"
    law: "Law"
    forecast: "Forecast | None"
    truth: "Law | None"
    verdict: "LawVerdict | None"
    start: int | None
    lacking: tuple[str, ...] = ()
    compared: "pd.DataFrame | None" = None

    @classmethod
    def check(
        cls, law: "Law", source: Source, trials: "Trials", training: "Trials", bands: bool, later: LaterSteps
    ) -> "Learned":
        """Return a law with forecasts, and their bands if wanted, see `checked_forecast`."""
        from commonlaw.datasets import truth_of
        from commonlaw.verdict import checked_forecast, checked_start

        name, start = source.dataset, checked_start(law, trials)
        truth = later.take("the true law was not found", lambda: truth_of(name) if name else None, None)
        verdict = later.take("the law was not judged", lambda: law.verdict(trials, training), None)
        unchecked: tuple[Forecast | None, tuple[str, ...]] = None, ()
        checking = partial(checked_forecast, law, trials, training, bands)
        forecast, lacking = later.take("the law was not checked by forecasts, nor drawn", checking, unchecked)
        if verdict is not None:
            law = replace(law, provenance=law.provenance.judged(verdict))
        return cls(training, law, forecast, truth, verdict, start, lacking)

    @property
    def forecast_of(self) -> str:
        """Whether the forecasts are of trials ``"held out"``, or of those of ``"training"``."""
        from commonlaw.verdict import is_of_training

        return "training" if self.forecast and is_of_training(self.forecast, self.training) else "held out"

    def figure(self, plots: Any) -> "Figure | None":
        """Return a figure of the law and its forecasts, if there are any."""
        return plots.plot_law(self.law, self.forecast, truth=self.truth) if self.forecast else None

    def show(self) -> None:
        """Print the law and how well it forecasts."""
        from commonlaw.law.tables import BAYES_FACTOR, readable_candidates

        law, training = self.law, self.training
        say(
            f"{counted(len(training), 'trial')} of {counted(len(law.objects), 'object')}, "
            f"{counted(sum(map(len, training)), 'sample')}\n"
        )
        if law.shared and law.explanation is None:
            say("\n".join((*map(in_line, law.structure()), "")))
            columns = self._coefficient_columns()
            print_table(list(columns), zip(*columns.values(), strict=True))
        else:
            say(str(law))
        if law.alternatives:
            say("\nChosen (*) from these candidates; larger ones are left out:\n")
            candidates = readable_candidates(law.alternatives)
            print_frame(candidates)
            if "2 log B" in candidates:
                say(f"\n{BAYES_FACTOR}.")
        if self.compared is not None:
            print_compared(self.compared)
        kind, learned = "held-out trial", ""
        if self.forecast_of == "training":
            later = self.forecast and sum(map(len, self.forecast.trials)) > sum(map(len, training))
            kind, learned = "trial", f" it was learned from{', later samples included' if later else ''}"
        if self.forecast:
            say(
                f"\nForecasts of {counted(len(self.forecast.trials), kind)}{learned}, each from {self._begin}: "
                f"R^2 = {self.forecast.score():.5g}"
            )
        if self.verdict:
            say(f"\n{self.verdict}")

    @property
    def _begin(self) -> str:
        """Where the forecasts start, in words."""
        return "its own initial state" if self.start is None else f"a start fitted to its first {self.start} samples"

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
                "of": self.forecast_of,
                "score": forecast.score(),
                "errors": forecast.errors().to_dict(orient="records"),
            },
            "compared": None if self.compared is None else self.compared.to_dict(orient="records"),
            "verdict": self.verdict
            and asdict(self.verdict) | {"usable": self.verdict.usable, "sentences": self.verdict.sentences},
            "notes": list(self.training.notes),
            "outcomes": [str(outcome) for outcome in (*law.outcomes, *(forecast.outcomes if forecast else ()))],
        }

    def notes(self) -> list[object]:
        """Return what else there is to know."""
        outcomes = self.forecast.outcomes if self.forecast else ()
        return [*self.training.notes, *self.law.outcomes, *self.lacking, *outcomes]

    def _coefficient_columns(self) -> dict[str, list[object]]:
        """Return coefficients, with standard errors where they are known and true ones beside, and forecast errors."""
        law, truth = self.law, self.truth
        columns = {law.schema.object: list[object](law.objects)}
        values, errors = law.letter_values()
        letters = zip(law.named_coefficients, law.letter_units(), values.T, np.nan_to_num(errors.T), strict=True)
        for each, unit, own, deviations in letters:
            head = _with_unit(each.name, unit)
            pairs = zip(own.tolist(), deviations.tolist(), strict=True)
            columns[head] = [(value, error) if error else value for value, error in pairs]
            if truth is not None:
                true = [
                    np.array(
                        [_true_value(truth, name, part.equation, law.terms.names[part.term]) for name in law.objects]
                    )
                    for part in each.parts
                ]
                columns[f"true {each.name}"] = each.value(true).tolist()
        if self.forecast is None:
            return columns
        missed = self.forecast.errors().pivot_table(
            index=law.schema.object, columns="state", values="rms error", aggfunc=lambda each: np.sqrt(np.mean(each**2))
        )
        for state in law.states:
            head = _with_unit(f"rms error of {state}", law.schema.units.get(state))
            columns[head] = missed[state].reindex(law.objects).tolist()
        return columns


def _with_unit(name: str, unit: str | None) -> str:
    return f"{name} ({unit})" if unit else name


def _true_value(truth: "Law", name: str, equation: int, term: str) -> float:
    """Return a true coefficient; zero where the true law has no such term."""
    if term not in truth.terms.names:
        return 0.0
    return float(truth.coefficients_of(name)[equation, truth.terms.index(term)])
