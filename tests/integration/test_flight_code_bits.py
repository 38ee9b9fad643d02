"""The flight code has the bits of the testbed: over a recorded bag, for random controllers, on another processor."""

from __future__ import annotations

import os
import shutil
import subprocess
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from los_testbed.flight_code.export import FLAGS, SOURCES
from los_testbed.flight_code.laws import FlightLaws, laws_of
from los_testbed.flight_code.vectors import magnitudes, run_laws, without_frames
from los_testbed.run.replay import LAYOUT, controllers
from los_testbed.run_start import START_FILE, RunStart
from support.flight_library import LEVELS, LIBRARY, STRICT, FlightController, build, observer_of, same_bits, write

from fsm_pma_controller.runtime import FsmPmaController
from lftkit import SampledSystem
from lftkit.arrays import FloatArray
from los_estimator.runtime import LosEstimator
from pointing_analysis.read.run import Run
from pointing_analysis.replay.replay import replay
from titop_plant.interface import (
    COMMANDS,
    DT,
    ESTIMATES,
    K_FSM_INPUTS,
    K_FSM_OUTPUTS,
    K_PMA_INPUTS,
    K_PMA_OUTPUTS,
    MEASUREMENTS,
    PLATFORM,
    STAGES,
)

BAG = Path(__file__).parents[2] / "bags/reference"
RANDOM_CONTROLLERS, RANDOM_TICKS = 50, 300

with_gcc = pytest.mark.skipif(shutil.which("gcc") is None, reason="no C compiler")
with_clang = pytest.mark.skipif(shutil.which("clang") is None, reason="no clang")
COMPILERS = [pytest.param("gcc", marks=with_gcc), pytest.param("clang", marks=with_clang)]


