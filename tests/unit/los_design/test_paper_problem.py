"""The paper's own problem: curves by plain complex algebra, numbers, diagrams, pictures; designs at their bound."""

from __future__ import annotations

import itertools
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import paper_numbers
import pytest
from block_diagrams import WIDTH, Diagram, draw_diagram, fsm_synthesis, names, pma_synthesis
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from oracles.accurate_response import extended_response
from paper_case import FAMILY, PaperCase
from paper_figures import FIGURES, draw
from support.paper_problem import actuator_structure, observer_requirements

from fsm_pma_controller.problem import actuator_plant
from lftkit import SampledSystem, System
from lftkit.arrays import FloatArray
from lftkit.tuning import certify
from los_design.figures import plant_figures
from los_design.search.worst_case_search import points_with_ends
from los_design.synthesis.options import DesignOptions
from los_design.synthesis.state_space_requirements import paper_requirements
from los_design.synthesis.store import continuous
from los_design.synthesis.synthesis import design_actuators, design_observer
from los_design.verification.verification import check_paper
from los_estimator.problem import observer_plant
from los_loop.continuous_loop import continuous_open_loop
from titop_plant.disturbances.responses import Curve
from titop_plant.interface import STAGES
from titop_plant.telescope.assembly import assembled_telescope
from titop_plant.telescope.load import load_telescope

ARCSEC = np.pi / 648000.0
PAPER = Path(__file__).parents[3] / "examples" / "paper"
FILE, STORED = str(PAPER / "telescope.toml"), ("k_fsm", "k_pma", "k_fsm_nominal", "k_pma_nominal")


def first_worst(system: SampledSystem, count: int) -> SampledSystem:
    """The same design with so many worst members in its file."""
    worst = system.provenance.get("worst_cases", [])[:count]
    return replace(system, provenance={**system.provenance, "worst_cases": worst, FAMILY: []})


def stored(name: str) -> SampledSystem:
    """A design of the paper's telescope."""
    return SampledSystem.from_file(PAPER / "designs" / f"{name}.json")


@pytest.fixture(scope="module")
def case() -> PaperCase:
    """The paper's telescope and its designs; the nominal member and a worst one."""
    _, k_pma, *nominal = (first_worst(stored(name), 0) for name in STORED)
    pairs = {"robust": (first_worst(stored("k_fsm"), 1), k_pma), "nominal": (nominal[0], nominal[1])}
    return PaperCase(FILE, pairs, samples=0, corners=False)


def law(system: SampledSystem, s: complex) -> np.ndarray:
    """Response of the continuous controller in a file."""
    A, B, C, D = (np.array(system.provenance["continuous"][key]) for key in "ABCD")
    return C @ np.linalg.solve(s * np.eye(len(A)) - A, B) + D


def by_hand(case: PaperCase, stage: str, values: dict[str, float], omega: float) -> float:
    """Largest singular value [arcsec], from the response of the open telescope and the printed filters and weights."""
    s = 1j * omega
    plant = assembled_telescope(load_telescope(FILE), isolated=stage != "none").system.at(values)
    (G,) = extended_response(*plant.matrices, [omega])
    w = plant.input_indices(["wheel_imbalance", "sadm_torque"])
    wheel = np.array([0.4, 0.4, 0.35, 0.3, 0.3]) * abs((s + 5.101e-5) / (s + 5.101))
    weight = np.r_[np.tile(wheel, 4), 0.1, 0.1]
    los = plant.output_indices(["los_controlled"])
    closed = G[np.ix_(los, w)]
    if stage not in ("none", "isolator"):
        seen = plant.output_indices(["accel_Ip", "accel_M1", "accel_M2", "los_controlled", "fsm_angle"])
        filters = np.r_[np.full(18, s / (s + 0.1)), np.full(2, 100.0 / (s**2 + 14.0 * s + 100.0)), 1.0, 1.0]
        u = plant.input_indices(["fsm_command", "pma_force"])
        K = np.zeros((8, 22), dtype=complex)
        K[:2] = -law(case.pairs["robust"][0], s) / 0.1
        if stage == "fsm+pma":
            K[2:, :6] = law(case.pairs["robust"][1], s)
        K = K * filters
        loop = np.linalg.solve(np.eye(8) - K @ G[np.ix_(seen, u)], K @ G[np.ix_(seen, w)])
        closed = closed + G[np.ix_(los, u)] @ loop
    return float(np.linalg.svd(closed * weight, compute_uv=False)[0]) / ARCSEC


