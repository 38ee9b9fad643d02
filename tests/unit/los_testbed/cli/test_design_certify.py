"""`design certify`, `check-proof`, `all`, `verify`: interrupts, what is kept and goes on, proofs that are refused."""

from __future__ import annotations

import json
import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from los_testbed.cli import app
from los_testbed.cli.app import main
from support.command_line import call_command, refused
from support.uncertain_examples import aligned_modes

import los_design
from lftkit.proofs import BoundOptions, robust_stability
from los_design.verification import shipped_proofs, stage_check

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
    """Without time nothing is proven."""
    with pytest.raises(SystemExit) as stopped:
        main(["design", "certify", f"--output={tmp_path}", "--time-limit=1", "--workers=1", *options])
    assert stopped.value.code == 8
    found = json.loads((tmp_path / "bounds.json").read_text("utf-8"))["figures"]
    assert {(entry["stage"], entry["figure"]) for entry in found} == chosen
    assert {entry["status"] for entry in found} == {"open"}


def test_controllers_for_other_values_are_refused_before_the_work(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    """A telescope with another isolator beside the shipped pair; on its own telescope the pair is taken."""
    from los_design.synthesis.store import design_file

    designs, output = tmp_path / "designs", tmp_path / "new"
    designs.mkdir()
    for kind, name in (("k-fsm", "k_fsm.json"), ("k-pma", "k_pma.json")):
        shutil.copyfile(design_file(kind), designs / name)
    (designs / "telescope.toml").write_text("base = 'reference'\n[isolator]\nmass = 1.6\n")
    shutil.copy(Path(los_design.__file__).parent / "search" / "worst_points.json", designs)
    options = ["--figure=slow", "--stage=fsm", "--time-limit=1", "--workers=1", "--uncertain=isolator.stiffness=10%"]
    line = refused(capsys, "design", "certify", f"--designs={designs}", f"--output={output}", *options)
    assert "must be made for the telescope there, parameters_hash" in line and not output.exists()
    (designs / "telescope.toml").write_text('base = "reference"\n[uncertain]\n"isolator.stiffness" = 0.1\n')
    with pytest.raises(SystemExit) as stopped:
        main(["design", "certify", "--designs", str(designs), f"--output={output}", *options[:-1]])
    assert stopped.value.code == 8, "the table is the same as the option"
    shutil.rmtree(output)
    (designs / "telescope.toml").unlink()
    with pytest.raises(SystemExit) as stopped:
        main(["design", "certify", "--designs", str(designs), f"--output={output}", *options])
    assert stopped.value.code == 8, "there was no time"
    assert json.loads((output / "bounds.json").read_text("utf-8"))["figures"][0]["status"] == "open"


Content = dict[str, Any]

PROOFS = Path(__file__).parents[3] / "fixtures" / "proofs"

PLACE = shipped_proofs.FOLDER


@pytest.fixture(scope="module")
def proof() -> Content:
    bounds = robust_stability(aligned_modes(2, damping=0.02), options=BoundOptions(wall_limit=3600.0))
    assert bounds.proof is not None
    return bounds.proof.content


def test_the_command_checks_a_file(proof: Content, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "proof.json"
    for content, expected, text in (
        (proof, 0, "proven: stable"),
        ({**proof, "stable": None}, 1, "refused: the content must match"),
    ):
        path.write_text(json.dumps(content), "utf-8")
        code, out, err = call_command(capsys, "design", "check-proof", path)
        assert code == expected and text in out + err


@pytest.mark.parametrize(
    ("name", "text", "not_text"),
    [
        ("gain_of_an_unstable_system", "\nnot proven: stable", "\nproven: stable"),
        (
            "name_like_an_interval",
            'for all "stiffness in [0, 1e+09], x" in [0.8, 1.2]',
            "for all stiffness in [0, 1e+09]",
        ),
    ],
)
def test_what_a_proof_does_not_say_is_not_printed(
    name: str, text: str, not_text: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """A gain whose file claims no stability, of a system that is unstable; a name that continues like an interval."""
    assert main(["design", "check-proof", str(PROOFS / f"{name}.json")]) == 0
    shown = capsys.readouterr().out
    assert text in shown and not_text not in shown


def test_without_a_file_the_shipped_proofs_are_checked(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """One of them here; where they are not installed, or damaged, one line says so."""
    (name,) = (file.name for file in shipped_proofs.FOLDER.glob("*fast, 126 to*"))
    assert len(list(shipped_proofs.FOLDER.iterdir())) == 18
    monkeypatch.setattr(shipped_proofs, "FOLDER", tmp_path)
    with pytest.raises(SystemExit, match="2"):
        main(["design", "check-proof"])
    (line,) = capsys.readouterr().err.strip().splitlines()
    assert f"must be in {tmp_path}, got none" in line
    stored = (PLACE / name).read_bytes()
    (tmp_path / name).write_bytes(stored[:-1000])
    with pytest.raises(SystemExit, match="1"):
        main(["design", "check-proof"])
    assert capsys.readouterr().err.startswith(f"refused: {name} must be a stored proof, got ")
    (tmp_path / name).write_bytes(stored)
    assert main(["design", "check-proof"]) == 0
    assert re.search(
        r"^proven: fsm\+pma, .* of the limit, from 126 to 128.5 rad/s$", capsys.readouterr().out, re.MULTILINE
    )
    with pytest.raises(SystemExit, match="2"):
        main(["design", "check-proof", "--designs", str(tmp_path)])


COMMAND = """
import sys
from los_design.synthesis import synthesis
from los_design.synthesis.rounds import Effort
from los_design.search.worst_case_search import SearchOptions
from los_testbed.cli.app import main

search = SearchOptions(frequencies=40, points=8, ascents=4, iterations=2, patience=0)
synthesis.SHORT_EFFORT = Effort(rounds=1000, points=1, first=6, iterations=6, target=0.8, searches=(search,))
sys.exit(main(["design", "all", "--effort", "short", "--workers", "2", "--output", sys.argv[1]]))
"""

"""The command with a design of small effort: rounds that do not end within a minute, because nothing is below 0.8."""


def designing(folder: Path) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-c", COMMAND, str(folder)],
        text=True,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        env={**os.environ, "LOS_TESTBED_QUIET": ""},  # the lines of rounds say when to interrupt
        start_new_session=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
    )


def until_line(process: subprocess.Popen[str], text: str) -> None:
    assert process.stderr is not None
    for line in process.stderr:
        if line.startswith(text):
            return
    pytest.fail(f"the command ended without a line {text!r}, code {process.wait()}")


def members(session: int) -> list[int]:
    """Living processes of a session."""
    found = []
    for path in Path("/proc").glob("[0-9]*/stat"):
        try:
            fields = path.read_text().rsplit(")", 1)[1].split()
        except OSError:
            continue
        if int(fields[3]) == session and fields[0] != "Z":
            found.append(int(path.parent.name))
    return found


@pytest.mark.slow
def test_an_interrupted_design_ends_at_once_and_goes_on(tmp_path: Path) -> None:
    """The second round is interrupted, with worker processes of the first one's search; then the continued design."""
    process = designing(tmp_path)
    until_line(process, "round 2, step")
    assert len(members(process.pid)) >= 3, "this process and two workers"
    end_by_interrupt(process)
    assert [p.name for p in tmp_path.iterdir()] == ["rounds.json"]
    number = json.loads((tmp_path / "rounds.json").read_text())["state"]["number"]

    again = designing(tmp_path)
    until_line(again, f"goes on after {number} rounds")
    until_line(again, f"round {number + 1}:")
    end_by_interrupt(again)
    assert json.loads((tmp_path / "rounds.json").read_text())["state"]["number"] > number


def end_by_interrupt(process: subprocess.Popen[str]) -> None:
    """Code 130, one line beside those of the rounds, and no process left."""
    process.send_signal(signal.SIGINT)
    errors = process.communicate(timeout=600)[1].splitlines()
    assert process.returncode == 130
    told = [line for line in errors if not line.startswith(("round ", "design: "))]
    assert told[0].startswith("rounds and designs so far are stored") and told[1:] == ["los-testbed: interrupted"]
    until = time.monotonic() + 60.0
    while members(process.pid) and time.monotonic() < until:
        time.sleep(0.05)
    assert members(process.pid) == []


SMALL = Path(__file__).parents[4] / "examples" / "spacecraft" / "small_telescope"


@pytest.mark.further
def test_an_interrupted_verification_goes_on_and_gives_the_same(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    file, parts = tmp_path / "check.json", tmp_path / "check.json.parts"
    command = ["design", "verify", "--designs", str(SMALL), "--samples", "0", "--workers", "1", "--output", str(file)]
    computed = {"_swept": 0, "_looked_closely": 0}

    def counted(name: str, last: int) -> None:
        """Count the calls of a part of the work; the one after the last is an interrupt."""
        make = getattr(stage_check, name)

        def part(*arguments: Any) -> Any:
            if computed[name] == last:
                raise KeyboardInterrupt
            computed[name] += 1
            return make(*arguments)

        monkeypatch.setattr(stage_check, name, part)

    with monkeypatch.context():
        counted("_swept", 5)
        with pytest.raises(SystemExit) as ended:
            app.main(command)
    assert ended.value.code == 130 and parts.exists() and not file.exists()
    assert f"finished parts are stored; resume with: los-testbed {shlex.join(map(str, command))}" in (
        capsys.readouterr().err
    )
    monkeypatch.undo()
    counted("_swept", -1)
    counted("_looked_closely", 2)
    computed["_swept"] = 0
    with pytest.raises(SystemExit) as ended:
        app.main(command)
    assert ended.value.code == 130 and computed["_swept"] == stage_check.BLOCKS - 5
    assert f"5 parts are read from {parts}" in capsys.readouterr().err
    monkeypatch.undo()
    app.main(command)
    assert f"{stage_check.BLOCKS + 2} parts are read from {parts}" in capsys.readouterr().err
    assert not parts.exists()
    whole = tmp_path / "whole.json"
    app.main([*command[:-1], str(whole)])
    assert whole.read_bytes() == file.read_bytes()
