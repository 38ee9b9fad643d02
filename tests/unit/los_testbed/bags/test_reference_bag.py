"""The small bag of the repository: opens, is small, holds what a run holds."""

from pathlib import Path

import numpy as np
from los_testbed.bags.check import check_bag
from los_testbed.config.topics import TOPICS
from los_testbed.run import replay

from pointing_analysis.read.run import Run
from pointing_analysis.replay.replay import compare

BAG = Path(__file__).parents[4] / "bags" / "reference"


def test_it_is_small_and_whole() -> None:
    stored = [BAG / "metadata.yaml", *BAG.glob("*.mcap")]  # beside a report that somebody has made
    assert sum(file.stat().st_size for file in stored) <= 2_000_000
    run = Run.open(BAG)
    assert not run.problems
    assert "dirty" not in run.parameters["commit"], "recorded from a tree without changes"
    ticks = round(1000 * run.parameters["duration"])
    assert ticks >= 4000
    for topic in TOPICS:
        found = run[topic.name]
        assert len(found) == (ticks // 20 if topic.framed else ticks), topic.name
        assert found.integrity.missing == 0
    assert run.parameters["mode"] == "inprocess"


def test_its_format_is_the_present_one() -> None:
    """With a digest of each chunk and a chain to its end."""
    states = {row.name: row.state for row in check_bag(BAG).rows}
    assert states.pop("signature") == "none"
    assert set(states.values()) == {"agrees"}, states


def test_its_controllers_give_its_commands_again() -> None:
    """To rounding: another processor may add up in another order."""
    run = Run.open(BAG)
    chosen = replay.controllers(run)
    assert chosen.as_recorded
    replayed = replay.drive(run, chosen, lambda done, total: None)
    for difference in compare(run, replayed).differences:
        scale = np.abs(run[difference.topic].values).max()
        assert difference.missing == 0
        assert difference.largest <= 1e-9 * scale
