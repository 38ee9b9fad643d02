"""Robust control of linear systems: one type :class:`System` with named ports, uncertain elements, bounds, tuning.

Names are loaded when they are first asked for: controllers at run time import
:mod:`lftkit.systems.sampled.sampled_system` alone, and with it numpy only.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

__version__ = "0.2.0"

if TYPE_CHECKING:
    from lftkit.analysis.magnitude_fit import Cover, fit_magnitude, ucover
    from lftkit.analysis.margins import (
        DiskMargin,
        LoopMargins,
        SensitivityPeaks,
        disk_margin,
        loop_margins,
        sensitivity_peaks,
    )
    from lftkit.analysis.norms import HInfNorm, h2_norm, hinf_norm, hinf_norms, linf_norm, spectral_abscissa
    from lftkit.analysis.nu_gap import NuGap, nu_gap
    from lftkit.analysis.passivity import PassivityIndex, passivity_index
    from lftkit.analysis.plots import bode_band, pole_map, sigma_plot
    from lftkit.errors import InputError
    from lftkit.reduction.balanced import ReducedSystem, balred, hankel_singular_values, ncfmr
    from lftkit.systems.connection.feedback import cascade, close_loop
    from lftkit.systems.connection.filters import high_pass, transfer
    from lftkit.systems.connection.interconnection import (
        Connection,
        append,
        close,
        connect,
        feedback,
        invert,
        parallel,
        series,
        star,
        transform,
    )
    from lftkit.systems.delay import pade_delay
    from lftkit.systems.exchange import (
        as_system,
        from_json,
        from_scipy,
        read_system,
        to_json,
        to_scipy,
        write_system,
    )
    from lftkit.systems.mat_files import read_mat, write_mat
    from lftkit.systems.minimal import minimal_realisation
    from lftkit.systems.ports import Port
    from lftkit.systems.sampled.sampled_system import SampledSystem
    from lftkit.systems.sampling import discretise, sampled
    from lftkit.systems.symbolic.expressions import Expression, matrix
    from lftkit.systems.symbolic.variables import complex_gain, dynamic, real, s, z
    from lftkit.systems.system import System, from_control, state_space, static_gain
    from lftkit.uncertainty.elements import ComplexParameter, DynamicElement, RealParameter

__all__ = [
    "ComplexParameter",
    "Connection",
    "Cover",
    "DiskMargin",
    "DynamicElement",
    "Expression",
    "HInfNorm",
    "InputError",
    "LoopMargins",
    "NuGap",
    "PassivityIndex",
    "Port",
    "RealParameter",
    "ReducedSystem",
    "SampledSystem",
    "SensitivityPeaks",
    "System",
    "append",
    "as_system",
    "balred",
    "bode_band",
    "cascade",
    "close",
    "close_loop",
    "complex_gain",
    "connect",
    "discretise",
    "disk_margin",
    "dynamic",
    "feedback",
    "fit_magnitude",
    "from_control",
    "from_json",
    "from_scipy",
    "h2_norm",
    "hankel_singular_values",
    "high_pass",
    "hinf_norm",
    "hinf_norms",
    "invert",
    "linf_norm",
    "loop_margins",
    "matrix",
    "minimal_realisation",
    "ncfmr",
    "nu_gap",
    "pade_delay",
    "parallel",
    "passivity_index",
    "pole_map",
    "read_mat",
    "read_system",
    "real",
    "s",
    "sampled",
    "sensitivity_peaks",
    "series",
    "sigma_plot",
    "spectral_abscissa",
    "star",
    "state_space",
    "static_gain",
    "to_json",
    "to_scipy",
    "transfer",
    "transform",
    "ucover",
    "write_mat",
    "write_system",
    "z",
]

_MODULES = {
    "analysis.magnitude_fit": ("Cover", "fit_magnitude", "ucover"),
    "analysis.margins": (
        "DiskMargin",
        "LoopMargins",
        "SensitivityPeaks",
        "disk_margin",
        "loop_margins",
        "sensitivity_peaks",
    ),
    "analysis.nu_gap": ("NuGap", "nu_gap"),
    "analysis.passivity": ("PassivityIndex", "passivity_index"),
    "analysis.norms": ("HInfNorm", "h2_norm", "hinf_norm", "hinf_norms", "linf_norm", "spectral_abscissa"),
    "errors": ("InputError",),
    "analysis.plots": ("bode_band", "pole_map", "sigma_plot"),
    "reduction.balanced": ("ReducedSystem", "balred", "hankel_singular_values", "ncfmr"),
    "systems.delay": ("pade_delay",),
    "systems.exchange": (
        "as_system",
        "from_json",
        "from_scipy",
        "read_system",
        "to_json",
        "to_scipy",
        "write_system",
    ),
    "systems.mat_files": ("read_mat", "write_mat"),
    "systems.symbolic.expressions": ("Expression", "matrix"),
    "systems.connection.feedback": ("cascade", "close_loop"),
    "systems.connection.filters": ("high_pass", "transfer"),
    "systems.connection.interconnection": (
        "Connection",
        "append",
        "close",
        "connect",
        "feedback",
        "invert",
        "parallel",
        "series",
        "star",
        "transform",
    ),
    "systems.minimal": ("minimal_realisation",),
    "systems.ports": ("Port",),
    "systems.sampled.sampled_system": ("SampledSystem",),
    "systems.sampling": ("discretise", "sampled"),
    "systems.system": ("System", "from_control", "state_space", "static_gain"),
    "systems.symbolic.variables": ("complex_gain", "dynamic", "real", "s", "z"),
    "uncertainty.elements": ("ComplexParameter", "DynamicElement", "RealParameter"),
}
_MODULE_OF = {name: module for module, names in _MODULES.items() for name in names}


def __getattr__(name: str) -> Any:
    if name in _MODULE_OF:
        value = getattr(import_module(f"lftkit.{_MODULE_OF[name]}"), name)
        globals()[name] = value
        return value
    raise AttributeError(f"module 'lftkit' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *_MODULE_OF})
