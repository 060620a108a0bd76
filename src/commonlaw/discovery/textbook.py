"""The named model nearest to a law: its evidence, its forecasts, and what it leaves unexplained."""

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from itertools import chain, permutations, product
from typing import NamedTuple

import numpy as np

from commonlaw.array_types import Bools, Floats
from commonlaw.diagnostics import Outcome, note
from commonlaw.discovery.fitting import fit
from commonlaw.discovery.orders import attempt_each
from commonlaw.discrepancy.residual_tests import Residuals
from commonlaw.discrepancy.residuals import untested
from commonlaw.errors import CommonlawError
from commonlaw.formulation import law_variables, plain_rates
from commonlaw.inference import settings
from commonlaw.inference.fit.convergence import converged
from commonlaw.inference.fit.covariance import fitted_law
from commonlaw.inference.fit.final_score import final, score_of_fit
from commonlaw.inference.fit.fit import PLAUSIBLE, Fit, linearized_evidence
from commonlaw.inference.fit.initial_condition_prior import InitialConditionPrior
from commonlaw.inference.score.score import Kind
from commonlaw.inference.score.supports import SupportEvidence, shifted
from commonlaw.inference.search.error_models import fit_each_kind, with_error_models
from commonlaw.inference.search.law_search import fit_terms
from commonlaw.inference.search.pool import Pool
from commonlaw.inference.search.setup import FitSetup, RefitOptions
from commonlaw.law import Law
from commonlaw.law.alignment import matched
from commonlaw.law.law import shares_terms
from commonlaw.law.models import NamedModel, named_models
from commonlaw.law.parameters import named_parameters
from commonlaw.law.parse import read_equations
from commonlaw.law.quantities import Entry, entries_of, variables_in
from commonlaw.law.text import left_hand_sides
from commonlaw.law.verdict import LawVerdict
from commonlaw.library import Term, Terms
from commonlaw.library.bounds import Bound
from commonlaw.library.parametric import free_name
from commonlaw.likelihood import NotPositiveError
from commonlaw.runtime.fit_options import ErrorKind
from commonlaw.runtime.forking import cached_property
from commonlaw.runtime.notebooks import ShownInNotebooks
from commonlaw.runtime.progress import silent, unannounced
from commonlaw.trials import Schema, Trials
from commonlaw.trials.headers import known_unit
from commonlaw.trials.trial import property_names
from commonlaw.trials.units import Conversion
from commonlaw.verdict import assess

AS_GOOD = 3.0
"""2 log B up to which a named model is as good as the law: positive evidence begins at 2, strong at 6 (Kass and Raftery
1995)."""

_MAX_FITTED = 4
"""So many named models are fitted, the nearest by the linearized likelihood."""

_THIRDS = ("at the start", "in the middle", "at the end")
"""The thirds of a trial."""


class Unexplained(NamedTuple):
    """What a law leaves of the measurements of a state, beyond their noise.

    Parameters
    ----------
    state, unit
        Whose measurements, and their unit, empty if unknown.
    size
        ``sqrt(mean r^2 - s^2)`` of residuals r, with the noise s by the chosen law, if the excess of n residuals is
        above two standard errors, ``2 sqrt(2/n) s^2``; ``sqrt(mean r_i r_(i+1))`` of residuals and the next, in which
        white noise has no part, if that is slow and larger; else zero.
    correlation
        Of residuals with those of the next samples, about zero.
    slow
        Whether this is above zero by more than two standard errors, ``1/sqrt(n)`` of n pairs.
    shares
        Of the sum behind the size in the first, second and last third of the trials; zero if nothing is left.
    """

    state: str
    unit: str
    size: float
    correlation: float
    slow: bool
    shares: tuple[float, float, float]

    def __str__(self) -> str:
        if not self.size:
            return f"nothing of {self.state} beyond the noise"
        most = int(np.argmax(self.shares))
        where = f", mostly {_THIRDS[most]}" if self.shares[most] > 0.5 else ""
        size = f"{self.size:.2g} {self.unit}".rstrip()
        return f"{size} of {self.state}{', slow' if self.slow else ''}{where}"


