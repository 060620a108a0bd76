"""Small tables and equations of every kind: fits, searches, forecasts, pages and programs, sensible or not."""

import json
import math
import random
import re
from collections.abc import Callable, Sequence

import pandas as pd

from tests.hostile.case import Case

PARAMETERS = ("a", "b", "k")
NUMBERS = ("0", "1", "2", "3", "0.5", "1.5", "9.81", "20", "1e-3", "1e6", "1e300", "pi")
SCALES = (1, 1, 1e-3, 1e3, 1e-12, 1e12, 1e-100, 1e100)
GAPS = ("", "NA", "nan", "-", "inf", "<0.5")
FUNCTIONS = ("exp", "log", "sqrt", "abs", "sin", "cos", "tan", "tanh", "sinh", "cosh", "arctan", "sign")
SAVED = ("law.json", "law.parquet", "fit.svg", "fit.png", "page.html", "law.csv", "law.py", "law.c", "law.xlsx")
SETTINGS = (
    "errors=white", "errors=proportional", "errors=autocorrelated", "errors=drift",
    "errors=sensor-walk", "errors=random-walk", "errors=gp-forcing", "huber_threshold=inf", "huber_threshold=3",
    "input_interpolation=held", "input_interpolation=cubic", "partial_pooling=true", "log_states=x", "seed=3",
)  # fmt: skip
REGRESSIONS = (
    ("solver=stlsq:0.1",), ("solver=group-stlsq:1",), ("solver=best-subset:2",), ("solver=lasso:0.1",),
    ("solver=sr3:0.1",), ("solver=forward:2",), ("solver=best-subset", "rule=aicc"),
    ("solver=forward", "rule=held-out"), ("differentiation=finite:2",), ("differentiation=spline",),
    ("differentiation=robust",), ("differentiation=tv:1",), ("differentiation=spectral",),
    ("differentiation=wiener:3",), ("differentiation=median:3",),
)  # fmt: skip
LIBRARIES = (
    "poly:1", "poly:2", "poly:3", "fourier:1", "poly:1 + fourier:1", "terms:1,x,1/x", "terms:x,exp(x)",
    "terms:sqrt(x),log(x)", "terms:x,x*abs(x)", "rational:1:1+x**2", "constant",
)  # fmt: skip
UNITS = ("", "", "s", "m", "g", "mg/l", "%", "degC")


def table(r: random.Random, states: Sequence[str], odd: float = 0.5) -> bytes:
    """Return a small table of times, states, an input and a property; with a chance of `odd`, parts are unusual."""
    strange = r.random() < odd

    def unusual(chance: float) -> bool:
        return strange and r.random() < chance

    samples, step, origin = r.choice([2, 3, 4, 5, 5, 6, 6, 7, 8, 12, 25]), r.choice([0.1, 0.5, 1, 1 / 3]), 0.0
    if unusual(0.2):
        step, origin = r.choice([1e-9, 1e-3, 1e6, 86_400]), r.choice([0, -5, 1900, 1e9])
    curves = {name: _curve(r, r.choice(SCALES) if unusual(0.5) else 1) for name in states}
    noise, rows = r.choice([0, 0, 0.001, 0.02, 0.2]), []
    for i in range(r.choice([1, 1, 1, 2, 3])):
        for j in range(r.choice([1, 1, 1, 2])):
            rate = r.choice([0.1, 0.3, 1]) * (1 + 0.3 * i)
            for k in range(samples):
                row = {"object": f"o{i}", "trial": j, "t": origin + step * k}
                row |= {name: curve(rate * k) * (1 + noise * r.gauss(0, 1)) for name, curve in curves.items()}
                rows.append(row | {"u": math.sin(k) if samples % 2 else float(k > 3), "m": 1 + i})
    frame = pd.DataFrame(rows)
    for name in ("object", "trial"):
        if frame[name].nunique() == 1 and r.random() < 0.7:
            frame = frame.drop(columns=name)
    _make_unusual(r, frame, states, unusual)
    if unusual(0.2):
        frame = frame.sample(frac=r.choice([0.7, 1]), random_state=r.randrange(1000))
    if unusual(0.1):
        frame = pd.concat([frame, frame.tail(2)])
    if unusual(0.2):
        frame = frame.rename(columns={name: f"{name} [{r.choice(UNITS)}]" for name in (*states, "t", "u")})
    return frame.to_csv(index=False).encode()


