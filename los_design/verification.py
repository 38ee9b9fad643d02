"""Independent verification of the stored designs: gammas of the paper's problem and of the sampled loop."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fsm_pma_controller.problem import FORCE_SHARE, actuator_plant, actuator_requirements
from los_design.sampled_loop_norms import SampledLoopMetrics, sampled_loop_metrics
from los_design.store import continuous
from los_estimator.problem import observer_plant, observer_requirements
from lti import SampledSystem, StateSpace, UncertainSystem
from robust_design import certify
from titop_plant.interface import FRAME_TICKS, K_PMA_INPUTS, MEASURED, MIRROR_STAGES
from titop_plant.telescope.assembly import Telescope
from titop_plant.telescope.parameters import Parameters, parameter_corners

ARCSEC = np.pi / 648000.0
Values = Mapping[str, float]
FloatArray = NDArray[np.float64]
PAPER_ROBUST = {"fsm": [0.9857, 1.0026, 0.9877], "pma": [0.5768, 0.9835, 0.9835, 0.1185]}
PAPER_NOMINAL = {"fsm": [0.7115, 0.7160, 0.9804], "pma": [0.7115, 0.7115, 0.6150, 0.4266]}


def verification_points(
    parameters: Parameters, system: UncertainSystem, samples: int, seed: int = 0
) -> list[dict[str, float]]:
    """Nominal, all corners, and random points."""
    return [{}, *parameter_corners(parameters), *system.sample_values(np.random.default_rng(seed), samples)]


@dataclass(frozen=True)
class ImplementedCheck:
    """Worst metrics over parameter points of a pair of implemented designs; infinite where a point is unstable.

    Parameters
    ----------
    fsm, pma : list of float
        Gammas in the paper's order: APE, RPE (100 mas), mirror; APE, RPE (40 mas), noise to APE, force.
    noise_ape, noise_rpe : float
        Of the loop with both controllers at the nominal point [rad rms].
    worst : dict
        Parameter point of the largest APE and RPE of each stage; the first unstable point where there is one.
    stable, count : int
        Points at which the loops of both stages are stable, and all points.
    """

    fsm: list[float]
    pma: list[float]
    noise_ape: float
    noise_rpe: float
    worst: dict[str, Values]
    stable: int
    count: int

    @property
    def all_stable(self) -> bool:
        """Whether both stages are stable at every point; the nominal one is always among them."""
        return self.stable == self.count and math.isfinite(self.noise_ape)

    def to_mapping(self) -> dict[str, Any]:
        """Metrics for the JSON line; ``"inf"`` where a loop is unstable."""
        return {
            "fsm": [rounded(v) for v in self.fsm],
            "pma": [rounded(v) for v in self.pma],
            "noise_ape_arcsec_rms": rounded(self.noise_ape / ARCSEC),
            "noise_rpe_mas_rms": rounded(1e3 * self.noise_rpe / ARCSEC),
            "stable_samples": self.stable,
            "samples": self.count,
        }


def rounded(value: float) -> float | str:
    """Five digits for JSON, which has no infinity: ``"inf"``."""
    return float(f"{value:.5g}") if math.isfinite(value) else str(value)


def check_implemented(
    system: UncertainSystem,
    parameters: Parameters,
    k_fsm: SampledSystem,
    k_pma: SampledSystem,
    at: Iterable[Values],
    tick: Callable[[], None] = lambda: None,
) -> ImplementedCheck:
    """Evaluate a pair of implemented designs at the given parameter points.

    Parameters
    ----------
    system : UncertainSystem
        From 8 commands and 22 disturbances to 22 measurements and 2 controlled lines of sight, as
        :func:`titop_plant.simulation.control_loop_plant` makes it.
    parameters : mapping
        Telescope parameters (weights, sensors, authority).
    k_fsm, k_pma : SampledSystem
    at : iterable of mapping
        Parameter points; noise is evaluated at the nominal point whatever they are.
    tick : callable
        Called after each point.
    """
    fsm: FloatArray = np.zeros(3)
    pma: FloatArray = np.zeros(4)
    worst: dict[str, Values] = {}
    stable = count = 0
    for values in at:
        plant = system.data_at(values)
        stages: dict[str, SampledLoopMetrics] = {
            loop: sampled_loop_metrics(plant, k_fsm, k_pma, parameters, loop=loop, frame_ticks=FRAME_TICKS, noise=False)
            for loop in MIRROR_STAGES
        }
        one, two = stages["fsm"], stages["fsm+pma"]
        count += 1
        stable += int(one.stable and two.stable)
        for name, new, old in (
            ("fsm APE", one.ape, fsm[0]),
            ("fsm RPE", one.rpe, fsm[1]),
            ("pma APE", two.ape, pma[0]),
            ("pma RPE", two.rpe_fine, pma[1]),
        ):
            if new > old:
                worst[name] = dict(values)
        fsm = np.maximum(fsm, [one.ape, one.rpe, one.mirror])
        pma = np.maximum(pma, [two.ape, two.rpe_fine, 0.0, two.force])
        tick()
    nominal = system.data_at({})
    final, base = (
        sampled_loop_metrics(
            nominal, k_fsm, k_pma, parameters, loop="fsm+pma", frame_ticks=FRAME_TICKS, sensors=sensors
        )
        for sensors in (None, "platform")
    )
    pma[2] = base.noise_ape / parameters["weights"]["ape_limit"]
    return ImplementedCheck(fsm.tolist(), pma.tolist(), final.noise_ape, final.noise_rpe, worst, stable, count)


def failures(paper: Mapping[str, list[float]], checks: Mapping[str, ImplementedCheck]) -> list[str]:
    """One line for each loop that is unstable somewhere; empty if the verification holds.

    Parameters
    ----------
    paper : mapping
        Result of :func:`check_paper`.
    checks : mapping
        Name to result of :func:`check_implemented`.
    """
    found = [
        f"the paper's problem, {kind}: unstable" for kind, gammas in paper.items() if not np.isfinite(gammas).all()
    ]
    for name, check in checks.items():
        if check.stable < check.count:
            found.append(f"{name}: unstable at {check.count - check.stable} of {check.count} points")
        elif not check.all_stable:
            found.append(f"{name}: unstable at the nominal point")
    return found


def check_paper(
    telescope: Telescope, parameters: Parameters, k_fsm: SampledSystem, k_pma: SampledSystem, at: list[Values]
) -> dict[str, list[float]]:
    """Worst certified gammas of the continuous designs over the points, in the paper's order; infinite if unstable."""
    observer, actuators = continuous(k_fsm), continuous(k_pma)
    first = observer_plant(telescope, parameters)
    second = actuator_plant(telescope, parameters, observer)
    forces = _certified(
        second,
        actuators,
        tuple(port.name for port in K_PMA_INPUTS),
        actuator_requirements(parameters, implemented=False),
        at,
    )
    forces[3] *= FORCE_SHARE  # over the whole authority, as the paper counts
    return {
        "fsm": _certified(first, observer, MEASURED, observer_requirements(parameters, implemented=False), at),
        "pma": forces,
    }


def _certified(
    plant: Any, controller: UncertainSystem, measured: tuple[str, ...], requirements: Any, at: list[Values]
) -> list[float]:
    data = controller.data_at({})
    ports = tuple(plant.system.output_port(name) for name in measured)
    K = StateSpace(data.A, data.B, data.C, data.D, ports, data.outputs, "K")
    certificate = certify([plant(values) for values in at], K, requirements, 0.0)
    return [float(f"{v:.5g}") for v in np.max(certificate.values, axis=1)]
