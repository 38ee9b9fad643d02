"""What is proven of the controllers that fly: by the bundle of the shipped pair, or by one beside a user's controllers.

``statements.json`` is what ``los-testbed design check-proof BUNDLE --json`` says of the bundle of the shipped pair. A
bundle of a user is read and not checked here: that takes minutes.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

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
    """

    bundle: str
    figures: tuple[str, ...]
    checked: bool

    @property
    def text(self) -> str:
        """One line."""
        which = f"bundle {self.bundle}" + ("" if self.checked else ", not checked here")
        return (
            f"proven for every telescope of the family and tones of norm 1 in all: {', '.join(self.figures)} ({which})"
        )


NO_PROOF = "no proof of these controllers on this telescope is at hand"
"""What is said where no bundle fits."""


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
        found = tuple(str(row["text"]) for row in shipped["figures"] if row["stage"] == stage)
        return Statement(shipped["name"], found, True) if found else None
    if folder is None or not (folder / BUNDLE).is_file():
        return None
    from lftkit.proofs.verdict import ProofError
    from los_design.verification.bundle import figures_proven, open_bundle

    try:
        with open_bundle(folder / BUNDLE) as bundle:
            if not bundle.subject.covers(subject, stage):
                return None
            figures = figures_proven(bundle, stage)
            return Statement(bundle.name, figures, False) if figures else None
    except ProofError:
        return None
