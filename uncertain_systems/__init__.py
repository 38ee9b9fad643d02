"""Linear systems with named ports and real parameters (linear fractional transformations)."""

from uncertain_systems.interconnection import (
    Connection,
    close,
    connect,
    invert,
    parallel,
    series,
    star,
    transform,
)
from uncertain_systems.parameters import RealParameter
from uncertain_systems.runtime import Port, SampledSystem
from uncertain_systems.system import (
    StateSpaceData,
    UncertainSystem,
    from_control,
    state_space,
    static_gain,
)

__all__ = [
    "Connection",
    "Port",
    "RealParameter",
    "SampledSystem",
    "StateSpaceData",
    "UncertainSystem",
    "close",
    "connect",
    "from_control",
    "invert",
    "parallel",
    "series",
    "star",
    "state_space",
    "static_gain",
    "transform",
]
