"""The commands of the pages run as they are printed, in order, in the folder that the page presupposes.

A run is shortened and stays in one process; what takes long, or needs other machines or a ROS 2 in other terminals, is
named with its reason. `tests/architecture/test_documented_commands.py` reads the options of all of them.
"""

from __future__ import annotations

import re
import shlex
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest
from los_testbed.cli.app import main
from support.command_line import call_command
from support.documented_commands import PAGES, ROOT, Printed, blocks, printed

import fsm_pma_controller
import los_estimator

pytestmark = pytest.mark.usefixtures("without_pictures")
NOT_RUN = {
    r"--scheduler": "needs a cluster: test_campaign_cluster.py",
    r"^design (all|certify|k-fsm|k-pma|sensitivity|verify)\b": "takes minutes to hours: test_example_designs.py",
    r"^design check-proof|--proof\b": "needs the proofs of hours: test_design_certify.py",
    r"--only\b|^control\b|--to-ros|--live|--domain": "needs several processes: tests/ros",
    r"--device\b|^device check": "needs a rig: test_device_runs.py, test_rig_page.py",
    r"liblos_flight": "needs a compiler: test_flight_library_runs.py",
    r"/my/los": "needs a bag of another program: test_documented_commands_run.py",
}
"""What is not run, by its words, and why."""
TESTED_ELSEWHERE = {"tutorial.md": ("test_tutorials.py",)}
TESTED_ELSEWHERE |= dict.fromkeys(("your_data.md", "your_disturbances.md"), ("test_documented_commands_run.py",))
TESTED_ELSEWHERE |= {path.name: ("test_contributing_pages.py",) for path in (ROOT / "docs/extend").glob("*.md")}
SHORTER = {
    "run": {"--mode": "inprocess", "--duration": "2", "--no-report": ""},
    "stages": {"--duration": "2", "--samples": "1", "--no-parts": ""},
    "campaign": {"--duration": "1", "--workers": "1"},
}
"""Options that are added where a command does not have them."""
FEWER = {"--samples 200": "--samples 2", "--theta-rate 0.1 --ramp-duration 5": "--theta-rate 0.1 --ramp-duration 1"}
"""What is replaced."""
PROFILE = "time,theta,wheel_speed_1,wheel_speed_2,wheel_speed_3,wheel_speed_4\n0,0,30,30,30,30\n9,1,90,90,90,90\n"
OPTICS = "optics.aperture_diameter = 2.4\noptics.obscuration = 0.3\n"


def blocks_of(name: str, language: str) -> list[str]:
    return blocks((ROOT / "docs" / name).read_text("utf-8"), language)


def python_of(name: str) -> None:
    for block in blocks_of(name, "python"):
        exec(compile(block, name, "exec"), {})


def of_budget() -> None:
    (toml,) = [block for block in blocks_of("pointing_analysis.md", "toml") if block.startswith("title")]
    (table,) = [block for block in blocks_of("pointing_analysis.md", "text") if block.startswith("source,")]
    Path("my_budget.toml").write_text(toml)
    Path("my_budget.csv").write_text(table)


def of_images() -> None:
    python_of("your_data.md")
    rows = Path("bench.csv").read_text().splitlines()[1:]
    Path("los.csv").write_text("\n".join(["time,x,y", *rows[:10_000]]) + "\n")
    Path("optics.toml").write_text(
        re.sub(r"^optics.pupil.*\n", OPTICS, blocks_of("image_quality.md", "toml")[0], flags=re.M)
    )
    Path("my_camera.toml").write_text(blocks_of("image_quality.md", "toml")[1])


def of_analysis() -> None:
    of_budget()
    shutil.copytree(ROOT / "bags/reference", "BAG")
    command = "openssl genpkey -algorithm ed25519 -out key.pem && openssl pkey -in key.pem -pubout -out public.pem"
    assert command in (ROOT / "docs/pointing_analysis.md").read_text("utf-8")
    subprocess.run(command, shell=True, check=True, capture_output=True)


