"""Figures of merit of the loop, each a row of one table: what is measured, in which band, its limit, in which stages.

Tuner, search, verification, proofs, worst tones and the columns of a campaign are made from these rows; a row that is
added to :data:`FIGURES` takes effect in all of them.

===================  ===========  ===========  ====  =====================================================  ===========
name                 from         to           kind  value 1 means                                          stages
===================  ===========  ===========  ====  =====================================================  ===========
APE                  disturbance  LOS          gain  the limit of the absolute error                        all
RPE                  disturbance  LOS          gain  that of the relative error, of tones in all bands      the paper's
slow, fast           disturbance  LOS          gain  the same, of tones below and above the edge            all
noise -> APE         platform     LOS          rms   the limit of the absolute error                        the paper's
all noise -> APE     sensors      LOS          rms   the noise's share of the budget of the absolute error  fsm, fsm+pma
noise -> RPE         sensors      LOS          rms   the noise's share of the budget of the relative error  fsm, fsm+pma
mirror               disturbance  mirror       gain  the authority of the mirror                            fsm, fsm+pma
sensitivity, mirror  mirror       mirror       gain  a peak of 2 of the sensitivity                         fsm, fsm+pma
force                disturbance  forces       gain  the authority of the actuators, half of it allowed     fsm+pma
sensitivity, forces  forces       forces       gain  a peak of 2 of the sensitivity                         fsm+pma
===================  ===========  ===========  ====  =====================================================  ===========

Gains are largest singular values, with normalised disturbances. The relative error has the weight of the window
(:func:`titop_plant.telescope.weights.rpe_weight`), and the larger of its two limits without proof-mass actuators.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

from lftkit.errors import InputError
from los_loop.spec import DISTURBANCE, INPUTS, LINE_OF_SIGHT, OUTPUTS
from titop_plant.interface import COMMANDED, FORCE_STAGES, MEASURED, MIRROR_STAGES, STAGES
from titop_plant.telescope.error_budget import (
    MAX_SENSITIVITY,
    TUNED_FORCE_SENSITIVITY,
    TUNED_SENSITIVITY,
    band_edge,
    error_budget,
)
from titop_plant.telescope.telescope import Telescope

Limit = Callable[[Telescope, str], float]
"""From telescope and stage."""

Edge = float | Callable[[Telescope], float]
"""End of a band [rad/s], of all telescopes or of each."""

TUNED = 0.985
"""Part of the limits of mirror and force that is tuned for."""

FORCE_SHARE = 0.5
"""Part of the actuators' authority that a design may ask for."""


