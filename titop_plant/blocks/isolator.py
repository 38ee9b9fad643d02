"""Six-degree-of-freedom passive isolator with its platform, and the platform with proof-mass actuators.

A spring and a damper K, D (6 x 6) join the parent's point P and the platform's point C, which coincide
at rest. Twelve states: the displacement delta of C relative to P and its rate::

    M accel_C = -K delta - D delta' + wrench_C          (platform of mass matrix M at C)
    delta''   = accel_C - accel_P
    wrench_P  = K delta + D delta'

=================  ====  ================================================================
port               size  meaning
=================  ====  ================================================================
in ``accel_P``     6     acceleration twist of the parent's point
in ``angle_P``     3     its rotation; ``rate_P`` its rate
in ``wrench_C``    6     wrench on the platform by all that is mounted on it
out ``wrench_P``   6     by the isolator on its parent
out ``accel_C``    6     acceleration twist of the platform
out ``angle_C``    3     rotation of the platform; ``rate_C`` its rate
=================  ====  ================================================================

Source: the paper, "Proof-Mass Actuators" (isolator assembly). Neglected: mass of the springs (surge).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import linalg

from lftkit import Connection, Port, RealParameter, System, connect, static_gain
from lftkit.arrays import FloatArray
from titop_plant import ports
from titop_plant.blocks.mounting import mounted
from titop_plant.blocks.proof_mass_actuator import ProofMassActuator, proof_mass_actuator


@dataclass(frozen=True)
class Isolator:
    """Data of a 6-dof isolator.

    Parameters
    ----------
    mass_matrix : ndarray, shape (6, 6)
        Of the platform, at C.
    stiffness, damping : ndarray, shape (6, 6)
        K and D; translations [N/m], [N s/m], rotations [Nm/rad], [Nm s/rad].
    """

    mass_matrix: FloatArray
    stiffness: FloatArray
    damping: FloatArray


@dataclass(frozen=True)
class MountedActuator:
    """A proof-mass actuator on the platform.

    Parameters
    ----------
    actuator : ProofMassActuator
    position : ndarray, shape (3,)
        From the platform's point C [m].
    dcm : ndarray, shape (3, 3)
        From the platform's frame to the actuator's, whose z is the direction of motion.
    """

    actuator: ProofMassActuator
    position: FloatArray
    dcm: FloatArray


def isolator(
    data: Isolator,
    parent: str = "P",
    child: str = "C",
    stiffness: RealParameter | None = None,
    damping: RealParameter | None = None,
) -> System:
    """TITOP block of a 6-dof isolator with its platform (ports: see the module).

    Parameters
    ----------
    data : Isolator
    parent, child : str
        Names of P and C.
    stiffness, damping : RealParameter, optional
        Uncertain factors of K and of D, about 1: six occurrences each.

    Examples
    --------
    Well above its modes the transmissibility is small:

    >>> iso = isolator(Isolator(np.eye(6), 100.0 * np.eye(6), 1e-3 * np.eye(6)))
    >>> follow = iso["accel_C", "accel_P"].nominal()
    >>> round(abs(complex(follow(0.01j)[0, 0])), 4), round(abs(complex(follow(1000j)[0, 0])), 4)
    (1.0, 0.0001)
    """
    K, Dm = np.asarray(data.stiffness, float), np.asarray(data.damping, float)
    Minv = linalg.inv(np.asarray(data.mass_matrix, float))
    Z, I6 = np.zeros((6, 6)), np.eye(6)
    lift = np.hstack([-Minv @ K, -Minv @ Dm])  # accel_C per state
    A = np.vstack([np.hstack([Z, I6]), lift])
    B = np.zeros((12, 18))
    B[6:, :6], B[6:, 6:12] = -I6, Minv
    rotation = np.hstack([np.zeros((3, 3)), np.eye(3)])
    C = np.vstack(
        [
            np.hstack([K, Dm]),
            lift,
            np.hstack([rotation, np.zeros((3, 6))]),
            np.hstack([np.zeros((3, 6)), rotation]),
        ]
    )
    D = np.zeros((18, 18))
    D[6:12, 6:12] = Minv
    D[12:, 12:] = np.eye(6)
    factors = [(f, k) for f, k in ((stiffness, np.hstack([K, Z])), (damping, np.hstack([Z, Dm]))) if f is not None]
    # force of spring or damper z = k x; w = (factor - 1) z is added to it
    force = np.vstack([I6, -Minv, np.zeros((6, 6))])  # outputs by w
    for _, k in reversed(factors):
        B = np.hstack([np.vstack([Z, -Minv]), B])
        C = np.vstack([k, C])
        direct = np.vstack([np.zeros((len(D) - 18, 6)), force])
        D = np.vstack([np.zeros((6, 6 + D.shape[1])), np.hstack([direct, D])])
    return System(
        *(A, B, C, D),
        (ports.accel(parent), ports.wrench(child), ports.angle(parent), ports.rate(parent)),
        (ports.wrench(parent), ports.accel(child), ports.angle(child), ports.rate(child)),
        channels=tuple(factor.name for factor, _ in factors for _ in range(6)),
        elements=tuple(factor for factor, _ in factors),
    )


def actuated_platform(platform: System, actuators: Sequence[MountedActuator], child: str = "C") -> System:
    """Mount proof-mass actuators at the platform point `child` of a block.

    Parameters
    ----------
    platform : System
        Has ``wrench_<child>`` as input and ``accel_<child>`` as output (an isolator, or the bare
        platform).
    actuators : sequence of MountedActuator

    Returns
    -------
    System
        New ports ``pma_force`` [N] and ``pma_stroke`` [m], one signal per actuator;
        ``wrench_<child>`` remains an input for everything else mounted on the platform.
    """
    n = len(actuators)
    accel, wrench = ports.accel(child), ports.wrench(child)
    singles = [Port(f"force_{i}", 1, "N") for i in range(n)]
    strokes = [Port(f"stroke_{i}", 1, "m") for i in range(n)]
    force, stroke = Port("pma_force", n, "N"), Port("pma_stroke", n, "m")
    systems = {
        "platform": platform,
        "split": static_gain(np.eye(n), [force], singles),
        "join": static_gain(np.eye(n), strokes, [stroke]),
    }
    wires: list[Connection] = [
        (force.name, "split.pma_force"),
        ((wrench.name, *(f"pma{i}.{wrench.name}" for i in range(n))), f"platform.{wrench.name}"),
        *((p.name, f"platform.{p.name}") for p in platform.inputs if p.name != wrench.name),
    ]
    for i, one in enumerate(actuators):
        block = proof_mass_actuator(one.actuator)
        systems[f"pma{i}"] = mounted(block, "P", child, position=one.position, dcm=one.dcm)
        wires += [
            (f"platform.{accel.name}", f"pma{i}.{accel.name}"),
            (f"split.force_{i}", f"pma{i}.pma_force"),
            (f"pma{i}.pma_stroke", f"join.stroke_{i}"),
        ]
    return connect(
        systems,
        wires,
        inputs=[*platform.inputs, force],
        outputs={
            **{p.name: f"platform.{p.name}" for p in platform.outputs},
            stroke.name: "join.pma_stroke",
        },
    )
