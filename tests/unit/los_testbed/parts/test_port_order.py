"""A controller of MATLAB or python-control is the same law with names in either style, and in order without names."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import Any

import control
import numpy as np
import pytest
from los_testbed.config.run_config import RunConfig
from los_testbed.parts.user_blocks import make_law, read_law
from scipy import io
from support.loop_rows import ROWS

import los_estimator
from lftkit import System
from lftkit.arrays import FloatArray
from lftkit.systems.exchange import read_sampled
from lftkit.systems.mat_files import write_mat
from lftkit.systems.sampled.sampled_system import SampledSystem
from titop_plant.interface import LAW_PORTS

STORED = SampledSystem.from_file(Path(los_estimator.__file__).parent / "designs/k_fsm.json")
NAMES = [[signal for port in side for signal in port.signals] for side in (STORED.inputs, STORED.outputs)]
SHUFFLED = np.random.default_rng(2).permutation(len(NAMES[0]))


def one_based(names: list[str]) -> list[str]:
    return [name.replace(f"[{(n := int(name[-2]))}]", f"({n + 1})") for name in names]


def texts(names: list[str]) -> Any:
    return np.array(names, dtype=object)[:, None]


def answers(law: SampledSystem) -> FloatArray:
    """Outputs of 30 ticks with a random input, in the order of the loop."""
    assert law.inputs == LAW_PORTS["k_fsm"][0]
    out, found, rng = np.zeros(2), [], np.random.default_rng(1)
    law.reset()
    for _ in range(30):
        law.step(rng.standard_normal(22), out)
        found.append(out.copy())
    return np.array(found)


@pytest.mark.parametrize("style", ["zero", "one", "none"])
@pytest.mark.parametrize("kind", ["mat", "struct", "control"])
def test_the_law_is_the_same(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kind: str, style: str) -> None:
    """Named signals may have any order; without names it is that of the loop."""
    order = np.arange(22) if style == "none" else SHUFFLED
    matrices = {"A": STORED.A, "B": STORED.B[:, order], "C": STORED.C, "D": STORED.D[:, order]}
    inputs, outputs = [NAMES[0][i] for i in order], NAMES[1]
    if style == "one":
        inputs, outputs = one_based(inputs), one_based(outputs)
    names = {} if style == "none" else {"InputName": texts(inputs), "OutputName": texts(outputs)}
    if kind == "control":
        signals = {} if style == "none" else {"inputs": inputs, "outputs": outputs}
        module = f"laws_{os.path.basename(tmp_path)}".replace("-", "_")
        made = control.ss(*matrices.values(), 1e-3, **signals)
        monkeypatch.setitem(sys.modules, module, type(sys)(module))
        sys.modules[module].law = made  # type: ignore[attr-defined]
        text = f"{module}:law"
        config = RunConfig.from_mapping({"k_fsm": text, "ports_in_order": style == "none"})
        law = make_law(config, "k_fsm", ROWS).linear
        assert law is not None
    else:
        content = {**matrices, "Ts": 1e-3, **names}
        io.savemat(tmp_path / "law.mat", {"K": content} if kind == "struct" else content)
        law = read_law("k_fsm", tmp_path / "law.mat", in_order=style == "none")
    np.testing.assert_allclose(answers(law), answers(STORED), rtol=1e-9)


def test_a_continuous_controller_is_refused(tmp_path: Path) -> None:
    write_mat(tmp_path / "a.mat", K=System([[-1.0]], [[1.0]], [[1.0]], [[0.0]], [("u", 1)], [("y", 1)]))
    with pytest.raises(ValueError, match="must have its sampling period Ts in s, got a continuous one"):
        read_sampled(tmp_path / "a.mat")
