"""Independent verification of the stored designs: gammas of the paper's problem and of the sampled loop."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from fsm_pma_controller.problem import actuator_plant
from lftkit import SampledSystem, System
from lftkit.arrays import FloatArray
from lftkit.support.counted_nouns import counted
from lftkit.support.workers import Workers
from lftkit.tuning import certify
from los_design.synthesis.state_space_requirements import paper_requirements
from los_design.synthesis.store import continuous
from los_design.verification.stage_check import StageCheck, check_stages, grid
from los_estimator.problem import observer_plant
from los_loop.figures_of_merit import figure, gain_figures
from los_loop.implemented_loop import ImplementedLoop
from los_loop.margins import GuaranteedMargins, delay_margins, rounded
from los_loop.noise import loop_noise, noise_covariances, noise_rms
from los_loop.open_loop import OpenLoop
from pointing_analysis.formatting.number_text import digits_beside
from titop_plant.interface import FORCES, K_PMA_INPUTS, MEASURED, MIRROR, MIRROR_STAGES
from titop_plant.telescope.error_budget import MAX_SENSITIVITY
from titop_plant.telescope.requirements import instant_probability, window_probability
from titop_plant.telescope.telescope import Telescope
from titop_plant.telescope.weights import window_ratio
from titop_plant.telescope.window_noise import WindowNoise, combined_level

ARCSEC = np.pi / 648000.0
MAS = 1e-3 * ARCSEC
ENVELOPE = 0.7
"""Part of the worst fast tone above which tones of other frequencies are looked at beside the noise: a tone that turns
less in a window adds more to it, but by less than that."""
DELAY_POINTS, DELAY_FREQUENCIES = 40, 400
Values = Mapping[str, float]
SHORT_NAMES = dict(zip(("fsm", "pma"), MIRROR_STAGES))
"""Of the stages with fine control, in a mapping of metrics."""
CLOSINGS = {
    "fsm": (MIRROR_STAGES[0], "sensitivity, mirror", MIRROR),
    "pma, mirror": (MIRROR_STAGES[1], "sensitivity, mirror", MIRROR),
    "pma, forces": (MIRROR_STAGES[1], "sensitivity, forces", FORCES),
}
"""Where margins are given: name to stage, figure of merit and commands."""
PAPER_ROBUST = {"fsm": [0.9857, 1.0026, 0.9877], "pma": [0.5768, 0.9835, 0.9835, 0.1185]}
PAPER_NOMINAL = {"fsm": [0.7115, 0.7160, 0.9804], "pma": [0.7115, 0.7115, 0.6150, 0.4266]}


def verification_points(
    telescope: Telescope, system: System, samples: int, seed: int = 0, every: int = 1
) -> list[dict[str, float]]:
    """Nominal, corners (all, or each of so many), and random points."""
    corners = telescope.corners()[::every]
    return [{}, *corners, *system.sample_values(np.random.default_rng(seed), samples)]


@dataclass(frozen=True)
class ImplementedCheck:
    """Worst values over parameter points of a pair of implemented designs; infinite where a point is unstable.

    Parameters
    ----------
    checks : dict of str to StageCheck
        By stage: the mirror alone, and with the proof-mass actuators where the telescope has them.
    noise : dict of str to (WindowNoise, WindowNoise)
        By stage, at the nominal point: line of sight due to sensor noise [rad], plain and as relative error.
    platform_noise : float
        Line of sight due to the platform's accelerometers with all controllers [rad rms], the paper's figure.
    delay : dict of str to float
        Guaranteed delay margins [s]: ``fsm``, ``pma, mirror``, ``pma, forces``; the last two with these actuators.
    telescope : Telescope
        Telescope parameters.
    """

    checks: dict[str, StageCheck]
    noise: dict[str, tuple[WindowNoise, WindowNoise]]
    platform_noise: float
    delay: dict[str, float]
    telescope: Telescope

    @property
    def stages(self) -> tuple[str, ...]:
        """Stages with fine control that the telescope has."""
        return tuple(self.checks)

    @property
    def alone(self) -> StageCheck:
        """The mirror alone."""
        return self.checks[MIRROR_STAGES[0]]

    @property
    def both(self) -> StageCheck:
        """With the proof-mass actuators; KeyError: the telescope has none."""
        return self.checks[MIRROR_STAGES[1]]

    @property
    def count(self) -> int:
        """Parameter points."""
        return len(self.alone.stable)

    @property
    def stable(self) -> int:
        """Points at which the loops of all stages are stable."""
        return int(np.sum(np.all([check.stable for check in self.checks.values()], axis=0)))

    @property
    def all_stable(self) -> bool:
        """Whether all stages are stable at every point and at the nominal one."""
        return self.stable == self.count and math.isfinite(self.platform_noise)

    def gamma(self, stage: str, requirement: str) -> float:
        """Worst gamma of a figure; ``RPE`` is the worse of slow and fast tones."""
        check = self.checks[stage]
        if not check.stable.all():
            return math.inf
        names = ("slow", "fast") if requirement == "RPE" else (requirement,)
        return max((check.worst[n].gamma for n in names if n in check.worst), default=math.inf)

    @property
    def gammas(self) -> dict[str, list[float]]:
        """Gammas by the short name of the stage, in the paper's order."""
        by_stage = {"fsm": self.fsm, "pma": self.pma if MIRROR_STAGES[1] in self.checks else []}
        return {name: values for name, values in by_stage.items() if values}

    @property
    def fsm(self) -> list[float]:
        """Gammas of the mirror alone in the paper's order: APE, RPE, mirror."""
        return [self.gamma("fsm", name) for name in ("APE", "RPE", "mirror")]

    @property
    def pma(self) -> list[float]:
        """Gammas with both controllers in the paper's order: APE, RPE, noise to APE, force."""
        noise = self.platform_noise / figure("noise -> APE").limit(self.telescope, "fsm+pma")
        return [self.gamma("fsm+pma", "APE"), self.gamma("fsm+pma", "RPE"), noise, self.gamma("fsm+pma", "force")]

    def tone(self, stage: str, requirement: str) -> float:
        """Worst amplitude of slow or fast tones [mas]."""
        return self.gamma(stage, requirement) * figure(requirement).limit(self.telescope, stage) / MAS

    def total(self, stage: str) -> float:
        """Relative error that the required part of the windows keeps beside the worst tone [mas]."""
        return self._totals[stage]

    @cached_property
    def _totals(self) -> dict[str, float]:
        return {stage: self._total(stage) for stage in self.stages}

    def _total(self, stage: str) -> float:
        level = 0.0
        for tone, omega in self._tones(stage):
            level = self._beside_noise(stage, tone, omega, level)
        return level

    def _tones(self, stage: str) -> list[tuple[float, float]]:
        """Amplitudes [mas] and frequencies [rad/s] of tones: the slow one, and of the fast ones all that may matter."""
        check = self.checks[stage]
        limit, fast = figure("fast").limit(self.telescope, stage) / MAS, check.envelope["fast"]
        least = ENVELOPE * self.gamma(stage, "fast")
        tones = [(limit * float(v), float(w)) for v, w in zip(fast, grid()) if v > least]
        return [(self.tone(stage, "slow"), 0.0), (self.tone(stage, "fast"), check.worst["fast"].omega), *tones]

    def _beside_noise(self, stage: str, tone: float, omega: float = 0.0, least: float = 0.0) -> float:
        turn = omega * self.telescope.weights.rpe_window
        tone *= float(window_ratio(turn))
        probability = window_probability(self.telescope.requirements)
        noise = self.noise[stage][1]
        return _level(tone, noise.changed(noise.rms / MAS), probability, turn, least)

    def total_together(self, stage: str) -> float:
        """The same beside a slow and a fast tone at once, of norm 1 in all [mas]: at most, whatever their shares."""
        return self._beside_noise(stage, math.hypot(self.tone(stage, "slow"), self.tone(stage, "fast")))

    def total_ape(self, stage: str) -> float:
        """Line of sight that the required part of the instants keeps beside the tone that is worst for it [arcsec]."""
        limit = figure("APE").limit(self.telescope, stage) / ARCSEC
        tone, noise = self.gamma(stage, "APE") * limit, self.noise[stage][0]
        return _level(tone, noise.changed(noise.rms / ARCSEC), instant_probability(self.telescope.requirements))

    @property
    def reduction(self) -> float:
        """Worst fast tone of the mirror alone over that with both controllers [dB]."""
        one, two = self.tone("fsm", "fast"), self.tone("fsm+pma", "fast")
        return 20.0 * math.log10(one / two) if math.isfinite(one + two) and two > 0.0 else math.nan

    @property
    def amplification(self) -> tuple[float, float]:
        """Largest ratio of the worst relative errors of both stages at one frequency [dB], and that frequency [rad/s].

        Frequencies at which both are below a tenth of the limit of both do not count.
        """
        omega, limit = grid(), figure("RPE").limit
        ratio = limit(self.telescope, "fsm") / limit(self.telescope, "fsm+pma")
        one, two = (
            np.maximum(check.envelope["slow"], check.envelope["fast"]) * factor
            for check, factor in ((self.alone, ratio), (self.both, 1.0))
        )
        growth = np.where((two > 0.1) & (one > 0.0), two / np.maximum(one, 1e-12), 0.0)
        k = int(growth.argmax())
        return (20.0 * math.log10(growth[k]) if growth[k] > 0.0 else -math.inf), float(omega[k])

    def margins(self) -> dict[str, GuaranteedMargins]:
        """What the peaks of the sensitivities guarantee."""
        return {
            name: GuaranteedMargins(MAX_SENSITIVITY * check.worst[metric].gamma, self.delay[name])
            for name, (stage, metric, _) in CLOSINGS.items()
            if (check := self.checks.get(stage)) is not None and metric in check.worst
        }

    def lost_margins(self) -> list[str]:
        """One text for each changed loop that is unstable somewhere."""
        lines = []
        for check in self.checks.values():
            counts = Counter(name for names in check.unstable_changes for name in names)
            lines += [f"{check.stage}: {name} unstable at {counted(n, 'point')}" for name, n in counts.items()]
        return lines

    def to_mapping(self) -> dict[str, Any]:
        """Metrics for the JSON line; ``"inf"`` where a loop is unstable."""
        names = {short: stage for short, stage in SHORT_NAMES.items() if stage in self.checks}
        compared: dict[str, Any] = {}
        if len(names) > 1:
            db, at = self.amplification
            compared = {
                "fast_tones_reduction_db": rounded(self.reduction),
                "largest_amplification_db": {"db": rounded(db), "rad_s": rounded(at)},
            }
        return {
            "samples": self.count,
            "stable_samples": self.stable,
            **{short: [rounded(v) for v in values] for short, values in self.gammas.items()},
            "margins": {
                **{name: margin.to_mapping() for name, margin in self.margins().items()},
                "unstable_changes": self.lost_margins(),
            },
            "worst_point": {
                f"{short} {name}": {
                    "gamma": rounded(p.gamma),
                    "rad_s": rounded(p.omega),
                    "channel": p.channel(self.telescope),
                    "parameters": dict(p.parameters),
                }
                for short, stage in names.items()
                for name, p in self.checks[stage].worst.items()
            },
            "noise": {
                short: {
                    "ape_arcsec_rms": rounded(self.noise[stage][0].rms / ARCSEC),
                    "rpe_mas_rms": rounded(self.noise[stage][1].rms / MAS),
                }
                for short, stage in names.items()
            },
            "tones_mas": {
                short: {name: rounded(self.tone(stage, name)) for name in ("slow", "fast")}
                for short, stage in names.items()
            },
            "total_mas": {short: rounded(self.total(stage)) for short, stage in names.items()},
            "total_together_mas": {short: rounded(self.total_together(stage)) for short, stage in names.items()},
            "total_ape_arcsec": {short: rounded(self.total_ape(stage)) for short, stage in names.items()},
            **compared,
        }


