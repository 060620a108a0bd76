"""From trials to a law: the estimator, and the function that most people call."""

import inspect
from collections.abc import Iterator, Mapping, Sequence, Sized
from dataclasses import fields, is_dataclass, replace
from functools import partial
from math import isfinite
from typing import TYPE_CHECKING, Any, Self

import numpy as np

from commonlaw.diagnostics import Diagnostic, Outcome, note
from commonlaw.discovery.cache import cached_law, is_kept
from commonlaw.discovery.hints import (
    outcomes_of_confounding,
    outcomes_of_generations,
    outcomes_of_inputs,
    outcomes_of_rivals,
    outcomes_of_separate_states,
    outcomes_of_units,
)
from commonlaw.discovery.known_physics import Base, order_of_base, with_base
from commonlaw.discovery.measured_rates import GivenDerivatives, with_derivatives
from commonlaw.discovery.method import (
    AbstractMethod,
    Key,
    Known,
    ModelStructure,
    of_each_equation,
    with_properties_in,
)
from commonlaw.discovery.observed import discover_observed
from commonlaw.discovery.orders import AskedOrder, order_by_state, possible_orders, single_orders
from commonlaw.discovery.regression import DerivativeRegression, DiscreteTimeRegression
from commonlaw.discovery.textbook import outcomes_of_textbook
from commonlaw.discovery.trajectory_likelihood import TrajectoryLikelihood, stopped
from commonlaw.errors import CommonlawError, check_choice
from commonlaw.estimation.profile import with_one_sided_limits
from commonlaw.formulation import TrialDerivatives, refuse_vanishing_states
from commonlaw.inference.data.subsampling import can_be_subsampled
from commonlaw.inference.diagnose.scale_origin import with_origin_outcomes
from commonlaw.law import Law, Step
from commonlaw.law.alignment import matched
from commonlaw.law.observation import STATES
from commonlaw.law.parameters import state_rates
from commonlaw.law.provenance import Domain
from commonlaw.law.script import call, is_same, recorded_arguments
from commonlaw.library import AbstractLibrary, CappedLibrary, Order, one_order, order_of_each, parse_library
from commonlaw.library.libraries import LibraryGiven
from commonlaw.runtime.arguments import check_type, check_types
from commonlaw.runtime.checkpoint import is_replay
from commonlaw.runtime.digest import digest
from commonlaw.runtime.fit_options import changed_settings
from commonlaw.runtime.parallel import one_blas_thread
from commonlaw.runtime.progress import ProgressCallback, on_terminal
from commonlaw.runtime.time_limit import OutOfTimeError, limit_of, limited
from commonlaw.text import shown
from commonlaw.trials import Schema, Trials, TrialStream
from commonlaw.trials.check import exact_copies
from commonlaw.trials.stream import in_memory_or_by_file, measured
from commonlaw.trials.transformations import (
    objects_at_rest,
    outcome_of_constants,
    outcome_of_rest,
    refuse_amounts,
    refuse_standing_time,
    states_at_rest,
    with_zeros_before_doses,
    without_objects,
    without_states,
)
from commonlaw.trials.trial import check_gaps

if TYPE_CHECKING:
    from distributed import Client
    from sklearn.utils import Tags

    from commonlaw.forecast import Forecast


