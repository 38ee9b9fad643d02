"""Former names of :class:`lftkit.System` and its functions."""

from lftkit.systems.system import System as UncertainSystem
from lftkit.systems.system import from_control, state_space, static_gain

__all__ = ["UncertainSystem", "from_control", "state_space", "static_gain"]
