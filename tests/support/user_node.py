"""A node of a user beside a run, in the process of the test: parameters and services by the clients of ROS."""

from __future__ import annotations

import pytest
from bystander import middleware
from los_testbed.nodes.remote_control import RemoteControl
from rcl_interfaces.srv import GetParameters, ListParameters
from rclpy.context import Context
from rclpy.node import Node
from rclpy.parameter import parameter_value_to_python


class UserNode:
    """Remote control in this process, with a context of its own."""

    def __init__(self, domain, namespace="/telescope", timeout=60.0):
        with middleware():
            self.context = Context()
            self.context.init(domain_id=domain)
            self.node = Node("user", context=self.context)
        self.remote = RemoteControl(self.node, namespace, timeout)

    def dump(self, name):
        """All parameters of a node, as `ros2 param dump` asks for them."""
        names = self.remote._call(ListParameters, f"{name}/list_parameters", ListParameters.Request()).result.names
        request = GetParameters.Request(names=names)
        values = self.remote._call(GetParameters, f"{name}/get_parameters", request).values
        return {n: parameter_value_to_python(v) for n, v in zip(names, values, strict=True)}

    def refused(self, call, *arguments):
        with pytest.raises(ValueError) as error:
            call(*arguments)
        return str(error.value)

    def close(self):
        self.node.destroy_node()
        self.context.shutdown()
