"""Former names of :class:`lftkit.System` and of the module of its matrices."""

from lftkit.systems.matrices import checked_matrices, real_array
from lftkit.systems.system import System as StateSpace

__all__ = ["StateSpace", "checked_matrices", "real_array"]
