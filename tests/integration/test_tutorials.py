"""The tutorial's code runs as printed, its output is the printed one, and its results agree with the mechanics."""

from __future__ import annotations

import contextlib
import io
import re
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy import linalg

from pointing_analysis.read.run import Run

TUNING = [pytest.param(f"lftkit/{name}.md", marks=pytest.mark.further) for name in ("quick_start", "examples")]
PAGE = Path(__file__).parents[2] / "docs" / "tutorial.md"


BLOCKS = PAGE.parent / "extend" / "a_spacecraft_from_blocks.md"


def section(title: str) -> str:
    """Text of a section of the tutorial."""
    text = PAGE.read_text("utf-8")
    return next(part for part in re.split(r"^## ", text, flags=re.MULTILINE) if part.startswith(title))


def code(section: str) -> list[str]:
    return re.findall(r"```python\n(.*?)```", section, flags=re.DOTALL)


@pytest.fixture(scope="module")
def spacecraft() -> dict[str, Any]:
    names: dict[str, Any] = {}
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed):
        exec("\n".join(code(BLOCKS.read_text("utf-8"))), names)
    names["printed"] = printed.getvalue()
    return names


def test_the_output_is_the_one_on_the_page(spacecraft: dict[str, Any]) -> None:
    shown = re.findall(r"```text\n(.*?)```", BLOCKS.read_text("utf-8"), flags=re.DOTALL)[0]
    assert spacecraft["printed"] == shown


def coupled(names: dict[str, Any], omega_1: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Mass, damping, stiffness for hub motion (6), hinge angle, modes: kinematic elimination by hand."""
    boom, hub = names["boom"], names["hub_mass"]
    x, y, z = 0.2, 0.6, 0.1
    to_root = np.eye(6)
    to_root[:3, 3:] = -np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    root = np.column_stack([to_root, np.eye(6)[:, 5]])  # motion of the root by hub and hinge
    L, n = boom.participation, boom.n_modes
    rigid = root.T @ boom.mass_matrix @ root
    rigid[:6, :6] += hub
    M = np.block([[rigid, root.T @ L.T], [L @ root, np.eye(n)]])
    w = np.array([omega_1, *boom.frequencies[1:]])
    K = np.diag([*np.zeros(6), 3000.0, *w**2])
    D = np.diag([*np.zeros(6), 2.0, *2.0 * boom.damping * w])
    return M, D, K


@pytest.mark.parametrize("factor", [0.8, 1.0, 1.2])
def test_free_poles_are_those_of_the_coupled_equations(spacecraft: dict[str, Any], factor: float) -> None:
    value = factor * spacecraft["w1"]
    M, D, K = coupled(spacecraft, value)
    n = len(M)
    A = np.block([[np.zeros((n, n)), np.eye(n)], [-linalg.solve(M, K), -linalg.solve(M, D)]])
    theirs = np.array([p for p in linalg.eigvals(A) if abs(p) > 1.0])
    ours = linalg.eigvals(spacecraft["free"].at({"boom.omega_1": value}).A)
    assert ours.size == theirs.size == 14
    for pole in theirs:
        assert np.abs(ours - pole).min() < 1e-9 * abs(pole)


@pytest.mark.further
def test_own_controller_and_own_plant(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The observer reduces the slow motion to less than 35 %; without it the error is the motion itself."""
    monkeypatch.chdir(tmp_path)
    names: dict[str, Any] = {}
    module, run, _ = code(section("Your own plant"))
    (tmp_path / "my_module.py").write_text(module)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "my_module", raising=False)
    exec("\n".join([*code(section("Your own controller")), run]), names)
    uncontrolled = names["SlowMotion"]()
    uncontrolled.reset()
    config = names["RunConfig"](duration=20.0, loop="isolator", mode="inprocess")
    names["run_in_process"](config, Path("open_bag"), plant=uncontrolled)
    peaks = []
    for folder in ("my_bag", "open_bag"):
        truth = Run.open(tmp_path / folder)["truth/los"]
        peaks.append(np.abs(truth.values).max())
    assert peaks[1] == pytest.approx(2e-5, rel=1e-3)
    assert peaks[0] < 0.35 * peaks[1]


def printed_and_shown(page: str) -> tuple[str, str]:
    text = (PAGE.parent / page).read_text("utf-8")
    found = io.StringIO()
    with contextlib.redirect_stdout(found):
        exec("\n".join(code(text)), {})
    return found.getvalue(), "".join(re.findall(r"```text\n(.*?)```", text, flags=re.DOTALL))


@pytest.mark.parametrize("page", ["lftkit/linear_systems.md", "lftkit/norms.md", *TUNING])
def test_the_output_of_the_pages_of_the_library(page: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    printed, shown = printed_and_shown(page)
    assert printed == shown
