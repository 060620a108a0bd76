"""`commonlaw design`: which experiment next."""

from math import inf

import click

from commonlaw.cli.artifacts import Artifacts
from commonlaw.cli.command import command, working
from commonlaw.cli.options import AS_JSON, LAW_ARGUMENT, ReadFile, by_name, numbers, saving
from commonlaw.cli.output import print_json, say
from commonlaw.cli.source import WITH_LAW, Source, with_table


@command
@with_table(*WITH_LAW)
@LAW_ARGUMENT
@click.option(
    "--vary",
    metavar="NAME=VALUES",
    multiple=True,
    help="What can be set: a range x=5..60, a list rate=15,30, or one value; NAME is a state or rate where trials "
    "start, duration, rate, samples, repeats, object (names, or each), object.PROPERTY of a new object, an input, "
    "INPUT.shape or INPUT.period, the amount of a dose, DOSE.at or DOSE.every; repeat for more.",
)
@click.option(
    "--within",
    metavar="NAME=RANGE",
    multiple=True,
    help="A trial ends where a state leaves this range: x=0..100; repeat for more.",
)
@click.option(
    "--start-std",
    metavar="NAME=STD",
    multiple=True,
    help="How far starts are off from what is set: v=0 where exactly; repeat for more.  [default: only the experiment "
    "itself tells them]",
)
@click.option(
    "--cost",
    metavar="NAME=PRICE",
    multiple=True,
    help="Price of a trial, a sample, a unit of anything that is set, or a trial of an object by its name; repeat for "
    "more.  [default: 1 for each trial]",
)
@click.option("--budget", type=click.FloatRange(0, min_open=True), default=inf, help="What all may cost together.")
@click.option(
    "--at-most", type=click.IntRange(1), default=1, help="Experiments; fewer where the law is settled before."
)
@click.option(
    "--for",
    "about",
    metavar="WHAT",
    help="What is to be learned: law, coefficients, one of them ('c of Ball 3'), or a forecast ('x at t=10 from 100')."
    "  [default: law, if that is in doubt, else coefficients]",
)
@click.option(
    "--rival",
    "rivals",
    metavar="LAW.json",
    multiple=True,
    type=ReadFile(),
    help="Another law that is as probable; repeat for more.",
)
@click.option("--seed", type=click.IntRange(0), default=0, help="Of random numbers.")
@saving(table="a table of the experiments", figure="a figure of what the laws forecast of them")
@AS_JSON
def design(
    source: Source,
    law_path: str,
    vary: tuple[str, ...],
    within: tuple[str, ...],
    start_std: tuple[str, ...],
    cost: tuple[str, ...],
    budget: float,
    at_most: int,
    about: str | None,
    rivals: tuple[str, ...],
    seed: int,
    save: tuple[str, ...],
    as_json: bool,
) -> None:
    """Find the most informative experiment: on which law is right, on its coefficients, or on a quantity of interest.

    Each plausible law predicts the measurements with all errors; differences that refitting would remove do not count.
    With TABLE, settings that are not varied are those of its trials.

    \b
    Examples:
      commonlaw design drops.csv law.json --vary "x=5..60" --vary "duration=1..4" --within "x=0..60"
      commonlaw design law.json --vary x=5..60 --vary v=-10..0 --vary duration=1..6 --vary rate=15..240 --at-most 3
      commonlaw design drops.csv law.json --vary "x=5..60" --for "x at t=10 from 100"
    """
    import commonlaw as cl

    laws = [cl.Law.load(path) for path in (law_path, *rivals)]
    with working("Looking for experiments ...") as show:
        given = source.path or source.dataset
        trials = source.chosen(laws[0].schema) if given else None
        found = cl.design(
            laws,
            by_name("--vary", vary),
            trials=trials,
            within=by_name("--within", within),
            start_std=numbers("--start-std", start_std),
            cost=numbers("--cost", cost) if cost else None,
            budget=budget,
            experiments=at_most,
            about=about,
            seed=seed,
            progress=show,
        )
        later = Artifacts()
        later.save(save, table=found.to_frame, figure=lambda plots: plots.plot_design(found))
    if as_json:
        laws_ = [{"equations": list(law.law.structure), "probability": law.probability} for law in found.laws]
        table = found.to_frame().to_dict(orient="records")
        texts = [experiment.text for experiment in found.experiments]
        print_json(
            {
                "laws": laws_,
                "experiments": [row | {"text": text} for row, text in zip(table, texts, strict=True)],
                "chance now": found.chance_now,
                "chance": found.chance,
                "repeats": found.repeats,
                "cost": found.cost,
                "sentences": list(found.sentences),
            }
        )
    else:
        say(str(found))
    later.end(trials.notes if trials else (), silent=as_json)
