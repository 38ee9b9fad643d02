"""Limits of what is read from files that a user or another file names. Every reader takes its limit from here.

A size limit alone does not bound memory: a short text can stand for deep or numerous values. Beside the size there are
limits for nesting, for the number of values, and for what a compressed file unpacks to.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

MB = 1_000_000
TEXT = 64 * MB
"""Largest file that is read as text at once [byte]: controllers, profiles, settings."""
LINES = 2_000_000
"""Most lines of a text whose rows are kept as text until they are numbers."""
TABLE = 4_000 * MB
"""Largest table of samples [byte]: CSV, .mat, HDF5, Parquet, NumPy."""
SYSTEM = 256 * MB
"""Largest .mat file of a system, library of flight code, or model of a structure [byte]."""
PICTURE = 256 * MB
"""Largest pupil [byte]."""
SECRET = MB
"""Largest key, certificate or signature [byte]."""
RESULTS = 16_000 * MB
"""Largest file of results of another program (OP2) [byte]."""

DEPTH = 50
"""Deepest nesting of a text with structure, and most parts of a name with dots in TOML."""
DIGITS = 300
"""Longest integer; a float holds 308 digits."""


@dataclass(frozen=True)
class TextLimit:
    """Limits of a kind of text, in which a parser takes at most some hundred MB and some seconds.

    Attributes
    ----------
    size : largest text [character]
    values : most values, counted from above by the marks between them
    """

    size: int
    values: int


KINDS: Mapping[str, TextLimit] = MappingProxyType(
    {
        "JSON": TextLimit(TEXT, 4_000_000),
        "TOML": TextLimit(4 * MB, 300_000),
        "YAML": TextLimit(4 * MB, 300_000),
    }
)

UNPACKED, UNPACKED_RATIO = 200 * MB, 100
"""A compressed table may unpack to this many bytes, or to this many times its size, whichever is more."""


def most_unpacked(size: int) -> int:
    """Bytes that a compressed table of so many bytes may unpack to.

    Examples
    --------
    >>> most_unpacked(1000), most_unpacked(3_000_000)
    (200000000, 300000000)
    """
    return max(UNPACKED, UNPACKED_RATIO * size)


MAT_DEPTH = 32
"""Deepest nesting of cells and structures in a .mat file."""
MAT_ELEMENTS = 1_000_000
"""Most elements (variables, cells, fields) of a .mat file."""
HDF5_DEPTH = 32
"""Deepest group of an HDF5 file."""
HDF5_OBJECTS = 100_000
"""Most groups and datasets of an HDF5 file."""
MESSAGE_DEPTH = 12
"""Deepest nesting of a message definition."""
MESSAGE_FIELDS = 20_000
"""Most fields of a message definition, counted as often as they occur in a message."""
MESSAGE_ELEMENTS = 1_000_000
"""Most elements of one array of a message, and of all fields that are passed in one message."""
INCLUDES = 100
"""Most files that a NASTRAN deck includes."""