@dataclass(frozen=True)
class FigureOfMerit:
    """A figure of the loop that has a limit.

    Parameters
    ----------
    name : str
    output : str
        Port of :data:`los_loop.spec.OUTPUTS`; of noise the line of sight.
    inputs : tuple of str
        ``disturbance``, or a command that is added (a sensitivity), or measured ports, whose noise acts.
    limit : callable
        What counts as 1.
    stages : tuple of str
        Stages of the implemented loop that must keep it.
    paper : tuple of str
        Stages whose controller the paper's problem asks it of.
    target : callable, optional
        What is tuned for; default: the allowed part of the limit.
    allowed : float
        Largest value of a design that is accepted.
    band : (float or callable, float or callable)
        Frequencies [rad/s] at which it counts; an end may depend on the telescope.
    relative : bool
        Whether the weight of the relative error is applied.
    hard : bool
        Whether the tuner meets it first and then keeps it.

    Raises
    ------
    ValueError
        Ports that the loop does not have, or do not go together.
    """

    name: str
    output: str
    inputs: tuple[str, ...]
    limit: Limit
    stages: tuple[str, ...] = ()
    paper: tuple[str, ...] = ()
    target: Limit | None = None
    allowed: float = 1.0
    band: tuple[Edge, Edge] = (0.0, math.inf)
    relative: bool = False
    hard: bool = False

    def __post_init__(self) -> None:
        if self.output not in OUTPUTS:
            raise InputError(f"{self.name}: output must be one of {', '.join(OUTPUTS)}, got {self.output!r}")
        if self.is_noise:
            if self.output != LINE_OF_SIGHT:
                raise InputError(f"{self.name}: output of noise must be {LINE_OF_SIGHT}, got {self.output!r}")
        elif len(self.inputs) != 1 or self.inputs[0] not in INPUTS:
            known = f"one of {', '.join(INPUTS)}, or measured ports"
            raise InputError(f"{self.name}: inputs must be {known}, got {self.inputs}")

    @property
    def is_noise(self) -> bool:
        """Whether sensor noise makes it: a root mean square (H2), not a gain."""
        return bool(self.inputs) and set(self.inputs) <= set(MEASURED)

    @property
    def is_sensitivity(self) -> bool:
        """Whether it is from signals added to commands."""
        return not self.is_noise and self.inputs[0] in COMMANDED

    @property
    def is_error(self) -> bool:
        """Whether it is the gain from the disturbance to the line of sight."""
        return self.output == LINE_OF_SIGHT and self.inputs == (DISTURBANCE,)

    def tuned_for(self, telescope: Telescope, stage: str) -> float:
        """What counts as 1 when a stage is tuned: a share of the budget, or the limit less what tuning leaves."""
        if self.target is not None:
            return float(self.target(telescope, stage))
        return self.allowed * float(self.limit(telescope, stage))

    def band_of(self, telescope: Telescope) -> tuple[float, float]:
        """Its band for a telescope [rad/s]."""
        low, high = (edge(telescope) if callable(edge) else edge for edge in self.band)
        return low, high

    def within(self, telescope: Telescope, low: float, high: float) -> tuple[float, float]:
        """Its band for a telescope, within frequencies [rad/s]."""
        own = self.band_of(telescope)
        return max(low, own[0]), min(high, own[1])


def _ape(telescope: Telescope, stage: str) -> float:
    return telescope.weights.ape_limit


def _authority(table: str) -> Limit:
    return lambda telescope, stage: getattr(telescope, table).authority


def _of_stage(alone: Callable[[Telescope], float], both: Callable[[Telescope], float]) -> Limit:
    """Limit or share of the budget of the relative error: of the mirror alone, of both controllers."""
    return lambda telescope, stage: (both if stage in FORCE_STAGES else alone)(telescope)


def _absolute_tone(telescope: Telescope, stage: str) -> float:
    """What a tone may take of the absolute error where noise acts, too; all of it in stages without fine control."""
    return error_budget(telescope).ape_tone if stage in MIRROR_STAGES else _ape(telescope, stage)


def _part(part: float, limit: Limit) -> Limit:
    return lambda telescope, stage: part * limit(telescope, stage)


def _always(value: float) -> Limit:
    return lambda telescope, stage: value


_MIRROR, _FORCE = COMMANDED
_NOISE = _of_stage(lambda t: error_budget(t).noise, lambda t: error_budget(t).total_noise)
_APE = FigureOfMerit("APE", LINE_OF_SIGHT, (DISTURBANCE,), _ape, STAGES, MIRROR_STAGES, target=_absolute_tone)
_RPE = replace(
    _APE,
    name="RPE",
    limit=_of_stage(lambda t: t.weights.rpe_limit, lambda t: t.weights.rpe_limit_fine),
    stages=(),
    target=None,
    relative=True,
)

