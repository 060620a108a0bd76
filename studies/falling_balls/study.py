"""The study from end to end: what it starts from, its parts one after the other, the report."""

import os
from collections.abc import Callable, Mapping

from commonlaw.datasets import ball_drops
from commonlaw.errors import CommonlawError
from commonlaw.runtime.shutdown import end_with_parent
from studies.falling_balls.candidates import candidates
from studies.falling_balls.data import data
from studies.falling_balls.default_method import default_method
from studies.falling_balls.drag_regimes import drag_regimes
from studies.falling_balls.findings import findings
from studies.falling_balls.inquiry import Inquiry
from studies.falling_balls.learned_terms import learned_terms
from studies.falling_balls.model_error import model_error
from studies.falling_balls.next_experiment import next_experiment
from studies.falling_balls.numerical_differentiation import numerical_differentiation
from studies.falling_balls.report import Report, Section
from studies.falling_balls.reynolds_drag import reynolds_drag
from studies.falling_balls.settings import SEED
from studies.falling_balls.simulated_drops import simulated_drops
from studies.falling_balls.sparsity_path import sparsity_path
from studies.falling_balls.universal_laws import universal_laws
from studies.falling_balls.worked_examples import worked_examples

TITLE = "Falling balls: what data say about a law of physics"

PARTS: Mapping[str, Callable[[Inquiry], Section]] = {
    "The balls and their drops": data,
    "Drag on a sphere": drag_regimes,
    "Candidate terms": candidates,
    "Learned terms": learned_terms,
    "Simulated drops with linear drag": simulated_drops,
    "Simulated drops with Reynolds-dependent drag": reynolds_drag,
    "How well the models predict": model_error,
    "What the default method says of the drops": default_method,
    "Rates from noisy heights": numerical_differentiation,
    "How the threshold decides": sparsity_path,
    "Worked examples": worked_examples,
    "Universal laws and discrepancies": universal_laws,
    "Which experiment next": next_experiment,
}
"""The parts by title."""

LAST = "Findings"
"""The title of the last part, which rests on the results of all others."""

_SUMMARY = """
Ten sports balls were dropped from a bridge, twice each, and filmed. Can a machine find the law of falling bodies in
such data: gravity, and the drag of the air? De Silva, Higdon, Brunton and Kutz asked this in
[Discovery of Physics from Data: Universal Laws and Discrepancies](https://doi.org/10.3389/frai.2020.00025) (2020). This
report does their work again from the measurements on, and sets each result beside what they printed.

The method: the heights $x$ are smoothed and differentiated to speeds $v$ and accelerations; the acceleration is fitted
as a sum of few candidate terms, $\\ddot x = c_1 + c_2 x + c_3 v + c_4 x v + \\dots$; terms whose coefficients stay
below a threshold are dropped, and the rest is fitted again. A *single-trial* model does so for each ball by itself.
The *group* method lets all balls vote: they share the terms, and each keeps its own coefficients.

Each part ends in a verdict. *Reproduced* means that the printed numbers, or the statement made, come out.
*Reproduced with correction* means that the print errs, and that the method, done right, gives what is said.
*Differs* means that something else comes out. *Beyond the paper* is what it did not ask.
"""


def inquire(folder: str | os.PathLike[str] | None = None, seed: int = SEED, simulated_only: bool = False) -> Inquiry:
    """Return what the study starts from.

    Parameters
    ----------
    folder
        The folder of the measured drops. By default they are looked for where `commonlaw.datasets.ball_drops` looks,
        and the study does without them where they are not to be had.
    seed
        Of the simulated noise.
    simulated_only
        Leave the measured drops out.

    Raises
    ------
    CommonlawError
        If a folder is given and does not hold the measured drops.
    """
    if simulated_only:
        return Inquiry(None, "they were left out as asked", seed)
    try:
        return Inquiry(ball_drops(folder), "", seed)
    except CommonlawError as error:
        if folder is not None:
            raise
        return Inquiry(None, str(error), seed)


def run(inquiry: Inquiry, started: Callable[[str], None] | None = None) -> Report:
    """Return the report of the whole study.

    Parameters
    ----------
    inquiry
        What it starts from, see `inquire`.
    started
        Called with the title of each part when its turn comes.
    """
    from joblib import Parallel, delayed

    # Parts know nothing of each other, and are the same whoever does them
    parallel = Parallel(n_jobs=-1, return_as="generator", pre_dispatch="all", initializer=end_with_parent)
    found = parallel(delayed(part)(inquiry) for part in PARTS.values())
    sections: list[Section] = []
    titles = (*PARTS, LAST)
    for number, title in enumerate(titles, start=1):
        if started is not None:
            started(f"Part {number} of {len(titles)}: {title}")
        if title in PARTS:
            sections.append(next(found))
    results = {key: value for section in sections for key, value in section.results.items()}
    return Report(TITLE, _SUMMARY, (*sections, findings(inquiry, results)))
