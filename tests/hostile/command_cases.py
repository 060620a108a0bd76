"""Commands that must be refused: options given twice, and files that are read to be written over."""

import random
from collections.abc import Iterator

import click

from commonlaw.cli.main import commonlaw
from commonlaw.cli.options import ReadFile, WrittenFile
from tests.hostile.case import Case

FILES = {"drops.csv": b"ball,drop,t,height\ngolf,1,0,5\ngolf,1,1,4\ngolf,1,2,2\n", "law.json": b"{}"}
"""What is read; nothing is done with it, as all of these commands are refused before."""


def repeated(r: random.Random) -> Case:
    """Options of one value that are given twice, among others, with the same value or another."""
    words, command = r.choice(list(_commands()))
    options = [param for param in command.params if isinstance(param, click.Option)]
    option = r.choice([each for each in options if not each.multiple])
    others = [each for each in r.sample(options, min(3, len(options))) if each is not option]
    given = [_given(r, option), *(_given(r, each) for each in others)]
    r.shuffle(given)
    given.insert(r.randrange(len(given) + 1), _given(r, option))
    arguments = _arguments(command)
    parts = r.sample([arguments, [word for each in given for word in each]], 2)
    return Case((*words, *parts[0], *parts[1]), FILES, refused=True)


def inputs(r: random.Random) -> Case:
    """A file that is read, named once more as one to be written: by itself, by a way about, or by a link."""
    reading = [(words, each) for words, each in _commands() if _written(each)]
    words, command = r.choice(reading)
    option = r.choice(_written(command))
    read = r.choice([param for param in command.params if isinstance(param.type, ReadFile) and param.name != "dataset"])
    path = r.choice(["law.json", "drops.csv"])
    same = r.choice(
        [path, f"./{path}", f"../case/{path}", f".//{path}", *(["link.csv"] if path == "drops.csv" else [])]
    )
    values = {read: path}
    given = [] if isinstance(read, click.Argument) else [read.opts[0], path]
    return Case((*words, *_arguments(command, values), *given, option.opts[0], same), FILES, refused=True)


def _commands(
    group: click.Group = commonlaw, words: tuple[str, ...] = ()
) -> Iterator[tuple[tuple[str, ...], click.Command]]:
    context = click.Context(group)
    for name in group.list_commands(context):
        found = group.get_command(context, name)
        if isinstance(found, click.Group):
            yield from _commands(found, (*words, name))
        elif found is not None and any(
            isinstance(param, click.Option) and not param.multiple for param in found.params
        ):
            yield (*words, name), found


def _written(command: click.Command) -> list[click.Parameter]:
    return [param for param in command.params if isinstance(param.type, WrittenFile)]


def _arguments(command: click.Command, values: dict[click.Parameter, str] | None = None) -> list[str]:
    """Return the words that a command takes one after the other."""
    usual = {"law_path": "law.json", "path": "drops.csv", "equations": "height' = a", "laws": "height' = b"}
    given = values or {}
    words = [given.get(each, usual.get(str(each.name))) for each in command.params if isinstance(each, click.Argument)]
    return [word for word in words if word]


def _given(r: random.Random, option: click.Option) -> list[str]:
    """Return the words that give an option once."""
    name = r.choice([*option.opts, *option.secondary_opts])
    if option.is_flag:
        return [name]
    if isinstance(option.type, click.Choice):
        return [name, r.choice(list(option.type.choices))]
    return [name, r.choice(["1", "2"] if option.type.name != "file" else ["out.csv", "law.json"])]
