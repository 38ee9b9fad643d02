"""Guaranteed bounds of the telescope's loop: the model that is proven, parts, violated levels, the camera's frames."""

from __future__ import annotations

import dataclasses
import itertools
import math
import time
from collections.abc import Sequence
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import trapezoid
from support.loop_rows import FRAME_TICKS
from support.slow_cases import slow

from lftkit import SampledSystem
from lftkit.arrays import ComplexArray, FloatArray
from lftkit.proofs.sampled_loop import LoopModel, LoopProof, check_loop_proof
from lftkit.proofs.sampled_loop.bounds import member_gains
from lftkit.proofs.trusted.noise import NoisePart, NoiseProof, check_noise_proof
from lftkit.proofs.trusted.proof import ProofError
from lftkit.support.workers import Workers
from los_design.search.worst_points import WorstPoint
from los_design.synthesis.store import load_designs
from los_design.verification.certify import (
    PartResult,
    ProofLevel,
    ProofPart,
    certify_figure,
    kept_part,
    parts_of,
    prove_part,
    task_of,
)
from los_design.verification.frames import IMAGES, LIMITS, SEEN, frames_share
from los_design.verification.loop_models import (
    NYQUIST,
    box_of,
    figures_of,
    frames_of,
    margins_of,
    noise_model,
    telescope_model,
)
from los_design.verification.noise_certificate import ABOVE, seen_gain
from los_loop.implemented_loop import ImplementedLoop
from los_loop.noise import noise_covariances, noise_rms
from los_loop.open_loop import OpenLoop
from titop_plant.interface import DT

FIXTURES = Path(__file__).parents[2] / "fixtures"
BAND = (200.0, 205.0)


@pytest.fixture(scope="module")
def loop(system, telescope) -> ImplementedLoop:
    return ImplementedLoop(
        OpenLoop(system, telescope, telescope.loop_ports.used_by()), *load_designs("implemented"), "fsm+pma"
    )


@pytest.fixture(scope="module")
def part(loop: ImplementedLoop, tmp_path_factory: pytest.TempPathFactory) -> ProofPart:
    model = telescope_model(loop, figures_of(loop.telescope, loop.stage, loop.ports)["fast"])
    return ProofPart(model, box_of(loop), BAND, 1.0, math.inf, tmp_path_factory.mktemp("parts") / "000.npz")


def deviations(loop: ImplementedLoop, points) -> np.ndarray:
    """Points of the unit cube as deviations from the nominal values, the angle [rad]."""
    values = loop.open.low + points * loop.open.width - loop.open.nominal
    values[:, -1] = 4.0 * np.arctan(values[:, -1])
    return values


@pytest.mark.parametrize("stage", ["isolator", "fsm", "fsm+pma"])
def test_the_model_has_the_gains_of_the_implemented_loop(stage: str, system, telescope) -> None:
    """All figures, random members and frequencies; 16 occurrences of the angle in place of 32."""
    loop = ImplementedLoop(
        OpenLoop(system, telescope, telescope.loop_ports.used_by()), *load_designs("implemented"), stage
    )
    rng = np.random.default_rng(3)
    for metric in figures_of(telescope, stage, telescope.loop_ports.used_by()).values():
        model = telescope_model(loop, metric)
        assert model.sizes[0] == 32
        low, high = max(metric.band[0], 0.02), min(metric.band[1], 3000.0)
        for omega in np.exp(rng.uniform(np.log(low), np.log(high), 4)):
            points = np.vstack([rng.uniform(size=(5, 7)), rng.integers(0, 2, (3, 7))])  # ends: half a turn among them
            expected = loop.gains(loop.at(float(omega)), metric, points)
            np.testing.assert_allclose(member_gains(model, float(omega), deviations(loop, points)), expected, rtol=1e-5)


def test_the_models_of_margins_have_the_sensitivities_of_the_implemented_loop(loop: ImplementedLoop) -> None:
    """S, T = S - I, and what T is for one more tick, at random members and frequencies."""
    rng = np.random.default_rng(5)
    points = rng.uniform(size=(5, 7))
    for name, metric in margins_of(loop.telescope, loop.stage, loop.ports).items():
        model, channels = telescope_model(loop, metric), slice(metric.rows.start - 2, metric.rows.stop - 2)
        for omega in (0.3, 7.4, 198.0, 2500.0):
            S = loop.sensitivities(loop.at(omega), points)[:, channels, channels]
            T = S - np.eye(S.shape[1])
            change = 2.0 * abs(math.sin(0.5 * omega * model.dt))
            kind = S if name.startswith("sensitivity") else T if name.startswith("gain") else change * T
            expected = np.linalg.norm(kind, ord=2, axis=(1, 2)) / metric.limit
            found = member_gains(model, omega, deviations(loop, points))
            np.testing.assert_allclose(found, expected, rtol=1e-5, atol=1e-9)


