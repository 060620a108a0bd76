"""Laws as they are found today: `python -m tests.recovery.golden [NAME ...]` writes them to golden.json."""

import json
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple
from unittest.mock import patch

import commonlaw as cl
from commonlaw.inference.fit import convergence, fit
from commonlaw.inference.result import assembly
from commonlaw.inference.verbs import collocation
from commonlaw.law.parameters import standard_errors
from tests.recovery.problems import PROBLEMS

FILE = Path(__file__).with_name("golden.json")


class Recovered(NamedTuple):
    """A law's structure, each object's parameters, its score if it has one, and how many fits that took."""

    structure: list[str]
    parameters: list[list[float]]
    errors: list[list[float]]
    score: float | None
    fits: int


@cache
def recovered(name: str) -> tuple[cl.Law, Recovered]:
    """Return the law of a problem as it is found today, and what of it is kept."""
    with _noted("fitted_law", assembly, collocation) as laws, _noted("fit_each", fit, convergence) as fits:
        law = PROBLEMS[name]()
    estimates, errors = law.coefficients[:, law.support], standard_errors(law)[:, law.support]
    # The first law is the one that is returned, others are beside it
    score = laws[0][1].score.total if laws else None
    return law, Recovered(list(law.structure), estimates.tolist(), errors.tolist(), score, len(fits))


@contextmanager
def _noted(function: str, *modules: Any) -> Iterator[list[tuple[Any, ...]]]:
    """Note what a function is called with in modules."""
    noted = list[tuple[Any, ...]]()
    with ExitStack() as stack:
        for module in modules:
            before = getattr(module, function)

            def noting(*given: Any, before: Any = before) -> Any:
                noted.append(given)
                return before(*given)

            stack.enter_context(patch.object(module, function, noting))
        yield noted


def stored() -> dict[str, Recovered]:
    """Return what was found when golden.json was written."""
    return {name: Recovered(**each) for name, each in json.loads(FILE.read_text()).items()}


def main(names: list[str]) -> None:
    """Write the laws of these problems, or of all."""
    kept = {name: each for name, each in (stored() if FILE.is_file() else {}).items() if name in PROBLEMS}
    for name in names or PROBLEMS:
        _, kept[name] = recovered(name)
        print(name, *kept[name].structure)
    listed = {name: kept[name]._asdict() for name in PROBLEMS if name in kept}
    FILE.write_text(json.dumps(listed, indent=1) + "\n")


if __name__ == "__main__":
    main(sys.argv[1:])
