"""What the tools of C programmers say of the flight code: clang-tidy, cppcheck with its MISRA rules, callgrind."""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path

import pytest
from los_testbed.flight.laws import laws_of
from los_testbed.flight.tables import UNITS
from support.flight_library import LIBRARY, write
from support.scripts import script

ROOT = Path(__file__).parents[2]
DEVIATIONS = {"2.4", "2.5", "5.7", "5.9", "8.7", "8.9", "8.11", "15.5"}
"""Rules of MISRA C:2012 that the code deviates from, all advisory but 5.7: docs/flight_code.md says why."""

FLOAT = ["-DFLT_RADIX=2", "-DDBL_MANT_DIG=53", "-DDBL_MAX_EXP=1024", "-DFLT_EVAL_METHOD=0"]
GROUPS = ("bugprone", "cert", "clang-analyzer", "misc", "performance", "portability")
CHECKS = ",".join(["-*", *(f"{group}-*" for group in GROUPS), "-bugprone-easily-swappable-parameters"])
SOURCES = [f"{unit}.c" for unit in UNITS]


@pytest.fixture(scope="module")
def flight(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write(laws_of(), tmp_path_factory.mktemp("flight") / "code", LIBRARY)


@pytest.mark.skipif(shutil.which("clang-tidy") is None, reason="no clang-tidy")
def test_clang_tidy_finds_nothing(flight: Path) -> None:
    line = ["clang-tidy", "--quiet", f"--checks={CHECKS}", "--warnings-as-errors=*", *SOURCES, "--", "-std=c99"]
    done = subprocess.run(line, cwd=flight, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout


@pytest.mark.further
@pytest.mark.skipif(shutil.which("cppcheck") is None, reason="no cppcheck")
def test_cppcheck_finds_the_listed_deviations_of_misra_alone(flight: Path) -> None:
    line = ["cppcheck", "--std=c99", "--enable=style,warning,performance,portability", "--addon=misra", *FLOAT]
    line += ["--quiet", "--template={file}:{line}: {id}", *SOURCES]
    found = subprocess.run(line, cwd=flight, capture_output=True, text=True).stderr.splitlines()
    rules = [match[1] for text in found if (match := re.search(r": misra-c2012-([\d.]+)$", text))]
    assert len(rules) == len(found), [text for text in found if "misra" not in text]
    assert rules and set(rules) <= DEVIATIONS


@pytest.mark.further
@pytest.mark.skipif(not (shutil.which("valgrind") and shutil.which("gcc")), reason="no valgrind or gcc")
def test_a_step_takes_the_same_instructions_for_all_values(flight: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """All loops have fixed bounds: what a step costs depends on absent samples and limits by a few instructions."""
    monkeypatch.syspath_prepend(str(ROOT / "benchmarks"))
    cost = script(ROOT / "benchmarks/flight_cost.py")
    (flight / "main.c").write_text(cost.MAIN)
    line = ["gcc", "-std=c99", "-O2", "-ffp-contract=off", "main.c", *SOURCES, "-o", "main", "-lm"]
    subprocess.run(line, cwd=flight, check=True)
    counts = [cost._calls(flight, "los_k_fsm_step", value) for value in cost.CASES.values()]
    assert 2 * 1056 < min(counts) <= max(counts) < 1.02 * min(counts)
