"""Replay of a bag: its sensors through controllers, the result as a new bag and as a comparison."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fsm_pma_controller.fade import FADE_TICKS, Fade
from fsm_pma_controller.runtime import FsmPmaController
from lftkit.arrays import FloatArray
from lftkit.support.atomic_output import atomic_folder
from lftkit.support.input_files import read_bytes
from lftkit.support.input_limits import SYSTEM
from lftkit.support.threads import one_thread
from lftkit.systems.sampled.sampled_system import SampledSystem
from los_estimator.runtime import LosEstimator
from los_loop.steady_state import LoopStart
from los_testbed.bags.cdr import codec_for
from los_testbed.bags.writer import BagWriter, check_new_bag
from los_testbed.config.plugins import source_hashes
from los_testbed.config.run_config import RunConfig, is_code, is_library
from los_testbed.config.topics import COMMAND_TOPICS, DRIVEN, FSM_COMMAND, TOPICS, TopicDefinition, placed_topics
from los_testbed.parts.controllers import assemble_controller, compare_with_telescope
from los_testbed.parts.flight_library import LibraryLaw
from los_testbed.parts.start import START_FILE, RunStart
from los_testbed.parts.user_blocks import UserBlock, make_law, read_law, with_loop_ports
from los_testbed.run.change_requests import changes_in
from los_testbed.run.loop.changes import appliers_of
from los_testbed.run.loop.closed_loop import LoopDivergedError
from los_testbed.run.loop.contract import first_not_finite
from los_testbed.run.metadata import METADATA_NAME
from los_testbed.run.processes.memory_file import memory_file
from los_testbed.run.replay_ports import layout_of, recorded_ports
from pointing_analysis.indices.errors import (
    RAD_PER_ARCSEC,
    RAD_PER_MAS,
    ErrorSeries,
    knowledge_error,
    knowledge_error_of,
)
from pointing_analysis.indices.metrics import radial, rpe_rms
from pointing_analysis.read.mapped_arrays import SortedValues, parts, release
from pointing_analysis.read.mcap.records import BagError
from pointing_analysis.read.run import Run
from pointing_analysis.read.run_end import run_end
from pointing_analysis.replay import replay
from pointing_analysis.replay.replay import UNCHANGED, LawChanges, LoopLayout
from pointing_analysis.requirements.exposure import probabilities_of, quantile_key
from pointing_analysis.requirements.summary import exposure_of_run, requirements_of
from pointing_analysis.requirements.verdict import NOT_JUDGED, not_judged_by
from titop_plant.interface import DT, FORCE_STAGES, LAW_PORTS, RATE, STAGES, TICK_NS, DesignBasis
from titop_plant.telescope.loop_ports import LoopPorts

CHUNK_NS = RATE * TICK_NS

COMMAND_NAMES = {topic.name for topic in COMMAND_TOPICS}

Law = SampledSystem | LibraryLaw | UserBlock
"""K_FSM or K_PMA: matrices, a flight library, or code of the user."""

Signals = Mapping[str, tuple[NDArray[np.int64], FloatArray]]


@dataclass(frozen=True)
class Controllers:
    """Controllers of a replay.

    Parameters
    ----------
    files : mapping of str to bytes
        Contents of ``k_fsm.json`` and ``k_pma.json``, or ``.so`` for those of a flight library.
    loop : str
        Stage.
    difference : str
        What is not as the bag has recorded it; empty: nothing.
    estimator : LosEstimator
    controller : FsmPmaController
    layout : LoopLayout
        Topics that they read and write.
    start : LoopStart, optional
        States in which they start, with the others of the run; None for a bag without states: at rest.
    warnings : tuple of str
        One line for each controller that was made for other parameters or limits than those of the bag.
    changes : (LawChanges, LawChanges)
        Of observer and controller during the run; none in another stage.
    """

    files: Mapping[str, bytes]
    loop: str
    difference: str
    estimator: LosEstimator | LibraryLaw | UserBlock
    controller: FsmPmaController
    layout: LoopLayout
    start: LoopStart | None = None
    warnings: tuple[str, ...] = ()
    changes: tuple[LawChanges, LawChanges] = (UNCHANGED, UNCHANGED)

    @property
    def as_recorded(self) -> bool:
        """Whether all of this is as the bag has recorded it."""
        return not self.difference


def controller_of(run: Run, name: str) -> tuple[SampledSystem, bytes]:
    """The controller in a bag, and its file.

    Raises
    ------
    ValueError
        A file that is no controller, a bag without it.
    """
    data = run.attachments.get(f"{name}.json")
    if data is None:
        raise BagError(
            f"{run.path}: the bag must hold the controller {name}.json, got "
            f"{', '.join(sorted(run.attachments)) or 'no files'}: give --{name.replace('_', '-')} FILE"
        )
    with memory_file(data, name) as file:
        try:
            return SampledSystem.from_file(file.path), data
        except ValueError as error:
            raise BagError(str(error).replace(file.path, f"{run.path}: {name}.json")) from None


def models_of_controllers(run: Run) -> dict[str, SampledSystem]:
    """The controllers that a bag holds, by name.

    Raises
    ------
    ValueError
        A controller was user code, whose model is not known; a file that is no controller.
    """
    gone = [f"{name}.json" for name in LAW_PORTS if f"{name}.json" not in run.attachments]
    if gone:
        raise BagError(f"the bag does not hold the controllers {' and '.join(gone)}, as of user code")
    return {name: controller_of(run, name)[0] for name in LAW_PORTS}


def controllers(
    run: Run,
    k_fsm: str | Path | None = None,
    k_pma: str | Path | None = None,
    loop: str | None = None,
    in_order: bool = False,
) -> Controllers:
    """Controllers as recorded, or others instead.

    Parameters
    ----------
    run : Run
    k_fsm, k_pma : str or Path, optional
        As the settings of a run: a file (.json, .mat), a flight library, MODULE:NAME or an entry point.
    loop : str, optional
        Stage.
    in_order : bool
        Whether signals of the others that have no names are those of the loop in their order.

    Raises
    ------
    ValueError
        A file that is no controller, code that cannot be used, a bag without controllers or without its loop stage, an
        unknown stage, a controller made for another sensitivity of the mirror than that of the bag.
    """
    recorded = run.parameters.get("replay_loop", run.parameters.get("loop"))
    stage = recorded if loop is None else loop
    if stage not in STAGES:
        where = "--loop" if loop is not None else f"{run.path}: the loop stage of the bag"
        raise BagError(f"{where} must be one of {', '.join(STAGES)}, got {stage!r}" + ("" if loop else ": give --loop"))
    asked = {"k_fsm": k_fsm, "k_pma": k_pma}
    read = {name: _law_of(run, name, law, in_order) for name, law in asked.items()}
    chosen, telescope = {name: law for name, (law, _) in read.items()}, telescope_of(run)
    warnings = compare_with_telescope(chosen, telescope, stage)
    rows = {name: _rows_of(run, name, law) for name, law in chosen.items()}
    fsm, pma = (_in_order(name, law, rows[name]) for name, law in chosen.items())
    laws, fade_ticks = (
        {"k_fsm": fsm, "k_pma": pma},
        RunConfig(fade_ticks=run.parameters.get("fade_ticks", FADE_TICKS)).fade_ticks,
    )
    controller = assemble_controller(laws, telescope, stage, rows["k_pma"], fade_ticks=fade_ticks)
    files = {_file_name(name, law): data for name, (law, data) in read.items() if data}
    same = (
        run.attachments.get(_file_name(name, law)) == data if data else _is_code_of(run, name, asked[name])
        for name, (law, data) in read.items()
    )
    estimator = LosEstimator(fsm, rows["k_fsm"]) if isinstance(fsm, SampledSystem) else fsm
    start, resting = _started(run, laws, closed=stage == recorded)
    if start is not None:
        estimator.start_at(start.k_fsm, start.camera)
        controller.start_at(start.k_pma)
    if resting := [name for name in resting if name == "k_fsm" or stage in FORCE_STAGES]:
        of_replay = " and ".join(resting)
        warnings += (f"the run starts in a steady state, {of_replay} of the replay at rest: figures have the start-up",)
    layout = layout_of(rows["k_fsm"], rows["k_pma"])
    difference = "" if stage == recorded else f"controllers as recorded, with loop {stage} instead of {recorded}"
    if not all(same):
        difference = "other controllers"
    changes = UNCHANGED, UNCHANGED
    if stage == recorded:
        changes = (
            changes_of(run, "estimator", estimator, fade_ticks),
            changes_of(run, "controller", controller, fade_ticks),
        )
    return Controllers(files, stage, difference, estimator, controller, layout, start, warnings, changes)


def changes_of(run: Run, node: str, law: object, fade_ticks: int) -> LawChanges:
    """Changes of a law by its node during a recorded run."""
    fade = Fade(fade_ticks)
    appliers = appliers_of(law, fade)
    rows = [row for row in changes_in(run, node) if row["name"] in appliers]
    return LawChanges(tuple((row["tick"], partial(appliers[row["name"]], row["value"])) for row in rows), fade.scale)


def _law_of(run: Run, name: str, asked: str | Path | None, in_order: bool) -> tuple[Law, bytes]:
    """A law as a run takes it, and the content of its file; of code nothing."""
    if asked is None:
        return controller_of(run, name)
    text = str(asked)
    if is_library(text):
        return LibraryLaw(Path(text), name), read_bytes(text, SYSTEM)
    if is_code(text):
        known = {key: run.parameters[key] for key in ("camera_rate",) if key in run.parameters}
        block = make_law(
            RunConfig.from_mapping({**known, name: text, "ports_in_order": in_order}), name, recorded_ports(run)
        )
        linear = block.linear if block.is_linear else None
        return (block, b"") if linear is None else (linear, linear.to_json().encode())
    law = read_law(name, Path(text), in_order)
    if not {port.name for port in law.inputs} & {row.name for row in recorded_ports(run).sensors}:
        law.require(*LAW_PORTS[name], DT)  # none of its ports has a name of the loop: the message has them all
    return law, read_bytes(text) if text.endswith(".json") else law.to_json().encode()


def _is_code_of(run: Run, name: str, asked: str | Path | None) -> bool:
    """Whether code is that of a recorded run: the same object of a source file with the same bytes."""
    recorded = run.parameters.get(f"{name}_source_sha256")
    return bool(recorded) and run.parameters.get(name) == asked and source_hashes({name: str(asked)})[name] == recorded


def _rows_of(run: Run, name: str, law: Law) -> LoopPorts:
    """Rows that a law uses."""
    if isinstance(law, SampledSystem):
        return recorded_ports(run, law).of_system(name, law)
    return law.ports if isinstance(law, UserBlock) and law.ports else recorded_ports(run).of_law(name)


def _in_order(name: str, law: Law, rows: LoopPorts) -> Law:
    """A controller with the inputs of its loop in their order."""
    return with_loop_ports(name, _file_name(name, law), law, rows) if isinstance(law, SampledSystem) else law


def _file_name(name: str, law: Law) -> str:
    return f"{name}.so" if isinstance(law, LibraryLaw) else f"{name}.json"


def _starts_as_recorded(run: Run, name: str, law: Law, state: FloatArray | tuple[float, ...]) -> bool:
    """Whether the recorded state is of this law: one of the recorded matrices, or a library of the same order."""
    if isinstance(law, LibraryLaw):
        return bool(law.order == len(state))
    if isinstance(law, UserBlock) or f"{name}.json" not in run.attachments:
        return False
    recorded = controller_of(run, name)[0]
    before = with_loop_ports(name, _file_name(name, recorded), recorded, recorded_ports(run, recorded))
    if law.inputs != before.inputs or law.outputs != before.outputs:
        return False
    return all(bool(np.array_equal(getattr(law, M), getattr(before, M))) for M in "ABCD")


def _started(run: Run, laws: Mapping[str, Law], *, closed: bool) -> tuple[LoopStart | None, list[str]]:
    """States in which the laws of a replay start, and the names of those that start at rest where the run did not.

    K_PMA starts as it did where the stage is that of the run, too (`closed`).
    """
    # States in which the recorded controllers started; None: at rest
    data = run.attachments.get(START_FILE)
    recorded = RunStart() if data is None else RunStart.from_bytes(data)
    states = recorded.states
    if states is None:
        return None, []
    same = {name: _starts_as_recorded(run, name, law, getattr(states, name)) for name, law in laws.items()}
    same["k_pma"] &= closed
    still = {name: np.zeros(law.order) for name, law in laws.items() if not same[name]}
    if "k_fsm" in still:
        still["camera"] = np.zeros_like(states.camera)
    return replace(states, **still), [name for name in laws if not same[name] and recorded.steady]


def telescope_of(run: Run) -> DesignBasis:
    """Telescope and limits stated in a bag.

    Raises
    ------
    BagError
        It does not state them.
    """
    names = ("los_sensitivity", "fsm_authority", "pma_authority")
    values: dict[str, Any] = {name: run.parameters[name] for name in names if name in run.parameters}
    if missing := [name for name in names if name not in values]:
        raise BagError(f"{run.path}: must state the telescope's {', '.join(missing)}, got a bag without")
    if "parameters_hash" in run.parameters:
        values["parameters_hash"] = str(run.parameters["parameters_hash"])
    return DesignBasis.from_mapping(values, str(run.path))


def drive(run: Run, chosen: Controllers, progress: Callable[[int, int], None]) -> replay.Replayed:
    """Step observer and controller on the sensors of the bag.

    Raises
    ------
    BagError
        A sensor is missing in the bag.
    LoopDivergedError
        Outputs of observer or controller are not finite.
    """
    with one_thread(), np.errstate(all="ignore"):
        replayed = replay.replay(run, chosen.estimator, chosen.controller, chosen.layout, progress, chosen.changes)
    _check_finite("observer", {"los_estimate": replayed.estimate}, replayed.stamp, run)
    _check_finite("controller", {"command": replayed.command}, replayed.command_stamp, run)
    return replayed


def _check_finite(who: str, signals: Mapping[str, FloatArray], stamp: NDArray[np.int64], run: Run) -> None:
    """Reject a replay whose output is not finite, with tick and port."""
    for part in parts(len(stamp)):
        odd = first_not_finite({name: values[part] for name, values in signals.items()}, part.stop - part.start)
        if odd is not None:
            tick = part.start + odd[0]
            seconds = (stamp[tick] - stamp[0]) * 1e-9
            raise LoopDivergedError(
                f"the {who} diverges on the sensors of {run.path} within {seconds:g} s: at tick {tick} the {odd[1]}"
            )


def _knowledge(series: ErrorSeries, window: float, part: float) -> dict[str, float]:
    size = radial(series.values)
    ranked = SortedValues(size)
    rke = float(np.hypot(*rpe_rms(series.values, series.dt, window))) if series.duration >= window else float("nan")
    return {
        "ake_rms_arcsec": math.sqrt(sum(np.nansum(size[rows] ** 2) for rows in parts(len(size))) / ranked.size)
        / RAD_PER_ARCSEC,
        f"ake_{quantile_key(part)}_arcsec": ranked.quantile(part) / RAD_PER_ARCSEC,
        "rke_rms_mas": rke / RAD_PER_MAS,
    }


def _commands(signals: Signals) -> dict[str, float]:
    largest: dict[str, float] = {}
    for name, (_, values) in signals.items():
        if name in COMMAND_NAMES or name.startswith(f"{DRIVEN}/"):
            key = "fsm_peak_rad" if name == FSM_COMMAND.name else "pma_peak_n"
            peaks = [float(np.abs(values[part]).max()) for part in parts(len(values))]
            largest[key] = max([largest.get(key, 0.0), *peaks])
    return largest


def metrics(run: Run, replayed: replay.Replayed, transient: float | None = None) -> dict[str, dict[str, float]]:
    """Knowledge errors and command peaks, recorded and replayed; what cannot be formed is left out."""
    window, part = exposure_of_run(run), probabilities_of(requirements_of(run) or ()).knowledge
    recorded = {name: (run[name].stamp, run[name].values) for name in replayed.topics() if name in run}
    values = {"recorded": _commands(recorded), "replayed": _commands(replayed.topics())}
    if {"truth/los", "fsm/strain_gauge"} <= set(run.topics):
        if "los_estimate" in recorded:
            values["recorded"] = {**_knowledge(knowledge_error(run, transient), window, part), **values["recorded"]}
        series = knowledge_error_of(run, replayed.stamp, replayed.estimate, transient)
        values["replayed"] = {**_knowledge(series, window, part), **values["replayed"]}
    return values


def write_bag(path: Path, run: Run, replayed: replay.Replayed, chosen: Controllers) -> None:
    """Write sensors and truth of `run` with the replayed estimates and commands as a new bag.

    **The truth is that of the recorded loop**, whose name the new bag keeps as ``loop``: it does not respond to the
    replayed commands. ``replay_loop`` is the stage of the controllers that were replayed.

    Raises
    ------
    ValueError
        The bag exists or cannot be made.
    """
    check_new_bag(path)
    signals: dict[str, tuple[NDArray[np.int64], FloatArray]] = {
        name: (run[name].stamp, run[name].values) for name in run.topics
    }
    signals.update(replayed.topics())
    sources = {f"{name}_sha256": hashlib.sha256(data).hexdigest() for name, data in chosen.files.items()}
    left_out = ("statistics", "mode", "output", "k_fsm", "k_pma", "controller_warnings")
    recorded = {
        key: value if isinstance(value, str) else json.dumps(value)
        for key, value in run.parameters.items()
        if key not in left_out
    }
    metadata = {**recorded, **sources, "mode": "replay", "replay_loop": chosen.loop, "replay_of": run.path.name}
    if reason := not_judged_by(run) or _ends_early(run):
        metadata[NOT_JUDGED] = reason
    if chosen.warnings:
        metadata["controller_warnings"] = "; ".join(chosen.warnings)
    laws = {Path(name).stem for name in chosen.files}  # the recorded ones are not those of this bag
    others = {name: data for name, data in run.attachments.items() if Path(name).stem not in laws}
    if chosen.start is not None:
        others[START_FILE] = replace(RunStart.from_bytes(others[START_FILE]), states=chosen.start).to_bytes()
    files = {name: ("application/octet-stream", data) for name, data in others.items()}
    kinds = {".json": "application/json", ".so": "application/octet-stream"}
    files.update({name: (kinds[Path(name).suffix], data) for name, data in chosen.files.items()})
    write_signal_bag(path, metadata, signals, files)


def _ends_early(run: Run) -> str:
    """What a replay of a recording cannot show of its end: it has the samples that are there as all of them."""
    ends = [topic.open_end or topic.lost_before or topic.lost_after for topic in map(run.__getitem__, run.topics)]
    if any(ends):
        return "the recording lacks samples before its first or after its last ones"
    return run_end(run.parameters, run.covered_ticks).text


def write_signal_bag(
    path: Path, metadata: Mapping[str, str], signals: Signals, files: Mapping[str, tuple[str, bytes]] | None = None
) -> None:
    """Write a new bag of stamped signals, as `write_signals` does; it appears whole or not at all."""
    with (
        atomic_folder(path) as folder,
        BagWriter(folder, {METADATA_NAME: metadata}, files, topics=_topics(signals), name=path.name) as bag,
    ):
        write_signals(bag, signals)


def _topics(signals: Signals) -> tuple[TopicDefinition, ...]:
    """Topics of the loop, and those of sensors and actuators at places among the signals."""
    return (*TOPICS, *placed_topics({name: values.shape[1] for name, (_, values) in signals.items()}))


def write_signals(bag: BagWriter, signals: Signals) -> None:
    """Write stamped signals, named without namespace, second by second; times are the stamps."""
    known = [(topic, codec_for(topic), *signals[topic.name]) for topic in _topics(signals) if topic.name in signals]
    known = [row for row in known if len(row[2])]
    first, last = min(int(row[2][0]) for row in known), max(int(row[2][-1]) for row in known)
    for begin in range(first, last + 1, CHUNK_NS):
        for topic, codec, stamps, values in known:
            low, high = np.searchsorted(stamps, (begin, begin + CHUNK_NS))
            if high > low:
                part = np.ascontiguousarray(values[low:high, : topic.size])
                times, name = stamps[low:high], topic.path_in(bag.namespace)
                bag.write(name, times, times, codec.encode_many(times, part))
        bag.end_chunk()
        release()


def as_dict(
    run: Run, chosen: Controllers, comparison: replay.Comparison, measures: Mapping[str, Any]
) -> dict[str, Any]:
    """The replay as one JSON object."""
    return {
        "bag": str(run.path),
        "loop": chosen.loop,
        "as_recorded": chosen.as_recorded,
        "identical": comparison.identical,
        "ticks": min((one.compared for one in comparison.differences), default=0),
        "incomplete_ticks": comparison.incomplete,
        "differences": [vars(d) for d in comparison.differences],
        **{
            key: {name: float(f"{x:.6g}") if np.isfinite(x) else None for name, x in values.items()}
            for key, values in measures.items()
        },
    }