@pytest.mark.parametrize("stage", STAGES)
def test_curves_are_those_of_plain_algebra(case: PaperCase, stage: str) -> None:
    """At three frequencies of one member, the worst one of the design; what is drawn is the same to a line's width."""
    values = case.members[1]
    exact, drawn = case.loop("robust").curve(stage, values, tolerance=1e-9), case.clouds("robust")[stage][1]
    assert drawn.size == pytest.approx(exact.size, rel=1e-5)
    for omega in (0.06, 4.7, 380.0):
        k = int(np.argmin(np.abs(exact.omega - omega)))
        assert exact.size[k] == pytest.approx(by_hand(case, stage, values, float(exact.omega[k])), rel=1e-9)


def test_the_peak_of_a_curve_is_the_certified_gamma(case: PaperCase) -> None:
    """APE of K_FSM at the nominal member: the norm of the assembled loop with its weights."""
    (ape, *_) = paper_requirements(case.telescope, "fsm")
    plant = observer_plant(case.telescope)
    found = certify([plant({})], continuous(case.pairs["robust"][0]), [ape]).values.item()
    assert case.clouds("robust")["fsm"][0].size.max() / 10.0 == pytest.approx(found, rel=1e-3)


def test_a_member_with_an_unstable_loop_is_counted_not_drawn(case: PaperCase) -> None:
    """K_PMA with its sign turned round and a thousand times its gain; the mirror alone is as before."""
    k_fsm, k_pma = case.pairs["robust"]
    matrices = k_pma.provenance["continuous"]
    wrong = {**matrices, **{key: (-1e3 * np.array(matrices[key])).tolist() for key in "CD"}}
    pair = (k_fsm, replace(k_pma, provenance={**k_pma.provenance, "continuous": wrong}))
    unstable = PaperCase(FILE, {"robust": pair}, samples=0, corners=False)
    clouds = unstable.clouds("robust")
    assert np.isinf([curve.size.max() for curve in clouds["fsm+pma"]]).all()
    assert clouds["fsm"][0].size == pytest.approx(case.clouds("robust")["fsm"][0].size)
    figure = Figure()
    FIGURES["stages_robust"][1](figure, unstable)
    labels = [text.get_text() for text in figure.legends[0].get_texts()]
    assert "isolator + FSM + PMA (2 of 2 unstable)" in labels and "isolator + FSM" in labels
    assert len(figure.axes[0].lines) == 3 * 2 + 4 + 3


def test_gammas_are_rows_of_the_paper_s_limits(case: PaperCase, monkeypatch: pytest.MonkeyPatch) -> None:
    """Robust over the members, nominal at one and over the members; an unstable loop is said to be one."""
    asked = []

    def check(telescope, k_fsm, k_pma, at):
        asked.append((k_fsm.name, len(at)))
        return {"fsm": [0.5, 0.6, np.inf], "pma": [0.1, 0.2, 0.3, 0.4]}

    monkeypatch.setattr(paper_numbers, "check_paper", check)
    rows = paper_numbers.gammas(case)
    robust, nominal = (case.pairs[name][0].name for name in ("robust", "nominal"))
    assert asked == [(robust, 2), (nominal, 1), (nominal, 2)]
    published = [row for row in rows if row["variant"] == "published, nominal"]
    assert published[1]["gammas"] == {"APE": 0.7115, "RPE": 0.7115, "noise -> APE": 0.6150, "force": 0.4266}
    assert {row["variant"] for row in rows if row["status"]} == {"robust", "nominal"}
    assert rows[0]["gammas"] == {"APE": 0.5, "RPE": 0.6, "mirror": "inf"}
    assert [row["variant"] for row in rows[:5]] == [row["variant"] for row in rows[5:]]


