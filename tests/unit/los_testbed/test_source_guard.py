"""Which publisher a message came from: streams of sequence numbers, lost, restarted, overtaken."""

import pytest
from los_testbed.loop.source_guard import FOREIGN, OURS, UNMATCHED, Endpoint, SourceGuard

from pointing_analysis.read.messages.cdr import STAMP
from titop_plant.interface import TICK_NS

MS = 1_000_000
PLANT = Endpoint("01", "/telescope/plant")
STRANGER = Endpoint("02", "/stranger")


def message(tick):
    """Beginning of a message of this tick; None is a hold tick."""
    return bytes(4) + STAMP.pack(*divmod(0 if tick is None else 10**12 + tick * TICK_NS, 10**9))


class Line:
    """A guard that was matched with /telescope/plant at number 1 by a hold tick; sorts one message a call."""

    def __init__(self, *endpoints):
        self.guard = SourceGuard("/telescope/plant")
        self.now = 0
        assert self.send(1, None) == UNMATCHED
        assert self.guard.decide(endpoints or (PLANT,), self.now)

    def run(self, ticks):
        """So many ticks, numbers 2 and following."""
        for k in range(ticks):
            assert self.send(2 + k, k, after=1) == OURS

    def send(self, number, tick, after=0):
        self.now += after * MS
        return self.guard.sort(number, self.now, self.now, message(tick))


def test_one_publisher_with_lost_messages_is_always_ours():
    line = Line()
    assert line.send(2, 0) == OURS
    assert line.send(40, 38) == OURS, "some were lost within a tick"
    assert line.send(1040, 1038, after=500) == OURS, "many were lost in a pause"
    assert (line.guard.foreign, line.guard.doubled) == (0, False)


@pytest.mark.parametrize("first", [1, 4000, 20_000])
def test_every_message_of_a_second_publisher_is_counted_and_none_of_the_first_is(first):
    line = Line()
    for k in range(6000):
        assert line.send(2 + k, k, after=1) == OURS
        if k >= 5000:
            assert line.send(first + k - 5000, k) == FOREIGN
    assert line.guard.foreign == 1000
    assert line.guard.doubled


def test_a_publisher_that_sends_faster_does_not_take_the_place_when_the_numbers_meet():
    """Ten a tick from number 1: it overtakes at tick 222. A few pass while the numbers are equal, never a hundred."""
    line, passed, ours, number = Line(), 0, 0, 0
    for k in range(2000):
        line.send(2 + k, k, after=1)
    for k in range(2000, 4000):
        ours += line.send(2 + k, k, after=1) == OURS
        for _ in range(10):
            number += 1
            passed += line.send(number, k) == OURS
    assert passed <= 20
    assert ours >= 1980


def test_a_relay_that_repeats_and_swaps_messages_is_one_publisher():
    line = Line()
    ticks = [tick for k in range(0, 500, 5) for tick in (k, k, k + 3, k + 1, k + 4)]  # one of five lost, one twice
    stranger = [line.send(1, 0)]
    sorted_as = [line.send(2 + i, tick, after=1) for i, tick in enumerate(ticks)]
    assert set(sorted_as) == {OURS}
    assert stranger == [FOREIGN]


def test_a_restarted_node_is_matched_by_its_name_and_a_stranger_is_not():
    line = Line()
    line.send(2, 0)
    assert line.send(1, 600, after=600) == UNMATCHED
    assert not line.guard.decide([PLANT, STRANGER], line.now)
    assert line.send(2, 601, after=1) == UNMATCHED
    assert line.guard.decide([PLANT, Endpoint("03", "/telescope/plant")], line.now)
    assert line.send(3, 602, after=1) == OURS
    assert line.guard.foreign == 0, "what came before it was matched was its own"


AGAIN = Endpoint("03", "/telescope/plant")


def test_a_node_that_is_back_within_the_silence_is_no_second_publisher():
    line = Line()
    line.run(2000)
    sorted_as = []
    for k in range(600):
        sorted_as.append(line.send(1 + k, 2100 + k, after=100 if k == 0 else 1))
        line.guard.decide([PLANT, AGAIN], line.now)
    assert sorted_as == [FOREIGN] * 401 + [UNMATCHED] + [OURS] * 198
    assert (line.guard.foreign, line.guard.doubled) == (0, False)


