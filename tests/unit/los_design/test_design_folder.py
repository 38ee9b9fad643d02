"""Designs in a folder: what is read, what is made again, what goes on."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from lftkit import SampledSystem
from lftkit.support.job import Job
from los_design.synthesis.design_folder import DesignFolder
from los_design.synthesis.options import DesignOptions
from los_design.synthesis.round_state import RoundState
from los_design.synthesis.starts import zero_controller

PAIR = zero_controller("k-fsm"), zero_controller("k-pma")
OPTIONS = DesignOptions(loop_delay=0.0)


class Maker:
    """Stand-in for a design of the pair in rounds, of which each call makes one."""

    def __init__(self, *ends: str) -> None:
        self.ends, self.rounds = list(ends), list[int]()

    def __call__(self, job: Job) -> list[SampledSystem]:
        state = RoundState.load(job) or RoundState(np.zeros(2))
        RoundState(state.x, state.number + 1).save(job)
        self.rounds.append(state.number + 1)
        provenance = {"status": self.ends.pop(0), "command": "another"}
        return [replace(system, provenance=provenance) for system in PAIR]


def made(folder: Path, maker: Maker, options: DesignOptions = OPTIONS, telescope: str = "a", **given) -> list[str]:
    systems = DesignFolder(folder, telescope, "make it", print).made(["one", "two"], maker, options, given)
    assert all(system.provenance["command"] == "make it" for system in systems)
    return [system.provenance["status"] for system in systems]


def test_a_design_is_made_once(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    maker = Maker("converged")
    assert made(tmp_path, maker) == ["converged"] * 2
    assert capsys.readouterr().out == "one.json: converged\ntwo.json: converged\n"
    before = [(tmp_path / name).read_bytes() for name in ("one.json", "two.json")]
    assert made(tmp_path, maker, replace(OPTIONS, wall_limit=1.0, progress=True)) == ["converged"] * 2
    assert before == [(tmp_path / name).read_bytes() for name in ("one.json", "two.json")]
    assert maker.rounds == [1] and [path.name for path in (tmp_path / "build").iterdir()] == ["two.json"]


@pytest.mark.parametrize("change", ["telescope", "options", "given", "file"])
def test_another_design_is_made_anew(tmp_path: Path, change: str) -> None:
    maker = Maker("converged", "rounds")
    made(tmp_path, maker, k_fsm=PAIR[0])
    if change == "file":
        (tmp_path / "one.json").unlink()
    options = replace(OPTIONS, seed=1) if change == "options" else OPTIONS
    given = replace(PAIR[0], D=PAIR[0].D + 1.0) if change == "given" else PAIR[0]
    assert made(tmp_path, maker, options, "b" if change == "telescope" else "a", k_fsm=given) == ["rounds"] * 2
    assert maker.rounds == [1, 1]


def test_a_design_that_its_wall_limit_ended_goes_on(tmp_path: Path) -> None:
    maker = Maker("out_of_time", "converged")
    assert made(tmp_path, maker) == ["out_of_time"] * 2
    assert made(tmp_path, maker) == made(tmp_path, maker) == ["converged"] * 2
    assert maker.rounds == [1, 2]
