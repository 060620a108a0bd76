"""`commonlaw predict` as a user meets it."""

import numpy as np
import pandas as pd
import pytest

from commonlaw.law import Law, Uncertainty
from commonlaw.library import Variables, parse_library
from commonlaw.trials import Schema


@pytest.fixture
def tank(tmp_path):
    """A law of a tank with a valve that a controller moves, x' = -x + u, and a table of it; the exact states."""
    terms = parse_library("terms:x,u").bind(Variables(("x",), ("u",)))
    known = Uncertainty([np.diag([0.01, 0.01]) ** 2], noise=[0.02])
    law = Law(terms, Schema(("x",), ("u",)), 1, ("tank",), np.array([[[-1.0, 1.0]]]), uncertainty=known)
    law.save(tmp_path / "law.json")
    valve, states = np.tile([0.0, 2.0, 1.0], 10), [1.5]
    for each in valve[:-1]:
        states.append(each + (states[-1] - each) * np.exp(-1))
    frame = pd.DataFrame({"object": "tank", "t": np.arange(30.0), "x": states, "u": valve})
    frame.to_csv(tmp_path / "tank.csv", index=False)
    return np.array(states)


def test_inputs_between_samples_are_as_the_user_says(run, tmp_path, tank):
    predict = "predict", "law.json", "tank.csv", "--start", "1", "--save", "out.csv"
    assert run(*predict, "--input-between", "held")[0] == 0
    np.testing.assert_allclose(pd.read_csv(tmp_path / "out.csv")["x forecast"], tank, atol=1e-6)
    for other in ([], ["--input-between", "linear"], ["--input-between", "cubic"]):
        assert run(*predict, *other)[0] == 0
        assert pd.read_csv(tmp_path / "out.csv")["x error"].abs().max() > 0.05
    code, _, err = run(*predict, "--input-between", "zoh")
    assert (code, "'zoh' is not one of 'held', 'linear', 'cubic'" in err) == (2, True)
