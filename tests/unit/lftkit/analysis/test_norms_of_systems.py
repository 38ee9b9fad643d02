"""A system in place of its four matrices: norms, pictures and weights take it as it is written."""

from __future__ import annotations

import control
import numpy as np
import pytest
from scipy import signal

from lftkit import InputError, System, h2_norm, hinf_norm, hinf_norms, linf_norm, pole_map, real, s, z
from lftkit import sigma_plot as plot
from lftkit.synthesis import augw, mixsyn, ncfsyn

LAG = 6 / (s**2 + 0.3 * s + 2)


@pytest.mark.parametrize("norm", [hinf_norm, h2_norm, linf_norm])
def test_a_system_is_its_matrices(norm: object) -> None:
    assert callable(norm)
    system = LAG.system("u", "y")
    expected = norm(*system.matrices)
    assert norm(system) == expected and norm(LAG) == expected
    value = getattr(expected, "value", expected)
    other = norm(signal.TransferFunction([6.0], [1.0, 0.3, 2.0]))
    assert getattr(other, "value", other) == pytest.approx(value, rel=1e-7)
    other = norm(control.tf([6.0], [1.0, 0.3, 2.0]))
    assert getattr(other, "value", other) == pytest.approx(value, rel=1e-7)


@pytest.mark.parametrize("norm", [hinf_norm, h2_norm, linf_norm])
def test_a_sampled_system_has_its_period(norm: object) -> None:
    assert callable(norm)
    system = (1 / (z(0.1) - 0.5)).system("u", "y")
    expected = norm(*system.matrices, dt=0.1)
    assert norm(system) == expected and norm(system, dt=0.1) == expected
    with pytest.raises(InputError, match=r"dt must be that of the system, 0\.1 s, got 0\.2 s"):
        norm(system, dt=0.2)


def test_a_matrix_alone_is_a_gain() -> None:
    assert hinf_norm([[3.0, 4.0]]).value == pytest.approx(5.0)


def test_many_systems_or_their_matrices() -> None:
    system = LAG.system("u", "y")
    assert len({norm.value for norm in hinf_norms([system, system.matrices, LAG])}) == 1


def test_what_is_no_system() -> None:
    with pytest.raises(InputError, match="A, B, C and D, or one system, got no C and no D"):
        hinf_norm([[-1.0]], [[1.0]])
    with pytest.raises(InputError, match="system must be a System"):
        hinf_norm("G")
    with pytest.raises(InputError, match="certain"):
        hinf_norm(1 / (s + real("a", 1.0, percent=10)))


def test_weights_and_plants_as_they_are_written() -> None:
    plant, weight = 200 / ((10 * s + 1) * (0.05 * s + 1) ** 2), (s / 1.5 + 10) / (s + 1e-3)
    named = plant.system("u", "y"), weight.system("e", "z")
    assert mixsyn(plant, weight, 1.0).value == mixsyn(*named, 1.0).value
    by_control = control.tf([1 / 1.5, 10.0], [1.0, 1e-3])
    assert mixsyn(plant, by_control, 1.0).value == pytest.approx(mixsyn(*named, 1.0).value, rel=1e-6)
    assert ncfsyn(plant, (s + 2) / s).value == ncfsyn(named[0], ((s + 2) / s).system("v", "u")).value


def test_a_gain_weights_each_channel_of_a_sampled_plant() -> None:
    two = System(0.5 * np.eye(2), np.eye(2), np.eye(2), np.zeros((2, 2)), [("u", 2)], [("y", 2)], dt=0.1)
    for weight in (3.0, 3.0 * np.eye(2), 3.0 + 0.0 * s):
        made = augw(two, error=weight)
        assert made.dt == 0.1 and np.array_equal(made["z1", "w"].D, 3.0 * np.eye(2))
    with pytest.raises(InputError, match="z1 must have 2 inputs or one, got 3"):
        augw(two, error=np.ones((1, 3)))


def test_pictures_of_an_expression() -> None:
    line = plot(LAG, omega=[1e-6, 1.0]).axes[0].lines[0]
    assert line.get_ydata()[0] == pytest.approx(3.0)  # type: ignore[index]
    assert len(pole_map(LAG).axes[0].collections[0].get_offsets()) == 2  # type: ignore[arg-type]
