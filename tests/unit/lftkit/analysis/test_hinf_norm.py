"""Norms that are known in closed form, certificates that agree, limits, refusals."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.linalg
from support.resonant_systems import CERTIFICATES, EVERY, mixed, oscillator, resonator, sum_of

from lftkit.analysis import norms
from lftkit.analysis.frequency_response import FrequencyResponse, PoleError, direct_response, refined_response
from lftkit.analysis.hinf.peak_search import squared_gain
from lftkit.analysis.norms import band_gain, h2_norm, hinf_norm, linf_norm, schur_lyapunov, spectral_abscissa


@pytest.mark.parametrize("certificate", CERTIFICATES)
@pytest.mark.parametrize("rtol", [0.1, 1e-3, 1e-6, 1e-9])
def test_norm_lies_between_both_sides(rtol: float, certificate: str) -> None:
    exact = 1.0 / (2 * 0.05 * np.sqrt(1 - 0.05**2))
    norm = hinf_norm(*mixed(sum_of(oscillator(3.0, 0.05), oscillator(40.0, 0.06))), rtol=rtol, certificate=certificate)
    assert norm.certificate == certificate
    assert norm.value <= exact * (1 + 1e-12) and exact <= norm.upper
    assert norm.upper == pytest.approx(norm.value * (1 + rtol), rel=1e-12)
    assert norm.omega == pytest.approx(3.0 * np.sqrt(1 - 2 * 0.05**2), rel=0.1 * np.sqrt(rtol))


@pytest.mark.parametrize("certificate", CERTIFICATES)
def test_two_peaks_that_differ_by_little(certificate: str) -> None:
    """The search starts at the second; the test finds the first."""
    low, high = oscillator(1.0, 0.01), oscillator(70.0, 0.01 * (1 + 1e-5))
    norm = hinf_norm(*mixed(sum_of(low, high)), rtol=1e-8, certificate=certificate)
    assert norm.value == pytest.approx(50.0 / np.sqrt(1 - 1e-4), rel=2e-8)
    assert norm.omega == pytest.approx(np.sqrt(1 - 2e-4), rel=1e-4)


@pytest.mark.parametrize("zeta", [1e-8, 1e-10, 1e-12])
@pytest.mark.parametrize("certificate", ["auto", "interval"])
def test_damping_near_zero(zeta: float, certificate: str) -> None:
    """Beside modes of three decades above and below."""
    system = sum_of(oscillator(1.0, 0.1), oscillator(30.0, zeta), oscillator(1e3, 0.02))
    norm = hinf_norm(*system, rtol=1e-7, certificate=certificate)
    assert norm.value == pytest.approx(0.5 / zeta, rel=1e-7)
    assert norm.omega == pytest.approx(30.0, rel=1e-12)
    assert norm.upper == pytest.approx(norm.value, rel=1.01e-7) and norm.certificate == "interval"


@pytest.mark.parametrize("certificate", CERTIFICATES)
def test_peak_of_a_matrix_with_feedthrough(certificate: str) -> None:
    """D + 1 / (s + 1) at zero frequency and D at infinity, for two signs of D."""
    A, B, C = -np.eye(2), np.eye(2), np.eye(2)
    same = hinf_norm(A, B, C, np.diag([3.0, 1.0]), certificate=certificate)
    assert (same.value, same.omega) == (4.0, 0.0) and same.upper == pytest.approx(4.0, rel=1e-6)
    against = hinf_norm(A, B, C, np.diag([-3.0, 1.0]), certificate=certificate)
    assert against.value == pytest.approx(3.0, rel=1e-12) and against.omega == np.inf


def test_discrete_pole_on_or_outside_the_circle_is_unstable() -> None:
    for radius, angle in ((1.0, 0.7), (1.2, 0.7)):
        norm = hinf_norm(*resonator(radius, angle), dt=0.1)
        assert (norm.value, norm.upper, norm.certificate) == (np.inf, np.inf, "unstable")
        assert norm.omega == pytest.approx(7.0)
        assert h2_norm(*resonator(radius, angle), dt=0.1) == np.inf
    both = sum_of(([[0.5]], [[1.0]], [[1.0]], [[0.0]]), ([[-1.5]], [[1.0]], [[1.0]], [[0.0]]))
    assert hinf_norm(*both, dt=0.5).omega == pytest.approx(2 * np.pi)


def test_systems_without_states() -> None:
    empty = np.zeros((0, 0)), np.zeros((0, 2)), np.zeros((1, 0)), np.array([[3.0, 4.0]])
    for dt in (None, 0.1):
        norm = hinf_norm(*empty, dt=dt)
        assert (norm.value, norm.upper, norm.omega, norm.certificate) == (5.0, 5.0, 0.0, "static")
    assert h2_norm(*empty, dt=0.1) == 5.0
    assert h2_norm(*empty) == np.inf
    assert h2_norm(*empty[:3], 0.0 * empty[3]) == 0.0


@pytest.mark.parametrize(("inputs", "outputs"), [(0, 1), (1, 0), (0, 0)])
@pytest.mark.parametrize("dt", [None, 0.1])
def test_without_inputs_or_outputs_the_norm_is_zero_or_that_of_an_unstable_system(
    dt: float | None, inputs: int, outputs: int
) -> None:
    for stable in (True, False):
        pole = (0.5 if stable else 1.5) if dt else (-1.0 if stable else 1.0)
        system = [[pole]], np.ones((1, inputs)), np.ones((outputs, 1)), np.zeros((outputs, inputs))
        limit = 0.0 if stable else np.inf
        assert hinf_norm(*system, dt=dt).value == hinf_norm(*system, dt=dt).upper == limit
        assert band_gain(*system, (0.0, 1.0), dt=dt).value == limit
        assert linf_norm(*system, dt=dt).value == 0.0
    assert spectral_abscissa(np.zeros((0, 0))) == -np.inf


def test_states_that_are_not_driven_or_not_observed() -> None:
    one, none = np.ones((1, 1)), np.zeros((1, 1))
    for B, C in ((none, one), (one, none)):
        norm = hinf_norm(-one, B, C, 2 * one)
        assert (norm.value, norm.upper, norm.certificate) == (2.0, 2.0, "static")
        assert hinf_norm(0 * one, B, C, 2 * one).certificate == "unstable"
        assert hinf_norm(one, B, C, none).value == np.inf
    assert hinf_norm(
        np.array([[0.5, 2.0], [-2.0, 0.5]]), np.zeros((2, 1)), np.ones((1, 2)), none
    ).omega == pytest.approx(2.0)


@pytest.mark.parametrize("w", [0.0, 2.0, 1e4])
def test_undamped_modes_are_unstable(w: float) -> None:
    """Alone, beside damped ones, in mixed coordinates; a double integrator."""
    free = ([[0.0, w], [-w, 0.0]], [[0.0], [1.0]], [[1.0, 0.0]], [[0.0]])
    for system in (free, sum_of(free, oscillator(3.0, 0.01))):
        norm = hinf_norm(*system)
        assert (norm.value, norm.upper, norm.omega, norm.certificate) == (np.inf, np.inf, w, "unstable")
        assert h2_norm(*system) == np.inf
    assert hinf_norm([[0.0, 1.0], [0.0, 0.0]], [[0.0], [1.0]], [[1.0, 0.0]], [[0.0]]).certificate == "unstable"


LAG = [[-0.5]], [[1.0]], [[1.0]], [[0.0]]
PERIODS = -1.0, float("nan"), float("inf"), True, "1"


@pytest.mark.parametrize(
    ("matrices", "options", "message"),
    [
        (LAG, {"certificate": "grid"}, "auto, interval or hamiltonian, got 'grid'"),
        (LAG, {"rtol": -1e-3}, r"rtol must be positive, got -0\.001"),
        (LAG, {"rtol": np.nan}, "rtol must be positive, got nan"),
        (LAG, {"dt": 0.1, "certificate": "hamiltonian"}, "auto or interval in discr"),
        (([[1.0, 0.0]], *LAG[1:]), {}, "matrix A must be 1 x 1 to fit states and ports, got 1 x 2"),
        ((LAG[0], [[np.nan]], *LAG[2:]), {}, "matrix B must be finite"),
        *((LAG, {"dt": dt}, "dt must be a sampling period, or None or 0") for dt in PERIODS),
    ],
)
def test_what_has_no_norm_is_refused(matrices: tuple, options: dict, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        hinf_norm(*matrices, **options)
    if not {"certificate", "rtol"} & options.keys():
        with pytest.raises(ValueError, match=message):
            h2_norm(*matrices, **options)


def test_h2_of_known_systems() -> None:
    """The oscillator has the squared norm w / (4 zeta); the discrete lag c^2 / (1 - a^2) + d^2."""
    assert h2_norm(*mixed(oscillator(3.0, 0.02))) ** 2 == pytest.approx(3.0 / 0.08, rel=1e-10)
    two = sum_of(oscillator(3.0, 0.02), oscillator(7.0, 0.5))
    assert h2_norm(*two) ** 2 == pytest.approx(3.0 / 0.08 + 7.0 / 2.0, rel=1e-10)
    assert h2_norm([[-0.5]], [[1.0]], [[3.0]], [[4.0]], dt=0.1) ** 2 == pytest.approx(9 / 0.75 + 16)
    for dt in (None, 0.0):
        assert h2_norm([[-8.0]], [[1.0]], [[1.0]], [[0.0]], dt=dt) == pytest.approx(0.25)
        assert hinf_norm([[-8.0]], [[1.0]], [[1.0]], [[0.0]], dt=dt).value == pytest.approx(0.125)
    assert h2_norm([[0.0]], [[0.5]], [[0.5]], [[0.0]], dt=1.0) == pytest.approx(0.25)
    assert h2_norm([[-1.0]], [[1.0]], [[1.0]], [[1e-9]]) == np.inf
    assert h2_norm([[-1e-9]], [[1.0]], [[1.0]], [[0.0]]) ** 2 == pytest.approx(0.5e9)
    assert h2_norm([[0.0]], [[1.0]], [[1.0]], [[0.0]]) == np.inf
    assert h2_norm(*mixed(sum_of(oscillator(3.0, 0.0), oscillator(7.0, 0.5)))) == np.inf
    assert h2_norm([[1.0]], [[1.0]], [[1.0]], [[0.0]], dt=1.0) == np.inf
    assert h2_norm([[0.999]], [[1.0]], [[1.0]], [[0.0]], dt=1.0) < np.inf


@pytest.mark.parametrize("transposed", [False, True])
def test_lyapunov_equation_of_a_quasi_triangular_matrix(transposed: bool) -> None:
    rng = np.random.default_rng(0)
    T = scipy.linalg.schur(rng.normal(size=(6, 6)) - 3 * np.eye(6))[0]
    W = rng.normal(size=(6, 6))
    W = W + W.T
    P = schur_lyapunov(T, W, transposed=transposed)
    left = T.T if transposed else T
    assert np.array_equal(P, P.T)
    np.testing.assert_allclose(left @ P + P @ left.T, -W, atol=1e-12)


EPS = np.finfo(float).eps


@pytest.mark.parametrize("certificate", EVERY)
@pytest.mark.parametrize("pole", [-4.0, -0.25, -0.5 + 2.0j])
def test_equal_parts_of_opposite_sign_leave_a_bound_of_the_rounding_of_their_terms(
    pole: complex, certificate: str
) -> None:
    """100 roundings of the sum of the modal terms, each a residue over the distance of the pole."""
    size, a, w = abs(pole), abs(np.real(pole)), np.imag(pole)
    part = np.array([[-a, w], [-w, -a]]) if w else np.array([[-a]])
    terms = 2.0 * (0.5 / a + 0.5 / (size + w) if w else 1.0 / a)
    first = np.eye(len(part))[:1]
    norm = hinf_norm(
        scipy.linalg.block_diag(part, part),
        np.hstack([first, first]).T,
        np.hstack([first, -first]),
        [[0.0]],
        certificate=certificate,
    )
    assert norm.value == 0.0 and norm.upper == pytest.approx(100.0 * EPS * terms, rel=1e-9, abs=0.0)


@pytest.mark.parametrize("certificate", EVERY)
@pytest.mark.parametrize("modal", [True, False])
def test_part_that_is_driven_beside_one_that_is_observed_has_norm_zero(modal: bool, certificate: str) -> None:
    """Shown with intervals; a Hamiltonian, which a triple pole asks for, needs 100 roundings of |B| |C| / |Re pole|."""
    chain = 0.25 * (-np.eye(3) + np.diag([1.0, 1.0], 1))
    one, two = (np.diag([-0.25, -0.5, -0.75]), np.diag([-1.0, -1.25, -1.5])) if modal else (chain, chain)
    A, B, C = scipy.linalg.block_diag(one, two), 3.0 * np.eye(6)[:, 2:3], 5.0 * np.eye(6)[3:4]
    assert FrequencyResponse.of(A, B, C, [[0.0]]).modal == modal
    norm = hinf_norm(A, B, C, [[0.0]], certificate=certificate)
    intervals = modal and certificate != "hamiltonian"
    assert norm.value == 0.0 and norm.certificate == ("interval" if intervals else "hamiltonian")
    assert norm.upper == (0.0 if intervals else pytest.approx(100.0 * EPS * 15.0 / 0.25, rel=1e-9, abs=0.0))


def test_smallest_gains_of_a_schur_form_are_as_exact_as_large_ones() -> None:
    """k / (s + 1)^3 has the norm k."""
    A, B, C = -np.eye(3) + np.diag([1.0, 1.0], 1), np.eye(3)[:, 2:], np.eye(3)[:1]
    for gain in (1e-20, 1e-15, 1.0, 1e20):
        norm = hinf_norm(A, gain * B, C, [[0.0]])
        assert norm.certificate == "hamiltonian" and norm.value == pytest.approx(gain, rel=1e-9, abs=0.0)
        assert norm.upper == pytest.approx(gain * (1 + 1e-7), rel=1e-9, abs=0.0)


def test_pole_counts_as_on_the_circle_within_four_roundings_per_state() -> None:
    for states, roundings, outside in ((1, 2, True), (1, 8, False), (2, 6, True), (2, 12, False), (1, 0, True)):
        A = np.diag([1.0 - roundings * EPS, 0.5][:states])
        norm = hinf_norm(A, np.eye(states), np.eye(states), np.zeros((states, states)), dt=1.0)
        assert (norm.certificate == "unstable") == outside


def test_lyapunov_solution_near_the_largest_number_is_scaled() -> None:
    """-1e-150 p + 1e145 = 0: LAPACK answers with a scale factor below one."""
    assert schur_lyapunov(np.array([[-0.5e-150]]), np.array([[1e145]])) == pytest.approx(1e295, rel=1e-9)


def test_h2_with_several_inputs_and_outputs() -> None:
    """diag(1 / (s + a_i)) between mixing matrices: the squared norm is the sum of m_ij n_ij / (a_i + a_j)."""
    rng = np.random.default_rng(2)
    a, B, C = np.array([0.1, 3.0, 40.0]), rng.normal(size=(3, 4)), rng.normal(size=(2, 3))
    expected = np.sum((B @ B.T) * (C.T @ C) / (a[:, None] + a))
    assert h2_norm(*mixed((-np.diag(a), B, C, np.zeros((2, 4))))) ** 2 == pytest.approx(expected, rel=1e-9)
    z, D = np.array([0.9, -0.5, 0.1]), rng.normal(size=(2, 4))
    expected = np.sum((B @ B.T) * (C.T @ C) / (1.0 - z[:, None] * z)) + np.sum(D**2)
    assert h2_norm(*mixed((np.diag(z), B, C, D)), dt=0.1) ** 2 == pytest.approx(expected, rel=1e-9)


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


@pytest.mark.parametrize("modes", [1, 2, 5, 30, 100])
@pytest.mark.parametrize("seed", range(2))
def test_two_certificates_agree_on_a_flexible_structure(seed: int, modes: int) -> None:
    """Cuts and Taylor bounds of the intervals against the eigenvalues of the Hamiltonian matrix."""
    system = flexible(seed, modes)
    a = hinf_norm(*system, rtol=1e-8, certificate="interval")
    b = hinf_norm(*system, rtol=1e-8, certificate="hamiltonian")
    assert (a.certificate, b.certificate) == ("interval", "hamiltonian")
    assert a.value == pytest.approx(b.value, rel=1e-8)
    assert a.omega == pytest.approx(b.omega, rel=1e-6)
    gain = np.linalg.norm(refined_response(*system, a.omega), 2)
    assert gain == pytest.approx(a.value, rel=1e-12)


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


def test_no_norm_is_below_the_gain_at_infinity() -> None:
    """A loop with entries from 1e-6 to 1e11, as cheap control has it: its Hamiltonian matrix shows no crossing.

    The norm is from responses with 50 digits.
    """
    A = np.zeros((6, 6))
    A[0, 1], A[2, 0], A[2, 2] = 0.03125, -0.015625, -0.01
    A[1, 3:] = -2211992728.0294785, -12112.794388593087, 140825477150.168
    A[3, [0, 3, 4, 5]] = 0.0023291032001037256, -6.814972268896504, 0.03124103431866137, 433.78265744213877
    A[4, [0, 3, 4, 5]] = 5.2556028858700195e-05, -2211992728.183258, -12112.794388795397, 140825477159.95627
    A[5, [0, 3, 4, 5]] = -0.015630381472815594, 0.015746185685898695, 2.0715373450523524e-08, -1.0122670461382768
    B = np.array([[0.0, 0.0, 0.00048828125, -7.278447500324142e-05, -1.6423759018343811e-06, 0.0004884494210254873]]).T
    C = np.array([[-32.0, 0.0, 2027.52, 0.0, 0.0, 0.0], [3.2, 0.0, 0.0, 0.0, 0.0, 0.0]])
    norm = hinf_norm(A, B, C, [[1.0], [0.0]])
    assert norm.value == pytest.approx(1.0001745766, rel=1e-7) and norm.value <= norm.upper


def test_a_direct_solution_that_meets_a_pole_leaves_no_exception(monkeypatch: pytest.MonkeyPatch) -> None:
    """Once: a PoleError, for a loop with entries of 1e8 and a pole at -4e-11; its poles are the axis to rounding."""

    def at_pole(model: object, levels: int) -> None:
        raise PoleError("a pole")

    monkeypatch.setattr(norms, "bracketed_norm", at_pole)
    norm = hinf_norm(*oscillator(1.0, 0.1), certificate="interval")
    assert norm.upper == np.inf and norm.certificate == "unstable"


SHAPES = [(1, 1), (1, 3), (3, 1), (2, 2), (4, 3), (2, 5)]


def random_system(seed: int, shape: tuple[int, int], feedthrough: float = 0.5) -> tuple[np.ndarray, ...]:
    """Up to twelve states, slowest decay 0.05 rad/s, spectral radius about one."""
    rng = np.random.default_rng(seed)
    n, (p, m) = int(rng.integers(1, 13)), shape
    A = rng.normal(size=(n, n)) / np.sqrt(n)
    A -= (np.linalg.eigvals(A).real.max() + 0.05) * np.eye(n)
    return A, rng.normal(size=(n, m)), rng.normal(size=(p, n)), feedthrough * rng.normal(size=(p, m))


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("modal", [True, False])
def test_derivatives_of_response_and_gain_agree_with_differences(shape: tuple[int, int], modal: bool) -> None:
    A, B, C, D = random_system(3, shape)
    form = FrequencyResponse.of(A, B, C, D)
    if not modal:
        T, Q = np.diag(form.poles), np.eye(len(A))
        form = FrequencyResponse(form.poles, form.left @ Q, Q @ form.right, D, T)
    assert form.modal == modal
    h, w = 1e-4, 0.7
    low, middle, high = (form.with_derivatives(x) for x in (w - h, w, w + h))
    for k in (0, 1):
        np.testing.assert_allclose(middle[k + 1], (high[k] - low[k]) / (2 * h), rtol=1e-5, atol=1e-6)
    np.testing.assert_allclose(middle[0], form.at(w)[0], rtol=1e-12)
    below, value, above = (squared_gain(*found) for found in (low, middle, high))
    assert value[0] == pytest.approx(np.linalg.norm(middle[0], 2) ** 2, rel=1e-12)
    for k in (0, 1):
        assert value[k + 1] == pytest.approx((above[k] - below[k]) / (2 * h), rel=1e-4, abs=1e-5)


@pytest.mark.parametrize("size", [1e-160, 1e-60, 1e60])
def test_gains_whose_powers_are_no_numbers_are_not_lost(size: float) -> None:
    """Of one input, where the gain is a root of a sum of squares, and of two; at both ends of the range."""
    for B in (np.array([[1.0], [-2.0]]), np.array([[1.0, 0.5], [-2.0, 0.3]])):
        A, C, D = np.array([[-0.1, 1.0], [-1.0, -0.1]]), np.array([[1.0, 0.2], [0.4, -0.7]]), np.zeros((2, B.shape[1]))
        expected = hinf_norm(A, B, C, D)
        found = hinf_norm(A, B * size, C, D)
        assert found.value == pytest.approx(expected.value * size, rel=1e-7)
        assert found.value <= found.upper <= found.value * (1.0 + 2e-7)


@pytest.mark.parametrize("dt", [None, 0.1])
def test_what_is_not_sound_is_left_to_the_other_ways(dt: float | None) -> None:
    """Unstable, poles at the circle to rounding, no basis of eigenvectors, hidden gain."""
    one, gap = np.eye(2), 0.0 if dt is None else 1.0
    for a in (0.1, 0.0, *([] if dt is None else [-1e-15])):
        norm = hinf_norm((a + gap) * one, one, one, 0.0 * one, dt=dt)
        assert (norm.value, norm.certificate) == (np.inf, "unstable")
    chain = np.array([[gap - 0.5, 1.0], [0.0, gap - 0.5]])
    assert hinf_norm(chain, one[:, 1:], one[:1], np.zeros((1, 1)), dt=dt).value == pytest.approx(4.0, rel=1e-7)
    hidden = hinf_norm((gap - 0.5) * one, one[:, :1], one[1:], np.zeros((1, 1)), dt=dt)
    assert hidden.value == 0.0 and hidden.upper < 1e-12
