"""Whose a message is: by the list of the run, or by the graph; floods, restarts, pauses, impostors."""

import pytest
from los_testbed.run.loop.members import OPEN, OTHER, OWN, PENDING, Members, complete_line
from los_testbed.run.loop.source_guard import FOREIGN, MAX_STREAMS, OURS, UNMATCHED, Endpoint, SourceGuard

from pointing_analysis.read.messages.cdr import STAMP
from titop_plant.interface import TICK_NS

MS = 1_000_000
A, B, C = b"\1", b"\2", b"\3"
NODE = "/telescope/plant"
PLANT, AGAIN = Endpoint(A.hex(), NODE), Endpoint(C.hex(), NODE)
STRANGER = Endpoint(B.hex(), "/stranger")


def message(tick):
    """Beginning of a message of this tick; None is a hold tick."""
    return bytes(4) + STAMP.pack(*divmod(0 if tick is None else 10**12 + tick * TICK_NS, 10**9))


class Line:
    """A guard that was matched with publisher A of /telescope/plant by a hold tick; sorts one message a call."""

    def __init__(self, *endpoints):
        self.guard = SourceGuard(NODE)
        self.now = 0
        assert self.send(A, None) == UNMATCHED
        assert self.guard.decide(endpoints or (PLANT,), self.now)

    def run(self, ticks, gid=A):
        """So many messages, one a millisecond."""
        for k in range(ticks):
            assert self.send(gid, k, after=1) == OURS

    def send(self, gid, tick, after=0):
        self.now += after * MS
        return self.guard.sort(gid, self.now, message(tick))

    def decide(self, *endpoints):
        return self.guard.decide(endpoints, self.now)


@pytest.mark.parametrize("ahead", [0, 10**6, -(10**5), None], ids=["same", "1000 s ahead", "100 s behind", "hold"])
def test_of_a_flood_no_message_is_ours_and_of_ours_none_is_lost(ahead):
    """Ten foreign ones for each own one, whatever their stamps."""
    line = Line()
    for k in range(2000):
        assert line.send(A, k, after=1) == OURS
        for i in range(10):
            assert line.send(B, None if ahead is None else k + ahead + i) == FOREIGN
        line.decide(PLANT, Endpoint(B.hex(), NODE))
    assert line.guard.foreign == 20_000
    assert line.guard.intruders() == [B]
    assert line.guard.misused == 0


def test_messages_of_one_publisher_are_ours_whatever_their_stamps():
    line = Line()
    assert [line.send(A, tick) for tick in (0, 38, 2, 1038, None, 3)] == [OURS] * 6
    assert line.guard.sort(A, line.now, b"\0\1") == OURS, "too short for a stamp"
    assert (line.guard.foreign, line.guard.intruders()) == (0, [])


def test_a_restarted_node_is_matched_by_its_name_and_a_stranger_is_not():
    line = Line()
    line.run(10)
    assert line.send(B, 600, after=600) == UNMATCHED
    assert not line.decide(PLANT, STRANGER)
    assert line.send(C, 601, after=1) == UNMATCHED
    assert line.decide(PLANT, STRANGER, AGAIN)
    assert line.send(C, 602, after=1) == OURS
    assert line.guard.foreign == 1, "what the restarted node sent before it was matched was its own"


def test_a_node_that_is_back_within_the_silence_is_no_second_publisher():
    line = Line()
    line.run(2000)
    sorted_as = []
    for k in range(600):
        sorted_as.append(line.send(C, 2100 + k, after=100 if k == 0 else 1))
        line.decide(PLANT, AGAIN)
    assert sorted_as == [FOREIGN] * 401 + [UNMATCHED] + [OURS] * 198
    assert (line.guard.foreign, line.guard.intruders()) == (0, [])


def test_an_impostor_of_the_same_name_does_not_take_the_place_of_a_node_that_pauses():
    line = Line()
    line.run(2000)
    assert line.send(C, 2100, after=100) == FOREIGN
    assert not line.decide(PLANT, AGAIN)
    assert line.guard.intruders() == [], "it may be the restarted node"
    assert line.send(A, 2101, after=1) == OURS
    assert (line.guard.foreign, line.guard.intruders()) == (1, [C])


def test_a_node_whose_place_was_taken_has_it_again_with_its_first_message():
    """Nothing but a list tells a node that pauses for longer than it takes to start again from one that has ended."""
    line = Line()
    line.run(2000)
    assert line.send(C, 2700, after=700) == UNMATCHED
    assert line.decide(PLANT, AGAIN)
    assert [line.send(C, 2701 + k, after=1) for k in range(100)] == [OURS] * 100
    for k in range(100):
        assert line.send(A, 2800 + k, after=1) == OURS
        assert line.send(C, 2800 + k) == FOREIGN
    assert (line.guard.foreign, line.guard.misused, line.guard.intruders()) == (201, 101, [C])


