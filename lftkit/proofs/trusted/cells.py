"""Check of a proof by cells of the parameters and the frequency, with constant scalings in each.

A proof says: for all parameters in the box and all frequencies of the band the gain from the inputs d to the outputs
e is below `level` (kind ``gain``), or there is no pole on the imaginary axis (kind ``stability``); together with one
stable member, a band from zero to infinity then proves stability of every member. With ``v = j omega x = A x + B1 w +
B2 d``, ``z = C1 x + D11 w + D12 d``, ``e = C2 x + D21 w + D22 d`` and ``w = delta z``, each cell has scalings that make

    performance (e* e - level^2 d* d) + 2 Re x* Q v + sum 2 Re z* (j G) w + 2 Re (v - j a x)* P (j b x - v)
                                      + sum 2 Re (w - delta_low z)* D (delta_high z - w)

negative definite in (x, w, d), P and D positive definite, Q and G Hermitian: on solutions in the cell all but the first
term are not negative, so the first one is negative. For a band from a to infinity the term of P is
``2 Re (v - j a x)* P j x``.

The proof may have *disks*: complex numbers and stable dynamics whose value Delta at each frequency is any complex
matrix with a norm of at most `radius`. In each of their occurrences i, ``w_i = Delta z_i``, so that for Hermitian D > 0

    sum over i and j of D_ij (radius^2 z_i* z_j - w_i* w_j)

is not negative, and it is added. The sets contain zero, where the stable member has them, and with each Delta all its
multiples by numbers of 0 to 1: where I - M Delta is regular along the axis for all of them, no pole crosses it.

In discrete time the states of the system are s, and its next states A s + B1 w + B2 d. Then ``x`` stands for the sum of
both and ``v`` for their difference, the second less the first: on the unit circle, z = exp(j omega dt), they satisfy
``v = j tan(omega dt / 2) x``, and this tangent is the frequency of bands and cells. What infinite frequency is in
continuous time, a member that is not well posed, is no point of the circle. So a list of cells of its own, `posed`,
shows that ``w = delta D11 w`` has no solution but zero anywhere in the box.

Every matrix is kept with a bound of its error (:mod:`lftkit.proofs.trusted.arithmetic`); complex ones are real
matrices of twice the size.
"""

from __future__ import annotations

import hashlib
import json
import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import linalg

from lftkit.proofs.trusted.arithmetic import (
    UNIT,
    Ball,
    definite_ratio,
    embedded,
    exact_product,
    hermitian,
    scalar,
    turned,
)
from lftkit.proofs.trusted.digests import plant_digest
from lftkit.proofs.trusted.entries import (
    each,
    fixed,
    header_of,
    index,
    mapping,
    maybe,
    number,
    pair,
    record,
    table,
    text,
)
from lftkit.proofs.trusted.proof import (
    CheckedProof,
    ComplexArray,
    FloatArray,
    Interval,
    ProofError,
    refusing,
    require,
    uncovered,
)

KIND = "cells"
SCALING = fixed(table, table)
CELL = record(
    {
        "intervals": each(pair),
        "band": fixed(number, maybe(number)),
        "P": SCALING,
        "Q": SCALING,
        "D": mapping(SCALING),
        "G": mapping(SCALING),
        "centre": number,
        "performance": number,
    }
)
SYSTEM = record(
    {
        "order": index,
        "inputs": index,
        "outputs": index,
        "channels": each(text),
        "parameters": each(record({"name": text, "nominal": number, "unit": text})),
        **dict.fromkeys("ABCD", table),
    },
    {"dt": number, "disks": each(record({"name": text, "radius": number, "outputs": index, "inputs": index}))},
)
CONTENT = {
    "claim": record(
        {"property": text, "level": maybe(number), "band": fixed(number, maybe(number)), "box": mapping(pair)}
    ),
    "plant": SYSTEM,
    "cells": each(CELL),
    "stable": maybe(record({"point": each(number), "L": table, "T": table, "weights": mapping(each(number))})),
    "sha256": text,
}
"""What a proof holds; in discrete time it has `posed`, too."""


def sized(values: Any, shape: tuple[int, int], what: str) -> FloatArray:
    """A matrix that must have a shape and finite numbers; rows without columns are lost in a file."""
    found = np.array(values, dtype=float)
    own = (found.shape == shape or found.size + math.prod(shape) == 0) and np.isfinite(found).all()
    require(own, f"{what} must be finite and have shape {shape}, got {found.shape}")
    return found.reshape(shape)


def scaling(parts: Any, size: int, what: str) -> FloatArray:
    """Embedded Hermitian matrix of the lower triangles that a proof stores."""
    real, imag = (sized(part, (size, size), what) for part in parts)
    return hermitian(real, imag)