FIGURES = (
    _APE,
    _RPE,
    replace(
        _RPE,
        name="slow",
        stages=STAGES,
        paper=(),
        band=(0.0, band_edge),
        target=_of_stage(lambda t: error_budget(t).slow, lambda t: error_budget(t).tone),
    ),
    replace(
        _RPE,
        name="fast",
        stages=STAGES,
        paper=(),
        band=(band_edge, math.inf),
        target=_of_stage(lambda t: error_budget(t).fast_mirror, lambda t: error_budget(t).fast),
    ),
    FigureOfMerit("noise -> APE", LINE_OF_SIGHT, MEASURED[:1], _ape, paper=FORCE_STAGES),
    FigureOfMerit("all noise -> APE", LINE_OF_SIGHT, MEASURED, lambda t, _: error_budget(t).ape_noise, MIRROR_STAGES),
    FigureOfMerit("noise -> RPE", LINE_OF_SIGHT, MEASURED, _NOISE, MIRROR_STAGES, relative=True),
    FigureOfMerit(
        "mirror",
        _MIRROR,
        (DISTURBANCE,),
        _authority("fsm"),
        MIRROR_STAGES,
        MIRROR_STAGES[:1],
        target=_part(TUNED, _authority("fsm")),
        hard=True,
    ),
    FigureOfMerit(
        "sensitivity, mirror",
        _MIRROR,
        (_MIRROR,),
        _always(MAX_SENSITIVITY),
        MIRROR_STAGES,
        target=_always(TUNED_SENSITIVITY),
        hard=True,
    ),
    FigureOfMerit(
        "force",
        _FORCE,
        (DISTURBANCE,),
        _authority("pma"),
        FORCE_STAGES,
        FORCE_STAGES,
        target=_part(TUNED * FORCE_SHARE, _authority("pma")),
        allowed=FORCE_SHARE,
        hard=True,
    ),
    FigureOfMerit(
        "sensitivity, forces",
        _FORCE,
        (_FORCE,),
        _always(MAX_SENSITIVITY),
        FORCE_STAGES,
        target=_always(TUNED_FORCE_SENSITIVITY),
        hard=True,
    ),
)
"""The table; read it by the functions below."""


def figure(name: str) -> FigureOfMerit:
    """Figure of a name.

    Raises
    ------
    ValueError
        There is none.

    Examples
    --------
    The proof-mass actuators lower the limit of the relative error to 40 %:

    >>> from titop_plant.telescope.load import load_telescope
    >>> alone, both = (figure("fast").limit(load_telescope(), stage) for stage in ("fsm", "fsm+pma"))
    >>> round(both / alone, 3)
    0.4
    """
    for row in FIGURES:
        if row.name == name:
            return row
    raise InputError(f"figure must be one of {', '.join(row.name for row in FIGURES)}, got {name!r}")


def figures(stage: str) -> tuple[FigureOfMerit, ...]:
    """What a stage of the implemented loop must keep.

    Examples
    --------
    >>> [row.name for row in figures("isolator")]
    ['APE', 'slow', 'fast']
    """
    return tuple(row for row in FIGURES if stage in row.stages)


def gain_figures(stage: str) -> tuple[FigureOfMerit, ...]:
    """Those of a stage that are gains."""
    return tuple(row for row in figures(stage) if not row.is_noise)


def noise_figures(stage: str) -> tuple[FigureOfMerit, ...]:
    """Those of a stage that sensor noise makes."""
    return tuple(row for row in figures(stage) if row.is_noise)


def paper_figures(stage: str) -> tuple[FigureOfMerit, ...]:
    """What the paper's problem asks of the controller of a stage, in the order of its gammas.

    Examples
    --------
    >>> [row.name for row in paper_figures("fsm+pma")]
    ['APE', 'RPE', 'noise -> APE', 'force']
    """
    return tuple(row for row in FIGURES if stage in row.paper)


def error_names() -> tuple[str, ...]:
    """Names of the gains from the disturbance to the line of sight: what a tone can be worst for."""
    return tuple(row.name for row in FIGURES if row.is_error)


__all__ = [
    "FIGURES",
    "FORCE_SHARE",
    "FigureOfMerit",
    "error_names",
    "figure",
    "figures",
    "gain_figures",
    "noise_figures",
    "paper_figures",
]
