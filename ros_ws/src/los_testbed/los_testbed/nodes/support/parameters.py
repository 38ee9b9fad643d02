"""The run's configuration as ROS parameters: read-only, with description, range and unit."""

from __future__ import annotations

from dataclasses import Field
from typing import Any

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.exceptions import ParameterException
from rclpy.node import Node
from rclpy.parameter import Parameter

from los_testbed.config import FIELDS, RunConfig, unknown

_OWN = ("use_sim_time", "start_type_description_service")


def declare_config(node: Node) -> RunConfig:
    """Declare every field of :class:`RunConfig` on the node and return the configuration it was given.

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
                node.declare_parameter(name, Parameter.Type.DOUBLE_ARRAY, _descriptor(entry))
                given = node.get_parameter_or(name, None)
                values[name] = tuple(given.value or ()) if given is not None else default
            else:
                values[name] = node.declare_parameter(name, default, _descriptor(entry)).value
        except ParameterException as error:
            raise ValueError(f"{name}: {' '.join(str(error).split())}") from None
    if values["namespace"] != node.get_namespace():
        raise ValueError(
            f"namespace must be that of the node, {node.get_namespace()} (set it by -r __ns:=NAMESPACE), "
            f"got {values['namespace']}"
        )
    return RunConfig.from_mapping(values)


def _descriptor(entry: Field[Any]) -> ParameterDescriptor:
    meta = entry.metadata
    unit, choices = meta["unit"], meta.get("choices")
    text = meta["description"] + (f" [{unit}]" if unit else "")
    descriptor = ParameterDescriptor(name=entry.name, description=text, read_only=True)
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
