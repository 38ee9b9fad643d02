"""The frame rate is a value of the telescope: runs, models, design and proofs have that of its file."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from los_testbed.campaign.member import MemberEvaluator
from los_testbed.campaign.sampling import MemberParameters
from los_testbed.config.run_config import RunConfig
from los_testbed.parts.run_parts import RunParts
from los_testbed.run.loop.simulate import run_in_process

from lftkit.errors import InputError
from los_design.synthesis.options import DesignOptions
from los_design.verification.frames import IMAGES, SEEN
from los_design.verification.loop_models import NYQUIST, frames_of, noise_model
from los_estimator.problem import observer_plant
from los_loop.sampled_loop_norms import tone_response
from pointing_analysis.read.run import Run
from titop_plant.interface import COLUMNS, DT
from titop_plant.telescope.load import load_telescope
from titop_plant.telescope.weights import weight_amplitudes

RATE, TICKS = 25.0, 40


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> str:
    path = tmp_path_factory.mktemp("slow") / "telescope.toml"
    path.write_text(f"base = 'reference'\n[sensors]\ncamera_rate = {RATE}\n", "utf-8")
    return str(path)


def test_a_file_and_the_setting_of_a_run_give_the_same_signals(file: str, tmp_path: Path) -> None:
    base = {"mode": "inprocess", "duration": 0.4, "scenario": "unit_norm", "start": "rest"}
    signals = []
    for name, settings in (("file", {"parameters": file}), ("setting", {"camera_rate": RATE})):
        run_in_process(RunConfig.from_mapping({**base, **settings}), tmp_path / name)
        run = Run.open(tmp_path / name)
        assert np.unique(np.diff(run["camera/los"].stamp)).tolist() == [TICKS * 1_000_000]
        signals.append([run[topic].values for topic in ("camera/los", "los_estimate", "pma/command", "truth/los")])
    for one, other in zip(*signals):
        np.testing.assert_array_equal(one, other)


def test_the_models_of_a_file_are_held_for_its_frames(file: str) -> None:
    """Gain at a tone from the periodic loop against the fundamental: at 25 Hz the hold is 20 ms older than at 50 Hz."""
    parts, camera = RunParts(RunConfig(parameters=file, scenario="unit_norm")), COLUMNS["camera_los"]
    loop = parts.implemented_loop()
    assert loop.control_laws.held_ticks[camera].tolist() == [TICKS] * 2
    noise = np.asarray(noise_model(loop).weights)[camera, 0]
    assert noise == pytest.approx(parts.telescope.camera_noise * np.sqrt(TICKS), rel=1e-12)
    plant, closed = loop.sampled_at({})
    assert closed.frame_ticks == TICKS
    omega = np.array([2.0, 8.0])
    exact = tone_response(closed, plant, omega).fundamental[:, :2]
    size, nominal = weight_amplitudes(parts.telescope, omega), loop.delta(loop.point({}))[None]
    for tone, weight, response in zip(loop.at_each(omega), size, exact):
        modelled = loop.some_responses(tone, nominal, slice(0, 2), slice(0, -8))[0]
        np.testing.assert_allclose(modelled / weight, response, atol=1e-3 * np.abs(response).max())
    bands = {name: metric.band for name, metric in frames_of(parts.telescope, "fsm", parts.ports).items()}
    assert bands == {SEEN: (0.0, NYQUIST / TICKS), IMAGES: (NYQUIST / TICKS, NYQUIST)}


def test_the_design_has_the_mean_age_of_its_frames(file: str) -> None:
    """Phase of a slow signal of the camera between the two rates: half of the difference of their periods."""
    omega, phase = 1e-2, []
    for telescope in (load_telescope(), load_telescope(file)):
        plant = observer_plant(telescope, **DesignOptions().hold_delays).system.at({})
        part = plant.select(inputs=("optical_noise",), outputs=("camera_los",))
        gain = part.D + part.C @ np.linalg.solve(1j * omega * np.eye(len(part.A)) - part.A, part.B)
        phase.append(np.angle(gain[0, 0]))
    assert (phase[0] - phase[1]) / omega == pytest.approx(0.5 * (TICKS - 20) * DT, rel=1e-4)


def test_the_name_of_a_telescope_has_its_rate(file: str) -> None:
    reference = load_telescope()
    assert reference.changed({"sensors": {"camera_rate": 50.0}}).digest == reference.digest
    assert load_telescope(file).digest != reference.digest


def test_a_rate_that_does_not_divide_the_ticks_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "telescope.toml"
    path.write_text("base = 'reference'\n[sensors]\ncamera_rate = 30.0\n", "utf-8")
    with pytest.raises(InputError, match=r"line 3: 'sensors.camera_rate' must divide 1000 Hz .*, got 30.0 Hz"):
        load_telescope(path)


def test_a_campaign_at_depth_model_has_the_rate_of_its_runs() -> None:
    columns = []
    for rate in (50.0, 10.0):
        base = RunConfig(mode="inprocess", camera_rate=rate, scenario="unit_norm")
        known = MemberParameters.of(base.parameters)
        middle = {name: 0.5 * sum(known.ranges[of]) for name, of in zip(known.columns, known.ranges)}
        row = MemberEvaluator.of(base).row(0, {**middle, "seed": 1}, "model")
        assert row["status"] == "ok", row["reason"]
        columns.append(row["noise_rpe_mas_rms"])
    assert columns[1] > 1.1 * columns[0]
