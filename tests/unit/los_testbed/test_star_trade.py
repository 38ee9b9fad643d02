"""Guide stars against pointing: the command, its parameter files, its mistakes."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from los_testbed.cli.app import main
from los_testbed.run.star_trade import markdown, parameter_text

from titop_plant.telescope.parameters import load_parameters


def test_a_parameter_file_keeps_what_the_user_wrote(tmp_path: Path) -> None:
    """Nested tables, lists of tables, and a file beside it, whose name becomes the whole path."""
    (tmp_path / "beam.toml").write_text("x = 1\n", "utf-8")
    own = {
        "sensors": {"washout": 0.2},
        "camera": {"read_noise": 5.0, "magnitude": 9.0},
        "requirement": [{"name": "RPE, mine", "text": "prob(|RPE(20 ms)| < 1 arcsec) >= 0.9 at 90 % confidence"}],
        "body": {"damping": 0.004},
    }
    file = tmp_path / "star.toml"
    file.write_text(parameter_text(own, tmp_path, 12.5, 0.04), "utf-8")
    found = load_parameters(file)
    assert found["sensors"]["washout"] == 0.2 and found["sensors"]["camera"] == "image"
    assert (found["camera"]["magnitude"], found["camera"]["exposure"]) == (12.5, 0.04)
    assert found["camera"]["read_noise"] == 5.0 and found["body"]["damping"] == 0.004
    assert "RPE, mine" in [row["name"] for row in found["requirement"]]
    assert str(tmp_path / "beam.toml") in parameter_text({"a": {"b": "beam.toml"}}, tmp_path, 1.0, 0.02)


def test_a_table_counts_frames_that_the_star_did_not_give() -> None:
    row = {
        "magnitude": 15.5,
        "rate_hz": 50.0,
        "noise_mas": 7.66,
        "frames": 200,
        "without_angles": {"before_start": 2, "no_star": 40, "not_a_star": 4},
        "failure": "",
        "ape_arcsec": 1.5,
        "rpe_mas": 29.8,
        "mtf_nyquist": 0.5,
        "strehl": None,
    }
    assert markdown([row]).splitlines()[-1] == "| 15.5 | 50 | 7.66 | 44 of 200 | 1.5 | 29.8 | 0.5 | - |"


def test_one_command_makes_table_and_picture(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = tmp_path / "trade"
    arguments = ["--magnitudes", "10,25", "--rates", "50", "--duration", "1", "--scenario", "imbalance", "--json"]
    main(["image", "trade", *arguments, "--output", str(folder)])
    rows = json.loads(capsys.readouterr().out.splitlines()[-1])["trade"]
    bright, none = rows
    assert (bright["magnitude"], none["magnitude"]) == (10.0, 25.0)
    assert bright["frames"] == 50 and bright["without_angles"] == {"before_start": 2}
    assert sum(none["without_angles"].values()) == 50
    assert 0.0 < bright["mtf_nyquist"] < 1.0 and bright["rpe_mas"] > 0.0
    assert json.loads((folder / "trade.json").read_text()) == rows
    assert (folder / "trade.png").read_bytes().startswith(b"\x89PNG")
    assert len((folder / "trade.md").read_text().splitlines()) == 4


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--magnitudes", "a,b"], "--magnitudes must be numbers with commas between them, got 'a,b'"),
        (["--rates", "30"], "must divide 1000 Hz"),
        (["--rates", "0"], "rates must be positive, got 0 Hz"),
        (["--magnitudes", "120"], "camera.magnitude must be above -30 and below 99, got 120.0"),
    ],
)
def test_a_mistake_is_one_line(
    arguments: list[str], message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["image", "trade", *arguments, "--duration", "1", "--output", str(tmp_path / "trade")])
    error = capsys.readouterr().err
    assert ended.value.code == 2 and message in error and len(error.strip().splitlines()) == 1
    assert not (tmp_path / "trade").exists()
