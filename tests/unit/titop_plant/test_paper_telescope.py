"""The telescope of examples/paper: what the paper says of its own, as numbers."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from los_loop.continuous_loop import continuous_open_loop
from titop_plant.disturbances.responses import DRIVES, WHEELS, disturbance_responses
from titop_plant.telescope.assembly import assembled_telescope
from titop_plant.telescope.load import load_telescope

FILE = str(Path(__file__).parents[3] / "examples" / "paper" / "telescope.toml")
ARCSEC = np.pi / 648000.0
BANDS = (1.0, 6.0, 10.0, 30.0, 100.0, 300.0, 1000.0)
OCCURRENCES = {"solar_array.omega_1": 4, "solar_array.omega_2": 4, "solar_array.tau": 32}


def decades(file: str | None) -> list[float]:
    """Median over each band of the decades by which the wheels exceed the drives, resonances in each hundredth."""
    both, found = disturbance_responses(load_telescope(file)), []
    for low, high in pairwise(BANDS):
        edges = np.geomspace(low, high, round(100 * np.log10(high / low)) + 1)
        wheels, drives = (both.weighted(both.isolated, {}, of, low, high).columns(edges) for of in (WHEELS, DRIVES))
        found.append(float(np.median(np.log10(wheels / drives))))
    return found


def test_order_and_occurrences() -> None:
    """204 and 2, 2, 2, 2, 4, 4, 32."""
    system = assembled_telescope(load_telescope(FILE)).system
    assert system.order == 204
    assert system.occurrences() == {**{f"wheel_{i}.speed": 2 for i in range(1, 5)}, **OCCURRENCES}


@pytest.mark.further
def test_wheels_are_up_to_three_decades_above_the_drives_below_100_rad_s() -> None:
    """In each band, not at one frequency; above 100 rad/s the two come closer. The reference has other drives."""
    found = decades(FILE)
    assert all(value > 1.5 for value in found[:4]) and 2.5 < max(found[:4]) < 3.5
    assert found[5] < 1.1 and found[5] < found[4] < 2.1
    assert decades(None)[3] < 1.0


def test_the_open_loop_needs_more_than_the_mirror_by_what_the_pairs_of_figures_say() -> None:
    """Reach 109.3 arcsec; 10 arcsec times the APE of a nominal and of a robust design more, 0.7115 and 0.9857."""
    telescope = load_telescope(FILE)
    loop, rng = continuous_open_loop(telescope), np.random.default_rng(0)
    points = rng.uniform(size=(2000, len(loop.names)))
    points = np.where(rng.uniform(size=points.shape) < 0.6, np.round(points), points)
    points[0] = loop.point({})
    omega = np.geomspace(0.055, 0.065, 7)
    size = np.max(
        [
            np.linalg.norm(loop.closed_over(lft, points)[:, -2:, : loop.disturbances], 2, axis=(1, 2))
            for lft in loop.at(omega)
        ],
        axis=0,
    )
    reach = telescope.fsm.authority * telescope.fsm.los_sensitivity
    limit = telescope.weights.ape_limit
    assert size[0] / ARCSEC == pytest.approx(116.4, abs=0.1)
    assert (size[0] - reach) / limit == pytest.approx(0.7115, rel=0.02)
    assert (size.max() - reach) / limit == pytest.approx(0.9857, rel=0.02)
