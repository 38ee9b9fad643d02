"""Conversions from and to python-control: every signal reaches its port, the period is kept or refused."""

from __future__ import annotations

from itertools import permutations

import control
import numpy as np
import pytest

from lftkit import Port, SampledSystem, System, from_control, static_gain
from lftkit.systems.signal_labels import order_for_ports, ports_of_labels

LABELS = ("w[0]", "w[1]", "w[2]", "v", "q[0]", "q[1]")
COLUMN = dict(zip(LABELS, (1.0, 2.0, 3.0, 4.0, 5.0, 6.0)))
ORDERS = list(permutations(LABELS))[::29]


def system(inputs: tuple[str, ...], outputs: tuple[str, ...], dt: float | bool | None = 0) -> control.StateSpace:
    """Pole 0.5 - 1 or 0.5; B, C and D tell which label a column or row has."""
    b, c = np.array([COLUMN[name] for name in inputs]), np.array([COLUMN[name] for name in outputs])
    pole = [[0.5 if dt else -0.5]]
    return control.ss(pole, b[None], 10 * c[:, None], c[:, None] + 100 * b, dt, inputs=inputs, outputs=outputs)


def check(made: System | SampledSystem | System) -> None:
    """Each signal of each port has the column and row of its label."""
    b = [COLUMN[label] for port in made.inputs for label in port.signals]
    c = np.array([COLUMN[label] for port in made.outputs for label in port.signals])
    assert {(p.name, p.size) for p in made.inputs} == {("w", 3), ("v", 1), ("q", 2)}
    np.testing.assert_array_equal(made.B, [b])
    np.testing.assert_array_equal(made.C, 10 * c[:, None])
    np.testing.assert_array_equal(made.D, c[:, None] + 100 * np.array(b))


@pytest.mark.parametrize("labels", ORDERS[:25])
def test_labels_in_any_order_reach_their_ports(labels: tuple[str, ...]) -> None:
    check(System.from_control(system(labels, labels[::-1])))
    check(from_control(system(labels, labels[::-1])))
    sampled = SampledSystem.from_control(system(labels, labels[::-1], 0.25))
    check(sampled)
    assert sampled.dt == 0.25
    again = SampledSystem.from_control(sampled.to_control())
    assert (again.inputs, again.outputs, again.dt) == (sampled.inputs, sampled.outputs, 0.25)
    assert all(np.array_equal(getattr(sampled, key), getattr(again, key)) for key in "ABCD")


def test_ports_that_are_given_take_the_signals_of_their_names() -> None:
    given = [Port("q", 2, "N"), Port("w", 3), Port("v", 1)]
    made = from_control(system(LABELS[::-1], LABELS), given, given)
    check(made)
    assert made.inputs == tuple(given)
    assert made.B.tolist() == [[5.0, 6.0, 1.0, 2.0, 3.0, 4.0]]


def test_ports_of_new_names_go_by_position_and_a_mixture_is_refused() -> None:
    plant = system(LABELS[:3], LABELS[3:])
    made = from_control(plant, [Port("force", 2), Port("torque", 1)], [Port("y", 3)])
    np.testing.assert_array_equal(made.B, plant.B)
    with pytest.raises(ValueError, match=r"input ports must have the signals w\[0\], w\[1\], w\[2\], got 'v'"):
        from_control(plant, [Port("w", 2), Port("v", 1)])
    with pytest.raises(ValueError, match="input ports must have 3 signals in all, got 2"):
        from_control(plant, [Port("w", 2)])
    assert order_for_ports(["u[0]"], [Port("u", 1)]).tolist() == [0]


@pytest.mark.parametrize(
    ("labels", "message"),
    [
        (["w[0]", "v", "w[2]"], r"labels of port 'w' must have the indices 0 to 1, got 0, 2"),
        (["w[1]", "w[2]"], r"labels of port 'w' must have the indices 0 to 1, got 1, 2"),
        (["w[1]"], r"labels of port 'w' must have the indices 0 to 0, got 1"),
        (["w", "w[0]"], r"must name one signal each, got 'w' and 'w\[0\]' for port 'w'"),
        (["w[1]", "w"], r"must name one signal each, got 'w\[1\]' and 'w' for port 'w'"),
        (["w", "w[1]"], r"must name one signal each, got 'w' and 'w\[1\]' for port 'w'"),
        (["w[0]", "v", "w[0]"], r"must name one signal each"),
        (["w", "w"], "must name one signal each"),
    ],
)
def test_doubtful_labels_are_refused(labels: list[str], message: str) -> None:
    with pytest.raises(ValueError, match=message) as caught:
        ports_of_labels(labels)
    assert "\n" not in str(caught.value)
    plant = control.ss([[-1.0]], np.ones((1, len(labels))), [[1.0]], np.zeros((1, len(labels))), inputs=labels)
    for convert in (System.from_control, from_control):
        with pytest.raises(ValueError, match="input labels"):
            convert(plant)


def test_transfer_matrices_keep_their_response_labels_and_period() -> None:
    entries = [[[1.0, 3.0], [2.0]], [[1.0], [4.0, 0.0, 1.0]]]
    under = [[[1.0, 2.0], [5.0]], [[1.0, 0.5, 0.25], [1.0, 1.0, 3.0]]]
    for dt in (0, 0.5):
        theirs = control.tf(entries, under, dt, inputs=["w[1]", "w[0]"], outputs=["y", "z"])
        ours, point = from_control(theirs), 0.3 + 0.7j
        assert ours.dt == dt and [(p.name, p.size) for p in ours.inputs] == [("w", 2)]
        np.testing.assert_allclose(ours(point), theirs(point)[:, ::-1], rtol=1e-13)
    with pytest.raises(ValueError, match="transfer function must be proper"):
        from_control(control.tf([1, 0, 0], [1, 1]))


def test_a_continuous_model_stays_one_whatever_the_default_of_control(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(control.config.defaults, "control.default_dt", 0.1)
    monkeypatch.setitem(control.config.defaults, "statesp.remove_useless_states", True)
    model = System([[-1.0, 0.0], [0.0, 0.0]], [[1.0], [0.0]], [[1.0, 0.0]], [[0.0]], [("u", 1)], [("y", 1)])
    assert model.to_control().dt == 0 and model.to_control().nstates == 2
    assert static_gain([[2.0]], [Port("u", 1)], [Port("y", 1)]).to_control().dt is None
