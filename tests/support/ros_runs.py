"""Real runs with processes for tests: a private domain, the small telescope as plant."""

from __future__ import annotations

import contextlib
import functools
import hashlib
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from los_testbed.config.run_config import RunConfig
from los_testbed.run.loop.simulate import run_in_process
from los_testbed.run.processes.domains import domain_lock
from los_testbed.run.processes.node_launch import environment, node_command, parameter_file, ros_arguments
from los_testbed.run.runner import Runner
from mcap.reader import make_reader
from simple_telescope import write_controllers
from support.unjudged import judged

from pointing_analysis.read.run import Run
from titop_plant.interface import TICK_NS

PLANT_TOPICS = ("truth/los", "isolator/accel", "m1/accel", "m2/accel", "fsm/strain_gauge")
"""Topics that the plant sends at every tick."""

Hashes = dict[str, tuple[int, str]]

_HELD = contextlib.ExitStack()
"""What is freed when this process ends."""

PLANT = [sys.executable, str(Path(__file__).with_name("simple_telescope.py"))]


@functools.cache
def private_domain() -> int:
    """Domain that no other tests on this machine use until this process ends; above 101 ports may be taken."""
    for domain in range(10, 100):
        with contextlib.suppress(ValueError):
            _HELD.enter_context(domain_lock(domain, "/tests"))
            return domain
    raise RuntimeError("a ROS domain from 10 to 99 must be free of other tests")


def config_for(folder: Path, **values: object) -> RunConfig:
    """Configuration of a run with the small telescope that writes to `folder`/bag."""
    base = {
        "duration": 1.0,
        "mode": "realtime",
        "output": str(folder / "bag"),
        "domain": private_domain(),
        "wait_for_recorder": True,
        "start_timeout": 60.0,
        "max_missed": 100.0,  # how many ticks are missed is a matter of the machine
        "start": "rest",  # of the telescope alone is it known what is steady
        **write_controllers(folder),
    }
    return RunConfig.from_mapping({**base, **values})


