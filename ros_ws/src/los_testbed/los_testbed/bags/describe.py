"""Contents of a bag: times, topics, run, hashes; a bag without its statistics is read, its messages are counted."""

from __future__ import annotations

import hashlib
from collections import Counter
from pathlib import Path
from typing import Any

from los_testbed.bags.signature import signature_file
from pointing_analysis.read.mcap.bag_files import bag_files
from pointing_analysis.read.mcap.bag_metadata import merged, value_of
from pointing_analysis.read.mcap.bag_pass import BagPass
from pointing_analysis.read.mcap.records import MAX_CHUNK

NANO = 1e9
RUN = ("loop", "mode", "scenario", "plant", "seed", "rate_hz", "software_version", "commit")
"""Entries of the run that are shown, where the bag has them."""
HASHES = ("plant_hash", "parameters_hash", "plant_parameters_hash")


def _sha256(file: Path) -> str:
    with file.open("rb") as stream:
        total = hashlib.sha256()
        while block := stream.read(1 << 20):
            total.update(block)
    return total.hexdigest()


def describe_bag(path: Path, max_chunk: int = MAX_CHUNK) -> dict[str, Any]:
    """Description of a bag, for JSON.

    Raises
    ------
    BagError
        Not a bag.
    """
    bag = bag_files(path)
    reading = BagPass(path, bag, max_chunk, heads_only=True)
    for _ in reading.blocks():
        pass
    counts = Counter[str]()
    statistics = [info.statistics for info in reading.infos if info.expected and info.statistics is not None]
    if len(statistics) == len(reading.infos):
        spans = [(e.first, e.last) for info in reading.infos for e in info.expected.values()]
        for info, messages in zip(reading.infos, statistics, strict=True):
            for number, channel in info.channels.items():
                counts[channel.topic] += messages.get(number, 0)
    else:  # cut, or of another program: what can be read is counted
        reading, spans = BagPass(path, bag, max_chunk), []
        for info, block in reading.blocks():
            spans.append((int(block.heads["log"].min()), int(block.heads["log"].max())))
            for channel, rows in block.by_channel(info.channels):
                counts[channel.topic] += int(rows.size)
    record, _ = merged(reading.infos)
    run = {key: value_of(text) for key, text in record.items()}
    start, end = min((s[0] for s in spans), default=None), max((s[1] for s in spans), default=None)
    schemas = {channel.topic: channel.schema for info in reading.infos for channel in info.channels.values()}
    attachments = {name: a for info in reading.infos for name, a in info.attachments.items()}
    return {
        "bag": str(path),
        "files": [file.name for file in bag.files],
        "size_bytes": sum(file.stat().st_size for file in bag.files),
        "storage": "mcap",
        "start_ns": start,
        "end_ns": end,
        "duration_s": None if start is None or end is None else (end - start) / NANO,
        "messages": counts.total(),
        "topics": {name: {"type": schemas[name], "messages": counts[name]} for name in sorted(schemas)},
        "run": {key: run[key] for key in RUN if run.get(key) not in (None, "")},
        "hashes": {key: run[key] for key in HASHES if key in run},
        "attachments": {
            name: {"size_bytes": len(a.data), "sha256": hashlib.sha256(a.data).hexdigest()}
            for name, a in sorted(attachments.items())
        },
        "sha256": {file.name: _sha256(file) for file in bag.files},
        "digest": [info.stated.hex() for info in reading.infos if info.stated],
        "signed": any(signature_file(file).is_file() for file in bag.files),
        "problems": reading.problems(),
        "contradictions": list(reading.contradictions),
    }
