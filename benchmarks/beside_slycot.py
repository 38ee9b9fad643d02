"""Values and processor time of lftkit beside those of python-control with Slycot, and the published values, in one run.

    python benchmarks/beside_slycot.py [--seconds 0.5] [--json | --table]

Eleven problems, most of them of the page of published values: norms, a Riccati equation, Hankel singular values,
reduction, synthesis, structured singular value and disk margin. Calls of both sides alternate, with one thread; times
are CPU seconds of a call, medians. Slycot is optional: ``pip install slycot`` (its wrapper is GPL-2, so it is no
dependency of the project), in an environment of its own with numpy, scipy, control and threadpoolctl, and the clone on
PYTHONPATH. Where it is not installed its columns are empty.
"""

from __future__ import annotations

import argparse
import json
import time
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import control
import numpy as np
from scipy import linalg
from threadpoolctl import threadpool_limits

from lftkit import System, balred, h2_norm, hankel_singular_values, hinf_norm, s
from lftkit.analysis.riccati import riccati
from lftkit.proofs import complex_block, disk_margins, full_block, mu, real_block
from lftkit.synthesis import h2syn, hinfsyn, mixsyn

try:
    import slycot
except ImportError:
    slycot = None

ROUNDS = 5
"""Of alternating calls."""


@dataclass(frozen=True)
class Problem:
    """A problem and its two solutions.

    Parameters
    ----------
    name, published : str
        The printed value as it is printed.
    ours, theirs : callable
        What is measured.
    value : callable
        Number from what `theirs` returns, which is not measured.
    """

    name: str
    published: str
    ours: Callable[[], Any]
    theirs: Callable[[], Any]
    value: Callable[[Any], float] = float


def three_states() -> System:
    """Of MATLAB's `norm` in the tests of python-control."""
    A = [
        [-1.017041847539126, -0.224182952826418, 0.042538079149249],
        [-0.310374015319095, -0.516461581407780, -0.119195790221750],
        [-1.452723568727942, 1.7995860837102088, -1.491935830615152],
    ]
    B = [
        [0.312858596637428, -0.164879019209038],
        [-0.864879917324456, 0.627707287528727],
        [-0.030051296196269, 1.093265669039484],
    ]
    C = [
        [1.109273297614398, 0.077359091130425, -1.113500741486764],
        [-0.863652821988714, -1.214117043615409, -0.006849328103348],
    ]
    return System(A, B, C, np.zeros((2, 2)), [("u", 2)], [("y", 2)])


def three_modes() -> System:
    """Of SLICOT's documentation of AB13DD."""
    modes = [[[0, 1], [-0.5, -2e-4]], [[0, 1], [-1, -2e-5]], [[0, 1], [-2, -2e-6]]]
    B, C = np.tile([[1.0], [0.0]], (3, 1)), np.tile([1.0, 0.0], (1, 3))
    return System(linalg.block_diag(*modes), B, C, [[0.0]], [("u", 1)], [("y", 1)])


def two_areas() -> System:
    """Seven states of SLICOT's documentation of AB09AD."""
    A = np.zeros((7, 7))
    A[0, :4], A[4, 3:] = [-0.04165, 0, 4.92, -4.92], [4.92, -0.04165, 0, 4.92]
    A[3, [0, 4]] = 0.545, -0.545
    for k in (1, 5):
        A[k, [k - 1, k]], A[k + 1, [k, k + 1]] = [-5.21, -12.5], [3.33, -3.33]
    B = np.zeros((7, 2))
    B[1, 0] = B[5, 1] = 12.5
    return System(A, B, np.eye(7)[[0, 3, 4]], np.zeros((3, 2)), [("u", 2)], [("y", 3)])


def standard(A: Any, B1: Any, B2: Any, C1: Any, C2: Any) -> System:
    """Plant with one disturbance beside the noise, and one error beside the cost."""
    B1, C1 = np.array(B1, dtype=float), np.array(C1, dtype=float)
    B, C = np.hstack([B1, 0.0 * B1, B2]), np.vstack([C1, 0.0 * C1, C2])
    return System(A, B, C, [[0, 0, 0], [0, 0, 1], [0, 1, 0]], [("w", 2), ("u", 1)], [("z", 2), ("y", 1)])


