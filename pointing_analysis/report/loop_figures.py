"""Nyquist curves and sensitivity of the loop that ran, as a model gives them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Circle

from pointing_analysis.arrays import ComplexArray, FloatArray
from pointing_analysis.report.figures import LIMIT, Picture, _panels, legend_above, picture, stroke

REACH = 2.6
"""Half of the width of a Nyquist picture: what matters is near the critical point -1."""


@dataclass(frozen=True)
class LoopCurves:
    """Loop broken at one place, all others closed; the critical point is -1.

    Attributes
    ----------
    place : where it is broken, such as ``mirror``
    omega : (k,) frequencies [rad/s]
    loci : (k, n) eigenvalues of the open loop L at each frequency
    sensitivity : (k,) largest singular value of ``(I + L)^-1``
    limit : largest sensitivity that a design may have
    """

    place: str
    omega: FloatArray
    loci: ComplexArray
    sensitivity: FloatArray
    limit: float


def nyquist(names: Sequence[str], loops: Sequence[Sequence[LoopCurves]]) -> Picture | None:
    """Eigenvalues of the open loop of each run, one panel for each place where it is broken."""
    places = _places(loops)
    if not places:
        return None

    def draw(figure: Figure) -> None:
        for axis, place in zip(_panels(figure, len(places), columns=len(places)), places):
            for i, (name, curves) in enumerate(zip(names, loops)):
                for curve in (c for c in curves if c.place == place):
                    inside = np.where(np.abs(curve.loci) < 3.0 * REACH, curve.loci, np.nan)
                    for k in range(inside.shape[1]):
                        label = name if k == 0 else "_nolegend_"
                        axis.plot(inside[:, k].real, inside[:, k].imag, label=label, **stroke(i, len(names)))
                    axis.add_patch(Circle((-1.0, 0.0), 1.0 / curve.limit, fill=False, color=LIMIT, ls="--"))
            axis.plot(-1.0, 0.0, "+", color=LIMIT, ms=8)
            axis.set(xlim=(-REACH, REACH), ylim=(-REACH, REACH), aspect="equal", title=place, xlabel="real part")
            axis.set_ylabel("imaginary part")
        legend_above(figure, figure.axes[0])

    alt = "Eigenvalues of the open loop in the complex plane, with the critical point -1 and the circle of the limit"
    return picture("nyquist", "Nyquist curves of the loop (model)", alt, 4.6 / len(places), draw)


def sensitivity(names: Sequence[str], loops: Sequence[Sequence[LoopCurves]]) -> Picture | None:
    """Sensitivity of each run over frequency, one panel for each place where the loop is broken."""
    places = _places(loops)
    if not places:
        return None

    def draw(figure: Figure) -> None:
        for axis, place in zip(_panels(figure, len(places)), places):
            for i, (name, curves) in enumerate(zip(names, loops)):
                for curve in (c for c in curves if c.place == place):
                    axis.semilogx(curve.omega, curve.sensitivity, label=name, **stroke(i, len(names)))
                    axis.axhline(curve.limit, color=LIMIT, ls="--")
            axis.set(title=place, ylabel="largest singular value", ylim=(0.0, None))
        figure.axes[-1].set_xlabel("frequency [rad/s]")
        legend_above(figure, figure.axes[0])

    peaks = ", ".join(
        f"{name}, {c.place}: peak {c.sensitivity.max():.3g}" for name, curves in zip(names, loops) for c in curves
    )
    return picture(
        "sensitivity", "Sensitivity of the loop (model)", f"Sensitivity; {peaks}", 1.2 + 1.8 * len(places), draw
    )


def _places(loops: Sequence[Sequence[LoopCurves]]) -> list[str]:
    return list(dict.fromkeys(curve.place for curves in loops for curve in curves))
