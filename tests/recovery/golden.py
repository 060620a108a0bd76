"""Laws as they are found today: `python -m tests.recovery.golden [NAME ...]` writes them to golden.json."""

import json
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple
from unittest.mock import patch

from commonlaw.inference.result import assembly
from commonlaw.inference.verbs import refinement
from tests.recovery.problems import PROBLEMS

FILE = Path(__file__).with_name("golden.json")


class Recovered(NamedTuple):
    """A law's structure, the parameters of each object, and minus twice the log-evidence if the law has one."""

    structure: list[str]
    parameters: list[list[float]]
    errors: list[list[float]]
    score: float | None


def recovered(name: str) -> Recovered:
    """Return what is found today."""
    with _score() as score:
        law = PROBLEMS[name]()
    estimates, errors = law.coefficients[:, law.support], law.standard_errors[:, law.support]
    return Recovered(list(law.structure()), estimates.tolist(), errors.tolist(), score[0] if score else None)


@contextmanager
def _score() -> Iterator[list[float]]:
    """Note the score of each law that is fitted: first of that which is returned, then of others beside it."""
    noted = list[float]()

    def of(module: Any) -> Any:
        before = module.fitted_law

        def fitted_law(template: Any, fit: Any, *settings: Any) -> Any:
            noted.append(fit.score.total)
            return before(template, fit, *settings)

        return patch.object(module, "fitted_law", fitted_law)

    with of(assembly), of(refinement):
        yield noted


def stored() -> dict[str, Recovered]:
    """Return what was found when golden.json was written."""
    return {name: Recovered(**each) for name, each in json.loads(FILE.read_text()).items()}


def main(names: list[str]) -> None:
    """Write the laws of these problems, or of all."""
    kept = {name: each for name, each in (stored() if FILE.is_file() else {}).items() if name in PROBLEMS}
    for name in names or PROBLEMS:
        kept[name] = recovered(name)
        print(name, *kept[name].structure)
    listed = {name: kept[name]._asdict() for name in PROBLEMS if name in kept}
    FILE.write_text(json.dumps(listed, indent=1) + "\n")


if __name__ == "__main__":
    main(sys.argv[1:])