def weight_of(weights: Any, count: int) -> Ball:
    """Diagonal matrix of weights that are not negative."""
    found = np.array(weights, dtype=float).reshape(count)
    require(np.all(found >= 0.0), "weights must not be negative")
    return Ball(np.diag(found))


@dataclass(frozen=True)
class Disk:
    """A complex number or dynamics: occurrences with the channels that go into it and those that come out."""

    name: str
    radius: float
    into: list[list[int]]
    out: list[list[int]]

    @classmethod
    def of(cls, content: dict[str, Any], channels: list[str]) -> Disk:
        """As a proof has it; each occurrence takes as many channels as the larger of its sizes."""
        name, radius = str(content["name"]), float(content["radius"])
        outputs, inputs = int(content["outputs"]), int(content["inputs"])
        width, own = max(outputs, inputs), [i for i, channel in enumerate(channels) if channel == name]
        some = min(outputs, inputs) >= 1 and own and len(own) % width == 0 and 0.0 < radius < math.inf
        require(some, f"disk {name!r} must have a positive radius, sizes and channels for each occurrence")
        places = [own[at : at + width] for at in range(0, len(own), width)]
        return cls(name, radius, [place[:inputs] for place in places], places)


class Inequality:
    """The inequality of a cell of one system; `static`: of its channels without states, inputs and outputs."""

    def __init__(self, proof: dict[str, Any], static: bool = False) -> None:
        system = proof["plant"]
        self.dt = float(system.get("dt", 0.0))
        require("dt" not in system or 0.0 < self.dt < math.inf, f"dt must be positive, got {self.dt}")
        self.names = [str(p["name"]) for p in system["parameters"]]
        self.nominal = {p["name"]: float(p["nominal"]) for p in system["parameters"]}
        channels = list(enumerate(system["channels"]))
        self.disks = [Disk.of(content, system["channels"]) for content in system.get("disks", [])]
        elements = [*self.names, *(disk.name for disk in self.disks)]
        require(len(set(elements)) == len(elements), f"each element must have a name of its own, got {elements}")
        self.rows = {name: [i for i, channel in channels if channel == name] for name in self.names}
        self.gain = proof["claim"]["property"] == "gain"
        n, q = int(system["order"]), len(channels)
        m, p = (int(system["inputs"]), int(system["outputs"])) if self.gain else (0, 0)
        rows, columns = q + int(system["outputs"]), q + int(system["inputs"])
        shapes = {"A": (n, n), "B": (n, columns), "C": (rows, n), "D": (rows, columns)}
        A, B, C, D = matrices = [sized(system[key], shape, key) for key, shape in shapes.items()]
        sizes = {str(disk["name"]): (disk["outputs"], disk["inputs"]) for disk in system.get("disks", [])}
        self.plant = plant_digest(self.dt, system["channels"], self.nominal, sizes, matrices)
        if static:
            A, B, C = np.zeros((0, 0)), np.zeros((0, D.shape[1])), np.zeros((len(D), 0))
            self.gain, n, m, p = False, 0, 0, 0
        self.n, self.q = n, q
        unit = np.eye(n + q + m)
        self.w, self.d = unit[n : n + q], unit[n + q :]
        self.states, self.after = unit[:n], np.hstack([A, B[:, : q + m]])
        self.z, self.e = np.hstack([C[:q], D[:q, : q + m]]), np.hstack([C[q : q + p], D[q : q + p, : q + m]])

    def signal(self, of_v: complex, of_x: complex) -> list[ComplexArray]:
        """Factors of ``of_v v + of_x x`` as rows over (x, w, d), without rounding: one number is real, or zero."""
        if not self.dt:
            return [of_v * self.after + of_x * self.states]
        ahead, back = ((of_x + sign * of_v) * np.eye(self.n, dtype=complex) for sign in (1.0, -1.0))
        return [np.hstack([ahead, back]), np.vstack([self.after, self.states]).astype(complex)]

    def delta(self, name: str, value: float) -> Ball:
        """``value - nominal`` with its rounding."""
        return scalar(value) - scalar(self.nominal[name])

    def ratio(self, cell: dict[str, Any], level: float | None) -> float:
        """Smallest :func:`definite_ratio` of the cell's matrices."""
        low, high = cell["band"]
        coordinates = embedded(self.coordinates(cell))
        ahead = (0.0, 1j) if high is None else (-1.0, 1j * high)
        x, v, below, above = (
            exact_product(*(embedded(factor) for factor in self.signal(*parts)), coordinates)
            for parts in ((0.0, 1.0), (1.0, 0.0), (1.0, -1j * low), ahead)
        )
        P, Q = (scaling(cell[key], self.n, key) for key in "PQ")
        total = below.transposed() @ (Ball(P) @ above) + x.transposed() @ (Ball(Q) @ v)
        ratios = [definite_ratio(Ball(P))]
        for name, (lower, upper) in zip(self.names, cell["intervals"]):
            rows = self.rows[name]
            w, z = (exact_product(embedded(part[rows]), coordinates) for part in (self.w, self.z))
            D, G = (scaling(cell[key][name], len(rows), f"{key} of {name}") for key in "DG")
            off = w - z.times(self.delta(name, lower))
            rest = z.times(self.delta(name, upper)) - w
            total = total + off.transposed() @ (Ball(D) @ rest) + z.transposed() @ (Ball(turned(G)) @ w)
            ratios.append(definite_ratio(Ball(D)))
        for disk in self.disks:
            D = scaling(cell["D"][disk.name], len(disk.into), f"D of {disk.name}")
            ratios.append(definite_ratio(Ball(D)))
            total = total + self.disk_form(disk, D, coordinates)
        total = total + total.transposed()
        if self.gain:
            factor = float(cell["performance"])
            if level is None or not (factor > 0.0 and level > 0.0):
                raise ProofError(f"performance and level must be positive, got {factor} and {level}")
            e, d = (exact_product(embedded(part), coordinates) for part in (self.e, self.d))
            allowed = (d.transposed() @ d).times(scalar(level)).times(scalar(level))
            total = total + (e.transposed() @ e - allowed).times(scalar(factor))
        return min(*ratios, definite_ratio(-total))

    def disk_form(self, disk: Disk, D: FloatArray, coordinates: FloatArray) -> Ball:
        """``sum of D_ij (radius^2 z_i* z_j - w_i* w_j)``; what a disk's channels have beyond its sizes is zero in w."""
        forms = []
        for part, places in ((self.z, disk.into), (self.w, disk.out)):
            signal = exact_product(embedded(part[[row for place in places for row in place]]), coordinates)
            scaling = Ball(np.asarray(np.kron(D, np.eye(len(places[0]))), dtype=np.float64))
            forms.append(signal.transposed() @ (scaling @ signal))
        radius = scalar(disk.radius)
        return forms[0].times(radius).times(radius) - forms[1]

    def coordinates(self, cell: dict[str, Any]) -> ComplexArray:
        """Any basis of (x, w, d); this one makes the terms of the inequality small where they cancel."""
        middle = np.repeat(0.0, self.q)
        for name, (lower, upper) in zip(self.names, cell["intervals"]):
            middle[self.rows[name]] = 0.5 * (lower + upper) - self.nominal[name]
        states = self.signal(1.0, -1j * float(cell["centre"]))
        offsets = [states[0] @ states[1] if self.dt else states[0], self.w - middle[:, None] * self.z, self.d]
        if not any(map(len, offsets)):  # LAPACK refuses what is empty
            return np.zeros((0, 0), complex)
        factors, pivots, _ = linalg.lapack.zgetrf(np.vstack(offsets))
        return np.asarray(linalg.lapack.zgetri(factors, pivots)[0])

    def stable_ratio(self, stable: dict[str, Any]) -> float:
        """Lyapunov inequality of one member: ``(L x)* (L v) + (L v)* (L x) < 0`` where ``w = delta z``.

        Written in coordinates ``T y`` of the states, with a multiplier of ``|w - delta z|^2`` for each channel.
        """
        n, q = self.n, self.q
        L, T = (sized(stable[key], (n, n), key) for key in "LT")
        basis = np.block([[T, np.zeros((n, q))], [np.zeros((q, n)), np.eye(q)]])
        part = slice(0, n + q)
        signals = [[factor.real for factor in self.signal(*parts)] for parts in ((0.0, 1.0), (1.0, 0.0))]
        x, v = (exact_product(L, *before, rows[:, part], basis) for *before, rows in signals)
        total = x.transposed() @ v
        total = total + total.transposed()
        for name, value in zip(self.names, stable["point"]):
            rows = self.rows[name]
            w, z = (exact_product(signal[rows][:, part], basis) for signal in (self.w, self.z))
            off = w - z.times(self.delta(name, value))
            total = total - off.transposed() @ (weight_of(stable["weights"][name], len(rows)) @ off)
        for disk in self.disks:
            rows = [row for place in disk.out for row in place]
            w = exact_product(self.w[rows][:, part], basis)
            total = total - w.transposed() @ (weight_of(stable["weights"][disk.name], len(rows)) @ w)
        states = exact_product(L, T)
        return min(definite_ratio(states.transposed() @ states), definite_ratio(-total))