@dataclass(frozen=True, eq=False)
class TextbookLaw(ShownInNotebooks):
    """The named model nearest to a law; it prints as a sentence.

    Parameters
    ----------
    models
        The named models with these equations, over the columns of the trials.
    chosen
        The law that it is compared with.
    law
        The named model, fitted to the training data; the chosen law itself if this has its terms and signs.
    evidence
        2 log B of the chosen law against it, without the prior probabilities of terms, see `commonlaw.compare`;
        negative if the named model is more probable.
    verdicts
        The forecast assessments of it and of the chosen law.
    residuals
        Of its trajectories and of those of the chosen law, both over the noise by the latter.
    has_same_terms
        Whether it has the terms of the chosen law, if need be with relations between their coefficients.
    """

    models: tuple[NamedModel, ...]
    chosen: Law
    law: Law
    evidence: float
    verdicts: tuple[LawVerdict, LawVerdict]
    residuals: tuple[Residuals, Residuals]
    has_same_terms: bool

    @property
    def title(self) -> str:
        """What textbooks call it."""
        return _title(self.models)

    @cached_property
    def unexplained(self) -> tuple[Unexplained, ...]:
        """What it leaves of each measured state."""
        schema = self.chosen.observation.measured
        return tuple(_unexplained(self.residuals[0], schema.states.index(name), schema) for name in schema.measured)

    @property
    def is_chosen(self) -> bool:
        """Whether the chosen law is this named model."""
        return self.law is self.chosen

    @property
    def as_good(self) -> bool:
        """Whether the data do not distinguish it from the chosen law: 2 log B of at most 3."""
        return self.evidence <= AS_GOOD

    @property
    def error_ratio(self) -> float:
        """Its forecast error over that of the chosen law; infinite if its forecasts diverge, NaN if unknown."""
        named, of_chosen = self.verdicts
        with np.errstate(all="ignore"):
            return float(np.divide(named.error, of_chosen.error))

    def as_dict(self) -> dict[str, object]:
        """Return its names, equations and numbers."""
        return {
            "models": [model.name for model in self.models],
            "equations": list(self.models[0].without_bounds),
            "is_chosen": self.is_chosen,
            "2 log B": self.evidence,
            "error_ratio": self.error_ratio,
            "unexplained": [of_state._asdict() for of_state in self.unexplained],
            "sentence": str(self),
        }

    def __str__(self) -> str:
        title, equations = self.title, "; ".join(self.models[0].without_bounds)
        if self.has_same_terms:
            known = f"This is a textbook law: {title}, {equations} ({self.models[0].source})"
            if self.is_chosen:
                return f"{known}."
            probable = "less" if self.evidence > 0 else "more"
            size = f"2 log B = {_rounded(abs(self.evidence))}"
            return f"{known}; its relations between coefficients are {probable} probable than none ({size})."
        return f"Nearest textbook law: {title}, {equations}. {'; '.join(self._sentences())}."

    def _sentences(self) -> Iterator[str]:
        size = f"2 log B = {_rounded(abs(self.evidence))}"
        if abs(self.evidence) <= AS_GOOD:
            yield f"These data do not distinguish it from the chosen law ({size})"
        else:
            yield f"It is {'less' if self.evidence > 0 else 'more'} probable than the chosen law ({size})"
        ratio = self.error_ratio
        data = "training data" if self.verdicts[0].in_sample else self.verdicts[0].judged_on
        if np.isinf(ratio):
            yield f"its forecasts of {data} diverge"
        elif ratio > 1.1 or ratio < 1 / 1.1:
            yield f"its forecasts of {data} have {ratio:.2g} times the error"
        elif np.isfinite(ratio):
            yield f"its forecasts of {data} are as accurate"
        yield f"it leaves {' and '.join(map(str, self.unexplained))}"


