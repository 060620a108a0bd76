"""The search for laws with parametric terms, starting from the best law among plain terms.

Candidate supports of each equation are proposed along estimated states, see `integral_ranking`. Laws with these
supports are fitted to the trajectories, each once, in the order of a prescreening, one equation after the other, and
the law of largest evidence gives better states. A law with unidentifiable parameters, or with a denominator that
vanishes along its solutions, is rejected. The score contains the multiplicity of the larger library, so the law among
plain terms is kept unless the evidence against it pays for that.
"""

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import product

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.errors import CommonlawError
from commonlaw.inference import settings
from commonlaw.inference.fit.annealing import fit_supports, fit_with, rescale_noise
from commonlaw.inference.fit.fit import ALL_MODEL_ERRORS, NO_MODEL_ERROR, PLAUSIBLE, Fit, Status, best_fit
from commonlaw.inference.fit.lack_of_fit import has_pole
from commonlaw.inference.fit.parameter_grid import frequencies_in_time
from commonlaw.inference.fit.problem import SearchProblem
from commonlaw.inference.propose.integral_ranking import CandidateSupport, rank_supports
from commonlaw.inference.propose.nonlinear_parameters import full_schedule, multistart, short_schedule, shrink_to_pooled
from commonlaw.inference.propose.rational import rank_ratios
from commonlaw.inference.search.error_models import with_error_models
from commonlaw.inference.search.law_search import resolved
from commonlaw.inference.search.pool import Pool
from commonlaw.library import Offer, Term, Terms, parse_term
from commonlaw.library.parametric import ParametricTerm, free_name
from commonlaw.likelihood import ErrorModel, Estimate
from commonlaw.runtime.parallel import in_parallel
from commonlaw.runtime.progress import ProgressCallback, Stage, part

Rows = tuple[CandidateSupport, ...]
"""The terms of a law, equation by equation."""


def with_parametric_terms(
    pool: Pool, offers: Sequence[Offer], progress: ProgressCallback, *, in_place_of_errors: bool = False
) -> Pool:
    """Return a pool with laws that contain offered terms, and the best law among plain terms.

    Offers are tried until one improves a law that is not `may_be_simpler`; their multiplicity includes that of the
    earlier ones. With `in_place_of_errors` the search ends after the first proposals if these explain far less than
    the model error of the plain law does, see `_ParametricSearch.is_in_vain`.
    """
    best = pool.best
    base = replace(best.problem, excluded_terms=len(best.problem.terms))  # The terms of a law are not yet among them
    base = base.under_white_noise if base.errors.of_law else base
    search = _ParametricSearch(best, pool.explored, base, progress, in_place_of_errors)
    for i, offer in enumerate(offers):
        if not offer.count:
            continue
        if search.is_in_vain or (search.best is not pool.best and not may_be_simpler(search.best, 2)):
            break
        # The first is tried in any equation; others where one of their terms alone, or a ratio, has fewer numbers
        numbers = [term.size + len(term.shared_parameters) for term in offer.terms]
        search.add(offer, min(numbers, default=2) if i else -1)
    fits = [search.plain, *(fit for fit in search.fitted.values() if fit.is_usable)]
    return Pool.of(fits, search.explored)


def with_parametric_terms_under_errors(
    pool: Pool, before: ErrorModel, offers: Sequence[Offer], progress: ProgressCallback
) -> Pool:
    """Return a pool with laws that contain offered terms, searched for under other measurement errors than `before`.

    Under heteroscedastic noise small values have larger weights, and these may show a nonlinearity that white noise
    hides. Other parameters are those of `with_parametric_terms`, and so are the laws that need no more of them.
    """
    plain = pool.plain
    if plain is None or not any(offer.count for offer in offers) or not may_be_simpler(pool.best, 2):
        return pool
    errors = plain.problem.errors
    if errors.of_law or errors.kind in ("white", before.kind):
        return pool
    again = with_parametric_terms(Pool((plain,), pool.explored), offers, progress)
    again = with_error_models(again, None, (errors.kind,), progress)
    return pool.joined(*again.fits, deterministic=again.deterministic)


