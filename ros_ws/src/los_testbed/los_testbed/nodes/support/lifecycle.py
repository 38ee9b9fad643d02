"""Life cycle of estimator and controller: active when they start; inactive, their output fades to zero."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn

MANAGED = ("estimator", "controller")


class ManagedNode(LifecycleNode):  # type: ignore[misc, unused-ignore]
    """Lifecycle node that notifies its loop.

    Activate and deactivate call `on_active`; shutdown sets `ended`. It is built once: cleanup is rejected.

    Parameters
    ----------
    name : str
        Name of the node.
    **values
        As :class:`rclpy.node.Node` takes them.
    """

    def __init__(self, name: str, **values: Any) -> None:
        super().__init__(name, **values)
        self.on_active: Callable[[bool], None] = lambda active: None
        self.ended = False
        self._change_state = self._service_change_state.callback
        self._service_change_state.callback = self._on_change_state

    def _on_change_state(self, request: Any, response: Any) -> Any:
        """Answer a transition that the present state does not have with a refusal; rclpy would end the node."""
        try:
            return self._change_state(request, response)
        except rclpy_implementation.RCLError:
            response.success = False
            return response

    def begin(self) -> None:
        """Configure and activate."""
        self.trigger_configure()
        self.trigger_activate()

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Nothing to do: the loop is built when the node starts."""
        return TransitionCallbackReturn.SUCCESS

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Fade in."""
        self.on_active(True)
        return TransitionCallbackReturn.SUCCESS

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Fade out."""
        self.on_active(False)
        return TransitionCallbackReturn.SUCCESS

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Refused: the node stays inactive."""
        return TransitionCallbackReturn.FAILURE

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """End the node."""
        self.ended = True
        return TransitionCallbackReturn.SUCCESS
