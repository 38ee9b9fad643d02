"""Sampled systems: parity with plain simulation, files, refusals."""

from __future__ import annotations

import json
import tracemalloc
from pathlib import Path

import numpy as np
import pytest
from scipy import signal

from lftkit import Port, SampledSystem, state_space
from lftkit.systems.connection.filters import high_pass, with_input_filter

PORTS = (Port("u", 2),), (Port("y", 1),)


def example() -> SampledSystem:
    rng = np.random.default_rng(0)
    A = 0.4 * rng.standard_normal((5, 5))
    return SampledSystem(A, rng.standard_normal((5, 2)), rng.standard_normal((1, 5)), [[0.3, -1.0]], *PORTS, 1e-3)


def test_step_equals_dlsim_and_reset_repeats_it() -> None:
    k, u = example(), np.random.default_rng(1).standard_normal((200, 2))
    _, expected, _ = signal.dlsim((k.A, k.B, k.C, k.D, k.dt), u)
    runs = []
    for _ in range(2):
        k.reset()
        y = np.zeros((200, 1))
        for i in range(200):
            k.step(u[i], y[i])
        runs.append(y)
    np.testing.assert_allclose(runs[0], expected, rtol=1e-10, atol=1e-12)
    assert runs[0].tobytes() == runs[1].tobytes()


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


def test_the_earlier_name_of_the_format_is_read(tmp_path: Path) -> None:
    path = tmp_path / "k.json"
    example().to_file(path)
    content = json.loads(path.read_text())
    assert content["format"] == "lftkit/sampled-system"
    path.write_text(json.dumps({**content, "format": "los-testbed/sampled-system"}))
    assert SampledSystem.from_file(path).to_json() == example().to_json()


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
