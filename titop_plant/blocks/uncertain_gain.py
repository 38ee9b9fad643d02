"""An uncertain factor of the signals of a port: gain errors of sensors and actuators."""

from __future__ import annotations

import numpy as np

from lftkit import Port, RealParameter, System


def uncertain_gain(port: Port, factor: RealParameter) -> System:
    """One uncertain factor of all signals of a port, from the port to itself; one occurrence for each signal.

    Examples
    --------
    >>> block = uncertain_gain(Port("u", 2), RealParameter("u.gain", 1.0, 0.9, 1.1))
    >>> block.at({"u.gain": 1.1}).D.tolist()
    [[1.1, 0.0], [0.0, 1.1]]
    """
    one, n = np.eye(port.size), port.size
    D = np.block([[np.zeros((n, n)), one], [one, factor.nominal * one]])
    A, B, C = np.zeros((0, 0)), np.zeros((0, 2 * n)), np.zeros((2 * n, 0))
    return System(A, B, C, D, (port,), (port,), channels=(factor.name,) * n, elements=(factor,))
