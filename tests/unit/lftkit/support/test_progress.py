"""The progress bar writes to the error output only, and to nothing where it is off."""

import pytest

from lftkit.support.progress import Progress


@pytest.mark.parametrize("shown", [True, False])
def test_the_standard_output_stays_free_and_lines_stay_only_when_shown(capsys, shown):
    with Progress("tuning", shown) as bar:
        bar.report(1, 3, best=0.125)
        bar.print("round 1")
    out, err = capsys.readouterr()
    assert out == ""
    assert err.split() == (["round", "1"] if shown else [])


def test_a_terminal_shows_part_count_and_best_value(capsys, monkeypatch):
    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.setenv("COLUMNS", "120")
    with Progress("tuning") as bar:
        bar.report(1, 3, what="start 2", best=0.125)
    _, err = capsys.readouterr()
    for text in ("start 2, best 0.125", "1/3"):
        assert text in err
