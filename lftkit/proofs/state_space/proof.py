"""Proofs by cells as they are written: what :mod:`lftkit.proofs.trusted.cells` verifies."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import numpy as np
from scipy import linalg

from lftkit.arrays import ComplexArray, FloatArray
from lftkit.proofs.proof_files import write_content
from lftkit.proofs.state_space.cells import Cell, CellScalings
from lftkit.proofs.state_space.disks import disks_of
from lftkit.proofs.trusted.cells import KIND, Inequality, digest
from lftkit.proofs.trusted.entries import FORMAT
from lftkit.support.state_units import in_balanced_units
from lftkit.systems.system import System


@dataclass(frozen=True)
class Proof:
    """Content of a proof file.

    Parameters
    ----------
    content : dict
        Numbers, lists and names, as JSON has them; floating-point numbers keep all their digits.
    """

    content: dict[str, Any]

    @property
    def cells(self) -> int:
        """Number of cells."""
        return len(self.content["cells"])

    def to_file(self, path: Path) -> None:
        """Write the proof as JSON."""
        write_content(path, (self.content, {}))


def statement(
    system: System,
    kind: str,
    box: Sequence[tuple[float, float]],
    level: float | None,
    band: tuple[float, float],
    radii: Mapping[str, float] | None = None,
) -> dict[str, Any]:
    """Claim of a proof, without cells: the system, the box, the band, the level; `radii` as for a cell test.

    The band is that of the axis: in discrete time ``tan(omega dt / 2)``.
    """
    q = len(system.channels)
    disks = [
        {"name": disk.name, "radius": disk.radius, "outputs": disk.outputs, "inputs": disk.inputs}
        for disk in disks_of(system, radii)
    ]
    return {
        "format": FORMAT,
        "kind": KIND,
        "claim": {
            "property": kind,
            "level": level,
            "band": [band[0], None if np.isinf(band[1]) else band[1]],
            "box": {p.name: list(ends) for p, ends in zip(system.parameters, box)},
        },
        "plant": {
            **({"dt": system.dt} if system.dt else {}),
            "order": system.order,
            "inputs": system.B.shape[1] - q,
            "outputs": system.C.shape[0] - q,
            "channels": list(system.channels),
            "parameters": [{"name": p.name, "nominal": p.nominal, "unit": p.unit} for p in system.parameters],
            **({"disks": disks} if disks else {}),
            **{key: getattr(system, key).tolist() for key in "ABCD"},
        },
    }


def proven_cell(cell: Cell, scalings: CellScalings) -> dict[str, Any]:
    """A cell of a proof with its scalings."""
    low, high = cell.band
    return {
        "intervals": [list(ends) for ends in cell.intervals],
        "band": [low, None if np.isinf(high) else high],
        "P": _parts(scalings.P),
        "Q": _parts(scalings.Q),
        "D": {name: _parts(matrix) for name, matrix in scalings.D.items()},
        "G": {name: _parts(matrix) for name, matrix in scalings.G.items()},
        "centre": scalings.centre,
        "performance": scalings.performance,
    }


def _parts(matrix: ComplexArray) -> list[list[list[float]]]:
    """Real and imaginary part of a Hermitian matrix."""
    return [matrix.real.tolist(), matrix.imag.tolist()]


def finished(
    claim: dict[str, Any], cells: list[dict[str, Any]], stable: dict[str, Any] | None, posed: list[dict[str, Any]]
) -> Proof:
    """The claim with its cells, the stable member, in discrete time what is well posed, and the SHA-256 of it all."""
    discrete = {"posed": posed} if "dt" in claim["plant"] else {}
    content = json.loads(json.dumps({**claim, "cells": cells, "stable": stable, **discrete}))
    return Proof({**content, "sha256": digest(content)})


def stable_member(system: System, claim: dict[str, Any], point: FloatArray) -> dict[str, Any] | None:
    """Factor of a Lyapunov matrix and weights that prove the member at `point` stable; None if none were found."""
    values = {p.name: float(v) for p, v in zip(system.parameters, point)}
    inequality, q = Inequality(claim), len(system.channels)
    deviations = {p.name: values[p.name] - p.nominal for p in system.parameters}
    deviation = np.array([deviations.get(c, 0.0) for c in system.channels])
    D11 = system.D[:q, :q]
    loop = np.eye(q) - D11 * deviation
    through = np.eye(q) + deviation[:, None] * linalg.solve(loop, D11) if q else np.eye(0)
    A, channels = np.array(system.at(values, beyond_range=True).A), system.B[:, :q] @ through
    if system.dt:  # what follows is for the sum and the difference of next states and states
        ahead, step, (above, below) = A + np.eye(len(A)), A - np.eye(len(A)), (channels, channels)
    else:
        ahead, step, (above, below) = np.eye(len(A)), A, (0.0 * channels, channels)
    rate = linalg.solve(ahead.T, step.T).T
    for L, inverse in _lyapunov_factors(rate):
        T = linalg.solve(ahead, inverse) if system.dt else inverse
        rates = np.maximum(-np.diag(L @ rate @ inverse), 1e-300)
        channel = (L @ ahead @ T).T @ L @ below + (L @ step @ T).T @ L @ above
        of_products = 2.0 * q * np.sum(np.abs(L @ above) * np.abs(L @ below), axis=0)
        weights = 4.0 * max(q, 1) * np.sum(channel**2 / rates[:, None], axis=0) + of_products
        weights = np.maximum(weights, 1e-12 * float(weights.max(initial=0.0)) or 1.0)
        for factor in 8.0 ** np.arange(6):
            content = {
                "point": point.tolist(),
                "L": L.tolist(),
                "T": T.tolist(),
                "weights": {
                    e.name: [float(w) for w, c in zip(factor * weights, system.channels) if c == e.name]
                    for e in system.elements
                },
            }
            with suppress(ArithmeticError):  # a number out of range
                if inequality.stable_ratio(content) >= 1.0:
                    return content
    return None


def _lyapunov_factors(A: FloatArray) -> Iterator[tuple[FloatArray, FloatArray]]:
    """Pairs (L, T = L^-1) with ``L A T`` plus its transpose negative definite, as far as A is stable.

    One in modal coordinates, one from the Lyapunov equation of the balanced matrix.
    """
    if not len(A):
        yield np.zeros((0, 0)), np.zeros((0, 0))
        return
    values, vectors = cast("tuple[ComplexArray, ComplexArray]", linalg.eig(A))
    columns = [vectors[:, i].real for i in range(len(A)) if values[i].imag == 0.0]
    for i in range(len(A)):
        if values[i].imag > 0.0:
            columns += [vectors[:, i].real, vectors[:, i].imag]
    modal = np.stack(columns, axis=1)
    factors, pivots, _ = linalg.lapack.dgetrf(modal)
    inverse, info = linalg.lapack.dgetri(factors, pivots)
    if info == 0:
        yield inverse, modal
    balanced, scale = in_balanced_units(A)
    X = linalg.solve_continuous_lyapunov(balanced.T, -np.eye(len(A)))
    R, info = linalg.lapack.dpotrf(0.5 * (X + X.T), lower=0)
    if info == 0:
        yield R / scale, scale[:, None] * linalg.solve_triangular(R, np.eye(len(A)))
