"""What a system consists of: as five lines, in full as text, and as HTML for notebooks."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from typing import TYPE_CHECKING, Protocol

from lftkit.support.counted_nouns import counted
from lftkit.uncertainty.elements import Element, description

if TYPE_CHECKING:
    from lftkit.systems.ports import Port

Row = tuple[str, ...]


class WithPorts(Protocol):
    """A system with a name, ports and a number of states, for a line about it."""

    @property
    def name(self) -> str:
        """Name of the system."""

    @property
    def inputs(self) -> tuple[Port, ...]:
        """Ports of the inputs."""

    @property
    def outputs(self) -> tuple[Port, ...]:
        """Ports of the outputs."""

    @property
    def order(self) -> int:
        """Number of states."""


class Summarised(WithPorts, Protocol):
    """A system with period, elements and their occurrences as well, for a summary."""

    @property
    def dt(self) -> float:
        """Sampling period [s]; 0: continuous time."""

    @property
    def elements(self) -> tuple[Element, ...]:
        """Uncertain elements."""

    def occurrences(self) -> dict[str, int]:
        """Number of repetitions of each element in Delta."""


def lines(system: Summarised) -> list[str]:
    """Five lines or fewer: what stands in a session or a debugger.

    Examples
    --------
    >>> from lftkit import Port, RealParameter, System
    >>> k = RealParameter("k", 2.0, 1.0, 3.0, "N/m")
    >>> u, y = (Port("u", 1, "m"),), (Port("y", 1, "N"),)
    >>> System([], [], [], [[0.0, 1.0], [1.0, 2.0]], u, y, "spring", channels=("k",), elements=(k,))
    System 'spring': gain without states
      1 input: u (1)
      1 output: y (1)
      Delta 1 x 1: k (1)
    """
    size = sum(system.occurrences().values())
    head = f"System {system.name!r}: {_kind(system)}"
    sides = [f"  {counted(sum(p.size for p in ports), kind)}: {_named(ports)}" for ports, kind in _sides(system)]
    if not system.elements:
        return [head, *sides]
    occurrences = [f"{name} ({n})" for name, n in system.occurrences().items()]
    return [head, *sides, f"  Delta {size} x {size}: {_first(occurrences)}"]


def _kind(system: Summarised) -> str:
    time = f"dt {system.dt:g} s" if system.dt else "continuous time"
    return f"order {system.order}, {time}" if system.order or system.dt else "gain without states"


def named_line(system: WithPorts, *facts: str) -> str:
    """Type, name, order, the first ports by name and size, and further `facts`."""
    sides = [f"{kind}{'' if len(ports) == 1 else 's'} {_named(ports)}" for ports, kind in _sides(system)]
    return f"{type(system).__name__}({', '.join([repr(system.name), f'order {system.order}', *sides, *facts])})"


def _named(ports: Sequence[Port]) -> str:
    return _first([f"{port.name} ({port.size})" for port in ports])


def _first(names: Sequence[str], shown: int = 4) -> str:
    more = f" and {len(names) - shown} more" if len(names) > shown else ""
    return f"{', '.join(names[:shown]) or 'none'}{more}"


def text(system: Summarised) -> str:
    """Ports with sizes and units, elements with range and occurrences in Delta."""
    parts = [f"{system.name}: {_kind(system)}"]
    for ports, kind in _sides(system):
        parts += [f"{counted(sum(p.size for p in ports), kind)}:", *_columns(_port_rows(ports))]
    rows = _element_rows(system)
    total = sum(system.occurrences().values())
    parts += [f"{counted(len(rows), 'element')}, {counted(total, 'occurrence')} in Delta:"] if rows else ["certain"]
    return "\n".join([*parts, *_columns(rows)])


def html(system: Summarised) -> str:
    """The same as HTML: one line, ports and elements in tables that fold out."""
    parts = [f"<strong>{escape(system.name)}: {_kind(system)}</strong>"]
    for ports, kind in _sides(system):
        head = counted(sum(p.size for p in ports), kind)
        parts.append(_table(head, ("port", "size", "unit"), _port_rows(ports)))
    if rows := _element_rows(system):
        head = f"{counted(len(rows), 'element')}, {counted(sum(system.occurrences().values()), 'occurrence')} in Delta"
        parts.append(_table(head, ("element", "range", "occurrences"), rows))
    return f"<div>{''.join(parts)}</div>"


def _sides(system: WithPorts) -> tuple[tuple[tuple[Port, ...], str], ...]:
    return (system.inputs, "input"), (system.outputs, "output")


def _port_rows(ports: Sequence[Port]) -> list[Row]:
    return [(p.name, str(p.size), p.unit) for p in ports]


def _element_rows(system: Summarised) -> list[Row]:
    count = system.occurrences()
    return [(e.name, description(e), str(count[e.name])) for e in system.elements]


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
