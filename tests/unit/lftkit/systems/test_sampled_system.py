"""Sampled systems: the bits of sums from left to right, files, inputs, refusals."""

from __future__ import annotations

import copy
import json
import pickle
import tracemalloc
from pathlib import Path

import numpy as np
import pytest

from lftkit import Port, SampledSystem, state_space
from lftkit.systems.connection.filters import high_pass, with_input_filter
from lftkit.systems.sampled.ordered_product import OrderedProduct

PORTS = (Port("u", 2),), (Port("y", 1),)


def example() -> SampledSystem:
    rng = np.random.default_rng(0)
    A = 0.4 * rng.standard_normal((5, 5))
    return SampledSystem(A, rng.standard_normal((5, 2)), rng.standard_normal((1, 5)), [[0.3, -1.0]], *PORTS, 1e-3)


def test_step_keeps_no_memory() -> None:
    k, u, y = example(), np.ones(2), np.zeros(1)
    k.step(u, y)
    tracemalloc.start()
    before = tracemalloc.get_traced_memory()[0]
    for _ in range(1000):
        k.step(u, y)
    grown = tracemalloc.get_traced_memory()[0] - before
    tracemalloc.stop()
    assert grown < 500


def test_file_round_trip_is_exact(tmp_path: Path) -> None:
    k = example()
    k.to_file(tmp_path / "k.json")
    again = SampledSystem.from_file(tmp_path / "k.json")
    for key in "ABCD":
        np.testing.assert_array_equal(getattr(again, key), getattr(k, key))
    assert again.inputs == k.inputs and again.dt == k.dt
    assert [p.name for p in tmp_path.iterdir()] == ["k.json"]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"format": "x"}, 'expected JSON with "format"'),
        ({"version": 7}, "expected version 1, got 7"),
        ({"A": [[float("nan")] * 5] * 5}, r"matrix A must be finite, got nan in entry \[0, 0\]"),
        ({"B": [[1.0]]}, "matrix B must be 5 x 2"),
        ({"C": [[1.0], [1.0, 2.0]]}, "matrix C must be a rectangular array"),
        ({"dt": -1.0}, "sampling period must be positive"),
        ({"dt": "0.001"}, "sampling period must be positive, got '0.001'"),
        ({"delay": 5}, "keys must be among .*, got 'delay'"),
        ({"inputs": ["u"]}, "expected ports as objects"),
    ],
)
def test_bad_files_say_what_is_wrong(tmp_path: Path, change: dict, message: str) -> None:
    path = tmp_path / "k.json"
    example().to_file(path)
    path.write_text(json.dumps({**json.loads(path.read_text()), **change}))
    with pytest.raises(ValueError, match=message) as caught:
        SampledSystem.from_file(path)
    assert "\n" not in str(caught.value)


def test_not_a_file_and_not_json(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="cannot read the controller file"):
        SampledSystem.from_file(tmp_path / "none.json")
    (tmp_path / "x.json").write_text("hello")
    with pytest.raises(ValueError, match="is not a controller file: it must be JSON"):
        SampledSystem.from_file(tmp_path / "x.json")
    (tmp_path / "y.json").write_text("{}")
    with pytest.raises(ValueError, match="is not a controller file"):
        SampledSystem.from_file(tmp_path / "y.json")


def test_washout_takes_away_a_bias_and_nothing_else() -> None:
    port = Port("a", 2, "m/s2")
    integrator = state_space([[-1.0]], [[1.0, 1.0]], [[1.0]], [[0.0, 0.0]], [port], [Port("y", 1)])
    both = with_input_filter(integrator, {"a": high_pass(port, 0.1)}).nominal()
    assert abs(both(0)[0, 0]) < 1e-15
    assert abs(both(50j)[0, 0] / integrator.nominal()(50j)[0, 0]) == pytest.approx(1.0, abs=1e-5)