@pytest.fixture(scope="module")
def shipped(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write(laws_of(), tmp_path_factory.mktemp("flight") / "shipped")


@pytest.fixture(scope="module")
def recorded() -> Run:
    return Run.open(BAG)


@pytest.mark.parametrize("level", LEVELS)
@pytest.mark.parametrize("compiler", COMPILERS)
def test_all_ticks_of_the_reference_bag(compiler: str, level: str, recorded: Run, tmp_path: Path) -> None:
    """Estimates and commands are those of the record, which the testbed's laws have made."""
    laws = controllers(recorded)
    library = build(write(FlightLaws.of(laws.estimator, laws.controller), tmp_path / "laws", LIBRARY), compiler, level)
    states = RunStart.from_bytes(recorded.attachments[START_FILE]).states
    assert states is not None
    observer = observer_of(library, (np.array(states.k_fsm), np.array(states.camera)))
    made = replay(recorded, observer, FlightController(library, laws.loop, np.array(states.k_pma)), layout=LAYOUT)
    assert len(made.stamp) == 4100
    for name, (stamp, values) in made.topics().items():
        topic = recorded[name]
        assert np.array_equal(stamp, topic.stamp)
        expected = topic.values[:, : values.shape[1]]  # a message has three angles of the mirror
        assert same_bits(np.ascontiguousarray(values), np.ascontiguousarray(expected)).all(), name


def random_system(rng: np.random.Generator, order: int, inputs: tuple, outputs: tuple) -> SampledSystem:
    """A system whose numbers are of all magnitudes, some of them zero or subnormal."""
    rows, columns = order + sum(p.size for p in outputs), order + sum(p.size for p in inputs)
    matrix = rng.standard_normal((rows, columns)) * 10.0 ** rng.uniform(-8, 3, (rows, columns))
    matrix[rng.random(matrix.shape) < 0.1] = 0.0
    matrix[rng.random(matrix.shape) < 0.05] = -3e-320
    A = matrix[:order, :order]
    A /= max(1.0, 1.1 * np.abs(A).sum(axis=1).max())
    return SampledSystem(A, matrix[:order, order:], matrix[order:, :order], matrix[order:, order:], inputs, outputs, DT)


def random_laws(rng: np.random.Generator, order: int) -> FlightLaws:
    k_fsm = random_system(rng, order, K_FSM_INPUTS, K_FSM_OUTPUTS)
    k_pma = random_system(rng, int(rng.integers(1, 13)), K_PMA_INPUTS, K_PMA_OUTPUTS)
    sensitivity, mirror, force = (float(value) for value in 10.0 ** rng.uniform([-3, -4, 0], [1, 4, 12]))
    limits = {"los_sensitivity": sensitivity, "fsm_authority": mirror, "pma_authority": force}
    return FlightLaws.of(LosEstimator(k_fsm), FsmPmaController(k_pma, **limits))


def inputs(rng: np.random.Generator) -> FloatArray:
    """Ordinary values, all magnitudes, sums that overflow, an acceleration that is NaN; no camera at times."""
    ordinary = rng.standard_normal((RANDOM_TICKS // 2, MEASUREMENTS))
    odd = magnitudes(rng, RANDOM_TICKS - len(ordinary))
    odd[-30:] = 1.7e308 * rng.uniform(-1.0, 1.0, (30, MEASUREMENTS))
    odd[-5, rng.integers(18)] = np.nan
    return without_frames(np.vstack([ordinary, odd]), rng)


def answers_of(library: Path, measurement: FloatArray, stages: list[int]) -> tuple[FloatArray, FloatArray]:
    observer, controller, loop = observer_of(library), FlightController(library), STAGES[-1]
    estimate, command = np.zeros((len(measurement), ESTIMATES)), np.zeros((len(measurement), COMMANDS))
    for row, y in enumerate(measurement):
        if STAGES[stages[row]] != loop:
            loop = STAGES[stages[row]]
            controller.switch(loop)
        observer.step(y, estimate[row])
        controller.step(estimate[row], y[PLATFORM], command[row])
    return estimate, command


@with_gcc
@pytest.mark.parametrize("count", [4, pytest.param(RANDOM_CONTROLLERS, marks=pytest.mark.slow)])
def test_random_controllers_on_inputs_of_all_magnitudes(count: int, tmp_path: Path) -> None:
    rng, finite, steps = np.random.default_rng(2035), 0, 0
    for number in range(count):
        laws = random_laws(rng, 1 + number % 12)
        library = build(write(laws, tmp_path / str(number), LIBRARY), "gcc", LEVELS[number % len(LEVELS)])
        measurement = inputs(rng)
        stages = np.repeat(rng.integers(0, len(STAGES), RANDOM_TICKS // 20), 20).tolist()
        for found, expected in zip(answers_of(library, measurement, stages), run_laws(laws, measurement, stages)):
            assert same_bits(found, expected).all(), number
            finite, steps = finite + int(np.isfinite(expected).all(axis=1).sum()), steps + len(expected)
    assert 0.5 * steps < finite < steps  # both kinds of ticks


def self_test(folder: Path, compiler: str, *options: str) -> subprocess.CompletedProcess[str]:
    program = folder / f"self_test_{compiler}{''.join(options)}"
    subprocess.run([compiler, *options, *(str(folder / name) for name in SOURCES), "-o", str(program)], check=True)
    return subprocess.run([str(program)], capture_output=True, text=True, check=False)


@pytest.mark.parametrize("level", LEVELS)
@pytest.mark.parametrize("compiler", COMPILERS)
def test_the_self_test_passes_without_a_warning(compiler: str, level: str, shipped: Path) -> None:
    done = self_test(shipped, compiler, *STRICT, level, "-ffp-contract=off")
    assert done.returncode == 0 and "have the bits of the testbed" in done.stdout


@with_gcc
def test_the_self_test_finds_fused_products(shipped: Path) -> None:
    """A compiler that fuses products with sums makes other bits, and the self test says so."""
    if " fma " not in Path("/proc/cpuinfo").read_text("utf-8"):
        pytest.skip("this processor has no fused multiply-add of x86")
    done = self_test(shipped, "gcc", "-O2", "-mfma", "-ffp-contract=fast")
    assert done.returncode == 1 and "values differ" in done.stdout


@with_gcc
@pytest.mark.parametrize(("change", "found"), [("0x1.", "values differ"), ("> limit", "values differ")])
def test_the_self_test_finds_another_law(change: str, found: str, shipped: Path, tmp_path: Path) -> None:
    """One number of a table, or the limit of the commands."""
    folder = Path(shutil.copytree(shipped, tmp_path / "other"))
    unit, other = {"0x1.": ("k_pma.c", "0x1.0"), "> limit": ("controller.c", "> 2.0 * limit")}[change]
    text = (folder / unit).read_text("utf-8")
    assert change in text
    (folder / unit).write_text(text.replace(change, other, 1), "utf-8")
    assert found in self_test(folder, "gcc", *FLAGS).stdout


@with_gcc
def test_undefined_behaviour_and_memory(shipped: Path) -> None:
    done = self_test(shipped, "gcc", "-O1", "-g", "-fsanitize=address,undefined", "-fno-sanitize-recover=all")
    assert done.returncode == 0, done.stderr


@pytest.mark.skipif(
    shutil.which("aarch64-linux-gnu-gcc") is None or shutil.which("qemu-aarch64") is None,
    reason="no cross compiler and emulator of AArch64",
)
def test_aarch64_has_the_same_bits(shipped: Path) -> None:
    program = shipped / "self_test_aarch64"
    sources = [str(shipped / name) for name in SOURCES]
    for level in ("-O0", "-O3"):
        line = ["aarch64-linux-gnu-gcc", *STRICT, level, "-ffp-contract=off", "-static", *sources, "-o", str(program)]
        subprocess.run(line, check=True)
        done = subprocess.run(["qemu-aarch64", str(program)], capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stdout


@with_gcc
@pytest.mark.parametrize("tool", [("make", "check"), ("cmake",)], ids=" ".join)
def test_make_and_cmake_build_it(tool: tuple[str, ...], shipped: Path, tmp_path: Path) -> None:
    if shutil.which(tool[0]) is None:
        pytest.skip("no make or cmake")
    folder = Path(shutil.copytree(shipped, tmp_path / "copy", ignore=shutil.ignore_patterns("self_test_*")))
    lines = [list(tool)]
    if tool[0] == "cmake":
        lines = [["cmake", "-B", "build", "."], ["cmake", "--build", "build"], ["build/self_test"]]
    environment = {k: v for k, v in os.environ.items() if k not in ("CFLAGS", "MAKEFLAGS")}
    for line in lines:
        done = subprocess.run(line, cwd=folder, capture_output=True, text=True, check=False, env=environment)
        assert done.returncode == 0 and "warning" not in done.stderr, done.stderr
    assert "have the bits of the testbed" in done.stdout


@with_gcc
def test_the_rounding_of_a_step_is_within_its_bound(shipped: Path) -> None:
    """Against exact sums of fractions: n u / (1 - n u) times the sum of absolute values, of each row."""
    library = build(shipped, "gcc", "-O2")
    rng, laws = np.random.default_rng(7), laws_of()
    matrix = np.hstack([laws.k_fsm.C, laws.k_fsm.D])
    n, u = matrix.shape[1], Fraction(1, 2**53)
    bound, largest = n * u / (1 - n * u), Fraction(0)
    for _ in range(20):
        values, found = rng.standard_normal(n), np.zeros(ESTIMATES)
        state, held = values[: laws.k_fsm.order].copy(), np.zeros(2)
        observer_of(library, (state, held)).step(values[laws.k_fsm.order :].copy(), found)
        for row, sum_of in zip(matrix, found):
            terms = [Fraction(m) * Fraction(z) for m, z in zip(row.tolist(), values.tolist())]
            error = abs(Fraction(float(sum_of)) - sum(terms)) / sum(map(abs, terms))
            assert error <= bound
            largest = max(largest, error)
    assert largest > 0  # not all sums are exact
