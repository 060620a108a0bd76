"""`commonlaw show`: print a saved law."""

import click


@click.command()
@click.argument("law_path", metavar="LAW.json")
@click.option("--latex", is_flag=True, help="Print LaTeX.")
@click.option("--object", "name", metavar="NAME", help="Only this object.")
@click.option("--average", is_flag=True, help="The mean of all objects' coefficients.")
def show(law_path: str, latex: bool, name: str | None, average: bool) -> None:
    """Print the law in LAW.json."""
    from commonlaw.law import Law

    if name and average:
        raise click.UsageError("give --object or --average, not both")
    law = Law.load(law_path)
    law = law.select([name]) if name else law.average() if average else law
    if not latex:
        click.echo(str(law))
        return
    for each in law.objects:
        click.echo(f"% {each}\n{law.to_latex(each)}")
