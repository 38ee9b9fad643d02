"""Strangers with the names of the nodes of a run: floods, early ones, requests; the verdict is right or refused."""

import json

import pytest
from attack_campaign import GOOD, case_of, judge, messages_of, run_beside
from attacker import EARLY, Attacker, Case
from los_testbed.run.results import RunError
from los_testbed.run.runner import Runner
from los_testbed.run.summary.summary import print_summary, summarise_runs
from ros_runs import PLANT, config_for, topic_hashes

from pointing_analysis.command.screen import Screen
from pointing_analysis.read.run import Run

DURATION = 1.2
LONG = 120.0
"""Of runs that a request ends: on a fast machine one of a second is over before it comes."""


def attacked(folder, case, **values):
    """Results of a run in lockstep beside a stranger."""
    config = config_for(folder, **{"duration": DURATION, "mode": "lockstep", **values})
    stranger = Attacker(config.domain, case)
    try:
        return Runner(config, commands={"plant": PLANT}).run()
    finally:
        assert "sent" in stranger.close(), "it has sent"


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory):
    config = config_for(tmp_path_factory.mktemp("undisturbed"), duration=DURATION, mode="lockstep")
    return topic_hashes(Runner(config, commands={"plant": PLANT}).run().bag)


CASES = {
    "truth 1000 s ahead by a second plant": Case("truth/los", "plant", "/telescope", "future", 4000.0),
    "commands off the grid by a second controller": Case("fsm/command", "controller", "/telescope", "off_grid", 4000.0),
    "commands of the next tick": Case("fsm/command", "controller", "/telescope", "next", 2000.0),
}


@pytest.mark.parametrize(
    "case",
    [pytest.param(case, id=name, marks=[pytest.mark.slow] * ("1000 s" not in name)) for name, case in CASES.items()],
)
def test_a_flood_under_the_name_of_a_node_changes_no_message_of_the_bag(tmp_path, undisturbed, case):
    results = attacked(tmp_path, case)
    assert topic_hashes(results.bag) == undisturbed
    (line,) = [text for text in results.failures if text.startswith(f"/telescope/{case.topic} ")]
    assert "not used" in line and "of the same name" in line
    count = int(results.statistics["recorder"][f"foreign_/telescope/{case.topic}"])
    (told,) = [text for text in results.warnings if text.startswith(f"/telescope/{case.topic}: ")]
    assert int(told.split()[1]) >= count > 0
    assert told.endswith("of second publishers were not used")


@pytest.mark.parametrize(
    ("topic", "stamps"),
    [
        ("recorder/progress", "hold"),
        pytest.param("isolator/accel", "future", marks=pytest.mark.slow),
        pytest.param("los_estimate", "future", marks=pytest.mark.slow),
    ],
)
def test_an_early_stranger_does_not_keep_a_run_from_starting_or_is_named(tmp_path, undisturbed, topic, stamps):
    case = Case(topic, stamps=stamps, begin=EARLY, rate=200.0, seconds=20.0)
    refused = ""
    try:
        results = attacked(tmp_path, case)
    except RunError as error:
        refused = str(error)
    assert "/stranger" in refused if refused else topic_hashes(results.bag) == undisturbed


@pytest.mark.usefixtures("without_pictures")
def test_a_stop_by_a_stranger_is_told_with_its_name_and_time_in_table_bag_and_json(tmp_path, undisturbed):
    """The services are for every node of the domain; who used them stands in the bag."""
    results = attacked(tmp_path, Case("plant/stop", begin=500, rate=20.0), duration=LONG)
    run = Run.open(results.bag)
    (row,) = json.loads(run.parameters["statistics"]["plant"]["changes"])
    assert (row["name"], row["by"]) == ("stop", "/stranger")
    assert 500 <= row["tick"] < 1000 * LONG
    assert int(results.statistics["plant"]["ticks"]) == row["tick"] + 1
    found = summarise_runs([results.bag], tmp_path / "report.html", transient=0.1)
    line = f"stopped by request at {row['tick'] / 1000:g} s, from /stranger"
    assert line in found.runs[0]["remarks"]
    assert f"S{line[1:]}." in (tmp_path / "report.html").read_text(), "a sentence among the notes"
    console = Screen()
    with console.capture() as shown:
        print_summary(console, found)
    assert line in shown.get()


def test_a_node_that_a_stranger_shuts_down_ends_a_run_in_lockstep_with_its_name(tmp_path):
    """The plant would wait for its answer for ever."""
    with pytest.raises(RunError, match="controller was shut down by a life-cycle request") as ended:
        attacked(tmp_path, Case("controller/change_state", begin=100, rate=20.0, request="shutdown"), duration=LONG)
    assert ended.value.code == 1
    assert str(tmp_path / "bag") in str(ended.value)
    assert len(Run.open(tmp_path / "bag")["truth/los"]) >= 100


@pytest.fixture(scope="module")
def expected(tmp_path_factory):
    return messages_of(run_beside(tmp_path_factory.mktemp("alone"), None).bag)


@pytest.mark.parametrize("seed", [3, pytest.param(1, marks=pytest.mark.slow)])
def test_cases_of_the_campaign_are_right_or_refused(tmp_path, expected, seed):
    """All of them: make attacks."""
    kind, said = judge(tmp_path, case_of(seed), expected)
    assert kind in GOOD, said
