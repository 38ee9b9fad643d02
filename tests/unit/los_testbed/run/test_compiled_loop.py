"""Whole loops in compiled code: the bits of their parts, nothing left to compile, and no need of numba."""

from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from los_testbed.config.run_config import RunConfig
from los_testbed.parts.run_parts import RunParts
from los_testbed.run.loop import compiled_loop
from los_testbed.run.loop.closed_loop import SIGNALS, SampleBlock, SimulatedLoop
from los_testbed.run.loop.compiled_loop import prepare

from titop_plant.simulation import compilation

DESIGN = RunConfig(mode="inprocess", scenario="design", duration=2.3, camera_dropout=0.3, seed=5)
SPEED_UP = {"wheel_acceleration": (8.0, -8.0, 3.0, 0.0)}
CONFIGS = {
    "both laws": DESIGN,
    "mirror": replace(DESIGN, loop="fsm", scenario="imbalance"),
    "no law, hard mount": replace(DESIGN, loop="none", noise=False),
    "ramp": replace(DESIGN, duration=1.2, scenario="ramp", theta_rate=0.01, ramp_duration=1.0, **SPEED_UP),
}

needs_numba = pytest.mark.skipif(compilation.kernel() is None, reason="could not import 'numba'")


def record(parts: RunParts, compiled: bool, monkeypatch: pytest.MonkeyPatch) -> tuple[bytes, bytes]:
    """Signals of a run as bytes, and the state of the plant at its end."""
    plant, estimator, controller = parts.plant(), parts.estimator(), parts.controller()
    estimator.reset()
    controller.reset()
    blocks: list[bytes] = []

    def sink(block: SampleBlock, rows: int) -> None:
        blocks.append(b"".join(getattr(block, name)[:rows].tobytes() for name in SIGNALS))

    monkeypatch.setattr(compiled_loop, "kernel_for", lambda ticks: compilation.kernel() if compiled else None)
    used = parts.used["k_fsm"], parts.used["k_pma"]
    loop = SimulatedLoop(plant, estimator, controller, parts.ports, used, parts.start.command)
    loop.run(parts.config.ticks, sink)
    return b"".join(blocks), plant.state.tobytes()  # type: ignore[attr-defined]


@needs_numba
@pytest.mark.parametrize("name", CONFIGS)
def test_a_loop_in_compiled_code_has_the_bits_of_its_parts(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    parts = RunParts(CONFIGS[name])
    assert record(parts, True, monkeypatch) == record(parts, False, monkeypatch)


@needs_numba
def test_what_is_prepared_is_all_that_runs_need(monkeypatch: pytest.MonkeyPatch) -> None:
    """A run with other types of arrays than the prepared ones would compile the loop once more."""
    assert prepare()
    compiled = compilation.kernel()
    assert compiled is not None
    for name in ("both laws", "ramp"):
        record(RunParts(replace(CONFIGS[name], duration=1.1)), True, monkeypatch)
    functions = compiled.loop, compiled.advance, compiled.between, compiled.turn
    assert [len(function.signatures) for function in functions] == [1, 1, 1, 1]


@needs_numba
def test_no_product_is_fused_with_a_sum() -> None:
    """Compiled anew, since code from the cache has no listing."""
    import numba

    compiled = compilation.kernel()
    assert compiled is not None
    fresh = numba.njit(compiled._add.py_func)
    sums = np.zeros(40)
    fresh(np.ones((20, 40)), 0, np.ones(20), sums)
    assert sums.tolist() == [20.0] * 40
    text = "".join([*fresh.inspect_asm().values(), *fresh.inspect_llvm().values()])
    assert "mulpd" in text or "fmul" in text
    assert "fmadd" not in text and "fmla" not in text and "contract" not in text and " fast " not in text


CODE = """
import sys
{before}
from los_testbed.config.run_config import RunConfig
from los_testbed.parts.run_parts import RunParts
from titop_plant.simulation.compilation import kernel
parts = RunParts(RunConfig(scenario="imbalance", start="rest", loop="isolator", duration=0.1))
import numpy as np
plant, y, truth = parts.plant(), np.zeros(22), np.zeros(2)
plant.compile()
for _ in range(50):
    plant.step(np.ones(8), y, truth)
print(kernel() is None, plant.state.tobytes().hex())
"""


def ran(before: str, **environment: str) -> tuple[str, str]:
    done = subprocess.run(
        [sys.executable, "-c", CODE.format(before=before)],
        capture_output=True,
        text=True,
        check=True,
        env={**os.environ, **environment},
    )
    compiled, state = done.stdout.split()
    return compiled, state


@needs_numba
@pytest.mark.parametrize(
    ("before", "environment"),
    [
        ("sys.modules['numba'] = None", {}),
        pytest.param("", {"NUMBA_CACHE_DIR": "/proc/nowhere"}, marks=pytest.mark.further),
    ],
    ids=["without numba", "without a folder for its cache"],
)
def test_without_numba_or_a_folder_for_its_cache_the_bits_are_the_same(
    before: str, environment: dict[str, str], capsys: pytest.CaptureFixture[str]
) -> None:
    exec(CODE.format(before=""), {})
    usual, other = capsys.readouterr().out.split(), ran(before, **environment)
    assert (usual[0], other[0]) == ("False", str(bool(before))) and usual[1] == other[1]
