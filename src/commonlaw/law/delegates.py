"""What can be asked of a law, and which room answers.

A law is a value and depends on nothing above it; what follows from it lives with who makes it. These methods find their
rooms by name when they are called, and do nothing else:

============================  =======================
simulate, predict, score      `commonlaw.forecast`
adapt, bounds                 `commonlaw.inference`
residuals, discrepancy        `commonlaw.discrepancy`
simplify                      `commonlaw.law.simplifying`
verdict                       `commonlaw.verdict`
report                        `commonlaw.report`
============================  =======================
"""

from collections.abc import Mapping, Sequence
from pkgutil import resolve_name
from typing import TYPE_CHECKING, Any, Literal, Self, cast

from numpy.typing import ArrayLike

from commonlaw.integration import Event, Trajectory, VectorField
from commonlaw.law.averages import AbstractAverages
from commonlaw.law.forecast import Forecast
from commonlaw.law.page import Page
from commonlaw.law.simplification import Simplification
from commonlaw.likelihood import HUBER_THRESHOLD
from commonlaw.trials import Trials, TrialStream

if TYPE_CHECKING:
    import pandas as pd
    from distributed import Client

    from commonlaw.discrepancy.function import Discrepancy
    from commonlaw.discrepancy.residual_tests import Residuals
    from commonlaw.inference.diagnose.coefficient_limits import Bounds
    from commonlaw.verdict.law_verdict import LawVerdict


