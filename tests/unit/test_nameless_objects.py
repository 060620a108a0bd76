"""Tables and arrays that name no object."""

import numpy as np
import pandas as pd

from commonlaw.law import Law, Uncertainty
from commonlaw.library import Variables, parse_library
from commonlaw.trials import Schema, Trials
from tests.refusals import refused

FRAME = pd.DataFrame({"t": np.arange(8.0), "x": np.exp(-np.arange(8.0))})


def law_of(*objects):
    terms, count = parse_library("terms:x").bind(Variables(("x",))), len(objects)
    rates = -np.arange(1.0, count + 1).reshape(-1, 1, 1)
    return Law(
        terms, Schema(("x",)), 1, objects, rates, uncertainty=Uncertainty(1e-4 * np.ones((count, 1, 1)), noise=[0.1])
    )


def test_an_object_is_nameless_where_neither_table_nor_user_names_it():
    assert Trials.from_frame(FRAME).nameless
    assert Trials.from_arrays(FRAME["t"], FRAME["x"]).nameless
    assert Trials.from_frame(FRAME)[[0]].nameless
    assert not Trials.from_frame(FRAME, object_name="cup").nameless
    assert Trials.from_frame(FRAME, object_name="cup").objects == ("cup",)
    assert not Trials.from_frame(FRAME.assign(object="cup")).nameless
    assert not Trials.from_arrays(FRAME["t"], FRAME["x"], object="cup").nameless
    with refused("object-column-and-name", column="object"):
        Trials.from_frame(FRAME.assign(object="cup"), object_name="cup")


def test_a_nameless_object_has_the_coefficients_of_the_only_one_and_their_accuracy():
    nameless, named = Trials.from_frame(FRAME), Trials.from_frame(FRAME, object_name="cup")
    forecast, expected = (law_of("cup").predict(each, return_std=True) for each in (nameless, named))
    np.testing.assert_array_equal(forecast.trajectories[0].states, expected.trajectories[0].states)
    np.testing.assert_array_equal(forecast.std[0], expected.std[0])
    assert forecast.trials.objects == ("object",)
    remark = "no object is named: object has the coefficients of cup, the only object of the law"
    assert forecast.trials.notes == (remark,)
    assert expected.trials.notes == ()
    assert law_of("object", "cup").predict(nameless).trials.notes == ()


def test_which_object_of_several_is_not_guessed():
    with refused("object-unnamed", objects="cup, pot"):
        law_of("cup", "pot").predict(Trials.from_frame(FRAME))
    with refused("unknown-name", kind="object of this law", name="mug"):
        law_of("cup").predict(Trials.from_frame(FRAME, object_name="mug"))
