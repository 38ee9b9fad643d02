"""The proofs of the shipped pair: checked anew, and of the loop that ships (slow)."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from los_design.certify import NYQUIST, box_of, figures_of, telescope_model
from los_design.implemented_loop import ImplementedLoop
from los_design.open_loop import OpenLoop
from los_design.store import load_designs
from robust_design.certified_loop import LoopProof, check_loop_proof
from titop_plant.simulation import control_loop_plant, telescope
from titop_plant.telescope.budget import BAND_EDGE
from titop_plant.telescope.parameters import load_parameters

PROOFS = Path(__file__).parents[1] / "fixtures" / "proofs"
BANDS = {"slow": (1e-2, BAND_EDGE), "fast": (BAND_EDGE, NYQUIST)}


@pytest.fixture(scope="module")
def loop() -> ImplementedLoop:
    parameters = load_parameters()
    open_loop = OpenLoop(control_loop_plant(telescope(), parameters), parameters)
    return ImplementedLoop(open_loop, *load_designs("implemented"), "fsm+pma")


@pytest.mark.parametrize("figure", BANDS)
def test_the_proof_is_of_the_loop_that_ships(figure: str, loop: ImplementedLoop) -> None:
    """Remade by ``los-testbed design certify`` when the telescope or the controllers change."""
    proof = LoopProof.from_file(PROOFS / f"fsm+pma-{figure}.npz")
    model = telescope_model(loop, figures_of(loop.parameters, loop.stage)[figure])
    assert proof.level == 1.0 and proof.model.scale == model.scale and proof.model.window == model.window
    assert proof.band == pytest.approx(BANDS[figure]) and proof.model.groups == model.groups
    np.testing.assert_allclose(proof.box, box_of(loop), rtol=1e-12)
    np.testing.assert_array_equal(proof.model.weights, model.weights)
    for omega in np.geomspace(*BANDS[figure], 12):
        for own, stored in zip(model.at(float(omega)), proof.model.at(float(omega))):
            np.testing.assert_allclose(stored, own, atol=1e-5 * np.abs(own).max())


@pytest.mark.slow
@pytest.mark.parametrize("figure", BANDS)
def test_the_proof_passes(figure: str) -> None:
    checked = check_loop_proof(PROOFS / f"fsm+pma-{figure}.npz")
    assert checked.level == 1.0 and checked.band == pytest.approx(BANDS[figure])
