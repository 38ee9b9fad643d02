"""The tuner against BFGS with random restarts on the published plants, same wall time, one core each.

    python benchmarks/tuning.py [--plants AC3,REA1] [--orders 0,1,2] [--seconds 30] [--json]

The rival is written here, apart from the tuner: BFGS with a weak Wolfe line search on the H-infinity norm itself (Lewis
and Overton 2013 found it good on such functions), the norm by the level iteration of Bruinsma and Steinbuch (1990),
the gradient from the singular vectors at the peak, unstable points by the spectral abscissa. The value of the tuner is
the certified upper bound.
"""

from __future__ import annotations

import argparse
import json
import time
from typing import Any

import numpy as np
import scipy.linalg as sl
from threadpoolctl import threadpool_limits

from lti import StateSpace
from robust_design import HinfGain, TuningOptions, state_space, tune
from robust_design.published_plants import BEST_KNOWN, PLANTS

AGREEMENT = 1e-3


class Loop:
    """Closed loop of a plant with a controller of fixed order, all entries free, as a function of their vector."""

    def __init__(self, plant: StateSpace, order: int) -> None:
        k, n = order, plant.order
        nu, nz = plant.inputs[1].size, plant.outputs[0].size
        nw, ny = plant.inputs[0].size, plant.outputs[1].size
        B, C, D = plant.B, plant.C, plant.D
        self.A = sl.block_diag(plant.A, np.zeros((k, k)))
        self.B1 = np.vstack([B[:, :nw], np.zeros((k, nw))])
        self.B2 = np.block([[np.zeros((n, k)), B[:, nw:]], [np.eye(k), np.zeros((k, nu))]])
        self.C1 = np.hstack([C[:nz], np.zeros((nz, k))])
        self.C2 = np.block([[np.zeros((k, n)), np.eye(k)], [C[nz:], np.zeros((ny, k))]])
        self.D11, self.D12 = D[:nz, :nw], np.hstack([np.zeros((nz, k)), D[:nz, nw:]])
        self.D21 = np.vstack([np.zeros((k, nw)), D[nz:, :nw]])
        self.shape = (k + nu, k + ny)

    def closed(self, x: np.ndarray) -> tuple[np.ndarray, ...]:
        """Matrices of the closed loop; the plants have no direct path from u to y."""
        K = x.reshape(self.shape)
        return (
            self.A + self.B2 @ K @ self.C2,
            self.B1 + self.B2 @ K @ self.D21,
            self.C1 + self.D12 @ K @ self.C2,
            self.D11 + self.D12 @ K @ self.D21,
        )

    def norm(self, x: np.ndarray) -> tuple[float, np.ndarray]:
        """H-infinity norm and gradient; infinite where the loop is unstable."""
        A, B, C, D = self.closed(x)
        poles = sl.eigvals(A)
        if poles.real.max() >= -1e-9:
            return np.inf, np.zeros_like(x)
        value, omega = level_iteration(A, B, C, D, np.abs(poles))
        R = sl.inv(1j * omega * np.eye(len(A)) - A) if np.isfinite(omega) else np.zeros_like(A)
        U, _, Vh = sl.svd(C @ R @ B + D)
        left = U[:, 0].conj() @ (C @ R @ self.B2 + self.D12)
        right = (self.C2 @ R @ B + self.D21) @ Vh[0].conj()
        return value, np.real(np.outer(left, right)).ravel()

    def abscissa(self, x: np.ndarray) -> tuple[float, np.ndarray]:
        """Spectral abscissa and gradient."""
        values, left, right = sl.eig(self.closed(x)[0], left=True, right=True)
        i = int(np.argmax(values.real))
        scale = left[:, i].conj() @ right[:, i]
        slope = np.outer(left[:, i].conj() @ self.B2, self.C2 @ right[:, i]) / (scale if abs(scale) > 1e-14 else 1e-14)
        return float(values[i].real), np.real(slope).ravel()


def level_iteration(A: Any, B: Any, C: Any, D: Any, first: np.ndarray, rtol: float = 1e-8) -> tuple[float, float]:
    """H-infinity norm and peak frequency: levels raised until the Hamiltonian has no imaginary eigenvalue."""

    def gain(w: float) -> float:
        response = D if not np.isfinite(w) else C @ sl.solve(1j * w * np.eye(len(A)) - A, B) + D
        return float(sl.svdvals(response)[0])

    best, omega = max((gain(float(w)), float(w)) for w in (0.0, np.inf, *first))
    for _ in range(30):
        level = best * (1.0 + 2.0 * rtol)
        if level <= 0.0:
            break
        R, S = level**2 * np.eye(D.shape[1]) - D.T @ D, level**2 * np.eye(len(D)) - D @ D.T
        F = A + B @ sl.solve(R, D.T @ C)
        H = np.block([[F, level * B @ sl.solve(R, B.T)], [-level * C.T @ sl.solve(S, C), -F.T]])
        values = sl.eigvals(H)
        crossings = np.unique(np.abs(values[np.abs(values.real) < 1e-8 * np.maximum(np.abs(values), 1.0)].imag))
        if len(crossings) < 2:
            break
        value, w = max((gain(float(m)), float(m)) for m in 0.5 * (crossings[1:] + crossings[:-1]))
        if value <= best:
            break
        best, omega = value, w
    return best, omega