def _level(tone: float, noise: WindowNoise, probability: float, turn: float = 0.0, least: float = 0.0) -> float:
    known = math.isfinite(tone + noise.rms + least)
    return combined_level(tone, noise, probability, turn, least=least) if known else math.inf


def check_implemented(
    system: System,
    telescope: Telescope,
    k_fsm: SampledSystem,
    k_pma: SampledSystem,
    at: Iterable[Values],
    tick: Callable[[], None] = lambda: None,
    changes: bool = True,
    workers: Workers | None = None,
) -> ImplementedCheck:
    """Evaluate a pair of implemented designs at the given parameter points.

    Parameters
    ----------
    system : System
        From 8 commands and 22 disturbances to 22 measurements and 2 controlled lines of sight, as
        :func:`titop_plant.telescope.control_plant.loop_plant` makes it for the ports that the controllers use.
    telescope : Telescope
        Telescope parameters (weights, sensors, authority).
    k_fsm, k_pma : SampledSystem
    at : iterable of mapping
        Parameter points; noise is evaluated at the nominal point whatever they are.
    tick : callable
        Called for each point and stage.
    changes : bool
        Check gains and one more tick of delay, too.
    workers : Workers, optional
        Processes; the result does not depend on them.
    """
    points, pair = list(at), (k_fsm, k_pma)
    open_loop = OpenLoop(system, telescope, ports=telescope.loop_ports.used_by(*pair))
    stages = telescope.mirror_stages
    loops = [ImplementedLoop(open_loop, *pair, stage) for stage in stages]
    checks = dict(zip(stages, check_stages(loops, points, changes=changes, tick=tick, workers=workers)))
    nominal = system.at({})
    noise = {stage: loop_noise(nominal, *pair, telescope, loop=stage) for stage in stages}
    of_platform = noise_covariances(nominal, *pair, telescope, loop=stages[-1], sensors="platform")
    platform = noise_rms(of_platform)
    delay = _delays(open_loop, pair, points, stages)
    return ImplementedCheck(checks, noise, platform[0], delay, telescope)


