"""Norms: limits, certificates, discrete time, and refusals."""

from __future__ import annotations

import control
import numpy as np
import pytest

from lftkit.analysis.frequency_response import FrequencyResponse, direct_response, refined_response
from lftkit.analysis.hinf.hamiltonian_norm import level_crossings
from lftkit.analysis.hinf.interval_norm import interval_test
from lftkit.analysis.norms import h2_norm, hinf_norm, hinf_norms, spectral_abscissa
from lftkit.systems.system import System


def flexible(seed: int, modes: int = 100, inputs: int = 5, outputs: int = 2) -> tuple[np.ndarray, ...]:
    """Lightly damped structure (damping 0.001 to 0.02) in coordinates that mix all modes."""
    rng = np.random.default_rng(seed)
    w, zeta = np.sort(10 ** rng.uniform(-1, 3.3, modes)), 10 ** rng.uniform(-3, -1.7, modes)
    A = np.zeros((2 * modes, 2 * modes))
    i = np.arange(modes)
    A[2 * i, 2 * i + 1], A[2 * i + 1, 2 * i], A[2 * i + 1, 2 * i + 1] = w, -w, -2 * zeta * w
    B, C = np.zeros((2 * modes, inputs)), np.zeros((outputs, 2 * modes))
    B[1::2], C[:, ::2] = rng.normal(size=(modes, inputs)), rng.normal(size=(outputs, modes)) / w
    T = np.eye(2 * modes) + 0.2 * rng.normal(size=A.shape) / np.sqrt(2 * modes)
    inverse = np.linalg.inv(T)
    return T @ A @ inverse, T @ B, C @ inverse, np.zeros((outputs, inputs))


@pytest.mark.parametrize("seed", range(3))
def test_two_certificates_agree_on_a_flexible_structure(seed: int) -> None:
    system = flexible(seed)
    a = hinf_norm(*system, rtol=1e-8, certificate="interval")
    b = hinf_norm(*system, rtol=1e-8, certificate="hamiltonian")
    assert (a.certificate, b.certificate) == ("interval", "hamiltonian")
    assert a.value == pytest.approx(b.value, rel=1e-8)
    assert a.omega == pytest.approx(b.omega, rel=1e-6)
    gain = np.linalg.norm(refined_response(*system, a.omega), 2)
    assert gain == pytest.approx(a.value, rel=1e-12)


@pytest.mark.parametrize("test", ["interval", "hamiltonian"])
def test_level_just_below_the_norm_is_seen_to_be_exceeded(test: str) -> None:
    system = flexible(7, modes=30)
    value = hinf_norm(*system, rtol=1e-9).value
    response = FrequencyResponse.of(*system)

    def below(level: float) -> bool:
        if test == "interval":
            return interval_test(response, level, np.abs(response.poles)) is None
        crossings = level_crossings(system, level)
        middles = response.at(0.5 * (crossings[:-1] + crossings[1:]))
        return max((float(np.linalg.norm(g, 2)) for g in middles), default=0.0) <= level

    assert below(value * (1 + 1e-7))
    assert not below(value * (1 - 1e-6))


def test_peak_at_zero_infinity_and_no_states() -> None:
    lag = hinf_norm([[-1.0]], [[1.0]], [[2.0]], [[0.0]])
    assert (lag.value, lag.omega) == (2.0, 0.0)
    washout = hinf_norm([[-1.0]], [[1.0]], [[-3.0]], [[3.0]])
    assert washout.value == pytest.approx(3.0) and washout.upper >= 3.0
    assert hinf_norm(np.zeros((0, 0)), np.zeros((0, 2)), np.zeros((1, 0)), [[3.0, 4.0]]).value == 5.0


def test_unstable_is_infinite() -> None:
    norm = hinf_norm([[0.1, 2.0], [-2.0, 0.1]], [[1], [0]], [[1, 0]], [[0]])
    assert norm.value == np.inf and norm.certificate == "unstable" and norm.omega == pytest.approx(2.0)
    assert h2_norm([[1.0]], [[1.0]], [[1.0]], [[0.0]]) == np.inf
    assert hinf_norm([[1.1]], [[1]], [[1]], [[0]], dt=1.0).value == np.inf


def test_repeated_poles_fall_back_to_schur() -> None:
    """1 / (s + 1)^5 has no modal form; its norm is 1 at zero."""
    A = -np.eye(5) + np.diag(np.ones(4), 1)
    B, C = np.eye(5)[:, -1:], np.eye(5)[:1]
    assert not FrequencyResponse.of(A, B, C, [[0.0]]).modal
    norm = hinf_norm(A, B, C, [[0.0]])
    assert norm.value == pytest.approx(1.0, rel=1e-6) and norm.certificate == "hamiltonian"


