"""Options that several commands share."""

import click

from commonlaw.cli.source import pairs

noise_option = click.option(
    "--noise",
    "noises",
    metavar="STATE=VALUE",
    multiple=True,
    help="Known standard deviation of a state's measurement noise; repeat for each state.  [default: estimated]",
)
errors_option = click.option(
    "--errors",
    type=click.Choice(["likelihood", "bootstrap"]),
    default="likelihood",
    show_default=True,
    help="How standard errors by trajectories are found: from the likelihood, or by drawing stretches of trials anew.",
)
pool_option = click.option(
    "--pool/--no-pool",
    default=True,
    show_default=True,
    help="Whether coefficients by trajectories are drawn to their mean over objects as far as these are alike.",
)


def numbers(option: str, texts: tuple[str, ...]) -> dict[str, float]:
    """Return the numbers that an option gives by name."""
    found = {}
    for name, text in pairs(option, texts):
        try:
            found[name] = float(text)
        except ValueError:
            raise click.UsageError(f"{option} {name}={text}: {text!r} is not a number") from None
    return found
