"""Plant and recorder on one host, estimator and controller on another: two network namespaces and a cable."""

import numpy as np
import pytest

pytest.importorskip("rclpy")
from ros_runs import PLANT, config_for
from two_hosts import NotPermittedError, far, near

from pointing_analysis.read import Run

pytestmark = pytest.mark.ros
TICKS = 4000


@pytest.fixture
def hosts(request):
    cable = request.param()
    try:
        hosts = cable.__enter__()
    except NotPermittedError as error:
        pytest.skip(f"network namespaces are not permitted here: {error}")
    yield hosts
    cable.__exit__(None, None, None)


def fly(hosts, folder):
    hosts.fly(config_for(folder, duration=TICKS / 1000), folder, PLANT)
    hosts.unplug()
    return Run.open(folder / "bag")


@pytest.mark.parametrize("hosts", [near], indirect=True)
def test_a_loop_over_two_hosts(hosts, tmp_path):
    run = fly(hosts, tmp_path)
    assert len(run["truth/los"]) == len(run["m1/accel"]) == len(run["fsm/command"]) == TICKS
    assert run["fsm/command"].integrity.missing == 0
    assert np.isfinite(run["fsm/command"].values).all()


@pytest.mark.parametrize("hosts", [far], indirect=True)
def test_a_loop_over_two_hosts_with_a_bad_cable(hosts, tmp_path):
    """A lost sample costs its own tick and no other: nothing waits until it was sent again."""
    run = fly(hosts, tmp_path)
    statistics = run.parameters["statistics"]
    assert hosts.lost == pytest.approx(1e-3 * (hosts.carried + hosts.lost), rel=0.5), "as bad as it is meant to be"
    assert hosts.lost > 10
    assert len(run["truth/los"]) == len(run["m1/accel"]) == TICKS, "nothing is lost on the plant's own host"
    assert float(statistics["plant"]["latency_median_us"]) > 400, "twice 0.2 ms"
    gaps = int(statistics["estimator"]["gap_ticks"])
    assert 0 < gaps <= 2 * hosts.lost
    commands = run["fsm/command"]
    assert len(commands) >= TICKS - int(statistics["controller"]["gap_ticks"]) - 5
    assert np.isfinite(commands.values).all()
