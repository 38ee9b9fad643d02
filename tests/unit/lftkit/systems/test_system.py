"""The uncertain system itself: values, names, refusals."""

from __future__ import annotations

import numpy as np
import pytest

from lftkit import Port, RealParameter, System, from_control, state_space, static_gain


def gain(k: RealParameter) -> System:
    """y = k u."""
    empty = np.zeros((0, 0))
    D = [[0.0, 1.0], [1.0, k.nominal]]
    return System(empty, empty, empty, D, (Port("u", 1),), (Port("y", 1),), channels=(k.name,), elements=(k,))


def test_delta_zero_is_nominal_and_values_are_physical() -> None:
    system = gain(RealParameter("k", 2.0, 1.0, 5.0))
    assert system.nominal().D[0, 0] == 2.0
    assert system.at({"k": 4.5}).D[0, 0] == pytest.approx(4.5, abs=1e-15)


def test_nominal_result_is_a_control_system_with_signal_names(make) -> None:
    nominal = make(np.random.default_rng(1)).nominal().to_control()
    assert nominal.input_labels == ["u[0]", "u[1]", "w"]
    assert nominal.output_labels == ["y[0]", "y[1]", "z"]
    assert nominal.nstates == 4


def test_occurrences_count_the_channels(make) -> None:
    assert make(np.random.default_rng(1)).occurrences() == {"k": 2, "m": 1}


def test_a_value_outside_its_range_names_the_parameter() -> None:
    with pytest.raises(ValueError, match=r"'k'.*\[1, 5\].*got 6"):
        gain(RealParameter("k", 2.0, 1.0, 5.0)).at({"k": 6.0})


def test_an_unknown_parameter_lists_those_there_are() -> None:
    with pytest.raises(ValueError, match=r"parameter must be one of k, got 'q'"):
        gain(RealParameter("k", 2.0, 1.0, 5.0)).at({"q": 2.0})


def test_an_unknown_port_lists_those_there_are(make) -> None:
    with pytest.raises(ValueError, match=r"input port must be one of u, w, got 'v'"):
        make(np.random.default_rng(1)).select(inputs=["v"])


def test_ill_posed_values_are_refused() -> None:
    k = RealParameter("k", 0.0, -1.0, 1.0)
    empty = np.zeros((0, 0))
    system = System(
        empty, empty, empty, [[1, 1], [1, 0]], (Port("u", 1),), (Port("y", 1),), channels=("k",), elements=(k,)
    )
    assert system.at({"k": 0.5}).D[0, 0] == pytest.approx(1.0)
    with pytest.raises(ValueError, match="must be well posed"):
        system.at({"k": 1.0})


@pytest.mark.parametrize(
    ("D", "message"),
    [([[1.0, 2.0]], "matrix D must be 1 x 1"), ([[np.nan]], "must be finite")],
)
def test_matrices_are_checked_at_the_door(D, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        static_gain(D, [Port("u", 1)], [Port("y", 1)])


def test_a_port_name_may_not_come_twice() -> None:
    with pytest.raises(ValueError, match="port names must be unique, got 'u' twice"):
        static_gain(np.zeros((1, 2)), [Port("u", 1), Port("u", 1)], [Port("y", 1)])


def test_one_name_with_two_definitions_is_refused() -> None:
    k, other = RealParameter("k", 0.0, -1.0, 1.0), RealParameter("k", 0.0, -2.0, 1.0)
    empty = np.zeros((0, 0))
    with pytest.raises(ValueError, match="must have one definition, got two"):
        System(
            empty,
            empty,
            empty,
            np.zeros((3, 3)),
            (Port("u", 1),),
            (Port("y", 1),),
            channels=("k", "k"),
            elements=(k, other),
        )


def test_arrays_cannot_be_written(make) -> None:
    with pytest.raises(ValueError, match="read-only"):
        make(np.random.default_rng(1)).A[0, 0] = 1.0


def test_sub_system_by_names_and_sampling(make) -> None:
    system = make(np.random.default_rng(1))
    part = system["z", "u"]
    assert [p.name for p in part.inputs] == ["u"] and [p.name for p in part.outputs] == ["z"]
    whole, small = system.at({"k": 1.0}), part.at({"k": 1.0})
    np.testing.assert_allclose(small(2.0j), whole(2.0j)[2:3, :2], atol=1e-14)
    values = system.sample_values(np.random.default_rng(3), 50)
    assert all(0.2 <= v["k"] <= 1.4 for v in values) and len({v["k"] for v in values}) == 50
    assert len(system.sample(np.random.default_rng(3), 2)) == 2


def test_renaming_keeps_the_response(make) -> None:
    system = make(np.random.default_rng(2))
    other = system.renamed({"u": "command"}, {"k": "stiffness"})
    assert other.occurrences() == {"stiffness": 2, "m": 1}
    np.testing.assert_array_equal(other.at({"stiffness": 1.1}).A, system.at({"k": 1.1}).A)
    with pytest.raises(ValueError, match=r"port must be one of .*, got 'v'"):
        system.renamed({"v": "x"})


def test_normalised_family_is_the_same_family(make) -> None:
    system = make(np.random.default_rng(4))
    unit = system.normalised()
    for nu_k, nu_m in ((-1.0, 1.0), (0.0, 0.0), (0.3, -0.8), (1.0, -1.0)):
        physical = {n: system.parameter(n).from_normalised(nu) for n, nu in (("k", nu_k), ("m", nu_m))}
        np.testing.assert_allclose(
            unit.at({"k": nu_k, "m": nu_m})(1.7j), system.at(physical)(1.7j), rtol=1e-12, atol=1e-12
        )
    assert unit.occurrences() == system.occurrences()


def test_round_trip_through_control() -> None:
    system = state_space([[-1.0]], [[1.0]], [[2.0]], [[0.5]], [Port("u", 1)], [Port("y", 1)])
    again = from_control(system.nominal().to_control())
    np.testing.assert_array_equal(again.A, system.A)
    assert [p.name for p in again.inputs] == ["u"]


@pytest.mark.parametrize(("nominal", "lower", "upper"), [(0.0, 1.0, 2.0), (3.0, 1.0, 2.0), (np.nan, 0.0, 1.0)])
def test_a_parameter_needs_its_nominal_value_in_range(nominal: float, lower: float, upper: float) -> None:
    with pytest.raises(ValueError, match="parameter 'k'"):
        RealParameter("k", nominal, lower, upper)
