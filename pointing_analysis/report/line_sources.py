"""Origin of a line of the spectrum, and its likely cause: a wheel, or the scenario of the run."""

from __future__ import annotations

import math
from collections.abc import Sequence

from lftkit.support.counted_nouns import counted
from pointing_analysis.files.structured_text import is_number
from pointing_analysis.read.recording import Recording
from pointing_analysis.report.figures import RunView
from pointing_analysis.requirements.conditions import ACTING, LINES, WHEEL_SPEEDS
from pointing_analysis.spectra.spectra import SpectralLine

NAMED = 2
"""Sources of one line that are named, in the space of a label."""
ORDERS = 6
"""Multiples of the speed of a wheel at which its bearings and its imbalance make lines."""


def origin(line: SpectralLine) -> str:
    """Origin of a line: named in the recording, or found in the spectrum."""
    return "recording" if line.found is None else f"spectrum, {line.found.level:.0f} dB above the noise"


def likely_source(view: RunView, line: SpectralLine) -> str:
    """Likely cause of a line; empty if nothing in the recording fits.

    A line within the resolution of the run, one over its length, of a tone of a source is that source's, at a multiple
    of the speed of a wheel that wheel's; others that the recording names are of its scenario.
    """
    if line.found is not None and line.found.is_sideband:
        return f"sideband of {line.found.carrier / (2 * math.pi):.4g} Hz"
    speeds = view.run.parameters.get(WHEEL_SPEEDS, [])
    near = 2 * math.pi / max(view.series.duration, 1e-9)
    wheels = _wheels(
        line.omega, [abs(float(x)) for x in speeds if is_number(x)] if isinstance(speeds, list) else [], near
    )
    return _sources(view.run, line.omega, near) or wheels or (_scenario(view.run) if line.found is None else "")


def _wheels(omega: float, speeds: Sequence[float], near: float) -> str:
    for order in range(1, ORDERS + 1):
        numbers = [str(k + 1) for k, speed in enumerate(speeds) if speed > near and abs(omega - order * speed) <= near]
        if numbers:
            name = f"wheel{'s' if len(numbers) > 1 else ''} {', '.join(numbers)}"
            return name if order == 1 else f"{order} × {name}"
    return ""


def _acting(run: Recording) -> list[dict[str, object]]:
    entries = run.parameters.get(ACTING)
    return [entry for entry in entries if isinstance(entry, dict)] if isinstance(entries, list) else []


def _sources(run: Recording, omega: float, near: float) -> str:
    """Names of the sources with a tone at a frequency [rad/s], of more than `NAMED` the first ones and their number."""
    names: list[str] = []
    for entry in _acting(run):
        lines = entry.get(LINES)
        known = [float(x) for x in lines if is_number(x)] if isinstance(lines, list) else []
        if any(abs(line - omega) <= near for line in known):
            names.append(str(entry.get("name")))
    others = len(names) - NAMED
    return ", ".join(names[:NAMED]) + (f" and {counted(others, 'other')}" if others > 0 else "")


def _scenario(run: Recording) -> str:
    return next((str(entry.get("name")) for entry in _acting(run) if entry.get("kind") == "scenario"), "")