def _unexplained(residuals: Residuals, j: int, schema: Schema) -> Unexplained:
    """Return what a law leaves of a state, given its residuals over the noise."""
    samples, pairs = list[Floats](), list[Floats]()
    for trial, fitted, standardized in zip(residuals.trials, residuals.fitted, residuals.standardized, strict=True):
        seen = np.isfinite(standardized[:, j])
        r, z = trial.states[seen, j] - fitted[seen, j], standardized[seen, j]
        third = np.minimum(3 * trial.elapsed[seen] / max(trial.elapsed[-1], np.finfo(float).tiny), 2).astype(int)
        samples.append(np.array([third, r**2, np.divide(r**2, z**2, out=np.zeros_like(r), where=z != 0)]))
        pairs.append(np.array([third[:-1], r[:-1] * r[1:]]))
    (third, squares, variances), (of_pair, products) = (np.concatenate(parts, axis=1) for parts in (samples, pairs))
    correlation = float(products.mean() / squares.mean()) if products.size and squares.any() else 0.0
    slow = bool(correlation > 2 / np.sqrt(max(products.size, 1)))
    excess = squares - variances
    is_excess = excess.mean() > 2 * np.sqrt(2 / squares.size) * variances.mean()
    # The larger of two estimates: what is slow is in both, unless the noise by the chosen law contains it
    is_slower = slow and not (is_excess and excess.mean() > products.mean())
    where, values = (of_pair, products) if is_slower else (third, excess)
    positive = np.maximum(np.bincount(where.astype(int), values, minlength=3), 0.0)
    is_left, shares = slow or is_excess, (0.0, 0.0, 0.0)
    if is_left:
        first, second, last = (positive / positive.sum()).tolist()
        shares = (first, second, last)
    size = float(np.sqrt(values.mean())) if is_left else 0.0
    unit = "" if schema.states[j] in schema.logarithmic else schema.units.get(schema.states[j], "")
    return Unexplained(schema.states[j], unit, size, correlation, slow, shares)


class _Nearest(NamedTuple):
    """Named models with the same terms, 2 log B of the law against them, and whether the law is this model.

    They `have_same_terms` if these are those of the law. `fitted` is the first of them as a law under white noise, if
    it was fitted so.
    """

    models: tuple[NamedModel, ...]
    evidence: float
    is_law: bool = False
    fitted: Law | None = None
    have_same_terms: bool = False


def nearest_textbook_law(
    law: Law, trials: Trials, learned: Trials | None = None, verdict: LawVerdict | None = None
) -> TextbookLaw:
    """Return the named model nearest to a law, see `Law.textbook`; `verdict` is that of the law, if it is known."""
    if not _is_comparable(law):
        raise CommonlawError("named-model-beyond")
    whole = matched(law, trials)
    training = whole if learned is None or learned is trials else matched(law, learned)
    with unannounced(), np.errstate(all="ignore"):
        nearest = _nearest(law, training)
        if nearest is None:
            raise CommonlawError("named-model-none", equations=left_hand_sides(law.schema.states, law.order))
        errors, verdict = law.uncertainty.error_model, verdict or assess(law, whole, training)
        named, of_named = law, verdict
        if not nearest.is_law:
            if nearest.fitted is not None and errors.kind == "white":
                named = nearest.fitted
            else:
                named = _fit(nearest.models[0], training, law, errors.kind)
            of_named = assess(named, whole, training)
        under = replace(named, uncertainty=replace(named.uncertainty, error_model=errors))
        residuals = [untested(one, training, law.uncertainty.noise)[0] for one in (under, law)]
    return TextbookLaw(
        models=nearest.models,
        chosen=law,
        law=named,
        evidence=nearest.evidence,
        verdicts=(of_named, verdict),
        residuals=(residuals[0], residuals[1]),
        has_same_terms=nearest.is_law or nearest.have_same_terms,
    )


def outcomes_of_textbook(law: Law, trials: Trials) -> tuple[Outcome, ...]:
    """Return a note if a named model of other terms or signs is as good, see `TextbookLaw.as_good`.

    Laws with parameters inside of terms, which come from a wider search, have none.
    """
    if not _is_comparable(law) or law.terms.variables.parameters or _of_terms(law, _candidates(law)):
        return ()
    try:
        with unannounced(), np.errstate(all="ignore"):
            nearest = _nearest(law, trials, AS_GOOD)
    except (CommonlawError, ArithmeticError, np.linalg.LinAlgError):  # Laws are reported without this note, too
        return ()
    if nearest is None or nearest.is_law:
        return ()
    title, equations = _title(nearest.models), nearest.models[0].without_bounds
    probable = "more probable" if nearest.evidence < -AS_GOOD else "about as probable"
    evidence = f"2 log B = {_rounded(abs(nearest.evidence))} {'against' if nearest.evidence > 0 else 'for'} it"
    return (note("textbook-law-as-good", title=title, equations=equations, probable=probable, evidence=evidence),)


