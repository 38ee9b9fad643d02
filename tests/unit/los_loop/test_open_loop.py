"""The telescope's response to held commands, at its nominal parameters, has the digits of its modes."""

import numpy as np
import pytest

from lftkit.analysis.frequency_response import FrequencyResponse
from los_loop.open_loop import OpenLoop
from titop_plant.interface import COMMANDS, DT
from titop_plant.telescope.control_plant import control_loop_plant
from titop_plant.telescope.load import load_telescope


@pytest.mark.parametrize("omega", [0.3, 85.0, 580.7, 1400.0])
def test_held_commands_reach_every_output_as_through_each_mode(omega: float) -> None:
    """Modes in balanced coordinates, condition 1e3: in metres and microradians it is 1e5 to 1e9."""
    telescope = load_telescope()
    system = control_loop_plant(telescope)
    q = len(system.channels)
    open_loop = OpenLoop(system, telescope)
    held = open_loop.at(np.array([omega]))[0][open_loop.channels :, -COMMANDS:]
    B, C, D = system.B[:, q : q + COMMANDS], system.C[q:], system.D[q:, q : q + COMMANDS]
    modes = FrequencyResponse.of(system.A, B, C, D)
    assert modes.modal
    flow = np.exp(modes.poles * DT)
    exact = (
        modes.left * (np.expm1(modes.poles * DT) / modes.poles / (np.exp(1j * omega * DT) - flow))
    ) @ modes.right + D
    largest = np.abs(exact).max(axis=0)  # of each command: angles and forces have other units
    assert np.all(np.abs(held - exact).max(axis=0) < 3e-11 * largest)
