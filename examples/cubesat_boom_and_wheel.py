"""A CubeSat of 12 kg with a deployed boom and one reaction wheel: wheel imbalance to pointing error.

python examples/cubesat_boom_and_wheel.py

The wheel spins about z; its speed and the first frequency of the boom are parameters. Printed are the poles of the
free spacecraft, the effect of a torque of the wheel, which must be that of the rigid inertias, and the pointing error
that the imbalance of the wheel causes at speeds below, at and above the first resonance of the boom.
"""

import numpy as np

from lftkit import Port, RealParameter, System, connect, invert
from titop_plant import ports
from titop_plant.blocks.attitude_control import attitude
from titop_plant.blocks.flexible_body import flexible_body, rigid_body
from titop_plant.blocks.mounting import mounted
from titop_plant.blocks.reaction_wheel import ReactionWheel, reaction_wheel
from titop_plant.structures import Beam, BeamFrame, LumpedMass, from_inertia, to_modal_data
from titop_plant.structures.sections import tube

WHEEL = ReactionWheel(mass=0.13, axial_inertia=4e-5, radial_inertia=2.3e-5)
STATIC_IMBALANCE = 2e-8  # kg m
SPEED = RealParameter("wheel.speed", 300.0, 0.0, 800.0, "rad/s")
ARCSEC = np.pi / 648_000


def cubesat() -> System:
    """Ports: imbalance (5) [N, Nm] and wheel_torque [Nm] -> angle_G (3) [rad], wheel_accel [rad/s2]."""
    tape = tube({"E": 70e9, "G": 26e9, "density": 2700.0}, diameter=0.012, thickness=0.0004)
    tip = LumpedMass("tip", 0.15, np.diag([2e-5, 2e-5, 2e-5]), name="magnetometer")
    frame = BeamFrame("boom", {"root": [0, 0, 0], "tip": [0, 1.0, 0]}, (Beam("root", "tip", tape, elements=6),), (tip,))
    modes = to_modal_data(frame, "root", [], n_modes=4, damping=0.005)
    w1 = float(modes.frequencies[0])
    omega_1 = RealParameter("boom.omega_1", w1, 0.9 * w1, 1.1 * w1, "rad/s")
    boom = mounted(flexible_body(modes, frequencies={0: omega_1}), "root", "A")
    places = {"A": np.array([0.0, 0.17, 0.05]), "W": np.array([0.0, 0.0, -0.05])}
    hub = rigid_body("hub", "G", from_inertia(12.0, np.diag([0.12, 0.08, 0.13]), [0, 0, 0]), places)
    wheel = reaction_wheel(WHEEL, SPEED, "W")
    imbalance, torque, rate = (
        next(p for p in wheel.inputs if p.name == n) for n in ("imbalance", "wheel_torque", "rate_W")
    )
    driven = connect(
        {"hub": hub, "boom": boom, "wheel": wheel},
        [
            ("accel_G", "hub.accel_G"),
            ("hub.accel_A", "boom.accel_A"),
            ("boom.wrench_A", "hub.wrench_A"),
            ("hub.accel_W", "wheel.accel_W"),
            ("wheel.wrench_W", "hub.wrench_W"),
            ("rate_W", "wheel.rate_W"),
            ("imbalance", "wheel.imbalance"),
            ("wheel_torque", "wheel.wheel_torque"),
        ],
        inputs=[ports.accel("G"), rate, imbalance, torque],
        outputs={"wrench_G": "hub.wrench_G", "wheel_accel": "wheel.wheel_accel"},
    )
    free = invert(driven, {"accel_G": "wrench_G"})  # no wrench from outside: the input wrench_G stays zero
    return connect(
        {"free": free, "attitude": attitude("G")},
        [
            ("imbalance", "free.imbalance"),
            ("wheel_torque", "free.wheel_torque"),
            ("none", "free.wrench_G"),
            ("free.accel_G", "attitude.accel_G"),
            ("attitude.rate_G", "free.rate_W"),
        ],
        inputs=[imbalance, torque, Port("none", 6, ports.wrench("G").unit)],
        outputs={"angle_G": "attitude.angle_G", "accel_G": "free.accel_G", "wheel_accel": "free.wheel_accel"},
    )


def main() -> System:
    """Print the results; returns the spacecraft."""
    system = cubesat()
    print(system)
    poles = system.nominal().poles()
    flexible = np.unique(np.abs(poles[np.abs(poles) > 5.0]).round(2))
    print("modes of the free spacecraft:", flexible[:3], "rad/s")
    still = system.at({"wheel.speed": 0.0})
    low = (still.C @ np.linalg.solve(0.05j * np.eye(system.order) - still.A, still.B) + still.D).real
    column = 5  # wheel_torque, behind the imbalance (5)
    print(f"1 mNm of the wheel turns the hub by {1e-3 * low[3 + 5, column]:.4f} rad/s2 about z")
    for speed in (0.5 * flexible[0], flexible[0], 2.0 * flexible[0], 800.0):
        data = system.at({"wheel.speed": min(float(speed), 800.0)})
        force = STATIC_IMBALANCE * speed**2 * np.array([1.0, -1.0j, 0.0, 0.0, 0.0, 0.0])  # turns with the wheel
        vector = np.concatenate([force, np.zeros(6)])
        response = data.C @ np.linalg.solve(1j * speed * np.eye(system.order) - data.A, data.B @ vector)
        angle = np.linalg.norm((response + data.D @ vector)[:3]) / ARCSEC
        print(f"imbalance at {speed:6.1f} rad/s: {1e3 * angle:.3g} mas")
    return system


if __name__ == "__main__":
    main()
