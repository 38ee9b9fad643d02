"""Numbers of algorithms that callers may change: their ranges, and that they reach the algorithm."""

from __future__ import annotations

import importlib
import pkgutil
from dataclasses import dataclass, fields, replace

import numpy as np
import pytest

import lftkit
from lftkit import InputError, hinf_norm, loop_margins, real, s
from lftkit.analysis.hinf.level_iteration import NormSettings
from lftkit.analysis.margins import CrossingSettings
from lftkit.proofs import BoundOptions, worst_case_gain
from lftkit.proofs.settings import CellSettings
from lftkit.support.settings import AlgorithmSettings


@dataclass(frozen=True)
class Numbers(AlgorithmSettings):
    count: int = 3
    part: float = 0.5
    several: tuple[float, ...] = (0.0, 1.0)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"count": 0}, "count must be positive, got 0"),
        ({"count": 1.5}, "count must be an integer"),
        ({"part": -1.0}, r"part must be positive, got -1\.0"),
        ({"part": np.inf}, "part must be positive, got inf"),
        ({"part": "half"}, "part must be positive, got 'half'"),
        ({"several": (1.0, -1.0)}, "several must be finite numbers that are not negative"),
        ({"several": (np.nan,)}, "several must be finite numbers that are not negative"),
    ],
)
def test_numbers_out_of_range_are_refused_by_name(changes: dict[str, object], message: str) -> None:
    with pytest.raises(InputError, match=message):
        replace(Numbers(), **changes)  # type: ignore[arg-type]


def all_settings() -> list[type[AlgorithmSettings]]:
    for module in pkgutil.walk_packages(lftkit.__path__, "lftkit."):
        if not module.name.endswith("__main__"):
            importlib.import_module(module.name)
    return [kind for kind in AlgorithmSettings.__subclasses__() if kind.__module__.startswith("lftkit.")]


def test_every_setting_has_a_default_in_its_range_and_a_line_about_it() -> None:
    kinds = all_settings()
    assert len(kinds) > 15
    for kind in kinds:
        kind()
        text = kind.__doc__ or ""
        missing = [f.name for f in fields(kind) if f.name not in text]
        assert not missing, (kind, missing)


def test_settings_reach_the_algorithm() -> None:
    """A norm of one level, crossings of noise, and cells without a smallest width do not end where they did."""
    A, one = np.diag([-1.0, -2.0, -3.0]), np.ones((3, 1))
    norm = hinf_norm(A, one, one.T, [[0.0]])
    without = hinf_norm(A, one, one.T, [[0.0]], settings=NormSettings(small_states=1))
    assert (norm.certificate, without.certificate) == ("hamiltonian", "interval")
    loop = 4 / (s + 1) ** 3
    assert loop_margins(loop).gain and not loop_margins(loop, settings=CrossingSettings(crosses=1e-300)).gain
    mode = (1 / (s**2 + 0.1 * s + real("k", 1.0, 0.8, 1.2))).system("force", "x")
    options = BoundOptions(max_tests=0, cells=CellSettings(raised=(1e6,)))
    assert worst_case_gain(mode, options=options).upper > 1e5
