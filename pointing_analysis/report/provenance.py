"""Provenance of the runs of a report: digest, settings and attachments of their recordings."""

from __future__ import annotations

import hashlib
from typing import Any

from pointing_analysis.formatting.tables import TextTable, texts
from pointing_analysis.read.mcap.bag_files import bag_files, files_digest
from pointing_analysis.read.recording import Recording

HASH_LIMIT = 2_000_000_000
"""Size of a bag [byte] from which its digest is not computed for the report."""


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