def digest(proof: dict[str, Any]) -> str:
    """SHA-256 of the content."""
    content = json.dumps({key: value for key, value in proof.items() if key != "sha256"}, sort_keys=True)
    return hashlib.sha256(content.encode()).hexdigest()


def check_cells(header: dict[str, Any]) -> CheckedProof:
    """Verify a proof by cells; a ProofError says why it is refused.

    Parameters
    ----------
    header : dict
        Content of the file.
    """
    with refusing("a proof by cells"):
        own, proof = digest(header), header_of(header, KIND, CONTENT, {"posed": each(CELL)})
        require(proof["sha256"] == own, "the content must match its SHA-256, got another: the file was altered")
        return _checked(proof)


def _checked(proof: dict[str, Any]) -> CheckedProof:
    claim, stable = proof["claim"], proof["stable"]
    what, level, box = claim["property"], claim["level"], claim["box"]
    require(what in ("gain", "stability"), f"a proof must be of a gain or of stability, got {what!r}")
    require((level is None) == (what == "stability"), f"a gain must have a level and stability none, got {level}")
    inequality, band = Inequality(proof), _band(claim["band"])
    require_names(proof, inequality)
    whole = [box[name] for name in inequality.names]
    worst = smallest_ratio(inequality, proof["cells"], [*whole, band], level)
    if inequality.dt:
        static = Inequality(proof, static=True)
        worst = min(worst, smallest_ratio(static, proof["posed"], [*whole, (0.0, math.inf)], None))
    if stable is not None:
        point = stable["point"]
        inside = len(point) == len(whole) and all(low <= at <= high for at, (low, high) in zip(point, whole))
        require(inside, f"the stable member must be inside the box, got {point}")
        worst = min(worst, inequality.stable_ratio(stable))
        require(worst >= 1.0, "the Lyapunov inequality of the stable member must hold beyond rounding, got no margin")
    proven = stable is not None and band == (0.0, math.inf)
    require(proven or what == "gain", "a proof of stability must have a stable member and a band from zero to infinity")
    named, omega = dict(zip(inequality.names, whole)), frequencies(band, inequality.dt)
    disks = {disk.name: disk.radius for disk in inequality.disks}
    return CheckedProof(inequality.plant, what, level, named, omega, len(proof["cells"]), worst, proven, disks)


