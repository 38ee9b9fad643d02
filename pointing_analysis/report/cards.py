"""What the report shows of one run: verdict, figures with limit and margin, disturbance lines, provenance."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Sequence
from typing import Any

from pointing_analysis.indices.errors import RAD_PER_MAS
from pointing_analysis.indices.motion import motion_of
from pointing_analysis.read.mcap.bag_files import bag_files, files_digest
from pointing_analysis.read.recording import Recording
from pointing_analysis.report.figures import RunView
from pointing_analysis.requirements.requirement import time_text
from pointing_analysis.requirements.rows import css_class, digits
from pointing_analysis.requirements.summary import Summary
from pointing_analysis.spectra.spectra import SpectralLine

HASH_LIMIT = 2_000_000_000  # larger bags are not hashed for the report
LINES_SHOWN = 12


def _digest(run: Recording) -> str:
    if not run.path.exists():
        return "no file"
    files = bag_files(run.path).files
    if sum(f.stat().st_size for f in files) > HASH_LIMIT:
        return "not computed (large bag)"
    return files_digest(files)


def _flat(key: str, value: Any) -> list[tuple[str, str]]:
    """A parameter as table rows; a dictionary becomes one row per group of plain values."""
    if isinstance(value, dict):
        plain = {k: v for k, v in value.items() if not isinstance(v, dict)}
        rows = [(key, ", ".join(f"{k} {v}" for k, v in plain.items()))] if plain else []
        return rows + [row for k, v in value.items() if isinstance(v, dict) for row in _flat(f"{key}: {k}", v)]
    if isinstance(value, list) and value and all(isinstance(item, dict) for item in value):
        named = [
            (f"{key}: {item.get('name', i)}", {k: v for k, v in item.items() if k != "name"})
            for i, item in enumerate(value, 1)
        ]
        return [row for name, item in named for row in _flat(name, item)]
    if isinstance(value, list):
        return [(key, ", ".join(f"{x:.6g}" if isinstance(x, float) else str(x) for x in value) or "none given")]
    return [(key, str(value) if value != "" else "none given")]


def _provenance(run: Recording) -> list[tuple[str, str]]:
    name = run.kind if run.kind in ("bag", "arrays") else f"{run.kind} file"
    rows = [(name, run.path.name), (f"SHA-256 of the {name}", _digest(run))]
    for key in sorted(run.parameters):
        rows += _flat(key, run.parameters[key])
    for name, data in sorted(run.attachments.items()):
        rows.append((f"attachment {name}", f"{len(data)} bytes, SHA-256 {hashlib.sha256(data).hexdigest()[:16]}…"))
    return rows


def _line_rows(v: RunView) -> list[dict[str, str]]:
    total = math.fsum(line.rpe**2 for line in v.tones)
    return [
        {
            "omega": f"{line.omega:.2f}" + (f" ({line.merged} lines)" if line.merged > 1 else ""),
            "hertz": f"{line.omega / (2 * math.pi):.3f}",
            "origin": _origin(line),
            "x": _amplitude(line, 0),
            "y": _amplitude(line, 1),
            "rpe": digits(line.rpe / RAD_PER_MAS),
            "share": f"{100 * line.rpe**2 / total:.1f} %" if total else "–",
        }
        for line in v.tones[:LINES_SHOWN]
    ]


def _origin(line: SpectralLine) -> str:
    """Where a line is known from."""
    if line.found is None:
        return "named"
    if line.found.is_sideband:
        return f"found, sideband of {line.found.carrier / (2 * math.pi):.3f} Hz"
    return f"found, {line.found.level:.0f} dB above the noise"


def _amplitude(line: SpectralLine, axis: int) -> str:
    """Amplitude of an axis [mas]; of a found line with the larger distance of its bounds."""
    value = float(line.amplitude[axis])
    text = digits(value / RAD_PER_MAS)
    if line.found is None:
        return text
    bound = max(float(line.found.upper[axis]) - value, value - float(line.found.lower[axis]))
    return f"{text} ± {digits(bound / RAD_PER_MAS, 2)}"


def run_card(v: RunView, s: Summary, label: str, remarks: Sequence[str] = ()) -> dict[str, Any]:
    """Everything that the page shows of one run, ready to print."""
    status = s.overall
    return {
        "label": label,
        "status": status,
        "css": css_class(status),
        "scenario": s.scenario,
        "conditions": s.conditions.lines,
        "mode": s.mode,
        "figures": [(figure.name, figure.text) for figure in s.figures],
        "knowledge": s.knowledge
        and [
            ("AKE 99.7 %", f"{digits(s.knowledge.ake_p997_arcsec)} arcsec"),
            ("RKE rms", f"{digits(s.knowledge.rke_rms_mas)} mas"),
        ],
        "limits": s.rows,
        "data": (
            f"{digits(s.duration, 6)} s, {digits(s.ticks, 6)} {'ticks' if s.mode else 'samples'}; "
            f"first {s.transient:g} s dropped; "
            f"{digits(s.windows, 6)} windows of {time_text(s.window)}, {s.windows_skipped} skipped; "
            f"samples lost: {s.lost_text()}"
        ),
        "kind": s.kind,
        "problems": s.problems,
        "remarks": [*([] if s.budget is None else [str(s.budget)]), *remarks],
        "lines": _line_rows(v),
        "line_count": len(v.tones),
        "found": any(line.found for line in v.tones),
        "moves": motion_of(v.run) is not None,
        "provenance": _provenance(v.run),
    }
