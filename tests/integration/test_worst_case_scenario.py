"""The scenario worst_case runs the disturbance of unit norm that is worst: its tone measures gamma times the limit."""

from __future__ import annotations

import numpy as np
import pytest
from los_testbed.config.run_config import RunConfig
from los_testbed.config.run_settings import of_scenario
from los_testbed.parts.run_parts import RunParts
from support.loop_rows import COMMANDS, loop_rows
from support.true_los import true_los

from los_loop.closing import sampled_loop
from los_loop.control_laws import ControlLaws
from los_loop.worst_tone import INDICES, worst_tone
from titop_plant.interface import DT, STAGES
from titop_plant.simulation.build import plant_and_tones
from titop_plant.simulation.modal_plant import ModalPlant
from titop_plant.telescope.load import load_telescope
from titop_plant.telescope.weights import rpe_weight, weight_amplitudes


def measured(config: RunConfig, omega: float) -> float:
    """Amplitude of the line of sight at the tone [rad], norm of both axes, fitted to the record of a run."""
    t = DT * np.arange(config.ticks)
    basis = np.column_stack([np.cos(omega * t), np.sin(omega * t)])
    fit = np.linalg.lstsq(basis, true_los(config), rcond=None)[0]
    return float(np.sqrt(np.sum(fit**2)))


BOTH = STAGES[-1]


@pytest.mark.parametrize(
    ("loop", "index"),
    [
        pytest.param(loop, index, marks=[pytest.mark.slow] * (loop != BOTH and index != "RPE"))
        for loop in STAGES
        for index in INDICES
    ],
)
def test_the_measured_tone_is_gamma_times_the_limit(loop: str, index: str) -> None:
    """Within 2 %, at the worst parameters of the stage, with the designs that ship."""
    chosen = {"loop": loop, "worst_of": index, "duration": 10.0, "noise": False, "mode": "inprocess"}
    config = RunConfig.from_mapping({**chosen, **of_scenario(chosen)})
    tone, telescope = RunParts(config).start.tone, load_telescope()
    weight = 1.0 if index == "APE" else float(rpe_weight(tone.omega, telescope.weights.rpe_window))
    assert weight * measured(config, tone.omega) == pytest.approx(tone.gamma * tone.limit, rel=0.02)
    norm = np.linalg.norm(tone.amplitude / weight_amplitudes(telescope, tone.omega)[0])
    assert norm == pytest.approx(1.0, rel=1e-12)


def loop_at(config: RunConfig):
    plant = ModalPlant.of(plant_and_tones(RunParts(config).physical)[0], 8)
    chosen = RunParts(config).models
    return sampled_loop(plant, ControlLaws(chosen["k_fsm"], chosen["k_pma"], config.loop, loop_rows(20))), plant


def test_no_other_tone_of_unit_norm_is_worse() -> None:
    """Random frequencies, most of them near the worst one, and random directions, in the time domain."""
    config = RunConfig(loop="fsm", disturbance=False, worst_of="fast")
    telescope = load_telescope()
    loop, plant = loop_at(config)
    worst = worst_tone(loop, plant, telescope, index="fast", stage="fsm")
    rng = np.random.default_rng(8)
    for omega in worst.omega * (1.0 + np.array([0.0, 1e-3, -1e-3, 0.02, -0.3])):
        direction = rng.standard_normal(22) + 1j * rng.standard_normal(22)
        for mix in (0.0, 0.3, 1.0):
            unit = worst.amplitude / weight_amplitudes(telescope, worst.omega)[0] + mix * direction
            amplitude = weight_amplitudes(telescope, omega)[0] * unit / np.linalg.norm(unit)
            los = loop_response(loop, plant, omega, amplitude)
            size = float(rpe_weight(omega, 0.02)) * np.linalg.norm(los)
            assert size <= worst.gain * (1.0 + 1e-6)


def loop_response(loop, plant, omega: float, amplitude: np.ndarray) -> np.ndarray:
    """Phasor of the line of sight by the periodic solve of the tone model, which shares no code with the search."""
    from los_loop.tone_model import ToneModel

    model = ToneModel(loop, plant, np.array([omega]), amplitude[:, None], np.full(COMMANDS, 1.0))
    return model.settled()[:, 0]
