"""Control laws that make a loop unstable so slowly that a short record does not show it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from los_testbed.parts.run_parts import RunParts

from lftkit import SampledSystem


def with_slow_pole(parts: RunParts) -> SampledSystem:
    """K_PMA of a run with one more state that grows by 1.0005 per tick and is next to nothing in the commands."""
    law = parts.k_pma
    assert isinstance(law, SampledSystem)
    n = law.order
    A = np.block([[law.A, np.zeros((n, 1))], [np.zeros((1, n)), 1.0005 * np.eye(1)]])
    B, C = np.vstack([law.B, np.ones((1, 6))]), np.hstack([law.C, np.full((6, 1), 1e-9)])
    return replace(law, A=A, B=B, C=C)
