"""Check of a bag: end of the data, checksums, digests, counts, signature, and the times of the messages."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from lftkit.errors import InputError
from lftkit.support.counted_nouns import counted
from los_testbed.bags.contents import Contents
from los_testbed.bags.signature import is_signed_by, signature_file, write_signature
from los_testbed.config.topics import DIAGNOSTICS_TOPIC
from pointing_analysis.command.exit_codes import ExitCode
from pointing_analysis.read.arrivals import KINDS, Arrivals
from pointing_analysis.read.mcap.bag_files import BagFiles, bag_files
from pointing_analysis.read.mcap.bag_loss import TopicLoss, digests_cover
from pointing_analysis.read.mcap.bag_metadata import METADATA_NAME, merged, value_of
from pointing_analysis.read.mcap.bag_pass import BagPass
from pointing_analysis.read.mcap.file_digest import OTHER_DIGEST
from pointing_analysis.read.mcap.records import MAX_CHUNK, FileInfo
from pointing_analysis.read.run_end import RunEnd, count_of, run_end, statistics_of

if TYPE_CHECKING:
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey, Ed25519PublicKey

State = Literal["agrees", "none", "missing", "irregular", "early", "damaged", "contradicts"]
"""``none``: not known. Intact, but with messages ``missing`` or ``irregular``, as they came to the recorder; ``early``:
the run did not end as planned, or its messages do not show that it did."""

CHECKSUMS, WHOLE_FILE, SIGNATURE = "checksums", "digest of the file", "signature"
REFUTED = (SIGNATURE, "contradicts")
NO_DIGEST = "no digest can be read at the end of the file: what is beside its chunks is not covered"
NAMED = 3
"""Largest number of agreeing message counts that are listed."""


@dataclass(frozen=True)
class BagCheckRow:
    """One check: its name, state and finding."""

    name: str
    state: State
    found: str


@dataclass(frozen=True)
class BagCheck:
    """Result of a check.

    Attributes
    ----------
    path : the bag
    rows : what was checked
    contradictions : where it contradicts itself, one sentence each
    problems : these and further defects
    messages : that can be read, by topic
    losses : what was recorded and cannot be read
    arrivals : gaps, stalls and clock steps by topic: of what was sent, no defect of the bag
    ticks : of the run, where it ended by its plan and the messages show it; else None
    """

    path: Path
    rows: tuple[BagCheckRow, ...]
    contradictions: tuple[str, ...]
    problems: tuple[str, ...]
    messages: dict[str, int]
    losses: tuple[TopicLoss, ...]
    arrivals: dict[str, Arrivals]
    ticks: int | None = None

    @property
    def title(self) -> str:
        """Whether it is whole, that no checksum proves it, and that its run ended early."""
        early = "".join(f"; {row.found}" for row in self.rows if row.state == "early")
        unproved = "".join(
            f"; {row.found}"
            for row in self.rows
            if (row.name == CHECKSUMS and row.state == "none") or row.found == NO_DIGEST
        )
        whole = "complete" if unproved else "whole"
        if any(row.state in ("damaged", "contradicts") for row in self.rows if row.name != SIGNATURE):
            whole = "not whole"
        signed = "".join(f"; signature: {row.found}" for row in self.rows if (row.name, row.state) == REFUTED)
        return f"{whole}{unproved}{early}{signed}"

    @property
    def code(self) -> int:
        """Exit code: 0 whole, 1 damaged or incomplete, 5 contradictory."""
        states = {row.state for row in self.rows}
        if "contradicts" in states:
            return ExitCode.CONTRADICTION
        return ExitCode.FAILED if "damaged" in states else ExitCode.FINISHED

    def as_dict(self) -> dict[str, Any]:
        """For JSON."""
        return {
            "bag": str(self.path),
            "whole": self.code == 0,
            "checks": [vars(row) for row in self.rows],
            "messages": self.messages,
            "lost": {loss.topic: loss.missing for loss in self.losses},
            "times": {
                topic: {
                    "period": found.period,
                    "stamped": found.stamped,
                    "lost": found.lost,
                    "events": [vars(event) for event in found.events],
                }
                for topic, found in self.arrivals.items()
            },
            "contradictions": list(self.contradictions),
            "problems": list(self.problems),
        }


def check_bag(path: Path, max_chunk: int = MAX_CHUNK, key: Ed25519PublicKey | None = None) -> BagCheck:
    """Read a whole bag and check its digests, counts and signature.

    Parameters
    ----------
    path : of the bag
    max_chunk : largest chunk that is unpacked [byte]; a larger one counts as lost
    key : key that must have signed it; None: a signature is not checked

    Raises
    ------
    BagError
        Not a bag.
    """
    return _check(path, max_chunk, key)[0]


def sign_bag(path: Path, key: Ed25519PrivateKey, max_chunk: int = MAX_CHUNK) -> Path:
    """Sign an intact bag; the path of the signature.

    Raises
    ------
    ValueError
        It is damaged, contradicts itself, or has no digest of all its bytes.
    """
    check, infos, files = _check(path, max_chunk, None)
    refused = next((f"{row.name}: {row.found}" for row in check.rows if row.state in ("damaged", "contradicts")), "")
    if refused:
        raise InputError(f"a bag must be intact to be signed, got {path}, {refused}")
    if not all(info.agrees and info.chunks and _all_agree(info) for info in infos):
        raise InputError(f"a bag must have a manifest of each chunk and a digest to be signed, got {path} without")
    return write_signature(files[0], [info.stated for info in infos], key)


def _check(
    path: Path, max_chunk: int, key: Ed25519PublicKey | None
) -> tuple[BagCheck, list[FileInfo], tuple[Path, ...]]:
    bag = bag_files(path)
    reading, contents = BagPass(path, bag, max_chunk), Contents()
    for info, block in reading.blocks():
        contents.add(len(reading.infos) - 1, info, block)
    infos, losses = reading.infos, reading.losses()
    damage = _damage(reading)
    known = {key: value_of(text) for key, text in merged(infos)[0].items()}
    end = run_end(known, contents.covered_ticks(known, losses)) if "statistics" in known else None
    counts = _counts(
        _sources(infos, bag, contents, known), contents, bool(losses or damage or bag.problems or reading.cut)
    )
    rows = (
        BagCheckRow(
            "end of the data", *(("damaged", "the recording is truncated") if reading.cut else ("agrees", "present"))
        ),
        BagCheckRow("metadata.yaml", "damaged", _first(list(bag.problems))) if bag.problems else None,
        _checksums(infos, damage, contents.topics.total()),
        _digests(infos),
        _whole_file(infos),
        BagCheckRow("before its repair", "contradicts", _first(before)) if (before := _before(reading)) else None,
        counts,
        _lost(losses, arrived := contents.arrivals()),
        _times(arrived),
        None if end is None else _end_of_run(end),
        _signature(bag, infos, key),
    )
    present = tuple(row for row in rows if row is not None)
    differences = [f"{row.name}: {row.found}" for row in (counts, present[-1]) if row.state == "contradicts"]
    problems = tuple(dict.fromkeys([*reading.problems(), *differences]))
    result = BagCheck(
        path,
        present,
        (*reading.contradictions, *differences),
        problems,
        dict(contents.topics),
        losses,
        arrived,
        end.done if end is not None and end.by_plan else None,
    )
    return result, infos, bag.files


def _checksums(infos: list[FileInfo], damage: list[str], messages: int) -> BagCheckRow:
    if damage:
        return BagCheckRow(CHECKSUMS, "damaged", _first(damage))
    unchecked = sum(info.unchecked for info in infos if not info.data_checksum)
    if not unchecked:
        return BagCheckRow(CHECKSUMS, "agrees", "no damage")
    which = f"any of the {messages}" if unchecked >= messages else f"{unchecked} of the {messages}"
    return BagCheckRow(
        CHECKSUMS, "none", f"the file has no checksum of {which} messages: damage to them is not detected"
    )


def _first(texts: list[str]) -> str:
    return texts[0] if len(texts) == 1 else f"{texts[0]}; and {len(texts) - 1} more"


def _before(reading: BagPass) -> list[str]:
    """Contradictions of the bag that this one was repaired from."""
    of_files = {text for info in reading.infos for text in info.contradictions}
    return [text for text in reading.contradictions if text not in of_files]


def _damage(reading: BagPass) -> list[str]:
    """Defects of the files that are no contradictions, and metadata records that disagree with their hash."""
    contradictions = {text for info in reading.infos for text in info.contradictions}
    problems = [text for info in reading.infos for text in info.problems if text not in contradictions]
    return [*problems, *merged(reading.infos, METADATA_NAME)[1]]


def _all_agree(info: FileInfo) -> bool:
    """Whether every chunk is what its manifest says, and no manifest is without its chunk."""
    return info.digests == info.chunks == info.manifests


def _digests(infos: list[FileInfo]) -> BagCheckRow:
    chunks, agree = sum(max(info.chunks, info.manifests) for info in infos), sum(info.digests for info in infos)
    if not any(info.manifests for info in infos):
        return BagCheckRow("digests of chunks", "none", "no manifests, as in a bag of another program")
    refuted = [text for info in infos for text in info.contradictions if not text.endswith(OTHER_DIGEST)]
    text = f"{agree} of {chunks} agree"
    if refuted:
        return BagCheckRow("digests of chunks", "contradicts", f"{text}: {_first(refuted)}")
    if agree == chunks and not digests_cover(infos):
        text += ", those of a repair of a bag of which not all messages had digests"
        return BagCheckRow("digests of chunks", "none", text)
    return BagCheckRow("digests of chunks", "agrees" if agree == chunks else "damaged", text)


def _whole_file(infos: list[FileInfo]) -> BagCheckRow:
    """Of every byte up to the footers."""
    if not all(info.stated for info in infos):
        foreign = not any(info.manifests for info in infos)
        return BagCheckRow(WHOLE_FILE, "none", "none, as in a bag of another program" if foreign else NO_DIGEST)
    if all(info.agrees for info in infos):
        which = ", ".join(info.stated.hex()[:16] for info in infos)
        return BagCheckRow(
            WHOLE_FILE, "agrees", f"{which} of every byte up to the footer; metadata.yaml is not covered"
        )
    altered = any(text.endswith(OTHER_DIGEST) for info in infos for text in info.contradictions)
    return BagCheckRow(WHOLE_FILE, "contradicts" if altered else "damaged", OTHER_DIGEST)


@dataclass(frozen=True)
class _Source:
    """Message counts of one source, in all and by topic (None: not stated), and the messages read."""

    name: str
    total: int | None
    topics: Mapping[str, int] | None
    read: Mapping[str, int]

    @property
    def wrong(self) -> list[str]:
        """Differences from the messages read, one sentence each."""
        known, read = self.topics, sum(self.read.values())
        wrong_counts = [
            f"{topic}: {self.name} counts {counted(known.get(topic, 0), 'message')}, "
            f"{self.read.get(topic, 0)} can be read"
            for topic in (() if known is None else sorted({*known, *self.read}))
            if known is not None and known.get(topic, 0) != self.read.get(topic, 0)
        ]
        if self.total is None or self.total == read:
            return wrong_counts
        return [*wrong_counts, f"{self.name} counts {counted(self.total, 'message')} in all, {read} can be read"]


def _sources(infos: list[FileInfo], bag: BagFiles, contents: Contents, known: Mapping[str, Any]) -> list[_Source]:
    """metadata.yaml, the summary of each file, and the recorder of the run, as far as they count messages."""
    sources = []
    if bag.counts or bag.message_count is not None:
        sources.append(_Source("metadata.yaml", bag.message_count, bag.counts or None, contents.topics))
    for number, info in enumerate(infos):
        name = "the summary" if len(infos) == 1 else f"the summary of {bag.files[number].name}"
        read = contents.files[number] if number < len(contents.files) else {}
        if info.statistics is not None:
            sources.append(_Source(name, info.message_count, _by_topic(info) or None, read))
    stated = count_of(statistics_of(known, "recorder").get("messages"))
    if stated is not None:
        recorded = {topic: count for topic, count in contents.topics.items() if topic != DIAGNOSTICS_TOPIC}
        sources.append(_Source("the run's record", stated, None, recorded))
    return sources


def _by_topic(info: FileInfo) -> Counter[str]:
    """Messages of each topic as the summary of a file counts them."""
    counts = Counter[str]()
    for number, count in (info.statistics or {}).items():
        counts[info.channels[number].topic if number in info.channels else f"channel {number}"] += count
    return counts


def _counts(sources: Sequence[_Source], contents: Contents, incomplete: bool) -> BagCheckRow:
    """Comparison of the messages read with the counts elsewhere in the bag."""
    wrong = [text for source in sources for text in source.wrong]
    if wrong:
        return BagCheckRow("counts", "damaged" if incomplete else "contradicts", _first(wrong))
    names = [source.name for source in sources]
    if len(names) > NAMED:
        names[NAMED - 1 :] = [f"{len(names) - NAMED + 1} further summaries"]
    text = f"{counted(contents.topics.total(), 'message')} of {counted(len(contents.topics), 'topic')}"
    if not names:
        return BagCheckRow("counts", "none", text)
    return BagCheckRow(
        "counts", "agrees", f"{text}, as in {' and '.join(filter(None, [', '.join(names[:-1]), names[-1]]))}"
    )


def _end_of_run(end: RunEnd) -> BagCheckRow:
    """Whether the run ended by its plan, and the messages show it."""
    if end.text:
        return BagCheckRow("end of the run", "contradicts" if end.longer else "early", end.text)
    if end.by_plan and end.done is not None:
        return BagCheckRow("end of the run", "agrees", f"as planned, after {counted(end.done, 'tick')}")
    return BagCheckRow("end of the run", "none", "not known: the run's record lacks its plan and its ticks")


def _lost(losses: Sequence[TopicLoss], arrived: Mapping[str, Arrivals]) -> BagCheckRow:
    """Messages that were recorded and cannot be read. Where those went that only the stamps show is not known."""
    if losses:
        return BagCheckRow("lost messages", "damaged", _first([str(loss) for loss in losses]))
    missing = sum(topic.lost or 0 for topic in arrived.values())
    unknown = sum(topic.lost is None for topic in arrived.values())
    beside = f"; not known of {counted(unknown, 'topic')} without stamps or a regular rate" if unknown else ""
    if missing:
        what = f"{counted(missing, 'message')} missing between the stamps: not recorded, or removed since"
        return BagCheckRow("lost messages", "missing", what + beside)
    state: State = "none" if unknown == len(arrived) else "agrees"
    return BagCheckRow("lost messages", state, f"none{beside}" if state == "agrees" else beside.removeprefix("; "))


def _times(arrived: Mapping[str, Arrivals]) -> BagCheckRow:
    """Sums over the topics; what did not come is no damage of the bag."""
    lost = sum(topic.lost or 0 for topic in arrived.values())
    counts = {kind: sum(len(topic.of(kind)) for topic in arrived.values()) for kind in KINDS}
    parts = [counted(count, kind) for kind, count in counts.items() if count]
    text = (
        ", ".join([*parts, *([counted(lost, "message", " missing")] if lost else [])]) or "no gap, stall or clock step"
    )
    irregular = sum(topic.period is None for topic in arrived.values())
    beside = f"; gaps not judged of {counted(irregular, 'topic')} without a regular rate" if irregular else ""
    if not parts and irregular == len(arrived):
        return BagCheckRow("times of the messages", "none", beside.removeprefix("; "))
    return BagCheckRow("times of the messages", "irregular" if parts else "agrees", text + beside)


def _signature(bag: BagFiles, infos: list[FileInfo], key: Ed25519PublicKey | None) -> BagCheckRow:
    there = [file for file in bag.files if signature_file(file).is_file()]
    if key is None:
        return BagCheckRow(SIGNATURE, "none", "present, not checked: no --public-key" if there else "none")
    if not there:
        return BagCheckRow(SIGNATURE, "contradicts", "none, but required by --public-key")
    if not all(info.stated for info in infos):
        return BagCheckRow(SIGNATURE, "damaged", "cannot be checked: no digest can be read at the end of the file")
    if there != [bag.files[0]] or not is_signed_by(there[0], [info.stated for info in infos], key):
        return BagCheckRow(SIGNATURE, "contradicts", "does not match this key and bag")
    if not all(info.agrees and _all_agree(info) for info in infos):
        return BagCheckRow(SIGNATURE, "damaged", "matches this key, and is of the file before it was damaged")
    return BagCheckRow(SIGNATURE, "agrees", "matches this key")
