"""What the recorder counts as lost: samples that never came, not those that came late or twice."""

import numpy as np
import pytest

pytest.importorskip("rclpy")
from los_testbed.bags.cdr import codec_for
from los_testbed.config.topics import FSM_COMMAND
from los_testbed.nodes.support import track as recording
from los_testbed.nodes.support.transport.serialized_reader import Taken
from los_testbed.run.loop.source_guard import OURS, SourceGuard

from titop_plant.interface import TICK_NS

pytestmark = pytest.mark.ros
START = 1000


class Stamps:
    """A subscription that hands out messages with the given ticks."""

    def __init__(self, ticks):
        self.codec = codec_for(FSM_COMMAND)
        self.guard = SourceGuard()
        self.waiting = [bytes(self.codec.encode(tick * TICK_NS, np.zeros(2))) for tick in ticks]

    def take(self):
        if not self.waiting:
            return None
        return Taken(self.waiting.pop(0), 1, 1, b"\1")

    def sort(self, taken, now_ns):
        return OURS


def lost(ticks, last):
    source = Stamps(ticks)
    track = recording.Track("fsm/command", source, TICK_NS, source.codec)
    track.drain()
    return track.lost(START * TICK_NS, last * TICK_NS)


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


def test_a_sample_that_is_later_than_the_limit_stays_lost():
    far = START + 2 * recording.MAX_DISORDER
    assert lost([START, far, START + 1, far - 1], far) == far - START + 1 - 3
