"""Parts of the fast tones' band that can have bounds of their own, near its edge to the slow tones.

A window of the relative error is short beside these tones, so that most of their error adds up with that of slow tones
and of noise (:mod:`titop_plant.telescope.budget`): sums need the bound of each part. Names are those of proofs and of
their files.
"""

from __future__ import annotations

import itertools

from titop_plant.telescope.budget import BAND_EDGE

FAST = "fast"
NEAR_EDGE = (BAND_EDGE, 126.0, 128.5, 132.0, 138.0, 150.0, 200.0)
"""Edges of the parts [rad/s]."""
PARTS = {f"{FAST}, {low:g} to {high:g}": (low, high) for low, high in itertools.pairwise(NEAR_EDGE)}
"""Band [rad/s] of each part, by name."""
