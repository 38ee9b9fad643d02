"""What is proven of the controllers that fly: by the bundle of the shipped pair, or by one beside a user's controllers.

``statements.json`` is what ``los-testbed design check-proof BUNDLE --json`` says of the bundle of the shipped pair. A
bundle of a user is read and not checked here: that takes minutes.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from los_design.verification.error_sum import PARTS, WITH_NOISE, ErrorSum
from los_design.verification.subject import BUNDLE, Subject

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
    with_noise: tuple[str, ...] = ()
    """Proven sums of tones and noise, each with its limit; none where the noise was not proven."""

    @property
    def text(self) -> str:
        """One line on tones."""
        which = f"bundle {self.bundle}" + ("" if self.checked else ", not checked here")
        said = f"{', '.join(self.figures)} ({which})"
        return f"proven for every telescope of the family and tones of norm 1 in all: {said}"

    @property
    def noise_text(self) -> str:
        """One line on the same tones with noise; empty where the noise was not proven.

        Examples
        --------
        >>> Statement("0", (), True, with_noise=("APE 9.947 of 12 arcsec", "slow tone 65.581 of 90 mas")).noise_text
        'with noise, proven: APE 9.947 of 12 arcsec, slow tone 65.581 of 90 mas'
        """
        return f"with noise, proven: {', '.join(self.with_noise)}" if self.with_noise else ""


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


def statement_of(subject: Subject, stage: str, folder: Path | None) -> Statement | None:
    """What is proven of controllers on a telescope.

    Parameters
    ----------
    subject : Subject
    stage : str
        With fine control.
    folder : Path or None
        Of a user's controllers, where a bundle may be.
    """
    shipped = json.loads(SHIPPED.read_text("utf-8"))
    if Subject(**shipped["subject"]).covers(subject, stage):
        rows = [row for row in shipped["figures"] if row["stage"] == stage]
        found = tuple(str(row["text"]) for row in rows if row["figure"] not in PARTS)
        levels = {str(row["figure"]): float(row["level"]) * float(row["limit"]) for row in rows}
        sums = tuple(
            ErrorSum(row["name"], row["value"], row["limit"], row["unit"]).short_text
            for row in shipped["sums"].get(stage, ())
            if row["name"] in WITH_NOISE
        )
        return Statement(shipped["name"], found, True, relative_error(levels), sums) if found else None
    if folder is None or not (folder / BUNDLE).is_file():
        return None
    from lftkit.proofs.trusted.proof import ProofError
    from los_design.verification.bundle import figures_proven, levels_proven, open_bundle

    try:
        with open_bundle(folder / BUNDLE) as bundle:
            if not bundle.subject.covers(subject, stage):
                return None
            figures = figures_proven(bundle, stage)
            relative = relative_error(levels_proven(bundle, stage))
            return Statement(bundle.name, figures, False, relative) if figures else None
    except ProofError:
        return None
