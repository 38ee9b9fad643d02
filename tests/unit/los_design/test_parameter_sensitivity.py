"""Which parameter drives a worst case: derivatives and ranges, by the loop's own gains and by a law of scale."""

from __future__ import annotations

import numpy as np
import pytest
from support.command_line import refused

from los_design.search.parameter_sensitivity import changed_entry, effects_of_box, effects_of_entries
from los_design.search.worst_points import load_worst_points
from los_design.synthesis.store import load_designs
from los_design.verification.loop_models import figures_of
from los_loop.implemented_loop import ImplementedLoop
from los_loop.open_loop import OpenLoop
from titop_plant.telescope.control_plant import control_loop_plant
from titop_plant.telescope.load import load_telescope

STAGE = "fsm+pma"


@pytest.fixture(scope="module")
def loop() -> ImplementedLoop:
    telescope = load_telescope()
    open_loop = OpenLoop(control_loop_plant(telescope), telescope)
    return ImplementedLoop(open_loop, *load_designs("implemented"), STAGE)


def test_slopes_are_those_of_the_gain_and_ranges_hold_its_values(loop: ImplementedLoop) -> None:
    worst, metric = load_worst_points()[STAGE]["slow"], figures_of(loop.telescope, STAGE)["slow"]
    found = {effect.parameter: effect for effect in effects_of_box(loop, metric, worst)}
    assert set(found) == set(loop.names)
    point = loop.point(dict(worst.parameters))
    closed = loop.at(worst.omega)
    for k, name in enumerate(loop.names):
        effect, step = found[name], np.where(point < 0.5, 1.0, -1.0) * (np.arange(len(point)) == k)
        here, beside = loop.gains(closed, metric, np.array([point, point + 1e-5 * step]))
        assert effect.slope == pytest.approx((beside - here) / (1e-5 * step[k]) / here, rel=1e-3, abs=1e-3)
        other = loop.gains(closed, metric, np.array([np.where(step != 0.0, 0.25, point)]))[0]
        assert effect.least <= effect.value <= effect.largest and other <= effect.largest + 1e-12
    spans = [effect.largest - effect.least for effect in found.values()]
    assert spans == sorted(spans, reverse=True)


def test_a_per_cent_of_all_disturbances_is_a_per_cent_of_the_figure(loop: ImplementedLoop) -> None:
    """The fast worst tone is of the wheels, whose weight multiplies it."""
    worst, metrics = load_worst_points()[STAGE]["fast"], figures_of(loop.telescope, STAGE)
    (effect,) = effects_of_entries([loop], {STAGE: metrics}, [worst], ["weights.wheel_imbalance"])
    assert effect.slope == pytest.approx(0.01, rel=1e-3)
    assert effect.largest / effect.value == pytest.approx(1.01, rel=1e-4)
    assert effect.least / effect.value == pytest.approx(0.99, rel=1e-4)


@pytest.mark.parametrize("entry", ["isolator", "isolator.nothing", "nothing.stiffness", "camera.noise_curve"])
def test_what_is_no_entry_of_numbers_is_refused_in_one_line(entry: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(ValueError, match="must be TABLE"):
        changed_entry(load_telescope(), entry, 1.0)
    assert entry in refused(capsys, "design", "sensitivity", "--entry", entry)
