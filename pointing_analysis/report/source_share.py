"""A source of disturbance and the errors that it makes alone."""

from __future__ import annotations

from dataclasses import dataclass

from pointing_analysis.requirements.rows import digits


@dataclass(frozen=True)
class SourceShare:
    """One source and its own errors.

    Attributes
    ----------
    name, kind, place : str
        Of the source.
    ape : float
        99.7 % quantile of its absolute error, both axes [arcsec].
    rpe : float
        Its relative error, rms of both axes in its windows [mas].
    share : float
        Its part of the sum of squares of the relative errors of all sources, between 0 and 1.
    """

    name: str
    kind: str
    place: str
    ape: float
    rpe: float
    share: float

    @property
    def shown(self) -> dict[str, str]:
        """The fields as a table has them."""
        errors = {"ape": digits(self.ape), "rpe": digits(self.rpe), "share": f"{100 * self.share:.3g} %"}
        return {"name": self.name, "kind": self.kind, "place": self.place, **errors}
