"""`los-testbed design certify` as a process: interrupts, resumption, what is kept; mistakes are said at once."""

from __future__ import annotations

import json
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from los_testbed.cli.app import main
from support.command_line import refused

import los_design

PROGRAM = """
import signal, sys
from los_testbed.cli.app import main
signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell that starts tests in the background ignores it
sys.exit(main())
"""
FIGURE = ["design", "certify", "--stage=fsm", "--figure=slow", "--workers=1"]


def started(output: Path, *options: str) -> subprocess.Popen[str]:
    command = [sys.executable, "-c", PROGRAM, *FIGURE, f"--output={output}", *options]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def parts(output: Path) -> dict[str, int]:
    """Parts that are kept, and when they were written."""
    return {p.name: p.stat().st_mtime_ns for p in output.glob("parts/*/*.npz") if not p.name.startswith(".")}


def wait_for(output: Path, count: int, process: subprocess.Popen[str]) -> None:
    end = time.monotonic() + 300.0
    while len(parts(output)) < count:
        assert process.poll() is None and time.monotonic() < end
        time.sleep(0.05)


def content(path: Path) -> dict[str, np.ndarray]:
    """Arrays of a part but for the processor time, which is in its summary."""
    with np.load(path, allow_pickle=False) as archive:
        found = {name: archive[name] for name in archive.files}
    summary = json.loads(bytes(found.pop("header")).decode())
    del summary["seconds"]
    return {**found, "summary": np.array(json.dumps(summary))}


@pytest.mark.slow
def test_it_goes_on_after_any_end(tmp_path: Path) -> None:
    """Ctrl-C, SIGTERM, SIGKILL: parts are whole and kept, and the same as those of a run that was left alone."""
    output = tmp_path / "proofs"
    kept: dict[str, int] = {}
    for count, (sent, code) in enumerate(
        [(signal.SIGINT, 130), (signal.SIGTERM, 130), (signal.SIGKILL, -signal.SIGKILL)], start=1
    ):
        process = started(output)
        wait_for(output, count, process)
        process.send_signal(sent)
        _, errors = process.communicate(timeout=600)
        assert process.returncode == code, errors
        if code == 130:
            assert errors.strip().splitlines()[-1].startswith("los-testbed: interrupted")
            assert "resume with: los-testbed design certify" in errors
            assert "Traceback" not in errors and not [p for p in output.rglob("*") if p.name.startswith(".")]
        now = parts(output)
        assert kept.items() <= now.items() and len(now) >= count  # none was made again
        kept = now
    alone = tmp_path / "alone"
    process = started(alone)
    wait_for(alone, len(kept), process)
    process.kill()
    process.communicate()
    (own,), (other,) = (list(folder.glob("parts/*")) for folder in (output, alone))
    assert own.name == other.name
    for name in kept:
        first, second = content(own / name), content(other / name)
        assert first.keys() == second.keys()
        for key in first:
            np.testing.assert_array_equal(first[key], second[key])


@pytest.mark.parametrize(
    ("options", "chosen"),
    [
        (["--figure=slow"], {("fsm", "slow"), ("fsm+pma", "slow")}),
        (["--figure=force"], {("fsm+pma", "force")}),
        (["--stage=fsm", "--figure=APE"], {("fsm", "APE")}),
    ],
)
def test_one_figure_is_chosen(tmp_path: Path, options: list[str], chosen: set[tuple[str, str]]) -> None:
    """Below a value that is known the answer needs no proof."""
    with pytest.raises(SystemExit) as stopped:
        main(["design", "certify", f"--output={tmp_path}", "--level=0.1", "--workers=1", *options])
    assert stopped.value.code == 7
    found = json.loads((tmp_path / "bounds.json").read_text("utf-8"))["figures"]
    assert {(entry["stage"], entry["figure"]) for entry in found} == chosen
    assert {entry["status"] for entry in found} == {"violated"}


def test_controllers_for_other_values_are_refused_before_the_work(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    """A telescope with another isolator beside the shipped pair; on its own telescope the pair is taken."""
    from los_design.synthesis.store import design_file

    designs, output = tmp_path / "designs", tmp_path / "new"
    designs.mkdir()
    for kind, name in (("k-fsm", "k_fsm.json"), ("k-pma", "k_pma.json")):
        shutil.copyfile(design_file(kind), designs / name)
    (designs / "telescope.toml").write_text("[isolator]\nmass = 1.6\n")
    shutil.copy(Path(los_design.__file__).parent / "search" / "worst_points.json", designs)
    options = ["--figure=slow", "--stage=fsm", "--level=0.1", "--workers=1", "--uncertain=isolator.stiffness=10%"]
    line = refused(capsys, "design", "certify", f"--designs={designs}", f"--output={output}", *options)
    assert "must be made for the telescope there, parameters_hash" in line and not output.exists()
    (designs / "telescope.toml").write_text('[uncertain]\n"isolator.stiffness" = 0.1\n')
    with pytest.raises(SystemExit) as stopped:
        main(["design", "certify", "--designs", str(designs), f"--output={output}", *options[:-1]])
    assert stopped.value.code == 7, "the table is the same as the option"
    shutil.rmtree(output)
    (designs / "telescope.toml").unlink()
    with pytest.raises(SystemExit) as stopped:
        main(["design", "certify", "--designs", str(designs), f"--output={output}", *options])
    assert stopped.value.code == 7, "violated: the level is below what is known"
    assert json.loads((output / "bounds.json").read_text("utf-8"))["figures"][0]["status"] == "violated"
