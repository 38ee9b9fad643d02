"""Which parameter of a box to bisect where no scalings prove it.

The loss of a parameter, ``trace(D z S z*)``, says where the scalings spend their margin, not what a smaller interval
would gain. The parameters with the largest losses may be some whose bisection, even six times over, does not lower the
bound, while small intervals of another one do. So the gain is measured: the level that can be proven with a parameter
held near its lower end, its middle and its upper end, against that of the whole box.
"""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, field

import numpy as np

from lftkit.arrays import FloatArray
from lftkit.proofs.sampled_loop.model import SearchedResponses
from lftkit.proofs.sampled_loop.scalings import ScalingTest
from lftkit.proofs.trusted.proof import REAL, Interval
from lftkit.proofs.trusted.strips import is_circle

Box = tuple[Interval, ...]
HELD = 0.02
"""Part of its interval in which a parameter is held."""
POINTS = 0.0, 0.5, 1.0
"""Where it is held, as parts of the interval."""
RATIO = 1.06
"""Between two levels that are told apart."""
BELOW, ABOVE = 6, 12
"""Levels below and above the one to be proven."""
NEAR = 0.05
"""Part of a frequency within which measured gains are used again."""
SMALL = 1e-3
"""Gain of a parameter that has none, in levels: it is bisected after the others."""


@dataclass
class Branching:
    """Choice of parameters to bisect in the boxes of one proof.

    Parameters
    ----------
    model : SearchedResponses
    level : float
        To be proven.
    until : float
        ``time.monotonic()`` after which nothing is measured.
    """

    model: SearchedResponses
    level: float
    until: float = math.inf
    known: list[tuple[Box, float, FloatArray | None]] = field(default_factory=list)

    def axis(self, box: Box, root: Box, omega: float, losses: FloatArray) -> int | None:
        """Parameter to bisect; None where all elements are disks, which are whole.

        Parameters
        ----------
        box : Box
            Of which nothing was proven at the frequency.
        root : Box
            A box that has it as a part, in which the gains are measured.
        omega : float
            Frequency [rad/s].
        losses : ndarray
            Of the parameters, which decide where holding one of them gains nothing in `root`.
        """
        real = np.array([kind == REAL for kind in self.model.kinds])
        if not np.any(real):
            return None
        gains = self._gains(root, omega)
        if gains is None or not np.any(gains):
            # Losses, for a whole circle of an angle (which has no D, so no loss) half of the largest
            losses = np.array(losses)
            for k, ends in enumerate(box):
                if losses[k] == 0.0 and is_circle(*ends):
                    losses[k] = 0.5 * float(np.max(losses))
            return int(np.argmax(losses))
        left = [(b - a) / (high - low) if high > low else 0.0 for (a, b), (low, high) in zip(box, root)]
        return int(np.argmax(np.where(real, (gains + SMALL) * left, -np.inf)))

    def _gains(self, root: Box, omega: float) -> FloatArray | None:
        """Levels gained by holding each parameter; None where none can be proven of the box."""
        for box, at, gains in self.known:
            if box == root and abs(omega - at) <= NEAR * at:
                return gains
        gains = self._measured(root, omega)
        self.known.append((root, omega, gains))
        return gains

    def _measured(self, root: Box, omega: float) -> FloatArray | None:
        whole = self._least(root, omega, ABOVE)
        if whole is None:
            return None
        gains = np.zeros(len(root))
        for axis, (low, high) in enumerate(root):
            if self.model.kinds[axis] != REAL:
                continue
            worst = -BELOW
            for point in POINTS if high > low else ():
                at, width = low + point * (high - low), HELD * (high - low)
                held = *root[:axis], (max(low, at - width), min(high, at + width)), *root[axis + 1 :]
                least = self._least(held, omega, whole - 1)
                worst = whole if least is None else max(worst, least)
                if worst == whole:
                    break
            gains[axis] = whole - worst if high > low else 0.0
        return gains

    def _least(self, box: Box, omega: float, most: int) -> int | None:
        """Number of the least level that is proven, at most `most`; None where that isn't."""
        if not self._holds(box, omega, most):
            return None
        least, no = most, -BELOW - 1
        while least - no > 1:
            middle = (least + no) // 2
            if self._holds(box, omega, middle):
                least = middle
            else:
                no = middle
        return least

    def _holds(self, box: Box, omega: float, number: int) -> bool:
        if time.monotonic() > self.until:
            return False
        return ScalingTest(self.model, box, omega, self.level * math.pow(RATIO, number)).feasible()[0] is not None
