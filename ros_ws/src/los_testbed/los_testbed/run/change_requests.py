"""Requests of other programs during a run, from its bag: origin, change and time."""

from __future__ import annotations

import json
from typing import Any

from lftkit.errors import InputError
from los_testbed.config.run_config import ACTIVE
from los_testbed.config.topics import NODES
from los_testbed.run.loop.changes import RESET, STOP
from pointing_analysis.read.mcap.bag_metadata import value_of
from pointing_analysis.read.run import Run
from pointing_analysis.read.run_end import statistics_of
from titop_plant.interface import RATE

SHOWN = 5
"""Largest number of changes listed; of further ones the number is given."""
LONGEST = 200
WORDS = {STOP: "stopped", RESET: "reset"}


def requested(run: Run) -> tuple[str, ...]:
    """Sentences about the requests that changed or ended a run, in order of time.

    Parameters
    ----------
    run : Run
        Of any origin: of values that are no lists of changes it is said that they are none.
    """
    read = {node: _read(run, node) for node in NODES}
    rows = [
        (row["tick"] / RATE, _sentence(node, row))
        for node, (changes, _) in read.items()
        for row in changes
        if isinstance(row.get("by"), str)
    ]
    rows.sort(key=lambda row: row[0])
    texts = [text for _, text in rows]
    # the end of the run comes last and is always reported
    left = texts[: len(texts) - 1][SHOWN:]
    if left:
        texts = [*texts[:SHOWN], f"{len(left)} more changes by request", texts[-1]]
    return (*(wrong for _, wrong in read.values() if wrong), *texts)


def changes_in(run: Run, node: str) -> list[dict[str, Any]]:
    """Changes of a node's settings that a bag records (:meth:`los_testbed.run.loop.changes.Changes.record`).

    Each has ``tick``, ``name`` and ``value``, requested ones ``by``.

    Raises
    ------
    InputError
        What the bag has is no such list.
    """
    rows, wrong = _read(run, node)
    if wrong:
        raise InputError(wrong)
    return rows


def _read(run: Run, node: str) -> tuple[list[dict[str, Any]], str]:
    """Changes of a node, and what is wrong with what the bag has."""
    text = statistics_of(run.parameters, node).get("changes")
    rows = [] if text is None else value_of(text) if isinstance(text, str) else text
    if isinstance(rows, list) and all(map(_is_change, rows)):
        return rows, ""
    return [], f"changes of the node {node} must be a list with tick, name and value, got {str(text)[:60]!r}"


def _is_change(row: Any) -> bool:
    known = isinstance(row, dict) and isinstance(row.get("name"), str) and "value" in row
    return known and isinstance(row.get("tick"), int) and 0 <= row["tick"] < 1e12


def _sentence(node: str, row: dict[str, Any]) -> str:
    name, time = row["name"], f"at {row['tick'] / RATE:g} s"
    by = row["by"][:LONGEST]
    if name in WORDS:
        return f"{WORDS[name]} by request {time}, from {by}"
    if name == ACTIVE:
        return f"{node} {'activated' if row.get('value') else 'deactivated'} by request {time}, from {by}"
    return f"{name[:LONGEST]} set to {json.dumps(row.get('value'))[:LONGEST]} by request {time}, from {by}"
