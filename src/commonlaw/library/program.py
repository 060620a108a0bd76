"""Terms as a program of single operations on registers, which any machine can run: the compiled kernel does."""

import ast
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from commonlaw.array_types import Floats
from commonlaw.library.constant import Constant
from commonlaw.library.evaluation import Plan
from commonlaw.library.grammar import constant
from commonlaw.library.monomial import Monomial
from commonlaw.library.term import AbstractTerm
from commonlaw.library.trigonometric import Trigonometric

OPERATIONS = (
    "add", "subtract", "multiply", "divide", "power", "negate", "abs", "sqrt", "exp", "log", "sin", "cos", "tan",
    "sinh", "cosh", "tanh", "arctan", "sign",
)  # fmt: skip
"""The operations by their numbers; the first five have two operands."""

_BINARY: dict[type[ast.operator], str] = {
    ast.Add: "add",
    ast.Sub: "subtract",
    ast.Mult: "multiply",
    ast.Div: "divide",
}
_LONGEST_CHAIN = 16
"""Whole powers up to this are products."""


@dataclass(frozen=True, eq=False)
class Program:
    """Operations in order, each on earlier registers; common parts are computed once.

    Registers hold the variables, then the constants, then the result of each operation.

    Parameters
    ----------
    variables
        How many there are.
    constants
        Their values, shape (constants,).
    code
        Number of the operation, first and second register of each, shape (operations, 3); functions have the same
        register twice.
    outputs
        The register of each term, shape (terms,).
    """

    variables: int
    constants: Floats
    code: NDArray[np.int64]
    outputs: NDArray[np.int64]

    @classmethod
    def of(cls, plan: Plan, variables: int) -> "Program | None":
        """Return the program that computes the terms of a plan; None where a term has operations that it cannot say."""
        writer = _Writer(variables)
        try:
            registers: list[int] = []
            for term, operation in plan.steps:
                if operation is None:
                    registers.append(writer.term(term))
                else:
                    kind, left, right = operation
                    registers.append(writer.emit(kind.__name__, registers[left], registers[right]))
            return writer.program([registers[step] for step in plan.indices])
        except _UnsaidError:
            return None


class _UnsaidError(Exception):
    """A term has an operation that programs do not have."""


@dataclass
class _Writer:
    """A program that is being written; constants count from -1 downwards until their number is known."""

    variables: int
    constants: dict[float, int] = field(default_factory=dict)
    code: dict[tuple[str, int, int], int] = field(default_factory=dict)

    def emit(self, operation: str, left: int, right: int) -> int:
        """Return the register of an operation's result."""
        if operation not in OPERATIONS:
            raise _UnsaidError
        return self.code.setdefault((operation, left, right), self.variables + len(self.code))

    def constant(self, value: float) -> int:
        """Return the place of a constant."""
        return self.constants.setdefault(value, -1 - len(self.constants))

    def term(self, term: AbstractTerm) -> int:
        """Return the register of a term that a plan does not take apart."""
        if isinstance(term, Constant):
            return self.constant(0.0)
        if isinstance(term, Monomial):
            return next(iter(term.columns())) if term.degree else self.constant(1.0)
        if isinstance(term, Trigonometric):
            angle = term.variable
            if term.frequency != 1:
                angle = self.emit("multiply", self.constant(term.frequency), angle)
            return self.emit(term.function, angle, angle)
        return self.tree(ast.parse(term.expression([f"v{i}" for i in range(self.variables)]), mode="eval").body)

    def tree(self, tree: ast.expr) -> int:
        """Return the register of an expression in the grammar's form."""
        number = constant(tree)
        if number is not None:
            return self.constant(number)
        match tree:
            case ast.Name(id=name):
                return int(name[1:])
            case ast.UnaryOp(op=ast.UAdd(), operand=operand):
                return self.tree(operand)
            case ast.UnaryOp(op=ast.USub(), operand=operand):
                return self.function("negate", self.tree(operand))
            case ast.Call(func=ast.Name(id=name), args=[operand]):
                return self.function(name, self.tree(operand))
            case ast.BinOp(op=ast.Pow(), left=base, right=exponent):
                return self.power(self.tree(base), exponent)
            case ast.BinOp(op=op, left=left, right=right) if type(op) in _BINARY:
                return self.emit(_BINARY[type(op)], self.tree(left), self.tree(right))
        raise _UnsaidError

    def function(self, name: str, operand: int) -> int:
        """Return the register of a function of one register."""
        return self.emit(name, operand, operand)

    def power(self, base: int, above: ast.expr) -> int:
        """Return the register of a power; small whole ones are products."""
        exponent = constant(above)
        if exponent is None:
            return self.emit("power", base, self.tree(above))
        if exponent == 0:
            return self.constant(1.0)
        size = abs(exponent)
        if not (size == int(size) and size <= _LONGEST_CHAIN):
            return self.emit("power", base, self.constant(exponent))
        found = base
        for _ in range(int(size) - 1):
            found = self.emit("multiply", found, base)
        return found if exponent > 0 else self.emit("divide", self.constant(1.0), found)

    def program(self, outputs: Sequence[int]) -> Program:
        """Return the program, registers being counted as it says."""
        code = [(OPERATIONS.index(name), self._place(left), self._place(right)) for name, left, right in self.code]
        return Program(
            self.variables,
            np.array(list(self.constants), dtype=np.float64),
            np.array(code, dtype=np.int64).reshape(-1, 3),
            np.array([self._place(each) for each in outputs], dtype=np.int64),
        )

    def _place(self, register: int) -> int:
        """Return where a register is when the number of constants is known."""
        if register < 0:
            return self.variables - 1 - register
        return register if register < self.variables else register + len(self.constants)
