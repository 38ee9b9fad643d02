"""Systems from and to scipy.signal and JSON, sampled ones from files; and anything of these as a :class:`System`."""

from __future__ import annotations

import json
import os
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from lftkit.arrays import FloatArray
from lftkit.errors import InputError
from lftkit.support.atomic_output import write_text
from lftkit.support.input_files import check_file, read_text
from lftkit.support.input_limits import SYSTEM
from lftkit.support.structured_text import load_json
from lftkit.systems.arguments import checked
from lftkit.systems.mat_files import read_mat
from lftkit.systems.ports import Port, total_size
from lftkit.systems.sampled.sampled_system import SampledSystem
from lftkit.systems.symbolic.expressions import as_expression, ports_for
from lftkit.systems.system import System
from lftkit.systems.zeros_poles import zeros_poles
from lftkit.uncertainty.elements import ComplexParameter, DynamicElement, Element, RealParameter

FORMAT = "lftkit/system"
VERSION = 1
MATLAB = b"MATLAB 5.0"
"""First bytes of a .mat file of version 5 to 7.2."""
_KINDS: dict[str, type[Any]] = {"real": RealParameter, "complex": ComplexParameter, "dynamic": DynamicElement}
Given = tuple[ArrayLike, ArrayLike, ArrayLike, ArrayLike]


@checked
def as_system(value: Any, inputs: Any = None, outputs: Any = None) -> System:
    """Anything that is a linear system as a :class:`System`.

    Parameters
    ----------
    value : System, SampledSystem, Expression, number, matrix, or a system of python-control or scipy.signal
    inputs, outputs : str, or sequence of Port, (name, size) or str, optional
        Ports by position; otherwise those of the value, ``u`` and ``y`` where it has none.

    Raises
    ------
    ValueError
        Another type, or ports of other sizes.

    Examples
    --------
    >>> from scipy import signal
    >>> as_system(signal.TransferFunction([1.0], [1.0, 2.0])).poles().real.tolist()
    [-2.0]
    """
    if isinstance(value, System) and inputs is None and outputs is None:
        return value
    if isinstance(value, SampledSystem):
        value = System(value.A, value.B, value.C, value.D, value.inputs, value.outputs, value.name, value.dt)
    elif type(value).__module__.startswith("scipy.signal"):
        value = from_scipy(value)
    elif type(value).__module__.partition(".")[0] == "control":
        value = System.from_control(value)
    elif not isinstance(value, System):
        expression = as_expression(value)
        if expression is None:
            raise InputError(
                "system must be a System, SampledSystem, Expression, number, matrix, or a system of python-control "
                f"or scipy.signal, got {type(value).__name__}"
            )
        value = expression.system()
    sides: list[tuple[Port, ...]] = [
        ports if names is None else ports_for(names, total_size(ports))
        for names, ports in ((inputs, value.inputs), (outputs, value.outputs))
    ]
    made: System = value.with_lft(value.lft, inputs=sides[0], outputs=sides[1])
    return made


@checked
def from_scipy(system: Any) -> System:
    """A `scipy.signal.lti` or `dlti` (any of its forms), with its period; ports ``u`` and ``y``.

    Zeros and poles stay as they are: they do not become the coefficients of a fraction, as in scipy.

    Raises
    ------
    ValueError
        Another type, complex coefficients, or a discrete system without a period in seconds.
    """
    from scipy import signal

    if not isinstance(system, signal.lti | signal.dlti):
        raise InputError(f"system must be a scipy.signal lti or dlti, got {type(system).__name__}")
    if system.dt is True:
        raise InputError("system must have a sampling period in seconds, got dt True")
    if isinstance(system, signal.ZerosPolesGain) and np.ndim(system.zeros) < 2 and np.size(system.gain) == 1:
        gain = _real(np.atleast_2d(np.asarray(system.gain))).item()
        A, B, C, D = zeros_poles(system.zeros, system.poles, gain)
    else:
        ss = system.to_ss()
        A, B, C, D = (_real(np.atleast_2d(np.asarray(M))) for M in (ss.A, ss.B, ss.C, ss.D))
    if not np.any(B) and not np.any(C) and not np.any(A):  # how scipy writes a gain
        A, B, C = np.zeros((0, 0)), np.zeros((0, D.shape[1])), np.zeros((D.shape[0], 0))
    ports = (Port("u", D.shape[1]),), (Port("y", D.shape[0]),)
    return System(A, B, C, D, *ports, dt=float(system.dt or 0.0))


def _real(matrix: Any) -> FloatArray:
    """The matrix without imaginary parts that are rounding: poles that are conjugate to the last bits leave some."""
    whole = np.asarray(matrix, dtype=complex)
    if np.any(np.abs(whole.imag) > 1e-12 * np.abs(whole).max(initial=0.0)):
        raise InputError("system must have real coefficients, got complex ones")
    return np.asarray(whole.real, dtype=float)


