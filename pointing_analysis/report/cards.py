"""What the report shows of one run: verdict, figures with limit and margin, disturbance lines, provenance."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Sequence
from typing import Any

from pointing_analysis.indices.errors import RAD_PER_MAS
from pointing_analysis.indices.motion import motion_of
from pointing_analysis.read.recording import Recording
from pointing_analysis.report.figures import RunView
from pointing_analysis.requirements.summary import Summary
from pointing_analysis.requirements.verdict import Verdict

HASH_LIMIT = 2_000_000_000  # larger bags are not hashed for the report
LINES_SHOWN = 12
KEEPS = "keeps its limits"
"""Shown for a run that keeps a limit and is too short to prove it."""


def digits(value: float, places: int = 3) -> str:
    """Number for a table: a few significant digits, a dash where there is none."""
    if math.isnan(value):
        return "–"
    if math.isinf(value):
        return "no bound yet"
    return f"{value:,.0f}".replace(",", "\u202f") if abs(value) >= 1000 else f"{value:.{places}g}"


def css_class(status: str) -> str:
    """Class of a status: its colour on the page."""
    return {"compliant": "ok", KEEPS: "ok", "not compliant": "bad"}.get(status, "open")


def shown_status(v: Verdict) -> str:
    """Status; of too short a run that exceeds its limit no more often than allowed: that it keeps it."""
    return KEEPS if v.status == "not enough data" and v.keeps else v.status


def overall(verdicts: Sequence[Verdict]) -> str:
    """One word for several verdicts: the worst of them."""
    found = {shown_status(v) for v in verdicts}
    for status in ("not compliant", "not enough data", "not judged", KEEPS):
        if status in found:
            return status
    return "compliant" if found else "not judged"


def limit_row(v: Verdict) -> dict[str, str]:
    """Quantile of one requirement beside its limit, and the margin: limit minus quantile, also in % of the limit."""
    scale, unit, limit = v.requirement.scale, v.requirement.unit, v.requirement.limit
    value = v.quantile.value
    if math.isnan(value) or v.status == "not judged":
        return {
            "name": v.requirement.name,
            "value": f"– of {digits(limit / scale)} {unit}",
            "margin": "",
            "css": "open",
        }
    margin, share = (limit - value) / scale, 100 * (limit - value) / limit
    text = f"margin {'+' if margin >= 0 else '−'}{digits(abs(margin))} {unit} ({abs(share):.0f} %)"
    return {
        "name": v.requirement.name,
        "value": f"{digits(value / scale)} of {digits(limit / scale)} {unit}",
        "margin": text,
        "css": "ok" if margin >= 0 else "bad",
    }


def _digest(run: Recording) -> str:
    if not run.path.exists():
        return "no file"
    files = sorted(run.path.glob("*.mcap*")) if run.path.is_dir() else [run.path]
    if sum(f.stat().st_size for f in files) > HASH_LIMIT:
        return "not computed (large bag)"
    total = hashlib.sha256()
    for file in files:
        with file.open("rb") as stream:
            while block := stream.read(1 << 20):
                total.update(block)
    return total.hexdigest()


def _flat(key: str, value: Any) -> list[tuple[str, str]]:
    """A parameter as table rows; a dictionary becomes one row per group of plain values."""
    if isinstance(value, dict):
        plain = {k: v for k, v in value.items() if not isinstance(v, dict)}
        rows = [(key, ", ".join(f"{k} {v}" for k, v in plain.items()))] if plain else []
        return rows + [row for k, v in value.items() if isinstance(v, dict) for row in _flat(f"{key}: {k}", v)]
    if isinstance(value, list):
        return [(key, ", ".join(f"{x:.6g}" if isinstance(x, float) else str(x) for x in value) or "none given")]
    return [(key, str(value) if value != "" else "none given")]


def _provenance(run: Recording) -> list[tuple[str, str]]:
    rows = [("bag", run.path.name), ("SHA-256 of the bag", _digest(run))]
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
            "x": digits(float(line.amplitude[0]) / RAD_PER_MAS),
            "y": digits(float(line.amplitude[1]) / RAD_PER_MAS),
            "rpe": digits(line.rpe / RAD_PER_MAS),
            "share": f"{100 * line.rpe**2 / total:.1f} %" if total else "–",
        }
        for line in v.tones[:LINES_SHOWN]
    ]


def run_card(v: RunView, s: Summary, label: str, remarks: Sequence[str] = ()) -> dict[str, Any]:
    """Everything that the page shows of one run, ready to print."""
    status = overall(s.verdicts)
    return {
        "label": label,
        "status": status,
        "css": css_class(status),
        "scenario": s.scenario,
        "mode": s.mode,
        "figures": [
            ("APE max", f"{digits(s.ape_max)} arcsec"),
            ("APE 99.7 %", f"{digits(s.ape_p997)} arcsec"),
            ("RPE rms", f"{digits(s.rpe_rms)} mas"),
            ("RPE 99.7 % of windows", f"{digits(s.rpe_windows_p997)} mas"),
            ("RPE 99.7 % of instants", f"{digits(s.rpe_p997)} mas"),
        ],
        "knowledge": s.knowledge
        and [
            ("AKE 99.7 %", f"{digits(s.knowledge.ake_p997_arcsec)} arcsec"),
            ("RKE rms", f"{digits(s.knowledge.rke_rms_mas)} mas"),
        ],
        "limits": [limit_row(verdict) for verdict in s.verdicts],
        "data": (
            f"{digits(s.duration, 6)} s, {digits(s.ticks, 6)} ticks; first {s.transient:g} s dropped; "
            f"{digits(s.windows, 6)} windows of 20 ms, {s.windows_skipped} skipped; {s.samples_lost} samples lost"
        ),
        "problems": s.problems,
        "remarks": [*([] if s.budget is None else [str(s.budget)]), *remarks],
        "lines": _line_rows(v),
        "line_count": len(v.tones),
        "moves": motion_of(v.run) is not None,
        "provenance": _provenance(v.run),
    }