def test_discrete_norm_is_reached_and_not_exceeded() -> None:
    A, B, C, D = [[0.5, 0.8], [-0.8, 0.5]], [[1.0], [0.0]], [[1.0, 1.0]], [[0.1]]
    norm = hinf_norm(A, B, C, D, dt=0.1)
    z = np.exp(1j * np.linspace(0, np.pi, 20001))
    gains = [abs(C @ np.linalg.solve(x * np.eye(2) - np.array(A), B) + D).item() for x in z]
    assert max(gains) <= norm.upper
    assert norm.value == pytest.approx(max(gains), rel=1e-6)
    assert norm.omega * 0.1 == pytest.approx(np.angle(z[int(np.argmax(gains))]), abs=1e-3)


def test_h2_against_control_and_discrete_sum() -> None:
    system = control.rss(5, 2, 3, strictly_proper=True)
    A, B, C, D = system.A, system.B, system.C, system.D
    W = control.gram(system, "c") if control.exception.slycot_check() else None
    expected = np.sqrt(np.trace(C @ W @ C.T)) if W is not None else control.norm(system, 2)
    assert h2_norm(A, B, C, D) == pytest.approx(expected, rel=1e-8)
    # impulse response of the discrete system summed
    assert h2_norm([[0.5]], [[1.0]], [[1.0]], [[2.0]], dt=1.0) ** 2 == pytest.approx(4 + 1 / (1 - 0.25))


def test_batch_and_abscissa() -> None:
    systems = [flexible(s, modes=5) for s in range(3)]
    assert [n.value for n in hinf_norms(systems)] == [hinf_norm(*s).value for s in systems]
    assert spectral_abscissa([[-1, 5], [0, -3]]) == -1.0


@pytest.mark.parametrize(
    ("matrices", "message"),
    [
        (([[1.0, 0.0]], [[1.0]], [[1.0]], [[0.0]]), "matrix A must be 1 x 1 to fit states and ports, got 1 x 2"),
        (([[-1.0]], [[np.nan]], [[1.0]], [[0.0]]), "matrix B must be finite"),
    ],
)
def test_bad_matrices_are_named(matrices: tuple, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        hinf_norm(*matrices)


def test_units_do_not_cost_digits() -> None:
    """Modes from 0.01 to 1e5 rad/s in states of very different units: the response equals that of the plain modes."""
    rng = np.random.default_rng(3)
    w = np.geomspace(1e-2, 1e5, 40)
    A, B, C = np.zeros((80, 80)), np.zeros((80, 3)), np.zeros((2, 80))
    i = np.arange(40)
    A[2 * i, 2 * i + 1], A[2 * i + 1, 2 * i], A[2 * i + 1, 2 * i + 1] = w, -w, -2e-3 * w
    B[1::2], C[:, ::2] = rng.normal(size=(40, 3)), rng.normal(size=(2, 40))
    A[2 * i[1:] + 1, 2 * i[:-1]] = 0.5 * w[1:]  # each mode drives the next
    units = 10.0 ** rng.uniform(-6, 6, 80)
    mixed = A * units / units[:, None], B / units[:, None], C * units
    form = FrequencyResponse.of(*mixed, np.zeros((2, 3)))
    assert form.modal
    for omega in (3e-3, 0.0995, 1.7, 40.0, 2.1e4):
        exact = direct_response(A, B, C, np.zeros((2, 3)), omega)
        assert np.abs(form.at(omega)[0] - exact).max() < 1e-8 * np.abs(exact).max()
    plain = hinf_norm(A, B, C, np.zeros((2, 3)))
    assert hinf_norm(*mixed, np.zeros((2, 3))).value == pytest.approx(plain.value, rel=1e-7)


def test_period_zero_is_continuous_time_as_systems_have_it():
    matrices = [[-2.0]], [[1.0]], [[1.0]], [[0.0]]
    assert h2_norm(*matrices, dt=0.0) == h2_norm(*matrices) == pytest.approx(0.5)
    assert hinf_norm(*matrices, dt=0.0).value == pytest.approx(0.5)


@pytest.mark.parametrize("dt", [-1.0, float("nan"), float("inf"), True, "1"])
@pytest.mark.parametrize("norm", [h2_norm, hinf_norm])
def test_a_period_that_is_none_is_refused(norm, dt):
    with pytest.raises(ValueError, match="dt must be a sampling period, or None or 0 for continuous time, got"):
        norm([[0.5]], [[1.0]], [[1.0]], [[0.0]], dt=dt)


def test_true_is_no_period_of_a_system():
    with pytest.raises(ValueError, match="dt must be a finite real number, got True"):
        System([[0.5]], [[1.0]], [[1.0]], [[0.0]], [("u", 1)], [("y", 1)], dt=True)