def test_an_impostor_of_the_same_name_does_not_take_the_place_of_a_node_that_pauses():
    line = Line()
    line.run(2000)
    assert line.send(1, 2100, after=100) == FOREIGN
    assert not line.guard.decide([PLANT, AGAIN], line.now)
    assert line.send(2002, 2101, after=1) == OURS
    assert (line.guard.foreign, line.guard.doubled) == (1, True)


def test_a_node_whose_place_was_taken_has_it_again_when_the_impostor_has_left():
    """Nothing tells a node that pauses for longer than it takes to start again from one that has ended."""
    line = Line()
    line.run(2000)
    assert line.send(1, 2700, after=700) == UNMATCHED
    assert line.guard.decide([PLANT, AGAIN], line.now)
    sorted_as = []
    for k in range(1500):
        sorted_as.append(line.send(2002 + k, 2700 + k, after=1))
        if k < 100:
            assert line.send(2 + k, 2700 + k) == OURS
        line.guard.decide([PLANT, *([AGAIN] if k < 100 else [])], line.now)
    assert sorted_as == [FOREIGN] * sorted_as.count(FOREIGN) + [OURS] * sorted_as.count(OURS)
    assert sorted_as.count(OURS) > 800
    assert line.guard.doubled


def test_a_restarted_node_is_matched_beside_a_stranger_that_goes_on_sending():
    line = Line()
    line.run(2000)
    stranger = Endpoint("02", "/stranger")
    assert line.send(50_000, 2000) == FOREIGN
    assert line.send(2002, 2001, after=1) == OURS
    sorted_as = []
    for k in range(1000):
        assert line.send(50_001 + k, 2002 + k, after=1) == FOREIGN
        if k > 600:  # killed, and here again
            sorted_as.append(line.send(k - 600, 2002 + k))
            line.guard.decide([PLANT, AGAIN, stranger], line.now)
    assert sorted_as == [UNMATCHED] + [OURS] * 398


def test_another_node_that_sent_beside_the_matched_one_is_not_matched_when_that_has_left():
    line = Line()
    line.run(2000)
    assert line.send(1, None, after=1) == FOREIGN
    assert line.send(2002, 2001, after=1) == OURS
    for k in range(2, 1000):
        assert line.send(k, None, after=1) in (FOREIGN, UNMATCHED)
        assert not line.guard.decide([STRANGER], line.now)


def test_a_new_publisher_beside_the_living_one_is_foreign_whatever_its_name():
    line = Line()
    line.send(2, 0)
    assert line.send(1, 1, after=1) == FOREIGN
    assert not line.guard.decide([PLANT, Endpoint("03", "/telescope/plant")], line.now)


def test_the_first_publisher_is_matched_by_its_hold_ticks_or_by_the_expected_name():
    late = SourceGuard("/telescope/plant")
    late.sort(700, 0, 0, message(5))
    assert not late.decide([STRANGER], 0)
    assert not late.decide([PLANT, STRANGER], 0)
    assert late.decide([PLANT], 0)
    replayed = SourceGuard("/telescope/plant")
    replayed.sort(1, 0, 0, message(None))
    assert replayed.decide([Endpoint("04", "/telescope/replay")], 0)
    assert replayed.strangers([PLANT]) == [PLANT]


def test_two_publishers_that_both_answer_the_hold_ticks_are_not_decided_on():
    guard = SourceGuard("/telescope/plant")
    for number in (100, 1, 101, 2):
        guard.sort(number, 0, 0, message(None))
    assert not guard.decide([PLANT, STRANGER], 0)


def test_the_next_run_of_another_node_is_matched_when_the_former_one_has_left():
    line = Line()
    line.send(2, 0)
    line.send(1, None, after=1000)
    assert not line.guard.decide([PLANT, Endpoint("04", "/telescope/replay")], line.now)
    assert line.guard.decide([Endpoint("04", "/telescope/replay")], line.now)


def test_a_middleware_without_sequence_numbers_gives_nothing_to_tell_by():
    assert SourceGuard().sort(None, 0, 0, b"") == OURS


def test_messages_too_short_for_a_stamp_belong_to_their_stream():
    line = Line()
    line.send(1, 3)
    assert line.guard.sort(2, 0, 0, b"\0\1") == OURS
