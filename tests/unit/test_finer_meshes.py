"""Which meshes are tried for estimates that are reported, by how far these move."""

from types import SimpleNamespace

import pytest

from commonlaw.inference.fit import convergence


class Stub:
    """A fit on a mesh of so many points to a step."""

    def __init__(self, points=1, estimates=()):
        self.estimates = estimates
        self.problem = SimpleNamespace(
            points=points, finer=lambda: SimpleNamespace(points=2 * points), on_half_steps=list
        )


@pytest.mark.parametrize(
    ("moves", "taken", "tried"),
    [
        ([0.5, 0.02, 1e-3], 8, 8),  # Resolved
        ([0.5, 0.008, 0.02], 4, 8),  # Diverging solutions move more again
        ([0.02, 0.04, 0.08, 0.13, 0.2, 0.3], None, 16),  # Chaotic ones from the first on
        ([0.02, 0.04, 0.08, 0.07, 0.005, 1e-3], 64, 64),
    ],
)
def test_finer_meshes_are_tried_until_estimates_are_resolved_or_move_more_and_more(monkeypatch, moves, taken, tried):
    points, left = list[int](), list(moves)

    def fitted(fit):
        points.append(fit.problem.points)
        return fit

    monkeypatch.setattr(convergence, "replace", lambda _, **changes: Stub(changes["problem"].points))
    monkeypatch.setattr(convergence, "_under_residual_noise", fitted)
    monkeypatch.setattr(convergence, "_metric", lambda _: ())
    monkeypatch.setattr(convergence, "_moved", lambda *_: left.pop(0))
    resolved = convergence._resolved(Stub())
    assert (resolved and resolved.problem.points) == taken
    assert points[-1] == tried
