"""A node asks the middleware whether there is a request, without its executor."""

import pytest
import rclpy
from los_testbed.nodes.support.requests import Requests
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from ros_runs import until
from std_srvs.srv import Trigger

pytestmark = pytest.mark.ros


@pytest.fixture
def nodes():
    context = rclpy.Context()
    rclpy.init(context=context)
    server = Node("server", context=context, start_parameter_services=False)
    user = Node("user", context=context)
    yield server, user
    server.destroy_node()
    user.destroy_node()
    rclpy.try_shutdown(context=context)


def test_a_request_waits_until_the_executor_has_answered_it(nodes):
    server, user = nodes
    requests, executor = Requests(server), SingleThreadedExecutor(context=server.context)
    executor.add_node(server)
    assert not requests.waiting()

    def answer(request, response):
        response.success = True
        return response

    server.create_service(Trigger, "~/go", answer)  # seen although it was made after the first question
    assert not requests.waiting()
    client = user.create_client(Trigger, "/server/go")
    assert client.wait_for_service(60.0)
    future = client.call_async(Trigger.Request())
    until(requests.waiting)
    assert requests.waiting(), "asking does not take it"
    executor.spin_once(timeout_sec=0.0)
    assert not requests.waiting()
    other = SingleThreadedExecutor(context=user.context)
    other.add_node(user)
    other.spin_until_future_complete(future, 60.0)
    assert future.result().success
