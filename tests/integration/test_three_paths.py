"""The day and the paths of the tutorial run as printed, with the files that the page makes; designs are slow tests."""

from __future__ import annotations

import json
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest
from los_testbed.cli.app import main
from scipy import io

pytestmark = pytest.mark.usefixtures("without_pictures")

PAGE = Path(__file__).parents[2] / "docs" / "tutorial.md"


def blocks(section: str, language: str) -> list[str]:
    """Blocks of a section of the page, which begins with these words."""
    text = next(part for part in re.split(r"^## ", PAGE.read_text("utf-8"), flags=re.M) if part.startswith(section))
    if language == "indented":
        return re.findall(r"^    (los-testbed .*)$", text, flags=re.M)
    return re.findall(rf"^```{language}\n(.*?)^```", text, flags=re.DOTALL | re.M)


def commands(section: str) -> list[list[str]]:
    return [shlex.split(line, comments=True)[1:] for block in blocks(section, "sh") for line in block.splitlines()]


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_a_measured_wheel_to_a_verdict(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Twice the record makes twice the error; the tones of the record are tones of the budget."""
    exec(blocks("Your wheel", "python")[0], {})
    (folder / "twice.toml").write_text(blocks("Your wheel", "toml")[0])
    runs = []
    for words in commands("Your wheel"):
        assert main([*words, "--no-report", "--json"]) == 0
        runs.append(json.loads(capsys.readouterr().out.splitlines()[-1]))
    once, open_loop, twice = (run["disturbances"][0] for run in runs)
    assert [run["loop"] for run in runs] == ["fsm+pma", "isolator", "fsm+pma"]
    assert all(run["requirements"] for run in runs)
    assert twice["rpe"] == pytest.approx(2.0 * once["rpe"], rel=1e-3)
    assert once["name"] == "bench_wheel" and once["place"] == "wheel_2" and open_loop["rpe"] != once["rpe"]


def test_a_mat_file_to_a_verdict(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The tone of 0.1 urad per axis and the noise: their relative error is known."""
    exec(blocks("Your .mat", "python")[0], {})
    (folder / "mission.toml").write_text(blocks("Your .mat", "toml")[0])
    (words,) = commands("Your .mat")
    assert main([*words, "--json"]) == 0
    run = json.loads(capsys.readouterr().out.splitlines()[-1])
    (verdict,) = run["requirements"]
    assert (verdict["name"], verdict["status"]) == ("jitter", "compliant")
    microradian = 1e-6 * 180 * 3600 * 1000 / 3.141592653589793  # [mas]
    expected = microradian * (2 * 0.1**2 / 2 + 2 * 0.08**2 * (1 - 1 / 128)) ** 0.5
    assert verdict["quantile"] == pytest.approx(expected, rel=0.25) and verdict["quantile"] > expected
    assert (folder / "verdict.html").stat().st_size > 10_000


def test_the_spacecraft_of_the_page_is_assembled(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (folder / "my_telescope.toml").write_text(blocks("Your spacecraft", "toml")[0])
    (words,) = commands("Your spacecraft")
    assert main(words) == 0
    shown = capsys.readouterr().out
    assert "wing.omega_1" in shown and "order 170" in shown


@pytest.mark.slow
def test_a_spacecraft_to_its_controllers(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The commands of the page: all requirements are met. Four minutes of processor time."""
    (folder / "my_telescope.toml").write_text(blocks("Your spacecraft", "toml")[0])
    for line in blocks("Your spacecraft", "indented"):
        words = shlex.split(line)[1:]
        assert main([*words, "--no-report"] if words[0] == "run" else words) == 0, line
    shown = capsys.readouterr().out
    assert "within limit" in shown and (folder / "my_designs" / "verification.json").exists()


@pytest.mark.slow
def test_an_engineers_day(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Deck, wheel, requirements, design, verification, campaign, proof, report, export: every step of the page.

    Four minutes of processor time.
    """
    root = Path(__file__).parents[2]
    (line,) = re.findall(r"^    python TESTBED/(.*)$", PAGE.read_text("utf-8"), flags=re.M)
    words = shlex.split(line)
    subprocess.run([sys.executable, str(root / words[0]), *words[1:]], check=True, capture_output=True)
    exec(blocks("An engineer's day", "python")[0], {})
    exec(blocks("Your wheel", "python")[0], {})
    (folder / "day.toml").write_text(blocks("An engineer's day", "toml")[0])
    for words in commands("An engineer's day"):
        assert main(words) == 0, words
    assert (folder / "day.pdf").read_bytes().startswith(b"%PDF")
    exported = io.loadmat(folder / "day.mat")
    assert any("truth" in name for name in exported)
    assert json.loads((folder / "designs" / "verification.json").read_text("utf-8"))["not_met"] == []
    assert "proven" in capsys.readouterr().out
