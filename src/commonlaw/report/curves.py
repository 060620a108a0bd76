"""The parts of a law's report with measurements and curves: the fit, and forecasts from first samples."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np
import pandas as pd

from commonlaw.forecast import Forecast
from commonlaw.law.tables import with_unit
from commonlaw.plots import ForecastPanels, plot_errors, plot_forecast
from commonlaw.plots.forecast import omission, relative_errors, representative
from commonlaw.report.document import Block, Fold, Gallery, Picture, Section, Table, Text
from commonlaw.report.law_sections import LawCase, folded, listed
from commonlaw.report.markup import literal
from commonlaw.text import counted, r_squared


def fit(case: LawCase) -> Section:
    """Return the part on trials as measured, with solutions of the law through them."""
    title, fit = "Fit", case.findings.fit
    if fit is None:
        why = (
            "a law in discrete time has forecasts only, see below" if case.law.order == 0 else "see the forecasts below"
        )
        return Section("fit", title, (Text(f"No fitted curves: {why}."),))
    training = "of the training data" if case.law.provenance.is_learned else "compared with it"
    diverged = f" {len(fit.outcomes)} of them diverge." if fit.outcomes else ""
    intro = (
        f"Fit of {counted(len(fit.trials), 'trial')} {training}, initial conditions estimated from all samples: "
        f"{_score(fit)} (1: perfect; 0: the mean of each trial).{diverged} Points: measurements. Lines: fit. Below: "
        f"residuals, measured minus fitted."
        f"{_legend(fit)}"
    )
    return Section("fit", title, (Text(intro), *Curves(fit, "fit").blocks()))


def forecasts(case: LawCase) -> Section:
    """Return the part on trials as measured, with forecasts from their first samples."""
    title, forecast = "Forecasts from the first samples", case.forecast
    if forecast is None:
        return Section("forecasts", title, (Text(listed([case.said(each) for each in case.findings.lacking])),))
    diverged = f" {len(forecast.outcomes)} of the forecasts diverge." if forecast.outcomes else ""
    begin = forecast.title.removeprefix("forecast ")
    intro = (
        f"Forecasts of {counted(len(forecast.trials), 'trial')} {case.forecast_of}, {begin}: {_score(forecast)}."
        f"{diverged} Below: errors, forecast minus measured.{_legend(forecast)}"
    )
    return Section("forecasts", title, (Text(intro), *Curves(forecast, "forecast").blocks()))


def _score(forecast: Forecast) -> str:
    score = forecast.score()
    return f"${r_squared(score)}$" if np.isfinite(score) else r"$R^2 = -\infty$"


def _legend(forecast: Forecast) -> str:
    bands = " Bands: 95 % of the measurements expected." if forecast.std is not None else ""
    several = len(forecast.trials) > len(forecast.trials.objects)
    return f"{bands}{' Colours: trials of an object.' if several else ''}"


@dataclass(frozen=True, eq=False)
class Curves:
    """Curves of a fit or a forecast, and their errors; `kind` begins the names of figures and tables."""

    forecast: Forecast
    kind: str

    def blocks(self) -> Iterator[Block]:
        """Yield figures of objects, tables of what the curves are off, and a figure of all that."""
        yield from self._objects()
        word = "Residuals of the fit" if self.forecast.is_fit else "Errors of the forecasts"
        yield Table(f"{self.kind}-by-state", f"{word} by state.", self._by_state().dropna(axis=1, how="all"), 3)
        errors = self.errors if self.forecast.outcomes else self.errors.drop(columns="diverged after")
        units, what = self.forecast.trials.schema.units, "residual" if self.forecast.is_fit else "error"
        errors = errors.assign(state=[with_unit(state, units.get(state)) for state in errors["state"]])
        errors.columns = [name.replace("rms", "RMS").replace("error", what) for name in map(str, errors)]
        yield folded(Table(f"{self.kind}-errors", f"{word} by trial.", errors, 3), f"{word} by trial")
        yield Fold(
            f"{word} of all trials", (Picture(f"{self.kind}-all", f"{word}.", partial(plot_errors, self.forecast)),)
        )

    @cached_property
    def errors(self) -> pd.DataFrame:
        """Errors of each trial, see `Forecast.errors`."""
        return self.forecast.errors()

    @cached_property
    def relative(self) -> "pd.Series[float]":
        """RMS errors of each object, the smallest first, see `relative_errors`."""
        return relative_errors(self.forecast)

    @cached_property
    def _rms(self) -> pd.DataFrame:
        """Root mean square errors, a row for each object and a column for each state."""
        schema = self.forecast.trials.schema
        squared = (self.errors["rms error"] ** 2).groupby([self.errors[schema.object], self.errors["state"]]).mean()
        return squared.pow(0.5).unstack("state").reindex(columns=list(schema.states))

    def in_words(self, name: str) -> str:
        """Return the root mean square error of an object, in the states' units, in words."""
        schema, rms = self.forecast.trials.schema, self._rms.loc[name]
        if np.isinf(rms).any():
            return "diverges"
        said = [
            f"{value:.2g} {schema.units.get(state, '')}".rstrip() + f" ({state})" * (len(rms) > 1)
            for state, value in zip(schema.states, rms, strict=True)
            if np.isfinite(value)
        ]
        return " and ".join(said) or "not measured"

    def _by_state(self) -> pd.DataFrame:
        frame, rows, schema = self.forecast.to_frame(), [], self.forecast.trials.schema
        what, sign = ("residual", -1.0) if self.forecast.is_fit else ("error", 1.0)
        for state in schema.states:
            errors = sign * frame[f"{state} error"].to_numpy(dtype=np.float64)
            seen = errors[np.isfinite(errors)]
            row: dict[str, object] = {
                "state": state,
                "unit": schema.units.get(state),
                "measurements": len(seen),
                f"mean {what}": None,
                f"RMS {what}": None,
            }
            if len(seen):
                mean, rms = float(np.mean(seen)), float(np.sqrt(np.mean(seen**2)))
                row |= {f"mean {what}": mean if abs(mean) > 1e-3 * rms else 0.0, f"RMS {what}": rms}
            if f"{state} measured low" in frame and len(seen):
                low, high = frame[f"{state} measured low"], frame[f"{state} measured high"]
                inside = ((low <= frame[state]) & (frame[state] <= high))[np.isfinite(errors)]
                row["within 95 % band"] = f"{100 * inside.mean():.0f} %"
            rows.append(row)
        return pd.DataFrame(rows)

    def _objects(self) -> Iterator[Block]:
        """Yield one figure of all objects, or of many those evenly spaced by rank, and the others folded."""
        ranked, shown = [str(name) for name in self.relative.index], representative(self.forecast)
        omitted = omission(self.forecast, shown)
        caption = f"{omitted}. {self._ends(ranked)}" if omitted else self._ends(ranked)
        yield Picture(f"{self.kind}-objects", f"{caption}.", partial(plot_forecast, self.forecast))
        others = [name for name in ranked if name not in shown]
        if others:
            yield Fold(f"The other {counted(len(others), 'object')}", tuple(self._others(others, len(shown))))

    def _ends(self, ranked: Sequence[str]) -> str:
        """Return the errors of the first and the last of some objects as Markdown."""
        ends = (
            f"**{literal(name)}** {literal(self.in_words(name))}" for name in dict.fromkeys((ranked[0], ranked[-1]))
        )
        what = "RMS residual" if self.forecast.is_fit else "RMS error"
        return f"{what}: {' to '.join(ends)}".replace(r"\.", ".")

    def _others(self, ranked: Sequence[str], size: int) -> Iterator[Block]:
        """Yield figures of some objects, so many in each; of very many few lines of each."""
        few = len(ranked) <= 50
        draw = partial(plot_forecast, self.forecast) if few else ForecastPanels(self.forecast).overview
        size = size if few else 36
        parts = [ranked[i : i + size] for i in range(0, len(ranked), size)]
        pictures = tuple(
            Picture(f"{self.kind}-{i + 1}", f"{self._ends(part)}.", partial(draw, part)) for i, part in enumerate(parts)
        )
        yield from pictures if few else (Gallery(pictures),)