def example_19_1() -> System:
    """Of Zhou, Doyle and Glover, Robust and Optimal Control."""
    A = [[-1, 0, 4], [0, 2, 0], [0, 0, -3]]
    return standard(A, [[0], [1], [0]], np.ones((3, 1)), [[0, 1, 0]], np.ones((1, 3)))


def four_disks() -> System:
    """Of the same book."""
    A, B = np.diag(np.ones(7), -1), np.eye(8)[:, :1]
    A[0] = [-0.161, -6.004, -0.58215, -9.9835, -0.40727, -3.982, 0, 0]
    C1 = 1e-3 * np.array([[0, 0, 0, 0, 0.55, 11, 1.32, 18]])
    C2 = np.array([[0, 0, 0.00064432, 0.0023196, 0.071252, 1.0002, 0.10455, 0.99551]])
    return standard(A, B, B, C1, C2)


def norms() -> Iterator[Problem]:
    """Norms, and what follows from Lyapunov and Riccati equations."""
    three, modes, areas = three_states(), three_modes(), two_areas()
    to_control = {id(G): G.to_control() for G in (three, modes, areas)}

    def of(G: System) -> Any:
        return to_control[id(G)]

    yield Problem(
        "H-infinity norm, three states",
        "4.276759162964244",
        lambda: hinf_norm(three).value,
        lambda: control.linfnorm(of(three))[0],
    )
    yield Problem(
        "H-infinity norm, three lightly damped modes",
        "500000.0001",
        lambda: hinf_norm(modes).value,
        lambda: control.linfnorm(of(modes))[0],
    )
    yield Problem(
        "H2 norm, three states", "2.237461821810309", lambda: h2_norm(three), lambda: control.norm(of(three), 2)
    )
    A, B, Q, R = np.diag([1.0], 1), np.array([[0.0], [1.0]]), np.diag([1.0, 2.0]), np.eye(1)
    yield Problem(
        "Riccati solution of SB02MD, first entry",
        "2",
        lambda: riccati(A, B, Q, R)[0, 0],  # type: ignore[index]
        lambda: control.care(A, B, Q, R, method="slycot")[0],
        lambda X: float(X[0, 0]),
    )
    yield Problem(
        "largest Hankel singular value, seven states",
        "2.5139",
        lambda: hankel_singular_values(areas)[0],
        lambda: control.hankel_singular_values(of(areas))[0],
    )
    yield Problem(
        "norm of the error of five of these states, bound",
        "0.0998",
        lambda: balred(areas, 5).error_bound,
        lambda: control.balred(of(areas), 5),
        lambda small: hinf_norm(areas - System.from_control(small)).value,
    )


