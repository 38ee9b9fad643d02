"""What the messages of a bag are, as one pass over it counts them: of each file by topic."""

from __future__ import annotations

from collections import Counter

from pointing_analysis.read.mcap.records import Block, FileInfo


class Contents:
    """Messages that were read.

    Attributes
    ----------
    files : messages by topic, of each file
    """

    def __init__(self) -> None:
        self.files: list[Counter[str]] = []

    def add(self, number: int, info: FileInfo, block: Block) -> None:
        """Take note of the messages of a block of the file with this number."""
        self.files += [Counter() for _ in range(number + 1 - len(self.files))]
        for channel, rows in block.by_channel(info.channels):
            self.files[number][channel.topic] += int(rows.size)

    @property
    def topics(self) -> Counter[str]:
        """Messages by topic, of all files."""
        return sum(self.files, Counter())