class AbstractDelegates(AbstractAverages):
    """What other rooms answer of a law."""

    def vector_field(self, name: str) -> VectorField:
        """Return the right-hand side for one object, ready to integrate, see `VectorField`.

        Raises
        ------
        CommonlawError
            If the law has no such object.
        """
        free = self.support if self.shared else None
        return VectorField(self.terms, self.coefficients_of(name), self.order, free=free)

    def simulate(
        self,
        times: ArrayLike,
        initial: "ArrayLike | Mapping[str, ArrayLike]",
        *,
        method: str = "auto",
        tolerance: float = 1e-8,
        events: Sequence[Event] = (),
        dense: bool = False,
        sensitivities: bool = False,
        doses: Mapping[str, Mapping[float, float]] | None = None,
    ) -> dict[str, Trajectory]:
        """Integrate the law for every object; a divergence is an outcome of its trajectory.

        Parameters
        ----------
        times
            When the states are wanted; the first is the time of the initial state. Shape (n,).
        initial
            Initial states, followed by the initial rates of those of second order: one vector for all objects, or one
            by name of object; objects that are not named are left out.
        method, tolerance, events, dense
            How to integrate and what to look for, see `commonlaw.integration.simulate`.
        sensitivities
            Whether to give the derivatives of states by coefficients in the support, row by row, and by initial states.
        doses
            Amounts by their times, of a law whose inputs are doses: ``{"dose": {3.0: 60.0}}``.

        Raises
        ------
        CommonlawError
            If the law has other inputs, lacks an object, or has not as many states as an initial state.
        """
        how = {"method": method, "tolerance": tolerance, "events": events, "dense": dense, "doses": doses}
        simulate = resolve_name("commonlaw.forecast:simulate_law")
        found: dict[str, Trajectory] = simulate(self, times, initial, sensitivities=sensitivities, **how)
        return found

    def predict(
        self,
        trials: Trials,
        *,
        times: ArrayLike | None = None,
        start: int | Literal["all"] | None = None,
        from_time: float | None = None,
        return_std: bool = False,
        method: str = "auto",
        tolerance: float = 1e-8,
        seed: int = 0,
        input_between: str | None = None,
        discrepancy: bool = False,
        averaged: bool = True,
    ) -> Forecast:
        """Forecast each trial from its own initial state.

        Parameters
        ----------
        trials
            What to forecast, at all samples, measured or not. Objects that the law, if it has several, does not know
            have the coefficients that follow from their properties, if `Law.explain` found how, else the mean ones of
            the others; the bands carry how far objects stray from that.
        times
            More times to forecast at after a trial's first sample, shape (m,). Inputs keep their last value.
        start
            How many of each trial's first measured samples tell where its forecast starts. 1: the first states as
            measured, and the rates of those of second order that the law's differentiation estimates there. 2 or more:
            the law, with its coefficients as they are, is fitted to so many samples by likelihood, which needs its
            noise; states may be missing. More samples leave less noise in the start, and make it matter more that the
            law is right. ``"all"``: the initial conditions are fitted to the whole trial, so that the trajectories are
            the fit of the law and no forecasts; noise that the law does not know is estimated from differences of
            samples. Default: 1, but if the noise is known all that were measured where others follow, those that first
            rates would be estimated from, or as many as tell what the first sample lacks.
        from_time
            When the forecasts begin: what was measured before tells the initial state, all of it, or the last `start`
            samples, and everything from then on is forecast. Trials without samples on both sides are left out, which
            `Forecast.trials.notes` says. Without the noise of the law its last sample counts as measured, or for a law
            of second order the first of five.
        return_std
            Whether `Forecast.interval` is to say how far off the forecasts may be. To first order the covariance of the
            coefficients and that of the initial state, which the noise of the trial's first samples makes uncertain,
            are carried along each trajectory; that noise and the errors of the coefficients count as independent, also
            where the law was learned from these samples.
        method, tolerance
            How to integrate, and the relative error of a step; see `commonlaw.integration.simulate`.
        seed
            Of the noise that shows how accurate the rates are that a differentiation estimates at the start.
        input_between
            The interpolation of inputs between samples: ``"held"`` at the earlier value, as a controller does,
            ``"linear"`` or ``"cubic"`` (a spline, for smooth inputs). Default: as the law was learned.
        discrepancy
            Whether to forecast with the discrepancy that was found beside the law, see `discrepancy`.
        averaged
            Whether forecasts are averaged over what the law could be, see `plausible`: each is the median of what
            these laws say, weighted by their probabilities, and its interval is that of the mixture. Else they are
            those of this law.

        Raises
        ------
        CommonlawError
            If a trial's object is not the only one of the law, its variables are not those of the law, standard
            deviations are asked for and the law's covariance or noise is not known, a start cannot be fitted, or the
            law carries no discrepancy.
        """
        predict = resolve_name("commonlaw.forecast:predict")
        options = {"start": start, "from_time": from_time, "return_std": return_std, "input_between": input_between}
        how = {"method": method, "tolerance": tolerance, "seed": seed, "discrepancy": discrepancy, "averaged": averaged}
        forecast: Forecast = predict(self, trials, times=times, **options, **how)
        return forecast

    def adapt(self, trials: Trials) -> Self:
        """Return the law of the objects of new trials, with coefficients that these trials have updated.

        Before, an object has the coefficients that `predict` would take: its own if the law knows it, else those that
        follow from its properties or are typical, with how far objects stray. That is a normal distribution; the
        likelihood of the trials, whose initial states are free, updates it, so that few samples change what is not
        known well, and no more. Trials that the law was learned from would count twice.

        Parameters
        ----------
        trials
            New trials, of few samples or many.

        Raises
        ------
        CommonlawError
            If the law does not know its noise or how accurate its coefficients are, has errors other than white
            noise or is of discrete time; or if the trials cannot be used.

        Examples
        --------
        >>> import commonlaw as cl
        >>> drops = cl.datasets.linear_drag(noise=0.05)
        >>> law = cl.fit("x'' = -g - c v", drops.select(object=drops.objects[:4])).explain([])
        >>> print(law.adapt(drops.select(object="Ball 5", trial=1).until(2.0)))
        x'' = -9.856 ± 0.046 - (0.714 ± 0.011) v
        <BLANKLINE>
        with v = x', g [m/s²] = 9.856 ± 0.046, c [1/s] = 0.714 ± 0.011
        """
        return cast(Self, resolve_name("commonlaw.inference:adapt")(self, trials))

    def bounds(self, trials: Trials, terms: Sequence[str] | None = None, *, level: float = 0.95) -> "Bounds":
        """Say how large coefficients of absent terms, by default all of the library, could be unseen: see `Bounds`.

        Raises
        ------
        CommonlawError
            If there are more than 30 such terms, or one is named that is in the law or cannot be read.
        """
        return cast("Bounds", resolve_name("commonlaw.inference:bounds")(self, trials, terms, level=level))

    def discrepancy(
        self,
        trials: Trials,
        of: str | None = None,
        *,
        times: str = "1",
        equation: str | None = None,
        zero_at: float | Literal["auto"] | None = "auto",
        noise: Mapping[str, float] | None = None,
        huber_threshold: float = HUBER_THRESHOLD,
    ) -> "Discrepancy[Self]":
        """Find what the law leaves unexplained as a smooth function of a coordinate, the same for all objects.

        The function is a Gaussian process in the likelihood of the trajectories, fitted together with the law's
        coefficients and all initial states; its amplitude and its smoothness are integrated out. Where measurements
        depart from law and function trial by trial, and evidence says so, that is a model error (a random walk).

        A function could take over what the law's terms say. So that coefficients keep their meaning, it is zero where
        the coordinate is zero, if that was visited or nearly: a drag vanishes at rest, and the constant of the law is
        gravity. Of other terms that a function of the coordinate could say as well it holds nothing: it is orthogonal
        to them over the visited samples, as it is to all such terms where no zero was visited, and of time. Terms that
        no function of the coordinate can say need no such rule.

        Parameters
        ----------
        trials
            Of objects of the law.
        of
            The coordinate: a state, its rate, an input, time, or an expression of these and of the objects' properties
            such as ``abs(v)*diameter/1.5e-5``. Default: the variable of largest evidence, which pays for the choice.
        times
            What the function is multiplied with, a term such as ``v*abs(v)*diameter^2/mass``: the function of the
            Reynolds number is then a drag coefficient but for a constant.
        equation
            The state in whose equation the function stands. Default: that of largest evidence among those with
            coefficients to be found.
        zero_at
            Where the function is zero, instead of the rule above; None for nowhere.
        noise, huber_threshold
            See `commonlaw.refine`.

        Raises
        ------
        CommonlawError
            If the law is of discrete time, its objects do not share their terms, or a coordinate cannot be read, is
            not finite or does not change; the message says which.

        Examples
        --------
        >>> import commonlaw as cl
        >>> drops = cl.datasets.linear_drag(noise=0.05, quadratic=-0.02)
        >>> found = cl.fit("x'' = -g - c v", drops).discrepancy(drops, of="v")
        >>> found.claimed
        True
        """
        options: dict[str, Any] = {"times": times, "equation": equation, "zero_at": zero_at}
        find = resolve_name("commonlaw.discrepancy:discrepancy")
        found: Discrepancy[Self] = find(self, trials, of, noise=noise, huber_threshold=huber_threshold, **options)
        return found

    def domain(self) -> "pd.DataFrame":
        """Return a table of where the law may be used: the ranges of what it was learned from, with their units.

        Rates are those of smooth curves through the samples. Forecasts that leave a range by more than a tenth of it
        say so, in ``Forecast.trials.notes``.

        Examples
        --------
        >>> import commonlaw as cl
        >>> law = cl.fit("x'' = -g - c v", cl.datasets.linear_drag(noise=0.0))
        >>> print(law.domain().round(1).drop(columns="unit").to_string(index=False))
        variable   low  high
               x   2.1  47.3
               v -26.7  -0.2
            drag  -0.7  -0.1
        """
        import pandas as pd

        units = self.schema.units
        rows = [(name, *ends, units.get(name, "")) for name, ends in self.provenance.domain.visited.items()]
        return pd.DataFrame(rows, columns=["variable", "low", "high", "unit"])

    def residuals(self, trials: Trials) -> "Residuals":
        """Say how well the law fits trials: what measurements are off its trajectories, and which patterns that has.

        Each trial's initial state is fitted to all of its samples; the coefficients stay as they are. Tests compare the
        residuals with the noise, hold them against time, states, rates, inputs and each other, and look for memory, for
        scatter that grows, and for errors that are not normal (Ljung and Box, Spearman, Shapiro and Wilk, F tests).
        P-values are adjusted for their number (Benjamini and Yekutieli 2001).

        Parameters
        ----------
        trials
            Of objects of the law, or of others that `predict` takes.

        Raises
        ------
        CommonlawError
            If the law is of discrete time, or the trials cannot be used.

        Examples
        --------
        >>> import commonlaw as cl
        >>> drops = cl.datasets.linear_drag(noise=0.05)
        >>> print(cl.fit("x'' = -g - c v", drops).residuals(drops))
        The residuals look like white noise: no pattern is significant.
        """
        return cast("Residuals", resolve_name("commonlaw.discrepancy:residuals")(self, trials))

    def score(self, trials: Trials, start: int | Literal["all"] | None = None) -> float:
        """Return the R^2 of the forecasts of these trials, see `Forecast.score`; for the start see `predict`."""
        return self.predict(trials, start=start).score()

    def verdict(self, trials: Trials, learned: Trials | None = None) -> "LawVerdict":
        """Say what the law is good for: how well and how far it forecasts, whether its bands hold, what is uncertain.

        Trials are forecast over all that follows their first samples, so that growth is judged while it grows, and
        compared with persistence, the states as they were last measured. Each forecast starts where the law, fitted
        to the samples before, says; the coefficients stay as they are.

        Parameters
        ----------
        trials
            What was measured.
        learned
            What of it the law was learned from, such as ``trials.until(70)`` or ``trials.select(trial=1)``: judged on
            are held-out trials, and later samples, these from the last that was learned too; objects that the law does
            not know have the mean coefficients of the others. Without it, or if nothing was held out, judged on are all
            trials, which the verdict says.

        Examples
        --------
        >>> import commonlaw as cl
        >>> drops = cl.datasets.linear_drag(noise=0.05)
        >>> law = cl.fit("x'' = -g - c v", drops.select(trial=1))
        >>> print(law.verdict(drops, drops.select(trial=1)).sentences[0])
        This law can be used for forecasts up to 2.6 s ahead (longest horizon tested).
        """
        return cast("LawVerdict", resolve_name("commonlaw.verdict:judge")(self, trials, learned))

    def report(
        self, trials: Trials | TrialStream, learned: Trials | TrialStream | None = None, client: "Client | None" = None
    ) -> Page:
        """Return the page of `commonlaw report` on the law: to be saved, or looked at in a notebook.

        Parameters
        ----------
        trials
            What was measured. All of a stream is forecast, and the page shows few objects that stand for all.
        learned
            What of it, or of others, the law was learned from, see `verdict`: ``law.report(*stream.split(trial=3))``.
        client
            A dask client, whose workers go through a stream.

        Raises
        ------
        CommonlawError
            If the law and the trials do not go together, or one of the others does not go with them.

        Examples
        --------
        >>> import commonlaw as cl
        >>> drops = cl.datasets.linear_drag(noise=0.05, trials=1)
        >>> cl.fit("x'' = -g - c v", drops).report(drops).html[:15]
        '<!DOCTYPE html>'
        """
        return cast(Page, resolve_name("commonlaw.report:law_page")(self, trials, learned, client))

    def simplify(self, tolerance: float = 2.0) -> Simplification[Self]:
        """Return the law in its simplest form: numbers that are nearly zero, one, a ratio, or each other replaced.

        A number is replaced by zero, a ratio of small whole numbers, or another number of the law or its opposite,
        where that is shorter to write than its digits that are known (minimum description length; Rissanen 1983):
        0.667 ± 0.001 becomes 2/3, and 0.67 ± 0.05 stays. The numbers that remain follow by the covariance. Numbers with
        units become zero or each other, as what else they are depends on units. Equations are in the shortest form
        among equivalent ones; where a part of a fraction vanishes within its error, a number goes: of ``a + b/(K + s)``
        with b near ``-K a`` remains ``a s/(K + s)``. What several objects have is replaced for all of them, and what
        `explain` said of them does not enter.

        Parameters
        ----------
        tolerance
            Standard errors that the mean over objects may be off. All replacements together may be as improbable, of
            the mean and of all objects, by chi-square tests. With two, one in twenty numbers that are simple stays.

        Raises
        ------
        CommonlawError
            If the law does not know how accurate its coefficients are, objects have terms of their own, or SymPy is
            not installed.

        Examples
        --------
        >>> import commonlaw as cl
        >>> drops = cl.datasets.linear_drag(drag=(-0.1, -0.2), noise=0.001)
        >>> print(cl.fit("x'' = -g - c v + b v^2", drops).simplify().equations[0])
        x'' = -(c*v + g)
        """
        return cast(Simplification[Self], resolve_name("commonlaw.law.simplifying:simplified")(self, tolerance))
