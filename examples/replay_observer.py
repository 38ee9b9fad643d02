"""Drive a user-defined observer with the sensors of a bag; compare its knowledge error with the recorded estimate's.

    python examples/replay_observer.py [BAG]

An observer is any object with ``step(measurement, out)`` and ``reset()``. The replayed controller's commands are
computed, but the recorded plant does not respond to them.
"""

import sys
import tempfile
from pathlib import Path

import numpy as np

from pointing_analysis.indices.errors import RAD_PER_MAS, knowledge_error, knowledge_error_of
from pointing_analysis.indices.metrics import radial
from pointing_analysis.indices.synthetic import write_bag
from pointing_analysis.read.run import Run
from pointing_analysis.replay import replay

LAYOUT = replay.LoopLayout(
    columns={"camera/los": slice(0, 2), "fsm/strain_gauge": slice(2, 4), "isolator/accel": slice(4, 10)},
    held=("camera/los",),
    observer=("camera/los", "fsm/strain_gauge"),
    controller=("isolator/accel",),
    commands={"fsm/command": slice(0, 2), "pma/command": slice(2, 8)},
)


class CameraOnly:
    """Holds the last camera frame minus the mirror's contribution; does not use the accelerometers."""

    def __init__(self):
        self.reset()

    def reset(self):
        self.los = np.zeros(2)

    def step(self, measurement, out):
        frame, mirror = measurement[:2], measurement[2:]
        if np.isfinite(frame).all():
            self.los = frame - 0.1 * mirror
        out[:] = self.los


class MirrorLaw:
    """u = -LOS / 0.1, no forces."""

    def reset(self):
        pass

    def step(self, los_estimate, accel_Ip, out):
        out[:2] = -los_estimate / 0.1
        out[2:] = 0.0


def synthetic(path):
    """A slow motion, measured by the camera at 50 Hz; the recorded estimate has a delay of 5 ms."""
    n = 5000
    t = 1e-3 * np.arange(n)
    truth = 2000 * RAD_PER_MAS * np.column_stack([np.sin(3 * t), np.cos(2 * t)])
    signals = {name: np.zeros((n, 6)) for name in ("isolator/accel", "m1/accel", "m2/accel")}
    signals |= {"fsm/strain_gauge": np.zeros((n, 2)), "camera/los": truth[::20], "truth/los": truth}
    signals["los_estimate"] = np.vstack([np.repeat(truth[:1], 5, axis=0), truth[:-5]])
    return write_bag(path, signals, periods={"camera/los": 20})


with tempfile.TemporaryDirectory() as folder:
    run = Run.open(sys.argv[1] if len(sys.argv) > 1 else synthetic(Path(folder) / "bag"))
    replayed = replay.replay(run, CameraOnly(), MirrorLaw(), LAYOUT)
    print(replay.compare(run, replayed))
    recorded = radial(knowledge_error(run).values)
    print(f"knowledge error of the recorded estimate: {np.sqrt(np.nanmean(recorded**2)) / RAD_PER_MAS:.1f} mas rms")
    own = radial(knowledge_error_of(run, replayed.stamp, replayed.estimate).values)
    print(f"of the camera alone, held between frames: {np.sqrt(np.nanmean(own**2)) / RAD_PER_MAS:.1f} mas rms")
