"""Laws of one trajectory are held against true solutions from its start, and from another."""

import json

import numpy as np
import pytest

from benchmarks import one_trajectory


@pytest.mark.slow
def test_a_law_is_scored_where_it_was_learned_and_elsewhere(tmp_path, capsys):
    saved = tmp_path / "scores.jsonl"
    chosen = ["--only", "spring", "--noise", "0.05", "--dropped", "0.5", "--library", "poly:1", "--save"]
    one_trajectory.main([*chosen, str(saved)])
    printed = capsys.readouterr().out
    assert "| 5 % | 0.5 | 1 | 1 (100%) | 1 (100%) |" in printed
    scores = [json.loads(line) for line in saved.read_text().splitlines()]
    assert [score["dropped"] for score in scores] == [0.5]
    assert min(score[name] for score in scores for name in ("learned", "elsewhere")) > 0.99


@pytest.mark.parametrize("name", one_trajectory.SYSTEMS)
def test_both_trajectories_of_a_system_exist(name):
    system = one_trajectory.SYSTEMS[name]
    for start in system.starts:
        states = system.solve(start)
        assert states.shape == (one_trajectory.SAMPLES, len(system.equations))
        assert np.isfinite(states).all()
        assert np.ptp(states, axis=0).min() > 0
