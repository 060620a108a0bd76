"""`commonlaw report`: one command, one page that opens by itself."""

import commonlaw as cl


def test_a_table_becomes_a_page_that_opens_by_itself(run, tmp_path, check_page):
    cl.datasets.linear_drag(drag=(-0.1, -0.5), noise=0.05).to_csv(tmp_path / "drops.csv")
    arguments = ("drops.csv", "--order", 2, "--library", "poly:1", "--hold-out", "trial=2")
    code, out, err = run("discover", *arguments, "--save", "drops.html")
    assert "Note: columns recognized as time: t; object: object; trial: trial; state: x; prop" in err
    assert (code, out.splitlines()[-1]) == (0, "Wrote drops.html")
    page = (tmp_path / "drops.html").read_text()
    assert "commonlaw discover drops.csv --order 2" in page
    assert "held-out trials" in page
    check_page(tmp_path / "drops.html")

    cl.Law.from_text("x'' = -9.8 - c v", {"c": {"Ball 1": 0.1, "Ball 2": 0.5}}).save(tmp_path / "law.json")
    code, _, _ = run("report", "drops.csv", "law.json", "--hold-out", "trial=2")
    saved = (tmp_path / "report.html").read_text()
    assert code == 0
    assert "commonlaw report drops.csv law.json" in saved
    assert "Their standard errors are unknown" in saved


def test_a_report_without_a_law_finds_one_as_in_the_last_release(run, tmp_path):
    cl.datasets.linear_drag(drag=(-0.1, -0.5), noise=0.05).to_csv(tmp_path / "drops.csv")
    code, _, err = run("report", "drops.csv", "--order", 2, "--library", "poly:1", "--out", "drops.html")
    assert (code, "report without a law is deprecated" in err) == (0, True)
    assert (tmp_path / "drops.html").exists()


def test_a_page_that_cannot_be_written_is_refused_before_work(run):
    code, out, err = run("report", "dataset:lorenz", "--save", "absent/report.html")
    assert code == 1
    assert "there is no folder 'absent'" in err
    assert "Traceback" not in out + err
