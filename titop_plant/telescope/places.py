"""Named places of the structure and the bodies that their nodes belong to."""

from __future__ import annotations

REFERENCE_POINT = "bus"
"""Place of the bus's reference point G."""

PAYLOAD_NODES = ("M1", "M2", "DET")
"""Nodes of the payload without an attached body."""

BUS = {"wheels": "I_w", "isolator": "I_p"}
PAYLOAD = {"payload": "platform", "M1": "M1", "M2": "M2", "detector": "DET"}
"""Places of the bus and of the payload that every telescope has, and their nodes."""


def body_of(node: str) -> str:
    """Block of the telescope that a node belongs to: ``platform``, ``payload`` or ``body``.

    Examples
    --------
    >>> body_of("M1"), body_of("I_w")
    ('payload', 'body')
    """
    return {"platform": "platform", **dict.fromkeys(PAYLOAD_NODES, "payload")}.get(node, "body")
