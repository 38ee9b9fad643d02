"""Laws of linear fractional transformations, for random systems and parameter values."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from dataclasses import fields
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import linalg
from scipy.spatial.transform import Rotation
from support.normalised import normalised_value

import lftkit as us
from lftkit import Port, RealParameter, System
from lftkit.systems import minimal
from lftkit.systems import system as system_module
from lftkit.systems.connection import filters, interconnection
from titop_plant.blocks.flexible_body import flexible_body
from titop_plant.blocks.rotation import rotation
from titop_plant.structures.modal_data import ChildPort, ModalData, from_inertia

S = 0.3 + 1.7j
"""Where transfer matrices are compared."""

seeds = st.integers(0, 2**32 - 1)
inside = st.floats(-1.0, 1.0)
K, M = RealParameter("k", 0.5, 0.2, 1.4, "N/m"), RealParameter("m", 0.5, 0.2, 1.4, "kg")


def random_system(
    seed: int, inputs: dict[str, int], outputs: dict[str, int], channels: tuple[str, ...] = ("k", "k", "m")
) -> System:
    """Random LFT that is well posed for all k and m in their ranges: the Delta loop has a small gain."""
    rng = np.random.default_rng(seed)
    q, n = len(channels), int(rng.integers(1, 5))
    m, p = q + sum(inputs.values()), q + sum(outputs.values())
    A = rng.standard_normal((n, n)) - 4.0 * np.eye(n)
    D = 0.3 * rng.standard_normal((p, m))
    if q:
        D[:q, :q] *= 0.5 / max(0.5, float(linalg.norm(D[:q, :q], 2)))
    ins, outs = ([Port(name, size) for name, size in ports.items()] for ports in (inputs, outputs))
    table = {"k": K, "m": M}
    used = tuple(table[name] for name in dict.fromkeys(channels))
    return System(
        A,
        rng.standard_normal((n, m)),
        rng.standard_normal((p, n)),
        D,
        tuple(ins),
        tuple(outs),
        channels=channels,
        elements=used,
    )


def transfer(system: System, values: dict[str, float]) -> np.ndarray:
    chosen = {name: value for name, value in values.items() if name in system.occurrences()}
    data = system.at(chosen)
    return np.asarray(data.C @ linalg.solve(S * np.eye(len(data.A)) - data.A, data.B.astype(complex)) + data.D)


def point(nu_k: float, nu_m: float) -> dict[str, float]:
    return {"k": K.from_normalised(nu_k), "m": M.from_normalised(nu_m)}


def close_to(one: np.ndarray, two: np.ndarray, tolerance: float = 1e-9) -> None:
    assert one.shape == two.shape
    assert np.abs(one - two).max(initial=0.0) <= tolerance * max(1.0, float(np.abs(two).max(initial=0.0)))


@given(seeds)
@settings(max_examples=10, deadline=None)
def test_delta_zero_is_the_nominal_system_to_the_last_bit(seed: int) -> None:
    system = random_system(seed, {"u": 2}, {"y": 2, "z": 1})
    q = len(system.channels)
    for data in (system.at({}), system.at({"k": 0.5, "m": 0.5})):
        np.testing.assert_array_equal(data.A, system.A)
        np.testing.assert_array_equal(data.B, system.B[:, q:])
        np.testing.assert_array_equal(data.C, system.C[q:])
        np.testing.assert_array_equal(data.D, system.D[q:, q:])


@given(seeds, inside, inside)
@settings(max_examples=10, deadline=None)
def test_a_member_is_the_upper_lft_of_its_delta(seed: int, nu_k: float, nu_m: float) -> None:
    """M22 + M21 Delta (1 - M11 Delta)^-1 M12, the transfer matrices taken first."""
    system = random_system(seed, {"u": 2}, {"y": 1})
    values, q = point(nu_k, nu_m), len(system.channels)
    whole = system.C @ linalg.solve(S * np.eye(system.order) - system.A, system.B.astype(complex)) + system.D
    delta = np.diag([values[c] - 0.5 for c in system.channels])
    M11, M12, M21, M22 = whole[:q, :q], whole[:q, q:], whole[q:, :q], whole[q:, q:]
    close_to(transfer(system, values), M22 + M21 @ delta @ linalg.solve(np.eye(q) - M11 @ delta, M12))


@given(inside, st.floats(0.02, 0.9), st.floats(0.5, 20.0))
@settings(max_examples=13, deadline=None)
def test_sampled_equals_rebuilt_flexible_body(nu: float, zeta: float, nominal: float) -> None:
    """Frequency and damping of a mode as parameters, or as numbers in the modal data."""
    mass = from_inertia(5.0, np.eye(3), [0.1, 0.0, -0.2])
    L = np.array([[0.8, 0.0, 0.3, 0.1, 0.0, 0.2], [0.0, 0.5, 0.0, 0.0, 0.4, 0.1]])
    tip = ChildPort("C", [1.0, 0.0, 0.5], 0.3 * L.T)
    w = RealParameter("w", nominal, 0.5 * nominal, 1.2 * nominal)
    z = RealParameter("z", 0.1, 0.01, 0.95)
    value = w.from_normalised(nu)

    def body(frequency: float, damping: float) -> ModalData:
        return ModalData("b", "P", np.zeros(3), mass, [frequency, 30.0], [damping, 0.02], L, (tip,))

    family = flexible_body(body(nominal, 0.1), frequencies={0: w}, dampings={0: z})
    sampled, rebuilt = family.at({"w": value, "z": zeta}), flexible_body(body(value, zeta)).at({})
    for key in "ABCD":
        close_to(getattr(sampled, key), getattr(rebuilt, key), 1e-12)
    assert family.occurrences() == {"w": 2, "z": 1}


@given(st.floats(-3.1, 3.1), st.floats(-1.5, 1.5), st.tuples(inside, inside, st.floats(0.1, 1.0)))
@settings(max_examples=29, deadline=None)
def test_sampled_equals_rebuilt_rotation(tau: float, nominal: float, axis: tuple[float, float, float]) -> None:
    """Whatever the nominal angle: Rodrigues' formula at theta = 4 atan(tau), and backwards."""
    angle = RealParameter("tau", nominal, -4.0, 4.0)
    family, back = rotation(axis, angle, Port("v", 6)), rotation(axis, angle, sign=-1.0)
    R = Rotation.from_rotvec(4.0 * np.arctan(tau) * np.asarray(axis) / linalg.norm(axis)).as_matrix()
    close_to(family.at({"tau": tau}).D, linalg.block_diag(R, R), 1e-12)
    close_to(back.at({"tau": tau}).D, R.T, 1e-12)
    assert family.occurrences() == {"tau": 8} and back.occurrences() == {"tau": 4}