def test_bands_and_parts_leave_no_frequency_out(telescope) -> None:
    figures = figures_of(telescope, "fsm+pma", telescope.loop_ports.used_by())
    assert set(figures) == {"APE", "slow", "fast", "mirror", "force"}
    assert figures["slow"].band[1] == figures["fast"].band[0] and figures["fast"].band[1] == NYQUIST
    for metric in figures.values():
        parts = parts_of(metric.band)
        assert parts[0][0] == metric.band[0] and parts[-1][1] == metric.band[1]
        assert all(before[1] == after[0] for before, after in itertools.pairwise(parts))


def test_a_part_of_the_band_is_proven_checked_and_kept(part: ProofPart, loop: ImplementedLoop) -> None:
    found = prove_part(part)
    assert found.finished and not found.uncovered and part.file.exists()
    again = prove_part(part)
    assert len(again.strips) == len(found.strips) and again.seconds == found.seconds
    assert kept_part(dataclasses.replace(part, level=1e-3)) is None, "what is kept is checked again"
    names = tuple(p.name for p in loop.system.parameters)
    proof = LoopProof(part.model, names, part.box, BAND, 1.0, again.strips)
    assert check_loop_proof(proof).windows >= found.windows > 0
    louder = dataclasses.replace(part.model, C=4.0 * part.model.C)
    with pytest.raises(ProofError):
        check_loop_proof(dataclasses.replace(proof, model=louder))
    with pytest.raises(ProofError, match="hole"):
        check_loop_proof(dataclasses.replace(proof, band=(199.0, 205.0)))


@pytest.mark.further
@pytest.mark.parametrize("name", ["sensitivity, mirror", "gain x0.5, mirror", "one more tick, mirror"])
def test_a_part_of_a_margin_is_proven_over_the_box(name: str, loop: ImplementedLoop, tmp_path: Path) -> None:
    """Where the mirror's loop acts, below its limit; not far below what members have."""
    model, box, band = (
        telescope_model(loop, margins_of(loop.telescope, loop.stage, loop.ports)[name]),
        box_of(loop),
        (7.42, 7.48),
    )
    found = prove_part(ProofPart(model, box, band, 1.0, math.inf, tmp_path / "part.npz"))
    assert found.finished and not found.uncovered
    names = tuple(p.name for p in loop.system.parameters)
    proof = LoopProof(model, names, box, band, 1.0, found.strips)
    assert check_loop_proof(proof, stability=False).windows > 0
    reached = float(member_gains(model, 7.45, np.zeros((1, 7)))[0])
    with pytest.raises(ProofError):
        check_loop_proof(dataclasses.replace(proof, level=0.99 * reached), stability=False)


def test_a_part_of_the_noise_is_proven_near_what_members_have(loop: ImplementedLoop, tmp_path: Path) -> None:
    whole, box, band = noise_model(loop), box_of(loop), (20.0, 20.8)
    model = dataclasses.replace(whole, rows=(0,))
    level = ABOVE * seen_gain(model, box, band)
    found = prove_part(ProofPart(model, box, band, level, math.inf, tmp_path / "part.npz"))
    assert found.finished and not found.uncovered and found.lower < level
    part = NoisePart((0,), band, level, found.strips)
    proof = NoiseProof(whole, tuple(p.name for p in loop.system.parameters), box, (part,))
    assert check_loop_proof(proof.of_part(part), stability=False).windows > 0
    with pytest.raises(ProofError, match="parts"):
        check_noise_proof(proof, stability=False)


@pytest.mark.parametrize("stage", [pytest.param("fsm", marks=pytest.mark.further), "fsm+pma"])
def test_the_noise_of_the_model_is_that_of_the_sampled_loop(stage: str, system, telescope) -> None:
    """The integral of both axes' gains at the nominal member against the Lyapunov equation of the periodic loop."""
    pair = load_designs("implemented")
    own = ImplementedLoop(OpenLoop(system, telescope, telescope.loop_ports.used_by()), *pair, stage)
    model, zero = noise_model(own), np.zeros((1, 7))
    omega = np.unique(np.concatenate([np.geomspace(1e-3, NYQUIST, 250), np.linspace(1.0, NYQUIST, 150)]))
    power = np.zeros(len(omega))
    for row in model.rows:
        axis = dataclasses.replace(model, rows=(row,))
        power += [float(member_gains(axis, float(w), zero)[0]) ** 2 for w in omega]
    found = model.scale * math.sqrt(model.dt / math.pi * trapezoid(power, omega))
    exact = noise_rms(noise_covariances(own.system.at({}), *pair, telescope, loop=stage))[0]
    assert found == pytest.approx(exact, rel=0.01)


