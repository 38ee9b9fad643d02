"""What the recorder counts as lost, and takes for another run, for a start and for a report of a node."""

from __future__ import annotations

from collections import deque
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from los_testbed.bags.cdr import codec_for
from los_testbed.bags.diagnostics import Status, write_diagnostics
from los_testbed.config.topics import FSM_COMMAND, TOPICS, TopicDefinition
from los_testbed.nodes.recorder import Recorder
from los_testbed.nodes.support.track import MAX_DISORDER, UNKNOWN_NS, ReportTrack, Track
from los_testbed.nodes.support.transport.serialized_reader import Taken
from los_testbed.run.loop.source_guard import OURS, Endpoint, SourceGuard

from titop_plant.interface import TICK_NS

START, HOLD = 1000, 0


class Queue:
    """A subscription without middleware."""

    def __init__(self, topic: TopicDefinition) -> None:
        self.topic, self.guard = topic, SourceGuard("/telescope/node")
        self.waiting: deque[bytes] = deque()

    def send(self, stamp: int) -> None:
        self.waiting.append(bytes(codec_for(self.topic).encode(stamp, np.zeros(self.topic.size))))

    def take(self):
        return Taken(self.waiting.popleft(), 1, 1, b"\1") if self.waiting else None

    def sort(self, taken, now):
        return OURS


def lost(ticks, last, over=True):
    source = Queue(FSM_COMMAND)
    for tick in ticks:
        source.send(tick * TICK_NS)
    track = Track("fsm/command", source, TICK_NS, codec_for(FSM_COMMAND))
    track.drain()
    return track.lost(START * TICK_NS, last * TICK_NS, over)


@pytest.mark.parametrize(
    ("ticks", "last", "expected"),
    [
        (range(START, START + 100), START + 99, 0),
        ([START, START + 1, START + 3], START + 3, 1),
        ([START, START + 2, START + 1, START + 3], START + 3, 0),
        ([START, START + 3, START + 1, START + 1, START + 3], START + 3, 1),
        ([START, START + 1], START + 4, 3),
        ([START, START + 5, START + 10, START + 4, START + 9, START + 4], START + 10, 6),
    ],
    ids=["whole", "a gap", "swapped", "late and twice", "the end", "two gaps"],
)
def test_late_samples_are_not_lost(ticks, last, expected):
    assert lost(ticks, last) == expected


@pytest.mark.parametrize(
    ("ticks", "last", "expected"),
    [
        ([], START + 9, 0),
        (range(START, START + 5), START + 9, 0),
        ([START, START + 1, START + 3], START + 9, 1),
        ([START + 2, START + 3], START + 9, 2),
        ([START, START + 1, START + 3, START + 7], START + 4, 2),
        ([START, START + 3, START + 1], START + 9, 1),
    ],
    ids=["nothing yet", "in flight", "a gap", "the beginning", "after what the plant has reported", "one came late"],
)
def test_during_a_run_a_sample_is_lost_when_a_later_one_has_come(ticks, last, expected):
    assert lost(ticks, last, over=False) == expected


def test_a_clock_that_drifts_loses_no_sample():
    """Frames of a camera whose clock is 500 ppm slow: after 40 s they are a period behind the grid of the first."""
    source = Queue(FSM_COMMAND)
    track = Track("camera", source, 20 * TICK_NS, codec_for(FSM_COMMAND))
    stamps = [round(k * 20.01 * TICK_NS) for k in range(1, 5000)]
    for stamp in stamps:
        source.send(stamp)
    track.drain()
    assert track.lost(stamps[0], stamps[-1]) == 0 and track.kept == len(stamps)


def test_a_sample_that_is_later_than_the_limit_stays_lost():
    far = START + 2 * MAX_DISORDER
    assert lost([START, far, START + 1, far - 1], far) == far - START + 1 - 3


def recorder():
    """Its tracks alone, and their queues by publisher."""
    made = object.__new__(Recorder)
    queues = [Queue(topic) for topic in TOPICS]
    made.tracks = [Track(topic.name, queue, TICK_NS, codec_for(topic)) for topic, queue in zip(TOPICS, queues)]
    made._from_plant = [track for track, topic in zip(made.tracks, TOPICS) if topic.publisher == "plant"]
    plant = [queue for queue in queues if queue.topic.publisher == "plant"]
    return made, plant, [queue for queue in queues if queue not in plant]


