"""Rules that hold for every command and every option, also for those to come."""

import os
import re

import click
import pytest

import commonlaw as cl
from commonlaw.cli.main import Command, commonlaw
from commonlaw.cli.options import ENDINGS, ReadFile, ReadLaw, ReadTable, WrittenFile, dialect

DROPS = cl.datasets.linear_drag(noise=0.05, trials=3)


def commands(group=commonlaw, path=()):
    """Yield every command with its words."""
    context = click.Context(group)
    for name in group.list_commands(context):
        found = group.get_command(context, name)
        if isinstance(found, click.Group):
            yield from commands(found, (*path, name))
        else:
            yield (*path, name), found


ALL = dict(commands())
PARAMETERS = [(words, param) for words, command in ALL.items() for param in command.params]
OPTIONS = [(words, each) for words, each in PARAMETERS if isinstance(each, click.Option)]
VALUES = {"integer range": "1", "float range": "1", "float": "1", "integer": "1"}


def of_kind(kind):
    return [(words, each) for words, each in PARAMETERS if isinstance(each.type, kind)]


def named(pairs):
    return [" ".join((*words, str(each.name))) for words, each in pairs]


def given(option, value=None):
    """Return the words that give an option once."""
    if option.is_flag:
        return [option.opts[0]]
    if isinstance(option.type, WrittenFile):
        return [option.opts[0], f"{value or 'x'}{ENDINGS[option.type.kinds[0]][0]}"]
    if option.opts[0] == "--set":
        return ["--set", "positive=x"]
    of_type = (
        option.type.choices[0] if isinstance(option.type, click.Choice) else VALUES.get(option.type.name, "x.json")
    )
    return [option.opts[0], value if option.type.name == "file" and value and "." in value else of_type]


EXAMPLES = {"equations": "x' = -x", "path": "y.csv"}
"""Arguments that are no saved law, by name."""


def needed(command, but=(), reading=None, source=""):
    """Return what a command cannot do without, every law being x.json and table y.csv, and what it is to read."""
    names = {each.name for each in command.params}
    always = {"path", "law_path", "equations"} & names if {"law_path", "equations"} & names else set()
    needs = [each for each in command.params if each.required or each is reading or each.name in always]
    wanted = [need for need in needs if need not in but]
    values = {each: source if each is reading else EXAMPLES.get(each.name, "x.json") for each in wanted}
    options = [each for each in wanted if isinstance(each, click.Option)]
    arguments = [values[each] for each in wanted if each not in options]
    return [*arguments, *(word for each in options for word in given(each, values[each]))]


def test_commands_have_few_options():
    shown = {
        words: [each for each in command.params if not getattr(each, "hidden", True)] for words, command in ALL.items()
    }
    assert sum(map(len, shown.values())) <= 158
    assert max(map(len, shown.values())) == len(shown[("discover",)]) == 29


def test_every_command_is_one_of_ours():
    assert {type(each) for each in ALL.values()} == {Command}


def test_what_names_a_file_says_whether_it_is_read_or_written():
    like_a_file = re.compile(r"FILE|FIGURE|\w\.\w")
    files = [(words, each) for words, each in PARAMETERS if like_a_file.search(each.metavar or "")]
    assert len(files) > 20
    assert [pair for pair in files if not isinstance(pair[1].type, ReadFile | WrittenFile)] == []


EACH_OPTION = [*{(*option.opts, option.multiple): (words, option) for words, option in OPTIONS}.values()]
"""Every option once, as the rule is that of the class of commands."""


@pytest.mark.parametrize(("words", "option"), EACH_OPTION, ids=named(EACH_OPTION))
def test_an_option_counts_each_time_or_is_refused(run, tmp_path, monkeypatch, words, option):
    for name in ("x.json", "y.csv"):
        (tmp_path / name).write_text("t,x\n")
    said = []
    monkeypatch.setattr(ALL[words], "callback", lambda **values: said.append(values))
    once = needed(ALL[words], but=(option,))
    code, _, err = run(*words, *once, *given(option, "a"), *given(option, "b"))
    if option.multiple:
        assert (code, len(said[0][option.name])) == (0, 2)
    else:
        assert (code, said) == (2, [])
        assert f"{option.opts[0]}" in err
        assert "is given 2 times and counts once: give it once" in " ".join(err.split())


READ_AND_WRITTEN = [
    (words, read, written)
    for words, read in of_kind(ReadFile)
    for of_words, written in of_kind(WrittenFile)
    if of_words == words
]


@pytest.mark.parametrize(
    ("words", "read", "written", "link"),
    [*((*each, None) for each in READ_AND_WRITTEN), *((*READ_AND_WRITTEN[0], each) for each in (os.symlink, os.link))],
)
def test_what_is_read_is_never_written_over(fails, tmp_path, monkeypatch, words, read, written, link):
    for name in ("x.json", "y.csv"):
        (tmp_path / name).write_text("others")
    (tmp_path / "of mine").mkdir()
    file = "in.csv" if read.name in ("path", "more") else "in.json"
    (tmp_path / "of mine" / file).write_text("read")
    path = f"of mine/../of mine/{file}"
    if link:
        link(tmp_path / "of mine" / file, tmp_path / "link.svg")
    monkeypatch.setattr(ALL[words], "callback", lambda **_: pytest.fail("work was started"))
    source = f"of mine/{file}"
    rest = needed(ALL[words], (written,), read, source)
    err = fails(*words, *rest, written.opts[0], "link.svg" if link else path)
    assert "it is read here too" in err or (link is os.link and "one file under several names" in err)
    assert (tmp_path / "of mine" / file).read_text() == "read"


