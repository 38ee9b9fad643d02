"""Connections by name; laws of the operations are in ``tests/properties/test_lft_laws.py``."""

from __future__ import annotations

import numpy as np
import pytest

from lftkit import Port, connect, invert, series, static_gain, transform

S = 1.3j
POINT = {"k": 0.9, "m": 0.3}


def response(system, s=S):
    return system.at({n: POINT[n] for n in system.occurrences()})(s)


def test_any_wiring_equals_its_matrices(make) -> None:
    """Three systems with ports of several sizes, sums and signs: z = So y + Eo r with y = G (S y + E r)."""
    rng = np.random.default_rng(13)
    a = make(rng, 3, {"u": 2, "v": 1}, {"y": 2, "q": 1}, ("k", "m"))
    b = make(rng, 2, {"u": 2}, {"y": 2}, ("m",))
    c = make(rng, 0, {"u": 1}, {"y": 1}, ())
    whole = connect(
        {"a": a, "b": b, "c": c},
        [(("r", "-b.y"), "a.u"), (("-c.y", "t"), "a.v"), (("a.y", "r", "-b.y"), "b.u"), ("-a.q", "c.u")],
        inputs=[Port("r", 2), Port("t", 1)],
        outputs={"e": ("r", "-a.y"), "q": "a.q", "w": ("c.y", "t", "-a.q")},
    )
    G = np.zeros((6, 6), complex)
    G[:3, :3], G[3:5, 3:5], G[5:, 5:] = response(a), response(b), response(c)
    S, E = np.zeros((6, 6)), np.zeros((6, 3))
    S[:2, 3:5], E[:2, :2] = -np.eye(2), np.eye(2)
    S[2, 5], E[2, 2] = -1.0, 1.0
    S[3:5, :2], S[3:5, 3:5], E[3:5, :2] = np.eye(2), -np.eye(2), np.eye(2)
    S[5, 2] = -1.0
    So, Eo = np.zeros((4, 6)), np.zeros((4, 3))
    So[:2, :2], Eo[:2, :2] = -np.eye(2), np.eye(2)
    So[2, 2] = 1.0
    So[3, 5], Eo[3, 2], So[3, 2] = 1.0, 1.0, -1.0
    y = np.linalg.solve(np.eye(6) - G @ S, G @ E)
    np.testing.assert_allclose(response(whole), So @ y + Eo, rtol=1e-11, atol=1e-12)
    assert whole.occurrences() == {"k": 1, "m": 2} and whole.order == 5
    assert [(p.name, p.size) for p in whole.outputs] == [("e", 2), ("q", 1), ("w", 1)]


def test_inverting_some_channels_solves_for_their_inputs(make) -> None:
    """Two channels of different size, their ports in another order than in the system, a third one kept."""
    system = make(np.random.default_rng(16), 3, {"a": 1, "b": 2, "c": 1}, {"p": 2, "q": 1, "r": 1}, ("k", "m", "k"))
    turned = invert(system, {"b": "p", "a": "r"})
    assert [p.name for p in turned.inputs] == ["r", "p", "c"] and [p.name for p in turned.outputs] == ["b", "q", "a"]
    rng = np.random.default_rng(17)
    u = rng.standard_normal(4)
    y = response(system) @ u
    result = response(turned) @ np.r_[y[3], y[:2], u[3]]
    np.testing.assert_allclose(result, np.r_[u[1:3], y[2], u[0]], rtol=1e-10, atol=1e-12)
    assert turned.occurrences() == system.occurrences()


def test_transform_of_one_port_leaves_the_others_where_they_are(make) -> None:
    system = make(np.random.default_rng(19), 2, {"u": 2, "w": 1}, {"y": 2, "z": 1}, ("k", "m"))
    T, R = np.array([[1.0], [-2.0]]), np.array([[0.5, 3.0]])
    changed = transform(system, inputs={"u": (T, Port("n", 1))}, outputs={"y": (R, Port("s", 1))})
    H = response(system)
    left, right = np.zeros((2, 3)), np.zeros((3, 2))
    left[0, :2], left[1, 2] = R, 1.0
    right[:2, 0], right[2, 1] = T[:, 0], 1.0
    np.testing.assert_allclose(response(changed), left @ H @ right, rtol=1e-12)
    n, s = Port("n", 1), Port("s", 1)
    for side, wrong in (("inputs", {"u": (T.T, n), "x": (T, n)}), ("outputs", {"y": (R.T, s), "x": (R, s)})):
        for name, change in wrong.items():
            with pytest.raises(ValueError):
                transform(system, **{side: {name: change}})


def test_series_keeps_the_ports_of_its_ends(make) -> None:
    rng = np.random.default_rng(21)
    a = make(rng, 2, {"u": 2, "w": 1}, {"v": 1, "x": 2}, ("k",))
    b = make(rng, 1, {"p": 2, "q": 1}, {"y": 2}, ("m",))
    chain = series(a, b, {"x": "p", "v": "q"})
    swap = np.eye(3)[[1, 2, 0]]
    np.testing.assert_allclose(response(chain), response(b) @ swap @ response(a), rtol=1e-11)
    assert [p.name for p in chain.inputs] == ["u", "w"] and [p.name for p in chain.outputs] == ["y"]


def test_external_inputs_may_be_pairs_of_name_and_size() -> None:
    gain = static_gain([[2.0, 1.0]], [Port("a", 2)], [Port("b", 1)])
    made = connect({"g": gain}, [("r", "g.a")], inputs=[("r", 2)], outputs={"b": "g.b"})
    assert made.inputs == (Port("r", 2),) and made.D.tolist() == [[2.0, 1.0]]
    with pytest.raises(ValueError, match="connect, inputs: a port must be a Port"):
        connect({"g": gain}, [("r", "g.a")], inputs=["r"], outputs={"b": "g.b"})  # type: ignore[list-item]
