"""Designs in a folder: read where they are there, made where they are missing, continued where interrupted."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from lftkit import SampledSystem
from lftkit.support.job import Job
from lftkit.tuning import TuningStatus
from los_design.synthesis.options import DesignOptions
from los_design.synthesis.provenance import law_digest

FINISHED = {"finished": True}
"""State of the job of a design that came to its end."""


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
        make: Callable[[Job], Sequence[SampledSystem]],
        options: DesignOptions,
        fixed: Mapping[str, SampledSystem] | None = None,
    ) -> list[SampledSystem]:
        """What `make` designs; read if the files are there and were made for the same.

        A design that the wall limit ended is written, and goes on in another call.

        Parameters
        ----------
        names : sequence of str
            Of the files, one for each controller that is designed.
        make : callable
            Receives the job, whose record keeps the state between rounds, and gives the controllers.
        options : DesignOptions
            They must be the same, but for the wall limit, the processes and the progress bar.
        fixed : mapping of str to SampledSystem, optional
            Controllers that the design depends on.
        """
        key: dict[str, Any] = {"telescope": self.telescope, **asdict(options)}
        key |= {"wall_limit": 0.0, "progress": False, "workers": 1}
        key |= {name: law_digest(system) for name, system in (fixed or {}).items()}
        paths = [self.folder / f"{name}.json" for name in names]
        job = Job("design", key, self.folder / "build" / f"{names[-1]}.json")
        if all(path.exists() for path in paths) and job.state() == FINISHED:
            return [SampledSystem.from_file(path) for path in paths]
        job.record.parent.mkdir(parents=True, exist_ok=True)
        systems = [replace(system, provenance={**system.provenance, "command": self.command}) for system in make(job)]
        for path, system in zip(paths, systems, strict=True):
            system.to_file(path)
            self.report(f"{path.name}: {system.provenance['status']}")
        if all(system.provenance["status"] != TuningStatus.OUT_OF_TIME for system in systems):
            job.save(FINISHED)
        return systems
