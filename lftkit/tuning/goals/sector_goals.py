"""Goals for the energy of a channel: passivity and conic sectors."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import linalg

from lftkit.errors import InputError
from lftkit.systems.arguments import checked
from lftkit.systems.system import System
from lftkit.tuning.requirements import TuningRequirement
from lftkit.tuning.requirements.sector import SectorGain

Fraction = tuple[float, float, float, float]


@dataclass(frozen=True)
class _OfChannel:
    """A goal for a channel with as many outputs as inputs."""

    inputs: tuple[str, ...]
    outputs: tuple[str, ...]

    def __post_init__(self) -> None:
        for side in ("inputs", "outputs"):
            ports = getattr(self, side)
            object.__setattr__(self, side, (ports,) if isinstance(ports, str) else tuple(ports))

    def prepared(self, model: System) -> System:
        """The model as it is.

        Raises
        ------
        ValueError
            Ports that do not exist, or sides of different sizes.
        """
        columns, rows = model.input_indices(self.inputs), model.output_indices(self.outputs)
        if len(columns) != len(rows):
            raise InputError(
                f"{type(self).__name__} must be asked of as many outputs as inputs, got {len(rows)} and {len(columns)}"
            )
        return model

    def _requirement(
        self, model: System, fraction: Fraction, unit: float, hard: bool, name: str, band: tuple[float, float]
    ) -> tuple[TuningRequirement, ...]:
        called = name or f"{type(self).__name__} {'+'.join(self.inputs)} -> {'+'.join(self.outputs)}"
        common = {"hard": hard, "name": called, "band": band, "fraction": fraction}
        index = SectorGain(self.inputs, self.outputs, unit, **common)  # type: ignore[arg-type]
        columns, rows = model.input_indices(self.inputs), model.output_indices(self.outputs)
        without = not (model.D[rows].any() and model.D[:, columns].any())
        # The descents cannot leave an edge that no parameter moves
        if hard and without and band[1] == np.inf and abs(fraction[1]) > (1.0 - 1e-3) * abs(fraction[3]):
            raise InputError(
                f"{called}: a channel without feedthrough is at the edge of the sector at infinite frequency; a hard "
                "goal must have a band that ends before, or a sector with zero inside, got none"
            )
        return (index,)


def _check_unit(unit: float) -> None:
    if not (np.isfinite(unit) and unit > 0.0):
        raise InputError(f"unit must be positive, got {unit}")


@checked
@dataclass(frozen=True)
class Passivity(_OfChannel):
    """Energy goes into a channel: ``int z'w >= input_index int w'w + output_index int z'z`` from rest.

    Parameters
    ----------
    inputs, outputs : tuple of str (or one str)
        Ports of w and z: force and velocity, voltage and current, of the same size.
    input_index, output_index : float
        What a passive channel has to spare, [output unit / input unit] and its inverse; a negative `input_index` is a
        shortage that is admitted. Their product is below 1/4, as for every stable channel.
    unit : float
        Size of the channel's gain that matters most [output unit / input unit]: it has no effect on whether the value
        is at most 1, only on how far the value is from it.
    hard : bool
    name : str
    band : (lowest, highest)
        Frequencies that count [rad/s], all by default; in a band it is the real part of the response that is asked for.

    Notes
    -----
    The value is the relative index of the sector, for indices of 0 the largest gain of ``(T - unit) (T + unit)^-1``,
    which is at most 1 for passive T (Desoer and Vidyasagar 1975, section VI). A channel without feedthrough has the
    value 1 at infinite frequency, whatever the controller: soft, it cannot be better; hard, it needs a band or a
    negative `input_index`. The descents need a distance from the edge there: ``-0.05 unit``, or a band in which the
    response is not much smaller than the unit. :func:`lftkit.tuning.certify` says what the result is on the whole axis.

    Examples
    --------
    The velocity of a mass on a damper is passive under a force, its position is not:

    >>> from lftkit.systems.connection.filters import transfer
    >>> from lftkit.tuning import certify
    >>> def index(numerator, denominator):
    ...     channel = transfer(numerator, denominator)
    ...     goal, = Passivity("in", "out").requirements_on(channel)
    ...     nothing = System.static(np.zeros((0, 0)), [], [])
    ...     return certify([channel], nothing, [goal]).values.item()
    >>> round(index([1.0], [1.0, 1.0]), 3), round(index([1.0], [1.0, 1.0, 1.0]), 3)
    (1.0, 1.785)
    """

    input_index: float = 0.0
    output_index: float = 0.0
    unit: float = 1.0
    hard: bool = False
    name: str = ""
    band: tuple[float, float] = (0.0, float("inf"))

    def __post_init__(self) -> None:
        super().__post_init__()
        _check_unit(self.unit)
        if not (np.isfinite(self.input_index) and np.isfinite(self.output_index) and self.output_index >= 0.0):
            raise InputError(
                "input_index must be finite and output_index finite and not negative, got "
                f"{self.input_index} and {self.output_index}"
            )
        if not 4.0 * self.input_index * self.output_index < 1.0:
            raise InputError(
                f"input_index times output_index must be below 1/4, got {self.input_index} and {self.output_index}"
            )

    def requirements_on(self, model: System) -> tuple[TuningRequirement, ...]:
        """One index."""
        form = np.array([[2.0 * self.output_index * self.unit, -1.0], [-1.0, 2.0 * self.input_index / self.unit]])
        (low, high), vectors = linalg.eigh(form)
        above, below = np.sqrt(high) * vectors[:, 1], np.sqrt(-low) * vectors[:, 0]
        fraction = float(above[0]), float(above[1]), float(below[0]), float(below[1])
        return self._requirement(model, fraction, self.unit, self.hard, self.name, self.band)


@checked
@dataclass(frozen=True)
class ConicSector(_OfChannel):
    """A channel within a sector: ``int (z - low w)'(z - high w) <= 0`` from rest.

    Parameters
    ----------
    inputs, outputs : tuple of str (or one str)
        Ports of w and z, of the same size.
    low, high : float
        Slopes of the sector [output unit / input unit]; one of them may be infinite.
    unit : float
        With an infinite slope, as in :class:`Passivity`.
    hard : bool
    name : str
    band : (lowest, highest)
        Frequencies that count [rad/s], all by default.

    Notes
    -----
    With finite slopes the value is the largest gain of ``T - (low + high) / 2`` over ``(high - low) / 2`` (Zames 1966);
    with an infinite one that of :class:`Passivity` for ``T - low`` or ``high - T``. With an edge at 0 the same holds
    for channels without feedthrough as in :class:`Passivity`.

    Examples
    --------
    >>> ConicSector("w", "z", low=-1.0, high=3.0).fraction
    (0.5, -0.5, 0.0, 1.0)
    """

    low: float = 0.0
    high: float = float("inf")
    unit: float = 1.0
    hard: bool = False
    name: str = ""
    band: tuple[float, float] = (0.0, float("inf"))

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.low < self.high or (np.isinf(self.low) and np.isinf(self.high)):
            raise InputError(f"low must be below high, one of them finite, got {self.low} and {self.high}")
        _check_unit(self.unit)

    @property
    def fraction(self) -> Fraction:
        """Coefficients of :class:`lftkit.tuning.requirements.sector.SectorGain`."""
        low, high = self.low, self.high
        if np.isinf(high):
            return 1.0, -low - self.unit, 1.0, -low + self.unit
        if np.isinf(low):
            return -1.0, high - self.unit, -1.0, high + self.unit
        half = 0.5 * (high - low)
        return 1.0 / half, -0.5 * (low + high) / half, 0.0, 1.0

    def requirements_on(self, model: System) -> tuple[TuningRequirement, ...]:
        """One index."""
        return self._requirement(model, self.fraction, 1.0, self.hard, self.name, self.band)
