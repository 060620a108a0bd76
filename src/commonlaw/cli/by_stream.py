"""What commands do that learn a law from files, which are gone through one by one, here or by workers."""

from collections.abc import Callable
from typing import TYPE_CHECKING

from commonlaw.cli.later import LaterSteps
from commonlaw.cli.learned import Learned, Outputs
from commonlaw.cli.on_cluster import few_trials, stream_of
from commonlaw.cli.source import Source
from commonlaw.runtime.progress import ProgressCallback, part
from commonlaw.trials import TrialStream

if TYPE_CHECKING:
    from commonlaw.law import Law


def learned_by_stream(
    source: Source,
    outputs: Outputs,
    show: ProgressCallback,
    find: "Callable[[TrialStream, ProgressCallback], Law]",
    explain: "Callable[[Law, LaterSteps], Law]" = lambda law, _: law,
) -> tuple[Learned, LaterSteps]:
    """Find a law in files; it is checked by forecasts of all that is held out, or else of a few trials."""
    show("listing the files")
    stream, later = stream_of(source), LaterSteps()
    training = source.select(stream)
    law = find(training, part(show, 0.05, 0.9))
    outputs.keep(law, later)
    law = explain(law, later)
    few = few_trials(training)
    if source.holds_out:
        return Learned.check_by_stream(law, source.held_out(stream), training, few, show, later), later
    show("checking the law by forecasts of a few trials")
    return Learned.check(law, source, few, few, bool(outputs.plot), later, stream), later