class LawDiscovery:
    """Estimator of scikit-learn for `discover`.

    Parameters
    ----------
    order, library, method, known, shared, latent_states, observe, progress, cache, client, time_limit
        See `discover`.

    Attributes
    ----------
    law_
        The discovered law.

    Examples
    --------
    >>> from commonlaw import DerivativeRegression, LawDiscovery, datasets
    >>> from commonlaw.law import average_law
    >>> drops = datasets.linear_drag(noise=0.0)
    >>> method = DerivativeRegression(differentiation="finite:6", solver="group-stlsq:1")
    >>> model = LawDiscovery(order=2, library="poly:1", method=method).fit(drops)
    >>> average_law(model.set_params(method__solver__threshold=0.5).fit(drops).law_).equations()
    ("x'' = -9.8 - 0.38 v",)
    """

    law_: Law

    def __init__(
        self,
        order: AskedOrder = "auto",
        library: LibraryGiven | Mapping[str, LibraryGiven] = "auto",
        method: AbstractMethod | None = None,
        known: Base | None = None,
        shared: Sequence[Key] = (),
        latent_states: int | str | Sequence[str] = 0,
        observe: Mapping[str, str] | None = None,
        progress: ProgressCallback | None = None,
        cache: bool = True,
        client: "Client | None" = None,
        time_limit: float | None = None,
    ) -> None:
        self.order = order
        self.library = library
        self.method = method
        self.known = known
        self.shared = shared
        self.latent_states = latent_states
        self.observe = observe
        self.progress = progress
        self.cache = cache
        self.client = client
        self.time_limit = time_limit

    def fit(self, trials: Trials | TrialStream | Any, y: GivenDerivatives | None = None) -> Self:
        """Find the law of these trials, or of those that `Trials.from_frame` makes of a table.

        A stream is gone through once. Derivatives y may be given, see `x_dot` of `discover`.

        Raises `CommonlawError` if the trials cannot be used as they are, or do not go with the method; the message
        names the object and trial and says what to do.
        """
        trials = measured(trials)
        asked = vars(self)
        if isinstance(self.known, Mapping):  # Its coefficients are checked with their terms
            asked = asked | {"known": None}
        check_types(LawDiscovery, asked)
        progress = self.progress or on_terminal()

        def in_memory(trials: Trials) -> Law:
            check_gaps(tuple(trials), trials.schema)
            refuse_standing_time(trials)
            refuse_amounts(trials)
            if y is not None or not self.cache:
                return self._found(trials, progress, y)
            can_stop = limit_of(self.time_limit) is not None
            law = cached_law(trials, self._question, lambda: self._found(trials, progress), progress, can_stop=can_stop)
            if not law.provenance.is_stopped:
                return law
            return replace(law, provenance=replace(law.provenance, searched=digest(trials)))

        if self.time_limit is not None and not (self.time_limit >= 0 and isfinite(self.time_limit)):
            raise CommonlawError("time-limit", value=self.time_limit)
        if self.time_limit is not None and not isinstance(self.method, TrajectoryLikelihood | None):
            raise CommonlawError("time-limit-unsupported", what=type(self.method).__name__)
        by_file = partial(self._found_by_file, progress=progress, given=y)
        self.law_ = in_memory_or_by_file(trials, self.client, in_memory, by_file)
        return self

    @property
    def _question(self) -> dict[str, object]:
        """What the law depends on besides the trials; of what is empty, whatever its kind, nothing."""
        values = {name: getattr(self, name) for name in _PARAMETERS if name not in _CHANGING_NOTHING}
        return {name: None if isinstance(value, Sized) and not len(value) else value for name, value in values.items()}

    def _check_resumable(self, law: Law, trials: Trials | TrialStream) -> None:
        """Check that the search with these parameters that was stopped with a law can go on.

        Raises `CommonlawError` if it had other trials, or the cache has neither its steps nor the complete law.
        """
        before = law.provenance.searched
        if before and not (isinstance(trials, Trials) and digest(trials) == before):
            raise CommonlawError("resume-with-other-trials")
        if not (before and self.cache and isinstance(trials, Trials) and is_kept(trials, self._question)):
            raise CommonlawError("resume-without-steps")

    def _observed(self, trials: Trials, progress: ProgressCallback, derivatives: GivenDerivatives | None) -> Law:
        given = self.get_params(deep=False)
        refused = ["shared"] * bool(self.shared)
        refused += ["latent_states"] * (bool(self.latent_states) and not self._latent_names)
        refused += ["x_dot"] * (derivatives is not None)
        refused += ["time_limit"] * (self.time_limit is not None)
        settings = dict[str, Any]()
        if isinstance(self.method, TrajectoryLikelihood):
            settings = changed_settings("discover", vars(self.method))
        refused += ["method"] * (self.method is not None and not isinstance(self.method, TrajectoryLikelihood))
        refused += [name for name in settings if name not in ("noise", "seed", "n_jobs")]
        refused += ["library"] * isinstance(self.library, Mapping)
        if self.order not in ("auto", 1):
            raise CommonlawError("observed-order", order=self.order)
        if refused or isinstance(self.library, Mapping):
            raise CommonlawError("not-with-observation", settings=refused)
        library = parse_library(self.library)
        if library.functions:
            raise CommonlawError("function-with-observation", function=library.functions[0].text)
        trials = with_properties_in([library], trials)
        is_text = isinstance(self.known, Mapping | str | None)  # Laws and functions are none
        with one_blas_thread():
            return discover_observed(
                trials,
                self.observe or {},
                self._latent_names,
                None if self.library == "auto" else library,
                self.known or {},
                noise=settings.get("noise"),
                seed=settings.get("seed", 0),
                progress=progress,
                calls=(call(LawDiscovery, given, "cl.discover", "trials"),) if is_text else (),
            )

    def _found_by_file(self, stream: TrialStream, progress: ProgressCallback, given: GivenDerivatives | None) -> Law:
        if self.observe or self._latent_names:
            raise CommonlawError("not-for-streams")
        if given is not None:
            raise CommonlawError("derivatives-of-stream")
        if self.time_limit is not None:
            raise CommonlawError("time-limit-unsupported", what="a stream")
        (method, outcomes), order = self._method_for(None, None), self.order
        if order == "auto":
            is_open = not isinstance(self.library, Mapping)
            order = 0 if is_open and method.orders == (0,) else 1
            if is_open and order:
                outcomes = (note("order-without-evidence", order=order, what="in a stream"), *outcomes)
        known, states = self.known or {}, stream.schema.states
        if not isinstance(known, Mapping):
            raise CommonlawError("known-of-stream")
        possible = single_orders(order_by_state(order, states), states)
        library, absent = self._library_over(stream.schema, _lowest(possible))
        structure = ModelStructure(_lowest(possible), library, {**absent, **known}, self.shared, None, possible)
        with one_blas_thread():
            law = method.find_by_file(stream, structure, progress)
        return self._with_question(law, library, given, (*law.diagnostics, *outcomes), ())

    def _found(self, trials: Trials, progress: ProgressCallback, given: GivenDerivatives | None = None) -> Law:
        if self.observe or self._latent_names:
            return self._observed(trials, progress, given)
        derivatives, constant, resting = None, tuple[str, ...](), tuple[str, ...]()
        if given is not None:
            trials, derivatives = with_derivatives(trials, given)
        method, instead = self._method_for(trials, derivatives)
        limit = limit_of(self.time_limit, is_replay()) if isinstance(method, TrajectoryLikelihood) else None
        plain = not (isinstance(self.library, Mapping) or self.known or self.shared or derivatives)
        if plain and (isinstance(self.order, str) or self.order in (1, 2)):
            constant = states_at_rest(trials)
            trials = without_states(trials, constant)
        trials, structure, steps, outcomes = self._structure_for(trials, method, derivatives)
        library = structure.library
        refuse_vanishing_states(trials)
        trials, copies = _once(trials)
        resting = () if self.shared else objects_at_rest(trials)
        trials = without_objects(trials, resting)
        outcomes = (*outcomes, *copies, *outcome_of_constants(constant), *outcome_of_rest(resting))
        if not (self.known or self.shared):
            structure = replace(structure, library=_capped(library, trials))
        with one_blas_thread(), limited(limit):
            law = method.find(trials, structure, progress)
        strange = law.provenance.domain.strange
        trials = without_objects(trials, strange)
        outcomes = (*law.diagnostics, *outcomes, *instead)
        law = self._with_question(law, library, given, outcomes, steps)
        outcomes = (*with_origin_outcomes(outcomes, law, trials), *outcomes_of_confounding(trials, law.order, library))
        if self.order == "auto" and law.order != 0:
            outcomes = (*outcomes, *outcomes_of_generations(law, trials))
        outcomes = (*outcomes, *outcomes_of_separate_states(law), *outcomes_of_units(law, trials))
        outcomes += outcomes_of_inputs(law, trials)
        domain = replace(Domain.of(trials, state_rates(law)), at_rest=resting, constant=constant, strange=strange)
        law = replace(law, provenance=replace(law.provenance, domain=domain))
        outcomes = (*outcomes, *outcomes_of_rivals(law, trials))
        law = replace(law, provenance=replace(law.provenance, outcomes=outcomes))
        if law.provenance.is_stopped:
            return law
        try:
            with limited(limit):
                if plain and isinstance(method, TrajectoryLikelihood):
                    outcomes = (*outcomes, *outcomes_of_textbook(law, trials))
                    law = replace(law, provenance=replace(law.provenance, outcomes=outcomes))
                return law if library.functions else with_one_sided_limits(law, trials)
        except OutOfTimeError:
            return stopped(law, limit.elapsed if limit else 0.0, ["the nearest textbook law", "one-sided limits"])

    @property
    def _latent_names(self) -> tuple[str, ...]:
        latent = self.latent_states
        return (latent,) if isinstance(latent, str) else tuple(latent) if isinstance(latent, Sequence) else ()

    def _with_question(
        self,
        law: Law,
        library: AbstractLibrary,
        given: GivenDerivatives | None,
        outcomes: tuple[Outcome, ...],
        steps: tuple[Step, ...],
    ) -> Law:
        """Return a law with the call that found it, if text can express that, with notes, and steps before its own."""
        # Laws, functions and derivatives are no text
        is_text = isinstance(self.known, Mapping | str | None) and given is None and not library.functions
        calls = (call(LawDiscovery, self.get_params(deep=False), "cl.discover", "trials"),) if is_text else ()
        history = (*steps, *law.history)
        return replace(law, provenance=replace(law.provenance, calls=calls, outcomes=outcomes, history=history))

    def _method_for(
        self, trials: Trials | None, derivatives: TrialDerivatives | None
    ) -> tuple[AbstractMethod, tuple[Outcome, ...]]:
        """Return the method, and a note if trials, or a stream in place of them, take one without standard errors."""
        method, notes = self.method, tuple[Outcome, ...]()
        if method is None:
            method = DerivativeRegression() if derivatives else default_method(trials, self.order)
            if isinstance(method, DerivativeRegression) and not derivatives:
                why = "trials came from a stream"
                if trials is not None:
                    why = f"{len(trials.objects)} objects are too many for the likelihood of trajectories"
                notes = (note("derivatives-without-errors", why=why),)
        count = self.latent_states
        if not count or isinstance(count, str | Sequence):
            return method, notes
        if not isinstance(method, TrajectoryLikelihood):
            what, remedy = type(method).__name__, "leave-out" if 0 in method.orders else "use-trajectory-likelihood"
            raise CommonlawError("latent-states-unsupported", count=count, method=what, remedy=Diagnostic(remedy))
        return replace(method, latent_states=count), notes

    def _library_over(self, schema: Schema, order: Order) -> tuple[AbstractLibrary, Known]:
        """Return the library, and zero coefficients for the terms that an equation does not have."""
        if isinstance(self.library, Mapping):
            return of_each_equation(self.library, schema, order)
        return parse_library(self.library), {}

    def _structure_for(
        self, trials: Trials, method: AbstractMethod, derivatives: TrialDerivatives | None
    ) -> tuple[Trials, ModelStructure, tuple[Step, ...], tuple[Outcome, ...]]:
        """Return trials with the inputs of the laws, the structure of these, and steps and notes on their orders."""
        is_by_state = isinstance(self.library, Mapping)
        libraries = self.library.values() if isinstance(self.library, Mapping) else [self.library]
        trials = with_properties_in(map(parse_library, libraries), trials)
        is_first = self.order == "auto" and (derivatives is not None or is_by_state)
        trials, possible, steps, outcomes = possible_orders(trials, 1 if is_first else self.order)
        known = self.known or {}
        library, absent = self._library_over(trials.schema, _lowest(possible))
        if not isinstance(known, Mapping):
            if isinstance(known, Law) and known.schema.states == trials.schema.states:
                trials = with_zeros_before_doses(matched(replace(known, observation=STATES), trials, inputs="any"))
            if self.order == "auto" and not is_by_state:
                orders = order_of_each(order_of_base(known, trials), len(trials.schema.states))
                possible = tuple((order,) for order in orders)
            library, known = with_base(library, known, _lowest(possible), trials)
        if not isinstance(method, TrajectoryLikelihood) and any(len(orders) > 1 for orders in possible):
            possible = tuple((0,) if method.orders == (0,) else orders[:1] for orders in possible)
            if method.orders != (0,):
                what = f"by {type(method).__name__}"
                outcomes = (*outcomes, note("order-without-evidence", order=_lowest(possible), what=what))
        known = {**absent, **known}
        structure = ModelStructure(_lowest(possible), library, known, self.shared, derivatives, possible)
        return trials, structure, steps, outcomes

    def predict(self, trials: Trials, start: int | None = None) -> "Forecast":
        """Forecast each trial from its own initial state, fitted to its first samples, see `Law.predict`."""
        return self._fitted().predict(trials, start=start)

    def score(self, trials: Trials, y: None = None, start: int | None = None) -> float:
        """Return how well these trials are forecast, a finite number from -1 to 1, see `Forecast.bounded_score`.

        It is the mean of R^2 over trials and states, each of which counts as -1 if it is below that or the forecast
        diverged: one trial that is lost does not decide a comparison, as it would by `Forecast.score`.

        Parameters
        ----------
        trials
            What was measured.
        y
            Nothing, for scikit-learn.
        start
            How many first samples tell where each forecast starts, see `Law.predict`. A search over parameters takes it
            as ``GridSearchCV(..., scoring=lambda model, trials, _: model.score(trials, start=15))``.
        """
        return self._fitted().predict(trials, start=start).bounded_score()

    def get_params(self, deep: bool = True) -> dict[str, Any]:
        """Return the parameters by name; if `deep` those of the method too, ``method__solver__threshold``."""
        parameters = {name: getattr(self, name) for name in _PARAMETERS}
        inner = (pair for name, value in parameters.items() for pair in _nested_parameters(name, value))
        return parameters | dict(inner) if deep else parameters

    def set_params(self, **parameters: Any) -> Self:
        """Set parameters by name, also those of the method (``method__trim=5``), and return the estimator.

        Raises `CommonlawError` if a name is not a parameter.
        """
        for name in sorted(parameters, key=lambda parameter: parameter.count("__")):
            first, _, rest = name.partition("__")
            check_choice("parameter", first, _PARAMETERS)
            new = parameters[name]
            setattr(self, first, _with_parameter(first, getattr(self, first), rest, new) if rest else new)
        return self

    def __repr__(self) -> str:
        given = ", ".join(f"{name}={value!r}" for name, value in self.get_params(False).items() if value is not None)
        return f"LawDiscovery({given})"

    def __sklearn_tags__(self) -> "Tags":
        from sklearn.utils import InputTags, Tags, TargetTags

        inputs = InputTags(two_d_array=False)
        return Tags(estimator_type=None, target_tags=TargetTags(required=False), input_tags=inputs)

    def _fitted(self) -> Law:
        if not hasattr(self, "law_"):
            raise CommonlawError("not-fitted")
        return self.law_


