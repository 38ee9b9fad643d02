"""The command line: runs, analyses and reports; a mistake is one line and exit code 2, and leaves nothing behind."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from command_line import CommandLine, refused
from los_testbed.cli.environment import TRACEBACK
from los_testbed.cli.run import configure
from los_testbed.parts.run_parts import RunParts
from simple_telescope import SimpleTelescope, write_controllers

from pointing_analysis.command.exit_codes import ExitCode
from pointing_analysis.command.recordings import require_different
from pointing_analysis.indices.synthetic import write_bag

pytestmark = pytest.mark.usefixtures("without_pictures")


@pytest.fixture
def run(tmp_path, monkeypatch, capsys):
    """The command line with the small telescope."""

    def plant(parts, recorded):
        config = parts.config
        return SimpleTelescope(config.frame_ticks, config.seed, config.noise, config.camera_dropout)

    monkeypatch.setattr(RunParts, "plant", plant)
    files = tmp_path / "files"
    files.mkdir()
    controllers = [f"--{name.replace('_', '-')}={path}" for name, path in write_controllers(files).items()]
    return replace(CommandLine.below(tmp_path, monkeypatch, capsys), files=files, controllers=controllers)


def test_analyse_gives_the_figures_again(run):
    _, out, _ = run("run", "--mode=inprocess", "--duration=2", "--output=b", "--json", *run.controllers)
    first = json.loads(out.splitlines()[-1])
    code, out, _ = run("analyse", "b", "--json")
    assert code == 0
    assert json.loads(out.splitlines()[-1]) == first
    run("run", "--mode=inprocess", "--duration=2", "--seed=9", "--no-report", "--output=c", *run.controllers)
    code, out, _ = run("analyse", "b", "c", "--json", "--output=two.html")
    assert code == 0
    assert len(json.loads(out.splitlines()[-1])["runs"]) == 2
    assert (run.here / "two.html").exists()


def test_a_gate_has_a_code_for_a_requirement_that_is_not_met_and_one_that_is_not_demonstrated(run, tmp_path):
    """A limit that is always kept is demonstrated for half of the time, and not for all but 1e-4 of it."""
    base = ("run", "--mode=inprocess", "--no-report", "--gate", "--loop=fsm", "--scenario=unit_norm")
    code, _, err = run(*base, "--duration=4", "--output=bag")
    assert code == 7 and "gate: not met: " in err
    for limit, part, expected in (("1e-6 mas", 50, 7), ("1000 arcsec", 50, 0), ("1000 arcsec", 99.99, 8)):
        own = tmp_path / "own.toml"
        own.write_text(f'[[requirement]]\ntext = "prob(rms RPE(20 ms) < {limit}) >= {part} % at 95 % confidence"\n')
        code, _, err = run("analyse", "bag", f"--requirements={own}", "--gate")
        assert (code, "gate: not" in err) == (expected, expected != 0), err
    assert run("analyse", "bag", f"--requirements={own}")[0] == 0
    assert run("report", "bag", f"--requirements={own}", "--gate")[0] == 8


def test_options_of_all_commands_may_stand_anywhere(run, tmp_path):
    log = tmp_path / "los.log"
    code, _, err = run("analyse", "absent.csv", "--quiet", "--log", str(log))
    assert code == 2 and err in log.read_text() and len(log.read_text().splitlines()) == 1
    assert run("--quiet", "analyse", "absent.csv")[0] == 2


def test_verbose_shows_where_an_error_that_no_check_has_foreseen_came_from(run, monkeypatch):
    monkeypatch.setenv(TRACEBACK, "")  # put back at the end, whatever the option makes of it
    monkeypatch.setattr(RunParts, "check", lambda parts: {}["absent"])  # type: ignore[index]
    code, _, short = run("run", "--mode=inprocess", "--duration=1", *run.controllers)
    assert code == ExitCode.FAILED and "unexpected KeyError" in short and len(short.splitlines()) == 1
    code, _, long = run("run", "--verbose", "--mode=inprocess", "--duration=1", *run.controllers)
    assert code == ExitCode.FAILED and "Traceback" in long and long.splitlines()[-1] == short.strip()


def test_a_value_error_of_an_operation_is_no_mistake_of_the_user(run, monkeypatch):
    """Shapes that do not fit, a text that numpy cannot read: nothing that was given is to blame."""
    for fault in (lambda parts: np.zeros(3) + np.zeros(4), lambda parts: int("three"), lambda parts: json.loads("{")):
        monkeypatch.setattr(RunParts, "check", fault)
        code, _, error = run("run", "--mode=inprocess", "--duration=1", *run.controllers)
        assert code == ExitCode.FAILED and "unexpected " in error and "(a bug: please report it)" in error


MAS = np.pi / 648_000_000

RNG = np.random.default_rng(0)


@pytest.fixture
def report(tmp_path, monkeypatch, capsys):
    return CommandLine.below(tmp_path, monkeypatch, capsys, "report")


def los(seconds: float, scale: float = 5.0) -> np.ndarray:
    return scale * MAS * RNG.standard_normal((round(1000 * seconds), 2))


def test_what_the_run_said_beside_its_verdict_is_said_again(report, tmp_path) -> None:
    """As `run` and `analyse` do; of several bags with the name of the one that it is of."""
    told, quiet = (
        write_bag(tmp_path / name, {"truth/los": los(3)}, parameters={"loop": name, **more})
        for name, more in (("fsm", {"start_note": "no start <is> known"}), ("isolator", {}))
    )
    code, out, _ = report(told, "--output", "one.html")
    assert code == 0 and "note: no start <is> known" in out
    assert "no start &lt;is&gt; known" in (report.here / "one.html").read_text()
    code, out, _ = report(told, quiet, "--output", "two.html")
    assert code == 0 and "note: fsm: no start <is> known" in out


def test_not_a_bag(report, tmp_path, capsys) -> None:
    (tmp_path / "text.mcap").write_text("this is no bag at all, whatever its name says")
    (tmp_path / "empty").mkdir()
    (tmp_path / "los.csv").write_text("t,x,y\n0,1,2\n")
    for name, words in (
        ("text.mcap", ["text.mcap", "must begin with"]),
        ("empty", ["rosbag2 folder"]),
        ("los.csv", ["must be a bag", "got CSV", "analyse FILE --output PAGE"]),
    ):
        error = refused(capsys, "report", tmp_path / name)
        assert all(word in error for word in words) and not list(report.here.iterdir())


@pytest.fixture
def table(tmp_path: Path) -> Path:
    t = np.arange(2048) / 512.0
    rows = np.column_stack([t, *np.random.default_rng(0).standard_normal((2, t.size))])
    np.savetxt(tmp_path / "a.csv", rows, delimiter=",", header="time,x_mas,y_mas", comments="")
    return tmp_path / "a.csv"


def test_a_recording_or_its_copy_is_no_further_run(table: Path, capsys: pytest.CaptureFixture[str]) -> None:
    copy = table.with_name("b.csv")
    shutil.copy(table, copy)
    for second in (table, copy):
        assert "recordings must be distinct, got" in refused(capsys, "analyse", table, second)
    said = refused(capsys, "analyse", absent := table.with_name("absent"), table.with_name("other"))
    assert f"{absent}: no such file or folder" in said and "different ones" not in said


def test_compressed_bags_are_compared_by_their_content(tmp_path: Path) -> None:
    """Files as ``ros2 bag record --compression-mode file`` names them; the same one twice is refused."""
    bags = [tmp_path / name for name in "abc"]
    for bag, content in zip(bags, (b"first", b"other", b"first")):
        bag.mkdir()
        (bag / "bag_0.mcap.zstd").write_bytes(content)
    require_different(bags[:2])
    with pytest.raises(ValueError, match=r"c, which is the same as .*a$"):
        require_different(bags)


def test_options_beat_settings_which_beat_the_file(run):
    (run.files / "run.yaml").write_text("duration: 4.0\nseed: 5\nloop: fsm\n")
    config = configure(run.files / "run.yaml", ["seed=6", "theta=0.5"], {"loop": "isolator", "seed": None})
    assert (config.duration, config.seed, config.loop, config.theta) == (4.0, 6, "isolator", 0.5)
