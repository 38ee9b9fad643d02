"""Verdicts on designs under the disturbance sources of their telescope's file, which the tuning does not consider."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from los_testbed.config.members import worst_member
from los_testbed.config.run_config import RunConfig
from los_testbed.config.run_settings import of_designs, with_scenario
from los_testbed.parts.run_parts import RunParts
from pointing_analysis.formatting.number_text import digits, digits_beside, number
from pointing_analysis.requirements.rows import WITHIN, RequirementRow
from titop_plant.interface import NO_SCENARIO, STAGES

SECONDS = 20.0
"""Length of each run."""
OPENED = STAGES[1]
"""Stage without fine control, on the isolator."""
MET = ("compliant", WITHIN)


@dataclass(frozen=True)
class MissionVerdict:
    """A requirement of a stage with its controllers under the sources.

    Parameters
    ----------
    stage, member : str
    requirement : RequirementRow or None
        None: the loop diverged, or a part of it failed.
    without : float
        The judged quantile without fine control, in the unit of the requirement.
    failure : str
    """

    stage: str
    member: str
    requirement: RequirementRow | None
    without: float
    failure: str = ""

    @property
    def met(self) -> bool:
        """Whether the limit is met, or the requirement cannot be judged by such a run."""
        row = self.requirement
        return row is not None and (row.shown in MET or row.status == "not judged")

    @property
    def text(self) -> str:
        """One line."""
        head, row = f"{self.stage}, {self.member}, under the sources of the telescope", self.requirement
        if row is None:
            return f"{head}: {self.failure}"
        side = "at least" if row.lower else "below"
        value = digits_beside(row.value, row.limit)
        beside = f"{digits(self.without)} {row.unit} without fine control"
        return f"{head}: {row.quantity} {value} {row.unit}, must be {side} {row.limit:g} {row.unit} ({beside})"

    def as_dict(self) -> dict[str, Any]:
        """For JSON."""
        row = self.requirement
        values = {} if row is None else {**row.as_dict(), "without_fine_control": number(self.without)}
        return {
            "stage": self.stage,
            "member": self.member,
            **values,
            **({"failure": self.failure} if self.failure else {}),
        }


@dataclass(frozen=True)
class Mission:
    """Verdicts under the sources of a telescope.

    Parameters
    ----------
    sources : tuple of str
        Their names; empty where the telescope has none.
    verdicts : tuple of MissionVerdict
    rpe : mapping
        Stage and member to the relative error [mas rms] with and without fine control.
    """

    sources: tuple[str, ...] = ()
    verdicts: tuple[MissionVerdict, ...] = ()
    rpe: Mapping[tuple[str, str], tuple[float, float]] | None = None

    @property
    def not_met(self) -> list[str]:
        """One line for each requirement that is not met."""
        return [verdict.text for verdict in self.verdicts if not verdict.met]

    @property
    def statements(self) -> list[str]:
        """Performance under the sources of controllers tuned without them."""
        names = ", ".join(self.sources)
        return [
            f"the tuning does not consider {names}: {stage}, {member}, RPE {digits(closed)} mas rms under them, "
            f"{digits(opened)} without fine control{' (control makes it worse)' if closed > opened else ''}"
            for (stage, member), (closed, opened) in (self.rpe or {}).items()
        ]

    def to_mapping(self) -> dict[str, Any]:
        """For JSON; empty without sources."""
        if not self.sources:
            return {}
        rpe = [
            {"stage": stage, "member": member, "rpe_rms_mas": number(closed), "without_fine_control": number(opened)}
            for (stage, member), (closed, opened) in (self.rpe or {}).items()
        ]
        return {
            "mission": {
                "sources": list(self.sources),
                "seen_by_the_tuning": False,
                "seconds": SECONDS,
                "relative_error": rpe,
                "requirements": [verdict.as_dict() for verdict in self.verdicts],
            }
        }


NO_MISSION = Mission()
"""Of a telescope without sources."""


def sources_of_mission(parameters: str | None) -> tuple[str, ...]:
    """Names of the sources of a telescope's file; rejects unusable ones before hours of computation.

    Raises
    ------
    ValueError
        A source that cannot be used in a run of `SECONDS`.
    """
    config = with_scenario(RunConfig(parameters=parameters, duration=SECONDS, loop=OPENED))
    return tuple(one.name for one in RunParts(config).sources) if config.scenario == NO_SCENARIO else ()


def verify_mission(folder: Path, report: Callable[[str], None] = lambda text: None) -> Mission:
    """Runs of the stages of a folder of designs under the sources of its telescope, judged by its requirements.

    The members are the nominal one and the worst one of each stage for the relative error; each run has sensor noise
    and no tones of a scenario.

    Parameters
    ----------
    folder : Path
        Of ``los-testbed design all``.
    report : callable
        Receives one line for each member and stage.
    """
    settings = of_designs(str(folder))
    stated = {**settings, "mode": "inprocess", "duration": SECONDS, "loop": OPENED}  # a stage that every telescope has
    base = with_scenario(RunConfig.from_mapping(stated))
    parts = RunParts(base)
    if base.scenario != NO_SCENARIO or not parts.sources:
        return Mission()
    verdicts: list[MissionVerdict] = []
    rpe: dict[tuple[str, str], tuple[float, float]] = {}
    for stage in parts.telescope.mirror_stages:
        worst = worst_member(stage, "RPE", base.parameters, str(folder))
        for member, values in {"nominal": {}, **({"worst for the RPE": worst} if worst else {})}.items():
            report(f"{stage}, {member}: under {', '.join(source.name for source in parts.sources)}")
            config = RunConfig.from_mapping({**base.to_mapping(), "loop": stage, **values})
            judged, sizes = _judged(config, stage, member)
            verdicts += judged
            rpe |= {(stage, member): sizes} if sizes else {}
    return Mission(tuple(source.name for source in parts.sources), tuple(verdicts), rpe)


def _judged(config: RunConfig, stage: str, member: str) -> tuple[list[MissionVerdict], tuple[float, float] | None]:
    """Verdicts of a stage at a member, and its relative error with and without fine control [mas rms]."""
    from los_testbed.run.loop.closed_loop import LoopDivergedError
    from los_testbed.run.loop.contract import RunFailedError
    from los_testbed.run.loop.simulate import run_in_process
    from pointing_analysis.read.run import Run
    from pointing_analysis.requirements.summary import summarise

    requirements = [r for r in RunParts(config).telescope.requirements if not r.loops or stage in r.loops]
    with TemporaryDirectory() as scratch:
        run_in_process(replace(config, loop=OPENED), Path(scratch, OPENED))
        opened = summarise(Run.open(Path(scratch, OPENED)), requirements=requirements)
        try:
            run_in_process(config, Path(scratch, "closed"))
        except (LoopDivergedError, RunFailedError) as error:
            return [MissionVerdict(stage, member, None, float("nan"), str(error))], None
        closed = summarise(Run.open(Path(scratch, "closed")), requirements=requirements)
        pairs = list(zip(closed.rows, opened.rows))
    rows = [MissionVerdict(stage, member, row, other.value) for row, other in pairs]
    return rows, (closed.rpe_rms, opened.rpe_rms)
