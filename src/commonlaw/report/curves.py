"""The parts of a law's report with measurements and curves: the fit, and forecasts from first samples."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np
import pandas as pd

from commonlaw.forecast import Forecast
from commonlaw.plots import ForecastPanels, plot_errors
from commonlaw.report.document import Block, Fold, Gallery, Picture, Section, Table, Text
from commonlaw.report.law_sections import LawCase, folded, listed
from commonlaw.report.markup import literal
from commonlaw.text import counted, r_squared

_EACH, _ALL = 3, 12
"""Of best, typical and worst objects so many are shown each; all of them if there are no more than that."""

_NEGLIGIBLE = 1e-3
"""Mean residuals, relative to the RMS residual, below which they are zero."""

_DRAWN, _IN_OVERVIEW = 50, 36
"""Of the others up to so many have a figure each; of more, so many together have one."""


def fit(case: LawCase) -> Section:
    """Return the part on trials as measured, with solutions of the law through them."""
    title, fit = "Fit", case.findings.fit
    if fit is None:
        why = (
            "a law in discrete time has forecasts only, see below" if case.law.order == 0 else "see the forecasts below"
        )
        return Section("fit", title, (Text(f"No fitted curves: {why}."),))
    diverged = f" {len(fit.outcomes)} of them diverge." if fit.outcomes else ""
    intro = (
        f"Fit of {counted(len(fit.trials), 'trial')} {_training(case)}, initial conditions estimated from all samples: "
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


def _training(case: LawCase) -> str:
    return "of the training data" if case.law.provenance.is_learned else "compared with it"


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
        yield from self._gallery()
        word = "Residuals of the fit" if self.forecast.is_fit else "Errors of the forecasts"
        yield Table(f"{self.kind}-by-state", f"{word} by state.", self._by_state().dropna(axis=1, how="all"))
        errors = self.errors if self.forecast.outcomes else self.errors.drop(columns="diverged after")
        caption = f"{word}, in the unit of the state."
        yield folded(Table(f"{self.kind}-errors", caption, errors), f"{word}, trial by trial")
        yield Fold(
            f"{word} of all trials", (Picture(f"{self.kind}-all", f"{word}.", partial(plot_errors, self.forecast)),)
        )

    @cached_property
    def errors(self) -> pd.DataFrame:
        """Errors of each trial, see `Forecast.errors`."""
        return self.forecast.errors()

    @cached_property
    def relative(self) -> pd.Series:
        """Root mean square errors of each object, in units of the states' spread, the best first."""
        states = np.concatenate([trial.states for trial in self.forecast.trials])
        spread = pd.Series(np.nanstd(states, axis=0), self.forecast.trials.schema.states).replace(0.0, np.nan)
        squared = (self.errors["rms error"] / self.errors["state"].map(spread)) ** 2
        relative: pd.Series = squared.groupby(self.errors[self._object], sort=False).mean().pow(0.5)
        return relative.sort_values(kind="stable")

    @property
    def _object(self) -> str:
        return self.forecast.trials.schema.object

    @cached_property
    def _rms(self) -> pd.DataFrame:
        """Root mean square errors, a row for each object and a column for each state."""
        squared = (self.errors["rms error"] ** 2).groupby([self.errors[self._object], self.errors["state"]]).mean()
        return squared.pow(0.5).unstack("state").reindex(columns=list(self.forecast.trials.schema.states))

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
        what = "RMS residual" if self.forecast.is_fit else "RMS error"
        return f"{what} {' and '.join(said)}" if said else "not measured"

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
                row |= {f"mean {what}": mean if abs(mean) > _NEGLIGIBLE * rms else 0.0, f"RMS {what}": rms}
            if f"{state} measured low" in frame and len(seen):
                low, high = frame[f"{state} measured low"], frame[f"{state} measured high"]
                inside = ((low <= frame[state]) & (frame[state] <= high))[np.isfinite(errors)]
                row["within 95 % band"] = f"{100 * inside.mean():.0f} %"
            rows.append(row)
        return pd.DataFrame(rows)

    def _gallery(self) -> Iterator[Block]:
        """Yield small pictures of the best, typical and worst objects, and the rest of them folded."""
        panels, names = ForecastPanels(self.forecast), [str(name) for name in self.relative.index]
        objects = self.forecast.trials.objects
        indices = {name: i for i, name in enumerate(objects)}

        def picture(name: str, rank: str = "") -> Picture:
            off = literal(self.in_words(name)).replace(r"\.", ".")
            caption = f"**{literal(name)}**{rank}: {off}"
            return Picture(f"{self.kind}-{indices[name] + 1}", caption, partial(panels.draw, name))

        if len(names) <= _ALL:
            yield Gallery(tuple(picture(name) for name in objects))
            return
        middle = (len(names) - _EACH) // 2
        chosen = {"best": names[:_EACH], "typical": names[middle : middle + _EACH], "worst": names[-_EACH:]}
        shown = [(name, rank) for rank, own in chosen.items() for name in own]
        yield Gallery(tuple(picture(name, f" ({rank})") for name, rank in shown))
        rest = [name for name in objects if name not in {name for name, _ in shown}]
        others = Gallery(tuple(map(picture, rest))) if len(rest) <= _DRAWN else self._overviews(panels, rest)
        yield Fold(f"The other {counted(len(rest), 'object')}", (others,))

    def _overviews(self, panels: ForecastPanels, names: Sequence[str]) -> Gallery:
        """Return the curves of very many objects, few lines of each, the best first."""
        names = [name for name in self.relative.index.astype(str) if name in set(names)]
        parts = [names[i : i + _IN_OVERVIEW] for i in range(0, len(names), _IN_OVERVIEW)]
        pictures = [
            Picture(
                f"{self.kind}s-{i + 1}",
                f"From {literal(', to '.join(f'{name}, {self.in_words(name)}' for name in (part[0], part[-1])))}.",
                partial(panels.overview, part),
            )
            for i, part in enumerate(parts)
        ]
        return Gallery(tuple(pictures))