def designs() -> Iterator[Problem]:
    """Synthesis, and robustness of several loops at once."""
    G, W = (200 / ((10 * s + 1) * (0.05 * s + 1) ** 2)).system("u", "y"), ((s / 1.5 + 10) / (s + 1e-3)).system("e", "z")
    g, w, one = G.to_control(), W.to_control(), control.ss([], [], [], [[1.0]])
    yield Problem(
        "mixed sensitivity of the disturbance process",
        "1.37",
        lambda: mixsyn(G, W, 1.0).value,
        lambda: control.mixsyn(g, w, one)[2][0],
    )
    h2, disks = example_19_1(), four_disks()
    p, q = h2.to_control(), disks.to_control()
    yield Problem(
        "H2 synthesis, example 19.1",
        "8.9582",
        lambda: h2syn(h2, "y", "u").value,
        lambda: control.h2syn(p, 1, 1),
        lambda K: h2_norm(p.lft(K)),
    )
    yield Problem(
        "H-infinity synthesis, four disks",
        "1.1272",
        lambda: hinfsyn(disks, "y", "u").value,
        lambda: control.hinfsyn(q, 1, 1)[2],
    )
    first = [-1 + 6j, 2 - 3j, 3 + 8j, 3 + 8j, -5 - 9j, -6 + 2j]
    second = [4 + 2j, -2 + 5j, -6 - 7j, -4 + 11j, 8 - 7j, 12 - 1j]
    third = [5 - 4j, -4 - 8j, 1 - 3j, -6 + 14j, 2 - 5j, 4 + 16j]
    M = np.array([first, second, third] * 2)
    blocks = [real_block(), real_block(), full_block(2), complex_block(), complex_block()]
    yield Problem(
        "structured singular value, six by six",
        "41.74753408",
        lambda: mu(M, blocks).upper,
        lambda: slycot.ab13md(M, [1, 1, 2, 1, 1], [1, 1, 2, 2, 2])[0],
    )
    spinning = System([[0, 10], [-10, 0]], np.eye(2), [[1, 10], [-10, 1]], np.zeros((2, 2)), [("u", 2)], [("y", 2)])
    both, omega = spinning.to_control(), np.geomspace(0.01, 100.0, 200)
    yield Problem(
        "disk margin of the spinning satellite, both loops",
        "0.0998",
        lambda: disk_margins(spinning).together.upper,
        lambda: control.disk_margins(both, omega)[0],
    )


def measured(problem: Problem, seconds: float) -> dict[str, Any]:
    """One row: values, CPU seconds of a call, and their ratio."""
    row: dict[str, Any] = {"problem": problem.name, "published": problem.published}
    calls = {"lftkit": problem.ours} if slycot is None else {"lftkit": problem.ours, "slycot": problem.theirs}
    counts: dict[str, int] = {}
    times: dict[str, list[float]] = {side: [] for side in calls}
    for side, call in calls.items():
        found = call()  # also compiles
        row[side] = problem.value(found) if side == "slycot" else float(found)
        begin = time.process_time()
        call()
        counts[side] = max(1, int(seconds / ROUNDS / max(time.process_time() - begin, 1e-6)))
    for _ in range(ROUNDS):
        for side, call in calls.items():
            begin = time.process_time()
            for _ in range(counts[side]):
                call()
            times[side].append((time.process_time() - begin) / counts[side])
    for side in calls:
        row[f"{side}_seconds"] = float(np.median(times[side]))
    if slycot is not None:
        row["times_slycot"] = float(np.median(np.divide(times["lftkit"], times["slycot"])))
    return row


def table(rows: list[dict[str, Any]]) -> str:
    """Markdown, as in docs/lftkit/norms.md."""
    names = "problem", "published", "lftkit", "Slycot", "lftkit, ms", "Slycot, ms", "ratio"
    lines = ["| " + " | ".join(names) + " |", "|---|---|---|---|---:|---:|---:|"]
    for row in rows:
        cells = [row["problem"], row["published"], f"{row['lftkit']:.10g}", "", f"{1e3 * row['lftkit_seconds']:.3g}"]
        if slycot is None:
            cells += ["", ""]
        else:
            cells[3] = f"{row['slycot']:.10g}"
            cells += [f"{1e3 * row['slycot_seconds']:.3g}", f"{row['times_slycot']:.3g}"]
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines)


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=0.5, help="CPU seconds of each side of a problem, about")
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--table", action="store_true", help="Markdown, as in docs/lftkit/norms.md")
    arguments = parser.parse_args()
    with threadpool_limits(1), warnings.catch_warnings():
        warnings.filterwarnings("ignore", "connect.. is deprecated", FutureWarning)  # by control.mixsyn
        rows = [measured(problem, arguments.seconds) for part in (norms, designs) for problem in part()]
    if arguments.json:
        version = getattr(slycot, "__version__", None)
        print(json.dumps({"slycot": version, "control": control.__version__, "rows": rows}))
        return
    if arguments.table:
        print(table(rows))
    else:
        for row in rows:
            print(", ".join(f"{key} {value}" for key, value in row.items()))
    if slycot is None:
        print("slycot is not installed: no comparison")


if __name__ == "__main__":
    main()
