"""The run's configuration as ROS parameters, with description, range and unit; those that may change in a run do.

Each node can change the settings that it applies (:data:`los_testbed.loop.changes.NAMES`), at its next tick; the
parameter ``fault`` changes one of them at a tick that is named. All other parameters are read-only.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import Field
from typing import Any

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor, SetParametersResult
from rclpy.exceptions import ParameterException
from rclpy.node import Node
from rclpy.parameter import Parameter

from los_testbed.config import FIELDS, RunConfig, unknown
from los_testbed.loop.changes import Changes, parse_change

FAULT = "fault"
_OWN = ("use_sim_time", "start_type_description_service", FAULT)


def declare_config(node: Node, changing: Sequence[str] = ()) -> RunConfig:
    """Declare every field of :class:`RunConfig` on the node and return the configuration it was given.

    Those in `changing` are not read-only.

    Raises
    ------
    ValueError
        Unknown parameter, wrong type, value out of range.
    """
    for name in node._parameter_overrides:
        if name not in FIELDS and name not in _OWN and not name.startswith("qos_overrides"):
            raise ValueError(unknown(name))
    values: dict[str, Any] = {}
    for name, entry in FIELDS.items():
        default: Any = entry.default
        try:
            if name == "namespace":
                default = node.get_namespace()
            if isinstance(default, tuple):
                values[name] = _declare_array(node, entry)
            else:
                values[name] = node.declare_parameter(name, default, _descriptor(entry, name not in changing)).value
        except ParameterException as error:
            raise ValueError(f"{name}: {' '.join(str(error).split())}") from None
    if values["namespace"] != node.get_namespace():
        raise ValueError(
            f"namespace must be that of the node, {node.get_namespace()} (set it by -r __ns:=NAMESPACE), "
            f"got {values['namespace']}"
        )
    return RunConfig.from_mapping(values)


def _declare_array(node: Node, entry: Field[Any]) -> tuple[float, ...]:
    """Declare an array; one without a value would empty every answer to a request for several parameters."""
    descriptor = _descriptor(entry)
    descriptor.read_only = False
    node.declare_parameter(entry.name, Parameter.Type.DOUBLE_ARRAY, descriptor)
    given: Any = node.get_parameter_or(entry.name, None)
    value: Any = None if given is None else given.value
    values: tuple[float, ...] = tuple(value or ())
    node.set_parameters([Parameter(entry.name, Parameter.Type.DOUBLE_ARRAY, list(values))])
    final = _descriptor(entry)
    final.type = Parameter.Type.DOUBLE_ARRAY.value
    node.set_descriptor(entry.name, final)
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
        The parameter ``fault`` was given a value that is none.
    """

    def __init__(self, node: Node, changes: Changes) -> None:
        self._node = node
        self._changes = changes
        self._own = False
        text = "a change at a tick, as JSON: name, value and perhaps at [s from the start of the run]"
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
                elif parameter.name in FIELDS:
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
        while self._changes.told:
            name, value = self._changes.told.pop(0)
            if name in FIELDS and self._node.get_parameter(name).value != value:
                self._own = True
                self._node.set_parameters([Parameter(name, value=value)])
                self._own = False


def _descriptor(entry: Field[Any], read_only: bool = True) -> ParameterDescriptor:
    meta = entry.metadata
    unit, choices = meta["unit"], meta.get("choices")
    text = meta["description"] + (f" [{unit}]" if unit else "")
    descriptor = ParameterDescriptor(name=entry.name, description=text, read_only=read_only)
    if choices:
        descriptor.additional_constraints = "one of " + ", ".join(choices)
    low, high = meta.get("low"), meta.get("high")
    if low is None or high is None:
        return descriptor
    if type(entry.default) is float:
        descriptor.floating_point_range = [FloatingPointRange(from_value=float(low), to_value=float(high))]
    elif type(entry.default) is int:
        descriptor.integer_range = [IntegerRange(from_value=int(low), to_value=int(high), step=1)]
    else:
        descriptor.additional_constraints = f"each between {low:g} and {high:g}"
    return descriptor
