"""`los-testbed design certify` as a process: interrupts, resumption, what is kept; mistakes are said at once."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from los_testbed.cli.app import main

import los_design
from los_design.synthesis.options import DesignOptions

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
        _, errors = process.communicate(timeout=60)
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


@pytest.mark.slow
def test_a_full_disk_is_one_line_and_leaves_whole_parts(tmp_path: Path) -> None:
    """A limit of the file size in place of the disk: writing fails in the midst of a part."""
    output = tmp_path / "proofs"
    limited = "import resource; resource.setrlimit(resource.RLIMIT_FSIZE, (4000, 4000))\n"
    limited += "signal.signal(signal.SIGXFSZ, signal.SIG_IGN)\n"
    program = PROGRAM.replace("sys.exit", limited + "sys.exit")
    process = subprocess.run(
        [sys.executable, "-c", program, *FIGURE, f"--output={output}"], capture_output=True, text=True, timeout=300
    )
    assert process.returncode == 1
    assert process.stderr.strip().splitlines()[-1].startswith("los-testbed: ") and "Traceback" not in process.stderr
    assert not parts(output) and not list(output.rglob("*.npz*"))


@pytest.mark.slow
def test_out_of_time_says_what_is_open(tmp_path: Path) -> None:
    """The wall limit ends it; bounds.json has the lower bound, no upper one, and the part that is not covered."""
    process = started(tmp_path, "--time-limit=1")
    _, errors = process.communicate(timeout=300)
    assert process.returncode == 8, errors
    (found,) = json.loads((tmp_path / "bounds.json").read_text("utf-8"))["figures"]
    assert found["status"] == "open" and found["upper"] is None and found["proof"] is None and not found["stable"]
    assert 0.43 < found["lower"] < 0.44 and found["uncovered"]
    assert "time limit: 0 of 1 figures proven; run again to resume" in errors
    assert not list(tmp_path.glob("*.npz"))


@pytest.mark.slow
def test_a_design_goes_on_with_its_proofs_until_the_time_is_over(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """With the stored pair in place of a design of minutes, which took all the time."""
    from los_testbed.cli.designs import redesign as commands

    from los_design import redesign
    from los_design.synthesis.store import load_designs
    from los_design.verification.loop_models import figures_of
    from titop_plant.interface import MIRROR_STAGES
    from titop_plant.telescope.load import load_telescope

    limits = []

    def stored(telescope: Any, folder: Path, options: DesignOptions, **_: object) -> SimpleNamespace:
        limits.append(options.wall_limit)
        for name, system in zip(("k_fsm.json", "k_pma.json"), load_designs("implemented")):
            system.to_file(folder / name)
        shutil.copy(Path(redesign.__file__).parent / "search" / "worst_points.json", folder)
        time.sleep(options.wall_limit / commands.ROUNDS_OF_ALL + 0.1)
        return SimpleNamespace(check=SimpleNamespace(to_mapping=dict), not_met=[])

    monkeypatch.setattr(redesign, "design_all", stored)
    with pytest.raises(SystemExit) as stopped:
        main(["design", "all", f"--output={tmp_path}", "--certify", "--time-limit=1", "--json", "--workers=1"])
    told = capsys.readouterr()
    found = json.loads(told.out)["figures"]
    assert stopped.value.code == 8 and limits == [commands.ROUNDS_OF_ALL]
    wanted = [(stage, name) for stage in MIRROR_STAGES for name in figures_of(load_telescope(), stage)]
    assert [(f["stage"], f["figure"]) for f in found] == wanted
    assert {f["status"] for f in found} == {"open"}
    assert f"time limit: 0 of {len(wanted)} figures proven; run again to resume" in told.err
    assert not (tmp_path / "bundle.zip").exists()


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


def refused(capsys: pytest.CaptureFixture[str], *options: str) -> str:
    with pytest.raises(SystemExit) as stopped:
        main(["design", "certify", *options])
    assert stopped.value.code == 2
    lines = capsys.readouterr().err.strip().splitlines()
    assert len(lines) == 1 and lines[0].startswith("los-testbed: ")
    return lines[0]


def test_unknown_stages_and_figures_are_refused(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    out = f"--output={tmp_path / 'new'}"
    assert "--stage" in refused(capsys, out, "--stage=isolator")
    assert "--figure" in refused(capsys, out, "--figure=heat")
    assert "--figure" in refused(capsys, out, "--stage=fsm", "--figure=force")
    assert "--level" in refused(capsys, out, "--level=0")
    assert "tls_ca_file" in refused(capsys, out, "--scheduler=tcp://127.0.0.1:1", "--tls-ca-file=ca.pem").replace(
        "-", "_"
    )
    assert "--gap" in refused(capsys, out, "--gap=nan")
    assert "--time-limit" in refused(capsys, out, "--time-limit=-1")
    assert not (tmp_path / "new").exists()


def test_outputs_that_can_not_be_are_refused(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    file = tmp_path / "file"
    file.write_text("kept")
    assert "--output" in refused(capsys, f"--output={file}")
    assert file.read_text() == "kept"
    assert "--output" in refused(capsys, f"--output={file / 'below'}")
    (tmp_path / "bounds.json").write_text("not a summary")
    assert "bounds.json" in refused(capsys, f"--output={tmp_path}")
    assert (tmp_path / "bounds.json").read_text() == "not a summary"


def test_folders_without_the_controllers_are_refused(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    out = f"--output={tmp_path / 'new'}"
    assert "k_fsm.json" in refused(capsys, f"--designs={tmp_path / 'none'}", out)
    (tmp_path / "empty").mkdir()
    assert "k_fsm.json" in refused(capsys, f"--designs={tmp_path / 'empty'}", out)
    (tmp_path / "bad").mkdir()
    for name in ("k_fsm.json", "k_pma.json"):
        (tmp_path / "bad" / name).write_text("{}")
    assert refused(capsys, f"--designs={tmp_path / 'bad'}", out)
    assert not (tmp_path / "new").exists()


def test_controllers_of_another_size_are_refused(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    """The two files exchanged: K_FSM has not the ports of K_PMA."""
    from los_design.synthesis.store import design_file

    folder = tmp_path / "designs"
    folder.mkdir()
    shutil.copyfile(design_file("k-fsm"), folder / "k_pma.json")
    shutil.copyfile(design_file("k-pma"), folder / "k_fsm.json")
    assert "inputs must be" in refused(capsys, f"--designs={folder}", f"--output={tmp_path / 'new'}")


def test_controllers_of_another_telescope_are_refused(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    """Another sensitivity of the mirror than that of their design."""
    from los_design.synthesis.store import design_file

    for kind, name in (("k-fsm", "k_fsm.json"), ("k-pma", "k_pma.json")):
        shutil.copyfile(design_file(kind), tmp_path / name)
    (tmp_path / "telescope.toml").write_text("[fsm]\nlos_sensitivity = 0.2\n")
    assert "los_sensitivity" in refused(capsys, f"--designs={tmp_path}", f"--output={tmp_path / 'new'}")


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
    line = refused(capsys, f"--designs={designs}", f"--output={output}", *options)
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


def test_proofs_that_are_no_proofs_are_refused(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    for name, data in (("a.npz", b""), ("b.npz", os.urandom(300)), ("c.json", b"{}"), ("d.json", b"[1, 2]")):
        (tmp_path / name).write_bytes(data)
        with pytest.raises(SystemExit) as stopped:
            main(["design", "check-proof", str(tmp_path / name)])
        assert stopped.value.code == 1
        assert capsys.readouterr().err.startswith("refused: ")
    with pytest.raises(SystemExit) as stopped:
        main(["design", "check-proof", str(tmp_path / "none.npz")])
    assert stopped.value.code == 2
    assert "none.npz" in capsys.readouterr().err
