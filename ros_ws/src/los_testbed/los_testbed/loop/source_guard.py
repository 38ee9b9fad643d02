"""One publisher for each topic of the loop: messages of others are told apart by their sequence numbers.

A subscription does not say which publisher a message came from, but each publisher numbers its messages 1, 2, 3, ...
Messages of one publisher arrive in order, so every message belongs to the stream whose number it continues, or begins
a new one. The matched publisher sends at most one message a tick: a stream whose numbers grow faster than the stamps
is not its own, so another publisher that sends faster cannot take its place when the numbers meet.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

from pointing_analysis.read.messages.cdr import STAMP, STAMP_OFFSET
from titop_plant.interface import TICK_NS

SILENCE_NS = 500_000_000
"""A publisher that sent nothing for this time [ns] may have been replaced: less than a node takes to start again, more
than a node of a loop that does not keep pace is silent."""

SLACK, PER_MS = 64, 3
"""Messages that may be lost between two of a stream, and more of them for each millisecond between the two."""

REPEATED = 8
"""Messages that a relay in the place of the matched publisher may send twice, or late, within a short time."""

MAX_STREAMS = 8

OURS, FOREIGN, UNMATCHED = "", "foreign", "unmatched"
"""What a message is: of the matched publisher, of another one beside it, of one that is not yet decided on."""


@dataclass
class Stream:
    """Messages of one publisher.

    Parameters
    ----------
    last : int
        Number of the last one.
    sent : int
        Time of its publisher when it was sent [ns].
    at, first_at : int
        When the last one and the first one were received (steady clock [ns]).
    count : int
        How many were received.
    hold : bool
        Whether one of them was a hold tick.
    """

    last: int
    sent: int
    at: int
    first_at: int
    count: int = 1
    hold: bool = False


@dataclass(frozen=True)
class Endpoint:
    """A publisher in the graph: its identifier (hexadecimal) and the full name of its node, empty if unknown."""

    gid: str
    node: str


@dataclass
class SourceGuard:
    """Tells the messages of a topic's matched publisher from those of others.

    Parameters
    ----------
    expected : str
        Full name of the node that should send; only it is matched without a hold tick.
    paced : bool
        Whether a stamp comes only once.

    Examples
    --------
    The second stream is not that of the node that was matched:

    >>> guard = SourceGuard("/telescope/plant")
    >>> def at(tick):
    ...     return bytes(4) + STAMP.pack(0, tick * TICK_NS)
    >>> guard.sort(1, 0, 0, at(0))
    'unmatched'
    >>> guard.decide([Endpoint("01", "/telescope/plant")], 0)
    True
    >>> [guard.sort(number, 0, 1_000_000, at(tick)) for number, tick in ((2, 5), (1, 5), (3, 6), (2, 6))]
    ['', 'foreign', '', 'foreign']
    >>> guard.foreign
    2
    """

    expected: str = ""
    paced: bool = True
    matched: Stream | None = None
    node: str = ""
    others: list[Stream] = field(default_factory=list)
    doubled: bool = False
    latest: Stream | None = None
    _data: bytes = b""
    _lead: int | None = None
    _forgotten: int = 0
    _interrupted: bool = False
    _gids: set[str] = field(default_factory=set)

    @property
    def foreign(self) -> int:
        """Messages that were not of the matched publisher."""
        return self._forgotten + sum(stream.count for stream in self.others)

    def sort(self, number: int | None, sent_ns: int, now_ns: int, data: bytes) -> str:
        """Tell what a message is: :data:`OURS`, :data:`FOREIGN` or :data:`UNMATCHED`.

        Parameters
        ----------
        number : int or None
            Its sequence number; None from a middleware that gives none: then there is nothing to tell by, all is ours.
        sent_ns, now_ns : int
            When it was sent (clock of its publisher) and now (steady clock).
        data : bytes
            The message; it begins with a header unless it is malformed.
        """
        matched = self.matched
        if number is None:
            return OURS
        if matched is not None and not self.others and number == matched.last + 1:
            matched.last, matched.sent, matched.at = number, sent_ns, now_ns
            self._data = data
            return OURS
        stamp = _stamp(data)
        stream = self.latest = self._stream(number, sent_ns, now_ns, stamp)
        stream.hold |= stamp == 0
        if stream is matched:
            self._data = data
            self.doubled |= self._interrupted
            return OURS
        if matched is None or (stream.first_at > matched.at and now_ns - matched.at > SILENCE_NS):
            return UNMATCHED
        self._interrupted = True
        return FOREIGN

    def _too_fast(self, number: int, stamp: int) -> bool:
        """Whether the matched publisher would have sent more messages than there were ticks."""
        if not self.paced or self.matched is None:
            return False
        if (last := _stamp(self._data)) > 0:
            lead = self.matched.last * TICK_NS - last
            self._lead = lead if self._lead is None else min(lead, self._lead)
        return self._lead is not None and stamp > 0 and number * TICK_NS - stamp > self._lead + REPEATED * TICK_NS

    def _stream(self, number: int, sent_ns: int, now_ns: int, stamp: int) -> Stream:
        """The stream that this number continues with the smallest step; a new one if there is none."""
        known = [*([self.matched] if self.matched and not self._too_fast(number, stamp) else []), *self.others]
        steps = [
            (number - stream.last, i)
            for i, stream in enumerate(known)
            if 0 < number - stream.last <= SLACK + PER_MS * max(0, sent_ns - stream.sent) // 1_000_000
        ]
        if not steps:
            if len(self.others) >= MAX_STREAMS:
                oldest = min(self.others, key=lambda stream: stream.at)
                self.others.remove(oldest)
                self._forgotten += oldest.count
            self.others.append(Stream(number, sent_ns, now_ns, now_ns))
            return self.others[-1]
        stream = known[min(steps)[1]]
        stream.last, stream.sent, stream.at = number, sent_ns, now_ns
        stream.count += 1
        return stream

    def undecided(self, now_ns: int) -> bool:
        """Whether a stream may be that of a new publisher in the place of the matched one."""
        return bool(self._candidates(now_ns))

    def _candidates(self, now_ns: int) -> list[Stream]:
        if self.matched is None:
            return self.others
        if not self.others or now_ns - self.matched.at <= SILENCE_NS:
            return []
        later = [stream for stream in self.others if stream.first_at > self.matched.at]
        return later or [stream for stream in self.others if stream.at > self.matched.at]

    def decide(self, endpoints: Sequence[Endpoint], now_ns: int) -> bool:
        """Match a stream if the publishers in the graph leave no doubt; whether one was matched.

        The first one: the only stream with hold ticks, or the only one of the expected node. Later ones, when the
        matched one is silent: a new publisher of the same node; the only publisher left if it begins with hold ticks;
        and any stream while the graph has no other publisher than the matched one. One that sent beside the matched one
        is only matched if the node has a single publisher left: the match was wrong.
        """
        candidates, nodes = self._candidates(now_ns), {endpoint.node for endpoint in endpoints}
        holding = [stream for stream in candidates if stream.hold]
        if self.matched is None:
            if len(holding) == 1 or (len(candidates) == 1 and nodes == {self.expected}):
                return self._match((holding or candidates)[0], endpoints)
            return False
        new = [endpoint for endpoint in endpoints if endpoint.gid not in self._gids]
        again = not new or any(endpoint.node == self.node for endpoint in new)
        beside = any(stream.first_at <= self.matched.at for stream in candidates)
        if beside and (len(endpoints) != 1 or nodes != {self.node}):
            return False
        if len(candidates) == 1 and (again or (len(nodes) == 1 and candidates == holding)):
            return self._match(candidates[0], endpoints)
        return False

    def _match(self, stream: Stream, endpoints: Sequence[Endpoint]) -> bool:
        self.others = [other for other in self.others if other is not stream]
        self.matched, self._data, self._lead, self._interrupted = stream, b"", None, False
        nodes = sorted({endpoint.node for endpoint in endpoints if endpoint.node})
        if self.node not in nodes:
            self.node = self.expected if self.expected in nodes or not nodes else nodes[0]
        self._gids |= {endpoint.gid for endpoint in endpoints if endpoint.node == self.node}
        return True

    def strangers(self, endpoints: Sequence[Endpoint]) -> list[Endpoint]:
        """Publishers of other nodes than the matched one's; those whose node is not yet known are left out."""
        return [e for e in endpoints if self.node and e.node and e.node != self.node]


def _stamp(data: bytes) -> int:
    """Stamp [ns] of a message; -1 if it is too short to have one."""
    if len(data) < STAMP_OFFSET + STAMP.size:
        return -1
    seconds, rest = STAMP.unpack_from(data, STAMP_OFFSET)
    return int(seconds) * 1_000_000_000 + int(rest)
