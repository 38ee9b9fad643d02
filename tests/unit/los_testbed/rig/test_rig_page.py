"""The driver of docs/connect_your_rig.md: what `device check` says of it is what the page says."""

import re
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from los_testbed.config.run_config import RunConfig
from los_testbed.parts.run_parts import RunParts
from los_testbed.rig.check import faults, judge
from los_testbed.rig.motions import model_response, peaks_of, record
from los_testbed.rig.supervisor import Supervisor, SupervisorSettings
from los_testbed.run.loop.slow_sensor import SlowSensor

from titop_plant.interface import CAMERA_PORT, TICK_NS

PAGE = (Path(__file__).parents[4] / "docs" / "connect_your_rig.md").read_text("utf-8")


class Clock:
    """Clock of the ticks and of the driver, without real time."""

    def __init__(self):
        self.now = 10**9

    def begin(self, first):
        self.now = first

    def wait(self):
        self.now += TICK_NS


@pytest.fixture
def rig(monkeypatch):
    """The driver of the page and its clock."""
    clock, module = Clock(), ModuleType("my_rig")
    exec(re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)[0], module.__dict__)
    monkeypatch.setattr(module.__dict__["time"], "monotonic_ns", lambda: clock.now)
    np.random.seed(3)  # noqa: NPY002 - the page's driver draws from it
    return module.Rig(), clock


@pytest.mark.further
def test_the_driver_has_the_one_fault_that_the_page_names(rig):
    device, clock = rig
    parts = RunParts(RunConfig(start="rest"))
    peaks = peaks_of(parts.basis.authority)
    settings = SupervisorSettings(call=60.0)  # this machine may be slow
    supervisor = Supervisor(device, RunConfig(device="my:Rig", start="rest"), settings)
    supervisor.open()
    found = judge(record(supervisor, peaks, clock, lambda: clock.now), model_response(parts.plant(), peaks))
    assert faults(found) == ("pma_force: dead: moves nothing",) and f"`{faults(found)[0]}`" in PAGE


def test_its_frames_are_on_the_grid_of_the_camera(rig):
    device, clock = rig
    config = RunConfig(device="my:Rig", start="rest", camera_rate=50.0)
    device.open(config)
    camera = SlowSensor("camera", slice(0, 2), config.frame_ticks * TICK_NS)
    rng = np.random.default_rng(5)
    for _ in range(2000):
        clock.now += int(rng.integers(TICK_NS // 2, 3 * TICK_NS))  # read at any time
        for sample in device.read(clock.now):
            if sample.port == CAMERA_PORT:
                camera.note(sample.acquired_ns, sample.acquired_ns // TICK_NS * TICK_NS, clock.now, clock.now + 10**9)
    assert camera.counts["came"] > 100 and not camera.counts["off_phase"]


def test_the_noise_of_the_page_is_that_of_the_model():
    accelerometer, angle = RunParts(RunConfig()).telescope.loop_ports.noise[[0, 3]], 1e-8
    assert accelerometer.tolist() == [1.2e-3, 2.3e-3] and "1.2e-3 m/s² and 2.3e-3 rad/s²" in PAGE
    assert RunParts(RunConfig()).telescope.loop_ports.noise[18:].tolist() == [angle] * 4
