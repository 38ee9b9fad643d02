"""Observer, proof-mass law and disturbance of the user: their contract, checked before a run and at every tick.

A block is any object with ``reset`` and ``step``. `step` writes all of `out` and does not change its input; after
`reset` its outputs are bit-identical.

==================  ============================  ==========================================================
setting             step                          content
==================  ============================  ==========================================================
k_fsm               step(measurement, out)        22 measurements to 2 angles; the camera's are NaN between frames
k_pma               step(accel_Ip, out)           6 accelerations to 6 forces [N], limited afterwards
disturbance_source  step(out)                     forces and torques, :mod:`titop_plant.simulation.driven_plant`
==================  ============================  ==========================================================

A controller that names sensors and actuators of the telescope's file, a class in its attributes ``sensors`` and
``actuators``, a linear system in its ports, has their values behind these inputs and outputs
(:mod:`titop_plant.telescope.loop_ports`). An observer reads only; the proof-mass law reads and commands.

A controller may have a model: a method ``system()`` returns its sampled system, of python-control or lftkit. Its
``reset(state)`` sets a state of this system, ``reset(state, held)`` of an observer also the last values of the camera.
A run with it starts in the steady state of its loop, as one with a file does.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from lftkit.arrays import BoolArray, FloatArray
from lftkit.errors import InputError
from lftkit.support.file_kind import kind_of_file
from lftkit.systems.ports import Port, total_size
from lftkit.systems.sampled.sampled_system import SampledSystem
from los_estimator.runtime import LosEstimator
from los_testbed.config.plugins import RAISED, in_one_line, load, make
from los_testbed.config.run_config import RunConfig, is_library
from los_testbed.parts.law_models import difference, element, told_model
from los_testbed.parts.port_order import with_named_ports
from titop_plant.interface import DT, K_FSM_OUTPUTS, LAW_PORTS
from titop_plant.telescope.loop_ports import LoopPorts

UNTOUCHED = -1.2345678901234567e-300
"""Fill value that no block writes: an element with it after a step was not written."""

LARGEST = 1e30
"""No rad, N, Nm, m/s2 or rad/s2 of a telescope is larger; beyond it the next products are no longer finite."""
TRIAL_TICKS = 3


class BlockFailedError(RuntimeError):
    """A user's block failed during a run; the message says which, at which tick and how."""


def beyond(values: FloatArray) -> BoolArray:
    """Mask of the values that are NaN, infinite or larger than `LARGEST`.

    Examples
    --------
    >>> beyond(np.array([1.0, np.nan, -np.inf, 1e308]))
    array([False,  True,  True,  True])
    """
    return np.asarray(~(np.abs(values) <= LARGEST))


