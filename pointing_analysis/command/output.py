"""Output and checks shared by the commands: JSON, warnings, numbers."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import typer

from lftkit.errors import InputError
from pointing_analysis.command.exit_codes import ExitCode
from pointing_analysis.command.screen import printable

if TYPE_CHECKING:
    from pointing_analysis.requirements.summary import Summary


MET = {"compliant": True, "not compliant": False}
"""Whether a requirement is met, by the status of a verdict; others demonstrate nothing."""


def print_json(content: Mapping[str, Any] | Sequence[Any]) -> None:
    """Write one line of JSON to the standard output."""
    sys.stdout.write(json.dumps(content) + "\n")
    sys.stdout.flush()


def leave_if_contradicted(contradictions: Iterable[str]) -> None:
    """End the command with its exit code if there is a contradiction."""
    if any(contradictions):
        raise typer.Exit(ExitCode.CONTRADICTION)


def leave_by_gate(verdicts: Iterable[tuple[str, bool | None]]) -> None:
    """End the command with the code of requirements that are not met, or not demonstrated; say which.

    Parameters
    ----------
    verdicts : iterable of (str, bool or None)
        Each requirement, and whether it is met; None: it is not demonstrated. None at all demonstrate nothing.
    """
    rows = list(verdicts)
    for wanted, words, code in (
        (False, "not met", ExitCode.NOT_MET),
        (None, "not demonstrated", ExitCode.NOT_DEMONSTRATED),
    ):
        names = dict.fromkeys(printable(name) for name, status in rows if status is wanted)
        if names:
            sys.stderr.write(f"gate: {words}: {', '.join(names)}\n")
            raise typer.Exit(code)
    if not rows:
        sys.stderr.write("gate: not demonstrated: no requirement was judged\n")
        raise typer.Exit(ExitCode.NOT_DEMONSTRATED)


def gate_of(summaries: Iterable[Summary]) -> list[tuple[str, bool | None]]:
    """Verdicts on recorded runs for :func:`leave_by_gate`: of the samples alone, whatever is proven beside them."""
    return [(str(v.requirement), MET.get(v.status)) for summary in summaries for v in summary.verdicts]


def number(name: str, value: float, low: float, high: float, unit: str = "") -> float:
    """A number within its range.

    Raises
    ------
    ValueError
        It is not finite or outside.

    Examples
    --------
    >>> number("--transient", 1e308, 0.0, 1e6, "s")
    Traceback (most recent call last):
    ...
    lftkit.errors.InputError: --transient must be between 0 and 1e+06 s, got 1e+308
    """
    if not low <= value <= high:  # NaN is neither
        got = f"{value:g}" if isinstance(value, float) else str(value)[:40]
        raise InputError(f"{name} must be between {low:g} and {high:g}{' ' if unit else ''}{unit}, got {got}")
    return value


def numbers(name: str, text: str) -> tuple[float, ...]:
    """Numbers of an option, separated by commas.

    Raises
    ------
    ValueError
        One that is none.

    Examples
    --------
    >>> numbers("--rates", "50,25")
    (50.0, 25.0)
    """
    try:
        return tuple(float(part) for part in text.split(","))
    except ValueError:
        raise InputError(f"{name} must be numbers separated by commas, got {text!r}") from None


def seconds(name: str, value: float | None, high: float = 1e7) -> None:
    """Check an optional time [s]; raises as `number`."""
    if value is not None:
        number(name, value, 0.0, high, "s")


def chunk_limit(megabytes: float) -> int:
    """``--max-chunk`` in bytes."""
    return round(1e6 * number("--max-chunk", megabytes, 0.001, 100_000.0, "MB"))
