"""The run's configuration as ROS parameters with description, range and unit; some can change during a run.

Each node can change the settings that it applies (:data:`los_testbed.run.loop.changes.NAMES`), at its next tick; the
parameter ``fault`` changes one of them at a tick that is named. All other parameters are read-only.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Any

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor, SetParametersResult
from rclpy.exceptions import ParameterException
from rclpy.node import Node
from rclpy.parameter import Parameter

from lftkit.errors import InputError
from los_testbed.config.run_config import RunConfig
from los_testbed.run.loop.changes import NAMES, Changes, parse_change
from titop_plant.settings import Setting, unknown

FAULT = "fault"
SIMULATED_TIME = "use_sim_time"
_OWN = (SIMULATED_TIME, "start_type_description_service", FAULT)


def declare_config(node: Node, changing: Sequence[str] = ()) -> RunConfig:
    """Declare every setting of :class:`RunConfig` on the node and return the configuration it was given.

    Those in `changing` are not read-only.

    Raises
    ------
    ValueError
        Unknown parameter, wrong type, value out of range.
    """
    for name in node._parameter_overrides:
        if name not in RunConfig.SETTINGS and name not in _OWN and not name.startswith("qos_overrides"):
            raise InputError(unknown(name, RunConfig.SETTINGS))
    values: dict[str, Any] = {}
    for name, setting in RunConfig.SETTINGS.items():
        default = node.get_namespace() if name == "namespace" else setting.plain(setting.default)
        default = json.dumps(default) if isinstance(default, dict) else default
        try:
            if setting.kind is tuple:
                values[name] = _declare_array(node, setting)
            else:
                values[name] = node.declare_parameter(name, default, _descriptor(setting, name not in changing)).value
        except ParameterException as error:
            raise InputError(f"{name}: {' '.join(str(error).split())}") from None
    if values["namespace"] != node.get_namespace():
        raise InputError(
            f"namespace must be that of the node, {node.get_namespace()} (set it by -r __ns:=NAMESPACE), "
            f"got {values['namespace']}"
        )
    text = "use /clock, which the plant publishes in lockstep; set at the start, with the mode"
    kind = Parameter.Type.BOOL.value
    node.set_descriptor(
        SIMULATED_TIME, ParameterDescriptor(name=SIMULATED_TIME, type=kind, description=text, read_only=True)
    )
    return RunConfig.from_mapping(values)


def _declare_array(node: Node, setting: Setting) -> tuple[float, ...]:
    """Declare an array; one without a value would empty every answer to a request for several parameters."""
    descriptor = _descriptor(setting)
    descriptor.read_only = False
    node.declare_parameter(setting.name, Parameter.Type.DOUBLE_ARRAY, descriptor)
    parameter: Any = node.get_parameter_or(setting.name, None)
    value: Any = None if parameter is None else parameter.value
    values: tuple[float, ...] = tuple(value or ())
    node.set_parameters([Parameter(setting.name, Parameter.Type.DOUBLE_ARRAY, list(values))])
    final = _descriptor(setting)
    final.type = Parameter.Type.DOUBLE_ARRAY.value
    node.set_descriptor(setting.name, final)
    return values


class ChangingParameters:
    """Requests for changes of a node's settings, checked and handed to its loop.

    Parameters
    ----------
    node : Node
        With the declared parameters.
    changes : Changes
        Of the loop.

    Raises
    ------
    ValueError
        The parameter ``fault`` has an invalid value.
    """

    def __init__(self, node: Node, changes: Changes) -> None:
        self._node = node
        self._changes = changes
        self._own = False
        text = "a change at a tick, as JSON: name, value and optionally at [s from the start of the run]"
        fault = node.declare_parameter(FAULT, "", ParameterDescriptor(name=FAULT, description=text)).value
        if fault:
            changes.request(*parse_change(fault))
        node.add_on_set_parameters_callback(self._on_set)

    def _on_set(self, parameters: Sequence[Parameter]) -> SetParametersResult:
        """Check all, then request all."""
        if self._own:
            return SetParametersResult(successful=True)
        asked: list[tuple[str, Any, float | None]] = []
        try:
            for parameter in parameters:
                if parameter.name == FAULT and parameter.value:
                    asked.append(parse_change(parameter.value))
                elif parameter.name in RunConfig.SETTINGS:
                    asked.append((parameter.name, parameter.value, None))
            for name, value, at in asked:
                self._changes.check(name, value, at)
            for name, value, at in asked:
                self._changes.request(name, value, at)
        except ValueError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    def follow(self) -> None:
        """Give the parameters the values that a fault has set; in the slack after a tick."""
        while self._changes.unpublished:
            name, value = self._changes.unpublished.pop(0)
            if name in RunConfig.SETTINGS and self._node.get_parameter(name).value != value:
                self._own = True
                self._node.set_parameters([Parameter(name, value=value)])
                self._own = False


def _descriptor(setting: Setting, read_only: bool = True) -> ParameterDescriptor:
    absent = setting.plain(None) if setting.optional else None
    text = setting.text + (f"; {json.dumps(absent)} for {setting.absent}" if setting.optional else "")
    if owner := next((node for node, names in NAMES.items() if setting.name in names), None):
        text += f"; the {owner} changes it during a run"
    descriptor = ParameterDescriptor(name=setting.name, description=text, read_only=read_only)
    if setting.low is None or setting.high is None:
        descriptor.additional_constraints = setting.range
    elif setting.kind is tuple:
        descriptor.additional_constraints = f"each {setting.range}"
    else:
        low = setting.low if absent is None else min(setting.low, absent)
        ends = {"from_value": setting.kind(low), "to_value": setting.kind(setting.high)}
        if setting.kind is float:
            descriptor.floating_point_range = [FloatingPointRange(**ends)]
        else:
            descriptor.integer_range = [IntegerRange(**ends, step=1)]
    return descriptor
