"""The progress bar writes to the error output only, and to nothing where it is off."""

import re
import time

import pytest

from lftkit.support import progress
from lftkit.support.progress import Progress, choose_output


@pytest.fixture(autouse=True)
def as_at_the_start():
    """The choice of a process is that of its last command: other tests have run commands that are quiet."""
    choose_output()


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
    monkeypatch.setenv("TERM", "xterm")  # a dumb one shows no bar
    monkeypatch.setenv("COLUMNS", "120")
    with Progress("tuning") as bar:
        bar.report(1, 3, what="start 2", best=0.125)
    _, err = capsys.readouterr()
    for text in ("start 2, best 0.125", "1/3"):
        assert text in err


@pytest.fixture
def at_once(monkeypatch, tmp_path):
    """Lines without waiting; the log, and output as it was at the end."""
    monkeypatch.setattr(progress, "FIRST_S", 1e-3)
    log = tmp_path / "run.log"
    yield log
    choose_output()


def lines_of(log, number):
    """The first lines of the log, as soon as they are there; the test's own time limit ends the waiting."""
    while not log.exists() or len(log.read_text().splitlines()) < number:
        time.sleep(1e-3)
    return [line.split(" ", 1)[1] for line in log.read_text().splitlines()[:number]]


@pytest.mark.parametrize("equal", [True, False])
def test_without_a_terminal_lines_say_that_it_goes_on(at_once, capsys, equal):
    """How long it takes yet is said of parts that take equal times alone: the last of others may take the longest."""
    choose_output(interval=1e-3, log=at_once)
    with Progress("design", equal=equal) as bar:
        assert lines_of(at_once, 3)[0].startswith("design: ")
        bar.report(20, 80, best=0.5)
        bar.report(40, 80, best=0.5)
        while "40 of 80" not in at_once.read_text():
            time.sleep(1e-3)
    left = ", about [0-9]+ s left" if equal else ""
    assert re.search(rf"design, best 0\.5: 40 of 80, \d+ s{left}$", at_once.read_text(), re.MULTILINE)
    out, err = capsys.readouterr()
    assert out == "" and err.splitlines()[0].startswith("design: ")


def test_the_inner_of_two_is_shown_and_then_the_outer_again(at_once):
    choose_output(quiet=True, interval=1e-3, log=at_once)
    with Progress("outer"):
        with Progress("inner"):
            while "inner" not in at_once.read_text():
                time.sleep(1e-3)
            before = len(at_once.read_text().splitlines())
            assert "outer" not in lines_of(at_once, before + 3)[-1]
        now = len(at_once.read_text().splitlines())
        assert lines_of(at_once, now + 3)[-1].startswith("outer: ")


def test_quiet_is_quiet_but_for_the_log(at_once, capsys):
    choose_output(quiet=True, interval=1e-3, log=at_once)
    with Progress("design") as bar:
        bar.print("round 1")
        lines_of(at_once, 3)
    assert capsys.readouterr() == ("", "") and "round 1" in at_once.read_text()
