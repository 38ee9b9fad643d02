"""Repair of a bag whose recorder was killed or whose file is damaged: every reader opens the new bag.

The messages come through the same pass over the file as those of the reader (`pointing_analysis.read.mcap.walk`), so
the new bag holds what an analysis of the damaged one uses, and reports the same losses.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from lftkit.support.atomic_output import atomic_folder, check_space
from los_testbed.bags.writer import BagWriter, check_new_bag
from pointing_analysis.read.mcap.bag_files import bag_files
from pointing_analysis.read.mcap.bag_loss import (
    COVERED,
    LossLedger,
    TopicLoss,
    contradictions,
    digests_cover,
    repair_entries,
)
from pointing_analysis.read.mcap.bag_metadata import METADATA_NAME, REPAIR_NAME, merged
from pointing_analysis.read.mcap.records import BODY, HEAD, MAX_CHUNK, BagError, Block, FileInfo
from pointing_analysis.read.mcap.walk import walk
from pointing_analysis.read.messages.topic_columns import KNOWN


@dataclass
class RepairResult:
    """Result of a repair: messages copied and lost.

    Attributes
    ----------
    messages : messages in the new bag
    copied : messages of each topic in the new bag
    losses : what was recorded and cannot be read, topic by topic
    repeated : messages of each topic with a repeated sequence number, in both bags; a repeated chunk is not copied
    damage : offset [byte] in the file and description of each damaged place
    problems : the same and further defects as sentences
    contradictions : where the file contradicts its own digests; in `problems` as well
    finished : whether the file has its end-of-data record; False if the recorder was killed or the file truncated
    last_stamp : log time of the newest message [ns]
    """

    messages: int = 0
    copied: dict[str, int] = field(default_factory=dict)
    losses: tuple[TopicLoss, ...] = ()
    repeated: Mapping[str, int] = field(default_factory=dict)
    damage: tuple[tuple[int, str], ...] = ()
    problems: tuple[str, ...] = ()
    contradictions: tuple[str, ...] = ()
    finished: bool = True
    last_stamp: int = 0

    def sentences(self) -> list[str]:
        """Losses and damage, one sentence each."""
        texts = [*(str(loss) for loss in self.losses), *self.problems]
        texts += [f"{topic}: {n} messages have a repeated sequence number" for topic, n in self.repeated.items()]
        if not self.finished:
            texts.append("the recording is truncated after its last message")
        return texts or ["nothing is lost"]


def repair_bag(source: Path, target: Path, max_chunk: int = MAX_CHUNK) -> RepairResult:
    """Copy everything of `source` (folder or file) that can be read into the new bag `target`.

    The new bag has the sequence numbers of the old one and a record of what was lost, which every reader of this
    testbed shows. It appears whole or not at all.

    Parameters
    ----------
    source, target : the damaged bag, and the new one
    max_chunk : largest chunk that is unpacked [byte]

    Raises
    ------
    ValueError
        `source` is not a bag, is empty or has no readable message, or `target` exists.
    """
    check_new_bag(target)
    bag = bag_files(source)
    if len(bag.files) != 1:
        raise BagError(f"{source} must be a bag folder with one .mcap file, got {len(bag.files)}")
    check_space(target, 1.5 * bag.files[0].stat().st_size, "the repaired bag")
    info = FileInfo(max_chunk=max_chunk, compares=True)
    ledger = LossLedger()
    with atomic_folder(target) as folder:
        result = _copy(bag.files[0], info, ledger, folder, target.name, bag.counts)
        result.damage, result.finished = tuple(info.damage), info.finished
        result.contradictions = contradictions([info])
        result.problems = (*bag.problems, *info.problems)
        if not result.messages and not info.channels and not info.metadata:
            raise BagError(f"{source} must have readable records, got none")
        if not result.messages and result.losses:
            lost = sum(loss.missing for loss in result.losses)
            raise BagError(f"{source} must have readable messages, got none of the {lost} recorded")
    return result


def _copy(
    file: Path, info: FileInfo, ledger: LossLedger, folder: Path, name: str, counts: Mapping[str, int]
) -> RepairResult:
    """Two passes: metadata and attachments first, then the messages."""
    beside = FileInfo(max_chunk=info.max_chunk, unpacks=lambda first, last: False)
    for _ in walk(file, beside):
        pass
    tables, problems = _tables(beside)
    files = {key: (a.media_type, a.data) for key, a in beside.attachments.items()}
    result = RepairResult()
    # Namespace of the topics; None if no channel has it
    names = [channel.topic for channel in beside.channels.values()]
    namespaces = {name[: -len(known) - 1] for name in names for known in KNOWN if name.endswith(f"/{known}")}
    namespace = next(iter(namespaces)) if len(namespaces) == 1 else None
    with BagWriter(folder, tables, files, diagnostics=True, name=name, namespace=namespace) as bag:
        for block in walk(file, info):
            ledger.add(info, block)
            for topic, part in _by_topic(info, block, bag):
                # Messages of one topic in their order; those of equal length together
                heads = block.heads[part]
                sizes = heads["length"].astype(np.int64) - BODY
                data = np.frombuffer(block.data, np.uint8)
                log, publish, sequence = (heads[name].astype(np.int64) for name in ("log", "publish", "sequence"))
                for start, stop in pairwise([0, *(np.flatnonzero(np.diff(sizes)) + 1).tolist(), len(part)]):
                    begin = block.offsets[part[start:stop]] + HEAD
                    size = int(sizes[start])
                    payload = sliding_window_view(data, size)[begin] if size else np.zeros((stop - start, 0), np.uint8)
                    bag.write(topic, log[start:stop], publish[start:stop], payload, sequence[start:stop])
                result.messages += part.size
                result.copied[topic] = result.copied.get(topic, 0) + int(part.size)
                result.last_stamp = max(result.last_stamp, int(block.heads["log"][part].max()))
            bag.end_chunk()
        info.problems += problems
        result.losses, result.repeated = ledger.losses([info], counts), ledger.repeated([info])
        bag.close({REPAIR_NAME: _record(file, info, result, ledger.origin_of([info]))})
    return result


def _tables(beside: FileInfo) -> tuple[dict[str, dict[str, str]], list[str]]:
    """Metadata records of the new bag: of those of the run only what agrees with its hash."""
    run, problems = merged([beside])
    tables = {
        name: records[-1]
        for name, records in beside.metadata.items()
        if records and name not in ("rosbag2", METADATA_NAME)
    }
    return ({METADATA_NAME: run} if run else {}) | tables, problems


def _record(file: Path, info: FileInfo, result: RepairResult, origin: int) -> Mapping[str, str]:
    """Record of the losses for later readers of the new bag."""
    notes = [*(str(loss) for loss in result.losses), *info.problems]
    if not digests_cover([info]):
        notes.append("not all messages of the bag that was repaired had digests")
    return {
        "source": file.name,
        "messages": str(result.messages),
        "finished": json.dumps(info.finished),
        COVERED: json.dumps(digests_cover([info])),
        **repair_entries([info], result.losses, result.repeated, origin),
        **{f"note_{i:03d}": text for i, text in enumerate(notes[:200])},
    }


def _by_topic(info: FileInfo, block: Block, bag: BagWriter) -> Iterator[tuple[str, NDArray[np.int64]]]:
    """Topics of a block that the new bag can hold, with the rows of their messages."""
    numbers = block.heads["channel"]
    for number in np.unique(numbers).tolist():
        channel = info.channels.get(number)
        if channel is None:
            continue
        if channel.topic not in bag.topics:
            if channel.encoding != "cdr" or not channel.definition:
                info.problems.append(f"{channel.topic}: messages without a type definition are excluded")
                continue
            definition = channel.definition.decode(errors="replace")
            type_hash = dict(channel.metadata).get("topic_type_hash", "")
            bag.add_topic(channel.topic, channel.schema, definition, type_hash, channel.definition_encoding)
        known = bag.types[channel.topic]
        if channel.encoding != "cdr" or channel.schema not in ("", known):  # readers of the old bag skip them, too
            text = f"{channel.topic}: messages must be {known} in CDR, got others: they are excluded"
            info.problems += [text] if text not in info.problems else []
            continue
        yield channel.topic, np.flatnonzero(numbers == number)