def test_a_part_of_another_level_is_used(part: ProofPart, tmp_path: Path) -> None:
    """What holds for the lower level is taken from the part before: the strips are its own."""
    first = prove_part(part)
    lower = dataclasses.replace(part, level=0.97, file=tmp_path / "000.npz", others=(part.file,))
    found = prove_part(lower)
    assert found.finished and not found.uncovered
    before = {(node, strip.box) for strip in first.strips for node in strip.nodes}
    after = {(node, strip.box) for strip in found.strips for node in strip.nodes}
    assert len(before & after) > 0.8 * len(before)
    assert check_loop_proof(LoopProof(part.model, tuple("1234567"), part.box, BAND, 0.97, found.strips)).level == 0.97


@pytest.mark.parametrize("left", [slow(0), 0.5, slow(-1)], ids=["empty", "half", "all but one"])
def test_a_damaged_part_is_proven_again(
    left: float, part: ProofPart, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """As an interruption of power may leave it; as help for another level it is left out."""
    whole = (prove_part(part), part.file.read_bytes())
    data = whole[1][: int(left * len(whole[1])) if left == 0.5 else int(left)]
    damaged = dataclasses.replace(part, file=tmp_path / "000.npz")
    damaged.file.write_bytes(data)
    assert task_of(dataclasses.replace(part, others=(damaged.file,))).others == ((),)
    capsys.readouterr()
    found = prove_part(damaged)
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(f"part {tmp_path.name}/000.npz is damaged (") and line.endswith(" and is proven again")
    assert found.finished and not found.uncovered and len(found.strips) == len(whole[0].strips)
    assert kept_part(damaged) is not None and not capsys.readouterr().err


def test_a_part_without_time_is_open_and_not_kept(part: ProofPart, tmp_path: Path) -> None:
    late = dataclasses.replace(part, until=time.monotonic() - 1.0, file=tmp_path / "000.npz")
    found = prove_part(late)
    assert not found.finished and found.uncovered == [BAND] and not late.file.exists()


def test_the_level_of_a_known_worst_point_is_violated(system, telescope, tmp_path: Path) -> None:
    """Controllers of before, without margins: 40 mas is broken by 1.484."""
    pair = [SampledSystem.from_file(FIXTURES / f"{name}_without_margin.json") for name in ("k_fsm", "k_pma")]
    loop = ImplementedLoop(OpenLoop(system, telescope, telescope.loop_ports.used_by()), *pair, "fsm+pma")
    values = dict(zip(loop.names, (-789.9, 1047.2, 1047.2, 1047.2, 0.7801, 2.7825, -0.789)))
    known = [WorstPoint("fsm+pma", "fast", 1.484, 40.0, 683.9, values, np.zeros(22), np.zeros(2))]
    until = time.monotonic() + 600.0
    with Workers() as workers:
        each = partial(workers.each, prove_part)
        found = certify_figure(loop, "fast", ProofLevel(), known, tmp_path, each, until, lambda done, total: None)
    assert found.status == "violated" and found.lower > 1.47 and math.isinf(found.upper)
    assert not list(tmp_path.glob("*.npz")), "above the limit: no part was tried"


def test_a_member_above_the_level_raises_it(loop: ImplementedLoop, tmp_path: Path) -> None:
    """A search has found too little: the figure is far from its limit, and nothing is violated."""
    tries: list[float] = []

    def prove(parts: Sequence[ProofPart]) -> list[PartResult]:
        level = parts[0].level
        tries.append(level)
        gains = [0.3 if low > 100.0 else 0.2 for low, _ in (part.band for part in parts)]
        covered = [gain < level for gain in gains]
        return [
            PartResult((), [] if fits else [part.band], gain, [0.0] * 7, part.band[0], 1, 0.0, True)
            for part, gain, fits in zip(parts, gains, covered)
        ]

    zero = {p.name: p.nominal for p in loop.system.parameters}
    known = [WorstPoint("fsm+pma", "fast", 0.1, 40.0, 300.0, zero, np.zeros(22), np.zeros(2))]
    until = time.monotonic() + 600.0
    for level, last in ((ProofLevel(gap=0.02), 1.019 * 0.3), (ProofLevel(0.25), 1.01 * 0.3), (ProofLevel(), 1.0)):
        tries.clear()
        found = certify_figure(loop, "fast", level, known, tmp_path, prove, until, lambda done, total: None)
        assert (found.status, found.lower) == ("proven", 0.3) and found.upper == tries[-1] == pytest.approx(last)


def test_no_part_is_proven_below_a_gain_that_is_reached(part: ProofPart, tmp_path: Path) -> None:
    """A level 2 % below the gain of a member in the band: never covered."""
    rng = np.random.default_rng(0)
    members = np.array(part.box)[:, 0] + rng.uniform(size=(40, 7)) * np.ptp(np.array(part.box), axis=1)
    reached = max(float(member_gains(part.model, omega, members).max()) for omega in np.linspace(200.5, 201.5, 7))
    low = dataclasses.replace(part, band=(200.0, 202.0), level=0.98 * reached, file=tmp_path / "000.npz")
    assert prove_part(dataclasses.replace(low, until=time.monotonic() + 0.5)).uncovered


@pytest.fixture(scope="module", params=["fsm", "fsm+pma"])
def either(request: pytest.FixtureRequest, system, telescope) -> ImplementedLoop:
    return ImplementedLoop(
        OpenLoop(system, telescope, telescope.loop_ports.used_by()), *load_designs("implemented"), request.param
    )


def member(model: LoopModel, omega: float, deviations: FloatArray) -> ComplexArray:
    """Response of a member: Delta closed."""
    q = model.sizes[0]
    z, e = model.at(omega)
    delta = np.zeros(q)
    for k, (group, angle) in enumerate(zip(model.groups, model.angle)):
        delta[list(group)] = np.tan(0.5 * deviations[k]) if angle else deviations[k]
    return e[:, q:] + (e[:, :q] * delta) @ np.linalg.solve(np.eye(q) - z[:, :q] * delta, z[:, q:])


def members(either: ImplementedLoop, count: int) -> FloatArray:
    low, high = np.array(box_of(either)).T
    rng = np.random.default_rng(5)
    inside = rng.uniform(size=(count, len(low)))
    return low + np.where(rng.uniform(size=inside.shape) < 0.6, np.round(inside), inside) * (high - low)


def test_the_closed_gain_is_the_sensitivity_of_the_opened_one(either: ImplementedLoop) -> None:
    """``S = (I - L)^-1`` at members, though the one has the camera's loop closed and the other one open."""
    metrics = frames_of(either.telescope, either.stage, either.ports)
    closed, opened = (telescope_model(either, metrics[name]) for name in (SEEN, IMAGES))
    for deviations in members(either, 4):
        for omega in (0.05, 3.0, 8.0, 60.0, 157.0):
            S, L = member(closed, omega, deviations), member(opened, omega, deviations)
            np.testing.assert_allclose(S @ (np.eye(2) - L), np.eye(2), atol=1e-7 * np.linalg.norm(S))


def test_found_members_keep_both_limits_and_their_periodic_loop_is_stable(either: ImplementedLoop) -> None:
    found = dict.fromkeys(LIMITS, 0.0)
    drawn = members(either, 3)
    for name, metric in frames_of(either.telescope, either.stage, either.ports).items():
        model = telescope_model(either, metric)
        for omega in np.geomspace(max(metric.band[0], 5.0), metric.band[1], 40):
            found[name] = max(found[name], *(float(np.linalg.norm(member(model, omega, one), 2)) for one in drawn))
    assert 1.5 < found[SEEN] < LIMITS[SEEN] and 5e-5 < found[IMAGES] < LIMITS[IMAGES]
    share = frames_share(LIMITS, FRAME_TICKS)
    assert share is not None and share < 0.1 and frames_share({SEEN: 3.0}, FRAME_TICKS) is None
    for values in either.system.sample_values(np.random.default_rng(3), 2):
        assert either.sampled_at(values)[1].spectral_radius() < 1.0


def test_images_of_a_held_sample_are_those_of_the_argument() -> None:
    """A signal of one frequency, sampled and held: its images have the fundamental's factor at their own frequency."""
    N, frames, bin_ = FRAME_TICKS, 40, 7
    ticks = np.arange(N * frames)
    omega = 2.0 * np.pi * bin_ / (N * frames * DT)
    held = np.exp(1j * omega * DT * (ticks // N * N))
    for image in range(N):
        w = omega + 2.0 * np.pi * image / (N * DT)
        found = np.mean(held * np.exp(-1j * w * DT * ticks))
        assert found == pytest.approx(np.mean(np.exp(-1j * w * DT * np.arange(N))), abs=1e-12)