_PARAMETERS = inspect.signature(LawDiscovery).parameters

_CHANGING_NOTHING = ("progress", "cache", "client", "time_limit")
"""Parameters that the law does not depend on, unless its search is stopped."""


def default_method(trials: Trials | None, order: AskedOrder = "auto") -> AbstractMethod:
    """Return the method that is used when none is named; of a stream there are no trials in memory.

    `TrajectoryLikelihood`, but `DerivativeRegression` for streams and for so many objects that less than 200 samples
    of each could be fitted, and `DiscreteTimeRegression` for laws in discrete time.
    """
    if order == 0:
        return DiscreteTimeRegression()
    return TrajectoryLikelihood() if trials and can_be_subsampled(trials) else DerivativeRegression()


def _lowest(possible: Sequence[Sequence[int]]) -> Order:
    return one_order([orders[0] for orders in possible])


def _capped(library: AbstractLibrary, trials: Trials, fewest: int = 5) -> AbstractLibrary:
    """Return a library without high powers of inputs of few values, which are linear combinations of lower ones."""
    inputs = np.concatenate([trial.inputs for trial in trials]).T
    counts = [len(np.unique(signal[np.isfinite(signal)])) for signal in inputs]
    levels = tuple(pair for pair in zip(trials.schema.inputs, counts, strict=True) if pair[1] <= fewest)
    return CappedLibrary(library, levels) if levels else library