@unannounced()
def with_textbook_laws(pool: Pool) -> Pool:
    """Return a pool in which named models that are more probable than its best law come first, the best of them.

    A search moves from law to law; where coefficients of single objects run away, it does not come by one that is
    fitted from the measurements. Named models of terms of the library have the error model of the law, and the prior of
    their terms. There are none of measurements that are noise alone, or do not identify the noise.
    """
    best = pool.best
    problem, law = best.problem, fitted_law(best.problem.law, best)
    terms, measured = problem.terms, sum(problem.measured)
    if not _is_comparable(law) or terms.variables.parameters or best.score.kind is not Kind.EVIDENCE:
        return pool
    if not (best.size or best.has_process_noise):
        return pool
    candidates = _candidates(law)
    if any(candidate.is_free for candidate in _of_terms(law, candidates)):
        return pool
    named = list[tuple[float, Bools, list[_Candidate]]]()
    for places, alike in candidates.items():
        known = [candidate for candidate in alike if candidate.is_free and _has_units(candidate, law.schema)]
        if known and all(term in terms.terms for _, term in places):
            supports = np.zeros(problem.allowed.shape, dtype=np.bool_)
            for j, term in places:
                supports[j, terms.terms.index(term)] = True
            is_determined = problem.is_determined(int(supports.sum()) * len(problem.models))
            is_noise_identified = problem.noise_is_identifiable or is_determined
            if is_noise_identified and not (supports & ~problem.allowed).any():
                named.append((best.evidence.value(supports) - best.evidence.value(best.supports), supports, known))
    near = sorted((entry for entry in named if entry[0] < measured), key=lambda entry: entry[0])[:_MAX_FITTED]
    fits = [
        fit
        for _, supports, known in near
        for fit in fit_each_kind(problem, supports, (best.errors,))
        if _of_signs(known, np.array([estimate.coefficients for estimate in fit.estimates]), terms)
    ]
    if "scatter of starts" in best.score.parts:
        prior = InitialConditionPrior(best)
        fits = [fit.with_score(fit.score.plus("scatter of starts", prior.correction(fit))) for fit in fits]
    nearest = min(fits, default=None)
    # Of a plausible law, as scores of a search are off those of converged fits by less than strong evidence
    if nearest is None or nearest.score - best.score > PLAUSIBLE + settings.STRONG:
        return pool
    ahead = final(nearest)[0].score - final(best)[0].score
    if not ahead < 0:
        return pool
    more = ahead - (nearest.score - best.score)
    return pool.joined(nearest.with_score(nearest.score.plus("refit", more)))


def has_textbook_laws(law: Law) -> bool:
    """Return whether there are named models that a law can be compared with."""
    return _is_comparable(law) and bool(_candidates(law))


def _is_comparable(law: Law) -> bool:
    is_plain = law.scheme == "collocation" and not law.schema.initial_values and law.uncertainty.explanation is None
    return is_plain and law.order in (1, 2) and shares_terms(law)


def _rounded(evidence: float) -> str:
    """Return 2 log B with two digits, or as a whole number.

    >>> _rounded(1.234), _rounded(123.4)
    ('1.2', '123')
    """
    return f"{evidence:.2g}" if abs(evidence) < 100 else f"{evidence:.0f}"


def _title(models: Sequence[NamedModel]) -> str:
    return " or ".join(dict.fromkeys(model.title for model in models))


_Places = frozenset[tuple[int, Term]]
"""The terms of each equation of a law, with the index of the equation."""


