"""The benchmark of two masses and a spring: twelve lines of code, and the margin that is printed elsewhere."""

from __future__ import annotations

import ast
import runpy
from pathlib import Path

import pytest

EXAMPLE = Path(__file__).parents[2] / "examples/two_mass_spring_benchmark.py"


def test_the_benchmark_takes_twelve_lines_and_finds_the_published_margin(capsys: pytest.CaptureFixture[str]) -> None:
    """Manual of the Robust Control Toolbox, as docs/certificates.md: 2.8826 to 2.8864, critical at 575.0339 rad/s."""
    body = ast.parse(EXAMPLE.read_text("utf-8")).body[1:]  # without the docstring
    assert sum(int(n.end_lineno or 0) - n.lineno + 1 for n in body) <= 12
    found = runpy.run_path(str(EXAMPLE))
    assert found["plant"].occurrences() == {"m1": 1, "k": 1, "m2": 1} and found["plant"].order == 4
    bounds = found["bounds"]
    assert bounds.status == "closed" and 2.8 < bounds.lower <= 2.8864
    assert bounds.upper == pytest.approx(2.8864, abs=5e-5) and bounds.frequency == pytest.approx(575.0339, abs=1e-4)
    at = {name: float(v) for name, v in bounds.point.items()}
    crossing = found["loop"].at(at, beyond_range=True).poles()
    assert abs(crossing.real[abs(crossing.imag - 575.03) < 1]).max() < 1e-3 * 575
    assert "proof checked: True" in capsys.readouterr().out
