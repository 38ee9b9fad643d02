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


def test_without_a_terminal_lines_say_that_it_goes_on(at_once, capsys):
    choose_output(interval=1e-3, log=at_once)
    with Progress("design") as bar:
        assert lines_of(at_once, 3)[0].startswith("design: ")
        bar.report(20, 80, best=0.5)
        bar.report(40, 80, best=0.5)
        while "40 of 80" not in at_once.read_text():
            time.sleep(1e-3)
    assert re.search(r"design, best 0\.5: 40 of 80, \d+ s, about \d+ s left", at_once.read_text())
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


def test_what_is_short_says_nothing(capsys, monkeypatch):
    monkeypatch.setattr(progress, "FIRST_S", 3600.0)
    with Progress("short"):
        pass
    assert capsys.readouterr() == ("", "")


def test_short_computations_one_after_the_other_have_a_line_each_interval(tmp_path, monkeypatch):
    """None of them lasts until its own first line; an outer one that each of them hides does not either."""
    monkeypatch.setattr(progress, "FIRST_S", 3600.0)
    log = tmp_path / "run.log"
    choose_output(quiet=True, interval=1e-3, log=log)
    monkeypatch.setattr(progress._output, "due", time.monotonic())
    with Progress("outer"):
        lines_of(log, 1)
        number = 0
        while len(log.read_text().splitlines()) < 4 or "inner" not in log.read_text():
            number += 1
            with Progress(f"inner {number}"):
                time.sleep(2e-3)
    choose_output()


def test_the_first_line_counts_from_the_begin_of_the_program(tmp_path, monkeypatch):
    """Not from the first computation: what a program imports before it is silent, too."""
    monkeypatch.setattr(progress, "FIRST_S", 0.2)
    log = tmp_path / "run.log"
    choose_output(quiet=True, interval=3600.0, log=log)
    time.sleep(0.2)
    monkeypatch.setattr(progress, "FIRST_S", 3600.0)  # of the computation alone
    with Progress("design"):
        assert lines_of(log, 1)[0].startswith("design: ")
    choose_output()