class UserBlock:
    """Checked wrapper of a user's block, with the interface of a controller from a file.

    Parameters
    ----------
    setting : str
        ``k_fsm``, ``k_pma`` or ``disturbance_source``.
    text : str
        Name under which it was loaded, for messages.
    block : object
        With ``reset`` and ``step``.
    inputs, outputs : sequences of Port
        A block without inputs has the signature ``step(out)``.
    ports : LoopPorts, optional
        Rows of the loop that it uses; None of a disturbance.

    Raises
    ------
    InputError
        `step` or `reset` is missing or no method.
    """

    def __init__(
        self,
        setting: str,
        text: str,
        block: Any,
        inputs: Sequence[Port],
        outputs: Sequence[Port],
        ports: LoopPorts | None = None,
    ) -> None:
        try:
            methods = {name: getattr(block, name, "none") for name in ("step", "reset")}
            self.design_basis: Mapping[str, Any] = getattr(block, "design_basis", {})
        except RAISED as error:
            raise InputError(f"{setting} {text}: attributes must have values, got {in_one_line(error)}") from error
        for name, method in methods.items():
            if not callable(method):
                raise InputError(f"{setting} {text}: {name} must be a method, got {method!r}")
        self.name, self.block, self.ports = f"{setting} {text}", block, ports
        self.inputs, self.outputs = tuple(inputs), tuple(outputs)
        if not isinstance(self.design_basis, Mapping):
            raise InputError(f"{setting} {text}: design_basis must be a mapping, got {self.design_basis!r}")
        self.tick = 0
        self._told = self._told_model()
        self._start: tuple[FloatArray, ...] = ()

    def require(self, inputs: Iterable[Port], outputs: Iterable[Port], dt: float) -> None:
        """Nothing: code has no ports of its own, `check` tries the step."""

    def _told_model(self) -> SampledSystem | None:
        """Result of the method ``system`` of user code; None without one."""
        try:
            return told_model(self.block, self.inputs, self.outputs)
        except RAISED as error:
            what = error if isinstance(error, ValueError) else in_one_line(error)
            raise InputError(f"{self.name}: system must return the sampled system of the block, got {what}") from error

    @property
    def linear(self) -> SampledSystem | None:
        """Its linear system or model; None for other code."""
        law = self.block.k_fsm if type(self.block) is LosEstimator else self.block
        return law if isinstance(law, SampledSystem) else self._told

    @property
    def is_linear(self) -> bool:
        """Whether it is a linear system itself, not a class with a model."""
        return self.linear is not None and self._told is None

    @property
    def order(self) -> int:
        """Of a linear system; 0 of code without a model, which has no state that is known."""
        return 0 if self.linear is None else self.linear.order

    def start_at(self, state: FloatArray, camera: FloatArray) -> None:
        """Set the state of the next reset of an observer; no effect on code without a model, which starts at rest."""
        if type(self.block) is LosEstimator:
            self.block.start_at(state, camera)
        elif self._told is not None:
            self._start = np.array(state, dtype=float), np.array(camera, dtype=float)

    def reset(self, state: FloatArray | None = None) -> None:
        """Return to the first tick; with a model, to `state` (order,)."""
        self.tick = 0
        try:
            if self._told is not None:
                self.block.reset(*(self._start if state is None else (state,)))
            elif isinstance(self.block, SampledSystem):
                self.block.reset(state)
            else:
                self.block.reset()
        except RAISED as error:
            raise BlockFailedError(f"{self.name}: reset failed: {in_one_line(error)}") from error

    def step(self, *vectors: FloatArray) -> None:
        """One tick: the input, where the block has one, and `out`.

        Raises
        ------
        BlockFailedError
            The block raised an exception, or wrote a value that is not finite; the message names tick and port.
        """
        out = vectors[-1]
        try:
            self.block.step(*vectors)
        except RAISED as error:
            raise BlockFailedError(f"{self.name} failed at tick {self.tick}: {in_one_line(error)}") from error
        odd = beyond(out)
        if odd.any():
            where, value = element(self.outputs, odd), out[odd][0]
            raise BlockFailedError(f"{self.name} failed at tick {self.tick}: {where} is {value:g}")
        self.tick += 1

    def check(self) -> None:
        """Try a few ticks on a copy; a block that cannot be copied is tried itself and reset afterwards.

        Raises
        ------
        InputError
            `step` fails, leaves something unwritten, writes values that are not finite, changes its input, or does not
            repeat itself after `reset`.
        """
        try:
            trial = UserBlock(self.name, "", copy.deepcopy(self.block), self.inputs, self.outputs, self.ports)
        except Exception:
            trial = UserBlock(self.name, "", self.block, self.inputs, self.outputs, self.ports)
        trial.name = self.name
        first, second = (np.array(list(trial._trial())) for _ in range(2))
        trial.reset()
        if not np.array_equal(first, second):
            tick, index = np.argwhere(first != second)[0]
            where = element(self.outputs, np.arange(first.shape[1]) == index)
            pair = f"{first[tick, index]:g} and {second[tick, index]:g}"
            raise InputError(
                f"{self.name} must give the same outputs after reset, got {pair} in {where} at tick {tick}"
            )
        if self._told is not None:
            trial._check_model(self._told)

    def _check_model(self, model: SampledSystem) -> None:
        """Compare user code with its model."""
        try:
            text = difference(self.block.reset, self.block.step, model, self.ports)
        except RAISED as error:
            what = in_one_line(error)
            raise InputError(f"{self.name}: reset and step must accept a state, got {what}") from error
        if text:
            raise InputError(f"{self.name}: step must agree with system() from a state, got {text}")

    def _trial(self) -> Iterable[FloatArray]:
        """Outputs of the first ticks after a reset, with zeros as input; held values are NaN from the second tick."""
        size, width = total_size(self.inputs), total_size(self.outputs)
        shapes = ", ".join(f"{port.name} ({port.size},)" for port in (*self.inputs, *self.outputs))
        try:
            self.reset()
        except BlockFailedError as error:
            raise InputError(str(error)) from error
        for tick in range(TRIAL_TICKS):
            inputs = np.zeros(size)
            if tick and self.outputs == K_FSM_OUTPUTS and self.ports is not None:
                inputs[self.ports.held] = np.nan
            kept, out = inputs.copy(), np.full(width, UNTOUCHED)
            try:
                self.block.step(*((inputs, out) if size else (out,)))
            except RAISED as error:
                raise InputError(f"{self.name}: step must accept {shapes}, got {in_one_line(error)}") from error
            if not np.array_equal(inputs, kept, equal_nan=True):
                raise InputError(f"{self.name}: step must not change its input, got another one after the step")
            if (untouched := out == UNTOUCHED).any():
                where = element(self.outputs, untouched)
                raise InputError(f"{self.name}: step must write all of out, got nothing in {where}")
            if (odd := beyond(out)).any():
                where = f"{element(self.outputs, odd)} at tick {tick}"
                raise InputError(f"{self.name}: step must write finite values, got {out[odd][0]:g} in {where}")
            yield out


def watched(method: Callable[..., None], name: str) -> Callable[..., None]:
    """A method of an object that a node was given; an exception that it raises becomes a `BlockFailedError`."""

    def call(*vectors: FloatArray) -> None:
        try:
            method(*vectors)
        except BlockFailedError:  # its message has the cause
            raise
        except RAISED as error:
            raise BlockFailedError(f"{name} failed: {in_one_line(error)}") from error

    return call


