"""Tables of a verification: gammas of each stage, its margins and noise, and the worst points."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from pointing_analysis.command.screen import met
from pointing_analysis.formatting.number_text import digits
from pointing_analysis.formatting.tables import TextTable, numbers, texts

MARGINS = (
    ("sensitivity", "largest sensitivity"),
    ("gain_db", "gain [dB]"),
    ("phase_deg", "phase [deg]"),
    ("delay_ms", "delay [ms]"),
)
NOISE = (("ape_arcsec_rms", "APE rms [arcsec]"), ("rpe_mas_rms", "RPE rms [mas]"))
"""Entries of a loop or stage in a verification, and the columns that show them."""
NAMES = {"fsm": ("APE", "RPE", "mirror"), "pma": ("APE", "RPE", "noise", "force")}
"""Requirements of the gammas of each stage."""


def verification_tables(title: str, implemented: Mapping[str, Any]) -> Iterator[TextTable]:
    """Tables of a verification.

    Parameters
    ----------
    title : str
        Of the first one.
    implemented : mapping
        As :class:`los_design.verification.verification.ImplementedCheck` is stored.
    """
    rows = [
        (stage, name, _number(gamma), met(isinstance(gamma, float) and gamma <= 1.0))
        for stage, names in NAMES.items()
        for name, gamma in zip(names, implemented.get(stage, ()))
    ]
    yield TextTable.of((*texts("stage", "requirement"), *numbers("gamma"), *texts("")), rows, title)
    for key, columns, first, heading in (
        ("margins", MARGINS, "loop", "Margins at the worst points"),
        ("noise", NOISE, "stage", "Sensor noise alone"),
    ):
        of_rows = {name: row for name, row in implemented.get(key, {}).items() if isinstance(row, Mapping)}
        cells = [(name, *(_number(row.get(entry)) for entry, _ in columns)) for name, row in of_rows.items()]
        if cells:
            yield TextTable.of((*texts(first), *numbers(*(head for _, head in columns))), cells, heading)
    if points := implemented.get("worst_point", {}):
        heads = (*texts("worst point"), *numbers("gamma", "at [rad/s]"), *texts("channel", "parameters"))
        cells = [
            (name, _number(p["gamma"]), _number(p["rad_s"]), p["channel"], _values(p["parameters"]))
            for name, p in points.items()
        ]
        yield TextTable.of(heads, cells, "Worst points")


def _number(value: Any) -> str:
    return digits(float(value)) if isinstance(value, int | float) else ""


def _values(parameters: Mapping[str, float]) -> str:
    return ", ".join(f"{name} {digits(value)}" for name, value in parameters.items())
