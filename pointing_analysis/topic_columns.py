"""Messages of one topic, decoded in blocks and collected in arrays."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

import numpy as np
import zstandard
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from pointing_analysis import cdr
from pointing_analysis.mcap_records import BODY, HEAD, BagError, Block
from pointing_analysis.message_types import COLUMNS, UNITS
from pointing_analysis.topic import Topic, make_topic

#: topics of the testbed by their name without the namespace, with the unit of their values
KNOWN: Mapping[str, str] = MappingProxyType(
    {
        "isolator/accel": "m/s2, rad/s2",
        "m1/accel": "m/s2, rad/s2",
        "m2/accel": "m/s2, rad/s2",
        "fsm/strain_gauge": "rad",
        "camera/los": "rad",
        "los_estimate": "rad",
        "fsm/command": "rad",
        "pma/command": "N",
        "truth/los": "rad",
    }
)


class Column:
    """Collects the decoded messages of one topic in arrays that grow by doubling.

    The unused half of an array costs no memory (its pages are never touched), and there is no joining of pieces at the
    end, which would take the memory twice.
    """

    def __init__(self, name: str, schema: str) -> None:
        self.name, self.schema = name, schema
        width = len(COLUMNS[schema])
        self.size = 0
        self.arrays: list[NDArray[Any]] = _nothing(width)

    def add(self, stamp: NDArray[np.int64], values: NDArray[np.float64], sent: NDArray[np.int64]) -> None:
        """Append messages: stamps, values (m, k), times of publishing."""
        if not self.size and values.shape[1] != self.arrays[1].shape[1]:
            self.arrays = _nothing(values.shape[1])
        if values.shape[1] != self.arrays[1].shape[1]:
            raise BagError(
                f"all messages must have the same number of values, got {self.arrays[1].shape[1]} and {values.shape[1]}"
            )
        end = self.size + len(stamp)
        for i, new in enumerate((stamp, values, sent)):
            if end > len(self.arrays[i]):
                larger = np.empty((max(end, 2 * len(self.arrays[i])), *new.shape[1:]), self.arrays[i].dtype)
                larger[: self.size] = self.arrays[i][: self.size]
                self.arrays[i] = larger
            self.arrays[i][self.size : end] = new
        self.size = end

    @property
    def nbytes(self) -> int:
        """Memory in use [byte]."""
        return self.size * sum(a.itemsize * (a.shape[1] if a.ndim > 1 else 1) for a in self.arrays)

    def topic(self) -> Topic:
        """The finished topic; the column is empty afterwards."""
        columns = list(COLUMNS[self.schema])
        stamp, values, published = (a[: self.size] for a in self.arrays)
        if len(columns) != values.shape[1]:
            columns = [f"{columns[0]}[{i}]" for i in range(values.shape[1])]
        self.arrays = []
        unit = KNOWN.get(self.name, UNITS[self.schema])
        return make_topic(self.name, self.schema, unit, tuple(columns), stamp, values, published)


def _nothing(width: int) -> list[NDArray[Any]]:
    return [np.empty(0, np.int64), np.empty((0, width)), np.empty(0, np.int64)]


def decode_block(column: Column, block: Block, chosen: NDArray[np.bool_], packed: bool) -> None:
    """Decode the chosen messages of a block; equal sizes go through one numpy view."""
    buffer = np.frombuffer(block.data, np.uint8)
    heads, offsets = block.heads[chosen], block.offsets[chosen]
    sizes = heads["length"].astype(np.int64) - BODY
    sent = heads["publish"].astype(np.int64)
    if packed:
        unzip = zstandard.ZstdDecompressor()
        payloads = [
            unzip.decompressobj().decompress(block.data[o + HEAD : o + HEAD + n]) for o, n in zip(offsets, sizes)
        ]
        buffer = np.frombuffer(b"".join(payloads), np.uint8)
        sizes = np.array([len(p) for p in payloads], dtype=np.int64)
        starts = np.cumsum(sizes) - sizes
    else:
        starts = offsets + HEAD
    for size in np.unique(sizes):
        same = np.flatnonzero(sizes == size)
        begin = starts[same]
        plan = cdr.layout(column.schema, buffer[begin[0] : begin[0] + size].tobytes())
        rows = sliding_window_view(buffer, int(size))[begin]
        stamp, values, fits = cdr.decode(rows, plan)
        if fits.all():
            column.add(stamp, values, sent[same])
            continue
        column.add(stamp[fits], values[fits], sent[same][fits])
        odd = np.flatnonzero(~fits)
        stamp, single = cdr.decode_any(column.schema, [rows[i].tobytes() for i in odd])
        for i, row in enumerate(single):
            column.add(stamp[i : i + 1], row[None, :], sent[same[odd[i : i + 1]]])
