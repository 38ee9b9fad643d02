"""When the recorder ends its bag and begins another: the plant holds after a run."""

from collections import deque

import numpy as np
import pytest

pytest.importorskip("rclpy")
from los_testbed.bags.cdr import codec_for
from los_testbed.loop.source_guard import OURS, SourceGuard
from los_testbed.nodes.recorder import Recorder
from los_testbed.nodes.support.track import Track
from los_testbed.topics import TOPICS, Topic

from titop_plant.interface import TICK_NS

pytestmark = pytest.mark.ros
HOLD = 0


class Queue:
    """A subscription without middleware."""

    def __init__(self, topic: Topic) -> None:
        self.topic, self.guard, self.waiting = topic, SourceGuard("/telescope/node"), deque()

    def send(self, stamp: int) -> None:
        self.waiting.append(bytes(codec_for(self.topic).encode(stamp, np.zeros(self.topic.size))))

    def take(self):
        return (self.waiting.popleft(), {"received_timestamp": 1, "source_timestamp": 1}) if self.waiting else None

    def sort(self, taken, now):
        return OURS


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


def test_an_answer_that_is_taken_before_its_tick_is_no_other_run():
    """The plant's topics were looked at just before the first tick, the observer's just after it."""
    made, plant, followers = recorder()
    assert not drained(made, HOLD, *plant, *followers)
    assert not drained(made, TICK_NS, *followers)
    assert not drained(made, TICK_NS, *plant)
    assert all(track.distinct == 1 for track in made.tracks)


def test_a_plant_that_holds_after_its_run_is_another_run():
    made, plant, followers = recorder()
    for tick in range(1, 4):
        assert not drained(made, tick * TICK_NS, *plant, *followers)
    assert not drained(made, HOLD, plant[0]), "one topic"
    assert drained(made, HOLD, *plant)