def test_what_the_proof_masses_take_is_in_decibels() -> None:
    """A tenth from 30 rad/s on, and a peak that is between the columns' middles."""
    omega = np.geomspace(0.5, 2000.0, 3001)
    alone = Curve(omega, np.ones_like(omega))
    both = Curve(omega, np.where(omega < 30.0, 1.0, 0.1))
    with_peak = Curve(omega, np.where(np.arange(omega.size) == np.searchsorted(omega, 200.0), 0.5, both.size))
    case = PaperCase(None, {}, 0, 0, None, False, {"robust": {"fsm": [alone, alone], "fsm+pma": [both, with_peak]}})
    rows = {tuple(row["band"]): row for row in paper_numbers.reduction(case)}
    assert rows[1.0, 6.0]["nominal"] == 0.0 and rows[30.0, 100.0]["nominal"] == pytest.approx(20.0)
    assert rows[100.0, 300.0]["peaks"] == pytest.approx(20.0 * np.log10(2.0))
    assert rows[100.0, 300.0]["peak_mas"] == pytest.approx([1000.0, 500.0])
    assert rows[100.0, 300.0]["family"] == pytest.approx([20.0, 20.0])


def test_the_wheels_exceed_the_drives_by_decades(case: PaperCase) -> None:
    rows = paper_numbers.decades(case)
    edges = [1.0, 6.0, 10.0, 30.0, 100.0, 300.0, 1000.0]
    assert [row["band"] for row in rows] == [list(band) for band in itertools.pairwise(edges)]
    assert all(row["family"][0] <= row["nominal"] <= row["family"][1] for row in rows)
    assert 1.0 < rows[0]["nominal"] < 3.5


COMMON = (
    r"\Delta_\Omega", r"\Delta_\tau", r"\Delta_{A_\bullet}", "W_{rws}", "W_{sa}", r"\tilde w_{rws}", r"\tilde w_{sa}",
    "$w_{rws}$", "$w_{sa}$", "F_w", "F_{LOS}", r"\sigma_a", r"\sigma_{LOS}", r"\sigma_{FSM}", r"\tilde n_{a_p}",
    r"\tilde n_{a_m}", r"\tilde n_{LOS}", r"\tilde n_{FSM}", "W_{APE}", "e_{APE}", "W_{RPE}", "e_{RPE}", "S_{FSM}^{-1}",
    "K_{FSM}", "u_{fsm}", r"\widehat{LOS}", "LOS_c$", "LOS_c^m", r"\theta_{fsm}$", r"\theta_{fsm}^m", r"\ddot x_{I_p}$",
    r"\ddot x_{I_p}^m", r"\ddot x_{M_1}", r"\ddot x_{M_2}^m",
)  # fmt: skip


@pytest.mark.parametrize(
    ("diagram", "own"),
    [
        (fsm_synthesis(), (r"\mathcal{P}", "W_{u_{fsm}}", "e_u^{fsm}")),
        (pma_synthesis(), (r"\mathcal{Q}", "W_{RPE}^f", "e_{RPE}^f", "W_{u_{pma}}", "e_u^{pma}", "u_{pma}", "K_{PMA}")),
    ],
    ids=["fsm", "pma"],
)
def test_diagrams_have_every_signal_inside_their_bounds(diagram: Diagram, own: tuple[str, ...]) -> None:
    text = "\n".join(names(diagram))
    assert not [name for name in (*COMMON, *own) if name not in text]
    figure = Figure(figsize=(8.6, 6.0))
    canvas = FigureCanvasAgg(figure)
    axes = draw_diagram(figure, diagram)
    canvas.draw()
    drawn = {item.get_text() for item in axes.texts}
    assert drawn >= {*names(diagram)}
    assert all(0.0 <= x <= WIDTH and 0.0 <= y <= diagram.height for points, _ in diagram.wires for x, y in points)


