"""Ports from the signal labels of other libraries, which name single signals (numpy only).

A port ``w`` of three signals has the labels ``w[0]``, ``w[1]``, ``w[2]``; a port of one signal has its own name.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from lftkit.arrays import IntArray
from lftkit.errors import InputError
from lftkit.systems.ports import Port

_INDEXED = re.compile(r"(?P<port>.+)\[(?P<index>0|[1-9][0-9]*)\]", re.DOTALL)
_NUMBERED = re.compile(r".*\[[0-9]+\]", re.DOTALL)

Grouped = tuple[tuple[Port, ...], IntArray]


def ports_of_labels(labels: Sequence[str], units: Mapping[str, str] | None = None, kind: str = "signal") -> Grouped:
    """Ports of the labels, and where their signals stand among the labels.

    Parameters
    ----------
    labels : sequence of str, length m
        In any order; the signals of a port need not be neighbours.
    units : mapping, optional
        Unit of each port by name.
    kind : str
        What the labels name, for messages.

    Returns
    -------
    ports : tuple of Port
        In the order in which the labels name them first.
    order : ndarray of int, shape (m,)
        Position among the labels of each signal of the ports.

    Raises
    ------
    ValueError
        A label given twice, a port whose indices are not 0, 1, ..., or a label ``w`` beside ``w[0]``.

    Examples
    --------
    >>> ports, order = ports_of_labels(["w[1]", "v", "w[0]"])
    >>> [(port.name, port.size) for port in ports], order.tolist()
    ([('w', 2), ('v', 1)], [2, 0, 1])
    """
    places: dict[str, dict[int, int]] = {}
    plain: set[str] = set()
    for place, label in enumerate(labels):
        match = _INDEXED.fullmatch(label)
        name, index = (match["port"], int(match["index"])) if match else (label, 0)
        if match is None:
            plain.add(label)
        indices = places.setdefault(name, {})
        if index in indices or (name in plain and indices):
            first = labels[next(iter(indices.values()))]
            raise InputError(f"{kind} labels must name one signal each, got {first!r} and {label!r} for port {name!r}")
        indices[index] = place
    for name, indices in places.items():
        missing = sorted(set(range(len(indices))) - set(indices))
        if missing:
            raise InputError(
                f"{kind} labels of port {name!r} must have the indices 0 to {len(indices) - 1}, "
                f"got {', '.join(map(str, sorted(indices)))}"
            )
    units = units or {}
    ports = tuple(Port(name, len(indices), units.get(name, "1")) for name, indices in places.items())
    order = [indices[i] for indices in places.values() for i in range(len(indices))]
    return ports, np.array(order, dtype=np.intp)


def order_for_ports(labels: Sequence[str], ports: Iterable[Port], kind: str = "signal") -> IntArray:
    """Where the signals of given `ports` stand among the labels.

    Labels that name no signal of the ports, all of them, are taken by position.

    Raises
    ------
    ValueError
        Another number of signals, or labels of which only some name a signal of the ports.

    Examples
    --------
    >>> order_for_ports(["w[0]", "v", "w[1]"], [Port("v", 1), Port("w", 2)]).tolist()
    [1, 0, 2]
    >>> order_for_ports(["u[0]", "u[1]"], [Port("force", 1), Port("torque", 1)]).tolist()
    [0, 1]
    """
    signals = [signal for port in ports for signal in port.signals]
    if len(signals) != len(labels):
        raise InputError(f"{kind} ports must have {len(labels)} signals in all, got {len(signals)}")
    place = {label: k for k, label in enumerate(labels)}
    for k, label in enumerate(labels):
        if label.endswith("[0]"):
            place.setdefault(label[:-3], k)
    known = [place[signal] for signal in signals if signal in place]
    if not known:
        return np.arange(len(labels), dtype=np.intp)
    if len(set(known)) < len(labels):
        unknown = next((signal for signal in signals if signal not in place), signals[-1])
        raise InputError(f"{kind} ports must have the signals {', '.join(labels)}, got {unknown!r}")
    return np.array(known, dtype=np.intp)


def labels_of_ports(ports: Sequence[Port], kind: str = "signal") -> list[str]:
    """Labels from which :func:`ports_of_labels` makes the same ports.

    Raises
    ------
    ValueError
        A port whose name is itself that of a signal, for instance ``w[0]``.
    """
    for port in ports:
        if _NUMBERED.fullmatch(port.name):
            raise InputError(f"{kind} port must have a name without an index to become labels, got {port.name!r}")
    return [signal for port in ports for signal in port.signals]


def zero_based(label: str) -> str:
    """Label of a signal from its name in MATLAB, which counts from 1; any other as it is.

    Examples
    --------
    >>> zero_based("w(1)"), zero_based("w[0]"), zero_based("w")
    ('w[0]', 'w[0]', 'w')
    """
    return re.sub(r"\((\d+)\)$", lambda m: f"[{int(m[1]) - 1}]", label)
