"""What is proven of the controllers that fly: by the bundle of the shipped pair, or by one beside a user's controllers.

``statements.json`` is what ``los-testbed design check-proof --json`` says of the bundle of the shipped pair. A
bundle of a user is read and not checked here: that takes minutes.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from los_design.verification.error_sum import (
    PART,
    WITH_NOISE,
    ErrorSum,
    probability_text,
    required_probabilities,
)
from los_design.verification.subject import BUNDLE, Subject
from titop_plant.telescope.telescope import Telescope

SHIPPED = Path(__file__).with_name("statements.json")


@dataclass(frozen=True)
class Statement:
    """What was proven of a stage, for all members of the telescope's family.

    Parameters
    ----------
    bundle : str
        Name of the bundle by its content.
    figures : tuple of str
        Each with its bound and its limit.
    checked : bool
        Whether the check of the bundle was seen to pass; else the bundle says so and nobody looked.
    relative : float or None
        Upper bound of the weighted amplitude of the relative error of any tone [rad]; None where slow or fast tones
        are not proven. **No exposure has a larger rms**: the variance of a tone within a window is, for every phase and
        frequency, below the square of the amplitude times the weight of the relative error.
    """

    bundle: str
    figures: tuple[str, ...]
    checked: bool
    relative: float | None = None
    sums: tuple[ErrorSum, ...] = ()
    """Proven sums of tones and noise; none where the noise was not proven."""

    @property
    def with_noise(self) -> tuple[str, ...]:
        """These sums, each with its limit."""
        return tuple(row.short_text for row in self.sums)

    @property
    def probabilities(self) -> tuple[float, ...]:
        """With which each of these sums is kept."""
        return tuple(float(row.probability or 0.0) for row in self.sums)

    @property
    def text(self) -> str:
        """One line on tones."""
        which = f"bundle {self.bundle[:12]}" + ("" if self.checked else ", not checked here")
        said = f"{', '.join(self.figures)} ({which})"
        return f"proven for every telescope of the family and tones of norm 1 in all: {said}"

    @property
    def noise_text(self) -> str:
        """One line on the same tones with noise; empty where the noise was not proven.

        Examples
        --------
        >>> from dataclasses import replace
        >>> names = ("APE, tone of norm 1 and noise", "RPE, slow tone of norm 1 and noise")
        >>> sums = ErrorSum(names[0], 9.947, 12.0, "arcsec", 0.997), ErrorSum(names[1], 65.581, 90.0, "mas", 0.997)
        >>> Statement("0", (), True, None, sums).noise_text
        'with noise, proven: APE 9.947 of 12 arcsec, slow tone 65.581 of 90 mas, each with probability 0.997'
        >>> other = replace(sums[1], probability=0.9999)
        >>> Statement("0", (), True, None, (sums[0], other)).noise_text[20:]
        'APE 9.947 of 12 arcsec with probability 0.997, slow tone 65.581 of 90 mas with probability 0.9999'
        """
        if not self.sums:
            return ""
        words = [probability_text(part) for part in self.probabilities]
        if len(set(words)) == 1:
            said = [*self.with_noise, f"each {words[0]}"]
        else:
            said = [f"{text} {how_often}" for text, how_often in zip(self.with_noise, words)]
        return f"with noise, proven: {', '.join(said)}"


TONES = ("slow", "fast")
"""Figures that bound the relative error, together of every frequency."""
NO_PROOF = "no proof of these controllers on this telescope is at hand"
"""What is said where no bundle fits."""


def relative_error(levels: Mapping[str, float]) -> float | None:
    """The larger of the bounds on slow and on fast tones; None where one is missing.

    Parameters
    ----------
    levels : mapping of str to float
        Bound of each figure [rad].
    """
    return max(levels[name] for name in TONES) if set(TONES) <= set(levels) else None


def statement_of(
    subject: Subject, stage: str, folder: Path | None, telescope: Telescope | None = None
) -> Statement | None:
    """What is proven of controllers on a telescope.

    Parameters
    ----------
    subject : Subject
    stage : str
        With fine control.
    folder : Path or None
        Of a user's controllers, where a bundle may be.
    parameters : mapping, optional
        Of the telescope. The probability of the mirror's requirement on windows is no part of the subject's name: where
        another one is asked for, the sums with noise are computed for it. Without, they are of the shipped telescope;
        their text says the probability.

    Raises
    ------
    ProofError
        The folder's bundle cannot be read.
    """
    shipped = json.loads(SHIPPED.read_text("utf-8"))
    if Subject(**shipped["subject"]).covers(subject, stage):
        rows = [row for row in shipped["figures"] if row["stage"] == stage]
        texts = tuple(str(row["text"]) for row in rows if not str(row["figure"]).startswith(PART))
        levels = {str(row["figure"]): float(row["level"]) * float(row["limit"]) for row in rows}
        sums = _sums(shipped, stage, levels, telescope)
        return Statement(shipped["name"], texts, True, relative_error(levels), tuple(sums)) if texts else None
    if folder is None or not (folder / BUNDLE).is_file():
        return None
    from los_design.verification.bundle import figures_proven, levels_proven, open_bundle

    with open_bundle(folder / BUNDLE) as bundle:
        if not bundle.subject.covers(subject, stage):
            return None
        figures = figures_proven(bundle, stage)
        relative = relative_error(levels_proven(bundle, stage))
        return Statement(bundle.name, figures, False, relative) if figures else None


def _sums(
    shipped: Mapping[str, Any], stage: str, levels: Mapping[str, float], telescope: Telescope | None
) -> list[ErrorSum]:
    """Sums of tones and noise of the shipped pair, with the probabilities that a telescope asks for."""
    names = ("name", "value", "limit", "unit", "probability")
    sums = [ErrorSum(*(row[name] for name in names)) for row in shipped["sums"].get(stage, ())]
    sums = [row for row in sums if row.name in WITH_NOISE]
    if telescope is None or not sums:
        return sums
    instants, windows = required_probabilities(telescope, stage)
    if all(row.probability == (instants if row.name.startswith("APE") else windows) for row in sums):
        return sums
    from lftkit.proofs.trusted.noise import NoiseBound
    from los_design.verification.combined_bounds import error_sums

    absolute, relative = (NoiseBound(**bound) for bound in shipped["noise"][stage])
    return [row for row in error_sums(telescope, stage, levels, (absolute, relative)) if row.name in WITH_NOISE]
