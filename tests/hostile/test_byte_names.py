"""Files whose names are bytes and no text, as Linux lets them be."""

import pytest

import commonlaw as cl

BYTES = "b\udcff"
"""As Python has the name of a file that is not text in UTF-8."""

QUICK = ["--order", "2", "--library", "poly:1", "--set", "solver=group-stlsq:1.5"]


@pytest.mark.parametrize(
    ("words", "written"),
    [
        (["data", "check"], None),
        (["data", "export", "--save", f"{BYTES}.parquet"], f"{BYTES}.parquet"),
        (["discover", *QUICK, "--save", f"{BYTES}.json", "--save", f"{BYTES}.svg"], f"{BYTES}.svg"),
        (["discover", *QUICK, "--json"], None),
        (["report", *QUICK, "--save", f"{BYTES}.html"], f"{BYTES}.html"),
        (["discover", *QUICK, "--each", "--save", f"{BYTES}-all.csv"], f"{BYTES}-all.csv"),
    ],
)
def test_a_name_of_a_file_may_be_any_bytes(run, tmp_path, words, written):
    frame = cl.datasets.linear_drag(drag=(-0.1,), trials=1, noise=0.01).to_frame()
    frame[["t", "x"]].to_csv(tmp_path / f"{BYTES}.csv", index=False)
    code, _, err = run(*words, f"{BYTES}.csv")
    assert (code, "UnicodeEncodeError" in err) == (0, False)
    assert written is None or (tmp_path / written).stat().st_size
