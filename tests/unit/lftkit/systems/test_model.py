"""Models with named ports: conversion, weights, sampling, refusals."""

from __future__ import annotations

import numpy as np
import pytest

from lftkit.analysis.frequency_response import direct_response
from lftkit.systems.connection.feedback import cascade, close_loop
from lftkit.systems.connection.filters import transfer
from lftkit.systems.ports import Port
from lftkit.systems.sampled.sampling import sampled
from lftkit.systems.system import System
from lftkit.tuning.requirements import ClosedLoopPoles, HinfGain
from lftkit.tuning.structures.structures import pid, state_space


def plant() -> System:
    rng = np.random.default_rng(0)
    ports_in, ports_out = [Port("w", 2, "N"), Port("u", 1, "N")], [Port("z", 1, "rad"), Port("y", 2, "m")]
    A = rng.normal(size=(4, 4)) - 3 * np.eye(4)
    return System(
        A, rng.normal(size=(4, 3)), rng.normal(size=(3, 4)), rng.normal(size=(3, 3)), ports_in, ports_out, "p"
    )


def test_control_round_trip_keeps_names_and_units() -> None:
    model = plant()
    system = model.to_control()
    assert system.input_labels == ["w[0]", "w[1]", "u"]
    again = System.from_control(system, {"w": "N", "u": "N", "z": "rad", "y": "m"})
    assert again.inputs == model.inputs and again.outputs == model.outputs
    assert all(np.array_equal(a, b) for a, b in zip(model.matrices, again.matrices))


def test_channel_picks_by_name_in_the_order_asked_for() -> None:
    part = plant()["y", ("u", "w")]
    assert [p.name for p in part.inputs] == ["u", "w"]
    whole, w = plant(), 0.7
    expected = direct_response(*whole.matrices, w)[1:][:, [2, 0, 1]]
    assert direct_response(*part.matrices, w) == pytest.approx(expected)


def test_arrays_are_read_only() -> None:
    with pytest.raises(ValueError, match="read-only"):
        plant().A[0, 0] = 1.0


@pytest.mark.parametrize("s", [0.0, 0.3j, 2.0j])
def test_transfer_and_series_are_products(s: complex) -> None:
    first, second = transfer([1, 2, 3], [2, 4, 8]), transfer([1, 0], [1, 5])
    value = (s**2 + 2 * s + 3) / (2 * s**2 + 4 * s + 8) * s / (s + 5)
    assert direct_response(*cascade(first, second).matrices, s.imag).item() == pytest.approx(value)


def test_tustin_keeps_stability_and_the_gain_at_zero() -> None:
    system = sampled(plant(), 1e-2)
    assert np.abs(np.linalg.eigvals(system.A)).max() < 1
    dc = system.C @ np.linalg.solve(np.eye(4) - system.A, system.B) + system.D
    assert dc == pytest.approx(direct_response(*plant().matrices, 0.0).real)


def test_pid_response() -> None:
    K = pid("e", "u", derivative_filter=0.1)
    n, x = K.order, np.array([2.0, 3.0, 0.5])
    M = K.gain_matrix(x)
    s = 1.5j
    value = M[n:, n:] + M[n:, :n] @ np.linalg.solve(s * np.eye(n) - M[:n, :n], M[:n, n:])
    assert value.item() == pytest.approx(2.0 + 3.0 / s + 0.5 * s / (0.1 * s + 1))
    only_d = pid("e", "u", derivative_filter=0.1, terms="D")
    assert (only_d.order, only_d.size) == (1, 1)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: plant()["y", "x"], "p: input port must be one of w, u, got 'x'"),
        (lambda: System.static([[1.0, 2.0]], [("a", 1), ("a", 1)], [("b", 1)]), "port names must be unique"),
        (
            lambda: System.static([[1.0, 2.0]], [("a", 1)], [("b", 1)]),
            "matrix D must be 1 x 1 to fit states and ports, got 1 x 2",
        ),
        (lambda: transfer([1, 0, 0], [1, 1]), "proper transfer function"),
        (lambda: close_loop(plant(), System.static([[1.0]], [("z", 1)], [("w", 1)]), ["u"], ["y"]), "need 2 x 1"),
        (lambda: HinfGain((), "z"), "at least one port"),
        (lambda: HinfGain("w", "z", bound=0.0), "bound of a gain requirement must be positive"),
        (lambda: HinfGain("w", "z", weight_out=transfer([1], [1, 0])), "must be stable"),
        (lambda: ClosedLoopPoles(), "needs min_decay, min_damping or max_frequency"),
        (lambda: state_space([("y", 1)], [("u", 1)], 2, form="jordan"), "form must be one of"),
        (lambda: state_space([("y", 1)], [("u", 1)], 2).with_fixed({(9, 0): 1.0}), "outside the 3 x 3 gain matrix"),
    ],
)
def test_mistakes_raise(make: object, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        make()  # type: ignore[operator]
