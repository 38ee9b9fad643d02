"""Controllers of a run: comparison of their design basis with the telescope, and the laws built from them."""

from __future__ import annotations

from collections.abc import Mapping

from fsm_pma_controller.fade import FADE_TICKS
from fsm_pma_controller.runtime import FsmPmaController
from lftkit.systems.sampled.sampled_system import SampledSystem
from los_testbed.parts.flight_library import LibraryLaw
from los_testbed.parts.user_blocks import UserBlock
from titop_plant.interface import FORCE_STAGES, MIRROR_STAGES, DesignBasis, design_warnings
from titop_plant.telescope.loop_ports import LoopPorts


def compare_with_telescope(
    controllers: Mapping[str, SampledSystem | UserBlock | LibraryLaw], telescope: DesignBasis, loop: str
) -> tuple[str, ...]:
    """Compare controllers with the telescope of a run; one line for each made for other parameters or limits.

    K_FSM counts in every stage, since its estimates are recorded; K_PMA only where its loop is closed.

    Raises
    ------
    ValueError
        A loop is closed with a controller that was made for another sensitivity of the mirror.
    """
    lines = design_warnings([controllers["k_fsm"]], telescope, closed=loop in MIRROR_STAGES)
    if loop in FORCE_STAGES:
        lines += design_warnings([controllers["k_pma"]], telescope, closed=True)
    return lines


def assemble_controller(
    controllers: Mapping[str, SampledSystem | UserBlock | LibraryLaw],
    telescope: DesignBasis,
    loop: str,
    ports: LoopPorts,
    *,
    fade_ticks: int = FADE_TICKS,
) -> FsmPmaController:
    """Mirror and proof-mass laws.

    Parameters
    ----------
    controllers : mapping
        ``k_fsm``, which says the sensitivity of the mirror that it was made for, and ``k_pma``.
    telescope : DesignBasis
        With the limits of the run; its sensitivity counts where the file of K_FSM says none.
    loop : str
        Stage.
    ports : LoopPorts
        Rows that ``k_pma`` uses.
    fade_ticks : int
        Length of the fade after a change of the stage.

    Raises
    ------
    ValueError
        Other ports, another period, an unknown stage, a value that neither the file nor the telescope says.
    """
    k_fsm = controllers["k_fsm"]
    mirror, force = telescope.authority
    return FsmPmaController(
        controllers["k_pma"],
        ports,
        loop,
        los_sensitivity=DesignBasis.from_mapping(k_fsm.design_basis, k_fsm.name).mirror_sensitivity(telescope),
        fsm_authority=mirror,
        pma_authority=force,
        fade_ticks=fade_ticks,
    )
