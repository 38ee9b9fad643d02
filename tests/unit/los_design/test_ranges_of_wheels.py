"""Boxes of searches, samples and proofs where wheels have asymmetric ranges, one speed, or stay at rest."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support.spacecraft import write

from lftkit import write_system
from lftkit.proofs.sampled_loop.bounds import member_gains
from los_design.search.worst_case_search import Search, SearchOptions
from los_design.synthesis.store import load_designs
from los_design.verification.loop_models import box_of, figures_of, telescope_model
from los_loop.implemented_loop import ImplementedLoop
from los_loop.open_loop import OpenLoop
from titop_plant.telescope.assembly import build_telescope
from titop_plant.telescope.control_plant import control_loop_plant
from titop_plant.telescope.load import load_telescope

RANGES = {"wheel_1.speed": (100.0, 300.0), "wheel_3.speed": (-400.0, -50.0), "wheel_5.speed": (-200.0, 200.0)}
AXES = ([1.0, 0.1, 0.4], [1.0, 1.0, 1.0], [0.0, 1.0, 0.3], [0.0, 0.0, 2.0], [1.0, -1.0, 1.0])
SPEEDS = ([100.0, 300.0], [0.0, 0.0], [-400.0, -50.0], [150.0, 150.0], [-200.0, 200.0])


@pytest.fixture(scope="module")
def loop(tmp_path_factory: pytest.TempPathFactory) -> ImplementedLoop:
    wheels = [
        {"name": f"w{i}", "axis": axis, "speed_range": ends, "default_speed": ends[0]}
        for i, (axis, ends) in enumerate(zip(AXES, SPEEDS))
    ]
    telescope = load_telescope(write(tmp_path_factory.mktemp("ranges"), {"reaction_wheel": wheels}))
    return ImplementedLoop(
        OpenLoop(control_loop_plant(telescope), telescope, telescope.loop_ports.used_by()),
        *load_designs("implemented"),
        "fsm",
    )


def test_the_boxes_of_searches_and_proofs_are_the_ranges(loop: ImplementedLoop) -> None:
    ends = dict(zip(loop.names, zip(loop.open.low, loop.open.low + loop.open.width)))
    assert {name: ends[name] for name in RANGES} == RANGES and len(loop.names) == 6
    found = dict(zip(loop.names, box_of(loop)))
    assert [found[name] for name in RANGES] == [(-100.0, 100.0), (-175.0, 175.0), (-200.0, 200.0)]
    assert loop.telescope.box["wheel_3.speed"] == (-400.0, -50.0) and len(loop.telescope.corners()) == 64
    assert loop.values(loop.point({"wheel_1.speed": 100.0}))["wheel_1.speed"] == 100.0


def test_the_model_of_a_proof_has_the_gains_of_the_loop_at_the_corners(loop: ImplementedLoop) -> None:
    points = np.random.default_rng(2).integers(0, 2, size=(6, 6)).astype(float)
    angle = loop.names.index("solar_array.tau")
    points[:, angle] = np.linspace(0.1, 0.9, 6)
    values = loop.open.low + points * loop.open.width - loop.open.nominal
    values[:, angle] = [4.0 * math.atan(x) for x in values[:, angle]]
    for name, metric in figures_of(loop.telescope, "fsm", loop.ports).items():
        model = telescope_model(loop, metric)
        for omega in (0.5, 12.0, 230.0):
            expected = loop.gains(loop.at(omega), metric, points)
            np.testing.assert_allclose(member_gains(model, omega, values), expected, rtol=1e-5, err_msg=name)


def test_a_worst_point_names_the_wheel_of_the_spacecraft(loop: ImplementedLoop) -> None:
    """The spare has no input: the wheels behind it keep their numbers."""
    search = Search(loop, SearchOptions(ascents=1))
    found = search.confirmed(search.metrics["fast"], 230.0, np.ones(6))
    assert len(found.disturbance) == 22
    names = {replace(found, disturbance=np.eye(22)[k].astype(complex)).channel(loop.telescope) for k in (0, 5, 15, 21)}
    assert names == {"wheel 1, force x", "wheel 3, force x", "wheel 5, force x", "solar array drive 2"}


def test_a_file_of_the_assembly_is_the_same_plant(tmp_path: Path, loop: ImplementedLoop) -> None:

    telescope = loop.telescope
    write_system(tmp_path / "plant.json", build_telescope(telescope).system)
    content = {"plant": {"file": "plant.json"}, "reaction_wheel": telescope.to_mapping()["reaction_wheel"]}
    from_file = load_telescope(write(tmp_path, content))
    assert list(from_file.uncertain) == list(telescope.uncertain) and from_file.box == telescope.box