def _make_unusual(
    r: random.Random, frame: pd.DataFrame, states: Sequence[str], unusual: Callable[[float], bool]
) -> None:
    """Change cells and columns of a table in place."""
    if unusual(0.3):
        frame["t"] += (
            (frame["t"].iloc[1] - frame["t"].iloc[0]) * 0.4 * pd.Series([r.random() for _ in range(len(frame))])
        )
    if unusual(0.2):
        frame.loc[r.randrange(1, len(frame)), "t"] = r.choice(list(frame["t"]))
    if unusual(0.2):
        frame[states[-1]] = frame[states[-1]].round()
    if unusual(0.3):
        name = r.choice([*states, "u"])
        frame[name] = frame[name].map(lambda value: r.choice(GAPS) if r.random() < 0.15 else value)
    if unusual(0.15):
        frame["flag"] = [r.choice([True, False]) for _ in range(len(frame))]
    if unusual(0.15):
        frame["note"] = [r.choice(["good", "bad"]) for _ in range(len(frame))]
    if unusual(0.1):
        frame["z"] = frame[states[0]]


def _curve(r: random.Random, scale: float) -> Callable[[float], float]:
    """Return a function of time."""
    level, size = r.choice([0, 0, 1, -2, 20]), r.choice([1, 1, 5, -3, 100])
    shapes: list[Callable[[float], float]] = [
        *[lambda t: math.exp(-t)] * 2,
        lambda t: math.exp(min(t, 30)),
        lambda t: math.cos(2 * t),
        lambda t: 1 - t,
        lambda t: float(t > 2),
        lambda t: 0 * t,
        lambda t: 1 / (1 + math.exp(3 - t)),
        lambda t: r.choice([0, 1, -1, t, 1e6]),
    ]
    shape = r.choice(shapes)
    return lambda t: scale * (level + size * shape(t))


def formula(r: random.Random, names: Sequence[str], depth: int) -> str:
    """Return a right-hand side, or a part of one, with parameters."""
    if depth <= 0:
        return r.choice([*names, *names, *names, *PARAMETERS, r.choice(NUMBERS)])
    inner, outer = formula(r, names, depth - 1), formula(r, names, r.randrange(depth))
    name, parameter, number = r.choice(names), r.choice(PARAMETERS), r.choice(NUMBERS)
    return r.choice(
        [f"{parameter} {name}", f"{inner} + {outer}", f"{inner} - {outer}", f"({inner})*({outer})"] * 2
        + [f"({inner})/({outer})", f"{parameter} {name}/({outer} + {name})", f"{parameter} {name}^{number}"]
        + [f"{name}^{parameter}", f"({inner})^{r.choice(['2', '3', '0.5', '-1', '-2', '0'])}"]
        + [f"{r.choice(FUNCTIONS)}({inner})", f"exp(-{parameter} t)", f"abs({name})^{parameter}"]
        + [f"{r.choice(['max', 'min'])}({inner}, {number})", f"where({name} > {parameter}, {inner}, {outer})"]
        + [f"{parameter} (t > {number})", f"u(t - {r.choice([parameter, number])})", f"{number} {name}"]
    )


def rates(r: random.Random, states: Sequence[str], order: int) -> str:
    """Return an equation of each state."""
    names = [*states, *states, *(["v"] if order == 2 and len(states) == 1 else []), "u", "t"]
    parts = []
    for state in states:
        begun = r.choice(
            [f"-{r.choice(PARAMETERS)} {state}", "", "", f"a - b {state}", f"{r.choice(PARAMETERS)} {state}"]
        )
        rest = formula(r, names, r.choice([0, 1, 1, 2, 3]))
        parts.append(
            f"{state}{chr(39) * order} = " + (f"{begun} + {rest}" if begun and r.random() < 0.6 else begun or rest)
        )
    return "; ".join(parts)