def test_the_first_publisher_is_matched_by_its_name_or_by_its_hold_ticks():
    late = SourceGuard(NODE)
    late.sort(A, 0, message(5))
    late.sort(B, 0, message(None))
    assert not late.decide([STRANGER], 0)
    assert late.decide([PLANT, STRANGER], 0), "the name goes before the hold ticks of another"
    assert late.matched.gid == A
    replayed = SourceGuard(NODE)
    replayed.sort(C, 0, message(None))
    assert replayed.decide([Endpoint(C.hex(), "/telescope/replay")], 0)
    assert replayed.foreign_publishers([PLANT]) == [PLANT]


def test_thousands_of_publishers_cost_no_memory_and_all_their_messages_are_counted():
    line = Line()
    for k in range(5000):
        assert line.send(k.to_bytes(4, "big"), k) == FOREIGN
        assert line.send(A, k, after=1) == OURS
    assert len(line.guard.others) <= MAX_STREAMS
    assert line.guard.foreign == 5000


class Listed:
    """A guard with a list of the run in a file."""

    def __init__(self, folder):
        path = folder / "members"
        path.touch()
        self.writer, reader = Members(str(path)), Members(str(path))
        self.guard = SourceGuard(NODE, lambda gid: reader.standing("/telescope/truth/los", NODE, gid))
        self.standing = self.guard.standing

    def sort(self, gid, now=0, tick=1):
        return self.guard.sort(gid, now, message(tick))

    def add(self, gid):
        self.writer.join(NODE, gid)
        self.writer.publishes("/telescope/truth/los")


def test_with_a_list_an_early_impostor_is_never_matched(tmp_path):
    listed = Listed(tmp_path)
    assert listed.sort(C, tick=None) == UNMATCHED
    assert not listed.guard.decide([AGAIN], 0), "the only publisher, with the right name and a hold tick"
    listed.add(A)
    assert [listed.sort(gid) for gid in (C, A, C, A)] == [FOREIGN, OURS, FOREIGN, OURS]
    assert listed.guard.foreign_publishers([PLANT, AGAIN]) == [AGAIN]
    assert listed.guard.intruders() == [C]


def test_with_a_list_a_restarted_node_is_matched_at_once_and_a_silent_one_is_not_replaced(tmp_path):
    listed = Listed(tmp_path)
    listed.add(A)
    assert listed.sort(A) == OURS
    assert listed.sort(C, 10**10) == FOREIGN
    assert not listed.guard.decide([AGAIN], 10**10)
    listed.add(B)
    assert [listed.sort(gid, 10**10) for gid in (B, C, A, B)] == [OURS, FOREIGN, OURS, OURS]
    assert (listed.guard.foreign, listed.guard.misused) == (2, 0)


def test_a_relay_between_a_node_and_a_topic_is_matched_when_the_node_has_listed_all_it_has(tmp_path):
    listed = Listed(tmp_path)
    assert listed.standing(A) == PENDING
    assert listed.sort(A, tick=None) == UNMATCHED
    listed.writer.complete(NODE)
    assert listed.standing(A) == OPEN
    assert listed.sort(A, tick=None) == UNMATCHED
    assert listed.guard.decide([Endpoint(A.hex(), "/telescope/relay")], 0)
    assert listed.sort(A) == OURS
    listed.add(B)
    assert (listed.standing(A), listed.standing(B)) == (OTHER, OWN)
    assert [listed.sort(gid) for gid in (B, A, B)] == [OURS, FOREIGN, OURS]
    assert listed.guard.misused == 3, "the two that came before it was matched are used as well"


def test_lines_of_the_list_that_are_cut_or_malformed_are_left_out(tmp_path):
    path = tmp_path / "members"
    line = complete_line(NODE)
    path.write_text("{\n" + line[:5])
    members = Members(str(path))
    assert members.standing("/t", NODE, A) == PENDING
    with path.open("a") as stream:
        stream.write(line[5:])
    assert members.standing("/t", NODE, A) == OPEN
    assert Members("").standing("/t", NODE, A) == OPEN


def test_another_node_that_sent_beside_the_matched_one_is_not_matched_when_that_has_left():
    line = Line()
    line.run(2000)
    assert line.send(B, None, after=1) == FOREIGN
    line.run(1)
    for _ in range(1000):
        assert line.send(B, None, after=1) in (FOREIGN, UNMATCHED)
        assert not line.decide(STRANGER)


def test_two_publishers_of_one_name_are_not_decided_on():
    guard = SourceGuard(NODE)
    for gid in (A, C):
        guard.sort(gid, 0, message(None))
    assert not guard.decide([PLANT, AGAIN], 0)
