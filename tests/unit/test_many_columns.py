"""Tables of many columns: none of them is smoothed for a comparison of laws in all of them, which is not made."""

from time import process_time

import numpy as np

import commonlaw as cl


def test_a_table_of_many_columns_is_read_and_checked_in_short_time(tmp_path):
    values = np.cumsum(np.random.default_rng(0).normal(size=(12, 250)), axis=0)
    header = ",".join(["t", *(f"q{i}" for i in range(250))])
    rows = np.column_stack([np.arange(12) / 8, values])
    np.savetxt(tmp_path / "t.csv", rows, "%.5g", ",", header=header, comments="")
    trials = cl.Trials.read(tmp_path / "t.csv")
    np.testing.assert_allclose(trials[0].states, values, rtol=1e-4)
    begin = process_time()
    assert not any("confounded" in finding.text for finding in trials.check().found)
    assert process_time() - begin < 2