def _band(ends: Any) -> Interval:
    band = float(ends[0]), math.inf if ends[1] is None else float(ends[1])
    require(0.0 <= band[0] < band[1], f"a band must be two frequencies with 0 <= lower < upper, got {ends}")
    return band


def require_names(proof: dict[str, Any], inequality: Inequality) -> None:
    """Whether all that is by name is of the elements of the system, nothing missing and nothing more."""
    real, every = {*inequality.names}, {*inequality.names, *(disk.name for disk in inequality.disks)}
    cells, stable = (*proof["cells"], *proof.get("posed", ())), proof["stable"]
    own = [("box", proof["claim"]["box"], real)]
    own += [(key, cell[key], names) for cell in cells for key, names in (("D", every), ("G", real))]
    own += [("weights", stable["weights"], every)] if stable is not None else []
    for what, values, names in own:
        require(set(values) == names, f"{what} must have the names {sorted(names)}, got {sorted(values)}"[:300])
    discrete = (inequality.dt > 0.0) == ("posed" in proof)
    require(discrete, "cells that show members well posed must be in a proof in discrete time, and in no other")


def smallest_ratio(inequality: Inequality, contents: Any, whole: Any, level: float | None) -> float:
    """Smallest ratio of the cells, which must cover the box and the band without overlap."""
    cells = [[*((float(a), float(b)) for a, b in c["intervals"]), _band(c["band"])] for c in contents]
    for i, cell in enumerate(cells):
        inside = len(cell) == len(whole) and all(lo <= a <= b <= hi for (a, b), (lo, hi) in zip(cell, whole))
        require(inside, f"cell {i} must be inside the box, got {cell}")
    ends = np.array(cells).reshape(len(cells), -1, 2)
    for i, own in enumerate(ends):
        overlapping = np.sum(np.all((ends[:, :, 0] < own[:, 1]) & (ends[:, :, 1] > own[:, 0]), axis=1))
        require(overlapping <= 1, f"cells must not overlap, got another one that overlaps cell {i}")
    hole = uncovered(whole, cells)
    require(hole is None, f"the cells must cover the box and the band, got a hole at {hole}")
    worst = math.inf
    for i, content in enumerate(contents):
        worst = min(worst, inequality.ratio(content, level))
        require(worst >= 1.0, f"the inequality of cell {i} must hold beyond rounding, got no margin at {cells[i]}")
    return worst


def frequencies(band: Interval, dt: float) -> Interval:
    """Frequencies [rad/s] inside a band; in discrete time `band` has the tangents of half their angles."""
    if not dt:
        return band
    low, high = (2.0 / dt * math.atan(end) for end in band)
    return (1.0 + 8.0 * UNIT) * low, (1.0 - 8.0 * UNIT * math.isfinite(band[1])) * high
