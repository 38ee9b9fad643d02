"""Names of what a statement is about: controllers and telescope, by their numbers."""

from __future__ import annotations

from dataclasses import dataclass

from lftkit.systems.sampled.sampled_system import SampledSystem
from los_design.synthesis.provenance import law_digest
from titop_plant.interface import FORCE_STAGES

BUNDLE = "bundle.zip"
"""Name of a bundle of proofs beside the controllers that it is about."""


@dataclass(frozen=True)
class Subject:
    """Names of what a statement is about: digests of both controllers' matrices and of the telescope's values."""

    k_fsm: str
    k_pma: str
    telescope: str

    @classmethod
    def of(cls, k_fsm: SampledSystem, k_pma: SampledSystem, telescope: str) -> Subject:
        """Of controllers and the :attr:`titop_plant.telescope.telescope.Telescope.digest` of their telescope."""
        return cls(law_digest(k_fsm), law_digest(k_pma), telescope)

    def covers(self, other: Subject, stage: str) -> bool:
        """Whether a statement is about what flies; without proof-mass actuators K_PMA does not count."""
        same = self.k_fsm == other.k_fsm and self.telescope == other.telescope
        return same and (stage not in FORCE_STAGES or self.k_pma == other.k_pma)
