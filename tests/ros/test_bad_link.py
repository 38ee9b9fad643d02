"""Lost, repeated, late and reordered messages between the nodes: counted, survived, never obeyed out of order."""

import os
import subprocess
import sys
from pathlib import Path

import bad_link
import numpy as np
import pytest
from bad_link import DELAYED, LOST, SWAPPED, TWICE, fate
from los_testbed.run.processes.node_launch import node_command
from los_testbed.run.runner import Runner
from ros_runs import PLANT, assert_gaps_are_counted, config_for, judged_at_pace, lost_samples, span_of

from pointing_analysis.read.run import Run

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
    return results, run, span_of(run)


def among(stamps, *kinds):
    return sum(fate(int(stamp)) in kinds for stamp in stamps)


def test_the_plant_never_stops(recorded):
    results, run, stamps = recorded
    assert TICKS - 100 < len(stamps) <= TICKS == int(results.statistics["plant"]["ticks"])
    assert not results.failures
    assert run["fsm/command"].stamp[-1] >= stamps[-1] - 500 * MS, "the loop works until the end"


def test_the_link_is_as_bad_as_it_is_meant_to_be(recorded):
    """What the recorder got over the link: otherwise the tests below would prove nothing."""
    _, run, stamps = recorded
    received = set(run["m1/accel"].stamp.tolist())
    assert not any(int(stamp) in received for stamp in stamps if fate(int(stamp)) == LOST)
    assert len(received) + lost_samples(run, "m1/accel") == len(stamps)
    assert len(received) >= 0.1 * (TICKS - among(stamps, LOST))
    if judged_at_pace(run, "the share of samples that come over the link"):
        assert len(received) >= 0.8 * (TICKS - among(stamps, LOST))


def test_repeated_and_late_commands_are_counted_and_not_obeyed(recorded):
    """Every command that came twice or out of order; more can be late on a busy machine, and none can be missing.

    Where the loop does not keep pace, a newer command may be there before the copy of an older one: it counts as late.
    """
    results, run, stamps = recorded
    plant = results.statistics["plant"]
    at_pace = judged_at_pace(run, "that commands that come twice are counted as such")
    # a tick whose sensor was lost has no command at all: the link then has nothing to repeat or to delay
    sent = set(run["fsm/command"].stamp.tolist())
    for name in ("fsm", "pma"):
        twice = sum(fate(s) == TWICE for s in sent)
        old = sum(fate(s) in (DELAYED, SWAPPED) for s in sent)
        duplicate, late = (int(plant.get(f"rejected_{name}_{reason}", 0)) for reason in ("duplicate", "late"))
        assert duplicate <= twice + lost_samples(run, f"{name}/command")
        assert duplicate > 0 or not at_pace
        assert duplicate + late >= twice + old
    assert int(plant["missed_ticks"]) >= among(stamps, LOST)


def test_the_estimator_steps_over_what_is_missing_and_goes_on(recorded):
    results, run, stamps = recorded
    estimates = run["los_estimate"]
    assert_gaps_are_counted(run, "los_estimate", "estimator")
    assert_gaps_are_counted(run, "fsm/command", "controller")
    assert not among(estimates.stamp, LOST)
    # a delayed sample is late when a newer tick is already complete; a busy machine may still take it in time
    made = set(estimates.stamp.tolist())
    too_late = [s for s in stamps[:-10] if fate(int(s)) in (DELAYED, SWAPPED) and int(s) not in made]
    unknown = lost_samples(run, "los_estimate")  # estimated, perhaps, and not in the bag
    assert len(too_late) <= int(results.statistics["estimator"]["rejected_late"]) + unknown
    if judged_at_pace(run, "that samples come too late"):
        assert too_late
    assert np.isfinite(estimates.values).all()
    assert np.all(np.diff(estimates.stamp) >= MS), "in order, none twice"


def test_the_mirror_never_goes_back_to_an_older_command(recorded):
    """Each angle of the strain gauge (noise 1e-8 rad) is looked up among the commands of the last 40 ticks.

    Where the loop does not keep pace, few commands are obeyed, perhaps none: what can be compared, must agree. A mirror
    that fades to zero passes the angles of some commands by chance, but not of one at each of nine ticks.
    """
    _, run, _ = recorded
    gauge, command = run["fsm/strain_gauge"], run["fsm/command"]
    angle, stamps = gauge.values[:, 0], gauge.stamp
    if judged_at_pace(run, "that the mirror moves"):
        assert np.abs(angle).max() > 5e-5, "the loop works"
    steepest = np.abs(np.diff(command.values[600:, 0]) / np.diff(command.stamp[600:])).max()
    slope = np.abs(np.gradient(command.values[:, 0], command.stamp))
    obeyed = np.full(len(stamps), -1)
    for k in range(600, len(stamps)):
        first, end = np.searchsorted(command.stamp, [stamps[k] - 40 * MS, stamps[k]])
        if end - first < 5 or slope[first:end].min() < 0.3 * steepest:  # near its turning points an angle comes twice
            continue
        nearest = first + int(np.argmin(np.abs(command.values[first:end, 0] - angle[k])))
        if abs(command.values[nearest, 0] - angle[k]) < 6e-8:
            obeyed[k] = nearest
    sure = np.flatnonzero(np.convolve(obeyed >= 0, np.ones(9), "same") == 9)
    follows = sure[1:][np.diff(stamps[sure]) == MS]
    assert np.all(obeyed[follows] >= obeyed[follows - 1])
    if judged_at_pace(run, "that commands are obeyed at once"):
        assert len(follows) > 20