@checked
def to_scipy(system: System) -> Any:
    """`scipy.signal.StateSpace` of a certain system, which has no names.

    Raises
    ------
    ValueError
        An uncertain system.
    """
    from scipy import signal

    system = as_system(system)
    return signal.StateSpace(*system.matrices, **({"dt": system.dt} if system.dt else {}))


def read_sampled(path: str | os.PathLike[str]) -> SampledSystem:
    """A sampled system from its JSON file or from a .mat file, told by the content; see :func:`read_mat`.

    Raises
    ------
    ValueError
        The file cannot be read, holds no system, or one without a sampling period ``Ts``.
    """
    try:
        check_file(path, SYSTEM)
        with open(path, "rb") as file:
            head = file.read(len(MATLAB))
    except OSError:
        head = b""  # the reader of JSON says why
    if head != MATLAB:
        return SampledSystem.from_file(path)
    system = read_mat(path)
    if not system.dt:
        raise InputError(f"{path}: system must have its sampling period Ts in s, got a continuous one")
    return as_sampled(system)


def as_sampled(system: System) -> SampledSystem:
    """A certain discrete system, ready to run.

    Raises
    ------
    ValueError
        An uncertain or continuous system.
    """
    return SampledSystem(*system.matrices, system.inputs, system.outputs, system.dt, system.name)


@checked
def to_json(system: System) -> str:
    """Text with everything of a system, its elements too, to the last bit: :func:`from_json` reads it."""
    system, kinds = as_system(system), {cls: kind for kind, cls in _KINDS.items()}
    content = {
        "format": FORMAT,
        "version": VERSION,
        "name": system.name,
        "dt": system.dt,
        "inputs": [asdict(p) for p in system.inputs],
        "outputs": [asdict(p) for p in system.outputs],
        "channels": list(system.channels),
        "elements": [{"kind": kinds[type(e)], **asdict(e)} for e in system.elements],
        **{key: getattr(system, key).tolist() for key in "ABCD"},
    }
    return json.dumps(content, indent=1, allow_nan=False)


@checked
def from_json(text: str) -> System:
    """System of the text that :func:`to_json` made.

    Raises
    ------
    ValueError
        Another text.
    """
    try:
        content = load_json(text, "text")
    except InputError as error:
        raise InputError(f"text must be JSON of a system: {error}") from None
    if not isinstance(content, dict) or content.get("format") != FORMAT or content.get("version") != VERSION:
        raise InputError(f'text must have "format": "{FORMAT}" and "version": {VERSION}, got another')
    try:
        sides = [tuple(Port(**p) for p in content[key]) for key in ("inputs", "outputs")]
        elements = tuple(_element(e) for e in content["elements"])
        A, B, C, D = (content[key] for key in "ABCD")
        channels = tuple(content["channels"])
        return System(A, B, C, D, sides[0], sides[1], content["name"], content["dt"], channels, elements)
    except KeyError as error:
        raise InputError(f"text must have the keys of a system, {error} is missing") from None
    except (TypeError, AttributeError, OverflowError) as error:
        raise InputError(f"text must describe a system, got: {error}") from None


def _element(content: Any) -> Element:
    if not isinstance(content, dict):
        raise TypeError(f"{content!r} as an element")
    kind = content.get("kind")
    if kind not in _KINDS:
        raise InputError(f"kind of an element must be one of {', '.join(_KINDS)}, got {kind!r}")
    made: Element = _KINDS[kind](**{key: value for key, value in content.items() if key != "kind"})
    return made


@checked
def write_system(path: str | os.PathLike[str], system: System) -> None:
    """Write a JSON file, whole or not at all."""
    write_text(Path(path), to_json(system) + "\n")


@checked
def read_system(path: str | os.PathLike[str]) -> System:
    """Read the file that :func:`write_system` wrote; a ValueError says what is wrong with it."""
    try:
        return from_json(read_text(path))
    except OSError as error:
        raise InputError(f"cannot read {path}: {error.strerror}") from None
    except ValueError as error:
        raise InputError(f"{path}: {error}") from None


def given_system(
    A: Any, B: ArrayLike | None, C: ArrayLike | None, D: ArrayLike | None, dt: float | None
) -> tuple[Given, float | None]:
    """Matrices and period, of a system in place of A too.

    Parameters
    ----------
    A : array_like, or what :func:`lftkit.as_system` takes
        A certain system stands for all four matrices.
    B, C, D : array_like or None
    dt : float or None
        Not beside a system, which has its own.

    Raises
    ------
    ValueError
        Some of the matrices only, a system beside another period, an uncertain system.
    """
    if B is not None and C is not None and D is not None:
        return (A, B, C, D), dt
    if not (B is None and C is None and D is None):
        missing = [name for name, matrix in zip("BCD", (B, C, D)) if matrix is None]
        raise InputError(f"matrices must be A, B, C and D, or one system, got no {' and no '.join(missing)}")
    system = as_system(A)
    if dt is not None and dt != system.dt:
        raise InputError(f"dt must be that of the system, {system.dt:g} s, got {dt:g} s")
    return system.matrices, system.dt or None
