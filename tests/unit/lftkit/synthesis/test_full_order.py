"""Full-order synthesis: published values, an independent bound, conservation by the bilinear map, and refusals."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest
from oracles.full_order_bound import full_order_bound
from scipy import linalg
from support.slow_cases import slow

from lftkit import InputError, Port, System, hinf_norm, loop_margins, s
from lftkit.synthesis import augw, h2syn, hinfsyn, mixsyn, ncfsyn
from lftkit.synthesis.riccati_controllers import central, lowest_level
from lftkit.synthesis.standard_plant import standard_plant
from lftkit.synthesis.working_plant import gain_out_of_reach
from lftkit.systems.sampled.bilinear import to_discrete
from lftkit.systems.symbolic.expressions import Expression
from lftkit.tuning.published_plants import BEST_KNOWN, PLANTS


def system(expression: Any) -> System:
    made: System = expression.system("u", "y")
    return made


def random_plant(seed: int, states: int, through: bool = False) -> System:
    """Generalised plant with weights on all commands and noise on all measurements; half of its modes unstable."""
    rng = np.random.default_rng(seed)
    nw, nu, nz, ny = 3, 2, 3, 2
    A, B, C = (rng.standard_normal(shape) for shape in ((states, states), (states, nw + nu), (nz + ny, states)))
    D = np.zeros((nz + ny, nw + nu))
    D[:nz, nw:], D[nz:, :nw] = rng.standard_normal((nz, nu)), rng.standard_normal((ny, nw))
    if through:
        D[:nz, :nw], D[nz:, nw:] = rng.standard_normal((nz, nw)), 0.1 * rng.standard_normal((ny, nu))
    return System(A, B, C, D, (Port("w", nw), Port("u", nu)), (Port("z", nz), Port("y", ny)), "P")


def norm(closed: System) -> float:
    return hinf_norm(*closed.matrices, dt=closed.dt or None).value


def stable(closed: System) -> bool:
    poles = linalg.eigvals(closed.A)
    return bool(np.abs(poles).max() < 1.0 if closed.dt else poles.real.max() < 0.0)


NESTED: Any = [["u"]]
DISTURBANCE = 200 / ((10 * s + 1) * (0.05 * s + 1) ** 2)


def test_loop_shaping_at_a_level() -> None:
    """The same book, example 9.3: with 1.1 times the least level the margins are 3.48 and 51.5 degrees."""
    plant, weight = system(DISTURBANCE), system((s + 2) / s)
    least = ncfsyn(plant, weight)
    found = ncfsyn(plant, weight, level=1.1 * least.lower)
    assert found.lower == least.lower <= least.value < found.value <= 1.1 * least.lower * (1.0 + 1e-6)
    margins = loop_margins(-plant @ found.controller)
    assert round(margins.gain_range[1], 2) == 3.48 and round(margins.phase_margin, 1) == 51.5
    fastest = [abs(design.controller.poles()).max() for design in (least, found)]
    assert fastest[1] < fastest[0]
    for level in (least.lower, 1.0, -1.0):
        with pytest.raises(InputError, match=r"level must be above the least one, 2\.338"):
            ncfsyn(plant, weight, level=level)


def test_a_steeper_weight_reaches_its_independent_bound() -> None:
    weight = ((s / 1.5**0.5 + 10) / (s + 0.1)) ** 2
    plant = augw(system(DISTURBANCE), system(weight), 1.0)
    bound = full_order_bound(_with_one_error(plant))
    found = hinfsyn(plant, "y", "u")
    assert found.lower == pytest.approx(bound, rel=1e-4) and found.value == pytest.approx(bound, rel=1e-3)


def _with_one_error(plant: System) -> System:
    """z1 and z2 as one port z."""
    return System(*plant.matrices, plant.inputs, (Port("z", 2), Port("y", 1)), plant.name)


@pytest.mark.parametrize(
    ("plant", "margin"),
    [
        (1 / s, np.sqrt(0.5)),
        (1 / s**2, np.sin(np.pi / 8)),
        (1 / (s - 1), 1.0 / np.sqrt(1.0 + (1.0 + np.sqrt(2.0)) ** 2)),
    ],
)
def test_margins_of_coprime_factors_in_closed_form(plant: Expression, margin: float) -> None:
    """Of 1 / (s - a) the two Riccati equations are quadratic: X = Z = a + sqrt(a^2 + 1)."""
    found = ncfsyn(system(plant))
    assert 1.0 / found.lower == pytest.approx(margin, rel=1e-9) and found.value <= 1.0001 * found.lower
    assert stable(found.closed)


@pytest.mark.parametrize(
    ("seed", "through"), [(0, True), (3, False), *(slow(seed, through) for seed in (1, 2) for through in (False, True))]
)
def test_the_value_is_reached_and_no_controller_does_better(seed: int, through: bool) -> None:
    """Against existence conditions that share no code; the value is the norm of the assembled loop."""
    plant = random_plant(seed, 2 + seed % 5, through)
    found = hinfsyn(plant, "y", "u")
    assert stable(found.closed) and found.value == pytest.approx(norm(found.closed), rel=1e-9)
    without = System(plant.A, plant.B, plant.C, _without_d22(plant), plant.inputs, plant.outputs)
    bound = full_order_bound(without)
    assert found.lower <= 1.0001 * bound and found.value >= (1.0 - 1e-5) * bound and found.value <= 1.001 * bound


def _without_d22(plant: System) -> np.ndarray[Any, Any]:
    """The direct path from commands to measurements changes the controller, and not what it reaches."""
    D = plant.D.copy()
    D[np.ix_(plant.output_indices(["y"]), plant.input_indices(["u"]))] = 0.0
    return D


@pytest.mark.parametrize("seed", [0, slow(1), slow(2)])
def test_a_larger_level_is_kept_by_its_central_controller(seed: int) -> None:
    plant = random_plant(seed, 4)
    least = hinfsyn(plant, "y", "u").value
    found = hinfsyn(plant, "y", "u", level=2.0 * least)
    assert stable(found.closed) and found.value <= 2.0 * least
    with pytest.raises(ValueError, match="level must be one that a controller reaches, got"):
        hinfsyn(plant, "y", "u", level=0.9 * least)


@pytest.mark.parametrize("seed", [0, slow(1), slow(2)])
def test_a_sampled_plant_reaches_what_its_continuous_image_does(seed: int) -> None:
    plant, dt = random_plant(seed, 3), 0.1
    image = System(*to_discrete(*plant.matrices, dt), plant.inputs, plant.outputs, "P", dt)
    found = hinfsyn(image, "y", "u")
    assert found.controller.dt == dt and stable(found.closed)
    assert found.value == pytest.approx(hinfsyn(plant, "y", "u").value, rel=1e-3)


@pytest.mark.parametrize("seed", [0, slow(1), slow(2)])
def test_the_h2_controller_is_a_minimum(seed: int) -> None:
    """Random changes of the controller raise the norm, to second order: by more than rounding and never less."""
    from lftkit import close_loop, h2_norm

    plant = random_plant(seed, 3)
    found = h2syn(plant, "y", "u")
    assert stable(found.closed) and found.gap == 0.0
    rng, K = np.random.default_rng(seed), found.controller
    for size in (1e-3, 1e-2):
        changed = [M + size * rng.standard_normal(M.shape) for M in K.matrices[:3]]
        other = System(*changed, K.D, K.inputs, K.outputs)
        closed = close_loop(plant, other, ["w"], ["z"])
        assert not stable(closed) or h2_norm(*closed.matrices) >= found.value * (1.0 - 1e-12)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(("pole", "effort"), [(1e-2, 0.1), (1e-6, 0.1), (1e-4, None)])
def test_slow_weights_work_and_warn_of_nothing(pole: float, effort: float | None) -> None:
    """The commonest habit: an integrator in the weight of the error, moved a little to the left."""
    found = mixsyn(system(1 / (s + 1)), system((0.5 * s + 1) / (s + pole)), effort)
    assert stable(found.closed) and (effort is None or found.gap < 1e-2)


@pytest.mark.parametrize("rate", [1.0, 1e-2])
def test_a_double_slow_pole_of_a_weight_hides_no_controller(rate: float) -> None:
    """Of example 2.17 of Skogestad and Postlethwaite (2.21), in units of time.

    One solution is zero there but for rounding of 1e-7, with which no controller below 2.2092 was found.
    """
    t = s / rate
    plant = system(200 / ((10 * t + 1) * (0.05 * t + 1) ** 2))
    found = mixsyn(plant, system((t / 1.5**0.5 + 10) ** 2 / (t + 0.01) ** 2), 1.0)
    assert found.lower == pytest.approx(2.20606, rel=1e-4)
    assert found.lower < found.value < 1.001 * found.lower


@pytest.mark.parametrize("pole", [1.0, -1.0])
def test_slow_weights_in_units_of_time(pole: float) -> None:
    """The filter's equation is zero beside an unstable pole of the plant, and slow modes magnify rounding there.

    With it as computed 1.6 times the least norm was reached, depending on the unit, and no bound was found.
    """
    found = []
    for rate in (1.0, 1e-3, 1e4):
        t = s / rate
        weight = ((t / 1.5 + 2) / (t + 5e-6)) ** 2
        found.append(mixsyn(system(8 / (t + pole) / (t + 20)), system(weight), system(0.3 * (t + 1) / (1e-3 * t + 1))))
    assert max(one.value for one in found) < 1.003 * min(one.value for one in found)
    assert all(0.997 * one.value < one.lower < min(other.value for other in found) for one in found)


def test_weights_of_one_channel_are_those_of_each() -> None:
    plant = System(-np.eye(2), np.eye(2), np.eye(2), np.zeros((2, 2)), (Port("u", 2),), (Port("y", 2),), "G")
    alone = mixsyn(system(1 / (s + 1)), system(1 / (s + 0.1)), 0.5, 0.1)
    both = mixsyn(plant, system(1 / (s + 0.1)), 0.5, 0.1)
    assert both.value == pytest.approx(alone.value, rel=1e-3)


@pytest.mark.further
@pytest.mark.parametrize("name", ["AC2", "NN17", slow("HE1"), slow("PSM")])
def test_no_static_controller_is_better_than_full_order(name: str) -> None:
    """COMPleib plants whose measurements have no noise; a mode of AC2 at zero is not in the error."""
    found = hinfsyn(PLANTS[name](), "y", "u")
    assert found.lower <= found.value <= 1.0005 * BEST_KNOWN[name] and found.gap < 1e-3 and stable(found.closed)


@pytest.mark.further
@pytest.mark.parametrize("seed", [1, 8, slow(35)])
def test_without_noise_or_weights_no_other_controller_is_below_the_bound(seed: int) -> None:
    given = random_plant(seed, 3)
    direct = given.D * ([[1], [1], [1], [0], [0]] if seed % 2 else 0)  # no noise, and for some no weights either
    plant = System(given.A, given.B, given.C, direct, given.inputs, given.outputs, "P")
    found = hinfsyn(plant, "y", "u")
    others = [found.value * (1.0 + distance) for distance in (1e-3, 1e-2, 0.1, 1.0)]
    assert found.regularised > 0.0 and found.gap < 2e-3
    assert all(found.lower <= hinfsyn(plant, "y", "u", level).value for level in others)


@pytest.mark.further
def test_a_sampled_plant_without_direct_paths_has_a_controller() -> None:
    """As many states as disturbances and errors: the static gain for the least direct path of its image is infinite."""
    rng, dt = np.random.default_rng(0), 0.1
    A, B = np.split(linalg.expm(dt * np.vstack([rng.standard_normal((3, 8)), np.zeros((5, 8))]))[:3], [3], axis=1)
    ports = (Port("w", 3), Port("u", 2)), (Port("z", 3), Port("y", 2))
    found = hinfsyn(System(A, B, rng.standard_normal((5, 3)), np.zeros((5, 5)), *ports, "P", dt), "y", "u")
    assert found.regularised == 0.0 and 0.0 <= found.gap < 1e-4


def test_without_a_weight_on_commands_the_value_is_that_of_the_loop_and_has_no_bound() -> None:
    """Cheap control: the infimum is approached and not reached; what is said is the loop's own norm."""
    found = mixsyn(system(1 / (s + 1)), system(1 / (s + 0.1)))
    assert found.regularised > 0.0 and found.gap == np.inf
    assert found.value == pytest.approx(norm(found.closed), rel=1e-9) and found.value < 0.1


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: hinfsyn(random_plant(0, 2), "x", "u"), "outputs must be of z, y, got x"),
        (lambda: hinfsyn(random_plant(0, 2), "y", ["u", "w"]), "some inputs must be the controller's and some not"),
        (lambda: mixsyn(system(1 / (s + 1)), system(1 / s), 1.0), "the mode at 0 is not stable and must be seen in y"),
        (lambda: hinfsyn(random_plant(0, 2), 3, "u"), "outputs must be a name or names of ports, got 3"),
        (lambda: hinfsyn(random_plant(0, 2), "y", NESTED), "inputs must be a name or names of ports"),
        (lambda: hinfsyn(random_plant(0, 2), "y", "u", "low"), "level must be positive, got 'low'"),
        (lambda: hinfsyn(random_plant(0, 2), "y", "u", np.inf), "level must be positive, got inf"),
        (lambda: ncfsyn(system(1 / s), level=np.inf), "level must be above the least one, 1.41421, got inf"),
        (lambda: ncfsyn(system(1 / s), level="low"), "level must be a finite real number, got 'low'"),
        (lambda: hinfsyn(2.0, "y", "u"), "some outputs must be the controller's and some not, got y"),
        (lambda: augw(system(1 / (s + 1))), "one of the weights error, effort and output, got none"),
        (lambda: h2syn(random_plant(0, 2, through=True), "y", "u"), "D11 must be zero"),
        (lambda: mixsyn(system(1 / (s + 1)), random_plant(0, 1)), "z1 must have 1 inputs or one, got 5"),
    ],
)
def test_what_cannot_be_designed_says_which_assumption_fails(make: Any, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        make()


@pytest.mark.parametrize("seed", [0, slow(1), slow(2)])
def test_units_of_states_make_no_plant_unstabilisable(seed: int) -> None:
    """States in units that differ by 1e12: a plant that is controllable stays so, one with an unreached mode not."""
    rng = np.random.default_rng(seed)
    n = 4
    A, B, C = (rng.standard_normal(shape) for shape in ((n, n), (n, 3), (3, n)))
    units = 10.0 ** rng.uniform(-6.0, 6.0, n)
    ports = [("w", 2), ("u", 1)], [("z", 2), ("y", 1)]
    D = np.array([[0.0, 0, 0], [0, 0, 1], [0, 1, 0]])
    plant = System(A * units[:, None] / units, B * units[:, None], C / units, D, *ports)
    assert hinfsyn(plant, "y", "u").value > 0.0
    A[0], B[0, 2] = np.eye(n)[0], 0.0
    with pytest.raises(ValueError, match="the mode at 1 is not stable and must be reached from u"):
        hinfsyn(System(A * units[:, None] / units, B * units[:, None], C / units, D, *ports), "y", "u")


UNITS = {
    "commands": (1.0, 1.0, 1e-7, 1.0, 1.0),
    "measurements": (1.0, 1.0, 1.0, 1e-7, 1.0),
    "commands and measurements": (1.0, 1.0, 1e6, 1e-7, 1.0),
    "small disturbances": (1e-7, 1.0, 1.0, 1.0, 1.0),
    "large errors": (1.0, 1e6, 1.0, 1.0, 1.0),
    "seconds": (1.0, 1.0, 1.0, 1.0, 1e8),
    "all": (1e6, 1e-6, 1e-4, 1e5, 1e3),
}
"""Factors of disturbances, errors, commands, measurements and rates."""


def _in_units(plant: System, factors: tuple[float, ...]) -> System:
    w, z, u, y, rate = factors
    columns, rows = (
        np.repeat(pair, [p.size for p in side]) for pair, side in (((w, u), plant.inputs), ((z, y), plant.outputs))
    )
    A, B, C, D = plant.matrices
    matrices = rate * A, rate * B * columns, rows[:, None] * C, rows[:, None] * D * columns
    return System(*matrices, plant.inputs, plant.outputs, plant.name)


@cache
def _in_plain_units(seed: int) -> tuple[System, Any, Any]:
    """A plant with its two optimal controllers."""
    plant = random_plant(seed, 2 + seed, through=bool(seed % 2))
    return plant, hinfsyn(plant, "y", "u"), None if seed % 2 else h2syn(plant, "y", "u")


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("units", UNITS)
@pytest.mark.parametrize("seed", [2, slow(0), slow(3)])
def test_units_of_signals_and_time_are_factors_of_the_norm(seed: int, units: str) -> None:
    """Of w and z those of the norm, of u and y of the controller alone, and time is the root of a factor of H2."""
    plant, least, quiet = _in_plain_units(seed)
    given, (w, z, _, _, rate) = _in_units(plant, UNITS[units]), UNITS[units]
    found = hinfsyn(given, "y", "u")
    assert found.value / (w * z) == pytest.approx(least.value, rel=1e-5) and stable(found.closed)
    assert found.lower / (w * z) == pytest.approx(least.lower, rel=1e-5) and found.regularised == 0.0
    if not seed % 2:
        assert h2syn(given, "y", "u").value / (w * z * rate**0.5) == pytest.approx(quiet.value, 1e-6)


def test_a_resonance_in_small_units_is_reached_and_seen() -> None:
    """A mode without damping, from a command in one unit to a measurement in another; nothing disturbs it."""
    G, weight = 1.0 / (s**2 + 1e4), (s + 100) / (s + 0.1)
    plain = mixsyn(system(G), system(weight), 1.0)
    for u, y in ((1e-7, 1.0), (1e6, 1e-7)):
        given = mixsyn(system(u * y * G), system(weight), u * y)
        assert given.value == pytest.approx(plain.value, rel=1e-3) and stable(given.closed)
        assert given.lower <= plain.value and plain.lower <= given.value


def test_a_zero_on_the_axis_is_approached_and_the_norm_not_stated_too_low() -> None:
    """``z = s / (s - 1) u + w / (s - 1)``: every stabilising controller leaves the gain 1 at frequency 0.

    Controllers near to that have a closed pole near to 0, and rounding hides the norm of some.
    """
    ports = [("w", 1), ("u", 1)], [("z", 1), ("y", 1)]
    plant = System([[1.0]], [[1.0, 1.0]], [[1.0], [1.0]], [[0.0, 1.0], [1.0, 0.0]], *ports)
    found = hinfsyn(plant, "y", "u")
    assert stable(found.closed) and abs(found.closed(0.0)) == pytest.approx(1.0, rel=1e-3)
    assert found.lower <= 1.0 <= (1.0 + 1e-6) * found.value and found.value < 1.001


@pytest.mark.parametrize("rate", [1.0, 1e3])
@pytest.mark.parametrize(
    ("G", "bound"), [(lambda p: 1.0 / (p + 1) ** 2, 0.5), (lambda p: (1 - p) / (p + 2) ** 2, 1.5 / 1.001)]
)
def test_without_a_weight_of_commands_a_zero_of_the_plant_is_the_bound(G: Any, bound: float, rate: float) -> None:
    """W S is W at infinity, and at a zero to the right of the axis; loops come near to it."""
    p = s / rate
    found = mixsyn(system(G(p)), system((0.5 * p + 1) / (p + 1e-3)))
    assert found.lower == pytest.approx(bound, rel=1e-9)
    assert found.lower < found.value < 1.001 * bound and stable(found.closed)


def _with_hidden_modes(seed: int) -> System:
    """Modes at the right, some of them not seen in the errors and some not reached by the disturbances."""
    rng = np.random.default_rng(seed)
    n, (nw, nz, nu, ny) = int(rng.integers(2, 6)), (int(k) for k in rng.integers(1, 3, 4))
    poles = np.where(rng.random(n) < 0.5, rng.choice([1.0, 2.0, 0.0, 0.5, 3.0], n), -rng.uniform(0.2, 3, n))
    B, C = rng.standard_normal((n, nw + nu)), rng.standard_normal((nz + ny, n))
    for mode in range(n):
        C[:nz, mode] *= rng.random() >= 0.5
        B[mode, :nw] *= rng.random() >= 0.5
    T = linalg.qr(rng.standard_normal((n, n)))[0]
    D = np.zeros((nz + ny, nw + nu))
    for rows, columns in ((slice(nz), slice(nw)), (slice(nz, None), slice(nw)), (slice(nz), slice(nw, None))):
        D[rows, columns] = rng.standard_normal(D[rows, columns].shape) if rng.random() < 0.5 else 0.0
    ports = [("w", nw), ("u", nu)], [("z", nz), ("y", ny)]
    return System(T @ np.diag(poles) @ T.T, T @ B, C @ T.T, D, *ports)


@pytest.mark.parametrize("seed", [41, 194, 265, 358])
def test_a_mode_that_errors_do_not_see_bounds_nothing(seed: int) -> None:
    """It is a zero from commands to errors, where responses are rounding: 4.8 was out of reach, 3.2 is reached."""
    plant = _with_hidden_modes(seed)
    found = hinfsyn(plant, "y", "u")
    assert gain_out_of_reach(standard_plant(plant, "y", "u").extended) <= found.value * (1.0 + 1e-7)
    assert found.lower <= found.value and stable(found.closed)


def test_a_plant_without_states_has_a_gain_as_controller() -> None:
    """Parrott: of ``[[2 + d, 1], [1, 0]]`` with d free the least norm is that of the second row and column, 1."""
    D = np.array([[2.0, 1.0, 1.0], [1.0, 0.0, 0.0], [1.0, 0.0, 0.0]])
    found = hinfsyn(System.static(D, [("w", 2), ("u", 1)], [("z", 2), ("y", 1)]), "y", "u")
    assert found.controller.order == 0 and found.value == pytest.approx(1.0, rel=1e-4)
    assert found.lower == pytest.approx(1.0, rel=1e-4)


def _least_to_the_last_bit(plant: System) -> None:
    """Controllers at levels that approach the least one until two doubles are neighbours."""
    given = standard_plant(plant, "y", "u").extended
    found = lowest_level(given)
    assert found is not None
    low, high = found
    for _ in range(55):
        middle = 0.5 * (low + high)
        low, high = (low, middle) if central(given, middle) is not None else (middle, high)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("seed", [0, 3, *(slow(seed) for seed in (1, 2, 4, 5, 6, 7))])
def test_no_warning_reaches_the_user(seed: int) -> None:
    """Next to the least level the coupling of the two solutions is singular: such a level is refused, in silence."""
    plant = random_plant(seed, 2 + seed % 7, bool(seed % 2))
    hinfsyn(plant, "y", "u")
    _least_to_the_last_bit(plant)


@pytest.mark.parametrize(("states", "dt"), [(0, 0.0), (1, 0.0), (1, 0.1)])
def test_no_controller_is_the_best_of_a_plant_without_gain(states: int, dt: float) -> None:
    """z = u, y = w: the static plant was refused, beside a mode it was a division by zero."""
    B, ports = np.zeros((states, 2)), ([("w", 1), ("u", 1)], [("z", 1), ("y", 1)])
    plant = System(-0.1 * np.eye(states), B, B.T, [[0.0, 1.0], [1.0, 0.0]], *ports, dt=dt)
    found = hinfsyn(plant, "y", "u")
    assert found.value == found.lower == 0.0 and found.controller.order == 0 and not found.controller.D.any()