def is_truncated_series(fit: Fit) -> bool:
    """Return whether a law contains what may be a truncated power series.

    These are three powers of one variable with a common factor, in equal steps, as of an exponential function, a sine
    or a reciprocal: a term with the same values has one or two parameters. x and x^3 are the first of a sine.
    """
    terms = fit.problem.terms
    for support in fit.supports & terms.is_factor:
        chosen = [monomial for k in np.flatnonzero(support) if (monomial := terms.terms[k].exponents) is not None]
        for last in chosen:
            for column, power in last.items():
                factors = {i: exponent for i, exponent in last.items() if i != column}
                before = [factors | ({column: lower} if lower else {}) for lower in range(power)]
                steps = range(1, power // 2 + 1)
                if any(before[power - step] in chosen and before[power - 2 * step] in chosen for step in steps):
                    return True
                if power == 3 and not factors and before[1] in chosen:
                    return True
    return False


def may_be_simpler(fit: Fit, numbers: int) -> bool:
    """Return whether a fit has a lack of fit, or an equation with more than so many coefficients."""
    return fit.supports.sum(axis=1).max() > numbers or bool(fit.lack_of_fit)


@dataclass(eq=False)
class _ParametricSearch:
    """The search among laws with offered terms: the best law so far, its terms `rows`, and all fits by their terms.

    It starts from the best law among `plain` terms, and all fits explored in its search; `base` is the problem with
    these terms alone. `near` are quick fits along the current states, and of the fitted laws. If it `is_in_vain`,
    laws `in_place_of_errors` explain less than `PROMISING` of what the model error of the plain law does.
    """

    plain: Fit
    explored: Sequence[Fit]
    base: SearchProblem
    progress: ProgressCallback
    in_place_of_errors: bool = False
    is_in_vain: bool = False
    fitted: dict[Rows, Fit] = field(default_factory=dict)
    near: dict[Rows, list[Estimate]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.best = self.plain
        self.rows: Rows = tuple(
            CandidateSupport(
                tuple(np.flatnonzero(support).tolist()),
                starts=(np.array([estimate.coefficients[j, support] for estimate in self.plain.estimates]),),
            )
            for j, support in enumerate(self.plain.supports)
        )

    def add(self, offer: Offer, fewest: int) -> None:
        """Find the law of largest evidence with the terms of another offer, on a refined mesh.

        Its terms add to the number of candidate terms. Equations without lack of fit are only replaced if they have
        more parameters than `fewest`.
        """
        self.base = replace(self.base, excluded_terms=self.base.excluded_terms + offer.count)
        self.offer, self.fewest = offer, fewest
        self.proposed: list[list[list[CandidateSupport]]] = []
        self.proposed_along = -np.inf  # -2 log evidence of the law without lack of fit along whose solutions they were
        # States of the law with a large model error, and smoothed measurements
        loose = next((fit for fit in self.explored if fit.model_error >= settings.MODEL_ERRORS[-2]), None)
        near = ([loose.estimates] if loose else []) + [self.plain.problem.starts]
        curves = [_without_processes(self.plain, estimates) for estimates in near]
        if not self.best.lack_of_fit:  # Its solutions are the best states
            curves = [_without_processes(self.best, self.best.estimates)]
        while True:
            self._run(curves)
            worse = not self.best < self.plain
            points = self.base.points if worse else resolved(Pool((self.best,)), self.progress).best.problem.points
            if points <= self.base.points:
                return
            self.progress("fitting laws again on a finer mesh")
            curves = [_without_processes(self.best, self.best.estimates)]
            self.base = replace(self.base, starts=curves[0]).with_points(points)
            curves, problem = [self.base.starts], self.plain.problem.about(self.plain.estimates).with_points(points)
            self.plain = best_fit([rescale_noise(fit_supports(problem, self.plain.supports, ALL_MODEL_ERRORS))])
            self.explored, self.fitted, self.near = (self.plain,), {}, {}

    def _run(self, curves: Sequence[tuple[Estimate, ...]]) -> None:
        """Find the law of largest evidence on one mesh, with supports proposed along some states in turn."""
        self.best = self.plain
        # A model error compensates for terms that one equation lacks
        if self.plain.has_model_error or any(row.others for row in self.rows):
            first = self.fit(self.rows, curves[0])
            self.best = first if first.is_usable else self.plain
        equations, later, without = len(self.rows), list(curves), self.best.score.total
        for sweep in range(settings.MAX_SWEEPS):
            before, begun, most = self.best, self.rows, self._max_parameters
            near, *later = later
            # Proposals along the solutions of an equally probable law would be the same
            if not self.best.score.total < self.proposed_along + settings.MAX_MESH_CHANGE:
                self.progress(Stage("proposing parametric terms", sweep / settings.MAX_SWEEPS))
                self.proposed = [*self._proposals(near), *self.proposed]
                self.proposed_along = self.best.score.total if sweep > 0 and not self.best.lack_of_fit else -np.inf
            # All equations jointly, each in turn, and combinations of the best of each
            ends = (sweep + np.arange(equations + 3) / (equations + 2)) / settings.MAX_SWEEPS
            stages = [part(self.progress, *ends[k : k + 2]) for k in range(equations + 2)]
            if equations > 1:
                self._improve(_joint(self.proposed, most), settings.MAX_PROPOSED, near, stages[0])
            for j, lists in enumerate(zip(*self.proposed, strict=True)):
                few = [row for row in _interleaved(lists) if row.numbers <= self._max_parameters[j]]
                listed = [(*self.rows[:j], row, *self.rows[j + 1 :]) for row in few[: settings.MAX_TRIED_SETS]]
                self._improve(listed, settings.MAX_REFINED, near, stages[j + 1])
            if equations > 1 and self.best.lack_of_fit:
                self._improve(self._combinations(begun), settings.MAX_PROPOSED, near, stages[-1])
            if self.best is not before:
                later = later if self.best.lack_of_fit else []
                later = [_without_processes(self.best, self.best.estimates), *later]
                self.rows = self._rows_from_best()
                self.near = {rows: estimates for rows, estimates in self.near.items() if rows in self.fitted}
            by_errors, by_terms = without - self.plain.score.total, without - self.best.score.total
            self.is_in_vain = self.in_place_of_errors and by_terms < settings.PROMISING * by_errors
            if self.is_in_vain or not later:
                break
        eliminated_from, last = None, part(self.progress, 1.0, 1.0)
        while self.best is not eliminated_from and self.best is not self.plain:  # Backward elimination
            eliminated_from, near = self.best, _without_processes(self.best, self.best.estimates)
            self._improve([*self._with_one_term_less()], settings.MAX_PROPOSED, near, last)

    @property
    def _max_parameters(self) -> list[int]:
        """The largest number of parameters to try in each equation: that of a law without lack of fit.

        It is one more for exact measurements whose residuals are large enough to discriminate.
        """
        if self.best.lack_of_fit:
            return [settings.MAX_NUMBERS] * len(self.rows)
        problem = self.best.problem
        deviance = sum(estimate.deviance for estimate in self.best.estimates) / sum(problem.measured)
        more = int(problem.least_variance >= 1 and deviance > problem.noise_scale.least)
        return [row.numbers + more for row in self.rows]

    def _proposals(self, estimates: Sequence[Estimate]) -> list[list[list[CandidateSupport]]]:
        """Return ranked supports of each equation: with parametric terms, then with ratios of sums.

        If the best law has no lack of fit, equations with few parameters keep their terms.
        """
        most = {
            j: count
            for j, (count, row) in enumerate(zip(self._max_parameters, self.rows, strict=True))
            if self.best.lack_of_fit or row.numbers > self.fewest
        }
        ranked = [rank_supports(self.base, estimates, self.offer.terms, most)]
        if self.offer.ratios:
            ranked.append(rank_ratios(self.base, estimates, self.offer.ratios, most))
        return [[by_equation.get(j, [row]) for j, row in enumerate(self.rows)] for by_equation in ranked]

    def _improve(
        self, listed: Sequence[Rows], most: int, estimates: Sequence[Estimate], progress: ProgressCallback
    ) -> None:
        """Fit the most promising of the laws listed that are not fitted yet, and keep the one of largest evidence.

        They are ranked by the BIC of a quick fit to the median object; it may fail in single objects. Laws far worse
        than those fitted so far are left out.
        """

        def quick_fit(rows: Rows) -> list[Estimate]:
            try:
                return multistart(*self._problem(rows, estimates), short_schedule)
            except (CommonlawError, np.linalg.LinAlgError):  # Terms that cannot be parsed, or are nowhere finite
                return []

        def show(begun: float, count: int) -> Callable[[int], None]:
            text = "fitting laws with nonlinear parameters"
            return lambda done: progress(Stage(text, begun + 0.5 * done / count))

        new = [rows for rows in dict.fromkeys(listed) if rows not in self.fitted]
        short = [rows for rows in new if rows not in self.near]
        self.near.update(zip(short, in_parallel(quick_fit, short, done=show(0.0, len(short))), strict=True))
        typical = {
            rows: float(np.median(objectives))
            for rows, fits in self.near.items()
            if (objectives := [fit.objective for fit in fits])
            and np.isfinite(objectives).all()  # Not so for the root of a negative number
        }
        penalty = float(np.log(np.median(self.base.measured)))
        criteria = [typical.get(rows, np.inf) + penalty * sum(row.numbers for row in rows) for rows in new]
        relative, margin = settings.MAX_DEVIANCE
        fitted = [typical[rows] for rows, fit in self.fitted.items() if fit.is_usable and rows in typical]
        worst = relative * min(fitted, default=np.inf) + margin
        ranked = (new[k] for k in np.argsort(criteria, kind="stable"))
        promising = [rows for rows in ranked if typical.get(rows, np.inf) < worst][:most]
        fits = in_parallel(lambda rows: self.fit(rows, estimates), promising, done=show(0.5, len(promising)))
        for rows, fit in zip(promising, fits, strict=True):
            if fit < self.best:
                self.best, self.rows = fit, rows

    def fit(self, rows: Rows, estimates: Sequence[Estimate]) -> Fit:
        """Return the fit of a law with these terms, starting from estimated states."""
        if rows not in self.fitted:
            try:
                self.fitted[rows] = self._fit(rows, estimates)
            except (CommonlawError, np.linalg.LinAlgError):
                self.fitted[rows] = Fit.failed(self.base, self.plain.supports, Status.REFUSED)
        return self.fitted[rows]

    def _fit(self, rows: Rows, estimates: Sequence[Estimate]) -> Fit:
        """Return a fit under its residual noise, with a status of failure where the Laplace approximation fails."""
        problem, initial = self._problem(rows, estimates)
        if not len(problem.terms):
            return Fit.failed(problem, problem.allowed, Status.WITHOUT_EFFECT)
        fit = Fit.failed(problem, problem.allowed, Status.NOT_COMPUTABLE)
        for schedule in (short_schedule, full_schedule):
            near = self.near.get(rows) if schedule is short_schedule else None
            separate = near or multistart(problem, initial, schedule)
            if not separate:
                break
            pooled, best = shrink_to_pooled(problem, separate)
            fit = fit_with(pooled, pooled.allowed, NO_MODEL_ERROR, best)
            if not fit.is_usable or fit.has_converged:
                break
        fit = rescale_noise(replace(fit, problem=replace(fit.problem, starts=fit.estimates))) if fit.is_usable else fit
        if not fit.is_usable:
            return fit
        if not fit.has_converged:
            return fit.but(Status.NOT_CONVERGED)
        if not are_parameters_identifiable(fit):
            return fit.but(Status.NOT_IDENTIFIABLE)
        has_poles = any(has_pole(fit.problem, o, estimate) for o, estimate in enumerate(fit.estimates))
        return fit.but(Status.HAS_POLE) if has_poles else fit

    def _problem(self, rows: Rows, estimates: Sequence[Estimate]) -> tuple[SearchProblem, list[Floats]]:
        """Return the problem of a law, and starting values, each of shape (objects, equations, terms)."""
        terms, known, places = _assembled(self.base, rows)
        problem = replace(
            self.base,
            models=tuple(replace(model, terms=terms) for model in self.base.models),
            starts=tuple(estimates),
            known=known,
            excluded_terms=self.base.excluded_terms - int(terms.is_factor.sum()),
            solver=None,
        )
        initial = list[Floats]()
        for k in range(max(len(row.starts) for row in rows)):
            initial.append(np.nan_to_num(known))
            for j, row in enumerate(rows):
                initial[k][:, j, places[j]] = row.starts[min(k, len(row.starts) - 1)]
        return problem, initial

    def _rows_from_best(self) -> Rows:
        """Return the terms of the best law with its estimates as starting values."""
        coefficients = np.array([estimate.coefficients for estimate in self.best.estimates])
        places = _assembled(self.base, self.rows)[2]
        return tuple(replace(row, starts=(coefficients[:, j, places[j]],)) for j, row in enumerate(self.rows))

    def _with_one_term_less(self) -> Iterator[Rows]:
        """Yield laws with one term less that are plausible by the likelihood linearised about the best."""
        places = _assembled(self.base, self.rows)[2]
        for j, row in enumerate(self._rows_from_best()):
            fewer = list[CandidateSupport]()
            terms = len(row.plain) + len(row.others)
            for k in range(terms) if terms > 1 else ():
                supports = self.best.supports.copy()
                supports[j, [places[j][column] for column in row.columns_of(k)]] = False
                if self.best.evidence.value(supports) < self.best.score.total + PLAUSIBLE:
                    fewer.append(row.without(k))
            fewer += reflected(self.base.terms, row)
            yield from ((*self.rows[:j], less, *self.rows[j + 1 :]) for less in fewer)

    def _combinations(self, rows: Rows) -> list[Rows]:
        """Return laws that combine the best supports of each equation, given these terms of the others.

        A change in two equations may improve the fit although neither does alone, since errors of one equation can
        compensate for those of the other.
        """
        best = []
        for j in range(len(rows)):
            scores = {
                terms[j]: fit.score
                for terms, fit in self.fitted.items()
                if fit.is_usable and terms[:j] == rows[:j] and terms[j + 1 :] == rows[j + 1 :]
            }
            best.append(sorted(scores, key=scores.__getitem__)[: _max_joint_supports(len(rows))])
        return list(product(*best))


def reflected(terms: Terms, row: CandidateSupport) -> Iterator[CandidateSupport]:
    """Yield supports whose constant is absorbed by a sigmoid s with parameters p: 1 - s(p) = s(-p)."""
    first = len(terms.variables.measured)
    for less in (row.without(k) for k, i in enumerate(row.plain) if terms.names[i] == "1"):
        for m, candidate in enumerate(less.others):
            if not isinstance(candidate, ParametricTerm) or candidate.tied or not candidate.parameters:
                continue
            shape = settings.GENERIC_POINTS, first + len(candidate.parameters)
            points = np.random.default_rng(0).uniform(0.5, 2.0, shape)
            opposite = points * np.where(np.arange(shape[1]) < first, 1.0, -1.0)
            with np.errstate(all="ignore"):
                total = candidate.term.evaluate(points) + candidate.term.evaluate(opposite)
            if (np.abs(total - 1) < settings.ROUNDING).all():
                signs = np.ones(less.numbers)
                signs[less.columns_of(len(less.plain) + m)] = -1.0
                yield replace(less, starts=tuple(start * signs for start in less.starts))


def _interleaved(proposed: Sequence[Sequence[CandidateSupport]]) -> list[CandidateSupport]:
    """Return the supports of several ranked lists, the best of each size before the second best."""
    ranks, result = Counter[tuple[int, int]](), dict[CandidateSupport, tuple[int, int]]()
    for number, ranked in enumerate(proposed):
        for row in ranked:
            result.setdefault(row, (ranks[number, row.numbers], row.numbers))
            ranks[number, row.numbers] += 1
    return sorted(result, key=result.__getitem__)


def _joint(proposed: Sequence[Sequence[Sequence[CandidateSupport]]], most: Sequence[int]) -> list[Rows]:
    """Return laws that combine the first of the ranked supports of all equations.

    For each number of parameters up to `most`, the largest support of that size or smaller of each equation is
    combined, too.
    """
    combined = dict[Rows, None]()
    for by_equation in proposed:
        combined |= dict.fromkeys(product(*(ranked[: _max_joint_supports(len(most))] for ranked in by_equation)))
    in_turn = [_interleaved(lists) for lists in zip(*proposed, strict=True)]
    for numbers in range(1, max(most) + 1):
        small = [[row for row in ranked if row.numbers <= numbers] for ranked in in_turn]
        if all(small):
            combined[tuple(max(ranked, key=lambda row: row.numbers) for ranked in small)] = None
    return [rows for rows in combined if all(row.numbers <= limit for row, limit in zip(rows, most, strict=True))]


def _max_joint_supports(equations: int) -> int:
    """Return how many supports of each equation are combined with those of the others."""
    counts = range(settings.MAX_KEPT, 1, -1)
    return next((count for count in counts if count**equations <= settings.MAX_TRIED_SETS), 1)


def _without_processes(fit: Fit, estimates: Sequence[Estimate]) -> tuple[Estimate, ...]:
    """Return estimates without the states of error processes."""
    width = fit.problem.models[0].width
    return tuple(
        replace(estimate, states=tuple(state[:, :width] for state in estimate.states)) for estimate in estimates
    )


def _assembled(problem: SearchProblem, rows: Rows) -> tuple[Terms, Floats, list[list[int]]]:
    """Return the terms of a law, known coefficients, and for each equation the terms of its starting values.

    Known coefficients have the shape (objects, equations, terms), NaN where they are estimated. The indices of terms of
    starting values have the order of `CandidateSupport.starts`.
    """
    whole = problem.terms
    variables, certain = whole.variables, np.nan_to_num(problem.known)
    plain = sorted({i for row in rows for i in row.plain} | {*np.flatnonzero(certain.any(axis=(0, 1))).tolist()})
    names, written, inside = list[str](), list[list[str]](), list[range]()
    for row in rows:
        written.append([])
        before = len(names)
        for candidate in row.others:
            first = len(names)
            for parameter in candidate.shared_parameters:
                names.append(free_name(parameter, (*variables.measured, *names)))
            written[-1] += candidate.expressions(variables, names[first:])
        inside.append(range(before, len(names)))
    texts = list(dict.fromkeys(text for expressions in written for text in expressions))
    texts = [*(whole.terms[i].expression(whole.variables.names) for i in plain), *texts]
    variables = replace(variables, parameters=tuple(names))
    parameters = (Term(parameter=variables.index(name)) for name in names)
    terms = Terms(variables, (*(parse_term(text, variables) for text in texts), *parameters))
    known = np.zeros((*certain.shape[:2], len(terms)))
    known[:, :, : len(plain)] = certain[:, :, plain]
    places = list[list[int]]()
    for j, (row, expressions) in enumerate(zip(rows, written, strict=True)):
        places.append(
            [*map(plain.index, row.plain), *map(texts.index, expressions), *(len(texts) + i for i in inside[j])]
        )
        known[:, j, places[j]] = np.nan
    return terms, known, places


def are_parameters_identifiable(fit: Fit) -> bool:
    """Return whether the nonlinear parameters of a law and the coefficients of their terms are separately identifiable.

    In ``V s/(K + s)`` for instance only V/K is, where s is small compared with K. There the likelihood is far from the
    normal distribution about the estimates, and the Laplace approximation of the evidence does not hold. A periodic
    forcing is identifiable if some trial contains a whole cycle, and its frequency is below the Nyquist limit of two
    samples a cycle.
    """
    terms, trials = fit.problem.terms, fit.problem.trials
    first, times = len(terms.variables.measured), [trial.times for trial in trials]
    longest, shortest = max(map(np.ptp, times)), np.concatenate([*map(np.diff, times)]).min()
    for column in frequencies_in_time(terms):
        place = terms.parameters[column - first]
        frequencies = [np.abs(estimate.coefficients[:, place]).sum() for estimate in fit.estimates]
        if np.median(frequencies) * longest < 2 * np.pi or np.max(frequencies) * shortest > np.pi:
            return False
    equations, chosen = np.nonzero(fit.supports)
    constant = ~terms.is_factor[chosen]
    is_nonlinear = constant | np.array(terms.have_parameters, dtype=bool)[chosen]
    squares = []
    for problem, estimate in zip(fit.evidence.problems, fit.estimates, strict=True):
        columns = problem.factor[:, np.flatnonzero(fit.supports)]
        try:
            inverse = np.linalg.inv(np.linalg.qr(columns, mode="r"))
        except np.linalg.LinAlgError:
            return False
        with np.errstate(over="ignore"):
            squares.append(estimate.coefficients[fit.supports] ** 2 / np.sum(inverse**2, axis=1))
    signs = np.sign([estimate.coefficients[fit.supports] for estimate in fit.estimates])
    least = np.where(np.ptp(signs, axis=0) == 0, np.median(squares, axis=0), np.min(squares, axis=0))
    is_lost = is_nonlinear & ~(least >= settings.SIGNIFICANT**2)
    return not any(
        is_lost[same].sum() > 1 and (is_lost & constant)[same].any() for same in equations == equations[:, np.newaxis]
    )
