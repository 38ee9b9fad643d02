"""Designs in a folder: read where they are there, made where they are missing, continued where interrupted."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from lftkit import SampledSystem
from lftkit.tuning import TuningStatus
from los_design.synthesis.options import DesignOptions
from los_design.synthesis.provenance import digest
from los_design.synthesis.round_state import Kept
from pointing_analysis.files.atomic_output import write_text


@dataclass(frozen=True)
class DesignFolder:
    """Files of designs, and in ``build`` what each was made for.

    Parameters
    ----------
    folder : Path
        Made if it does not exist.
    telescope : str
        Hash of its parameters.
    command : str
        That makes them, for their provenance.
    report : callable
        Receives a line for each file that is written.
    """

    folder: Path
    telescope: str
    command: str
    report: Callable[[str], None] = lambda text: None

    def made(
        self,
        names: Sequence[str],
        make: Callable[[Kept], Sequence[SampledSystem]],
        options: DesignOptions,
        given: Mapping[str, SampledSystem] | None = None,
    ) -> list[SampledSystem]:
        """What `make` designs; read if the files are there and were made for the same.

        A design that the wall limit ended is written, and goes on in another call.

        Parameters
        ----------
        names : sequence of str
            Of the files, one for each controller that is designed.
        make : callable
            Receives the file of the state between rounds and what it is made for, and gives the controllers.
        options : DesignOptions
            They must be the same, but for the wall limit and the progress bar.
        given : mapping of str to SampledSystem, optional
            Controllers that the design depends on.
        """
        key: dict[str, Any] = {"telescope": self.telescope, **asdict(options), "wall_limit": 0.0, "progress": False}
        key |= {name: digest(system) for name, system in (given or {}).items()}
        paths = [self.folder / f"{name}.json" for name in names]
        keys = self.folder / "build" / f"{names[-1]}.key"
        if keys.exists() and all(path.exists() for path in paths) and json.loads(keys.read_text("utf-8")) == key:
            return [SampledSystem.from_file(path) for path in paths]
        keys.parent.mkdir(parents=True, exist_ok=True)
        keys.unlink(missing_ok=True)
        rounds = keys.with_suffix(".rounds.json")
        systems = [
            replace(system, provenance={**system.provenance, "command": self.command}) for system in make((rounds, key))
        ]
        for path, system in zip(paths, systems, strict=True):
            system.to_file(path)
            self.report(f"{path.name}: {system.provenance['status']}")
        if all(system.provenance["status"] != TuningStatus.OUT_OF_TIME for system in systems):
            write_text(keys, json.dumps(key))
            rounds.unlink(missing_ok=True)
        return systems
