"""Static output feedback on published plants: our values beside the best known to us, each certified.

Plants: COMPleib (F. Leibfritz 2004). Best known to us: table of H-infinity static output feedback in Q. Tran
Dinh, S. Gumussoy,
W. Michiels and M. Diehl, IEEE Trans. Autom. Control 57(6), 2012 (the best of HIFOO, PENBMI and their own method).
Those numbers are quoted from memory, not checked against the printed page.
"""

from __future__ import annotations

import pytest
from oracles.full_order_bound import full_order_bound

from lti.state_space_model import StateSpace
from robust_design.published_plants import PLANTS
from robust_design.requirements import HinfGain
from robust_design.structures import gain, state_space
from robust_design.tuner import TuningOptions, TuningResult, tune

# plant: (published value, starts, iterations)
KNOWN = {
    "AC2": (0.1115, 1, 300),
    "AC3": (3.5053, 16, 600),
    "AC4": (0.9355, 1, 300),
    "AC6": (4.1140, 1, 300),
    "AC15": (15.1995, 4, 300),
    "AC16": (14.9881, 2, 300),
    "AC17": (6.6124, 1, 300),
    "HE1": (0.1540, 1, 300),
    "HE2": (4.4931, 1, 300),
    "REA1": (0.8815, 6, 300),
    "REA2": (1.1881, 1, 300),
    "DIS2": (1.0548, 1, 300),
    "DIS3": (1.0816, 4, 600),
}
SLOW = {"AC3"}


def tuned(plant: StateSpace, order: int, starts: int, iterations: int = 300) -> TuningResult:
    ports = {p.name: p for p in (*plant.inputs, *plant.outputs)}
    structure = state_space([ports["y"]], [ports["u"]], order) if order else gain([ports["y"]], [ports["u"]])
    options = TuningOptions(starts=starts, iterations=iterations, wall_limit=250)
    return tune([plant], [HinfGain("w", "z")], structure, options=options)


@pytest.mark.parametrize("name", [pytest.param(n, marks=[pytest.mark.slow] if n in SLOW else []) for n in KNOWN])
def test_static_output_feedback(name: str) -> None:
    published, starts, iterations = KNOWN[name]
    result = tuned(PLANTS[name](), 0, starts, iterations)
    assert result.certificate is not None and result.certificate.stable
    assert result.certificate.values.max() == pytest.approx(result.soft, rel=1e-5)
    assert result.certificate.upper.max() <= 1.001 * published


def test_decoupling_is_found_for_ac1() -> None:
    """AC1: the disturbance can be rejected completely; the infimum is 0 (2e-7 by PENBMI)."""
    result = tuned(PLANTS["AC1"](), 0, 3)
    assert result.soft < 1e-2
    assert result.certificate is not None and result.certificate.upper.max() < 1e-2


def scherer() -> StateSpace:
    """Scherer, Gahinet and Chilali 1997, example 7, H-infinity channel."""
    return StateSpace(
        [[0, 10, 2], [-1, 1, 0], [0, 2, -5]],
        [[1, 0], [0, 1], [1, 0]],
        [[1, 0, 0], [0, 0, 0], [0, 1, 0]],
        [[0, 0], [0, 1], [2, 0]],
        [("w", 1), ("u", 1)],
        [("z", 2), ("y", 1)],
        "Scherer 7",
    )


def test_riccati_bound_reproduces_hinfsyn() -> None:
    """python-control 0.10 hinfsyn (SLICOT SB10AD) gives 9.508085 and 0.557291 for these plants."""
    assert full_order_bound(scherer()) == pytest.approx(9.508085, rel=2e-6)
    assert full_order_bound(PLANTS["AC4"]()) == pytest.approx(0.557291, rel=2e-6)


@pytest.mark.parametrize(
    ("plant", "order"), [(PLANTS["AC4"], n) for n in (0, 1, 2, 4)] + [(scherer, n) for n in (1, 2, 3)]
)
def test_fixed_order_is_never_better_than_full_order(plant: object, order: int) -> None:
    model = plant()  # type: ignore[operator]
    bound = full_order_bound(model)
    result = tuned(model, order, 3)
    assert result.certificate is not None
    assert result.certificate.values.max() >= bound * (1 - 1e-6)
    if order == model.order:
        assert result.soft <= 1.03 * bound, "with the full order the bound is nearly reached"
