"""Terms with parameters inside that are to be found: ``s/(K + s)``, families of them by name, and ratios of sums.

Terms may share a constant: of ``A cos(w t + p) = a cos(w t) + b sin(w t)`` w alone is inside, and a and b are linear.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import chain, combinations, count

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.errors import CommonlawError, check_choice
from commonlaw.library.equation import split_equations, with_parameters
from commonlaw.library.notation import quoted
from commonlaw.library.term import Term, parse_term, product
from commonlaw.library.variables import Variables


@dataclass(frozen=True)
class ParametricTerm:
    """A candidate term over variables and, behind them, nonlinear parameters of any values.

    Where it equals a sum of terms with fewer parameters, ``cos(w t + p)`` of ``cos(w t)`` and ``sin(w t)``, a law has
    these `tied` terms in its place, with a coefficient before each; the term itself is compared with others.
    """

    term: Term
    parameters: tuple[str, ...]
    tied: "tuple[ParametricTerm, ...]" = ()

    @property
    def parts(self) -> "tuple[ParametricTerm, ...]":
        """The terms that a law has."""
        return self.tied or (self,)

    @property
    def shared_parameters(self) -> tuple[str, ...]:
        """The nonlinear parameters that these share."""
        return self.parts[0].parameters

    @property
    def size(self) -> int:
        """How many terms a law has."""
        return len(self.parts)

    def text(self, variables: Variables) -> str:
        """Return ``s/(K + s)``, or ``cos(w*t), sin(w*t)``."""
        return ", ".join(part.term.text((*variables.measured, *part.parameters)) for part in self.parts)

    def expressions(self, variables: Variables, parameters: Sequence[str]) -> list[str]:
        """Return the terms that a law has for `parse_term`, with other names of their parameters."""
        return [part.term.expression((*variables.measured, *parameters)) for part in self.parts]

    def times(self, factor: Term) -> "ParametricTerm":
        """Return the product with a plain term."""
        return replace(self, term=product(factor, self.term), tied=tuple(part.times(factor) for part in self.tied))


@dataclass(frozen=True)
class Ratio:
    """One ratio of two sums of terms with coefficients, of which that of the term `reference` below is one.

    As terms with parameters these are ``s/(K + s)``, ``s^2/(K + s)``: they share as parameters the coefficients of the
    other terms below.
    """

    above: tuple[Term, ...]
    below: tuple[Term, ...]
    reference: int
    shared_parameters: tuple[str, ...]

    @property
    def size(self) -> int:
        """How many terms it is: as many as there are above."""
        return len(self.above)

    @property
    def degree(self) -> int:
        """The power of a parameter added to one term below: 2 in ``K^2 + s^2``, so that K is a value of s."""
        reference = self.below[self.reference]
        pure = reference.exponents is not None and len(reference.columns()) == 1 and len(self.below) == 2
        return int(reference.complexity()) if pure else 1

    def expressions(self, variables: Variables, parameters: Sequence[str]) -> list[str]:
        """Return each of its terms for `parse_term`, with these names of its parameters."""
        names, free, written = variables.measured, list(parameters), list[str]()
        for i, term in enumerate(self.below):
            text = term.expression(names)
            if i == self.reference:
                written.append(text)
            elif term.columns():
                written.append(f"{free.pop(0)}*{text}")
            else:
                written.append(f"{free.pop(0)}**{self.degree}" if self.degree > 1 else free.pop(0))
        return [f"({term.expression(names)})/({' + '.join(written)})" for term in self.above]

    def values_of_parameters(self, below: Floats) -> list[float] | None:
        """Return the parameters from coefficients below, shape (terms below,).

        None if the coefficient of `reference` is zero, or an even power would have to be negative.
        """
        with np.errstate(all="ignore"):
            scaled = below / below[self.reference]
        result = []
        for i, (term, value) in enumerate(zip(self.below, scaled.tolist(), strict=True)):
            if i != self.reference:
                power = 1 if term.columns() else self.degree
                if not np.isfinite(value) or (value <= 0 and power % 2 == 0):
                    return None
                result.append(float(np.sign(value) * abs(value) ** (1 / power)))
        return result


@dataclass(frozen=True)
class Ratios:
    """Ratios of sums of terms `above` over sums of terms `below`, with plain terms `added`."""

    above: tuple[Term, ...]
    below: tuple[Term, ...]
    added: tuple[Term, ...] = ()

    def ratio(
        self, above: Sequence[int], below: Sequence[int], variables: Variables, sizes: Floats | None = None
    ) -> Ratio:
        """Return the ratio of sums of some terms above and some below, by their indices.

        The coefficient one goes to the largest by these sizes, or else the first, of those below that hold a variable.
        """
        terms, names = tuple(self.below[i] for i in below), list[str]()
        sizes = np.ones(len(terms)) if sizes is None else sizes
        reference = max((i for i, term in enumerate(terms) if term.columns()), key=lambda i: float(sizes[i]))
        for name in _PARAMETER_NAMES[: len(below) - 1]:
            names.append(free_name(name, (*variables.measured, *names)))
        return Ratio(tuple(self.above[i] for i in above), terms, reference, tuple(names))

    def is_reduced(self, above: Sequence[int], below: Sequence[int]) -> bool:
        """Whether no variable cancels in a ratio: ``s/(K + s)``, but not ``s^2/(K s + s^2)``."""
        terms = (*(self.above[i] for i in above), *(self.below[i] for i in below))
        exponents = [term.exponents for term in terms]
        columns = [exponent.keys() for exponent in exponents if exponent is not None]
        return len(columns) < len(terms) or not set(columns[0]).intersection(*columns)


def parameters_in(expression: str, variables: Variables) -> tuple[str, ...]:
    """Return the names inside a term that are no variables: parameters.

    >>> parameters_in("s/(K + s)", Variables(("s",)))
    ('K',)
    """
    try:
        (equation,) = split_equations(f"y' = {expression}")
        extended = with_parameters(variables, [equation])
        if any(summand.coefficients for summand in equation.summands(extended)):
            return ()
    except CommonlawError:  # The reader of the term says what is wrong with it
        return ()
    return tuple(parameter for parameter in extended.parameters if parameter not in variables.parameters)


@lru_cache(maxsize=4096)
def parametric_term(expression: str, variables: Variables) -> ParametricTerm:
    """Return the term of an expression, see `parse_term`, in which other names than variables are parameters."""
    return _read(expression, variables, parameters_in(expression, variables))


def _read(expression: str, variables: Variables, parameters: tuple[str, ...]) -> ParametricTerm:
    whole = replace(variables, parameters=(*variables.parameters, *parameters))
    return ParametricTerm(parse_term(expression, whole), parameters)


@dataclass(frozen=True)
class Family:
    """Functions with a name: of a variable ``{u}``, of pairs ``{u}`` and ``{w}``, of time or not, and where they occur.

    `tied` are functions that share their parameters, behind the one that equals a sum of them, see `ParametricTerm`.
    `of_vectors` are functions of a component ``{u}`` of a vector, ``{s}`` its squared length and ``{p}`` a parameter.
    """

    functions: tuple[str, ...]
    where: str
    of_pairs: tuple[str, ...] = ()
    tied: tuple[tuple[str, ...], ...] = ()
    of_vectors: tuple[str, ...] = ()
    of_time: bool = False


FAMILIES: Mapping[str, Family] = {
    "saturating": Family(
        ("{u}/(K + {u})", "1/(K + {u})"),
        "enzymes (Michaelis and Menten), growth on a substrate (Monod), predators that are sated (Holling), adsorption",
    ),
    "hill": Family(
        ("{u}^2/(K^2 + {u}^2)", "1/(K^2 + {u}^2)", "abs({u})^n/(K^n + abs({u})^n)"),
        "genes that are switched on or off, cooperative binding, grazing with a threshold",
    ),
    "exponential": Family(
        ("exp({u}/U)",), "diodes, reaction rates by temperature, adsorption where molecules repel each other"
    ),
    "power": Family(
        ("abs({u})^p", "abs({u})^p*sign({u})"), "drag, growth by body mass, flow through porous media, hysteresis"
    ),
    "logarithm": Family(("log({u})",), "growth of tumours (Gompertz), forces that change by ratios"),
    "reciprocal": Family(
        ("1/{u}", "1/{u}^2"), "drops that evaporate, oxide films that grow by diffusion, charges and magnets on a line"
    ),
    "root": Family(("sqrt({u})",), "tanks that drain (Torricelli), orifices and valves"),
    "sigmoid": Family(
        ("1/(1 + exp(-(a*{u} + c)))", "tanh({u}/U)"),
        "populations of nerve cells, switches, actuators that reach a limit",
        of_pairs=("1/(1 + exp(-(a*{u} + b*{w} + c)))",),
    ),
    "periodic": Family(
        ("cos(w*{u})", "sin(w*{u})"),
        "drives of unknown frequency and phase, seasons, lattices, ratchets",
        tied=(("cos(w*{u} + p)", "cos(w*{u})", "sin(w*{u})"),),
        of_time=True,
    ),
    "trigonometric": Family(
        ("sin({u})", "cos({u})", "sin(2*{u})"),
        "pendulums, beads on turning hoops (twice the angle), coupled clocks (Kuramoto), anything that turns",
        of_pairs=("sin({u} - {w})", "cos({u} - {w})"),
    ),
    "polar": Family(
        (),
        "gliders, orbits, anything whose course turns by a force over its speed or distance",
        of_pairs=("sin({u})/{w}", "cos({u})/{w}", "sin({w})/{u}", "cos({w})/{u}"),
    ),
    "central": Family(
        (),
        "orbits (Kepler), charges, springs in a plane; drag along a velocity, whose size it depends on",
        of_vectors=("{u}*{s}^{p}", "{u}*sqrt({s})", "{u}/sqrt({s})", "{u}/{s}^1.5"),
    ),
    "contact": Family(("sign({u})", "abs({u})"), "dry friction, valves and diodes that open one way, stops"),
    "friction": Family(("{u}/(e + abs({u}))",), "dry friction (Coulomb) that is smooth about rest"),
    "morse": Family(
        (),
        "bonds of molecules (Morse): repulsion that decays twice as fast as attraction",
        tied=(("exp(({u} - c)/U) - exp(2*({u} - c)/U)", "exp({u}/U)", "exp(2*{u}/U)"),),
    ),
}
"""Families by their names."""


def terms_of_family(name: str, variables: Variables, chosen: Sequence[str] | None = None) -> tuple[ParametricTerm, ...]:
    """Return the terms of a family over the chosen variables; default: states, inputs and, if due, time.

    Vectors have the chosen variables as components; by default all states, or of four and more each half: positions,
    and velocities.

    Raises `CommonlawError` if there is no such family or variable.
    """
    check_choice("family", name, FAMILIES)
    family, asked = FAMILIES[name], chosen is not None
    if chosen is None:
        chosen = (*variables.states, *variables.inputs, *((variables.time,) if family.of_time else ()))
    names = [variables.measured[variables.index(variable)] for variable in chosen]
    pairs = list(combinations([variable for variable in names if variable != variables.time], 2))
    result = [_of(text, variables, (u, "")) for u in names for text in family.functions]
    tied = [[_of(text, variables, (u, "")) for text in texts] for u in names for texts in family.tied]
    of_pairs = [_of(text, variables, pair) for pair in pairs for text in family.of_pairs]
    half, rest = divmod(len(variables.states), 2)
    vectors: list[Sequence[str]] = [names] if asked else [variables.states]
    if not asked and half > 1 and not rest:
        vectors = [variables.states[:half], variables.states[half:]]
    of_vectors, free = [], free_name("p", variables.names)
    for components in (vector for vector in vectors if len(vector) > 1):
        squared = "(" + " + ".join(f"{quoted(component)}^2" for component in components) + ")"
        texts = (text.format(u=quoted(u), s=squared, p=free) for u in components for text in family.of_vectors)
        of_vectors += [parametric_term(text, variables) for text in texts]
    return (*result, *(replace(whole, tied=tuple(parts)) for whole, *parts in tied), *of_pairs, *of_vectors)


_PARAMETER_NAMES = "KLMNPQRSTUVW"
_ANY = Variables(("u_", "w_"))


@lru_cache(maxsize=4096)
def _of(text: str, variables: Variables, names: tuple[str, str]) -> ParametricTerm:
    """Return a function of a family of variables of these names; its parameters have names that are no variables."""
    whole = parametric_term(text.format(u=_ANY.states[0], w=_ANY.states[1]), _ANY)
    free = tuple(free_name(parameter, variables.names) for parameter in whole.parameters)
    return _read(whole.term.expression((*names, "", *free)), variables, free)


def free_name(name: str, taken: Sequence[str]) -> str:
    """Return a name, or with the first number behind it that makes it another than those that are taken.

    >>> free_name("K", ("K", "x"))
    'K2'
    """
    return next(candidate for candidate in chain([name], (f"{name}{i}" for i in count(2))) if candidate not in taken)
