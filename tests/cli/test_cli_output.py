"""Tables on the terminal."""

from commonlaw.cli.output import print_columns


def test_a_table_that_is_wider_than_the_terminal_has_a_row_for_each_column_and_nothing_is_cut(capsys):
    names = [f"ball {i}" for i in range(20)]
    columns = {"object": names} | {f"coefficient {j}": [(100.0 * i + j, 0.5) for i in range(20)] for j in range(15)}
    print_columns(columns)
    wide = capsys.readouterr().out
    assert "\N{HORIZONTAL ELLIPSIS}" not in wide
    assert max(map(len, wide.splitlines())) <= 160
    heads = [line for line in wide.splitlines() if line.startswith(" object")]
    assert [part.strip() for line in heads for part in line.split("  ") if "ball" in part] == names
    assert sum(line.startswith(" coefficient 3 ") for line in wide.splitlines()) == len(heads) > 1
    assert "1903.00 \N{PLUS-MINUS SIGN} 0.50" in wide
    print_columns({name: columns[name] for name in ("object", "coefficient 1", "coefficient 2")})
    narrow = capsys.readouterr().out
    assert len(narrow.splitlines()) == 22
