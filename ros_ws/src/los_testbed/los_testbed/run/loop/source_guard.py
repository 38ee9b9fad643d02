"""One publisher for each topic of the loop, identified by the middleware's identifier.

The middleware gives every publisher a unique identifier, which comes with every message. In a run with a runner only
its processes can list themselves (:mod:`los_testbed.run.loop.members`): all others are foreign. Without a list, as on
several hosts, the publisher is found by the name of its node, or by its hold ticks; it is kept while it sends, replaced
by a later one of the same node when it is silent, and matched again when it returns. Stamps, values and rates of a
message do not identify its publisher, and are not used.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

from los_testbed.run.loop.members import OPEN, OTHER, OWN, PENDING
from pointing_analysis.read.messages.cdr import STAMP, STAMP_OFFSET

SILENCE_NS = 500_000_000
"""Silence [ns] after which a publisher may have been replaced: less than the restart of a node takes, more than a node
of a slow loop is silent."""

MAX_STREAMS = 64

OURS, FOREIGN, UNMATCHED = "", "foreign", "unmatched"
"""Class of a message: of the matched publisher, of a foreign one, of an undecided one."""


@dataclass(eq=False)
class Stream:
    """Messages of one publisher.

    Parameters
    ----------
    gid : bytes
        Its identifier.
    first_at, at : int
        When the first one and the last one were received (steady clock [ns]).
    standing : str
        Its standing in the list of the run.
    count, used : int
        How many were received in all, and while it was matched.
    hold : bool
        Whether one of them was a hold tick.
    beside : bool
        Whether it is known not to be the topic's own.
    """

    gid: bytes
    first_at: int
    at: int
    standing: str = OPEN
    count: int = 0
    used: int = 0
    hold: bool = False
    beside: bool = False


@dataclass(frozen=True)
class Endpoint:
    """A publisher in the graph: its identifier (hexadecimal) and the full name of its node, empty if unknown."""

    gid: str
    node: str


def _not_listed(gid: bytes) -> str:
    return OPEN


@dataclass
class SourceGuard:
    """Distinguishes the messages of a topic's matched publisher from those of others.

    Parameters
    ----------
    expected : str
        Full name of the node that should send; only it is matched without a hold tick.
    standing : callable
        Standing of an identifier in the list of the run; None: there is no list.

    Examples
    --------
    The second publisher is not that of the node that was matched, whatever it sends:

    >>> guard = SourceGuard("/telescope/plant")
    >>> def at(tick):
    ...     return bytes(4) + STAMP.pack(0, tick * 1_000_000)
    >>> guard.sort(b"1", 0, at(0))
    'unmatched'
    >>> guard.decide([Endpoint(b"1".hex(), "/telescope/plant")], 0)
    True
    >>> [guard.sort(gid, 1_000_000, at(tick)) for gid, tick in ((b"1", 5), (b"2", 6), (b"1", 6), (b"2", 900))]
    ['', 'foreign', '', 'foreign']
    >>> guard.foreign
    2
    """

    expected: str = ""
    standing: Callable[[bytes], str] = _not_listed
    matched: Stream | None = None
    node: str = ""
    others: dict[bytes, Stream] = field(default_factory=dict)
    latest: Stream | None = None
    misused: int = 0
    _former: dict[bytes, Stream] = field(default_factory=dict)
    _forgotten: int = 0
    _suspects: bool = False
    _gids: set[str] = field(default_factory=set)

    @property
    def foreign(self) -> int:
        """Messages that were not of the matched publisher."""
        return self._forgotten + sum(stream.count for stream in self.others.values())

    def sort(self, gid: bytes, now_ns: int, data: bytes) -> str:
        """Classify a message: :data:`OURS`, :data:`FOREIGN` or :data:`UNMATCHED`.

        Parameters
        ----------
        gid : bytes
            Identifier of its publisher.
        now_ns : int
            Now (steady clock).
        data : bytes
            The message; it begins with a header unless it is malformed.
        """
        matched = self.matched
        if matched is not None and gid == matched.gid:
            matched.at = now_ns
            matched.used += 1
            if self._suspects:
                self._accuse()
            return OURS
        if gid in self._former:
            return self._back(self._former[gid], now_ns)
        stream = self.latest = self._stream(gid, now_ns, data)
        if stream.standing == PENDING:
            return UNMATCHED
        if stream.standing == OWN:
            self._match(stream, [])
            return OURS
        if stream.standing == OTHER:
            return FOREIGN
        if matched is None or (stream.first_at > matched.at and now_ns - matched.at > SILENCE_NS):
            return UNMATCHED
        self._suspects = True
        return FOREIGN

    def _stream(self, gid: bytes, now_ns: int, data: bytes) -> Stream:
        """The stream of a publisher that is not matched; a new one if it has none."""
        stream = self.others.get(gid)
        if stream is None:
            if len(self.others) >= MAX_STREAMS:
                oldest = min(self.others.values(), key=lambda stream: stream.at)
                del self.others[oldest.gid]
                self._forgotten += oldest.count
            stream = self.others[gid] = Stream(gid, now_ns, now_ns, PENDING)
        if stream.standing == PENDING:
            stream.standing = self.standing(gid)
            stream.beside = stream.standing == OTHER
        stream.at = now_ns
        stream.count += 1
        stream.hold |= _is_hold(data)
        return stream

    def _accuse(self) -> None:
        """The matched publisher continues: those that sent meanwhile do not replace it."""
        self._suspects = False
        for stream in self.others.values():
            stream.beside = True

    def _back(self, stream: Stream, now_ns: int) -> str:
        """A silent, replaced publisher continues: it is matched again, and its substitute is foreign.

        Those of the run's list follow each other; they are not replaced by others.
        """
        del self._former[stream.gid]
        self._displace()
        self.matched, stream.at = stream, now_ns
        stream.used += 1
        return OURS

    def _displace(self) -> None:
        """The matched publisher is so no longer: it was of the run as well, or it never was the topic's own."""
        last = self.matched
        if last is None:
            return
        if last.standing == OWN:
            self._former[last.gid] = last
            return
        last.beside = True
        last.count += last.used
        self.misused += last.used
        self.others[last.gid] = last

    def intruders(self) -> list[bytes]:
        """Identifiers of publishers that have sent and are not the topic's own."""
        return [stream.gid for stream in self.others.values() if stream.beside]

    def undecided(self, now_ns: int) -> bool:
        """Whether a stream may be that of a new publisher that replaces the matched one."""
        return bool(self._candidates(now_ns))

    def _candidates(self, now_ns: int) -> list[Stream]:
        if not self.others:
            return []
        open_ones = [stream for stream in self.others.values() if stream.standing == OPEN]
        if self.matched is None:
            return open_ones
        if now_ns - self.matched.at <= SILENCE_NS:
            return []
        later = [stream for stream in open_ones if stream.first_at > self.matched.at]
        return later or [stream for stream in open_ones if stream.at > self.matched.at]

    def decide(self, endpoints: Sequence[Endpoint], now_ns: int) -> bool:
        """Match a stream if the publishers in the graph leave no doubt; whether one was matched.

        The first one: the only stream of the expected node, or the only one with hold ticks where that node is not and
        all who send are known. Later ones, when the matched one is silent: a new publisher of the same node, or the
        only publisher left if it begins with hold ticks. One that sent beside the matched one is only matched if that
        has left the graph and its node has a single publisher: the match was wrong.
        """
        names = {endpoint.gid: endpoint.node for endpoint in endpoints}
        every = self._candidates(now_ns)
        candidates = [s for s in every if names.get(s.gid.hex())]
        if self.matched is None:
            fitting = [s for s in candidates if names[s.gid.hex()] == self.expected]
            if len(candidates) == len(every) and self.expected not in names.values():
                fitting = [s for s in candidates if s.hold]
        else:
            fitting = self._successors(candidates, names)
        if len(fitting) != 1:
            return False
        self._match(fitting[0], endpoints)
        return True

    def _successors(self, candidates: Sequence[Stream], names: dict[str, str]) -> list[Stream]:
        """Streams of publishers that may have followed the matched one."""
        matched = self.matched
        assert matched is not None
        alone = matched.gid.hex() not in names and len(names) == 1
        fitting = []
        for stream in candidates:
            gid, later = stream.gid.hex(), stream.first_at > matched.at
            same = names[gid] == self.node
            if (same and (alone or (later and gid not in self._gids))) or (alone and later and stream.hold):
                fitting.append(stream)
        return fitting

    def _match(self, stream: Stream, endpoints: Sequence[Endpoint]) -> None:
        self.others.pop(stream.gid, None)
        if stream.standing == OWN:
            self._displace()
        elif self.matched is not None:
            self._former[self.matched.gid] = self.matched
        stream.used, stream.count, stream.beside, self._suspects = stream.count, 0, False, False
        self.matched = stream
        nodes = {endpoint.gid: endpoint.node for endpoint in endpoints}
        self.node = nodes.get(stream.gid.hex()) or self.expected
        self._gids |= {endpoint.gid for endpoint in endpoints if endpoint.node == self.node}

    def foreign_publishers(self, endpoints: Sequence[Endpoint]) -> list[Endpoint]:
        """Foreign publishers of the topic; undecided ones are excluded.

        With a list of the run, all that are not in it; without one, those of other nodes than the matched one's or,
        before there is one, the expected one.
        """
        foreign = []
        for endpoint in endpoints:
            standing = self.standing(bytes.fromhex(endpoint.gid))
            other = standing == OPEN and endpoint.node != (self.node or self.expected)
            if endpoint.node and (standing == OTHER or other):
                foreign.append(endpoint)
        return foreign


def _is_hold(data: bytes) -> bool:
    """Whether a message has the stamp zero."""
    if len(data) < STAMP_OFFSET + STAMP.size:
        return False
    seconds, rest = STAMP.unpack_from(data, STAMP_OFFSET)
    return not seconds and not rest
