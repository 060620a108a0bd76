"""Terms as a program of single operations on registers, with its derivatives; NumPy runs it, and so does the kernel."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from commonlaw.array_types import Floats
from commonlaw.library.functions import Function
from commonlaw.library.grammar import OPERATIONS, Algebra, evaluate
from commonlaw.runtime.forking import cached_property

_NAMES = tuple(OPERATIONS)

_Slope = Callable[[Any, Any, Any], Any]


def _root_or_power_slope(x: Any, y: Any, _: Any) -> Any:
    return np.where((x == 0) & (y > 0) & (y < 1), 0.0, y * x ** (y - 1))


_SLOPES: Mapping[str, tuple[_Slope, ...]] = {
    "add": (lambda *_: 1.0, lambda *_: 1.0),
    "subtract": (lambda *_: 1.0, lambda *_: -1.0),
    "multiply": (lambda _x, y, _: y, lambda x, *_: x),
    "divide": (lambda _x, y, _: 1 / y, lambda _x, y, value: -value / y),
    # That of a power of zero by its exponent is zero whatever stands above. Infinite slopes of roots at zero are zero,
    # so that ``sqrt(max(x, 0))`` has derivatives where it is constant
    "power": (_root_or_power_slope, lambda x, _, value: np.where(value == 0, 0.0, value * np.log(x))),
    "arctan2": (lambda y, x, _: x / (x * x + y * y), lambda y, x, _: -y / (x * x + y * y)),
    "negate": (lambda *_: -1.0,),
    "abs": (lambda x, *_: np.sign(x),),
    "sqrt": (lambda _x, _, value: np.where(value == 0, 0.0, 0.5 / value),),
    "exp": (lambda _x, _, value: value,),
    "log": (lambda x, *_: 1 / x,),
    "sin": (lambda x, *_: np.cos(x),),
    "cos": (lambda x, *_: -np.sin(x),),
    "tan": (lambda _x, _, value: 1 + value**2,),
    "sinh": (lambda x, *_: np.cosh(x),),
    "cosh": (lambda x, *_: np.sinh(x),),
    "tanh": (lambda x, *_: 1 / np.cosh(x) ** 2,),
    "arctan": (lambda x, *_: 1 / (1 + x**2),),
    "sign": (lambda x, *_: 0.0 * x,),
    "step": (lambda x, *_: 0.0 * x,),
    "arcsin": (lambda x, *_: 1 / np.sqrt((1 - x) * (1 + x)),),
    "arccos": (lambda x, *_: -1 / np.sqrt((1 - x) * (1 + x)),),
    "arcsinh": (lambda x, *_: 1 / np.sqrt(1 + x * x),),
    "arccosh": (lambda x, *_: 1 / (np.sqrt(x - 1) * np.sqrt(x + 1)),),
    "arctanh": (lambda x, *_: 1 / ((1 - x) * (1 + x)),),
    "log10": (lambda x, *_: 1 / (np.log(10) * x),),
    "log2": (lambda x, *_: 1 / (np.log(2) * x),),
    "erf": (lambda x, *_: 2 / np.sqrt(np.pi) * np.exp(-x * x),),
    "erfc": (lambda x, *_: -2 / np.sqrt(np.pi) * np.exp(-x * x),),
    "floor": (lambda x, *_: 0.0 * x,),
    "ceil": (lambda x, *_: 0.0 * x,),
}
"""The derivatives of each operation by its operands x and y, given its value."""


@dataclass(frozen=True, eq=False)
class Program:
    """Operations in order, each on earlier registers; common parts are computed once.

    A polynomial then costs one multiplication a term: ``x^2 v`` is ``x^2`` times v. A term has one way of being
    computed, so its value does not depend on the others. Registers hold so many variables, then `constants`, then the
    results of `code`: number of the operation and registers of its operands, shape (operations, 3), functions with the
    same one twice. Numbers behind those of `OPERATIONS` are `calls` of functions of Python with the registers of their
    arguments, which only NumPy runs. `outputs` are the registers of the terms.
    """

    variables: int
    constants: Floats
    code: NDArray[np.int64]
    outputs: NDArray[np.int64]
    calls: tuple[tuple[Function, tuple[int, ...]], ...] = ()

    @classmethod
    def of(
        cls,
        products: Sequence[Sequence[tuple[str, int]] | None],
        variables: int,
        functions: Sequence[Function] = (),
    ) -> "Program":
        """Return the program of products of powers of expressions over ``v<i>``; None stands for the number zero."""
        writer = _Writer(variables, functions)
        outputs = [writer.constant(0.0) if product is None else writer.product(product) for product in products]

        def place(register: int) -> int:
            if register < 0:
                return variables - 1 - register
            return register if register < variables else register + len(writer.constants)

        code, calls = list[tuple[int, int, int]](), list[tuple[Function, tuple[int, ...]]]()
        for operation, registers in writer.code:
            operands = tuple(map(place, registers))
            if isinstance(operation, Function):
                code.append((len(_NAMES) + len(calls), operands[0], operands[-1]))
                calls.append((operation, operands))
            else:
                code.append((_NAMES.index(operation), operands[0], operands[-1]))
        return cls(
            variables,
            np.array(list(writer.constants), dtype=np.float64),
            np.array(code, dtype=np.int64).reshape(-1, 3),
            np.array([place(output) for output in outputs], dtype=np.int64),
            tuple(calls),
        )

    def with_variables(self, more: int) -> "Program":
        """Return the program over so many more variables behind the others, which it does not use."""

        def moved(registers: NDArray[np.int64]) -> NDArray[np.int64]:
            return np.where(registers < self.variables, registers, registers + more)

        code = np.column_stack([self.code[:, :1], moved(self.code[:, 1:])])
        calls = tuple((function, tuple(moved(np.array(operands)).tolist())) for function, operands in self.calls)
        return Program(self.variables + more, self.constants, code, moved(self.outputs), calls)

    def evaluate(self, values: Floats, out: Floats | None = None) -> Floats:
        """Return the terms as the columns of a matrix in Fortran order, shape (n, terms), at rows of variables."""
        matrix = np.empty((len(values), len(self.outputs)), order="F") if out is None else out
        columns = list(matrix.T)
        registers = self._run(values, columns)
        for column, register in zip(columns, self._outputs, strict=True):
            if registers[register] is not column:
                column[:] = registers[register]
        return matrix

    def jacobian(self, values: Floats) -> Floats:
        """Return the derivatives of the terms by every variable, shape (n, terms, variables)."""
        registers = self._run(values)
        slopes: list[dict[int, Any]] = [{i: 1.0} for i in range(self.variables)]
        slopes += [{} for _ in self.constants]
        with np.errstate(all="ignore"):
            for place, (operation, operands) in enumerate(self._steps, len(slopes)):
                derivatives = dict[int, Any]()
                inside = [registers[operand] for operand in operands]
                if isinstance(operation, Function):
                    outers: list[Any] = (
                        operation.slopes(*inside) if any(slopes[operand] for operand in operands) else []
                    )
                else:
                    outers = [
                        slope(inside[0], inside[-1], registers[place]) if slopes[operand] else None
                        for slope, operand in zip(_SLOPES[operation], operands, strict=True)
                    ]
                for outer, operand in zip(outers, operands, strict=False):
                    if slopes[operand]:
                        for i, inner in slopes[operand].items():
                            derivatives[i] = derivatives[i] + outer * inner if i in derivatives else outer * inner
                slopes.append(derivatives)
        result = np.zeros((len(self.outputs), self.variables, len(values)))
        for block, register in zip(result, self._outputs, strict=True):
            for i, slope in slopes[register].items():
                block[i] = slope
        return result.transpose(2, 0, 1)

    @cached_property
    def _steps(self) -> list[tuple[str | Function, tuple[int, ...]]]:
        """The operations by their names, with the registers of their operands."""
        return [
            self.calls[number - len(_NAMES)]
            if number >= len(_NAMES)
            else (_NAMES[number], (first, second)[: len(_SLOPES[_NAMES[number]])])
            for number, first, second in self.code.tolist()
        ]

    @cached_property
    def _outputs(self) -> list[int]:
        return [int(register) for register in self.outputs]

    @cached_property
    def _runs(self) -> list[tuple[Callable[..., Any], tuple[int, ...], int | None]]:
        """The operations, the registers of their operands, and the term that each is the first to be."""
        first, terms = self.variables + len(self.constants), dict[int, int]()
        for k, register in enumerate(self._outputs):
            terms.setdefault(register, k)
        return [
            (operation if isinstance(operation, Function) else OPERATIONS[operation], operands, terms.get(place))
            for place, (operation, operands) in enumerate(self._steps, first)
        ]

    def _run(self, values: Floats, columns: Sequence[Floats] | None = None) -> list[Any]:
        """Return what is in each register; results that are terms are in the columns that are given for them."""
        registers: list[Any] = [*np.ascontiguousarray(values.T), *self.constants.tolist()]
        with np.errstate(all="ignore"):
            for operation, operands, term in self._runs:
                out = None if term is None or columns is None else columns[term]
                registers.append(operation(*[registers[operand] for operand in operands], out=out))
        return registers


class _Writer:
    """A program that is being written; constants count from -1 downwards until their number is known."""

    def __init__(self, variables: int, functions: Sequence[Function]) -> None:
        self.variables = range(variables)
        self.constants: dict[float, int] = {}
        self.code: dict[tuple[str | Function, tuple[int, ...]], int] = {}
        known: dict[str, Callable[..., int]] = {name: partial(self.emit, name) for name in OPERATIONS}
        self.algebra = Algebra(
            self.constant, known | {function.name: partial(self.add, function) for function in functions}
        )

    def constant(self, value: float) -> int:
        """Return the place of a constant."""
        return self.constants.setdefault(float(value), -1 - len(self.constants))

    def product(self, powers: Sequence[tuple[str, int]]) -> int:
        """Return the register of a product of powers."""
        above, below = (
            [evaluate(code, self.variables, self.algebra) for code, power in powers for _ in range(side * power)]
            for side in (1, -1)
        )
        return self.chain(above) if not below else self.emit("divide", self.chain(above), self.chain(below))

    def chain(self, registers: Sequence[int]) -> int:
        """Return the register of a product, from the left to the right."""
        if not registers:
            return self.constant(1.0)
        result, *others = registers
        for register in others:
            result = self.emit("multiply", result, register)
        return result

    def emit(self, name: str, left: int, right: int | None = None) -> int:
        """Return the register of an operation's result; that of constants is a constant."""
        operands = (left,) if right is None else (left, right)
        if max(operands) < 0:
            values = list(self.constants)
            with np.errstate(all="ignore"):
                return self.constant(OPERATIONS[name](*(np.float64(values[-1 - operand]) for operand in operands)))
        if name == "power" and right is not None and right < 0:
            exponent = list(self.constants)[-1 - right]
            # Whole powers up to 16 are products
            if exponent.is_integer() and abs(exponent) <= 16:
                size = int(abs(exponent))
                return (
                    self.chain([left] * size)
                    if exponent >= 0
                    else self.emit("divide", self.constant(1.0), self.chain([left] * size))
                )
        return self.add(name, *operands)

    def add(self, operation: str | Function, *operands: int) -> int:
        """Return the register of the result of an operation, or of a call."""
        return self.code.setdefault((operation, operands), len(self.variables) + len(self.code))