def equations(r: random.Random, states: Sequence[str], order: int) -> str:
    """Return an equation of each state, and at times what may follow: starts, events, bounds, observations."""
    state, parameter, number = r.choice(states), r.choice(PARAMETERS), r.choice(NUMBERS)
    more = {
        "start": f"{state}(0) = {r.choice([parameter, number, 'm', 'x0', 'steady()'])}",
        "event": f"{state} {r.choice('<>')} {number}: {state} = {r.choice([number, parameter, '-' + state])}",
        "time event": f"t > {r.choice([number, 'tau'])}: {state} = {state} + {r.choice([number, parameter])}",
        "bound": r.choice([f"{parameter} > 0", f"0 < {parameter} < {number}", f"{parameter} >= {number}"]),
        "observation": f"z = {formula(r, list(states), r.choice([0, 1, 2]))}",
    }
    chosen = r.sample(list(more), r.choice([0, 0, 0, 0, 0, 0, 1, 2]))
    return "; ".join([rates(r, states, order), *(more[name] for name in chosen)])


def fits(r: random.Random) -> Case:
    """Fits of equations to small tables, with options, and what is written of them."""
    states, order = r.choice([["x"], ["x"], ["x"], ["x", "y"]]), r.choice([1, 1, 2])
    given = ["fit", "t.csv", equations(r, states, order)]
    if r.random() < 0.3:
        given += ["--set", r.choice(SETTINGS)]
    if r.random() < 0.1:
        given += ["--noise", f"{r.choice(states)}={r.choice(['0.1', '1e-6', '1e6'])}"]
    if r.random() < 0.1:
        given += ["--initial-value", f"{states[0]}={r.choice(['1', '0', 'free', 'x0', 'm'])}"]
    if r.random() < 0.1:
        given += ["--shared", r.choice(PARAMETERS)]
    if r.random() < 0.1:
        given += r.choice([["--hold-out", "object=o1"], ["--where", "trial=0"], ["--json"]])
    saved = r.sample(SAVED, 1) if r.random() < 0.3 else []
    given += [word for each in saved for word in ("--save", each)]
    return Case((*given,), {"t.csv": table(r, states, 0.4)}, frozenset(saved))


def comparisons(r: random.Random) -> Case:
    """Several laws of one small table."""
    states, order = r.choice([["x"], ["x"], ["x"], ["x", "y"]]), r.choice([1, 1, 2])
    laws = [equations(r, states, order) for _ in range(r.choice([1, 2, 2]))]
    return Case(("compare", "t.csv", *laws), {"t.csv": table(r, states, 0.3)})


def searches(r: random.Random) -> Case:
    """Searches of a few terms in small tables."""
    states = r.choice([["x"], ["x"], ["x"], ["x", "y"]])
    given = ["discover", "t.csv", "--order", r.choice(["1", "2", "auto", "0"]), "--library", r.choice(LIBRARIES)]
    if r.random() < 0.7:
        given += [word for setting in r.choice(REGRESSIONS) for word in ("--set", setting)]
    elif r.random() < 0.3:
        given += ["--set", r.choice(SETTINGS)]
    if r.random() < 0.3:
        given += ["--learn-until", r.choice(["0", "1", "2", "3", "-1", "1e9"])]
    if r.random() < 0.1:
        given += r.choice([["--hold-out", "object=o1"], ["--where", "trial=0"], ["--json"], ["--exclude", "trial=0"]])
    saved = r.sample(SAVED, 1) if r.random() < 0.2 else []
    given += [word for each in saved for word in ("--save", each)]
    return Case((*given,), {"t.csv": table(r, states, 0.6)}, frozenset(saved))


def checks(r: random.Random) -> Case:
    """Checks of small tables, with and without options."""
    states = r.choice([["x"], ["x", "y"]])
    given = ["data", "check", "t.csv"]
    if r.random() < 0.4:
        given += ["--state", "x"]
    if r.random() < 0.3:
        given += ["--order", r.choice(["0", "1", "2"]), "--library", r.choice(LIBRARIES)]
    if r.random() < 0.2:
        given += r.choice([["--time", "t"], ["--json"], ["--save", "schema.toml"], ["--where", "object=o0"]])
    return Case((*given,), {"t.csv": table(r, states, 1)}, frozenset({"schema.toml"}))


