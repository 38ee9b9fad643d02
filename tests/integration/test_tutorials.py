"""The code and commands of tutorial and library pages run as printed; their results agree with the mechanics."""

from __future__ import annotations

import contextlib
import io
import json
import re
import shlex
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from los_testbed.cli.app import main
from scipy import linalg
from scipy.io import loadmat
from support.documented_commands import ROOT, blocks

from pointing_analysis.read.run import Run

TUNING = [pytest.param(f"lftkit/{name}.md", marks=pytest.mark.further) for name in ("quick_start", "examples")]
PAGE = ROOT / "docs/tutorial.md"
BLOCKS = ROOT / "docs/extend/a_spacecraft_from_blocks.md"

pytestmark = pytest.mark.usefixtures("without_pictures")


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


def printed_by(page: Path) -> tuple[str, dict[str, Any]]:
    """What the code of a page prints, and its names."""
    names: dict[str, Any] = {}
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed):
        exec("\n".join(blocks(page.read_text("utf-8"), "python")), names)
    return printed.getvalue(), names


@pytest.fixture(scope="module")
def spacecraft() -> dict[str, Any]:
    return printed_by(BLOCKS)[1]


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


@pytest.mark.parametrize(
    "page", ["extend/a_spacecraft_from_blocks.md", "lftkit/linear_systems.md", "lftkit/norms.md", *TUNING]
)
def test_the_output_is_the_one_on_the_page(page: str) -> None:
    path = ROOT / "docs" / page
    assert printed_by(path)[0] == "".join(blocks(path.read_text("utf-8"), "text"))


def section(title: str) -> str:
    """Text of a section of the tutorial, which begins with these words."""
    return next(part for part in re.split(r"^## ", PAGE.read_text("utf-8"), flags=re.M) if part.startswith(title))


def commands(title: str) -> list[list[str]]:
    found = blocks(section(title), "sh")
    return [shlex.split(line, comments=True)[1:] for block in found for line in block.splitlines()]


@pytest.mark.further
def test_own_controller_and_own_plant(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The observer reduces the slow motion to less than 35 %; without it the error is the motion itself."""
    names: dict[str, Any] = {}
    module, run, _ = blocks(section("Your own plant"), "python")
    (folder / "my_module.py").write_text(module)
    monkeypatch.syspath_prepend(folder)
    monkeypatch.delitem(sys.modules, "my_module", raising=False)
    exec("\n".join([*blocks(section("Your own controller"), "python"), run]), names)
    uncontrolled = names["SlowMotion"]()
    uncontrolled.reset()
    config = names["RunConfig"](duration=20.0, loop="isolator", mode="inprocess")
    names["run_in_process"](config, Path("open_bag"), plant=uncontrolled)
    peaks = [np.abs(Run.open(folder / bag)["truth/los"].values).max() for bag in ("my_bag", "open_bag")]
    assert peaks[1] == pytest.approx(2e-5, rel=1e-3)
    assert peaks[0] < 0.35 * peaks[1]


@pytest.mark.further
def test_a_measured_wheel_to_a_verdict(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Twice the record makes twice the error; the tones of the record are tones of the budget."""
    exec(blocks(section("Your wheel"), "python")[0], {})
    (folder / "twice.toml").write_text(blocks(section("Your wheel"), "toml")[0])
    runs = []
    for words in commands("Your wheel"):
        assert main([*words, "--no-report", "--json"]) == 0
        runs.append(json.loads(capsys.readouterr().out.splitlines()[-1]))
    once, open_loop, twice = (run["disturbances"][0] for run in runs)
    assert [run["loop"] for run in runs] == ["fsm+pma", "isolator", "fsm+pma"]
    assert all(run["requirements"] for run in runs)
    assert twice["rpe"] == pytest.approx(2.0 * once["rpe"], rel=1e-3)
    assert once["name"] == "bench_wheel" and once["place"] == "wheel_2" and open_loop["rpe"] != once["rpe"]


@pytest.mark.further
def test_a_mat_file_to_a_verdict(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The tone of 0.1 urad per axis and the noise: their relative error is known."""
    exec(blocks(section("Your .mat"), "python")[0], {})
    (folder / "mission.toml").write_text(blocks(section("Your .mat"), "toml")[0])
    (words,) = commands("Your .mat")
    assert main([*words, "--json"]) == 0
    run = json.loads(capsys.readouterr().out.splitlines()[-1])
    (verdict,) = run["requirements"]
    assert (verdict["name"], verdict["status"]) == ("jitter", "compliant")
    microradian = 1e-6 * 180 * 3600 * 1000 / 3.141592653589793  # [mas]
    expected = microradian * (2 * 0.1**2 / 2 + 2 * 0.08**2 * (1 - 1 / 128)) ** 0.5
    assert verdict["quantile"] == pytest.approx(expected, rel=0.25) and verdict["quantile"] > expected
    assert (folder / "verdict.html").stat().st_size > 10_000


@pytest.mark.further
def test_the_spacecraft_of_the_page_is_assembled(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (folder / "my_telescope.toml").write_text(blocks(section("Your spacecraft"), "toml")[0])
    (words,) = commands("Your spacecraft")
    assert main(words) == 0
    shown = capsys.readouterr().out
    assert "wing.omega_1" in shown and "order 170" in shown


@pytest.mark.slow
def test_a_spacecraft_to_its_controllers(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The commands of the page: all requirements are met. Four minutes of processor time."""
    (folder / "my_telescope.toml").write_text(blocks(section("Your spacecraft"), "toml")[0])
    for line in re.findall(r"^    (los-testbed .*)$", section("Your spacecraft"), flags=re.M):
        words = shlex.split(line)[1:]
        assert main([*words, "--no-report"] if words[0] == "run" else words) == 0, line
    shown = capsys.readouterr().out
    assert "within limit" in shown and (folder / "my_designs" / "verification.json").exists()


@pytest.mark.slow
def test_an_engineers_day(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Deck, wheel, requirements, design, verification, campaign, proof, report, export: every step of the page.

    Four minutes of processor time.
    """
    (line,) = re.findall(r"^    python TESTBED/(.*)$", PAGE.read_text("utf-8"), flags=re.M)
    words = shlex.split(line)
    subprocess.run([sys.executable, str(ROOT / words[0]), *words[1:]], check=True, capture_output=True)
    exec(blocks(section("An engineer's day"), "python")[0], {})
    exec(blocks(section("Your wheel"), "python")[0], {})
    (folder / "day.toml").write_text(blocks(section("An engineer's day"), "toml")[0])
    for words in commands("An engineer's day"):
        assert main(words) == 0, words
    assert (folder / "day.pdf").read_bytes().startswith(b"%PDF")
    exported = loadmat(folder / "day.mat")
    assert any("truth" in name for name in exported)
    assert json.loads((folder / "designs" / "verification.json").read_text("utf-8"))["not_met"] == []
    assert "proven" in capsys.readouterr().out
