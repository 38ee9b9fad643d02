"""The paper's own problem, continuous and without delay: its telescope, its four designs, the members drawn."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import numpy as np
from paper_stages import PaperStages

from lftkit import SampledSystem
from lftkit.errors import InputError
from los_design.figures.stage_curves import NAMES
from titop_plant.disturbances.responses import Curve, DisturbanceResponses, disturbance_responses
from titop_plant.interface import STAGES
from titop_plant.telescope.assembly import AssembledTelescope, assembled_telescope
from titop_plant.telescope.load import load_telescope
from titop_plant.telescope.telescope import Telescope

ALONE = "k_fsm_alone.json"
KINDS, FAMILY = ("k_fsm", "k_pma"), "family_worst_cases"
"""Stems of the files, and in their provenance the worst members of a nominal design over the family."""
DESIGNS = {"robust": "", "nominal": "_nominal"}
"""Name of a pair of designs to what its files have behind the kind."""

Pair = tuple[SampledSystem, SampledSystem]
"""K_FSM and K_PMA; their files hold the continuous controllers."""


@dataclass(frozen=True)
class PaperCase:
    """What the paper's figures are drawn from; what is slow is computed when it is first asked for.

    Parameters
    ----------
    file : str or None
        Parameter file; None for the reference telescope.
    pairs : mapping of str to (SampledSystem, SampledSystem)
        ``robust`` and ``nominal``.
    samples : int
        Random members of the family beside the nominal one and the worst ones of the designs.
    seed : int
    alone : SampledSystem, optional
        The robust K_FSM before it was tuned together with K_PMA.
    corners : bool
        Whether all corners of the parameters' ranges are members, too.
    """

    file: str | None
    pairs: Mapping[str, Pair]
    samples: int = 16
    seed: int = 0
    alone: SampledSystem | None = None
    corners: bool = True
    _clouds: dict[str, dict[str, list[Curve]]] = field(default_factory=dict, repr=False, compare=False)

    @classmethod
    def of(cls, folder: Path, samples: int = 16, seed: int = 0) -> PaperCase:
        """Of a folder with ``telescope.toml`` and ``designs``.

        Raises
        ------
        ValueError
            A file is missing or of another form, a negative number of samples.
        """
        if samples < 0:
            raise InputError(f"samples must not be negative, got {samples}")
        pairs: dict[str, Pair] = {}
        for name, ending in DESIGNS.items():
            k_fsm, k_pma = (folder / "designs" / f"{kind}{ending}.json" for kind in KINDS)
            pairs[name] = SampledSystem.from_file(k_fsm), SampledSystem.from_file(k_pma)
        file = folder / "telescope.toml"
        if not file.is_file():
            raise InputError(f"the folder must hold telescope.toml, got none in {folder}")
        alone = folder / "designs" / ALONE
        return cls(str(file), pairs, samples, seed, SampledSystem.from_file(alone) if alone.is_file() else None)

    @cached_property
    def telescope(self) -> Telescope:
        """Of the telescope."""
        return load_telescope(self.file)

    @cached_property
    def assembled(self) -> AssembledTelescope:
        """On its isolator."""
        return assembled_telescope(self.telescope)

    @cached_property
    def responses(self) -> DisturbanceResponses:
        """Without fine control."""
        return disturbance_responses(self.telescope)

    def loop(self, design: str) -> PaperStages:
        """The stages with a pair of designs."""
        return PaperStages.of(self.telescope, self.responses, self.pairs[design])

    @property
    def _alone(self) -> tuple[SampledSystem, ...]:
        return () if self.alone is None else (self.alone,)

    @cached_property
    def worst_members(self) -> list[dict[str, float]]:
        """Parameters that the designs' files name as worst for one of their requirements, each once."""
        found = {
            tuple(sorted(case["parameters"].items())): dict(case["parameters"])
            for system in (*(system for pair in self.pairs.values() for system in pair), *self._alone)
            for case in (*system.provenance.get("worst_cases", ()), *system.provenance.get(FAMILY, ()))
        }
        return [values for values in found.values() if values]

    @cached_property
    def members(self) -> list[dict[str, float]]:
        """Nominal, random and worst members and the corners: the same for both pairs of designs."""
        drawn = self.assembled.system.sample_values(np.random.default_rng(self.seed), self.samples)
        return [{}, *(self.telescope.corners() if self.corners else ()), *drawn, *self.worst_members]

    def clouds(self, design: str) -> Mapping[str, list[Curve]]:
        """Stage to the curve of each member, with a pair of designs."""
        if design not in self._clouds:
            loop = self.loop(design)
            known = next(iter(self._clouds.values()), {})  # without fine control the designs have no effect
            self._clouds[design] = {
                stage: known[stage]
                if stage in NAMES and stage in known
                else [loop.curve(stage, values) for values in self.members]
                for stage in STAGES
            }
        return self._clouds[design]