class _Candidate(NamedTuple):
    """A named model over the columns of trials, its terms with what stands before them, and bounds of its parameters.

    It `has_names` if the columns have the names of its variables; x, y and z do not say what a column is.
    """

    model: NamedModel
    entries: tuple[Entry, ...]
    bounds: tuple[Bound, ...]
    has_names: bool

    @property
    def places(self) -> _Places:
        """The terms of its equations."""
        return frozenset((entry.equation, entry.term) for entry in self.entries)

    @property
    def is_free(self) -> bool:
        """Whether each term has a coefficient of its own."""
        return len({name for entry in self.entries for name in entry.powers}) == len(self.entries)

    def has_signs(self, coefficients: Floats, terms: Terms) -> bool:
        """Return whether coefficients of terms, shape (objects, equations, terms), have the signs of the model.

        The mean over objects decides: noise may turn the sign of an object.
        """
        mean, positive = coefficients.mean(axis=0), {bound.name for bound in self.bounds if bound.low >= 0}
        known = (entry for entry in self.entries if positive >= entry.powers.keys())
        return all(mean[entry.equation, terms.terms.index(entry.term)] * entry.number > 0 for entry in known)


def _of_signs(alike: Sequence[_Candidate], coefficients: Floats, terms: Terms) -> list[_Candidate]:
    """Return those of some named models whose signs coefficients have, each once, that of the names of columns first.

    If one has these names, it alone says what the columns are.
    """
    known = dict[str, _Candidate]()
    for candidate in alike:
        if candidate.has_signs(coefficients, terms):
            known.setdefault(candidate.model.name, candidate)
    return [candidate for candidate in known.values() if candidate.has_names] or [*known.values()]


def _candidates(law: Law) -> dict[_Places, list[_Candidate]]:
    """Return the named models with the states, the order and inputs of a law, by their terms.

    No parameter is inside of a term.
    """
    schema, result = law.schema, dict[_Places, list[_Candidate]]()
    inputs = [name for name in schema.inputs if name not in schema.doses]
    taken = (*law.terms.variables.names, *property_names(law.properties))
    for model in named_models.values():
        is_of_order = (law.order == 2) == ("''" in model.equations)
        if not (is_of_order and len(model.states) == len(schema.states) and _has_plain_terms(model.name)):
            continue
        free = {name: free_name(name, taken) for name in model.parameters}
        free = {name: new for name, new in free.items() if new != name}
        for columns in product(permutations(schema.states), permutations(inputs, len(model.inputs))):
            names = dict(zip((*model.states, *model.inputs), chain(*columns), strict=True))
            has_names = all(name == column for name, column in names.items())
            over = model.over(names | free)
            for column in {*names.values()} & {*plain_rates(schema)} if law.order == 2 else ():
                # No rate, though it has the usual name of one
                over = replace(over, equations=re.sub(rf"\b{column}\b(?!')", f"`{column}`", over.equations))
            given = read_equations(over.equations, schema)
            has_names = has_names and not {*names} <= {"x", "y", "z"}
            candidate = _Candidate(over, entries_of(given), given.bounds, has_names)
            result.setdefault(candidate.places, []).append(candidate)
    return result


def _of_terms(law: Law, candidates: Mapping[_Places, Sequence[_Candidate]]) -> list[_Candidate]:
    """Return the named models that have the terms and signs of a law."""
    return _of_signs(candidates.get(_places_of(law), []), law.coefficients, law.terms)


def _places_of(law: Law) -> _Places:
    return frozenset((j, law.terms.terms[k]) for j, k in np.argwhere(law.support & law.terms.is_factor).tolist())


@cache
def _has_plain_terms(name: str) -> bool:
    """Return whether a named model has no parameter inside of a term, and all of its states have columns."""
    model = named_models[name]
    if model.properties or model.latent or model.doses or re.search(r"\(t - ", model.equations):
        return False
    given = read_equations(model.equations, Schema(model.states, model.inputs))
    measured = len(given.terms.variables.measured)
    return all(column < measured for entry in entries_of(given) for column in entry.term.columns())


