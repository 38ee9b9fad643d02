"""The script that starts a command as on another machine does what the names of its kinds say."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).parents[2]
SHOW = (
    "import json, os, shutil, signal, sys, time; mask = os.umask(0); print(json.dumps({"
    "'uptime': time.monotonic(), 'hup': int(signal.getsignal(1)), 'term': int(signal.getsignal(15)), "
    "'stdin': os.path.exists('/proc/self/fd/0'), 'place': os.getcwd(), 'umask': mask, 'cc': shutil.which('cc'), "
    "'gcc': shutil.which('gcc'), 'git': shutil.which('git'), 'cpus': len(os.sched_getaffinity(0)), "
    "'terminal': sys.stdout.isatty(), 'uid': os.getuid(), **os.environ}))"
)


def shown(*kinds: str) -> dict[str, Any]:
    """What a command sees on such a machine."""
    program = [sys.executable, str(ROOT / "tests/elsewhere.py"), *kinds, "--", "python3", "-c", SHOW]
    done = subprocess.run(program, capture_output=True, text=True, timeout=300, stdin=subprocess.PIPE)
    if done.returncode and "unshare" in done.stderr + done.stdout:
        pytest.skip("time namespaces are not permitted")
    assert done.returncode == 0, done.stderr
    (line,) = [line for line in done.stdout.splitlines() if line.startswith("{")]
    found: dict[str, Any] = json.loads(line)
    assert not Path(found["place"]).exists(), "nothing is left"
    return found


@pytest.fixture(autouse=True)
def _clone() -> None:
    if not (ROOT / ".git").exists():
        pytest.skip("not a clone")


def test_a_shell_of_another_kind() -> None:
    found = shown("nohup", "noterm", "nostdin", "c", "chatham", "narrow", "spaces", "umask", "one", "blas")
    assert (found["hup"], found["term"], found["stdin"], found["umask"], found["cpus"]) == (1, 1, False, 0o77, 1)
    assert (found["LC_ALL"], found["TZ"], found["COLUMNS"]) == ("C", "Pacific/Chatham", "40")
    assert " " in found["place"] and "ü" in found["TMPDIR"] and found["OPENBLAS_CORETYPE"] == "Prescott"
    assert "PYTHONPATH" not in found and "ROS_DOMAIN_ID" not in found


def test_a_machine_that_was_just_started_without_a_compiler() -> None:
    found = shown("young", "nocc", "pipe")
    assert found["cc"] is found["gcc"] is None and found["git"] and not found["terminal"]
    assert 55 < found["uptime"] < 600


def test_the_exit_code_is_that_of_the_command() -> None:
    program = [sys.executable, str(ROOT / "tests/elsewhere.py"), "pipe", "--", "sh", "-c", "exit 7"]
    assert subprocess.run(program, stdout=subprocess.DEVNULL, timeout=600).returncode == 7
    refused = subprocess.run([*program[:2], "mars"], capture_output=True, text=True, timeout=600)
    assert refused.returncode == 2 and "invalid choice: 'mars'" in refused.stderr