def test_inputs_that_a_system_does_not_have_do_nothing() -> None:
    rng = np.random.default_rng(3)
    a, b, c = Port("a", 2), Port("b", 1), Port("c", 3)
    K = SampledSystem(
        *(rng.standard_normal(s) for s in ((4, 4), (4, 5), (2, 4), (2, 5))), (a, c), (Port("y", 2),), 1e-3
    )
    wide = K.with_inputs((b, a, c))
    assert [p.name for p in wide.inputs] == ["b", "a", "c"] and wide.A.tobytes() == K.A.tobytes()
    for narrow, whole in ((K.B, wide.B), (K.D, wide.D)):
        assert np.array_equal(whole[:, 1:], narrow) and not whole[:, :1].any()
    assert K.with_inputs((a, c)) is K  # nothing to add
    for other in ((a, b), (Port("a", 3), b, c)):  # an input of its own is missing, or has another size
        assert K.with_inputs(other) is K


def test_a_port_in_another_unit_is_refused() -> None:
    """Also where inputs are to be sorted; a unit that is not stated is that of the loop."""
    accel, angle, los = Port("accel", 2, "m/s2,rad/s2"), Port("angle", 1, "rad"), Port("los", 1, "rad")

    def law(inputs: tuple[Port, ...], output: Port) -> SampledSystem:
        return SampledSystem([], [], [], np.ones((1, 3)), inputs, (output,), 1e-3)

    law((Port("accel", 2), angle), Port("los", 1)).require((accel, angle), (los,), 1e-3)
    with pytest.raises(ValueError, match="output los must be in rad, got mas"):
        law((accel, angle), Port("los", 1, "mas")).require((accel, angle), (los,), 1e-3)
    other = law((angle, Port("accel", 2, "g")), los)
    with pytest.raises(ValueError, match="input accel must be in m/s2,rad/s2, got g"):
        other.with_inputs((accel, angle)).require((accel, angle), (los,), 1e-3)


@pytest.mark.parametrize(
    "shape", [(1, 1), (1, 300), (2, 300), (3, 17), (24, 322), (232, 226), (7, 0), (0, 5), (129, 9)]
)
def test_every_row_is_added_up_from_left_to_right(shape: tuple[int, int]) -> None:
    rng = np.random.default_rng(shape[1])
    matrix = rng.standard_normal(shape) * 10.0 ** rng.uniform(-8, 8, shape)
    product = OrderedProduct(matrix)
    product.values[:] = rng.standard_normal(shape[1])
    expected = []
    for row in matrix.tolist():
        total = 0.0
        for k, (factor, value) in enumerate(zip(row, product.values.tolist())):
            total = factor * value if k == 0 else total + factor * value
        expected.append(total)
    assert product().tobytes() == np.array(expected).tobytes()


def test_a_sampled_system_steps_in_this_order_also_as_a_copy() -> None:
    rng = np.random.default_rng(5)
    A, B, C, D = (rng.standard_normal(shape) for shape in ((3, 3), (3, 4), (2, 3), (2, 4)))
    k = SampledSystem(0.3 * A, B, C, D, (Port("u", 4),), (Port("y", 2),), 1e-3)
    inputs = rng.standard_normal((50, 4))

    def plain() -> list[list[float]]:
        x, found = [0.0] * 3, []
        rows = np.block([[k.A, k.B], [k.C, k.D]]).tolist()
        for u in inputs.tolist():
            sums = []
            for row in rows:
                total = row[0] * x[0]
                for factor, value in zip(row[1:], [*x[1:], *u]):
                    total += factor * value
                sums.append(total)
            x = sums[:3]
            found.append(sums[3:])
        return found

    for one in (k, copy.deepcopy(k), pickle.loads(pickle.dumps(k))):
        for _ in range(2):
            one.reset()
            out, y = [], np.zeros(2)
            for u in inputs:
                one.step(u, y)
                out.append(y.tolist())
            assert out == plain()
