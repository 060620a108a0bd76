"""Programs of laws hold nothing that a stranger wrote but calls of commonlaw with plain values."""

import ast
import random

from commonlaw.law.script import rewritten
from tests.hostile.law_cases import recorded

NAMES = {"cl", "law", "trials", "float"}


def test_recorded_calls_of_random_pieces_are_left_out_or_plain():
    r, kept = random.Random(20), 0
    for _ in range(3000):
        found = rewritten(recorded(r))
        if found is None:
            continue
        kept += 1
        tree = ast.parse(found, mode="eval")
        assert "\n" not in found
        assert "open" not in {each.id for each in ast.walk(tree) if isinstance(each, ast.Name)}
        assert {each.id for each in ast.walk(tree) if isinstance(each, ast.Name)} <= NAMES
        assert not {each.attr for each in ast.walk(tree) if isinstance(each, ast.Attribute)} & {"load", "read", "save"}
        assert not any(
            isinstance(each, ast.Lambda | ast.JoinedStr | ast.NamedExpr | ast.Starred) for each in ast.walk(tree)
        )
    assert kept > 5
