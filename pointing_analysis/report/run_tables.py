"""Tables of the report about its runs: metrics, lines, predicted and measured tones, sensors, provenance."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Sequence
from typing import Any

from pointing_analysis.formatting.number_text import ABSENT, digits, percent
from pointing_analysis.formatting.tables import Heading, TextTable, numbers, texts
from pointing_analysis.indices.errors import RAD_PER_MAS
from pointing_analysis.read.mcap.bag_files import bag_files, files_digest
from pointing_analysis.read.recorded_sensors import sensors_of
from pointing_analysis.read.recording import Recording
from pointing_analysis.report.figures import RunView
from pointing_analysis.report.line_sources import likely_source, origin
from pointing_analysis.requirements.summary import Summary
from pointing_analysis.spectra.prediction import Prediction, ToneComparison
from pointing_analysis.spectra.spectra import SpectralLine

LINES_SHOWN = 12
"""Largest lines of a run that are in its table."""
HASH_LIMIT = 2_000_000_000
"""Size of a bag [byte] from which its digest is not computed for the report."""


def metric_table(names: Sequence[str], summaries: Sequence[Summary]) -> TextTable:
    """Metrics that need no requirement: a row each, a column for each run."""
    each = [_metrics(summary) for summary in summaries]
    metrics = dict.fromkeys(name for one in each for name in one)
    rows = [(name, *(one.get(name, ABSENT) for one in each)) for name in metrics]
    runs = (Heading(name, number=True, name=True) for name in names)
    heads = (*texts("metric"), *(runs if len(names) > 1 else numbers("value")))
    return TextTable.of(heads, rows, "Metrics", name="metrics")


def _metrics(summary: Summary) -> dict[str, str]:
    shown = {figure.name: figure.text for figure in summary.figures}
    if summary.knowledge:
        shown[f"AKE {percent(summary.probabilities.knowledge, 10)}"] = (
            f"{digits(summary.knowledge.ake_quantile_arcsec)} arcsec"
        )
        shown["RKE rms"] = f"{digits(summary.knowledge.rke_rms_mas)} mas"
    return shown


def line_table(view: RunView, name: str = "lines") -> TextTable:
    """The largest disturbance lines of a run; amplitudes of found ones with the larger distance of their bounds.

    Lines that the recording names and that are not above the noise stand at the end, without figures.
    """
    total = math.fsum(line.rpe**2 for line in view.tones)
    rows = [
        (
            *_line(view, line),
            _amplitude(line, 0),
            _amplitude(line, 1),
            digits(line.rpe / RAD_PER_MAS),
            f"{100 * line.rpe**2 / total:.1f} %" if total else ABSENT,
        )
        for line in view.tones[:LINES_SHOWN]
    ]
    quiet = sorted(view.within_noise, key=lambda line: line.omega)
    rows += [(*_line(view, line), *2 * ("in noise",), ABSENT, ABSENT) for line in quiet[: LINES_SHOWN - len(rows)]]
    heads = (
        *numbers("Hz", "rad/s"),
        *texts("likely source", "known from"),
        *numbers("x [mas]", "y [mas]", "RPE rms [mas]", "share of all lines"),
    )
    return TextTable.of(heads, rows, "Disturbance lines", name=name)


def _line(view: RunView, line: SpectralLine) -> tuple[str, str, str, str]:
    """Frequency in both units, likely source and origin."""
    hertz = f"{line.omega / (2 * math.pi):.3f}"
    return hertz, _frequency(line.omega, line.merged), likely_source(view, line) or ABSENT, origin(line)


def _frequency(omega: float, merged: int) -> str:
    return f"{omega:.2f}" + (f" ({merged} lines)" if merged > 1 else "")


def _amplitude(line: SpectralLine, axis: int) -> str:
    value = float(line.amplitude[axis])
    text = digits(value / RAD_PER_MAS)
    if line.found is None:
        return text
    bound = max(float(line.found.upper[axis]) - value, value - float(line.found.lower[axis]))
    return f"{text} ± {digits(bound / RAD_PER_MAS, 2)}"


def prediction_table(prediction: Prediction, name: str = "predicted") -> TextTable:
    """Predicted and measured amplitudes of the tones of a run, the strongest first."""
    rows = [
        (
            f"{tone.omega / (2 * math.pi):.3f}",
            _frequency(tone.omega, tone.merged),
            digits(tone.predicted / RAD_PER_MAS),
            digits(tone.measured / RAD_PER_MAS),
            _ratio(tone),
        )
        for tone in sorted(prediction.tones, key=lambda tone: -tone.predicted)
    ]
    heads = numbers("Hz", "rad/s", "predicted [mas]", "measured [mas]", "ratio")
    return TextTable.of(heads, rows, "Predicted and measured tones", name=name)


def _ratio(tone: ToneComparison) -> str:
    if tone.in_noise or not tone.predicted:
        return "in noise" if tone.in_noise else ABSENT
    return f"{tone.ratio:.3f}" + ("" if tone.uncertainty < 5e-4 else f" ± {tone.uncertainty:.3f}")


def sensor_table(run: Recording, name: str = "sensors") -> TextTable:
    """Rate and noise of the sensors of a run."""
    rows = []
    for sensor in sensors_of(run):
        integrity = run[sensor.topic].integrity
        rows.append(
            (
                sensor.topic,
                ", ".join(sensor.unit.split(",")),
                digits(sensor.rate),
                ", ".join(digits(value) for value in dict.fromkeys(sensor.noise)),
                str(len(run[sensor.topic]) - integrity.nan),
                str(integrity.nan) if sensor.held else ABSENT,
            )
        )
    heads = (*texts("topic", "unit"), *numbers("rate [Hz]", "noise of a sample, rms", "samples", "dropped"))
    return TextTable.of(heads, rows, "Sensors", name=name)


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


def provenance_table(run: Recording, name: str = "provenance") -> TextTable:
    """Digest of a recording, its settings and its attachments; `name` is that of the table's file."""
    kind = run.kind if run.kind in ("bag", "arrays") else f"{run.kind} file"
    rows = [(kind, run.path.name), (f"SHA-256 of the {kind}", _digest(run))]
    for key in sorted(run.parameters):
        rows += _flat(key, run.parameters[key])
    for attached, data in sorted(run.attachments.items()):
        rows.append((f"attachment {attached}", f"{len(data)} bytes, SHA-256 {hashlib.sha256(data).hexdigest()[:16]}…"))
    return TextTable.of(texts("value", "of this run"), rows, "Provenance", name=name)
