"""The recipe of ros_ws/README.md that builds the workspace with colcon: carried out line by line, as it is printed."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
TITLE = "against the wheels"
RUN = "los-testbed run --domain free"
SHORT_RUN = " --duration 2 --no-report --max-missed 100 --output {}"
SEEN = "import los_testbed, lftkit; print(los_testbed.__file__)"

pytest.importorskip("rclpy")


def recipe() -> str:
    """The lines below the comment, up to the next empty one."""
    text = (ROOT / "ros_ws/README.md").read_text("utf-8")
    (found,) = re.findall(rf"^    # {TITLE}[^\n]*\n((?:    [^\n]+\n)+)", text, flags=re.MULTILINE)
    return re.sub(r"^    ", "", found, flags=re.MULTILINE)


@pytest.fixture
def repository(tmp_path: Path) -> Path:
    """The workspace beside a copy of the environment of these tests, in which the recipe installs packages."""
    asked = [sys.executable, "-m", "pip", "download", "--quiet", "--no-deps", "--dest", str(tmp_path), "colcon-core"]
    if shutil.which("bash") is None or subprocess.run(asked, capture_output=True, check=False).returncode:
        pytest.skip("no package index that has colcon can be reached")
    folder = tmp_path / "repository"
    folder.mkdir()
    for entry in ROOT.iterdir():
        if not entry.name.startswith(".") and entry.name not in ("ros_ws", "build"):
            (folder / entry.name).symlink_to(entry)
    made = shutil.ignore_patterns("build", "install", "log", "__pycache__")
    shutil.copytree(ROOT / "ros_ws", folder / "ros_ws", ignore=made)
    shutil.copytree(sys.prefix, folder / ".venv", symlinks=True, copy_function=linked)
    for script in (folder / ".venv/bin").iterdir():
        if script.is_file() and not script.is_symlink() and sys.prefix.encode() in (text := script.read_bytes()):
            mode = script.stat().st_mode
            script.unlink()
            script.write_bytes(text.replace(sys.prefix.encode(), str(folder / ".venv").encode()))
            script.chmod(mode)
    return folder


def linked(source: str, target: str) -> None:
    """A second name of a file where that is possible: pip replaces files, and writes into none."""
    try:
        os.link(source, target)
    except OSError:
        shutil.copy2(source, target)


def test_the_workspace_is_built_tested_sourced_and_flown(repository: Path) -> None:
    """The nodes of the run are those that colcon has installed; no line fails, no test of the package fails."""
    lines = recipe()
    assert lines.count(RUN) == 1 and "source install/setup.bash" in lines
    bag = repository / "bag"
    script = lines.replace(RUN, RUN + SHORT_RUN.format(bag)) + f"python -c '{SEEN}'\nfind install -name '*.sh'\n"
    done = subprocess.run(
        ["bash", "-e", "-o", "pipefail", "-c", script], cwd=repository, capture_output=True, text=True, check=False
    )
    told = done.stdout + done.stderr
    assert done.returncode == 0, told
    (suite,) = ElementTree.parse(repository / "ros_ws/build/los_testbed/pytest.xml").getroot()
    assert int(suite.get("tests", 0)) >= 5 and (suite.get("errors"), suite.get("failures")) == ("0", "0"), told
    assert "install/los_testbed/share/los_testbed/hook/ament_prefix_path.sh" in done.stdout
    imported = re.findall(r"^.*/los_testbed/__init__\.py$", done.stdout, flags=re.MULTILINE)
    assert len(imported) == 1 and imported[0].startswith(str(repository / "ros_ws/install")), told
    assert (bag / "metadata.yaml").is_file(), told
