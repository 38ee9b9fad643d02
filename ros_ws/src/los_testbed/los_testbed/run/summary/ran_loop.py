"""Whether the loop that a bag holds is the one that ran: all that a model or a proof says of a run asks for it.

A bag holds the settings of the run, the controllers and the start. That this loop made the record is shown by two
things. Each node has announced what it runs, and its digest is that of what the bag holds
(:func:`los_testbed.run.identity.announced`). And the recorded estimates and commands are those of the controllers on
the recorded samples, from the first tick to the last, within the rounding of sums in another order
(:func:`lftkit.systems.sampled.rounding.rounding_bound`).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from lftkit.errors import InputError
from lftkit.support.counted_nouns import counted
from lftkit.support.threads import one_thread
from lftkit.systems.sampled.rounding import UNIT, rounding_bound
from lftkit.systems.sampled.sampled_system import SampledSystem
from los_estimator.runtime import LosEstimator
from los_testbed.config.run_config import ACTIVE, RunConfig
from los_testbed.config.topics import FSM_COMMAND, LOS_ESTIMATE
from los_testbed.parts.run_parts import RunParts
from los_testbed.parts.start import START_FILE, RunStart
from los_testbed.run.change_requests import changes_in
from los_testbed.run.identity import DIGEST, announced
from los_testbed.run.loop.changes import RESET, STOP
from los_testbed.run.proven_loop import reasons_against
from los_testbed.run.replay import changes_of, models_of_controllers
from los_testbed.run.replay_ports import layout_of
from pointing_analysis.arrays import FloatArray
from pointing_analysis.files.structured_text import load_yaml
from pointing_analysis.read import mapped_arrays
from pointing_analysis.read.run import Run
from pointing_analysis.read.run_end import count_of, statistics_of
from pointing_analysis.read.unsent import UNSENT
from pointing_analysis.replay import replay
from titop_plant.interface import TICK_NS

RUN_FILE = "run.yaml"
LAWS = ("estimator", "controller")
NODES = ("plant", *LAWS)
AUTHORITIES = ("fsm_authority", "pma_authority")


@dataclass(frozen=True)
class RanLoop:
    """The loop of a recorded run.

    Parameters
    ----------
    run : Run
    parts : RunParts or None
        Of the settings, controllers and start in the bag; None where they make none.
    unknown : str
        Why it is not known that this loop ran; empty where its nodes have announced it.
    """

    run: Run
    parts: RunParts | None
    unknown: str

    @classmethod
    def of(cls, run: Run) -> RanLoop:
        """Of a bag, whatever it holds."""
        parts = None
        try:
            for name in (RUN_FILE, START_FILE):
                if name not in run.attachments:
                    raise InputError(f"the bag does not hold {name}")
            config = RunConfig.from_mapping(load_yaml(run.attachments[RUN_FILE].decode(), f"{RUN_FILE} of the bag"))
            start = RunStart.from_bytes(run.attachments[START_FILE])
            unstated = start.states is None and start.tone is None  # the recorder node leaves it out at rest
            parts = RunParts(config, models_of_controllers(run), None if unstated else start)
            unknown = "" if run.has_digests else "another program has written the bag: no digests cover its messages"
            unknown = unknown or contradiction(run, parts) or _other_settings(run, parts)
            if not unknown:
                _ = _counts(run), [changes_in(run, node) for node in NODES]  # which say what is wrong with them
            return cls(run, parts, unknown)
        except (ValueError, TypeError, OSError, OverflowError) as error:
            return cls(run, parts, " ".join(str(error).split()).replace(str(run.path), run.path.name))

    @property
    def known(self) -> RunParts:
        """The parts of a loop that ran, for models of it, which have none of the changes during a run.

        Raises
        ------
        InputError
            It is not known that it did, the record is not that of this loop, or a setting changed.
        """
        if self.parts is None or self.unknown or self.differs:
            raise InputError(self.unknown or self.differs)
        if changed := sorted({row["name"] for node in NODES for row in changes_in(self.run, node)} - {STOP}):
            raise InputError(f"{' and '.join(changed)} changed during the run")
        return self.parts

    @cached_property
    def differs(self) -> str:
        """What of the record is not of this loop: samples that are missing, estimates or commands of another law."""
        assert self.parts is not None
        try:
            with one_thread(), np.errstate(all="ignore"):
                return _difference(self.run, self.parts)
        except ValueError as error:
            return str(error).replace(str(self.run.path), self.run.path.name)

    def against_proof(self) -> list[str]:
        """Why no proof of the loop is one of this run, one phrase each; empty where it is one."""
        if self.unknown or self.parts is None:
            return [self.unknown]
        rows = [row for node in NODES for row in changes_in(self.run, node)]
        changed = {row["name"] for row in rows} - {STOP, RESET, ACTIVE}
        changed |= {"what was active"} if any(row["name"] == ACTIVE and not row["value"] for row in rows) else set()
        _, late = _counts(self.run)
        reasons = [f"{counted(late, 'tick')} had an older command"] * (late > 0) + reasons_against(self.parts)
        reasons += [f"{name} changed" for name in sorted(changed)]
        return reasons or [self.differs] * bool(self.differs)


def _counts(run: Run) -> tuple[int, int]:
    """Ticks whose samples the plant has sent, and those that it missed; InputError: it has not counted them."""
    plant, outside = statistics_of(run.parameters, "plant"), f"{UNSENT}outside"
    ticks, missed, unsent = map(count_of, (plant.get("ticks"), plant.get("missed_ticks"), plant.get(outside, 0)))
    if ticks is None or missed is None or unsent is None:
        stated = [str(plant.get(name)) for name in ("ticks", "missed_ticks")]
        raise InputError(f"the plant's counts of ticks, and of those missed, must be whole numbers, got {stated}")
    return ticks - unsent, missed


def _other_settings(run: Run, parts: RunParts) -> str:
    """The first setting of the metadata, by which a bag is shown, that is not that of its configuration; else empty."""
    shown = parts.config.to_plain() | {name: getattr(parts.basis, name) for name in AUTHORITIES}
    other = [name for name, value in shown.items() if run.parameters.get(name, value) != value]
    return f"{other[0]} of the bag's metadata is not that of its {RUN_FILE}" if other else ""


def contradiction(run: Run, parts: RunParts, nodes: Sequence[str] = NODES) -> str:
    """The first node that has announced nothing, or another thing than the bag holds; empty where none has."""
    if not isinstance(run.parameters.get("statistics"), Mapping):
        return "the bag does not hold what its nodes announced"
    digests = announced(parts)
    for node in nodes:
        said = str(statistics_of(run.parameters, node).get(DIGEST, ""))
        if not said:
            return f"the node {node} announced no digest of what it ran"
        if said != digests[node]:
            files = "; a file of the telescope or of a disturbance may have changed" if node == "plant" else ""
            return f"what the node {node} ran has the digest {said}, that of the bag {digests[node] or 'none'}{files}"
    return ""


def _difference(run: Run, parts: RunParts) -> str:
    """How the record is not one of the whole run, or its estimates and commands not those of the laws; else empty."""
    begin, end = run.window
    if begin > 0.0:
        return f"the record is read from {begin:g} s on, and the controllers start with the run"
    estimator, controller, ticks = parts.estimator(), parts.controller(), parts.config.fade_ticks
    changes = changes_of(run, "estimator", estimator, ticks), changes_of(run, "controller", controller, ticks)
    layout = layout_of(parts.used["k_fsm"], parts.used["k_pma"])
    replayed = replay.replay(run, estimator, controller, layout, changes=changes)
    (done, missed), sampled = _counts(run), replayed.sampled
    recorded = int(sampled[-1] - sampled[0]) // TICK_NS + 1
    if recorded != done and (math.isinf(end) or recorded > done):
        return f"{recorded} of the {counted(done, 'tick')} of the run are recorded"
    if lacking := recorded - len(sampled):
        return f"{counted(lacking, 'tick')} of the record lack a sample"
    differences = replay.compare(run, replayed).differences
    names = {difference.topic for difference in differences if difference.compared and not difference.missing}
    acted = {LOS_ESTIMATE.name: len(replayed.stamp), FSM_COMMAND.name: len(replayed.command_stamp)}
    least = len(sampled) - missed
    for name in replayed.topics():
        if name not in names or acted.get(name, least) < least:
            return f"{name} is not recorded on each tick"
    other = [difference for difference in differences if not difference.identical]
    allowed = _rounding(run, parts, replayed) if other else {}
    for difference in other:
        if not difference.largest <= allowed[difference.topic] < np.inf:
            return (
                f"{difference.topic} is not that of the controllers in the bag on {difference.different} of "
                f"{counted(difference.compared, 'tick')}, first after {difference.first or 0.0:.3f} s"
            )
    return ""


def _rounding(run: Run, parts: RunParts, replayed: replay.Replayed) -> dict[str, float]:
    """Largest differences by rounding of estimates and commands, by topic."""
    layout, estimator, controller = replayed.layout, parts.estimator(), parts.controller()
    samples = replay.sensors(run, layout).measurement
    most = _largest(samples)
    assert isinstance(estimator, LosEstimator) and isinstance(controller.k_pma, SampledSystem)
    systems = {"k_fsm": (estimator.k_fsm, layout.observer), "k_pma": (controller.k_pma, layout.controller)}
    bounds = {}
    for name, (system, topics) in systems.items():
        state = np.zeros(system.order) if parts.states is None else getattr(parts.states, name)
        columns = layout.of(topics)
        known = (samples[rows][:, columns] for rows in mapped_arrays.parts(len(samples)))
        filled = (np.where(np.isnan(part), most[columns], part) for part in known)
        bounds[name] = rounding_bound(system, state, filled)
    mirror = abs(controller.mirror_gain) * bounds["k_fsm"]
    command = np.concatenate([mirror, bounds["k_pma"]]) + 4.0 * UNIT * _largest(replayed.command)
    largest = {topic: float(command[columns].max()) for topic, columns in layout.commands.items()}
    return {LOS_ESTIMATE.name: float(bounds["k_fsm"].max()), **largest}


def _largest(values: FloatArray) -> FloatArray:
    """Largest magnitude of each column (n, m), without values that are missing."""
    largest = [np.fmax.reduce(np.abs(values[part]), axis=0) for part in mapped_arrays.parts(len(values))]
    return np.asarray(np.nan_to_num(np.fmax.reduce(largest, initial=0.0)))