def test_folders_of_a_data_set_are_read(tmp_path):
    (tmp_path / "balls.txt").write_text("others")
    assert ReadTable({}).files(f"dataset:ball-drops:folder={tmp_path}") == [str(tmp_path / "balls.txt")]


def test_a_law_that_is_given_as_text_is_no_file():
    assert ReadLaw().files("x'' = -9.8") == []
    assert ReadLaw().files("law.json") == ["law.json"]


@pytest.mark.parametrize("option", ["--where", "--exclude", "--hold-out"])
def test_conditions_on_the_same_name_all_count(run, tmp_path, monkeypatch, option):
    DROPS.to_csv(tmp_path / "drops.csv")
    learned = []

    def discover(training, **_):
        learned.append({each.name for each in training})
        raise cl.CommonlawError("other", text="enough")

    monkeypatch.setattr("commonlaw.discover", discover)
    run("discover", "drops.csv", option, "trial=3", option, "trial=2")
    assert learned == [{"2", "3"} if option == "--where" else {"1"}]


@pytest.mark.parametrize(
    "given",
    [("--noise", "x=1", "x=2"), ("--known", "1=1", "1=2"), ("--set", "seed=1", "seed=2"), ("--noise", "x=1", "x = 1")],
)
def test_two_values_for_one_name_are_refused(fails, tmp_path, given):
    DROPS.to_csv(tmp_path / "drops.csv")
    name, one, other = given
    err = fails("discover", "drops.csv", name, one, name, other, code=2)
    assert re.search(r"twice.*: give it once", " ".join(err.split()))


def test_an_object_is_found_whose_name_has_a_comma(run, tmp_path):
    frame = cl.datasets.linear_drag(drag=(-0.1, -0.2, -0.3, -0.4), trials=1).to_frame()
    names = dict(zip(frame["object"].unique(), ["Ball", "blue", "Ball,blue", "Golf"], strict=True))
    frame.assign(object=frame["object"].map(names)).to_csv(tmp_path / "drops.csv", index=False)

    def kept(condition):
        return run("data", "check", "drops.csv", "--where", condition)[1].splitlines()[0].split(": ")[1]

    assert kept("object=Ball,blue").startswith("1 trial of 1 object")
    assert kept('object="Ball,blue",Golf').startswith("2 trials of 2 objects")
    assert kept("object=Ball,Golf").startswith("2 trials of 2 objects")


@pytest.mark.parametrize("option", ["-v", "--verbose"])
def test_every_step_is_said_when_asked_for(run, monkeypatch, option):
    def discover(*_, progress, **__):
        progress("choosing terms")
        raise cl.CommonlawError("other", text="enough")

    monkeypatch.setattr("commonlaw.discover", discover)
    _, _, err = run(option, "discover", "dataset:linear-drag")
    assert [line.split(" s  ")[1] for line in err.splitlines() if " s  " in line] == [
        "reading the table",
        "choosing terms",
    ]


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_a_line_makes_the_script_that_completes_words(run, monkeypatch, shell):
    monkeypatch.setenv("_COMMONLAW_COMPLETE", f"{shell}_source")
    code, out, _ = run()
    assert (code, "_commonlaw_completion" in out) == (0, True)


def test_words_are_completed(run, monkeypatch):
    monkeypatch.setenv("_COMMONLAW_COMPLETE", "zsh_complete")
    monkeypatch.setenv("COMP_WORDS", "commonlaw compare --sa")
    monkeypatch.setenv("COMP_CWORD", "2")
    assert "--save" in run()[1]
    monkeypatch.setenv("COMP_WORDS", "commonlaw show ")
    assert run()[1].split()[0] == "file"


def test_words_that_are_no_text_are_refused_by_name(run, fails):
    assert "--object-name: 'b\\udcff' is not text in UTF-8" in fails(
        "data", "check", "a.csv", "--object-name", "b\udcff", code=2
    )
    assert run("compare", "a.csv", "x' = b\udcff", "x' = 1")[0] == 2


def test_doses_are_named_in_the_words_of_the_command_that_takes_them():
    said = {words: dialect(command)("doses=['dose']") for words, command in ALL.items()}
    assert said[("fit",)] == "--dose 'dose'"
    assert {said[words] for words in (("discover",), ("data", "check"))} == {"--dose 'dose' of commonlaw fit"}


def test_options_of_tables_are_of_the_command_that_has_them_unless_a_schema_was_given():
    command = ALL["compare",]
    assert dialect(command)("wide='OD'") == "--wide OD of commonlaw data check --save"
    assert dialect(command, has_schema=True)("below={'BLQ': 0.5}") == "below = {'BLQ' = 0.5} in the --schema file"
    assert dialect(ALL["data", "check"])("wide='OD'") == "--wide OD"


def test_what_a_shell_would_read_itself_is_quoted():
    write = dialect(ALL["data", "check"])
    assert write("below={'<LOQ': 0.5}") == "--below '<LOQ=0.5'"
    assert write("below={'BLQ': 0.5}") == "--below BLQ=0.5"