def of_telescope() -> None:
    Path("my_telescope.toml").write_text("base = 'reference'\n[pma]\nstiffness = 90.0\n")
    Path("my_profile.csv").write_text(PROFILE)
    Path("designs/mine").mkdir(parents=True)
    for name, module in (("k_fsm.json", los_estimator), ("k_pma.json", fsm_pma_controller)):
        shutil.copy(Path(str(module.__file__)).parent / "designs" / name, Path("designs/mine") / name)


def of_code() -> None:
    shutil.copy(ROOT / "examples/classes_for_a_run.py", ".")
    shutil.copytree(ROOT / "examples/spacecraft", "spacecraft")


PREPARED: dict[str, Callable[[], None]] = {
    "image_quality.md": of_images,
    "pointing_analysis.md": of_analysis,
    "your_spacecraft.md": of_telescope,
    "flight_code.md": of_telescope,
    "your_controller.md": of_code,
}
"""What the text of a page presupposes, beside examples and bags."""


def not_run(command: Printed) -> bool:
    return any(re.search(pattern, " ".join(command.words)) for pattern in NOT_RUN)


def shortened(command: Printed) -> list[str]:
    text = " ".join(command.words)
    for longer, shorter in FEWER.items():
        text = text.replace(longer, shorter)
    words = text.split()
    for option, value in SHORTER.get(words[0], {}).items():
        if option not in words:
            words += [option, value] if value else [option]
    return words


EVERY = {page.name: printed(page) for page in PAGES}
RUN = [name for name, found in EVERY.items() if name not in TESTED_ELSEWHERE and any(not not_run(one) for one in found)]


@pytest.mark.slow
@pytest.mark.parametrize("page", RUN)
def test_the_commands_of_a_page_run(
    page: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("pyarrow")
    monkeypatch.chdir(tmp_path)
    (tmp_path / "examples").symlink_to(ROOT / "examples")
    for name in ("reference", "night", "none", "fsm"):
        shutil.copytree(ROOT / "bags/reference", tmp_path / "bags" / name)
    PREPARED.get(page, lambda: None)()
    for command in EVERY[page]:
        if not not_run(command):
            code, _, err = call_command(capsys, *shortened(command))
            assert code == 0, f"{command}: {command.text}: {err}"


def test_every_reason_is_of_a_command_and_names_a_test_that_exists() -> None:
    left = [" ".join(one.words) for found in EVERY.values() for one in found if not_run(one)]
    for pattern, reason in NOT_RUN.items():
        assert any(re.search(pattern, line) for line in left), pattern
        for name in re.findall(r"test_\w+\.py", reason):
            assert list((ROOT / "tests").rglob(name)), name
    assert all((ROOT / "tests/integration" / name).is_file() for names in TESTED_ELSEWHERE.values() for name in names)


@pytest.mark.parametrize("page", ["your_data.md", pytest.param("your_disturbances.md", marks=pytest.mark.further)])
def test_the_commands_of_a_page_on_files_of_others_run(
    page: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """With the files that the page makes."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "bags").symlink_to(ROOT / "bags")
    python_of(page)
    observer = Path(los_estimator.__file__).parent / "designs" / "k_fsm.json"
    Path("my_laws.py").write_text(
        "from lftkit.systems.sampled.sampled_system import SampledSystem\n"
        f"observer = SampledSystem.from_file({str(observer)!r}).to_control()\n"
    )
    for block in blocks_of(page, "toml"):
        (tmp_path / "my_sources.toml").write_text(block)
    commands = [line for block in blocks_of(page, "sh") for line in block.splitlines()]
    assert len(commands) >= 3
    for line in commands:
        words = shlex.split(line, comments=True)
        assert words.pop(0) == "los-testbed"
        more = ["--no-report"] if words[0] == "run" else []
        assert main([*words, *more]) == 0, line
        shown = "".join(capsys.readouterr())
        if words[0] == "run":
            assert ("Sources, each alone" in shown) == ("--disturbance" in words)
        else:
            assert "512 Hz from the times" in shown
