"""The normalised value of a parameter, against `RealParameter.from_normalised`."""

from __future__ import annotations

from lftkit import RealParameter


def normalised_value(parameter: RealParameter, value: float) -> float:
    """nu with nominal + a nu / (1 + b nu) = value, (a, b) the bilinear map of the parameter."""
    a, b = parameter.bilinear
    deviation = value - parameter.nominal
    return deviation / (a - b * deviation)
