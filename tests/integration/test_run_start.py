"""A run starts in the steady state of the loop that runs: nothing decays, from the first tick on."""

from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from los_testbed.config.run_config import RunConfig
from los_testbed.parts.run_parts import RunParts
from los_testbed.parts.start import START_FILE, RunStart
from support.loop_rows import FRAME_TICKS
from support.true_los import true_los
from support.unstable_laws import with_slow_pole

from lftkit.support.threads import THREADS
from pointing_analysis.files.structured_text import load_yaml
from pointing_analysis.indices.metrics import radial, windows
from pointing_analysis.read.run import Run
from titop_plant.interface import DT, STAGES

WHEELS = (300.0, -200.0, 150.0, -400.0)


@pytest.fixture(scope="module")
def biased(tmp_path_factory) -> RunConfig:
    """A telescope whose sensors have their bias and no noise."""
    file = tmp_path_factory.mktemp("biased") / "telescope.toml"
    zeros = ", ".join(["0.0"] * 6)
    file.write_text(
        "base = 'reference'\n"
        f"[sensors]\naccelerometer_noise = [{zeros}]\ncamera_noise = 0.0\nstrain_gauge_noise = 0.0\n",
        "utf-8",
    )
    return RunConfig(duration=4.0, mode="inprocess", parameters=str(file), wheel_speed=WHEELS, tau=0.3)


@pytest.mark.parametrize("loop", STAGES)
def test_a_steady_start_has_no_transient(biased: RunConfig, loop: str) -> None:
    """Tone, its sidebands at the camera's frame rate and the harmonics of the bias: fitted to the last second, they are
    all that the first one holds."""
    config = replace(biased, loop=loop)
    tone = RunParts(config).start.tone
    los, t = true_los(config), DT * np.arange(config.ticks)
    frame = 2.0 * np.pi / (FRAME_TICKS * DT)
    columns = [np.exp(1j * (tone.omega + k * frame) * t) for k in range(-FRAME_TICKS // 2, FRAME_TICKS // 2)]
    columns += [np.exp(1j * k * frame * t) for k in range(FRAME_TICKS // 2 + 1)]
    basis = np.column_stack([part for c in columns for part in (c.real, c.imag)])
    fit = np.linalg.lstsq(basis[-2000:], los[-2000:], rcond=1e-10)[0]
    assert np.abs(los - basis @ fit).max() < 1e-6 * np.abs(los).max()


@pytest.mark.slow
def test_a_start_at_rest_becomes_the_steady_one(biased: RunConfig) -> None:
    """After 200 s; at the beginning the washout's answer to the bias of the accelerometers is many times as large."""
    biased = replace(biased, worst_of="fast")
    steady = true_los(replace(biased, duration=2.0))
    rest = true_los(replace(biased, duration=200.0, start="rest"))
    first, last, same = (np.hypot(*windows(part, DT, 0.02).rpe_rms) for part in (rest[:1000], rest[-2000:], steady))
    assert last == pytest.approx(same, rel=0.02)
    assert radial(rest[2000:6000]).max() > 5.0 * radial(steady).max()
    assert first != pytest.approx(same, rel=0.02)


def test_a_loop_that_is_not_stable_starts_at_rest_and_says_so(tmp_path) -> None:
    chosen = RunParts(RunConfig()).models
    wild = replace(chosen["k_fsm"], C=40.0 * chosen["k_fsm"].C, D=40.0 * chosen["k_fsm"].D)
    start = RunParts(RunConfig(loop="fsm"), {**chosen, "k_fsm": wild}).start
    assert start.states is None and start.tone is not None
    assert "must be stable" in start.note and "rest" in start.note


@pytest.mark.further
def test_a_command_starts_with_the_bits_of_one_thread_whatever_the_environment(tmp_path: Path) -> None:
    """Numpy reads its number of threads when it is imported, and nobody who types a command has set it."""
    environment = {name: value for name, value in os.environ.items() if name != THREADS}
    line = ["--mode", "inprocess", "--duration", "0.1", "--scenario", "imbalance", "--no-report", "--output", "bag"]
    command = [sys.executable, "-m", "los_testbed", "run", *line]
    subprocess.run(command, cwd=tmp_path, env=environment, check=True, capture_output=True, timeout=300)
    run = Run.open(tmp_path / "bag")
    config = RunConfig.from_mapping(load_yaml(run.attachments["run.yaml"].decode(), "run.yaml"))
    assert RunParts(config).start.to_bytes() == run.attachments[START_FILE]


@pytest.mark.parametrize("start", ["steady", "rest"])
def test_a_start_knows_an_unstable_loop(biased: RunConfig, tmp_path: Path, start: str) -> None:
    """A slow pole in K_PMA: with 1.0005 per tick ten seconds look well; where it only listens it does no harm."""
    with_slow_pole(RunParts(biased)).to_file(tmp_path / "k_pma.json")
    config = replace(biased, scenario="unit_norm", start=start, k_pma=str(tmp_path / "k_pma.json"))
    found = {loop: RunParts(replace(config, loop=loop)).start for loop in STAGES}
    assert [loop for loop, one in found.items() if one.unstable] == ["fsm+pma"]
    assert RunStart.from_bytes(found["fsm+pma"].to_bytes()).unstable
