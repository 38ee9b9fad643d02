"""The flight code has the bits of the testbed, over a bag and for random controllers; tools of C find nothing."""

from __future__ import annotations

import ctypes
import os
import re
import shutil
import subprocess
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from los_testbed.flight.export import FLAGS, SOURCES
from los_testbed.flight.laws import FlightLaws, laws_of
from los_testbed.flight.tables import UNITS
from los_testbed.flight.vectors import run_laws
from los_testbed.parts.start import START_FILE, RunStart
from los_testbed.run.replay import controllers
from los_testbed.run.replay_ports import layout_of
from support.flight_library import (
    LEVELS,
    LIBRARY,
    STRICT,
    FlightController,
    build,
    observer_of,
    pointer,
    same_bits,
    write,
)
from support.loop_rows import COMMANDS
from support.scripts import script

from lftkit.arrays import FloatArray
from pointing_analysis.read.run import Run
from pointing_analysis.replay.replay import replay
from titop_plant.interface import CAMERA_PORT, COLUMNS, ESTIMATES, PLATFORM, STAGES

ROOT = Path(__file__).parents[2]
BAG = ROOT / "bags/reference"
benchmark = script(ROOT / "benchmarks/flight_code.py")

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
    layout = layout_of(laws.estimator.ports, laws.controller.ports)
    made = replay(recorded, observer, FlightController(library, laws.loop, np.array(states.k_pma)), layout=layout)
    assert len(made.stamp) == 4100
    for name, (stamp, values) in made.topics().items():
        topic = recorded[name]
        assert np.array_equal(stamp, topic.stamp)
        expected = topic.values[:, : values.shape[1]]  # a message has three angles of the mirror
        assert same_bits(np.ascontiguousarray(values), np.ascontiguousarray(expected)).all(), name


@with_gcc
@pytest.mark.parametrize(
    ("pairs", "steps", "every"),
    [(0, 100_000, 3), (12, 50_000, 1), pytest.param(50, 5_000_000, 1, marks=pytest.mark.slow)],
    ids=["shipped", "12 random", "50 random"],
)
def test_the_kernel_on_inputs_of_all_magnitudes(pairs: int, steps: int, every: int) -> None:
    """Subnormal numbers to 1e300, overflow, an absent or infinite camera; random controllers have order 1 to 12."""
    pytest.importorskip("numba")
    builds = tuple(build for build in benchmark.BUILDS if shutil.which(build[0]))
    found = benchmark.compare(pairs, steps, 35, builds[::every])
    assert found["values_differing"] == 0
    assert found["steps"] >= steps and 0.9 < found["finite"] < 1.0  # both kinds of ticks


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
def test_the_laws_in_numpy_with_all_stages_in_a_run(tmp_path: Path) -> None:
    """K_PMA starts again where its loop closes; the compiled kernel is not asked, it keeps its stage."""
    rng = np.random.default_rng(2035)
    for order in (1, 5, 12):
        laws, measurement = benchmark.random_laws(rng, order), benchmark.inputs(rng, "all magnitudes", 300)
        stages = np.repeat(rng.integers(0, len(STAGES), 15), 20).tolist()
        library = build(write(laws, tmp_path / str(order), LIBRARY), "gcc", "-O2")
        for found, expected in zip(answers_of(library, measurement, stages), run_laws(laws, measurement, stages)):
            assert same_bits(found, expected).all(), order


@with_gcc
def test_fused_products_differ_from_the_kernel(tmp_path: Path) -> None:
    """What the comparison is for: two roundings made one are found."""
    pytest.importorskip("numba")
    if " fma " not in Path("/proc/cpuinfo").read_text("utf-8"):
        pytest.skip("this processor has no fused multiply-add of x86")
    fused = "-O2", "-mfma", "-ffp-contract=fast", "-fno-tree-vectorize"  # vectors of products are added up one by one
    exported = benchmark.Exported(laws_of(), tmp_path, "gcc", *fused)
    found = benchmark.Comparison()
    found.block(laws_of(), exported, np.random.default_rng(1), 0)
    assert found.differing > 1000


def self_test(folder: Path, compiler: str, *options: str, emulator: str = "") -> subprocess.CompletedProcess[str]:
    program = folder / f"self_test_{compiler}{''.join(options)}"
    subprocess.run([compiler, *options, *(str(folder / name) for name in SOURCES), "-o", str(program)], check=True)
    return subprocess.run([*filter(None, [emulator]), str(program)], capture_output=True, text=True, check=False)


@pytest.mark.parametrize("level", LEVELS)
@pytest.mark.parametrize("compiler", COMPILERS)
def test_the_self_test_passes_without_a_warning(compiler: str, level: str, shipped: Path) -> None:
    done = self_test(shipped, compiler, *STRICT, level, "-ffp-contract=off")
    assert done.returncode == 0 and "have the bits of the testbed" in done.stdout


