"""`commonlaw report`: one command, one page that opens by itself."""

import commonlaw as cl


def test_a_table_becomes_a_page_that_opens_by_itself(run, tmp_path, check_page):
    cl.datasets.linear_drag(drag=(-0.1, -0.5), noise=0.05).to_csv(tmp_path / "drops.csv")
    arguments = ("drops.csv", "--order", 2, "--library", "poly:1", "--hold-out", "trial=2")
    code, out, err = run("report", *arguments, "--out", "drops.html")
    assert err.splitlines()[-1].startswith(
        "Note: columns recognized as time: t; object: object; trial: trial; state: x; prop"
    )
    assert (code, out.strip()) == (0, "Wrote drops.html")
    page = (tmp_path / "drops.html").read_text()
    assert "commonlaw report drops.csv --order 2" in page
    assert "held-out trials" in page
    check_page(tmp_path / "drops.html")

    cl.Law.from_text("x'' = -9.8 - c v", {"c": {"Ball 1": 0.1, "Ball 2": 0.5}}).save(tmp_path / "law.json")
    code, _, _ = run("report", "drops.csv", "--hold-out", "trial=2", "--law", "law.json")
    saved = (tmp_path / "report.html").read_text()
    assert code == 0
    assert "--law law.json" in saved
    assert "Their standard errors are unknown" in saved


def test_a_page_that_cannot_be_written_is_refused_before_work(run):
    code, out, err = run("report", "--dataset", "lorenz", "--out", "absent/report.html")
    assert code == 1
    assert "there is no folder 'absent'" in err
    assert "Traceback" not in out + err