def drained(made, stamp, *senders):
    """Send one tick, take what came."""
    for queue in senders:
        queue.send(stamp)
    for track in made.tracks:
        track.drain()
    return made._another_run()


def test_answers_in_flight_are_not_lost_before_the_run_is_over():
    """The report comes when the tick that it follows is there and its answers are not."""
    made, plant, followers = recorder()
    made.parts, made.context = SimpleNamespace(topics=TOPICS), SimpleNamespace(config=SimpleNamespace(device=None))
    made.watch, made._late, made.statistics = SimpleNamespace(statistics=dict), None, {}
    made.reports = {"plant": SimpleNamespace(path="plant", stamp=9 * TICK_NS, unreadable=0, foreign=0)}
    for tick in range(1, 10):
        drained(made, tick * TICK_NS, *plant, *(followers if tick not in (4, 9) else ()))
    assert made.own_statistics(over=False)["samples_lost"] == str(len(followers)), "of tick 4"
    assert made.own_statistics()["samples_lost"] == str(2 * len(followers)), "and of tick 9"


def test_a_plant_that_holds_after_its_run_is_another_run():
    made, plant, followers = recorder()
    for tick in range(1, 4):
        assert not drained(made, tick * TICK_NS, *plant, *followers)
    assert not drained(made, HOLD, plant[0]), "one topic"
    assert drained(made, HOLD, *plant)


def test_answers_of_the_last_run_that_come_late_are_not_of_the_next_one():
    """A controller that was held up answers ticks of the run that broke off, then holds."""
    made, plant, followers = recorder()
    for tick in range(1, 4):
        drained(made, tick * TICK_NS, *plant)
        drained(made, tick * TICK_NS, *followers)
    assert drained(made, HOLD, *plant)
    for track in made.tracks:
        track.data = []
        track.begin_again()
    drained(made, 4 * TICK_NS, *followers)
    drained(made, HOLD, *followers)
    drained(made, 1000 * TICK_NS, *plant)
    drained(made, 1000 * TICK_NS, *followers)
    assert all((len(track.data), track.first, track.kept) == (1, 1000 * TICK_NS, 1) for track in made.tracks)


@pytest.mark.parametrize("node", ["/telescope/node", ""])
def test_the_run_begins_when_the_graph_knows_the_nodes_or_has_had_its_time(node):
    made, plant, followers = recorder()
    endpoints = [Endpoint("01", "")]
    for queue in (*plant, *followers):
        queue.endpoints = lambda: endpoints
    made.reports, made.simulated, made._named, made._held_since = {}, True, False, 0
    sent: list[int] = []
    made._header, made.progress = SimpleNamespace(encode=lambda stamp: stamp), SimpleNamespace(publish=sent.append)

    def progress_at(time_ns):
        made._look_for_names(time_ns)
        made._tell_progress()
        return sent

    drained(made, HOLD, *plant, *followers)
    assert progress_at(1) == progress_at(UNKNOWN_NS) == []
    endpoints[:] = [Endpoint("01", node)]
    assert progress_at(UNKNOWN_NS + 1) == ([HOLD] if node else [])
    assert set(progress_at(UNKNOWN_NS + 2)) == {HOLD}


def test_a_report_waits_until_the_graph_knows_its_node():
    queue: Any = Queue(TOPICS[0])
    queue.name, queue.guard.expected = "/telescope/plant/diagnostics", "/telescope/plant"
    endpoints: list[Endpoint] = []
    queue.endpoints = lambda: endpoints
    track = ReportTrack(queue)
    for publisher in ("01", "02"):
        status = Status(0, "telescope: plant", "", {"from": publisher})
        taken = Taken(write_diagnostics(0, "", status), 1, 1, bytes.fromhex(publisher))
        queue.take = iter([taken, None]).__next__
        track.drain()
    assert (track.statistics, track.foreign) == ({}, 2)
    endpoints += [Endpoint("01", "/telescope/plant"), Endpoint("02", "/stranger")]
    queue.take = lambda: None
    track.drain()
    assert (track.statistics, track.foreign) == ({"from": "01"}, 1)
