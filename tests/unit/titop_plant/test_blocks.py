"""Laws of the TITOP blocks."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import linalg
from scipy.spatial.transform import Rotation

from lftkit import Port, RealParameter, invert
from titop_plant.blocks.attitude_control import attitude_control
from titop_plant.blocks.fast_steering_mirror import FastSteeringMirror, fast_steering_mirror
from titop_plant.blocks.flexible_body import flexible_body, rigid_body
from titop_plant.blocks.isolator import Isolator, MountedActuator, actuated_platform, isolator
from titop_plant.blocks.proof_mass_actuator import ProofMassActuator, proof_mass_actuator
from titop_plant.blocks.reaction_wheel import (
    MountedWheel,
    ReactionWheel,
    reaction_wheel,
    spin_frame,
    wheel_assembly,
)
from titop_plant.blocks.revolute_joint import on_revolute_joint
from titop_plant.blocks.rotation import turned
from titop_plant.structures import Beam, BeamFrame, ModalData, Section, from_inertia, to_modal_data

STEEL = Section(E=2.1e11, G=8.1e10, density=7850.0, A=4e-4, Iy=1.3e-8, Iz=2.0e-8, J=2.6e-8)


def beam(length: float = 1.0, modes: int = 40, damping: float = 0.0, elements: int = 10) -> ModalData:
    """Cantilever along x from P to C."""
    nodes = {"P": np.zeros(3), "C": np.array([length, 0.0, 0.0])}
    frame = BeamFrame("beam", nodes, (Beam("P", "C", STEEL, elements=elements),), ())
    return to_modal_data(frame, "P", ("C",), modes, damping)


def response(system, s, outputs=None, inputs=None):
    part = system.select(outputs=outputs, inputs=inputs)
    return part.nominal()(s)


def test_reciprocity() -> None:
    """Transfer P -> C equals the transposed transfer C -> P, at any frequency."""
    body = flexible_body(beam(damping=0.01))
    for s in (0.1j, 300j, 5e3j):
        there = response(body, s, ["accel_C"], ["accel_P"])
        back = response(body, s, ["wrench_P"], ["wrench_C"])
        np.testing.assert_allclose(there, back.T, rtol=1e-9, atol=1e-9)


def test_a_damped_body_is_passive() -> None:
    """The power into the driven base is not negative at any frequency (impedance W / (a / s))."""
    body = flexible_body(beam(modes=12, damping=0.02))
    for w in np.geomspace(1.0, 5e4, 60):
        reaction = -response(body, 1j * w, ["wrench_P"], ["accel_P"]) * 1j * w
        hermitian = 0.5 * (reaction + reaction.conj().T)
        assert np.min(linalg.eigvalsh(hermitian)) > -1e-9 * np.abs(reaction).max()


def _scalar_channels(body):
    """The block with scalar inputs u0..u11 (accel_P, wrench_C) and collocated outputs y0..y11 (wrench_P, accel_C)."""
    both = body.select(outputs=["wrench_P", "accel_C"])
    ins, outs = (tuple(Port(f"{kind}{i}", 1) for i in range(12)) for kind in "uy")
    return replace(both, inputs=ins, outputs=outs)


def test_all_twelve_channels_invert_one_by_one() -> None:
    block, s = _scalar_channels(flexible_body(beam(modes=96, elements=16, damping=0.01))), 200j
    H = block.nominal()(s)
    for i in range(12):
        T = invert(block, {f"u{i}": f"y{i}"}).nominal()(s)
        assert T[i, i] == pytest.approx(1.0 / H[i, i], rel=1e-6)
        others = [k for k in range(12) if k != i]
        closed = H[np.ix_(others, others)] - np.outer(H[others, i], H[i, others]) / H[i, i]
        np.testing.assert_allclose(T[np.ix_(others, others)], closed, atol=1e-6 * np.abs(H).max())


def _frequencies(system, count: int) -> np.ndarray:
    poles = linalg.eigvals(system.at({}).A)
    return np.sort(np.abs(poles.imag[poles.imag > 1e-3]))[:count]


def test_inverting_the_base_gives_the_free_free_beam() -> None:
    """Clamped-free -> free-free: bending beta L = 4.73004074, 7.85320462 in both planes."""
    free = invert(flexible_body(beam(elements=16, modes=60)), {"accel_P": "wrench_P"})
    base = np.sqrt(STEEL.E / (STEEL.density * STEEL.A))
    expected = np.sort([beta**2 * base * np.sqrt(I) for beta in (4.73004074, 7.85320462) for I in (STEEL.Iy, STEEL.Iz)])
    found = _frequencies(free.select(inputs=["wrench_P"], outputs=["accel_P"]), 4)
    np.testing.assert_allclose(found, expected, rtol=2e-3)


def test_uncertain_frequency_and_damping_equal_the_rebuilt_body() -> None:
    data = beam(modes=3, damping=0.01)
    w, z = RealParameter("w", 100.0, 80.0, 130.0, "rad/s"), RealParameter("z", 0.02, 0.001, 0.05)
    body = flexible_body(data, frequencies={0: w}, dampings={0: z, 2: RealParameter("z2", 0.01, 0.0, 0.1)})
    assert body.occurrences() == {"w": 2, "z": 1, "z2": 1}
    values = {"w": 127.0, "z": 0.004, "z2": 0.07}
    frequencies, damping = data.frequencies.copy(), data.damping.copy()
    frequencies[0], damping[0], damping[2] = values["w"], values["z"], values["z2"]
    rebuilt = flexible_body(
        ModalData("x", "P", np.zeros(3), data.mass_matrix, frequencies, damping, data.participation, data.children)
    )
    for s in (5j, 127j, 900j):
        expected = rebuilt.nominal()(s)
        np.testing.assert_allclose(body.at(values)(s), expected, atol=1e-9 * np.abs(expected).max())


def test_a_body_rotated_by_tau_equals_the_rotated_modal_data() -> None:
    data, axis, theta = beam(modes=6, damping=0.01), [0.0, 0.0, 1.0], 0.7
    block = turned(
        flexible_body(data).select(inputs=["accel_P"], outputs=["wrench_P"]),
        "P",
        axis,
        RealParameter("tau", 0.0, -1.0, 1.0),
    )
    assert block.occurrences() == {"tau": 16}
    built = flexible_body(
        data.rotated(Rotation.from_rotvec(theta * np.asarray(axis) / np.linalg.norm(axis)).as_matrix())
    )
    for s in (1j, 400j):
        expected = response(built, s, ["wrench_P"], ["accel_P"])
        np.testing.assert_allclose(
            block.at({"tau": np.tan(theta / 4)})(s), expected, atol=1e-9 * np.abs(expected).max()
        )


def test_a_joint_frees_one_axis_and_no_other() -> None:
    inertia = np.diag([2.0, 3.0, 4.0])
    body = rigid_body("b", "P", from_inertia(5.0, inertia, [0.1, 0.2, -0.1]))
    joint = on_revolute_joint(body, "P", [0, 1, 0], stiffness=90.0, damping=0.0)
    fast = -response(joint, 1e5j, ["wrench_P"], ["accel_P"])
    assert abs(fast[4, 4]) < 1e-6  # no apparent inertia about the free axis
    slow = -response(joint, 1e-4j, ["wrench_P"], ["accel_P"])
    np.testing.assert_allclose(slow, from_inertia(5.0, inertia, [0.1, 0.2, -0.1]), atol=1e-6)
    about_axis = from_inertia(5.0, inertia, [0.1, 0.2, -0.1])[4, 4]
    assert _frequencies(joint, 1)[0] == pytest.approx(np.sqrt(90.0 / about_axis), rel=1e-9)


def test_fast_steering_mirror_equals_its_closed_form() -> None:
    J, k, d = np.diag([3e-5, 4e-5, 6e-5]), 77.0, 0.015
    block = fast_steering_mirror(FastSteeringMirror(0.05, J, k, d))
    s = 900j
    for i in (0, 1):
        expected = k / (J[i, i] * s**2 + d * s + k)
        assert response(block, s, ["fsm_angle"], ["fsm_command"])[i, i] == pytest.approx(expected, rel=1e-10)
        dragged = -J[i, i] / (J[i, i] * s**2 + d * s + k)
        assert response(block, s, ["fsm_angle"], ["accel_If"])[i, 3 + i] == pytest.approx(dragged, rel=1e-10)
    assert block.order == 4


def test_proof_mass_actuator_slow_and_fast() -> None:
    pma = proof_mass_actuator(ProofMassActuator(2.5, 3.5, 1e-3 * np.eye(3), 70.0, 10.0))
    apparent = [-response(pma, s, ["wrench_P"], ["accel_P"])[2, 2].real for s in (1e-3j, 1e5j)]
    assert apparent == pytest.approx([6.0, 3.5], rel=1e-6)
    across = [-response(pma, s, ["wrench_P"], ["accel_P"])[0, 0].real for s in (1e-3j, 1e5j)]
    assert across == pytest.approx([6.0, 6.0], rel=1e-12)
    # Newton: force on the structure and the proof mass's acceleration are equal and opposite
    s = 8j
    stroke = response(pma, s, ["pma_stroke"], ["pma_force"])
    force = response(pma, s, ["wrench_P"], ["pma_force"])[2, 0]
    assert force == pytest.approx(-2.5 * s**2 * stroke, rel=1e-12)


def test_isolator_transmits_slow_motion_with_the_mass_of_its_platform() -> None:
    M = from_inertia(1.5, np.diag([0.4, 0.6, 1.0]), [0.01, 0.0, 0.02])
    block = isolator(Isolator(M, np.diag([5e6] * 3 + [1e6] * 3), 1e3 * np.eye(6)))
    np.testing.assert_allclose(response(block, 1e-2j, ["accel_C"], ["accel_P"]).real, np.eye(6), atol=1e-6)
    np.testing.assert_allclose(-response(block, 1e-2j, ["wrench_P"], ["accel_P"]).real, M, atol=1e-6)
    np.testing.assert_allclose(response(block, 1e-2j, ["wrench_P"], ["wrench_C"]).real, np.eye(6), atol=1e-6)
    # s^2 times the rotation of the platform is its angular acceleration while the base is at rest
    s = 700j
    angle = response(block, s, ["angle_C"], ["wrench_C"])
    np.testing.assert_allclose(s**2 * angle, response(block, s, ["accel_C"], ["wrench_C"])[3:], rtol=1e-9, atol=1e-12)


def test_actuators_on_a_platform_add_their_mass_and_force() -> None:
    M = from_inertia(10.0, np.eye(3), [0.0, 0.0, 0.0])
    plate = rigid_body("plate", "P", M, {"C": np.zeros(3)}, motion=True)
    one = MountedActuator(ProofMassActuator(2.5, 3.5, 1e-6 * np.eye(3), 70.0, 10.0), np.array([0.5, 0, 0]), np.eye(3))
    block = actuated_platform(plate, [one], "C")
    apparent = -response(block, 1e-3j, ["wrench_P"], ["accel_P"]).real
    np.testing.assert_allclose(apparent, M + from_inertia(6.0, 1e-6 * np.eye(3), [0.5, 0, 0]), atol=1e-5)
    force = response(block, 1e5j, ["wrench_P"], ["pma_force"])[:, 0].real
    np.testing.assert_allclose(force, [0, 0, -1.0, 0, 0.5, 0], atol=1e-6)


def test_attitude_law_is_stable_on_a_rigid_body() -> None:
    """Closed around J theta'' = u the law gives the specified poles."""
    J = np.array([9e3, 4e3, 8e3])
    axes = np.array([[0.58, -0.58, -0.58, 0.58], [0.58, 0.58, -0.58, -0.58], [0.57, 0.57, 0.57, 0.57]])
    law = attitude_control(J, axes, bandwidth=0.06, damping=0.7).nominal().D
    body_torque = axes @ law  # on the structure
    Kp, Kd = -body_torque[:, :3], -body_torque[:, 3:]
    np.testing.assert_allclose(np.diag(Kp) / J, 0.06**2, rtol=1e-9)
    np.testing.assert_allclose(np.diag(Kd) / J, 2 * 0.7 * 0.06, rtol=1e-9)
    with pytest.raises(ValueError, match="rank 3"):
        attitude_control(J, axes[:, :2], bandwidth=0.06, damping=0.7)


@pytest.mark.parametrize(
    "axis", [[0.3, 0.4, 1.0], [1.0, 0.0, 0.0], [1e-5, 0.0, 1.0], [0.0, 0.0, 2.0], [0.0, 0.0, -2.0]]
)
def test_a_wheel_frame_is_a_rotation_with_z_along_the_axis_and_a_horizontal_x(axis: list[float]) -> None:
    R, across = spin_frame(axis), np.cross([0.0, 0.0, 1.0], axis)
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-12)
    assert linalg.det(R) == pytest.approx(1.0)
    np.testing.assert_allclose(R @ axis / linalg.norm(axis), [0.0, 0.0, 1.0], atol=1e-12)
    assert R[0, 2] == pytest.approx(0.0, abs=1e-15)
    assert R[0] @ across > 0.0 if across.any() else R[0].tolist() == [1.0, 0.0, 0.0]


@given(st.floats(-1000.0, 1000.0), st.floats(-1000.0, 1000.0))
@settings(max_examples=20, deadline=None)
def test_wheel_equals_newton_and_euler(speed: float, nominal: float) -> None:
    """All ports at once, for random motion, torque and imbalance."""
    m, Jw, Jr = 3.5, 0.096, 0.047
    wheel = reaction_wheel(ReactionWheel(m, Jw, Jr), RealParameter("speed", nominal, -1000.0, 1000.0))
    a, omega_dot, omega, w = (np.random.default_rng(k).standard_normal(n) for k, n in enumerate((3, 3, 3, 5)))
    u = 0.7
    out = wheel.at({"speed": speed}).D @ np.r_[a, omega_dot, omega, u, w]
    force = -m * a + w[:3]
    gyroscopic = -Jw * speed * np.array([omega[1], -omega[0], 0.0])
    torque = np.array([-Jr * omega_dot[0] + w[3], -Jr * omega_dot[1] + w[4], u]) + gyroscopic
    np.testing.assert_allclose(out, np.r_[force, torque, -u / Jw - omega_dot[2]], rtol=1e-12, atol=1e-13)
    assert [(p.name, p.size) for p in wheel.inputs] == [
        ("accel_G", 6),
        ("rate_G", 3),
        ("wheel_torque", 1),
        ("imbalance", 5),
    ]
    assert [(p.name, p.size) for p in wheel.outputs] == [("wrench_G", 6), ("wheel_accel", 1)]


def test_assembly_is_the_sum_of_its_wheels() -> None:
    """Two wheels with lever arms and axes of their own, moved from frame to frame by hand."""
    data = [ReactionWheel(3.5, 0.096, 0.047), ReactionWheel(2.0, 0.05, 0.03)]
    axes = np.array([[0.6, 0.0, 0.8], [0.0, -1.0, 1.0]])
    positions = np.array([[0.3, -0.2, 0.1], [-0.4, 0.5, 0.2]])
    speeds = [120.0, -300.0]
    block = wheel_assembly(
        [
            MountedWheel(d, axis, r, RealParameter(f"wheel_{i + 1}.speed", 0.0, -1000.0, 1000.0))
            for i, (d, axis, r) in enumerate(zip(data, axes, positions))
        ]
    )
    assert block.occurrences() == {"wheel_1.speed": 2, "wheel_2.speed": 2}
    rng = np.random.default_rng(4)
    a, omega_dot, omega, u, w = (rng.standard_normal(n) for n in (3, 3, 3, 2, 10))
    force, torque, spin = np.zeros(3), np.zeros(3), np.zeros(2)
    for i, (d, axis, r) in enumerate(zip(data, axes, positions)):
        R = spin_frame(axis)
        acceleration, turning, rate = R @ (a + np.cross(omega_dot, r)), R @ omega_dot, R @ omega
        f = -d.mass * acceleration + w[5 * i : 5 * i + 3]
        t = np.r_[-d.radial_inertia * turning[:2] + w[5 * i + 3 : 5 * i + 5], u[i]]
        t -= d.axial_inertia * speeds[i] * np.array([rate[1], -rate[0], 0.0])
        force += R.T @ f
        torque += R.T @ t + np.cross(r, R.T @ f)
        spin[i] = -u[i] / d.axial_inertia - turning[2]
    values = {f"wheel_{i + 1}.speed": s for i, s in enumerate(speeds)}
    out = block.at(values).D @ np.r_[a, omega_dot, omega, u, w]
    np.testing.assert_allclose(out, np.r_[force, torque, spin], rtol=1e-10, atol=1e-12)
    assert [p.size for p in block.inputs] == [6, 3, 2, 10] and [p.size for p in block.outputs] == [6, 2]