@given(seeds, inside, inside)
@settings(max_examples=10, deadline=None)
def test_upper_and_lower_lft_in_either_order(seed: int, nu_k: float, nu_m: float) -> None:
    """Choose the parameters and close the controller, or close the controller and choose the parameters."""
    values = point(nu_k, nu_m)
    plant = random_system(seed, {"w": 1, "u": 2}, {"z": 1, "y": 2})
    controller = random_system(seed + 1, {"y": 2}, {"u": 2}, ("m",))
    small = us.transform(controller, outputs={"u": (0.05 * np.eye(2), Port("u", 2))})
    loop = us.close(plant, small, {"y": "y", "u": "u"})
    P, C = transfer(plant, values), transfer(small, values)
    expected = P[:1, :1] + P[:1, 1:] @ C @ linalg.solve(np.eye(2) - P[1:, 1:] @ C, P[1:, :1])
    close_to(transfer(loop, values), expected)
    assert loop.occurrences() == {"k": 2, "m": 2}


@given(seeds, inside, inside)
@settings(max_examples=8, deadline=None)
def test_the_star_product_is_associative(seed: int, nu_k: float, nu_m: float) -> None:
    values = point(nu_k, nu_m)
    a = random_system(seed, {"r": 1, "ba": 1}, {"e": 1, "ab": 1}, ("k",))
    b = random_system(seed + 1, {"ab": 1, "cb": 1}, {"ba": 1, "bc": 1}, ("m",))
    c = random_system(seed + 2, {"bc": 1, "d": 1}, {"cb": 1, "f": 1}, ("k",))
    quiet = [us.transform(s, outputs={p.name: (0.1 * np.eye(1), p) for p in s.outputs}) for s in (a, b, c)]
    a, b, c = quiet
    ab, bc = {"upper.ab": "lower.ab", "lower.ba": "upper.ba"}, {"upper.bc": "lower.bc", "lower.cb": "upper.cb"}
    left = us.star(us.star(a, b, ab), c, bc)
    right = us.star(a, us.star(b, c, bc), ab)
    pick = (("e", "f"), ("r", "d"))
    close_to(transfer(left[pick], values), transfer(right[pick], values))


@given(seeds, seeds, inside, inside)
@settings(max_examples=8, deadline=None)
def test_the_same_name_moves_together(one: int, two: int, nu_k: float, nu_m: float) -> None:
    values = point(nu_k, nu_m)
    a, b = (random_system(seed, {"u": 2}, {"y": 2}) for seed in (one, two))
    both = us.parallel(a, b, -1.0)
    close_to(transfer(both, values), transfer(a, values) - transfer(b, values))
    assert both.occurrences() == {"k": 4, "m": 2} and len(both.parameters) == 2
    apart = us.parallel(a, b.renamed(elements={"k": "k2"}))
    close_to(transfer(apart, {**values, "k2": 0.9}), transfer(a, values) + transfer(b, {**values, "k": 0.9}))


@given(seeds, inside, inside)
@settings(max_examples=8, deadline=None)
def test_normalised_family_is_the_same_family(seed: int, nu_k: float, nu_m: float) -> None:
    system = random_system(seed, {"u": 1}, {"y": 2})
    unit = system.normalised()
    assert all((p.lower, p.nominal, p.upper) == (-1.0, 0.0, 1.0) for p in unit.parameters)
    close_to(transfer(unit, {"k": nu_k, "m": nu_m}), transfer(system, point(nu_k, nu_m)))


