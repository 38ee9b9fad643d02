"""Metadata records of a bag: with a hash, so that a changed letter is noticed.

A bag has its configuration twice: in a record at the start, and with the results in one at the end. Where records carry
a hash (`HASH`), only those are believed whose hash agrees.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from typing import Any

from lftkit.errors import InputError
from lftkit.support.input_limits import DIGITS
from lftkit.support.structured_text import parse
from pointing_analysis.read.mcap.records import FileInfo

METADATA_NAME = "los_testbed"
"""Name of the metadata record of a run."""
REPAIR_NAME = "los_testbed_repair"
"""Name of the metadata record of a repaired bag: what was lost."""
REMAPPED = "remapped"
"""Key of the names under which topics are recorded, by those that they would have: an object."""
BUDGET = "rpe_budget_mas"
"""Key of the allowances of the relative error in the metadata of a bag: an object with parts, and with the edge."""
BUDGET_EDGE = "band_edge_rad_s"
"""Key in there of the frequency between slow and fast tones [rad/s]."""
HASH = "metadata_sha256"
"""Key of the hash in a metadata record."""
OWN_LIBRARY = "los-testbed"
"""Begin of the name of the library whose files have settings and number the messages of each topic."""


def with_hash(table: Mapping[str, str]) -> dict[str, str]:
    """The table with the SHA-256 of its other entries.

    Examples
    --------
    >>> table = with_hash({"mode": "inprocess"})
    >>> has_right_hash(table), has_right_hash({**table, "mode": "inprocuss"})
    (True, False)
    """
    rest = {key: str(value) for key, value in table.items() if key != HASH}
    return {**rest, HASH: hashlib.sha256(json.dumps(rest, sort_keys=True).encode()).hexdigest()}


def has_right_hash(table: Mapping[str, str]) -> bool:
    """Whether the hash is there and agrees."""
    return HASH in table and table[HASH] == with_hash(table)[HASH]


def merged(infos: Sequence[FileInfo], name: str = METADATA_NAME) -> tuple[dict[str, str], list[str]]:
    """All entries of the records of one name, the later record counts; which are not believed, one sentence each."""
    records = [table for info in infos for table in info.metadata.get(name, [])]
    hashed = any(HASH in table for table in records) or any(info.expected for info in infos)
    entries: dict[str, str] = {}
    problems = []
    for number, table in enumerate(records, 1):
        if hashed and not has_right_hash(table):
            problems.append(f"metadata record {name} {number} of {len(records)} does not match its hash: ignored")
            continue
        entries.update({key: value for key, value in table.items() if key != HASH})
    if problems and not entries:
        problems.append(f"the run is unknown: no metadata record {name} matches its hash")
    if name == METADATA_NAME and not records and any(info.library.startswith(OWN_LIBRARY) for info in infos):
        problems.append(f"the run is unknown: the file was recorded with a metadata record {name} and has none")
    return entries, problems


def value_of(text: str) -> Any:
    """Value of an entry: JSON where it is, else the text."""
    try:
        return parse(text, "entry", "JSON", _with_long_integers)
    except InputError:
        return text


def _with_long_integers(text: str) -> Any:
    """JSON; integers that no float can hold stay text."""
    return json.loads(text, parse_int=lambda digits: int(digits) if len(digits) < DIGITS else digits)