def test_no_two_names_of_a_diagram_overlap() -> None:
    """Nor does one lie across the edge of a block."""
    for diagram in (fsm_synthesis(), pma_synthesis()):
        figure = Figure(figsize=(8.6, 8.6 * diagram.height / WIDTH))
        canvas = FigureCanvasAgg(figure)
        axes = draw_diagram(figure, diagram)
        canvas.draw()
        boxes = [(item.get_text(), item.get_window_extent()) for item in axes.texts if item.get_text()]
        overlapping = [(one, two) for k, (one, a) in enumerate(boxes) for two, b in boxes[k + 1 :] if a.overlaps(b)]
        assert not overlapping


def test_every_picture_is_drawn_and_small(case: PaperCase, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(plant_figures, "MEMBERS", 1)
    monkeypatch.setattr(plant_figures, "STEPS", 6)
    paths = draw(case, tmp_path / "one")
    assert [path.name for path in paths] == [f"{name}.png" for name in FIGURES]
    assert all(10_000 < path.stat().st_size < 150_000 for path in paths)
    for again in draw(case, tmp_path / "two", ["synthesis_fsm", "stages_robust"]):
        assert again.read_bytes() == (tmp_path / "one" / again.name).read_bytes()


def test_a_picture_that_does_not_exist_is_refused(case: PaperCase, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"names must be of disturbances_to_los, .* got 'stage'"):
        draw(case, tmp_path / "out", ["stage"])
    assert not (tmp_path / "out").exists()


def test_a_case_is_read_from_a_folder(tmp_path: Path) -> None:
    (tmp_path / "designs").mkdir()
    for name in STORED:
        shutil.copy(PAPER / "designs" / f"{name}.json", tmp_path / "designs")
    with pytest.raises(ValueError, match=r"telescope\.toml"):
        PaperCase.of(tmp_path)
    (tmp_path / "telescope.toml").write_text('base = "reference"\n')
    found = PaperCase.of(tmp_path, samples=2)
    assert found.pairs["nominal"][1].name == stored("k_pma_nominal").name and found.alone is None
    assert len(found.members) == 1 + 128 + 2 + len(found.worst_members) and found.members[0] == {}
    with pytest.raises(ValueError, match="samples must not be negative, got -1"):
        PaperCase.of(tmp_path, samples=-1)


def largest_error(telescope) -> float:
    """Largest line of sight of the nominal telescope on its isolator [rad], normalised disturbances."""
    loop = continuous_open_loop(telescope)
    omega = np.geomspace(0.03, 0.12, 60)
    responses: list[FloatArray] = [loop.closed_over(lft, loop.point({})[None])[0] for lft in loop.at(omega)]
    return max(float(np.linalg.norm(r[-2:, : loop.disturbances], 2)) for r in responses)


@pytest.fixture(scope="module")
def k_fsm():
    telescope = load_telescope(FILE)
    return design_observer(telescope, DesignOptions(nominal=True, loop_delay=0.0))


def test_the_nominal_k_fsm_is_at_the_bound_of_the_mirror(k_fsm) -> None:
    """APE >= (L0 - reach g3) / limit for every observer; the design is there, by the norms of the assembled loop."""
    telescope = load_telescope(FILE)
    assert k_fsm.provenance["status"] == "converged"
    asked = observer_requirements(telescope)
    found = certify([observer_plant(telescope)({})], continuous(k_fsm), asked)
    gammas = dict(zip((r.name for r in asked), found.upper[:, 0]))
    assert found.abscissae.max() < 0.0
    for name, value in k_fsm.provenance["tuned_values"].items():
        assert gammas[name] == pytest.approx(value, rel=5e-3)  # samples beside a peak
    reach = telescope.fsm.authority * telescope.fsm.los_sensitivity
    floor = (largest_error(telescope) - reach * gammas["mirror"]) / telescope.weights.ape_limit
    assert floor * (1.0 - 1e-3) <= gammas["APE"] <= floor * 1.01
    assert gammas["mirror"] <= 1.0 + 1e-5


def test_noise_asked_of_k_fsm_is_that_of_the_platform_behind_an_idle_k_pma(k_fsm) -> None:
    """From the plant of K_FSM with the observer closed, and from that of K_PMA with no force."""
    telescope, observer = load_telescope(FILE), continuous(k_fsm)
    noise = observer_requirements(telescope)[-1]
    alone = certify([observer_plant(telescope)({})], observer, [noise]).values.item()
    plant = actuator_plant(telescope, observer)
    structure = actuator_structure(plant)
    size = structure.outputs[0].size, structure.inputs[0].size
    idle = System.static(np.zeros(size), structure.inputs, structure.outputs)
    (both,) = (r for r in paper_requirements(telescope, "fsm+pma") if r.name == noise.name)
    assert 0.1 < alone < 1.0
    assert abs(certify([plant({})], idle, [both]).values.item() / alone - 1.0) < 1e-6


@pytest.mark.slow
def test_the_nominal_k_pma_is_converged_and_certified(k_fsm) -> None:
    telescope, options = load_telescope(FILE), DesignOptions(nominal=True, loop_delay=0.0, starts=2)
    k_pma = design_actuators(telescope, k_fsm, options)
    asked = paper_requirements(telescope, "fsm+pma")
    plant = actuator_plant(telescope, continuous(k_fsm))
    found = certify([plant({})], continuous(k_pma), asked)
    assert k_pma.provenance["status"] == "converged" and len(k_pma.provenance["starts"]) == 2
    assert found.abscissae.max() < 0.0
    for requirement, upper in zip(asked, found.upper[:, 0], strict=True):
        assert upper == pytest.approx(k_pma.provenance["tuned_values"][requirement.name], rel=5e-3)
        assert upper <= k_fsm.provenance["tuned_values"]["APE"] * 1.001 or requirement.hard


ENDS = [
    # wheels [rad/s], array modes [rad/s], tan(theta / 4): worst members of the pair that was tuned on uniform samples
    ([-1047.2, -1047.2, 1047.2, 578.2634], 0.7414, 2.76, 0.3766),
    ([1047.2, -1047.2, -1047.2, 588.763], 0.706, 2.7825, -0.664),
    ([1047.2, -1047.2, -1047.2, 598.905], 0.764, 2.7825, -0.676),
]


def test_the_robust_pair_keeps_its_limits_where_wheels_are_at_the_ends_of_their_speeds() -> None:
    """Peaks there are narrow in the speeds: 800 uniform members show none of them."""
    whole = PaperCase.of(PAPER)
    names = [f"wheel_{k}.speed" for k in (1, 2, 3, 4)]
    members = [
        dict(zip([*names, "solar_array.omega_1", "solar_array.omega_2", "solar_array.tau"], [*speeds, *rest]))
        for speeds, *rest in ENDS
    ]
    found = check_paper(whole.telescope, *whole.pairs["robust"], members)
    assert max(found["fsm"] + found["pma"]) < 1.0 and found["pma"][1] > 0.95


def test_corners_are_among_the_members_and_ends_among_the_samples() -> None:
    whole = PaperCase.of(PAPER)
    table = np.array([list(member.values()) for member in whole.members if len(member) == 7])
    low, high = table.min(axis=0), table.max(axis=0)
    corners = table[((table == low) | (table == high)).all(axis=1)]
    assert len(np.unique(corners > low, axis=0)) == 128
    points = points_with_ends(np.random.default_rng(0), 400, 7)
    assert 0.6 < np.mean((points == 0.0) | (points == 1.0)) < 0.9 and ((points >= 0.0) & (points <= 1.0)).all()