def _has_units(candidate: _Candidate, schema: Schema) -> bool:
    """Return whether the units of columns have the dimensions of a named model, where both are known.

    Degrees Celsius have an arbitrary origin, which the terms must not fix.
    """
    model = candidate.model
    for name in (*model.states, *model.inputs):
        unit, of_model = (known_unit(units.get(name, "")) for units in (schema.units, model.units))
        if unit is None:
            continue
        if of_model is not None and of_model.dimensionality != unit.dimensionality:
            return False
        if unit.is_compatible_with("K") and Conversion.between(name, schema.units[name], "K").offset:
            variables = law_variables(schema, 2 if "''" in model.equations else 1)
            for j in range(len(schema.states)):
                terms = Terms(variables, tuple(term for equation, term in candidate.places if equation == j))
                # A term whose derivative is not in the span of those of its equation needs all of them
                if shifted(terms, variables.index(name)).all(axis=1).any():
                    return False
    return True


class _Ranked(NamedTuple):
    """Named models of the same terms, with coefficients, and 2 log B against them, by the linearized likelihood."""

    above: float
    alike: Sequence[_Candidate]
    law: Law


def _nearest(law: Law, trials: Trials, most: float = np.inf) -> _Nearest | None:
    """Return the nearest named model; None if there is none, or 2 log B against it is above `most`.

    One whose variables have the names of the columns comes before others. All have the error model of the law. Models
    are not fitted if by the linearized likelihood n residuals have e times the variance of those of the nearest, or
    with a finite `most` of those of the law, ``2 log B = n``.
    """
    candidates = {
        places: known
        for places, alike in _candidates(law).items()
        if (known := [candidate for candidate in alike if _has_units(candidate, law.schema)])
    }
    if same := [candidate for candidate in _of_terms(law, candidates) if candidate.is_free]:
        return _Nearest(tuple(candidate.model for candidate in same), 0.0, is_law=True)
    if inside := tuple(_with_parameters_inside(law)):
        return _Nearest(inside, 0.0, is_law=True)
    if not candidates:
        return None
    chosen = _fitted(law, trials, law)
    ranked = sorted(_linearized(chosen, law.schema, candidates.values()), key=lambda named: named.above)
    ranked = [named for named in ranked if any(known.has_names for known in named.alike)] or ranked
    measured = sum(chosen.problem.measured)
    farthest = measured + (ranked[0].above if ranked and np.isinf(most) else 0.0)
    near = [named for named in ranked[:_MAX_FITTED] if named.above < farthest]

    def fit_near(named: _Ranked) -> tuple[Fit, Law, Sequence[_Candidate]]:
        law_of_model = _law_of(named, trials, law)
        return _fitted(law_of_model, trials, law), law_of_model, named.alike

    fits, _ = attempt_each(fit_near, near)
    # Converged fits differ from these by less than strong evidence as a rule
    least = min((_score(fitted) for fitted, *_ in fits), default=0.0)
    close = [triple for triple in fits if _score(triple[0]) < min(least, _score(chosen) + most) + settings.STRONG]
    best, of_law = list[_Nearest](), score_of_fit(converged(chosen)[0]) if close else None
    for fitted, law_of_model, alike in close:
        done = converged(fitted)[0]
        coefficients = np.array([estimate.coefficients for estimate in done.estimates])
        models = _of_signs(alike, coefficients, done.problem.terms) if alike[0].is_free else alike
        if of_law is not None and models:
            under_white_noise = None if alike[0].is_free else law_of_model
            models_of_terms = tuple(candidate.model for candidate in models)
            is_same = alike[0].places == _places_of(law)
            above = score_of_fit(done) - of_law
            best.append(_Nearest(models_of_terms, above, fitted=under_white_noise, have_same_terms=is_same))
    nearest = min(best, key=lambda nearest: nearest.evidence, default=None)
    return nearest if nearest is not None and nearest.evidence <= most else None


