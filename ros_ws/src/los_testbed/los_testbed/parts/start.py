"""Start of a run: its worst-case tone, and the states of plant and controllers at tick 0.

Every process can compute this from the configuration alone, bit-identically on the same machine. The runner computes it
once and passes it to its nodes (:func:`for_nodes`); the bag holds it as ``start.json`` for replay and report.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cache, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lftkit.arrays import FloatArray
from lftkit.errors import InputError
from lftkit.support.structured_text import load_json
from lftkit.support.threads import one_thread
from lftkit.systems.sampled.sampled_system import SampledSystem
from los_testbed.config.run_config import RunConfig
from titop_plant.interface import FORCE_STAGES, MIRROR_STAGES

if TYPE_CHECKING:
    from los_loop.steady_state import LoopStart
    from los_loop.tone_model import ToneModel
    from los_loop.worst_tone import WorstTone
    from titop_plant.simulation.build import PlantConfig, PlantFamily

START_FILE = "start.json"
"""Name of the attachment in a bag."""

START_VARIABLE = "LOS_TESTBED_START"
"""File in which the runner hands the start to its nodes."""

FORMAT = "los-testbed/run-start"
FLAGS = "switched_on", "unstable"
"""Attributes that the file has where they are true."""

_KEPT = 8
_found: dict[str, RunStart] = {}


@dataclass(frozen=True)
class RunStart:
    """Tone and states with which a run starts.

    Parameters
    ----------
    tone : WorstTone or None
        Disturbance of the scenario worst_case; None in the others and without disturbance.
    states : LoopStart or None
        States in which the loop starts; None: at rest, all states zero.
    note : str
        Why it differs from the configuration; else empty.
    switched_on : bool
        Whether the states are those of the telescope without its controllers, which are switched on at tick 0.
    unstable : bool
        Whether the loop of telescope and acting controllers is known to be unstable.
    """

    tone: WorstTone | None = None
    states: LoopStart | None = None
    note: str = ""
    switched_on: bool = False
    unstable: bool = False

    @property
    def steady(self) -> bool:
        """Whether the loop starts in its steady state."""
        return self.states is not None and not self.switched_on

    def to_bytes(self) -> bytes:
        """JSON text; numbers are exact."""
        content = {
            "format": FORMAT,
            "version": 1,
            "tone": None if self.tone is None else self.tone.to_mapping(),
            "states": None if self.states is None else self.states.to_mapping(),
            "note": self.note,
            **{name: True for name in FLAGS if getattr(self, name)},
        }
        return (json.dumps(content) + "\n").encode()

    @classmethod
    def from_bytes(cls, data: bytes) -> RunStart:
        """Read what :meth:`to_bytes` wrote.

        Raises
        ------
        ValueError
            Another format.
        """
        from los_loop.steady_state import LoopStart
        from los_loop.worst_tone import WorstTone

        try:
            content = load_json(data.decode("utf-8"), START_FILE)
        except UnicodeDecodeError:
            raise InputError(f"{START_FILE} must be JSON, got text that is not UTF-8") from None
        if not isinstance(content, dict) or content.get("format") != FORMAT:
            raise InputError(f'{START_FILE} must have "format": "{FORMAT}"')
        tone, states = content.get("tone"), content.get("states")
        return cls(
            None if tone is None else WorstTone.from_mapping(tone),
            None if states is None else LoopStart.from_mapping(states),
            str(content.get("note", "")),
            **{name: bool(content.get(name, False)) for name in FLAGS},
        )

    @property
    def command(self) -> FloatArray | None:
        """Command that the first tick applies [rad, N]; None: zero."""
        return None if self.states is None else self.states.command

    def tones(self) -> tuple[tuple[float, ...], ...]:
        """The tone as :class:`titop_plant.simulation.build.PlantConfig` takes it."""
        if self.tone is None:
            return ()
        return ((self.tone.omega, *self.tone.amplitude.real.tolist(), *self.tone.amplitude.imag.tolist()),)


AT_REST = RunStart()
"""The start with all states zero."""


def for_nodes(settings: Mapping[str, Any], start: RunStart) -> bytes:
    """Content of the file :data:`START_VARIABLE`: the start, and the settings of its run, with the scenario."""
    return json.dumps({"config": _identity(settings), "start": start.to_bytes().decode()}).encode()


def from_runner(settings: Mapping[str, Any]) -> RunStart | None:
    """Start that the runner has computed for a node; None without a runner, or where it is of other settings.

    A plant that is started again has others, for example: its run is shorter.

    Parameters
    ----------
    settings : mapping
        Of the run, as :meth:`los_testbed.config.run_config.RunConfig.to_plain` has them.
    """
    try:
        content = json.loads(Path(os.environ[START_VARIABLE]).read_bytes())
        known, start = content["config"], content["start"]
    except (KeyError, TypeError, OSError, ValueError):
        return None
    return RunStart.from_bytes(start.encode()) if known == _identity(settings) else None


def _identity(settings: Mapping[str, Any]) -> Any:
    """Settings that a start depends on, as read from JSON; the name of the bag is not among them."""
    return json.loads(json.dumps({**settings, "output": None}))


def find_run_start(
    config: RunConfig,
    family: PlantFamily,
    settings: PlantConfig,
    controllers: Mapping[str, SampledSystem],
    authority: tuple[float, float],
    tone: WorstTone | None = None,
) -> RunStart:
    """Tone and states of a run; the last result is cached.

    A loop that is not stable has neither: its tone is that of the telescope without fine control, and it starts at
    rest (`RunStart.unstable`; `RunStart.note` says so).

    Parameters
    ----------
    config : RunConfig
        Its stage, start, duration and what the tone is worst for count.
    family : PlantFamily
        Of the telescope, with the sensors and actuators of the loop.
    settings : PlantConfig
        Member of the family and its disturbance; in the scenario worst_case without disturbance.
    controllers : mapping
        ``k_fsm`` and ``k_pma``.
    authority : (float, float)
        Largest commands of the run: mirror [rad], actuators [N].
    tone : WorstTone, optional
        Instead of the worst one, of a run whose disturbance is such a tone.
    """
    if tone is not None and needs_tone(config):
        with one_thread():
            return _computed(config, family, settings, controllers, authority, tone)
    chosen = config.loop, config.start, config.duration, config.worst_of, needs_tone(config), authority
    digest = hashlib.sha256()
    for name in ("k_fsm", "k_pma"):
        system = controllers[name]
        for matrix in (system.A, system.B, system.C, system.D):
            digest.update(matrix.tobytes())
        digest.update(json.dumps(dict(system.design_basis), sort_keys=True).encode())
    ports = family.ports
    rows = [(r.name, r.source, r.ticks, r.bias.tolist(), r.mount and r.mount.key) for r in ports.sensors]
    key = f"{chosen} {family.name(settings)} {digest.hexdigest()} {ports.actuators} {rows}"
    if key not in _found:
        while len(_found) >= _KEPT:
            del _found[next(iter(_found))]
        with one_thread():
            _found[key] = _computed(config, family, settings, controllers, authority)
    return _found[key]


def needs_tone(config: RunConfig) -> bool:
    """Whether the disturbance of a run is the worst-case tone."""
    return config.scenario == "worst_case" and config.scenario_acts


def _computed(
    config: RunConfig,
    family: PlantFamily,
    settings: PlantConfig,
    controllers: Mapping[str, SampledSystem],
    authority: tuple[float, float],
    tone: WorstTone | None = None,
) -> RunStart:
    from los_loop.steady_state import steady_start
    from los_loop.tone_model import ToneModel

    notes: list[str] = []
    model = partial(ToneModel.of, family, controllers=controllers, authority=authority)
    loop = cache(partial(model, settings))
    if tone is None and needs_tone(config):
        tone = _tone(config, family, loop, notes)
    states = None
    if config.start == "steady":
        closed = loop(loop=config.loop)
        if tone:
            closed = closed.with_tones(family.tones(with_tones(settings, RunStart(tone))))
        orders = controllers["k_fsm"].order, controllers["k_pma"].order
        try:
            states = steady_start(closed, family.bias(settings), orders)
        except ValueError as error:
            notes.append(f"{error}: the run starts at rest")
    unstable = _unstable(config.loop, loop(loop=config.loop), partial(model, settings), controllers)
    return RunStart(tone, states, "; ".join(notes), unstable=unstable)


def _unstable(
    stage: str, closed: ToneModel, model: Callable[..., ToneModel], controllers: Mapping[str, SampledSystem]
) -> bool:
    """Whether the loop that a stage closes is unstable; a K_PMA that only listens is no part of it."""
    if stage not in MIRROR_STAGES or closed.loop.growth < 1.0:
        return False
    if stage not in FORCE_STAGES:
        silent = replace(controllers["k_pma"], A=0.0 * controllers["k_pma"].A)
        closed = model(loop=stage, controllers={**controllers, "k_pma": silent})
    return not closed.loop.growth < 1.0


def _tone(config: RunConfig, family: PlantFamily, model: Callable[..., ToneModel], notes: list[str]) -> WorstTone:
    """Worst tone of the loop; of the telescope without fine control where the loop is not stable."""
    from los_loop.worst_tone import worst_tone

    open_loop = "isolator" if family.isolated else "none"
    for loop in (config.loop, open_loop):
        of = model(loop=loop)
        try:
            tone = worst_tone(
                of.loop, of.plant, family.telescope, index=config.worst_of, stage=config.loop, closed=loop != open_loop
            )
        except ValueError as error:
            notes.append(f"{error}: the tone is the worst one of the stage {open_loop}")
        else:
            return tone.peaking_at(0.5 * config.duration)
    raise AssertionError("the loop above returns or raises")


def with_tones(physical: PlantConfig, start: RunStart) -> PlantConfig:
    """The physical settings with the worst-case tone of a start."""
    return replace(physical, scenario="worst_case", disturbance=True, tones=start.tones())