USES = (
    "law.summary()", "law.equations()", "law._repr_html_()", "law.params", "law.conf_int()", "law.cov_params()",
    "law.sample(50)", "law.quantities()", "law.models", "law.comparison", "str(law.history)", "law.predict(trials)",
    "law.predict(trials, return_std=True)", "law.predict(trials, start='all')", "law.predict(trials, times=[1.0, 2.0])",
    "law.predict(trials, from_time=1.0)", "law.score(trials)", "law.score(trials, 'rmse')", "law.residuals(trials)",
    "law.assess(trials)", "law.discrepancy(trials)", "law.report(trials)", "law.update(trials)", "law.simplify()",
    "law.explain('m')", "law.diagnostics", "cl.bounds(law, trials)", "repr(law)", "law.support",
    "law.save('law.json'); cl.Law.load('law.json')", "law.save('law.parquet'); cl.Law.load('law.parquet')",
    "law.simulate([0.0, 1.0, 2.0], [1.0] * len(law.terms.variables.states))", "pickle.loads(pickle.dumps(law))",
    "law.simulate([0.0, 1e3], [0.0] * len(law.terms.variables.states))", "copy.deepcopy(law)",
    "cl.plots.plot_law(law, trials)", "cl.plots.plot_coefficients(law)", "cl.plots.plot_forecast(law.predict(trials))",
    "trials.check()", "trials.to_frame()", "cl.refine(law, trials)",
)  # fmt: skip
"""What is done with a law and trials."""


def programs(r: random.Random) -> Case:
    """Programs that fit a law and use it."""
    states, order = r.choice([["x"], ["x"], ["x"], ["x", "y"]]), r.choice([1, 1, 2])
    search = f"cl.discover(trials, order={order}, library={r.choice(LIBRARIES)!r}, method=cl.DerivativeRegression())"
    found = search if r.random() < 0.3 else f"cl.fit({equations(r, states, order)!r}, trials)"
    lines = ["trials = cl.Trials.read('t.csv')", f"law = {found}", *r.sample(USES, r.choice([2, 4, 6]))]
    made = frozenset({"law.json", "law.parquet"})
    return Case((), {"t.csv": table(r, states, 0.2)}, made, program=lines)


def statements(r: random.Random) -> Case:
    """Programs that state a law with its numbers, and show, draw and forecast it."""
    states, order = r.choice([["x"], ["x"], ["x"], ["x", "y"]]), r.choice([1, 1, 2])
    text = rates(r, states, order)
    numbers = [0, 1, -1, 0.5, -0.3, 2, 20, 1e-9, 1e9, *(r.choice([1e150, 1e300, -1e300, 5e-324]),) * (r.random() < 0.3)]
    values = {name: r.choice(numbers) for name in PARAMETERS if re.search(rf"\b{name}\b", text)}
    law = f"law = cl.Law.from_text({text!r}, {values!r}, inputs=['u'])"
    shown = ["law.summary()", "law._repr_html_()", "law.equations()", "law.quantities()", "law.params", "repr(law)"]
    start = [r.choice([0, 1, -1, 20, 1e6]) for _ in range(len(states) * order)]
    shown.append(f"law.simulate([0.0, 1.0, {r.choice([2.0, 100.0, 1e6])}], {start}, inputs={{'u': 1.0}})")
    shown.append("law.predict(cl.Trials.read('t.csv'))")
    shown += [
        f"law.save({each!r})" for each in ("law.json", "law.py", "law.c", "law.m", "law.mo", "law.xml", "law.xlsx")
    ]
    made = frozenset({"law.json", "law.py", "law.c", "law.m", "law.mo", "law.xml", "law.xlsx"})
    return Case((), {"t.csv": table(r, states, 0.2)}, made, program=[law, *r.sample(shown, r.choice([2, 4, 6]))])


def uses(r: random.Random, law: bytes, rows: bytes) -> Case:
    """Commands that use a saved law whose numbers were changed, on a table that may be another."""
    document = json.loads(law)
    numbers = [1e-300, 1e-9, -1e9, 1e9, 1e150, 0.0, 1.0, -1.0]
    for rows_of_object in document["coefficients"].values():
        if r.random() < 0.5:
            rows_of_object[0][0] = r.choice(numbers)
    usual = [
        *(("predict", *words.split()) for words in ("", "--until 100", "--from 0.2", "--initial-samples all")),
        *(("check",), ("discrepancy",), ("bounds",), ("compare",), ("predict", "--phase-plane")),
        *(("refine", "--save", "out.json"), ("design", "--vary", "height=5..60")),
    ]
    command = ("report", "--save", "out.html") if r.random() < 0.02 else r.choice(usual)
    content = table(r, ["height"]) if r.random() < 0.3 else rows
    files = {"law.json": json.dumps(document).encode(), "drops.csv": content}
    return Case((command[0], "drops.csv", "law.json", *command[1:]), files, frozenset({"out.html", "out.json"}))
