"""Named places of the structure and the nodes that they stand for."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from titop_plant.structures.reference import body_points
from titop_plant.telescope.layout import appendages, solar_arrays

REFERENCE_POINT = "bus"
"""Place of the bus's reference point G."""

PAYLOAD_NODES = ("M1", "M2", "DET")
"""Nodes of the payload without an attached body."""

BUS = {"wheels": "I_w", "isolator": "I_p"}
PAYLOAD = {"payload": "platform", "M1": "M1", "M2": "M2", "detector": "DET"}
"""Places of the bus and of the payload that every telescope has, and their nodes."""


def nodes(parameters: Mapping[str, Any]) -> dict[str, str]:
    """Nodes of the structure beside the bus's reference point, by the names of places.

    Examples
    --------
    >>> from titop_plant.telescope.parameters import load_parameters
    >>> list(nodes(load_parameters()))
    ['wheels', 'isolator', 'array_1', 'array_2', 'payload', 'M1', 'M2', 'detector']
    """
    arrays, others = solar_arrays(parameters), appendages(parameters)
    found = {**BUS, **{f"array_{i}": one.point for i, one in enumerate(arrays, start=1)}, **PAYLOAD}
    found |= {one.name: one.point for one in (*arrays, *others)}
    points = () if parameters["body"]["modal_data"] else body_points(parameters)
    return found | {point: point for point in points if point not in found.values()}


def loaded_nodes(parameters: Mapping[str, Any]) -> tuple[str, ...]:
    """Nodes of all places, each once: the loads of a telescope that sources act on."""
    return tuple(dict.fromkeys(nodes(parameters).values()))


def points(parameters: Mapping[str, Any]) -> dict[str, str]:
    """Nodes where a device may be, by the names of their places and by their own."""
    named = nodes(parameters)
    return named | {node: node for node in named.values()}


def node_at(place: str, parameters: Mapping[str, Any]) -> str:
    """Node of a place, the bus's reference point included."""
    return "G" if place == REFERENCE_POINT else points(parameters)[place]


def body_of(node: str) -> str:
    """Block of the telescope that a node belongs to: ``platform``, ``payload`` or ``body``.

    Examples
    --------
    >>> body_of("M1"), body_of("I_w")
    ('payload', 'body')
    """
    return {"platform": "platform", **dict.fromkeys(PAYLOAD_NODES, "payload")}.get(node, "body")
