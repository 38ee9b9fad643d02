"""Stored designs: their files, and the continuous controllers in them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from importlib import import_module
from pathlib import Path

import numpy as np

from lftkit import Port, SampledSystem, System, state_space
from lftkit.arrays import FloatArray, Matrices
from lftkit.errors import InputError
from lftkit.systems.ports import spread_columns
from titop_plant.interface import K_FSM_INPUTS, K_FSM_OUTPUTS
from titop_plant.telescope.loop_ports import LoopPorts
from titop_plant.telescope.telescope import Telescope

DESIGN_PACKAGES = {"k-fsm": "los_estimator", "k-pma": "fsm_pma_controller"}
VARIANTS = ("implemented", "implemented_nominal")


def design_file(kind: str, variant: str = "implemented") -> Path:
    """File of a stored design.

    Raises
    ------
    ValueError
        Unknown kind or variant.
    """
    if kind not in DESIGN_PACKAGES or variant not in VARIANTS:
        raise InputError(
            f"kind and variant must be one of {', '.join(DESIGN_PACKAGES)} and one of {', '.join(VARIANTS)}, "
            f"got {kind!r} and {variant!r}"
        )
    stem = kind.replace("-", "_") + ("" if variant == "implemented" else f"_{variant}")
    return Path(str(import_module(DESIGN_PACKAGES[kind]).__file__)).parent / "designs" / f"{stem}.json"


def continuous(system: SampledSystem) -> System:
    """The continuous controller that a stored design was sampled from, without washout.

    Measured ports that the file of an observer leaves out have no effect.

    Raises
    ------
    ValueError
        The file does not hold it.
    """
    matrices = system.provenance.get("continuous")
    if not isinstance(matrices, Mapping):
        raise InputError(f"{system.name}: the file holds no continuous controller, only the sampled one")
    A, B, C, D = (np.array(matrices[key], dtype=float) for key in "ABCD")
    n, (rows, columns) = len(A), D.shape  # lists of no states have lost their other dimension
    A, B, C = A.reshape(n, n), B.reshape(n, columns), C.reshape(rows, n)
    return state_space(A, *_for_loop(B, C, D, system.inputs, system.outputs))


def _for_loop(
    B: FloatArray, C: FloatArray, D: FloatArray, inputs: Sequence[Port], outputs: tuple[Port, ...]
) -> tuple[FloatArray, FloatArray, FloatArray, tuple[Port, ...], tuple[Port, ...]]:
    """B, C, D, inputs, outputs of a controller, an observer behind all measured ports."""
    if [port.name for port in outputs] != [port.name for port in K_FSM_OUTPUTS]:
        return B, C, D, tuple(inputs), outputs
    of_reference = {port.name for port in K_FSM_INPUTS}
    known = (*K_FSM_INPUTS, *(port for port in inputs if port.name not in of_reference))
    return spread_columns(B, inputs, known), C, spread_columns(D, inputs, known), known, outputs


def shipped(path: Path) -> bool:
    """Whether a path is that of a stored design: those that the package has are not overwritten."""
    files = [design_file(kind, variant).resolve() for kind in DESIGN_PACKAGES for variant in VARIANTS]
    return path.resolve() in files and path.exists()


def load_designs(variant: str) -> tuple[SampledSystem, SampledSystem]:
    """Stored K_FSM and K_PMA of a variant.

    Raises
    ------
    ValueError
        A file is missing; the message says which command makes it.
    """
    result = []
    for kind in ("k-fsm", "k-pma"):
        path = design_file(kind, variant)
        if not path.exists():
            flags = " --nominal" if "nominal" in variant else ""
            raise InputError(
                f"there is no {path.name}: make it with `los-testbed design {kind}{flags} --output {path}`"
            )
        result.append(SampledSystem.from_file(path))
    return result[0], result[1]


def of_shipped_designs(telescope: Telescope) -> bool:
    """Whether the shipped controllers, and what is stored beside them, were made for these parameters."""
    made_for = load_designs("implemented")[0].design_basis["parameters_hash"]
    return bool(made_for == telescope.parameters_hash)


def design_ports(kind: str, ports: LoopPorts) -> tuple[tuple[Port, ...], tuple[Port, ...]]:
    """Input and output ports of a kind of design in a loop with some rows."""
    name = kind.replace("-", "_")
    return ports.of_design(name).law_ports(name)


def matrices_of(kind: str, M: FloatArray, ports: LoopPorts) -> Matrices:
    """A, B, C, D of a controller of this kind whose gain matrix ``[A, B; C, D]`` is M."""
    n = len(M) - sum(port.size for port in design_ports(kind, ports)[1])
    return M[:n, :n], M[:n, n:], M[n:, :n], M[n:, n:]
