"""What is said of a run that did not end by its plan."""

import pytest

from pointing_analysis.read.run_end import run_end

PLAN = {"duration": 10.0, "rate_hz": 1000, "mode": "realtime"}


def of_plant(**plant):
    return run_end({**PLAN, "statistics": {"plant": plant}}).text


def test_a_run_by_its_plan_says_nothing():
    assert of_plant(ticks="10000") == of_plant(ticks="10000", planned_ticks="10000") == ""


def test_a_plant_that_was_started_again_has_a_plan_of_its_own():
    """It has the rest of the run; the configuration of the recorder has the whole."""
    assert of_plant(ticks="6800", planned_ticks="6800") == ""
    assert of_plant(ticks="10000", planned_ticks="20000") == "the run ended early: after 10000 of 20000 ticks"


def test_an_early_end_has_both_counts():
    assert of_plant(ticks="9999") == "the run ended early: after 9999 of 10000 ticks"


@pytest.mark.parametrize(
    ("mode", "said"), [("realtime", True), ("lockstep", True), ("inprocess", False), (None, False)]
)
def test_a_plant_that_was_killed_before_its_first_report_is_not_taken_for_one_that_ended(mode, said):
    assert bool(run_end({**PLAN, "mode": mode, "statistics": {"recorder": {"messages": "5"}}}).text) is said


@pytest.mark.parametrize(
    "parameters",
    [
        {},
        PLAN,
        {**PLAN, "statistics": "none"},
        {**PLAN, "duration": float("nan"), "statistics": {"plant": {"ticks": "5"}}},
        {**PLAN, "duration": float("inf"), "statistics": {"plant": {"ticks": "5"}}},
        {**PLAN, "duration": "ten", "statistics": {"plant": {"ticks": "5"}}},
        {"statistics": {"plant": {"ticks": "5"}}},
    ],
)
def test_nothing_is_said_where_no_plan_is_known(parameters):
    assert run_end(parameters).text == ""
