"""Summaries and pictures of uncertain systems show what the system is."""

from __future__ import annotations

import numpy as np
import pytest

from lftkit import Port, RealParameter, System, bode_band, pole_map, real, s, sigma_plot, state_space
from lftkit.analysis.frequency_response import frequency_response

K = RealParameter("k", 2.0, 1.0, 3.0, "N/m")


@pytest.fixture(scope="module")
def mass() -> System:
    """A mass of 1 kg on a spring k with light damping, two forces."""
    A, B = [[0, 1], [-2, -0.02]], [[0, 0, 0], [1, 1, 1]]
    C, D = [[-1, 0], [1, 0]], [[0, 0, 0], [0, 0, 0]]
    return System(A, B, C, D, (Port("force", 2, "N"),), (Port("x", 1, "m"),), channels=("k",), elements=(K,))


def test_a_summary_has_ports_units_and_elements_and_escapes_names(mass: System) -> None:
    system = state_space([[-1]], [[1]], [[1]], [[0]], [Port("a<b", 1)], [Port("y", 1)])
    assert system.summary().endswith("certain") and "a&lt;b" in system._repr_html_()
    for text in (repr(mass), mass.summary(), mass._repr_html_()):
        assert all(part in text for part in ("order 2", "force", "x", "k"))
    assert "real, 2 in [1, 3] N/m" in mass.summary()


def test_the_band_contains_every_member_and_the_line_is_the_nominal_system(mass: System) -> None:
    w = np.geomspace(0.3, 5.0, 60)
    values = [{"k": k} for k in (1.0, 1.7, 3.0)]
    upper, lower = bode_band(mass, values, output="x", input=("force", 1), omega=w).axes
    direct = [1.0 / (k - w**2 + 0.02j * w) for k in (2.0, 1.0, 1.7, 3.0)]  # the equation of motion
    np.testing.assert_allclose(upper.lines[0].get_ydata(), np.abs(direct[0]), rtol=1e-9)
    corners = np.asarray(upper.collections[0].get_paths()[0].vertices)
    for i in (5, 30, 55):
        here = corners[np.isclose(corners[:, 0], w[i]), 1]
        assert here.min() == pytest.approx(min(np.abs(g[i]) for g in direct), rel=1e-9)
        assert here.max() == pytest.approx(max(np.abs(g[i]) for g in direct), rel=1e-9)
    np.testing.assert_allclose(np.asarray(lower.lines[0].get_ydata())[[0, -1]], [0.0, -180.0], atol=1.0)


def test_the_default_grid_meets_the_resonances_of_the_members(mass: System) -> None:
    figure = bode_band(mass, [{"k": 1.0}], output="x", input="force")
    corners = np.asarray(figure.axes[0].collections[0].get_paths()[0].vertices)
    assert corners[:, 1].max() == pytest.approx(1 / (0.02 * 1.0), rel=1e-3)  # peak of the soft member at 1 rad/s


def test_singular_values_are_those_of_the_response(mass: System) -> None:
    w = np.array([0.5, 1.4, 4.0])
    axes = sigma_plot(mass, [{"k": 1.0}], omega=w).axes[0]
    expected = np.linalg.norm(frequency_response(mass.at({}), w)[:, 0, :], axis=1)
    np.testing.assert_allclose(axes.lines[0].get_ydata(), expected, rtol=1e-12)


def test_poles_are_those_of_the_members(mass: System) -> None:
    nominal, members = pole_map(mass, [{"k": 3.0}]).axes[0].collections
    np.testing.assert_allclose(np.abs(nominal.get_offsets() @ [1, 1j]), np.sqrt(2.0))
    np.testing.assert_allclose(np.abs(members.get_offsets() @ [1, 1j]), np.sqrt(3.0))


def test_mistakes_are_errors_of_one_line(mass: System) -> None:
    certain = System.static(np.eye(1), [("u", 1)], [("y", 1)])
    with pytest.raises(ValueError, match=r"output port must be one of x, got 'y'"):
        bode_band(mass, output="y", input="force")
    with pytest.raises(ValueError, match=r"index of input port force must be from 0 to 1, got 2"):
        bode_band(mass, output="x", input=("force", 2))
    with pytest.raises(ValueError, match=r"samples must be 0 for a system without uncertain elements"):
        sigma_plot(certain, 5)
    with pytest.raises(ValueError, match=r"samples must be 0 or more, got -1"):
        pole_map(mass, -1)
    with pytest.raises(ValueError, match=r"parameter 'k' must be in"):
        pole_map(mass, [{"k": 9.0}])


def test_the_phases_of_all_members_start_beside_the_nominal_one() -> None:
    """``1 / (s (s + c))``: -90 - atan(w / c) degrees, for a negative c below -180 and not near 180."""
    cart = 1 / (s**2 + real("c", 0.01, -0.1, 0.1) * s)
    bottom = bode_band(cart, [{"c": -0.1}, {"c": 0.1}], output="y", input="u", omega=[1.0, 2.0]).axes[1]
    limits = bottom.collections[0].get_datalim(bottom.transData)
    around = np.rad2deg(np.arctan(0.1))
    assert (limits.ymin, limits.ymax) == pytest.approx((-180.0 - around, -180.0 + around))
