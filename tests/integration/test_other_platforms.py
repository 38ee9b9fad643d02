"""Where no wheels of ROS 2 are: what works does, and one line says what."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from los_testbed.run.processes import domains, node_launch
from los_testbed.run.processes.memory_file import memory_file

ELSEWHERE = {
    **os.environ,
    "PYTHONPATH": str(Path(__file__).parents[1] / "support/without_linux"),
    "OPENBLAS_NUM_THREADS": "1",
}


def program(*arguments: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "los_testbed", *arguments]
    return subprocess.run(command, env=ELSEWHERE, capture_output=True, text=True, timeout=300)


@pytest.mark.further
def test_a_run_in_process_and_its_page(tmp_path: Path) -> None:
    done = program("run", "--mode", "inprocess", "--duration", "1", "--output", str(tmp_path / "bag"))
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "bag/report.html").is_file()


def test_modes_with_ros_say_what_works(tmp_path: Path) -> None:
    done = program("run", "--mode", "lockstep", "--duration", "1", "--output", str(tmp_path / "bag"))
    assert done.returncode == 2
    assert done.stderr.count("\n") == 1 and "got Darwin on arm64; use --mode inprocess" in done.stderr


@pytest.mark.parametrize(
    ("platform", "expected"), [(("Linux", "x86_64"), "los-testbed[ros]"), (("Linux", "aarch64"), "Linux on aarch64")]
)
def test_the_extra_is_named_where_it_has_wheels(
    platform: tuple[str, str], expected: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(node_launch.platform, "system", lambda: platform[0])
    monkeypatch.setattr(node_launch.platform, "machine", lambda: platform[1])
    monkeypatch.setattr(node_launch.importlib.util, "find_spec", lambda name: None)
    with pytest.raises(ValueError, match="rclpy must be installed") as caught:
        node_launch.check_ros()
    assert expected in str(caught.value) and "--mode inprocess" in str(caught.value)


def test_a_place_is_held_by_one_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(domains, "_NAMES_OF_THE_KERNEL", False)
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    with domains.output_lock(tmp_path / "bag"):
        with domains.output_lock(tmp_path / "other"), domains.domain_lock(3, "/a/b"):
            pass
        with (
            pytest.raises(ValueError, match="--output must not be in use by another run"),
            domains.output_lock(tmp_path / "bag"),
        ):
            pass
    with domains.output_lock(tmp_path / "bag"):
        pass


def test_a_file_without_a_name_is_read_by_its_path(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("los_testbed.run.processes.memory_file._IN_MEMORY", False)
    with memory_file(b"content", "example") as file, open(file.path, "rb") as stream:
        assert stream.read() == b"content"
