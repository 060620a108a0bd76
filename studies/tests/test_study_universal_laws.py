"""The part of the study on what all balls have in common."""

import pytest

from commonlaw.datasets.sphere_drag import drag_coefficient
from studies.falling_balls.inquiry import Inquiry
from studies.falling_balls.settings import SEED
from studies.falling_balls.universal_laws import universal_laws

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def results(drops):
    return universal_laws(Inquiry(drops, "", SEED)).results["universal_laws"]


def test_gravity_is_universal_and_drag_is_each_balls_own(results):
    gravity, drag = results["gravity"], results["drag"]
    assert (gravity["kind"], drag["kind"], drag["follows"]) == ("universal", "own", "")
    assert gravity["factor"] == pytest.approx(-7.9, abs=0.2)
    assert gravity["probability"] > 0.5


def test_what_all_balls_share_beyond_a_constant_drag_coefficient_is_less_than_what_each_drop_does(results):
    found = results["discrepancy"]
    assert found["evidence"] > 6
    assert found["shares"]["shared discrepancy"] < 0.1 < found["shares"]["trial"]
    curve = found["curve"]
    shifted = drag_coefficient(curve["reynolds"]) - curve["brown_lawler"]
    assert shifted == pytest.approx(shifted[0])
    assert sum(curve["samples"]) == pytest.approx(1.0)


def test_unseen_balls_are_forecast_within_their_bands_and_worse_than_by_their_own_law(results):
    unseen = results["unseen"].values()
    assert len(unseen) == 9
    assert all(each["held"] > 0.9 and each["errors"] < each["band"] for each in unseen)
    assert sum(each["errors"] > each["own_errors"] for each in unseen) >= 8
