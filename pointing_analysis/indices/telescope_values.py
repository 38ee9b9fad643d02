"""Values of the telescope that the analysis needs: those of the bag, else those of the reference telescope."""

from __future__ import annotations

import math
from collections.abc import Mapping
from types import MappingProxyType

from pointing_analysis.files.structured_text import is_number
from pointing_analysis.read.recording import Recording

#: for bags without their own: ``los_sensitivity`` [rad of line of sight per rad of mirror], ``fsm_authority``
#: (largest mirror angle) [rad], ``pma_authority`` (largest force of one actuator) [N], ``fsm_frequency`` [rad/s] and
#: ``fsm_damping`` (damping ratio) of the mirror on its joint
DEFAULTS: Mapping[str, float] = MappingProxyType(
    {
        "los_sensitivity": 0.1,
        "fsm_authority": 5.3e-3,
        "pma_authority": 31.6,
        "fsm_frequency": 1569.6,
        "fsm_damping": 0.153,
    }
)


def telescope_value(run: Recording, name: str) -> float:
    """A value of `DEFAULTS` as the recorder wrote it into the bag, or the default if the bag does not state it."""
    value = run.parameters.get(name)
    if is_number(value) and math.isfinite(value) and value > 0:
        return float(value)
    return DEFAULTS[name]