def bfgs(function: Any, x: np.ndarray, deadline: float, stop: float = -np.inf, steps: int = 1000) -> Any:
    """BFGS with a weak Wolfe line search by bisection; the best point and its value."""
    f, g = function(x)
    H = np.eye(len(x))
    for _ in range(steps):
        d = -H @ g
        if not g @ d < 0 or time.monotonic() > deadline or f < stop:
            break
        low, high, t, found = 0.0, np.inf, 1.0, False
        for _ in range(40):
            new_f, new_g = function(x + t * d)
            if not new_f < f + 1e-4 * t * (g @ d):
                high = t
            elif new_g @ d < 0.9 * (g @ d):
                low = t
            else:
                found = True
                break
            t = 0.5 * (low + high) if np.isfinite(high) else 2.0 * t
        if not found:
            break
        s, y = t * d, new_g - g
        x, f, g = x + s, new_f, new_g
        rho = 1.0 / (s @ y)
        V = np.eye(len(x)) - rho * np.outer(s, y)
        H = V @ H @ V.T + rho * np.outer(s, s)
    return x, f


def restarted(plant: StateSpace, order: int, seconds: float) -> float:
    """Best value of BFGS from random starts within the wall time."""
    loop, rng, deadline = Loop(plant, order), np.random.default_rng(0), time.monotonic() + seconds
    best = np.inf
    while time.monotonic() < deadline:
        x = rng.standard_normal(loop.shape).ravel() * 10.0 ** rng.uniform(-1, 1)
        x, abscissa = bfgs(loop.abscissa, x, deadline, -1e-3, 200)
        if abscissa < -1e-9:
            best = min(best, bfgs(loop.norm, x, deadline)[1])
    return float(best)


def measure(name: str, order: int, seconds: float) -> dict[str, Any]:
    """One plant and order, both methods."""
    plant = PLANTS[name]()
    structure = state_space([plant.outputs[1]], [plant.inputs[1]], order)
    start_time = time.monotonic()
    result = tune([plant], [HinfGain("w", "z")], structure, options=TuningOptions(wall_limit=seconds))
    used = time.monotonic() - start_time
    return {
        "name": name,
        "order": order,
        "best_known": BEST_KNOWN[name] if order == 0 else None,
        "ours": float(result.certificate.upper.max()) if result.certificate else None,
        "status": str(result.status),
        "bfgs": restarted(plant, order, used),
        "other": None,
        "seconds": used,
    }


def summary(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Counts over the rows: within 0.1 % of the best known value; wins, ties and losses against BFGS."""
    ours = np.array([np.inf if r["ours"] is None else r["ours"] for r in rows])
    rival = np.array([r["bfgs"] for r in rows])
    known = [(o, r["best_known"]) for o, r in zip(ours, rows) if r["best_known"] is not None]
    return {
        "plants": rows,
        "within_0.1_percent": sum(bool(o <= b * (1.0 + AGREEMENT) + 1e-6) for o, b in known),
        "wins": int(np.sum(ours < rival * (1.0 - AGREEMENT) - 1e-6)),
        "ties": int(np.sum(np.abs(ours - rival) <= rival * AGREEMENT + 1e-6)),
        "losses": int(np.sum(ours > rival * (1.0 + AGREEMENT) + 1e-6)),
    }


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--plants", default=",".join(PLANTS), help="names, separated by commas")
    parser.add_argument("--orders", default="0", help="orders of the controller, separated by commas")
    parser.add_argument("--seconds", type=float, default=60.0, help="wall limit of the tuner")
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    rows = []
    with threadpool_limits(1):
        for name in arguments.plants.split(","):
            for order in map(int, arguments.orders.split(",")):
                rows.append(measure(name, order, arguments.seconds))
                if not arguments.json:
                    print("{name:6s} order {order}: best known {best_known}, ours {ours} ({status}), BFGS {bfgs:.6g}, "
                          "{seconds:.1f} s each".format(**rows[-1]), flush=True)  # fmt: skip
    found = summary(rows)
    if arguments.json:
        print(json.dumps(found))
    else:
        print({key: value for key, value in found.items() if key != "plants"})


if __name__ == "__main__":
    main()