@pytest.mark.parametrize("compiler", COMPILERS)
@pytest.mark.parametrize("example", ["small_telescope", "earth_observer"])
def test_the_self_test_of_another_telescope_passes(example: str, compiler: str, tmp_path: Path) -> None:
    """Also where K_PMA is zero: numpy adds products of -0 up to 0."""
    designs = ROOT / "examples" / "spacecraft" / example
    folder = write(laws_of(str(designs)), tmp_path / "flight")
    done = self_test(folder, compiler, *STRICT, "-ffp-contract=off")
    assert done.returncode == 0 and "have the bits of the testbed" in done.stdout, done.stdout


@with_gcc
@pytest.mark.parametrize(
    ("unit", "change", "other"), [("k_pma.c", "0x1.", "0x1.0"), ("controller.c", "> limit", "> 2.0 * limit")]
)
def test_the_self_test_finds_another_law(unit: str, change: str, other: str, shipped: Path, tmp_path: Path) -> None:
    """One number of a table, or the limit of the commands."""
    folder = Path(shutil.copytree(shipped, tmp_path / "other"))
    text = (folder / unit).read_text("utf-8")
    assert change in text
    (folder / unit).write_text(text.replace(change, other, 1), "utf-8")
    assert "values differ" in self_test(folder, "gcc", *FLAGS).stdout


@with_gcc
def test_undefined_behaviour_and_memory(shipped: Path) -> None:
    done = self_test(shipped, "gcc", "-O1", "-g", "-fsanitize=address,undefined", "-fno-sanitize-recover=all")
    assert done.returncode == 0, done.stderr


@pytest.mark.skipif(
    shutil.which("aarch64-linux-gnu-gcc") is None or shutil.which("qemu-aarch64") is None,
    reason="no cross compiler and emulator of AArch64",
)
def test_aarch64_has_the_same_bits(shipped: Path) -> None:
    for level in ("-O0", "-O3"):
        options = *STRICT, level, "-ffp-contract=off", "-static"
        done = self_test(shipped, "aarch64-linux-gnu-gcc", *options, emulator="qemu-aarch64")
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


OK, NOT_FINITE, SATURATED, FADING, REFUSED = 0, 1, 2, 4, 8
"""Status of a step, as in los_flight.h."""


@with_gcc
def test_a_step_says_what_fault_handling_needs(shipped: Path) -> None:
    """Values that are not finite until a reset, commands at their limits, commands on a fade."""
    library = ctypes.CDLL(str(build(shipped, "gcc", "-O2")))
    memory, zeros = ctypes.create_string_buffer(1 << 14), np.zeros(22)
    estimate, command = np.zeros(ESTIMATES), np.zeros(COMMANDS)

    def observer(measurement: FloatArray) -> int:
        return int(library.los_k_fsm_step(memory, pointer(measurement), pointer(estimate)))

    library.los_k_fsm_init(memory)
    odd = zeros.copy()
    odd[0] = np.nan
    frame = zeros.copy()
    frame[COLUMNS[CAMERA_PORT]] = np.nan
    assert [observer(values) for values in (zeros, frame, odd, zeros)] == [OK, OK, NOT_FINITE, NOT_FINITE]
    library.los_k_fsm_reset(memory)
    assert observer(zeros) == OK

    def law(angle: float, accel: float = 0.0) -> int:
        given = np.full(ESTIMATES, angle), np.full(6, accel)
        return int(library.los_controller_step(memory, *map(pointer, given), pointer(command)))

    library.los_controller_init(memory)
    assert [law(1e-9), law(1.0), law(np.nan), law(1e-9)] == [OK, SATURATED, NOT_FINITE, OK]
    assert [law(0.0, np.inf) & NOT_FINITE, law(0.0) & NOT_FINITE] == [NOT_FINITE] * 2, "K_PMA has a state"
    library.los_controller_reset(memory)
    assert law(0.0) == OK
    library.los_controller_switch(memory, STAGES.index("fsm"))
    assert [law(1e-9) for _ in range(21)] == [*[FADING] * 19, OK, OK]


@with_gcc
def test_arguments_that_cannot_be_are_refused(shipped: Path) -> None:
    library = ctypes.CDLL(str(build(shipped, "gcc", "-O2")))
    memory, command = ctypes.create_string_buffer(1 << 14), np.zeros(COMMANDS)
    library.los_controller_init(memory)
    for limits in ((np.nan, 1.0), (1.0, np.nan), (0.0, 1.0), (1.0, -1.0)):
        assert library.los_controller_limit(memory, *map(ctypes.c_double, limits)) == REFUSED
    given = np.full(ESTIMATES, 1.0), np.zeros(6)
    assert library.los_controller_step(memory, *map(pointer, given), pointer(command)) == SATURATED
    assert np.abs(command[:2]).max() == laws_of().authority[0], "the limits are those of before"
    library.los_fade_weight.restype = ctypes.c_double
    assert [library.los_fade_weight(place) for place in (-(2**31), -1, 0, 20, 21, 2**31 - 1)] == [0, 0, 0, 1, 0, 0]


