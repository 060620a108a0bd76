"""Values below a limit of quantification, held against the maximum of their likelihood by SciPy."""

import numpy as np
import pytest
from scipy.optimize import minimize
from scipy.stats import norm

import commonlaw as cl
from tests.refusals import refused
from tests.unit.decays import estimates

EXACT = {"xatol": 1e-10, "fatol": 1e-12, "maxiter": 9999}


def minus_log_likelihood(measured, curve, std, limit):
    """Return that of normal errors, of which those below the limit have the probability of the tail."""
    below, std = ~(measured >= limit), np.broadcast_to(std, curve.shape)
    seen = norm.logpdf(measured[~below], curve[~below], std[~below]).sum()
    return -seen - norm.logcdf((limit - curve[below]) / std[below]).sum()


def test_values_below_a_limit_count_by_the_likelihood_of_the_tail():
    times = np.linspace(0, 8, 25)
    y = 3 * np.exp(-0.5 * times) + 0.15 * np.random.default_rng(8).standard_normal(25)
    y[y < 0.4] = np.nan
    below = np.where(np.isnan(y), 0.4, np.nan)[:, None]
    trials = cl.Trials((cl.Trial("A", "1", times, y[:, None], below=below),), cl.Schema(("x",)))
    law = cl.fit("x' = -k x", trials, initial_values={"x": "a"})

    def deviance(p):
        return minus_log_likelihood(y, p[1] * np.exp(-p[0] * times), np.exp(p[2]), 0.4)

    found = minimize(deviance, [0.5, 3, -2], method="Nelder-Mead", options=EXACT)
    assert [estimates(law)[each][0] for each in "ka"] == pytest.approx(found.x[:2], rel=1e-4)
    assert -law.provenance.log_likelihood == pytest.approx(found.fun, abs=1e-5)

    # The curvature of all of the likelihood, at the noise that is reported
    point, steps = np.array([*found.x[:2], np.log(law.uncertainty.noise[0])]), np.diag([1e-4, 1e-4, 1e-4])
    signs = [(i, j) for i in (1, -1) for j in (1, -1)]
    hessian = [[sum(i * j * deviance(point + i * a + j * b) for i, j in signs) / 4e-8 for b in steps] for a in steps]
    errors = np.sqrt(np.diag(np.linalg.inv(hessian)))[:2]
    assert [estimates(law)[each][1] for each in "ka"] == pytest.approx(errors, rel=0.05)


def test_cells_below_a_limit_are_read_and_count_in_fits(tmp_path):
    source, times, values = np.random.default_rng(10), np.linspace(0, 8, 17), {}
    rows = ["patient,t,conc"]
    for name, k in {"a": 0.4, "b": 0.6}.items():
        values[name] = (5 * np.exp(-k * times) + 0.1 * source.standard_normal(17)).round(6)
        rows += [f"{name},{t},{'<0.5' if v < 0.5 else v}" for t, v in zip(times, values[name], strict=True)]
    (tmp_path / "levels.csv").write_text("\n".join(rows))
    trials = cl.Trials.read(tmp_path / "levels.csv")
    assert any("below a limit of quantification in conc" in note for note in trials.notes)
    law = cl.fit("conc' = -k conc", trials, initial_values={"conc": "c0"}, shared="c0")

    def deviance(p):
        curves = [p[2] * np.exp(-k * times) for k in p[:2]]
        pairs = zip(values.values(), curves, strict=True)
        return sum(minus_log_likelihood(y, curve, np.exp(p[3]), 0.5) for y, curve in pairs)

    found = minimize(deviance, [0.5, 0.5, 5, -2], method="Nelder-Mead", options=EXACT)
    own = [estimates(law, "a")["k"][0], estimates(law, "b")["k"][0], estimates(law, "a")["c0"][0]]
    assert own == pytest.approx(found.x[:3], rel=1e-3)
    (tmp_path / "marks.csv").write_text("\n".join(rows).replace("<0.5", "BLQ"))
    with refused("cell-censored"):
        cl.Trials.read(tmp_path / "marks.csv")
    marked = cl.Trials.read(tmp_path / "marks.csv", below={"BLQ": 0.5})
    assert np.array_equal(marked[0].below, trials[0].below, equal_nan=True)


def test_proportional_noise_of_values_below_a_limit_has_its_likelihood():
    times, source = np.linspace(0, 6, 30), np.random.default_rng(12)
    clean = 5 * np.exp(-0.5 * times)
    y = clean + np.hypot(0.05, 0.1 * clean) * source.standard_normal(30)
    y[y < 0.5] = np.nan
    below = np.where(np.isnan(y), 0.5, np.nan)[:, None]
    trials = cl.Trials((cl.Trial("A", "1", times, y[:, None], below=below),), cl.Schema(("x",)))
    law = cl.fit("x' = -k x; x(0) = h", trials, errors="proportional")
    k, h = (estimates(law)[name][0] for name in "kh")
    curve = h * np.exp(-k * times)

    def deviance(p):
        return minus_log_likelihood(y, curve, np.hypot(np.exp(p[0]), np.exp(p[1]) * curve), 0.5)

    # The log-likelihood is that of the levels of largest likelihood about the curve
    found = minimize(deviance, [-3, -2], method="Nelder-Mead", options=EXACT)
    assert -law.provenance.log_likelihood == pytest.approx(found.fun, abs=1e-4)
    std = np.hypot(law.uncertainty.noise[0], law.uncertainty.error_model.heteroscedastic["proportional"] * curve)

    def at(p):
        return minus_log_likelihood(y, p[1] * np.exp(-p[0] * times), std, 0.5)

    assert minimize(at, [k, h], method="Nelder-Mead", options=EXACT).x == pytest.approx([k, h], rel=1e-4)
    for errors in ("by-object", "autocorrelated", "sensor-walk", "drift"):
        with refused("censored-with-errors"):
            cl.fit("x' = -k x", trials, errors=errors)
