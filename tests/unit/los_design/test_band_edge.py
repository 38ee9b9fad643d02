"""The edge between slow and fast tones is a value of the telescope: figures, tuner, search, proofs, weights have it."""

from __future__ import annotations

import math
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from support.loop_rows import COMMANDS, loop_rows

from los_design.search.worst_case_search import Search
from los_design.synthesis.pair_problem import BOTH, gains, grid
from los_design.synthesis.store import load_designs
from los_design.verification.combined_bounds import fast_pieces
from los_design.verification.error_sum import parts_of_band
from los_design.verification.loop_models import provable
from los_loop.closing import sampled_loop
from los_loop.control_laws import ControlLaws
from los_loop.figures_of_merit import error_names, figure
from los_loop.implemented_loop import ImplementedLoop
from los_loop.member_loop import MemberLoop, MemberLoopSettings
from los_loop.member_metrics import MemberMetrics
from los_loop.open_loop import OpenLoop
from los_loop.worst_tone import worst_tone
from titop_plant.simulation.modal_plant import ModalPlant
from titop_plant.telescope.load import differences, load_telescope
from titop_plant.telescope.telescope import Telescope
from titop_plant.telescope.weights import band_error_weight, rpe_weight

EDGE, STAGE = 40.0, "fsm+pma"


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    file = tmp_path_factory.mktemp("edge") / "mission.toml"
    file.write_text(f"base = 'reference'\n[weights]\nband_edge = {EDGE}\n")
    return file


@pytest.fixture(scope="module")
def own(file: Path) -> Telescope:
    assert differences(file) == [f"weights.band_edge = {EDGE:g}, reference 85"]
    return load_telescope(file)


def test_it_is_in_the_name_unless_it_is_that_of_before(own: Telescope) -> None:
    reference = load_telescope()
    assert own.parameters_hash != reference.parameters_hash
    assert own.changed({"weights": {"band_edge": reference.weights.band_edge}}).digest == reference.digest


@pytest.mark.parametrize("edge", [-1.0, 0.001, 5000.0])
def test_an_edge_beyond_the_frequencies_of_the_loop_is_refused(tmp_path: Path, edge: float) -> None:
    (tmp_path / "mission.toml").write_text(f"base = 'reference'\n[weights]\nband_edge = {edge}\n")
    with pytest.raises(ValueError, match=rf"weights.band_edge. must be between 0.01 and 3000 rad/s, got {edge:.12g}"):
        load_telescope(tmp_path / "mission.toml")


def test_figures_tuner_and_proofs_are_split_there(own: Telescope) -> None:
    assert figure("slow").band_of(own) == (0.0, EDGE) and figure("fast").band_of(own) == (EDGE, math.inf)
    around = np.array([EDGE * (1.0 - 1e-9), EDGE])
    seen = {gain.name.split(" ")[-1]: gain.scale(around) > 0.0 for gain in gains(own, (BOTH,))}
    assert seen["slow"].tolist() == [True, False] and seen["fast"].tolist() == [False, True]
    assert EDGE in grid(own.weights.band_edge)
    figures = provable(own, STAGE, own.loop_ports.used_by())
    assert (figures["slow"].band[1], figures["fast"].band[0]) == (EDGE, EDGE)
    first, *_ = parts = parts_of_band(own)
    assert parts[first][0] == EDGE and set(parts) < set(figures)
    turn, bound = fast_pieces(own, {"fast": 0.5, first: 0.1})[0]
    assert turn == EDGE * own.weights.rpe_window and bound == pytest.approx(0.1, rel=0.045)


def test_the_weight_of_a_band_halves_the_power_there(own: Telescope) -> None:
    whole = float(rpe_weight(EDGE, own.weights.rpe_window))
    for band in ("slow", "fast"):
        gain = abs(complex(band_error_weight(own, band).at({})(1j * EDGE)[0, 0]))
        assert gain == pytest.approx(whole * math.sqrt(0.5), rel=1e-9)


@pytest.mark.further
def test_search_worst_tone_and_members_look_in_its_bands(
    own: Telescope, system, monkeypatch: pytest.MonkeyPatch
) -> None:
    few = MemberLoopSettings(draws=4)  # only the nominal member is asked for
    monkeypatch.setattr(MemberLoop, "of", partial(MemberLoop.of, settings=few))
    pair = load_designs("implemented")
    search = Search(ImplementedLoop(OpenLoop(system, own, own.loop_ports.used_by()), *pair, STAGE))
    assert EDGE in search.bands and search.metrics["fast"].band[0] == EDGE
    plant = ModalPlant.of(system.at({}), COMMANDS)
    loop = sampled_loop(plant, ControlLaws(*pair, STAGE, loop_rows()))
    found = {index: worst_tone(loop, plant, own, index=index, stage=STAGE).omega for index in error_names()}
    assert found["slow"] <= EDGE <= found["fast"]
    above = own.changed({"weights": {"band_edge": 150.0}})
    first, other = (MemberMetrics.of(one, *pair, STAGE).metrics({}) for one in (load_telescope(), above))
    assert 85.0 < first["rpe_peak_rad_s"] < 150.0
    assert other["slow_tone_mas"] == pytest.approx(first["fast_tone_mas"]) and other["fast_tone_mas"] < 18.0


def test_a_run_and_its_budget_of_tones_have_it(file: Path, tmp_path: Path) -> None:
    from los_testbed.config.run_config import RunConfig
    from los_testbed.run.loop.simulate import run_in_process

    from pointing_analysis.read.run import Run

    config = RunConfig(mode="inprocess", duration=0.2, loop="isolator", start="rest", parameters=str(file))
    run_in_process(config, tmp_path / "bag")
    assert Run.open(tmp_path / "bag").parameters["rpe_budget_mas"]["band_edge_rad_s"] == EDGE