Operation = Callable[[System], System]
WIRES = [("u", "s.u"), ("w", "s.w")]
OPERATIONS: dict[str, Operation] = {
    "connect": lambda s: us.connect({"s": s}, WIRES, inputs=s.inputs, outputs={"y": "s.y", "z": "s.z"}),
    "series": lambda s: us.series(s, us.static_gain(np.eye(3), s.outputs, s.outputs), {"y": "y", "z": "z"}),
    "parallel": lambda s: us.parallel(s, us.static_gain(np.zeros((3, 3)), s.inputs, s.outputs)),
    "star": lambda s: us.star(
        us.static_gain(np.eye(2), [Port("u", 2, "N")], [Port("v", 2, "N")]), s, {"upper.v": "lower.u"}
    ),
    "close": lambda s: us.close(
        us.connect(
            {"s": s},
            [(("u", "c"), "s.u"), ("w", "s.w")],
            inputs=[*s.inputs, Port("c", 2, "N")],
            outputs={"y": "s.y", "z": "s.z", "seen": "s.y"},
        ),
        us.static_gain(np.zeros((2, 2)), [Port("seen", 2, "m")], [Port("c", 2, "N")]),
        {"seen": "seen", "c": "c"},
    ),
    "transform": lambda s: us.transform(s, inputs={"u": (np.eye(2), s.inputs[0])}),
    "invert": lambda s: us.invert(us.invert(s, {"w": "z"}), {"z": "w"}).select(inputs=["u", "w"], outputs=["y", "z"]),
    "select": lambda s: s.select(inputs=["u", "w"], outputs=["y", "z"]),
    "__getitem__": lambda s: s[("y", "z"), ("u", "w")],
    "renamed": lambda s: s.renamed({"u": "v"}, {"k": "c"}).renamed({"v": "u"}, {"c": "k"}),
    "sorted_channels": lambda s: s.sorted_channels(["m", "k"]),
    "substituted": lambda s: s.substituted({}),
    "normalised": lambda s: s.normalised(),
    "minimal_realisation": lambda s: minimal.minimal_realisation(s).system,
    "named": lambda s: s.named("other"),
    "with_lft": lambda s: s.with_lft(s.lft),
    "inverse": lambda s: s.inverse().inverse(),
    "append": lambda s: interconnection.append(s),
    "feedback": lambda s: us.feedback(s, us.static_gain(np.zeros((3, 3)), s.outputs, s.inputs)),
    "with_input_filter": lambda s: filters.with_input_filter(
        s, {"w": us.static_gain(np.eye(1), s.inputs[1:], s.inputs[1:])}
    ),
}
MAKERS = {"static_gain", "state_space", "from_control", "high_pass", "transfer", "as_system", "at", "nominal", "sample"}
"""Functions that make a system from something that has no names, or a member of an uncertain one."""


def test_the_table_holds_every_operation() -> None:
    """Whoever adds an operation adds it to the table."""
    found = set()
    for holder in (interconnection, system_module, minimal, filters, System):
        for name, function in inspect.getmembers(holder, inspect.isfunction):
            returns = str(inspect.signature(function).return_annotation)
            if "System" in returns or returns in ("S", minimal.Reduction.__name__):
                found.add(name)
    assert {name for name in found - MAKERS if not name.startswith("_") or name == "__getitem__"} == set(OPERATIONS)


@pytest.mark.parametrize("name", OPERATIONS)
def test_every_operation_keeps_names_units_parameters_and_values(name: str) -> None:
    plain = random_system(12, {"u": 2, "w": 1}, {"y": 2, "z": 1})
    ports = {"inputs": (Port("u", 2, "N"), Port("w", 1, "Nm")), "outputs": (Port("y", 2, "m"), Port("z", 1, "rad"))}
    kept: dict[str, Any] = {f.name: getattr(plain, f.name) for f in fields(plain)}
    system = System(**{**kept, **ports})
    result = OPERATIONS[name](system)
    assert {(p.name, p.size, p.unit) for p in result.inputs} == {("u", 2, "N"), ("w", 1, "Nm")}
    assert {(p.name, p.size, p.unit) for p in result.outputs} == {("y", 2, "m"), ("z", 1, "rad")}
    assert result.occurrences() == {"k": 2, "m": 1}
    values = {"k": 0.9, "m": 0.3}
    at = values if name != "normalised" else {n: normalised_value(system.parameter(n), v) for n, v in values.items()}
    order = result.select(inputs=["u", "w"], outputs=["y", "z"])
    close_to(transfer(order, at), transfer(system, values))
    if name != "normalised":
        assert {p.name: (p.lower, p.upper, p.unit) for p in result.parameters} == {
            "k": (0.2, 1.4, "N/m"),
            "m": (0.2, 1.4, "kg"),
        }
    assert result.nominal().to_control().input_labels == [s for p in result.inputs for s in p.signals]
