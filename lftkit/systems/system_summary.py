"""What a system consists of, as one line; of an uncertain one also as text and as HTML for notebooks."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    from lftkit.systems.ports import Port
    from lftkit.uncertainty.parameters import RealParameter

Row = tuple[str, ...]
SHOWN = 6
"""Ports of a side that a line names."""


class WithPorts(Protocol):
    """What the line needs of a system: ports and number of states."""

    @property
    def inputs(self) -> tuple[Port, ...]:
        """Ports of the inputs."""
        ...

    @property
    def outputs(self) -> tuple[Port, ...]:
        """Ports of the outputs."""
        ...

    @property
    def order(self) -> int:
        """Number of states."""
        ...


class Summarised(WithPorts, Protocol):
    """What a summary needs of an uncertain system: its parameters and their occurrences as well."""

    @property
    def parameters(self) -> tuple[RealParameter, ...]:
        """Uncertain parameters."""
        ...

    def occurrences(self) -> dict[str, int]:
        """Number of repetitions of each parameter in Delta."""
        ...


def one_line(system: WithPorts, *facts: str) -> str:
    """Type, order, counts and further `facts`: what stands in a session or a debugger.

    Examples
    --------
    >>> from lftkit import Port, RealParameter, StateSpace, UncertainSystem
    >>> k = RealParameter("k", 2.0, 1.0, 3.0, "N/m")
    >>> u, y = (Port("u", 1, "m"),), (Port("y", 1, "N"),)
    >>> UncertainSystem([], [], [], [[0.0, 1.0], [1.0, 2.0]], u, y, ("k",), (k,))
    UncertainSystem(order 0, 1 input, 1 output, parameters k (1))
    >>> StateSpace.static(2.0, u, y, "spring")
    StateSpace('spring', order 0, input u (1), output y (1))
    """
    counts = [_count(sum(p.size for p in ports), kind) for ports, kind in _sides(system)]
    return f"{type(system).__name__}({', '.join([f'order {system.order}', *counts, *facts])})"


def named_line(system: WithPorts, name: str, *facts: str) -> str:
    """Type, name, order, the first ports by name and size, and further `facts`."""
    sides = [_named_ports(ports, kind) for ports, kind in _sides(system)]
    return f"{type(system).__name__}({', '.join([repr(name), f'order {system.order}', *sides, *facts])})"


def _named_ports(ports: Sequence[Port], kind: str) -> str:
    shown = ", ".join(f"{port.name} ({port.size})" for port in ports[:SHOWN])
    more = f" and {len(ports) - SHOWN} more" if len(ports) > SHOWN else ""
    return f"{kind}{'' if len(ports) == 1 else 's'} {shown or 'none'}{more}"


def text(system: Summarised) -> str:
    """Ports with sizes and units, parameters with nominal value, range, unit and occurrences in Delta."""
    lines = [f"order {system.order}"]
    for ports, kind in _sides(system):
        lines += [f"{_count(sum(p.size for p in ports), kind)}:", *_columns(_port_rows(ports))]
    rows = _parameter_rows(system)
    total = sum(system.occurrences().values())
    lines += [f"{_count(len(rows), 'parameter')}, {_count(total, 'occurrence')} in Delta:"] if rows else ["certain"]
    return "\n".join([*lines, *_columns(rows)])


def html(system: Summarised) -> str:
    """The same as HTML: one line, ports and parameters in tables that fold out."""
    parts = [f"<strong>order {system.order}</strong>"]
    for ports, kind in _sides(system):
        head = _count(sum(p.size for p in ports), kind)
        parts.append(_table(head, ("port", "size", "unit"), _port_rows(ports)))
    if rows := _parameter_rows(system):
        head = f"{_count(len(rows), 'parameter')}, {_count(sum(system.occurrences().values()), 'occurrence')} in Delta"
        parts.append(_table(head, ("parameter", "nominal", "range", "unit", "occurrences"), rows))
    return f"<div>{''.join(parts)}</div>"


def _sides(system: WithPorts) -> tuple[tuple[tuple[Port, ...], str], ...]:
    return (system.inputs, "input"), (system.outputs, "output")


def _count(number: int, kind: str) -> str:
    return f"{number} {kind}{'' if number == 1 else 's'}"


def _port_rows(ports: Sequence[Port]) -> list[Row]:
    return [(p.name, str(p.size), p.unit) for p in ports]


def _parameter_rows(system: Summarised) -> list[Row]:
    count = system.occurrences()
    return [
        (p.name, f"{p.nominal:.6g}", f"{p.lower:.6g} .. {p.upper:.6g}", p.unit, str(count[p.name]))
        for p in system.parameters
    ]


def _columns(rows: Sequence[Row]) -> list[str]:
    widths = [max(len(cell) for cell in column) for column in zip(*rows)]
    return ["  " + "  ".join(cell.ljust(width) for cell, width in zip(row, widths)).rstrip() for row in rows]


def _table(summary: str, head: Row, rows: Sequence[Row]) -> str:
    titles = "".join(f"<th>{escape(cell)}</th>" for cell in head)
    body = "".join("<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in row) + "</tr>" for row in rows)
    return (
        f"<details><summary>{escape(summary)}</summary>"
        f"<table><thead><tr>{titles}</tr></thead><tbody>{body}</tbody></table></details>"
    )
