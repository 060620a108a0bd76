"""`commonlaw explain` and `discover --explain` as a user meets them."""

import json

import numpy as np
import pandas as pd
import pytest

import commonlaw as cl

MASSES = (0.3, 0.1, 0.1, 0.06, 0.043)


@pytest.fixture
def drops(tmp_path):
    """Drops of five balls, with their masses and colours in columns of the table."""
    frame = cl.datasets.linear_drag(noise=0.02, trials=1).to_frame().drop(columns="drag")
    ball = frame["object"].str[-1].astype(int) - 1
    frame.assign(mass=np.array(MASSES)[ball], day=ball % 2 + 1).to_csv(tmp_path / "drops.csv", index=False)


@pytest.mark.usefixtures("drops")
def test_a_fitted_law_is_explained_by_the_properties_in_its_table(run, done, fails, tmp_path):
    done("fit", "drops.csv", "x'' = -g - c v", "--save", "law.json")
    code, out, err = run(
        "explain", "law.json", "--property", "mass,day", "--save", "explained.json", "--save", "relations.svg"
    )
    assert (code, err) == (0, "")
    assert (tmp_path / "relations.svg").stat().st_size > 0
    assert "/mass v\n" in out
    assert "shared" in out
    assert "Wrote explained.json" in out
    law = cl.Law.load(tmp_path / "explained.json")
    assert law.uncertainty.explanation.relations[1].factors[0] == pytest.approx(-0.03, rel=0.02)
    code, out, _ = run("explain", "law.json", "--json")
    assert json.loads(out)["relations"][1]["follows"] == "1/mass"
    assert r"\frac{1}{\mathrm{mass}}" in run("explain", "law.json", "--latex")[1]
    assert r"\frac{1}{\mathrm{mass}}" in run("show", "explained.json", "--latex")[1]
    assert "a is object-specific" in run("explain", "law.json", "--property", "day")[1]
    assert "a is object-specific" in run("explain", "law.json", "--property", "")[1]
    assert "unknown property 'weight'" in fails("explain", "law.json", "--property", "weight")


@pytest.mark.usefixtures("drops")
def test_properties_come_from_a_table_of_their_own(run, fails, tmp_path):
    law = cl.fit("x'' = -g - c v", cl.datasets.linear_drag(noise=0.02, trials=1))
    law.save(tmp_path / "law.json")
    rows = [f"{name},{mass}" for name, mass in zip(law.objects, MASSES, strict=True)]
    (tmp_path / "balls.csv").write_text("\n".join(["object,mass [kg]", *rows]))
    code, out, _ = run("explain", "law.json", "--properties", "balls.csv")
    assert (code, "/mass v\n" in out) == (0, True)
    assert "balls.csv" in fails("explain", "law.json", "--properties", "balls.csv", "--save", "balls.csv")


@pytest.mark.usefixtures("drops")
def test_discover_explains_what_it_found_and_forecasts_a_ball_by_its_mass(run):
    found = run(
        "discover", "drops.csv", "--order", "2", "--library", "poly:1", "--explain", "--hold-out", "object=Ball 2"
    )
    assert found[0] == 0
    assert "/mass v\n" in found[1]
    assert "Do not use" not in found[1]


@pytest.mark.usefixtures("drops")
def test_a_ball_that_was_never_seen_is_forecast_from_the_mass_in_its_table(run, tmp_path):
    frame = pd.read_csv(tmp_path / "drops.csv")
    new = frame["object"] == "Ball 2"
    frame[~new].to_csv(tmp_path / "learned.csv", index=False)
    frame[new].to_csv(tmp_path / "new.csv", index=False)
    frame[new].drop(columns="mass").to_csv(tmp_path / "bare.csv", index=False)
    run("fit", "learned.csv", "x'' = -g - c v", "--save", "law.json")
    run("explain", "law.json", "--property", "mass", "--save", "explained.json")
    code, out, err = run("predict", "new.csv", "explained.json", "--save", "forecast.csv")
    assert code == 0
    assert float(out.partition("R^2 ")[2].split()[1]) > 0.999
    assert "Ball 2 is not in the law: it has the coefficients that follow from its mass" in err
    table = pd.read_csv(tmp_path / "forecast.csv")
    assert table["x"].between(table["x measured low"], table["x measured high"]).mean() > 0.85
    for law, why in (("explained.json", ", as its mass is not known"), ("law.json", "")):
        code, _, err = run("predict", "bare.csv", law)
        assert (code, f"it has the mean coefficients of the others{why}\n" in err) == (0, True)
