"""Lost, repeated, late and reordered messages between the nodes: counted, survived, never obeyed out of order."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("rclpy")
import bad_link
from bad_link import DELAYED, LOST, SWAPPED, TWICE, fate
from los_testbed.run.runner import Runner, node_command
from ros_runs import PLANT, config_for

from pointing_analysis.read import Run

pytestmark = pytest.mark.ros
MS = 1_000_000
TICKS = 3000


def over_link(command, *names):
    remapped = [part for name in names for part in ("-r", f"{name}:=link/{name}")]
    return [*command, "--ros-args", *remapped]


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    """A run whose commands, and one of whose sensors, go over the bad link."""
    folder = tmp_path_factory.mktemp("bad_link")
    config = config_for(folder, duration=TICKS / 1000)
    names = ["fsm/command", "pma/command", "m1/accel"]
    variables = {**os.environ, "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
    script = str(Path(bad_link.__file__))
    link = subprocess.Popen([sys.executable, script, str(config.domain), *names], env=variables)
    commands = {
        "plant": over_link(PLANT, "m1/accel"),
        "controller": over_link(node_command("controller"), "fsm/command", "pma/command"),
    }
    try:
        results = Runner(config, commands=commands).run()
    finally:
        link.terminate()
        link.wait(10)
    run = Run.open(results.bag)
    return results, run, run["truth/los"].stamp


def among(stamps, *kinds):
    return sum(fate(int(stamp)) in kinds for stamp in stamps)


def test_the_plant_never_stops(recorded):
    results, run, stamps = recorded
    assert len(stamps) == TICKS
    assert np.all(np.diff(stamps) == MS)
    assert not results.failures
    assert run["fsm/command"].stamp[-1] >= stamps[-1] - 5 * MS


def test_the_link_is_as_bad_as_it_is_meant_to_be(recorded):
    """What the recorder got over the link: otherwise the tests below would prove nothing."""
    _, run, stamps = recorded
    there = set(run["m1/accel"].stamp.tolist())
    assert not any(int(stamp) in there for stamp in stamps if fate(int(stamp)) == LOST)
    assert len(there) >= TICKS - among(stamps, LOST) - 5


def test_repeated_and_late_commands_are_counted_and_not_obeyed(recorded):
    """Every command that came twice or out of order; more can be late on a busy machine, and none can be missing."""
    results, run, stamps = recorded
    plant = results.statistics["plant"]
    # a tick whose sensor was lost has no command at all: the link then has nothing to repeat or to delay
    sent = set(run["fsm/command"].stamp.tolist())
    for name in ("fsm", "pma"):
        twice = sum(fate(s) == TWICE for s in sent)
        old = sum(fate(s) in (DELAYED, SWAPPED) for s in sent)
        duplicate, late = (int(plant.get(f"rejected_{name}_{reason}", 0)) for reason in ("duplicate", "late"))
        assert twice > 20
        assert 0.5 * twice < duplicate <= twice
        assert duplicate + late >= twice + old
    assert int(plant["missed_ticks"]) >= among(stamps, LOST)


def test_the_estimator_steps_over_what_is_missing_and_goes_on(recorded):
    results, run, stamps = recorded
    estimator, controller = results.statistics["estimator"], results.statistics["controller"]
    gaps = int(estimator["gap_ticks"])
    # lost ones, and those that come when a newer tick is already complete
    assert gaps >= among(stamps[:-10], LOST, DELAYED, SWAPPED)
    assert int(estimator["rejected_late"]) >= among(stamps[:-10], DELAYED, SWAPPED)
    assert int(estimator["ticks"]) + gaps >= TICKS - 5
    assert int(controller["gap_ticks"]) >= gaps - 5
    assert np.isfinite(run["los_estimate"].values).all()
    assert np.all(np.diff(run["los_estimate"].stamp) >= MS), "in order, none twice"


def test_the_mirror_moves_as_smoothly_as_without_the_faults(recorded):
    """One command that is held for some ticks is a small step; an old one applied again would be a step back."""
    _, run, _ = recorded
    angle = run["fsm/strain_gauge"].values[600:, :2]
    assert np.abs(angle).max() > 5e-5, "the loop works"
    speed = 2 * np.pi * 3 * np.abs(angle).max() * 1e-3  # of the 3 Hz motion, per tick
    assert np.abs(np.diff(angle, axis=0)).max() < 6 * speed
