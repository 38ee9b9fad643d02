"""Plant, estimator and controller in one process: one-tick delay, repeatability, speed, a bag."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import simple_telescope
from los_testbed.config.run_config import RunConfig
from los_testbed.parts.run_parts import build_controller, build_estimator
from los_testbed.run.loop.closed_loop import SimulatedLoop
from los_testbed.run.loop.simulate import run_in_process
from simple_telescope import SimpleTelescope, write_controllers
from support.loop_rows import ROWS

from pointing_analysis.read.run import Run


@pytest.fixture
def config(tmp_path):
    return RunConfig(duration=3.0, mode="inprocess", **write_controllers(tmp_path))


class Delayed(SimpleTelescope):
    """Keeps what it was told and measured."""

    def step(self, command, measurement, truth):
        self.commands.append(command.copy())
        super().step(command, measurement, truth)


def test_the_command_of_a_tick_is_applied_at_the_next(config):
    plant, rows = Delayed(), []
    used = ROWS.of_law("k_fsm"), ROWS.of_law("k_pma")
    loop = SimulatedLoop(plant, build_estimator(config), build_controller(config), ROWS, used)
    loop.run(2500, lambda block, n: rows.append(block.command[:n].copy()))
    sent = np.concatenate(rows)
    applied = np.array(plant.commands)
    assert applied.shape == (2500, 8)
    assert not applied[0].any()
    assert np.array_equal(applied[1:], sent[:-1])
    assert np.abs(sent).max() > 0


def test_the_same_seed_gives_the_same_file_and_another_seed_does_not(config, tmp_path):
    files = []
    for name, seed in (("a", 1), ("b", 1), ("c", 2)):
        run_in_process(config, tmp_path / name / "bag", SimpleTelescope(seed=seed))
        files.append((tmp_path / name / "bag" / "bag_0.mcap").read_bytes())
    assert files[0] == files[1]
    assert files[0] != files[2]


def test_the_bag_holds_every_tick_and_says_what_was_run(config, tmp_path):
    statistics = run_in_process(config, tmp_path / "bag", SimpleTelescope(frame_ticks=20, dropout=0.3))
    assert statistics["plant"]["ticks"] == "3000"
    run = Run.open(tmp_path / "bag")
    for name in run.topics:
        assert len(run[name]) == (150 if name == "camera/los" else 3000)
        assert run[name].integrity.missing == 0
    assert 20 < run["camera/los"].integrity.nan < 75
    assert run.parameters["loop"] == "fsm+pma"
    assert run.parameters["seed"] == 1
    assert run.parameters["tones_rad_s"] == [pytest.approx(6 * np.pi)]
    assert set(run.attachments) == {"k_fsm.json", "k_pma.json", "run.yaml", "start.json"}
    assert "plant_hash" not in run.parameters, "another plant than the telescope has announced none"


def test_no_ros_is_imported(config, tmp_path):
    code = (
        "import sys; sys.modules.update(dict.fromkeys(['rclpy', 'geometry_msgs', 'rosgraph_msgs']));"
        "sys.path.insert(0, sys.argv[1]);"
        "from pathlib import Path; from simple_telescope import *;"
        "from los_testbed.config.run_config import RunConfig; from los_testbed.run.loop.simulate import run_in_process;"
        "import los_testbed.cli.app;"
        "p = Path(sys.argv[2]); c = RunConfig(duration=0.1, **write_controllers(p));"
        "run_in_process(c, p / 'bag', SimpleTelescope())"
    )
    support = Path(simple_telescope.__file__).parent
    subprocess.run([sys.executable, "-c", code, str(support), str(tmp_path)], check=True, timeout=600)