@contextlib.contextmanager
def live_nodes(
    config: RunConfig, folder: Path, *names: str, variables: Mapping[str, str] | None = None
) -> Iterator[None]:
    """Nodes that are started beside what is under test, with the environment of a run or another one, and ended."""
    parameters = folder / "nodes.yaml"
    parameter_file(config, parameters)
    started = [
        subprocess.Popen(
            [*node_command(name), *ros_arguments(config.namespace, parameters)],
            env=variables or environment(config.domain, folder),
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        for name in names
    ]
    try:
        yield
    finally:
        for process in started:
            process.terminate()
        for process in started:
            process.wait(30)


def until(condition: Callable[[], Any], what: str = "nothing came", seconds: float = 200.0) -> Any:
    """What a condition gives as soon as it is true."""
    end = time.monotonic() + seconds
    while not (found := condition()):
        assert time.monotonic() < end, what
        time.sleep(0.005)
    return found


def lockstep_and_alone(
    config: RunConfig, folder: Path, plant: Any = None
) -> tuple[dict[str, tuple[int, str]], Run, Run]:
    """A run of four processes in lockstep has the bytes of the run in one process, on all topics of this one.

    Returns what :func:`topic_hashes` has of it, and both bags.
    """
    bag = Runner(config, commands={} if plant is None else {"plant": PLANT}).run().bag
    run_in_process(config, folder / "alone", plant)
    ours, theirs = topic_hashes(bag), topic_hashes(folder / "alone")
    assert {topic: ours[topic] for topic in theirs if topic in ours} == theirs and len(theirs) >= 8
    return ours, Run.open(bag), Run.open(folder / "alone")


def span_of(run: Run) -> np.ndarray:
    """Every tick from the first to the last that any topic has in the bag."""
    ends = [run[name].stamp[[0, -1]] for name in run.topics]
    return np.arange(min(first for first, _ in ends), max(last for _, last in ends) + 1, TICK_NS)


def lost_samples(run: Run, topic: str, namespace: str = "/telescope") -> int:
    """What the recorder counted of this topic as lost, or as not sent in a period that the plant had lost."""
    recorder = run.parameters["statistics"]["recorder"]
    return sum(int(recorder.get(f"{kind}_{namespace}/{topic}", 0)) for kind in ("lost", "unsent"))


def assert_gaps_are_counted(run: Run, topic: str, node: str) -> None:
    """Ticks that a node counts as gaps are missing in its topic, and what is missing is counted by the recorder.

    How many there are depends on the machine: a node of the loop would rather miss a sample than wait for it, and a
    recorder that asks too late for a lost sample (the writers keep 100 ticks) goes without.
    """
    stamps, statistics = run[topic].stamp, run.parameters["statistics"]
    missing = (stamps[-1] - stamps[0]) // TICK_NS + 1 - len(stamps)
    assert int(statistics[node]["gap_ticks"]) <= missing, topic
    assert lost_samples(run, topic) == len(span_of(run)) - len(stamps), topic


def keeps_pace(run: Run) -> bool:
    """Whether the loop keeps up with its clock on this machine: half of the mirror commands come within their tick.

    At most one tick of twenty may be missed. Where it does not keep up, the system drops messages between the nodes,
    and how many is a matter of the machine.
    """
    plant = run.parameters["statistics"]["plant"]
    in_time = float(plant["latency_median_us"]) < TICK_NS / 1000
    return in_time and int(plant["missed_ticks"]) <= 0.05 * int(plant["ticks"])


def judged_at_pace(run: Run, what: str) -> bool:
    """Whether something can be judged that is so only where the loop :func:`keeps_pace`; else it is counted."""
    return judged(keeps_pace(run), what, "the loop does not keep pace")


def assert_plant_is_recorded(run: Run, ticks: int, frame_ticks: int = 20, *, joined: bool = False) -> None:
    """Every sample that the plant sent is in the bag, or is counted as lost by the recorder.

    In real time a recorder that gets no processor for more than 100 ticks loses some; more than a fifth of a run fails.
    Where the loop does not keep pace, the share is not judged. In lockstep none may be missing: see the hashes of the
    bags. A recorder that has `joined` a plant that did not wait for it finds one topic after the other: the fifth is
    that of the time after the last.
    """
    span, lost = span_of(run), int(run.parameters["statistics"]["plant"].get("lost_periods", 0))
    assert ticks - 100 - lost < len(span) <= ticks  # periods that the plant has lost may be at the ends
    expected = dict.fromkeys(PLANT_TOPICS, span)
    expected["camera/los"] = span[span // TICK_NS % frame_ticks == 0]
    share_is_judged = judged_at_pace(run, "the share of samples that are recorded")
    found_all = max(run[name].stamp[0] for name in expected) if joined else span[0]
    for name, stamps in expected.items():
        found = run[name].stamp
        assert np.isin(found, stamps).all(), name
        assert np.all(np.diff(found) > 0), name
        assert lost_samples(run, name) == len(stamps) - len(found), name
        after = stamps >= found_all
        if share_is_judged:
            assert after.sum() - (found >= found_all).sum() <= 0.2 * after.sum(), name


def topic_hashes(bag: Path) -> Hashes:
    """Number of messages and hash of all their bytes, topic by topic."""
    hashes: dict[str, tuple[int, hashlib._Hash]] = {}
    with next(bag.glob("*.mcap")).open("rb") as stream:
        for _, channel, message in make_reader(stream).iter_messages(log_time_order=False):
            count, digest = hashes.get(channel.topic, (0, hashlib.sha256()))
            digest.update(message.data)
            hashes[channel.topic] = (count + 1, digest)
    return {topic: (count, digest.hexdigest()) for topic, (count, digest) in sorted(hashes.items())}
