"""Linear systems with named ports and real parameters (linear fractional transformations).

Names are loaded when they are first asked for: what flies imports :mod:`uncertain_systems.runtime` alone, and with
it numpy only.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
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

_HOMES = ("runtime", "parameters", "system", "interconnection")


def __getattr__(name: str) -> Any:
    if name in __all__:
        for home in _HOMES:
            module = import_module(f"uncertain_systems.{home}")
            if name in vars(module):
                globals()[name] = vars(module)[name]
                return globals()[name]
    raise AttributeError(f"module 'uncertain_systems' has no attribute {name!r}")


def __dir__() -> list[str]:
    return [*globals(), *__all__]