def _law_of(named: _Ranked, trials: Trials, law: Law) -> Law:
    """Return named models as a law: with free coefficients, or one with its relations between these.

    Raises `CommonlawError` if the mean of a parameter of the latter is outside of its bounds.
    """
    candidate = named.alike[0]
    if candidate.is_free:
        return named.law
    fitted = _fit(candidate.model, trials, law, "white")
    parameters = named_parameters(fitted)
    means = dict(zip(parameters.names, parameters.values.mean(axis=0), strict=True))
    for bound in candidate.bounds:
        if not bound.holds(means[bound.name]):
            raise CommonlawError("named-model-none", equations=left_hand_sides(law.schema.states, law.order))
    return fitted


def _fit(model: NamedModel, trials: Trials, law: Law, errors: ErrorKind) -> Law:
    """Return a named model as a law, without its bounds, on the scale of another one and under an error model."""
    return fit(
        model.without_bounds,
        trials,
        errors=errors,
        log_states=law.schema.logarithmic,
        input_interpolation=law.schema.input_interpolation,
        progress=silent,
    )


def _with_parameters_inside(law: Law) -> Iterator[NamedModel]:
    """Yield the named models that a law with parameters inside of terms is, over its columns."""
    if not law.terms.variables.parameters:
        return
    for model in named_models.values():
        if not (model.properties or model.latent or model.doses or re.search(r"\(t - ", model.equations)):
            for names in variables_in(law, model.equations, model.inputs):
                taken = (*names.values(), *property_names(law.properties))
                yield model.over({**{name: free_name(name, taken) for name in model.parameters}, **names})


def _fitted(law: Law, trials: Trials, chosen: Law) -> Fit:
    """Return the fit of a law under the error model of the chosen one."""
    fitted, kind = fit_terms(FitSetup.of(law, trials, RefitOptions())), chosen.uncertainty.error_model.kind
    return (fitted if kind == "white" else with_error_models(fitted, None, (kind,), silent)).best


def _score(fitted: Fit) -> float:
    """Return the score of a fit without the prior of its terms."""
    return fitted.score.total - fitted.score.parts.get("structure", 0.0)


def _linearized(fitted: Fit, schema: Schema, candidates: Iterable[Sequence[_Candidate]]) -> Iterator[_Ranked]:
    """Yield named models of the right signs, ranked by the likelihood linearized about a fitted law.

    The prior probabilities of terms are left out. Models whose terms are not finite there are, too.
    """
    problem, before = fitted.problem, fitted.problem.terms
    inner = len(before) - len(before.parameters)
    for alike in candidates:
        named = tuple(dict.fromkeys(entry.term for entry in alike[0].entries))
        more = [term for term in named if term not in before.terms]
        terms = Terms(before.variables, (*before.terms[:inner], *more, *before.terms[inner:]))
        columns = [terms.terms.index(term) for term in named]

        def wider(values: Floats, new: float, count: int = len(more)) -> Floats:
            return np.insert(values, [inner] * count, new, axis=-1)

        models = tuple(replace(model, terms=terms) for model in problem.models)
        estimates = [replace(estimate, coefficients=wider(estimate.coefficients, 0.0)) for estimate in fitted.estimates]
        wide = replace(problem, models=models, known=np.full_like(wider(problem.known, 0.0), np.nan))
        supports = np.zeros(wide.allowed.shape, dtype=bool)
        for entry in alike[0].entries:
            supports[entry.equation, terms.terms.index(entry.term)] = True
        try:
            evidence = linearized_evidence(wide, estimates, fitted.fitted_model_error)
            chosen = wider(fitted.supports.astype(np.float64), 0.0) > 0
            above = _without_prior(evidence, supports) - _without_prior(evidence, chosen)
            coefficients = evidence.coefficients(supports)
        except (NotPositiveError, np.linalg.LinAlgError):
            continue
        known, objects = _of_signs(alike, coefficients, terms), problem.trials.objects
        own_terms = Terms(replace(before.variables, parameters=()), named)
        law = Law(own_terms, schema, problem.order, objects, coefficients[:, :, columns])
        groups = [[candidate for candidate in known if candidate.is_free]]
        groups += [[candidate] for candidate in known if not candidate.is_free]
        yield from (_Ranked(above, group, law) for group in groups if group)


def _without_prior(evidence: SupportEvidence, supports: Bools) -> float:
    return evidence.value(supports) - sum(map(evidence.structure_prior.of, supports))
