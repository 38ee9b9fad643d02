"""Settings that change during a run: each is checked, applied at one tick and recorded."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from fsm_pma_controller.fade import Fade
from fsm_pma_controller.runtime import FsmPmaController
from lftkit.errors import InputError
from los_testbed.config.run_config import ACTIVE, RunConfig
from pointing_analysis.files.structured_text import is_number
from titop_plant.interface import RATE, TICK_NS

NEVER = 1 << 62
MAX_KEPT = 100
"""Changes that are kept for the record; the first ones stay."""

MAX_WAITING = 1000
"""Changes that may wait for their tick."""

NAMES = {
    "plant": ("noise", "disturbance", "camera_dropout", "stop", "reset"),
    "controller": ("loop", "fsm_authority", "pma_authority"),
}
"""Settings that may change during a run, by the node that applies them."""

ALIASES = {"stage": "loop"}

STOP = "stop"
"""Change that ends the run."""

RESET = "reset"
"""Change that ends the run and begins it again, with the settings of the start."""

Apply = Callable[[Any], None]


def parse_change(text: str) -> tuple[str, Any, float | None]:
    """Name, value and time [s] of a change given as JSON: ``{"name": "camera_dropout", "value": 0.2, "at": 3.5}``.

    Without ``at`` it applies at the next tick.

    Raises
    ------
    ValueError
        Not such an object.

    Examples
    --------
    >>> parse_change('{"name": "stage", "value": "fsm"}')
    ('loop', 'fsm', None)
    """
    try:
        content = json.loads(text)
    except (ValueError, TypeError, RecursionError):
        content = None
    if not isinstance(content, dict) or not {"name", "value"} <= set(content) <= {"name", "value", "at"}:
        raise InputError(f"fault must be a JSON object with name, value and optionally at, got {str(text)[:200]!r}")
    name, at = content["name"], content.get("at")
    if not isinstance(name, str):
        raise InputError(f"name of a fault must be a text, got {name!r}")
    if at is not None and (not is_number(at) or not 0.0 <= at < 1e6):
        raise InputError(f"at must be seconds from the start of the run, got {at!r}")
    return ALIASES.get(name, name), content["value"], None if at is None else float(at)


def owner_of(name: str) -> str:
    """The node that applies a setting that may change during a run.

    Raises
    ------
    ValueError
        No such setting.

    Examples
    --------
    >>> owner_of("stage"), owner_of("noise")
    ('controller', 'plant')
    """
    for node, names in NAMES.items():
        if ALIASES.get(name, name) in names:
            return node
    known = ", ".join(sorted({*ALIASES, *(n for names in NAMES.values() for n in names)}))
    raise InputError(f"name must be a setting that can change during a run ({known}), got {name!r}")


def appliers_of(law: object, fade: Fade) -> dict[str, Apply]:
    """What the settings that may change during a run do with an observer or a controller, and its fade."""
    appliers: dict[str, Apply] = {ACTIVE: fade.turn}
    if isinstance(law, FsmPmaController):
        appliers["loop"] = law.switch
        appliers["fsm_authority"] = lambda value: law.limit(fsm_authority=value)
        appliers["pma_authority"] = lambda value: law.limit(pma_authority=value)
    return appliers


@dataclass
class Changes:
    """Changes of the settings of one node.

    Parameters
    ----------
    config : RunConfig
        Settings at the start.
    appliers : mapping of str to callable
        What each setting that may change does with a new value.
    limits : mapping of str to float
        Largest values of the authorities: those of the start.
    who : callable
        Name of the requesting node; empty without one.

    Examples
    --------
    >>> changes = Changes(RunConfig(), {"loop": print})
    >>> changes.request("loop", "fsm", at=0.002)
    >>> for tick in range(4):
    ...     changes.advance(tick * TICK_NS)
    fsm
    >>> changes.record()
    {'changes': '[{"tick": 2, "name": "loop", "value": "fsm"}]'}
    """

    config: RunConfig
    appliers: Mapping[str, Apply]
    limits: Mapping[str, float] = field(default_factory=dict)
    who: Callable[[], str] = str
    due: int = NEVER
    now: int = -1
    unpublished: list[tuple[str, Any]] = field(default_factory=list)
    _pending: list[tuple[int, str, Any, str]] = field(default_factory=list)
    _applied: list[tuple[int, str, Any, str]] = field(default_factory=list)
    _changed: set[str] = field(default_factory=set)
    _initial: list[tuple[int, str, Any, str]] = field(default_factory=list)

    def check(self, name: str, value: Any, at: float | None = None) -> Any:
        """The value as the setting takes it.

        Raises
        ------
        ValueError
            A setting that cannot change, a value out of range, a time that has passed.
        """
        if name not in self.appliers:
            known = ", ".join(sorted(self.appliers)) or "nothing"
            raise InputError(f"name must be a setting that this node can change ({known}), got {name!r}")
        if len(self._pending) >= MAX_WAITING:
            raise InputError(f"changes that wait for their tick must be at most {MAX_WAITING}, got one more")
        if name in (STOP, RESET):
            if value is not True:
                raise InputError(f"{name} must be true, got {value!r}")
            checked: Any = True
        else:
            checked = getattr(replace(self.config, **{name: value}), name)
        if name == "loop" and (checked == "none") != (self.config.loop == "none"):
            raise InputError(
                f"loop must be a stage with the isolator as at the start, {self.config.loop}: it is part of the plant, "
                f"got {checked}"
            )
        if name in self.limits and not 0.0 < (checked or 0.0) <= self.limits[name]:
            raise InputError(
                f"{name} must be positive and at most {self.limits[name]:g} as at the start, got {checked or 0.0:g}"
            )
        if at is not None and at * 1e9 <= self.now:
            raise InputError(f"at must be later than {max(self.now, 0) / 1e9:.3f} s, got {at:g} s")
        return checked

    def enqueue(self, name: str, value: Any, due: int = 0, by: str | None = None) -> None:
        """Apply a checked value `due` [ns] after the first tick (0: at the next tick), asked for `by` a node."""
        change = due, name, value, self.who() if by is None else by
        self._pending.append(change)
        if self.now < 0 and name != ACTIVE:
            self._initial.append(change)
        self._pending.sort(key=lambda change: change[0])
        self.due = self._pending[0][0]

    def request(self, name: str, value: Any, at: float | None = None) -> None:
        """Apply a change at a time of the run [s], without one at the next tick; see :meth:`check` for the errors."""
        self.enqueue(name, self.check(name, value, at), 0 if at is None else round(at * RATE) * TICK_NS)

    def advance(self, since_start: int) -> None:
        """Apply what is due at this tick, `since_start` [ns] after the first one."""
        self.now = since_start
        while since_start >= self.due:
            _, name, value, by = self._pending.pop(0)
            self.due = self._pending[0][0] if self._pending else NEVER
            self.appliers[name](value)
            self.unpublished.append((name, value))
            self._changed.add(name)
            if len(self._applied) < MAX_KEPT:
                self._applied.append((since_start // TICK_NS, name, value, by))

    def restore(self) -> None:
        """Start of another run: the initial settings, and again the changes requested before it.

        A node that is inactive stays so.
        """
        for name in sorted(self._changed - {STOP, RESET, ACTIVE}):
            value = getattr(self.config, name)
            self.appliers[name](self.limits.get(name, value))
            self.unpublished.append((name, value))
        self._changed.clear()
        self._applied.clear()
        self._pending = sorted(self._initial, key=lambda change: change[0])
        self.due = self._pending[0][0] if self._pending else NEVER
        self.now = -1

    def record(self) -> dict[str, str]:
        """The changes so far, with their requesters, as a value of the statistics; empty without changes."""
        rows = [
            {"tick": tick, "name": name, "value": value, **({"by": by} if by else {})}
            for tick, name, value, by in self._applied
        ]
        return {"changes": json.dumps(rows)} if rows else {}