def make_law(config: RunConfig, setting: str, ports: LoopPorts) -> UserBlock:
    """Controller that the setting ``k_fsm`` or ``k_pma`` names, checked.

    Parameters
    ----------
    config : RunConfig
    setting : str
    ports : LoopPorts
        Rows of the telescope.

    Raises
    ------
    ValueError
        It cannot be made, or breaks the contract.
    """
    text = getattr(config, setting)
    block: Any
    if is_library(text):
        from los_testbed.parts.flight_library import LibraryLaw

        block, used = LibraryLaw(Path(text), setting), ports.of_law(setting)
    elif law := linear_law(setting, text, config.ports_in_order):
        used = ports.of_system(setting, law)
        block = _checked(setting, text, with_loop_ports(setting, text, law, ports), used)
    else:
        block = make(config, setting)
        used = _named(setting, text, block, ports)
        _refuse_commands(setting, text, used)
    made = UserBlock(setting, text, block, *used.law_ports(setting), used)
    made.check()
    return made


def read_law(setting: str, path: Path, in_order: bool = False) -> SampledSystem:
    """Controller of a file; ValueError: the file holds none, or one without names of ports, see `with_named_ports`."""
    check_controller_file(path)
    if path.suffix == ".json":  # as all stored ones are; nothing else is loaded for them
        return SampledSystem.from_file(path)
    from lftkit.systems.exchange import read_sampled

    law = read_sampled(path)
    try:
        return with_named_ports(law, *LAW_PORTS[setting], in_order)
    except ValueError as error:
        raise InputError(f"{setting} {path}: {error}") from None


def with_loop_ports(setting: str, text: str, law: SampledSystem, ports: LoopPorts) -> SampledSystem:
    """A linear controller with the inputs of its rows in their order; as it is where these are the stored one's.

    Raises
    ------
    InputError
        An observer that commands an actuator; other ports, another period.
    """
    used = ports.of_system(setting, law)
    _refuse_commands(setting, text, used)
    inputs, outputs = used.law_ports(setting)
    try:
        whole = law.with_inputs(inputs)
        whole.require(inputs, outputs, DT)
    except ValueError as error:
        raise InputError(f"{setting} {text}: {error}") from None
    return law if (inputs, outputs) == LAW_PORTS[setting] else whole


def linear_law(setting: str, text: str, in_order: bool = False) -> SampledSystem | None:
    """A system of python-control or of lftkit by its name, see `with_named_ports`; None for anything else.

    Raises
    ------
    ValueError
        A system that is not sampled, or has no names of ports.
    """
    law = load(text, setting)
    if isinstance(law, SampledSystem):
        return law
    if type(law).__module__.partition(".")[0] not in ("control", "lftkit") or not hasattr(law, "dt"):
        return None
    from lftkit.systems.exchange import as_sampled, as_system

    try:
        return with_named_ports(as_sampled(as_system(law)), *LAW_PORTS[setting], in_order)
    except ValueError as error:
        raise InputError(f"{setting} {text}: {error}") from None


def check_controller_file(path: Path | str) -> None:
    """Reject a file of another type by its name; ValueError."""
    kind = kind_of_file(path)
    if kind not in (None, "JSON", "a MATLAB file"):
        raise InputError(f"{path} is not a controller file: expected JSON or .mat (up to 7.2), got {kind}")


def _checked(setting: str, text: str, law: SampledSystem, ports: LoopPorts) -> LosEstimator | SampledSystem:
    """A linear law as a block."""
    try:
        if setting == "k_fsm":
            return LosEstimator(law, ports)
        law = law.with_inputs(ports.measured)
        law.require(ports.measured, ports.commanded, DT)
    except ValueError as error:
        raise InputError(f"{setting} {text}: {error}") from None
    return law


def _named(setting: str, text: str, block: Any, ports: LoopPorts) -> LoopPorts:
    """Rows of the stored controller, then those that a class of the user names."""
    try:
        return ports.of_law(setting, *(getattr(block, what, ()) for what in ("sensors", "actuators")))
    except RAISED as error:
        what = error if isinstance(error, ValueError) else in_one_line(error)
        raise InputError(f"{setting} {text}: {what}") from error


def _refuse_commands(setting: str, text: str, ports: LoopPorts) -> None:
    if setting == "k_fsm" and ports.actuators:
        names = ", ".join(port.name for port in ports.commanded)
        raise InputError(f"{setting} {text}: an observer must command no actuator (k_pma does), got {names}")


def make_disturbance(config: RunConfig, ports: Sequence[Port]) -> UserBlock:
    """Disturbance that the configuration names, for these ports of the telescope, checked.

    Raises
    ------
    ValueError
        It cannot be made, or breaks the contract.
    """
    setting = "disturbance_source"
    made = UserBlock(setting, str(config.disturbance_source), make(config, setting), (), ports)
    made.check()
    return made