def _once(trials: Trials) -> tuple[Trials, tuple[Outcome, ...]]:
    """Return the trials, each without empty samples and once, and a word on those that are no new evidence.

    What copies an object's own trial is left out; what copies another object's is all that is known of this one.
    """
    copies = exact_copies(trials)
    names = dict.fromkeys(trial.object for trial, _ in copies)
    redundant = [trial for name in names for trial, _ in exact_copies(trials.of_object(name))]
    kept = [trial for trial in trials if not any(trial is copy for copy in redundant)]
    left_out = [(trial, before) for trial, before in copies if any(trial is copy for copy in redundant)]
    counted, outcomes = [pair for pair in copies if pair not in left_out], list[Outcome]()
    for what, pairs in (("copies-of-trials", left_out), ("copies-of-objects", counted)):
        if pairs:
            outcomes.append(note(what, trials=shown([f"{trial.label} of {before.label}" for trial, before in pairs])))
    return trials.with_trials([trial.measured() for trial in kept]), tuple(outcomes)


def discover(
    trials: Trials | TrialStream | Any,
    order: AskedOrder = "auto",
    library: LibraryGiven | Mapping[str, LibraryGiven] = "auto",
    method: AbstractMethod | None = None,
    known: Base | None = None,
    shared: Sequence[Key] = (),
    latent_states: int | str | Sequence[str] = 0,
    observe: Mapping[str, str] | None = None,
    progress: ProgressCallback | None = None,
    cache: bool = True,
    client: "Client | None" = None,
    time_limit: float | None = None,
    x_dot: GivenDerivatives | None = None,
    resume: Law | None = None,
) -> Law:
    """Discover the law that the objects of trials share.

    Candidate laws are fitted by maximum likelihood and ranked by their evidence.

    Parameters
    ----------
    trials
        Measurements: trials, a stream, or a table that `Trials.from_frame` accepts.
    order
        Order of the law: 1 for ``x' = f(x)``, 2 for ``x'' = f(x, x')``; 0 for a law in discrete time, ``x[k+1] =
        f(x[k])``. By state if orders differ: ``{"theta": 2, "i": 1}``. ``"auto"``: 1 if such a law fits within the
        noise, otherwise 1 or 2 for each state, by the larger evidence (see `Law.provenance`). States measured together
        with their rates are of order 2; known physics keeps its order. For streams and regressions, which have no
        evidence, ``"auto"`` is 1, with a note. Discrete time is never tried; a note suggests it if each sample follows
        from the one before, but not by the law.
    library
        Candidate terms, as text such as ``"poly:3"``, ``"poly:2 + saturating"``, ``"ratio(poly:2, poly:2)"``, or
        a list of terms, libraries and functions of Python, ``["poly:2", "x^2/K", drag]``, see `parse_library` and
        `ExpressionLibrary`; or plain terms by state, ``{"x": "poly:2", "y": "poly:1"}``, for laws of order 1 unless
        another is named. Properties of the objects may stand in terms and are inputs of the law.
        ``"auto"``: polynomials of degree 3, and richer terms where these show lack of fit, see
        `AutoLibrary`; in streams and regressions only polynomials.
    method
        Method of estimation: `TrajectoryLikelihood`, `DerivativeRegression`, `WeakRegression`, or
        `DiscreteTimeRegression`. Default: see `default_method`.
    known
        Known coefficients: term to number (``{"1": -9.8}``), or to numbers by object; with several states the term is
        given with its equation's state (``{("x", "1"): -9.8}``). They are moved to the left-hand side. Or known physics
        as a base, whose terms join the library: equations with numbers (``"x'' = -9.81"``, names being properties of
        the objects), a law, or a function of variables and properties that gives the highest derivatives,
        ``lambda v, diameter, mass: -0.2 * v * abs(v) * diameter**2 / mass``. What is discovered is what is left.
    shared
        Terms that have one coefficient for all objects, such as gravity: ``("1",)``; named as in `known`.
    latent_states
        1 to consider laws with a latent state, too, see `TrajectoryLikelihood`. With `observe` the names of the states
        without a column.
    observe
        Observation equations: what was measured in place of states, by column, as expressions of states, inputs and
        parameters: ``observe={"y": "s (x + z) + b"}, latent_states="z"`` in a table of x and y. There have to be as
        many states as measured quantities. Parameters of observations are estimated with the law, of first order, and
        are the same for all objects, like known coefficients; what the law does not determine, such as the scale of a
        state that is seen through ``"s x"`` alone, is an error that names it. Of `TrajectoryLikelihood` noise and seed
        go with it;
        ``"auto"`` as the library is polynomials of degree 2, and of degree 3 where these show lack of fit.
    progress
        Called with the text of each step, and with the best law so far whenever there is another one: a text that has
        it as `law`, without standard errors. Default: the terminal shows the texts after two seconds.
    cache
        Whether to keep the law in the user's cache folder, and to return it from there if the same call was made before
        with the same trials. The environment variable ``COMMONLAW_CACHE`` names another folder; ``off`` disables it.
    client
        A ``distributed.Client`` whose workers read and compress the files of a `TrialStream`. The law does not depend
        on the number of workers, up to rounding.
    time_limit
        Seconds after which the search of `TrajectoryLikelihood` ends with the best law so far, with its standard errors
        and a note on what was not tried; the first law is awaited. Without a limit, the default, the law does not
        depend on the machine. A law that was complete in time is the same; one that was not is not kept in the cache.
    x_dot
        Measured or computed derivatives of the states at the samples: an array of shape (n, states)
        for each trial, or by state an array or the name of a column, ``{"x": "speed"}``. `DerivativeRegression`, the
        default then, takes them in place of its own, for laws of order 1.
    resume
        A law of these trials whose search was stopped, by `time_limit` or else: the search goes on with the arguments
        of then, and without a limit ends with the law that it had found unstopped. Steps that were done are taken from
        the cache, which has them on the machine, and for the version of commonlaw, that the search ran with.

    Raises
    ------
    CommonlawError
        If the trials or an argument cannot be used; the message states where and what to do.

    See Also
    --------
    fit : Fit given equations.
    compare : Compare laws by their evidence.
    refine : Refit a law to other trials.
    bounds : Limits of coefficients of absent terms.
    Law.assess : Check forecasts on held-out trials.
    LawDiscovery : The same as a scikit-learn estimator.

    Examples
    --------
    >>> import commonlaw as cl
    >>> from commonlaw.law import average_law
    >>> drops = cl.datasets.linear_drag(drag=(-0.1, -0.5), trials=1, noise=0.0)
    >>> print(average_law(cl.discover(drops, order=2, library="poly:1")))
    x'' = -9.8000 ± 0.0023 - (0.30000 ± 0.00020) v
    <BLANKLINE>
    with v = x'
    """
    estimator = LawDiscovery(
        order, library, method, known, shared, latent_states, observe, progress, cache, client, time_limit
    )
    if resume is not None:
        check_type("resume", resume, Law, "a law, as of `cl.discover`")
        trials = measured(trials)
        estimator.set_params(**_arguments_of_search(resume, estimator.get_params(deep=False)))
        estimator._check_resumable(resume, trials)
    return estimator.fit(trials, x_dot).law_


