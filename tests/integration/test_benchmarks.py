"""Every benchmark is imported and says its options; with its shortest setting each runs to its end (slow, in CI)."""

from __future__ import annotations

import ast
import json
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
BENCHMARKS = ROOT / "benchmarks"

SHORTEST: dict[str, str] = {
    "bag_reading": "--seconds 1 --rounds 1 --json",
    "bare_loop": "--seconds 0.5 --json",
    "beside_slycot": "--seconds 0.01 --json",
    "campaign": "--members 1 --workers 1 --counts 2 --duration 2 --json",
    "deadline_qos": "--seconds 1 --json",
    "design_gap": "--designs small_telescope",
    "device_faults": "--cases silent",
    "flight_code": "--steps 1e3 --json",
    "frequency_response": "--samples 1 --json",
    "full_order_gap": "--plants AC4",
    "fsm_value": "--seconds 1 --json",
    "goals": "--json",
    "hinf_norm": "--samples 1 --json",
    "image_camera": "--pairs 1 --seconds 1 --json",
    "image_quality": "--exposures 100 --frequencies 8 --json",
    "independent_search": "--seconds 1 --no-run",
    "lockstep": "--seconds 1 --json",
    "lost_ticks": "--seeds 1",
    "old_frames": "--seconds 1",
    "real_time_loop": "--seconds 1 --hogs 0 --loops ours --json",
    "size": "--states 100 --ticks 1000 --json",
    "soak": "--minutes 0.05 --json",
    "tick": "--ticks 500 --durations 1,2 --member 1 --json",
    "time_grid": "--seconds 3",
    "tuning": "--plants AC4 --seconds 1 --methods ours --json",
    "verdict_coverage": "--scale 0.02 --lengths 10 --kinds white --json",
    "verification": "--points 2 --json",
    "viewers": "--seconds 2 --json",
}
VERDICTS = {"soak": {0, 1}}
"""Exit codes, where they say more than that it ended: 1 for memory that grows, which a few seconds cannot tell."""
OTHERS = {
    "bundle_fuzz": "mutates a bundle of proofs: tests/unit/benchmarks",
    "executor_nodes": "nodes of real_time_loop and lockstep",
    "flight_cost": "needs valgrind, some minutes",
    "mutations": "runs tests: tests/unit/benchmarks",
    "processor_time": "a module of others",
    "gradient_sampling": "a module of tuning: tests/unit/benchmarks",
    "two_host_loop": "needs network namespaces",
}


def test_every_benchmark_has_a_shortest_setting_or_a_reason() -> None:
    assert {path.stem for path in BENCHMARKS.glob("*.py")} == SHORTEST.keys() | OTHERS.keys()
    assert not SHORTEST.keys() & OTHERS.keys()


def test_every_line_of_the_target_names_a_benchmark() -> None:
    (target,) = re.findall(r"^bench:.*\n((?:\t.*\n)+)", (ROOT / "Makefile").read_text("utf-8"), re.MULTILINE)
    lines = re.findall(r"benchmarks/(\w+)\.py", target)
    assert len(lines) == target.count("\n") and set(lines) <= SHORTEST.keys()


@pytest.mark.further
def test_every_benchmark_says_its_options() -> None:
    """In one process: it imports numpy once."""
    names = [path for path in sorted(BENCHMARKS.glob("*.py")) if has_program(path)]
    code = (
        "import contextlib, io, runpy, sys\n"
        "for path in sys.argv[1:]:\n"
        "    out, sys.argv = io.StringIO(), [path, '--help']\n"
        "    sys.path.insert(0, str(path.rsplit('/', 1)[0]))\n"
        "    code = 'went on'\n"
        "    with contextlib.redirect_stdout(out):\n"
        "        try:\n            runpy.run_path(path, run_name='__main__')\n"
        "        except SystemExit as end:\n            code = end.code or 0\n"
        "        except Exception as error:\n            code = repr(error)\n"
        "    if code or not out.getvalue().strip():\n        print(path, code)\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, *map(str, names)], capture_output=True, text=True, cwd=ROOT, timeout=600
    )
    assert (done.returncode, done.stdout) == (0, ""), done.stdout + done.stderr
    assert len(names) > 25


def has_program(path: Path) -> bool:
    """Whether a file is a program, no module of others."""
    return any(
        isinstance(part, ast.If) and "__main__" in ast.unparse(part.test) for part in ast.parse(path.read_text()).body
    )


@pytest.mark.slow
@pytest.mark.parametrize("name", SHORTEST)
def test_it_runs_to_its_end(name: str) -> None:
    options = SHORTEST[name].split()
    done = subprocess.run(
        [sys.executable, BENCHMARKS / f"{name}.py", *options], capture_output=True, text=True, cwd=ROOT, timeout=900
    )
    assert done.returncode in VERDICTS.get(name, {0}), done.stderr[-3000:]
    if "--json" in options:
        assert isinstance(json.loads(done.stdout), dict)
