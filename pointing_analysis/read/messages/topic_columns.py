"""Messages of one topic, decoded in blocks and collected in arrays."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

import numpy as np

from pointing_analysis.arrays import FloatArray, IntArray
from pointing_analysis.read.mapped_arrays import GrowingArray
from pointing_analysis.read.mcap.records import BagError, Block
from pointing_analysis.read.messages import cdr
from pointing_analysis.read.messages.message_types import COLUMNS
from pointing_analysis.read.topic import Topic, make_topic

CAMERA = "camera/los"
#: topics of the testbed by their name without the namespace, with the unit of their values
KNOWN: Mapping[str, str] = MappingProxyType(
    {
        "isolator/accel": "m/s2, rad/s2",
        "m1/accel": "m/s2, rad/s2",
        "m2/accel": "m/s2, rad/s2",
        "fsm/strain_gauge": "rad",
        CAMERA: "rad",
        "los_estimate": "rad",
        "fsm/command": "rad",
        "pma/command": "N",
        "truth/los": "rad",
    }
)


class Column:
    """Collects the decoded messages of one topic."""

    def __init__(self, name: str, schema: str) -> None:
        self.name, self.schema = name, schema
        self.size = 0
        self.arrays = _nothing(len(COLUMNS[schema]))

    def add(self, stamp: IntArray, values: FloatArray, sent: IntArray) -> None:
        """Append messages: stamps, values (m, k), times of publishing."""
        width = values.shape[1]
        columns = self.arrays[1].columns
        if width != columns:
            if self.size:
                raise BagError(f"all messages must have the same number of values, got {columns} and {width}")
            self.arrays = _nothing(width)
        for array, new in zip(self.arrays, (stamp, values, sent)):
            array.append(new)
        self.size += len(stamp)

    @property
    def nbytes(self) -> int:
        """Size of the arrays [byte]."""
        return sum(array.nbytes for array in self.arrays)

    def topic(self, unit: str, period: float | None = None) -> Topic:
        """The finished topic with the unit of its values, and its period [s] if that is known.

        The column is empty afterwards.
        """
        columns = list(COLUMNS[self.schema])
        stamp, values, published = (array.array() for array in self.arrays)
        if len(columns) != values.shape[1]:
            columns = [f"{columns[0]}[{i}]" for i in range(values.shape[1])]
        self.arrays = ()
        return make_topic(self.name, self.schema, unit, tuple(columns), stamp, values, published, period)


def _nothing(width: int) -> tuple[GrowingArray, ...]:
    return GrowingArray(None, np.int64), GrowingArray(width), GrowingArray(None, np.int64)


def decode_block(column: Column, block: Block, rows: IntArray) -> None:
    """Decode messages of a block, by their rows in it; equal sizes go through one numpy view."""
    sent = block.heads["publish"][rows].astype(np.int64)
    for same, payloads in block.payloads(rows):
        plan = cdr.layout(column.schema, payloads[0].tobytes())
        stamp, values, fits = cdr.decode(payloads, plan)
        if fits.all():
            column.add(stamp, values, sent[same])
            continue
        column.add(stamp[fits], values[fits], sent[same][fits])
        for i in np.flatnonzero(~fits):
            odd = payloads[i : i + 1]
            stamp, values, _ = cdr.decode(odd, cdr.layout(column.schema, odd.tobytes()))
            column.add(stamp, values, sent[same[i : i + 1]])
