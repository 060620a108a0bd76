"""The command finds the law of an ordinary table without any option."""

import pytest

import commonlaw as cl
from tests.ordinary_tables import ORDINARY


@pytest.mark.parametrize("kind", ORDINARY)
def test_a_table_alone_gives_its_law(run, tmp_path, kind):
    (tmp_path / "table.csv").write_text(ORDINARY[kind].table())
    code, out, err = run("discover", "table.csv", "--save", "law.json")
    assert code == 0, err
    law = cl.Law.load(tmp_path / "law.json")
    ORDINARY[kind].check(law)
    assert str(law).splitlines()[0] in out