def _arguments_of_search(law: Law, given: Mapping[str, Any]) -> dict[str, Any]:
    """Return the arguments of the search that was stopped with a law, but given ones that change nothing in a law.

    Where they are no text, and so not on record, they are those given.

    Raises `CommonlawError` if the law is complete, or a given argument is neither the default nor that of the search.
    """
    if not law.provenance.is_stopped:
        raise CommonlawError("resume-complete")
    recorded = recorded_arguments(law.provenance.calls[0]) if law.provenance.calls else given
    defaults = {name: parameter.default for name, parameter in _PARAMETERS.items()}
    searched = {**defaults, **recorded, **{name: given[name] for name in _CHANGING_NOTHING}}
    changed = [
        name
        for name, value in given.items()
        if not any(is_same(value, before) for before in (defaults[name], searched[name]))
    ]
    if changed:
        raise CommonlawError("resume-with-changes", names=changed)
    return searched


def _nested_parameters(name: str, value: object) -> Iterator[tuple[str, object]]:
    """Yield the fields of a value that is a dataclass, and of its fields, as ``method__solver__threshold``."""
    if is_dataclass(value):
        for field in fields(value):
            full, field_value = f"{name}__{field.name}", getattr(value, field.name)
            yield full, field_value
            yield from _nested_parameters(full, field_value)


def _with_parameter(name: str, value: Any, path: str, new: object) -> Any:
    """Return the parameter of this name, a dataclass, with the field at a path changed: ``"solver__threshold"``."""
    if not is_dataclass(value) or isinstance(value, type):
        raise CommonlawError("no-parameter", name=name, value=value, path=path)
    first, _, rest = path.partition("__")
    known = [field.name for field in fields(value) if field.init]
    check_choice(f"parameter of {name}", first, known)
    changed = _with_parameter(f"{name}__{first}", getattr(value, first), rest, new) if rest else new
    return replace(value, **{first: changed})
