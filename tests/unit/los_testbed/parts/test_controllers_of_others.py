"""Controllers from .mat files and from python-control fly as those of their JSON files do."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from los_testbed.config.run_config import RunConfig
from los_testbed.parts.run_parts import RunParts
from los_testbed.run.loop.simulate import run_in_process

import fsm_pma_controller
import los_estimator
from lftkit import System
from lftkit.systems.exchange import as_system, read_sampled
from lftkit.systems.mat_files import write_mat
from lftkit.systems.sampled.sampled_system import SampledSystem
from pointing_analysis.read.run import Run

DESIGNS = {
    "k_fsm": Path(los_estimator.__file__).parent / "designs/k_fsm.json",
    "k_pma": Path(fsm_pma_controller.__file__).parent / "designs/k_pma.json",
}


def los(folder: Path, **settings: str) -> np.ndarray:
    config = RunConfig(mode="inprocess", duration=0.3, start="rest", scenario="imbalance", loop="fsm+pma", **settings)
    RunParts(config).check()
    run_in_process(config, folder)
    return np.asarray(Run.open(folder)["truth/los"].values)


def test_a_mat_file_flies_as_its_json_file(tmp_path: Path) -> None:
    given = {}
    for name, path in DESIGNS.items():
        write_mat(tmp_path / f"{name}.mat", K=as_system(SampledSystem.from_file(path)))
        given[name] = str(tmp_path / f"{name}.mat")
        read, stored = read_sampled(given[name]), SampledSystem.from_file(path)
        assert [(p.name, p.size) for p in read.inputs] == [(p.name, p.size) for p in stored.inputs]
        assert all(np.array_equal(getattr(read, key), getattr(stored, key)) for key in "ABCD") and read.dt == stored.dt
    assert np.array_equal(los(tmp_path / "mat", **given), los(tmp_path / "json"))
    attached = Run.open(tmp_path / "mat").attachments["k_fsm.json"]
    (tmp_path / "again.json").write_bytes(attached)
    assert np.array_equal(
        SampledSystem.from_file(tmp_path / "again.json").A, SampledSystem.from_file(DESIGNS["k_fsm"]).A
    )


def test_a_continuous_controller_is_refused(tmp_path: Path) -> None:
    write_mat(tmp_path / "a.mat", K=System([[-1.0]], [[1.0]], [[1.0]], [[0.0]], [("u", 1)], [("y", 1)]))
    with pytest.raises(ValueError, match="must have its sampling period Ts in s, got a continuous one"):
        read_sampled(tmp_path / "a.mat")


def test_systems_of_python_control_fly_as_code(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    lines = ["from pathlib import Path", "from lftkit.systems.sampled.sampled_system import SampledSystem"]
    lines += [f"{name} = SampledSystem.from_file({str(path)!r}).to_control()" for name, path in DESIGNS.items()]
    Path("laws_of_control.py").write_text("\n".join(lines) + "\n")
    as_code = los(tmp_path / "code", k_fsm="laws_of_control:k_fsm", k_pma="laws_of_control:k_pma")
    assert np.allclose(as_code, los(tmp_path / "json"), rtol=1e-9, atol=1e-18)