def _delays(
    open_loop: OpenLoop, pair: tuple[SampledSystem, SampledSystem], points: list[Values], stages: Sequence[str]
) -> dict[str, float]:
    """Guaranteed delay margins [s] at up to :data:`DELAY_POINTS` of the points."""
    some = points[:: max(1, len(points) // DELAY_POINTS)]
    delays = dict.fromkeys(CLOSINGS, math.inf)
    omega: FloatArray = np.asarray(np.geomspace(0.1, 2500.0, DELAY_FREQUENCIES), dtype=float)
    for stage in stages:
        loop = ImplementedLoop(open_loop, *pair, stage)
        cube = np.array([loop.point(dict(values)) for values in some])
        forces = open_loop.ports.forces
        closings = {
            name: forces if channels == FORCES else channels
            for name, (closed, _, channels) in CLOSINGS.items()
            if closed == stage
        }
        delays |= dict(zip(closings, delay_margins(loop, list(closings.values()), cube, omega)))
    return {name: value for name, value in delays.items() if CLOSINGS[name][0] in stages}


def failures(checks: Mapping[str, ImplementedCheck]) -> list[str]:
    """One line for each loop that is unstable somewhere; empty if the verification holds.

    Parameters
    ----------
    checks : mapping
        Name to result of :func:`check_implemented`.
    """
    texts: list[str] = []
    for name, check in checks.items():
        if check.stable < check.count:
            texts.append(f"{name}: unstable at {check.count - check.stable} of {check.count} points")
        elif not check.all_stable:
            texts.append(f"{name}: unstable at the nominal point")
    return texts


def broken_requirements(check: ImplementedCheck) -> list[str]:
    """One line for each requirement of the implemented loop that a pair of designs breaks; empty if all are met."""
    lines = [
        f"{stage}: {row.name} {digits_beside(gamma, row.allowed)} of its limit, must be at most {row.allowed:g}"
        for stage in check.stages
        for row in gain_figures(stage)
        if not (gamma := check.gamma(stage, row.name)) <= row.allowed
    ]
    last = check.stages[-1]
    fine = figure("RPE").limit(check.telescope, last) / MAS
    if not check.total(last) <= fine:
        lines.append(
            f"{last}: tones and noise {digits_beside(check.total(last), fine)} mas, must be at most {fine:g} mas"
        )
    for stage in check.stages:
        absolute = figure("APE").limit(check.telescope, stage) / ARCSEC
        if not check.total_ape(stage) <= absolute:
            value = digits_beside(check.total_ape(stage), absolute)
            lines.append(f"{stage}: tone and noise {value} arcsec, must be at most {absolute:g} arcsec")
    return lines + check.lost_margins()


def check_paper(
    telescope: Telescope, k_fsm: SampledSystem, k_pma: SampledSystem, at: list[Values]
) -> dict[str, list[float]]:
    """Worst certified gammas of the continuous designs over the points, in the paper's order; infinite if unstable."""
    observer, actuators = continuous(k_fsm), continuous(k_pma)
    first = observer_plant(telescope)
    second = actuator_plant(telescope, observer)
    measured = tuple(port.name for port in K_PMA_INPUTS)
    alone, both = (paper_requirements(telescope, stage) for stage in MIRROR_STAGES)
    return {
        "fsm": _certified(first, observer, MEASURED, alone, at),
        "pma": _certified(second, actuators, measured, both, at),
    }


def _certified(
    plant: Any, controller: System, measured: tuple[str, ...], requirements: Any, at: list[Values]
) -> list[float]:
    data = controller.at({})
    ports = tuple(plant.system.output_port(name) for name in measured)
    K = System(data.A, data.B, data.C, data.D, ports, data.outputs, "K")
    certificate = certify([plant(values) for values in at], K, requirements, 0.0)
    return [float(f"{v:.5g}") for v in np.max(certificate.values, axis=1)]