class Gate(ctypes.Structure):
    """los_gate of los_flight.h."""

    _fields_ = (
        ("size", ctypes.c_int),
        ("limit", ctypes.c_double),
        ("held", ctypes.c_double * 6),
        ("last_stamp", ctypes.c_int64),
        ("ramp", ctypes.c_int),
    )


@with_gcc
@pytest.mark.parametrize("ramp", [-1, 21, 2**31 - 1, -(2**31)])
def test_a_place_on_the_fade_that_is_none_gives_zero_and_fades_in(shipped: Path, ramp: int) -> None:
    """Memory that was changed must not be an index: with sanitizers it would end here."""
    library = ctypes.CDLL(str(build(shipped, "gcc", "-O1")))
    gate, tick, applied = Gate(), 1_000_000, np.full(6, 7.0)
    library.los_gate_init(ctypes.byref(gate), 0, ctypes.c_int64(tick))
    gate.held[0], gate.ramp = 1e-3, ramp
    statuses = []
    for k in range(1, 25):
        gate.last_stamp = k * tick
        statuses.append(library.los_gate_step(ctypes.byref(gate), ctypes.c_int64((k + 1) * tick), pointer(applied)))
        assert k > 1 or 0 <= applied[0] < 1e-5
    assert statuses == [REFUSED | FADING, *[FADING] * 18, *[OK] * 5] and applied[0] == 1e-3


DEVIATIONS = {"2.4", "2.5", "5.7", "5.9", "8.7", "8.9", "8.11", "15.5"}
"""Rules of MISRA C:2012 that the code deviates from, all advisory but 5.7.

2.4, 2.5: an enumeration for constants, a macro for the caller. 5.7: enumerations without a tag. 5.9, 8.9: names and
tables of file scope in several units. 8.7, 8.11: for the caller alone, texts without a length. 15.5: several returns.
"""

FLOAT = ["-DFLT_RADIX=2", "-DDBL_MANT_DIG=53", "-DDBL_MAX_EXP=1024", "-DFLT_EVAL_METHOD=0"]
GROUPS = ("bugprone", "cert", "clang-analyzer", "misc", "performance", "portability")
CHECKS = ",".join(["-*", *(f"{group}-*" for group in GROUPS), "-bugprone-easily-swappable-parameters"])
UNIT_FILES = [f"{unit}.c" for unit in UNITS]


@pytest.fixture(scope="module")
def flight(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write(laws_of(), tmp_path_factory.mktemp("flight") / "code", LIBRARY)


@pytest.mark.skipif(shutil.which("clang-tidy") is None, reason="no clang-tidy")
def test_clang_tidy_finds_nothing(flight: Path) -> None:
    line = ["clang-tidy", "--quiet", f"--checks={CHECKS}", "--warnings-as-errors=*", *UNIT_FILES, "--", "-std=c99"]
    done = subprocess.run(line, cwd=flight, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout


@pytest.mark.skipif(shutil.which("cppcheck") is None, reason="no cppcheck")
def test_cppcheck_finds_the_listed_deviations_of_misra_alone(flight: Path) -> None:
    line = ["cppcheck", "--std=c99", "--enable=style,warning,performance,portability", "--addon=misra", *FLOAT]
    line += ["--quiet", "--template={file}:{line}: {id}", *UNIT_FILES]
    found = subprocess.run(line, cwd=flight, capture_output=True, text=True).stderr.splitlines()
    rules = [match[1] for text in found if (match := re.search(r": misra-c2012-([\d.]+)$", text))]
    assert len(rules) == len(found), [text for text in found if "misra" not in text]
    assert rules and set(rules) <= DEVIATIONS


@pytest.mark.skipif(not (shutil.which("valgrind") and shutil.which("gcc")), reason="no valgrind or gcc")
def test_a_step_takes_the_same_instructions_for_all_values(flight: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """All loops have fixed bounds: what a step costs depends on absent samples and limits by a few instructions."""
    monkeypatch.syspath_prepend(str(ROOT / "benchmarks"))
    cost = script(ROOT / "benchmarks/flight_cost.py")
    (flight / "main.c").write_text(cost.MAIN)
    line = ["gcc", "-std=c99", "-O2", "-ffp-contract=off", "main.c", *UNIT_FILES, "-o", "main", "-lm"]
    subprocess.run(line, cwd=flight, check=True)
    counts = [cost._calls(flight, "los_k_fsm_step", value) for value in cost.CASES.values()]
    assert 2 * 1056 < min(counts) <= max(counts) < 1.02 * min(counts)
