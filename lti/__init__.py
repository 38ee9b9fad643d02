"""Linear systems with named ports: state space, uncertain (linear fractional transformations), sampled.

Names are loaded when they are first asked for: controllers at run time import :mod:`lti.sampled_system` alone, and
with it numpy only.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from lti.delay import pade_delay
    from lti.feedback import cascade, close_loop
    from lti.filters import high_pass, transfer
    from lti.interconnection import Connection, close, connect, invert, parallel, series, star, transform
    from lti.norms import HInfNorm, h2_norm, hinf_norm, hinf_norms, spectral_abscissa
    from lti.parameters import RealParameter
    from lti.plots import bode_band, pole_map, sigma_plot
    from lti.ports import Port
    from lti.sampled_system import SampledSystem
    from lti.sampling import sampled
    from lti.state_space_model import StateSpace
    from lti.uncertain_system import UncertainSystem, from_control, state_space, static_gain

__all__ = [
    "Connection",
    "HInfNorm",
    "Port",
    "RealParameter",
    "SampledSystem",
    "StateSpace",
    "UncertainSystem",
    "bode_band",
    "cascade",
    "close",
    "close_loop",
    "connect",
    "from_control",
    "h2_norm",
    "high_pass",
    "hinf_norm",
    "hinf_norms",
    "invert",
    "pade_delay",
    "parallel",
    "pole_map",
    "sampled",
    "series",
    "sigma_plot",
    "spectral_abscissa",
    "star",
    "state_space",
    "static_gain",
    "transfer",
    "transform",
]

_MODULES = {
    "delay": ("pade_delay",),
    "feedback": ("cascade", "close_loop"),
    "filters": ("high_pass", "transfer"),
    "interconnection": ("Connection", "close", "connect", "invert", "parallel", "series", "star", "transform"),
    "norms": ("HInfNorm", "h2_norm", "hinf_norm", "hinf_norms", "spectral_abscissa"),
    "parameters": ("RealParameter",),
    "plots": ("bode_band", "pole_map", "sigma_plot"),
    "ports": ("Port",),
    "sampled_system": ("SampledSystem",),
    "sampling": ("sampled",),
    "state_space_model": ("StateSpace",),
    "uncertain_system": ("UncertainSystem", "from_control", "state_space", "static_gain"),
}
_MODULE_OF = {name: module for module, names in _MODULES.items() for name in names}


def __getattr__(name: str) -> Any:
    if name in _MODULE_OF:
        value = getattr(import_module(f"lti.{_MODULE_OF[name]}"), name)
        globals()[name] = value
        return value
    raise AttributeError(f"module 'lti' has no attribute {name!r}")


def __dir__() -> list[str]:
    return [*globals(), *_MODULE_OF]
