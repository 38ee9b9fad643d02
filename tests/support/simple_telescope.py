"""A small telescope for tests of the loop: one payload that turns, one mirror, noise, a tone.

It has the interface of the real plant and none of its physics worth the name, and is built at once.
Run as a script it is the plant node of a ROS run with this telescope.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

from lftkit.systems.sampled.sampled_system import SampledSystem
from titop_plant.interface import DT, K_FSM_INPUTS, K_FSM_OUTPUTS, K_PMA_INPUTS, K_PMA_OUTPUTS


class SimpleTelescope:
    """Line of sight: a slow drift, a tone of 3 Hz and a tenth of the mirror's angle, two axes."""

    def __init__(self, frame_ticks: int = 20, seed: int = 1, noise: bool = True, dropout: float = 0.0) -> None:
        self.frame_ticks = frame_ticks
        self.tones = np.array([2 * np.pi * 3.0])
        self._setting = (seed, noise, dropout)
        self._disturbance = 1.0
        self.reset()

    def reset(self) -> None:
        seed, noise, self._dropout = self._setting
        self._rng = np.random.default_rng(seed)
        self._sigma = 1e-8 if noise else 0.0
        self._tick = 0
        self._disturbance = 1.0
        self.commands: list[np.ndarray] = []

    def change(self, name: str, value: float) -> None:
        if name == "noise":
            self._sigma = 1e-8 if value else 0.0
        elif name == "disturbance":
            self._disturbance = float(value)
        else:
            self._dropout = float(value)

    def step(self, command: np.ndarray, measurement: np.ndarray, truth: np.ndarray) -> None:
        t = DT * self._tick
        los = 1e-5 * self._disturbance * np.array([np.sin(2 * np.pi * 3 * t), np.cos(2 * np.pi * 3 * t)])
        truth[:] = los + 0.1 * np.clip(command[:2], -5.3e-3, 5.3e-3)
        measurement[:] = self._sigma * self._rng.standard_normal(22)
        measurement[4] -= (2 * np.pi * 3) ** 2 * los[0]
        measurement[3] -= (2 * np.pi * 3) ** 2 * los[1]
        measurement[0] += 1e-3 * command[2]
        measurement[18:20] += truth
        measurement[20:22] += command[:2]
        dropped = self._rng.random() < self._dropout
        if self._tick % self.frame_ticks or dropped:
            measurement[18:20] = np.nan
        self._tick += 1


def write_controllers(folder: Path) -> dict[str, str]:
    """A leaky observer of the camera minus the mirror, and a proof-mass law with some dynamics."""
    D = np.zeros((2, 22))
    B = np.zeros((2, 22))
    B[:, 18:20], B[:, 20:22] = 0.02 * np.eye(2), -0.002 * np.eye(2)
    k_fsm = SampledSystem(0.98 * np.eye(2), B, np.eye(2), D, K_FSM_INPUTS, K_FSM_OUTPUTS, DT, "test observer")
    k_pma = SampledSystem(
        0.9 * np.eye(6), 0.1 * np.eye(6), np.eye(6), np.eye(6), K_PMA_INPUTS, K_PMA_OUTPUTS, DT, "test force law"
    )
    k_fsm.to_file(folder / "k_fsm.json")
    k_pma.to_file(folder / "k_pma.json")
    return {"k_fsm": str(folder / "k_fsm.json"), "k_pma": str(folder / "k_pma.json")}


LISTEN_S = 0.3
"""How long the plant of a test listens for another one [s]: there is none, except where that is the subject."""


def main(listen_s: float = LISTEN_S) -> int:
    from los_testbed.nodes import plant
    from los_testbed.nodes.support import handshake

    handshake.LISTEN_S = listen_s
    return plant.main(
        sys.argv[1:],
        build=lambda config: SimpleTelescope(config.frame_ticks, config.seed, config.noise, config.camera_dropout),
    )


if __name__ == "__main__":
    sys.exit(main())
