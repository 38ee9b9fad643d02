"""The plant of the design problems against the exactly sampled one."""

import numpy as np
import pytest
from scipy import linalg

from lftkit import Port
from lftkit.analysis.frequency_response import frequency_response
from titop_plant.interface import COMMANDED, DT, HOLD_DELAY, MEASURED
from titop_plant.telescope.assembly import assembled_telescope
from titop_plant.telescope.control_plant import (
    DISTURBANCES,
    held_commands,
    sample_hold,
    with_sensors,
)
from titop_plant.telescope.load import load_telescope

COLUMNS = {"mirror": slice(22, 24), "actuators": slice(24, 30)}
ACCELERATIONS, LOS = slice(2, 20), slice(0, 2)


@pytest.fixture(scope="module")
def plant():
    outputs = ("los_controlled", *MEASURED)
    return with_sensors(assembled_telescope().system, load_telescope()).select(
        inputs=(*DISTURBANCES, *COMMANDED), outputs=outputs
    )


def sampled_response(data, omega):
    """Held for a tick and sampled, exactly: the commands' columns only."""
    n, B = len(data.A), data.B[:, 22:]
    step = linalg.expm(np.block([[data.A, B], [np.zeros((8, n + 8))]]) * DT)
    response = np.zeros(data.D.shape, complex)
    z = np.exp(1j * omega * DT)
    response[:, 22:] = data.C @ np.linalg.solve(z * np.eye(n) - step[:n, :n], step[:n, n:]) + data.D[:, 22:]
    return response


def error(trial, exact, rows, columns):
    return np.linalg.norm((trial - exact)[rows, columns]) / np.linalg.norm(exact[rows, columns])


@pytest.mark.parametrize("omega", [0.3, 5.0, 20.0, 100.0])
def test_held_commands_are_close_to_the_sampled_plant_and_one_delay_is_not(plant, omega) -> None:
    exact = sampled_response(plant.at({}), omega)
    held = frequency_response(held_commands(plant, HOLD_DELAY).at({}), [omega])[0]
    one_delay = frequency_response(plant.at({}), [omega])[0] * np.exp(-1j * omega * HOLD_DELAY)
    for columns in COLUMNS.values():
        assert error(held, exact, LOS, columns) < 1e-3
        assert error(held, exact, ACCELERATIONS, columns) < 0.11
        ratio = error(one_delay, exact, ACCELERATIONS, columns) / error(held, exact, ACCELERATIONS, columns)
        assert ratio > 8.0


def test_nothing_is_added_without_a_hold(plant) -> None:
    assert held_commands(plant, 0.0) is plant


def test_a_held_frame_is_as_old_as_the_mean_of_its_ticks() -> None:
    hold = sample_hold(Port("camera_los", 2, "rad"), 0.02).at({})
    for omega in (0.5, 5.0, 30.0):
        mean = np.mean(np.exp(-1j * omega * DT * np.arange(20)))
        phase = np.angle(frequency_response(hold, [omega])[0][0, 0])
        assert phase == pytest.approx(np.angle(mean), rel=1e-3)
