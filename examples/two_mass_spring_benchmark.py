"""Robust-control benchmark of two masses and a spring: model, controller, robust stability with a proof.

python examples/two_mass_spring_benchmark.py

A force on the first mass, the position of the second one measured; masses and stiffness are uncertain by 20 %. The
problem is that of Wie and Bernstein (JGCD 15, 1992), the controller that of the ACC benchmark example in the manual of
MATLAB's Robust Control Toolbox, which prints a margin between 2.8826 and 2.8864.
"""

from lftkit import feedback, matrix, real, s
from lftkit.proofs import BoundOptions, check_proof, robust_stability

k, m1, m2 = (real(name, 1.0, percent=20) for name in ("k", "m1", "m2"))
plant = matrix([[m1 * s**2 + k, -k], [-k, m2 * s**2 + k]]).inverse()[1, 0].system("force", "position")
controller = (100 * ((s + 1) / (0.001 * s + 1)) ** 3).system("position", "force")
loop = feedback(plant @ controller)
bounds = robust_stability(loop, options=BoundOptions(gap=0.02))
print(loop)
print(f"{bounds.lower:.4f} to {bounds.upper:.4f} times the uncertainty, unstable at {bounds.frequency:.2f} rad/s")
print("proof checked:", bounds.proof is not None and check_proof(bounds.proof.content).stable)
