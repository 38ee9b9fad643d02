"""Results of a model of the telescope that a report shows beside what was measured."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType

from lftkit.errors import InputError
from pointing_analysis.arrays import FloatArray
from pointing_analysis.report.loop_figures import LoopCurves
from pointing_analysis.report.source_share import SourceShare
from pointing_analysis.spectra.prediction import Prediction

ExpectedLines = Mapping[str, tuple[FloatArray, FloatArray]]
"""Label of a run -> frequencies [rad/s] of the disturbance lines and rms [rad] of the line of sight at them."""


@dataclass(frozen=True)
class ModelResults:
    """Results of a model for the runs of a report; what is empty is left out of the page.

    Parameters
    ----------
    lines : what the model expects at the disturbance lines of a run, by its label
        (`pointing_analysis.report.report.labels`); drawn beside the measured lines of several runs
    predictions : for each run predicted and measured amplitude of its tones, or None
    sources : for each run its sources of disturbance with their own errors
    loops : for each run its loop, broken at one place after the other, for Nyquist curves and sensitivity
    without_loop : for each run why its loop is not there; empty where it is, or where none is expected
    """

    lines: ExpectedLines = field(default_factory=lambda: MappingProxyType({}))
    predictions: Sequence[Prediction | None] = ()
    sources: Sequence[Sequence[SourceShare]] = ()
    loops: Sequence[Sequence[LoopCurves]] = ()
    without_loop: Sequence[str] = ()

    def check(self, count: int) -> None:
        """Refuse results that are not those of `count` runs.

        Raises
        ------
        ValueError
        """
        for name in ("predictions", "sources", "loops", "without_loop"):
            results = len(getattr(self, name))
            if results not in (0, count):
                raise InputError(f"{name} must be one for each of the {count} runs, got {results}")


NO_MODEL = ModelResults()
