"""Systems from and to .mat files (version 7.2 or older): state-space matrices, and uncertain ones as MATLAB's lftdata.

An uncertain system is ``F_u(M, Delta)``: its matrices are those of M, whose first inputs and outputs are the channels
of Delta, and the field ``Blocks`` says the elements in the order of their channels. **Delta is normalised**, as that of
``lftdata``: a channel has values in [-1, 1], of which -1, 0 and 1 are the lowest, nominal and highest value of its
element, and what lies between is the fractional map of :attr:`lftkit.RealParameter.bilinear`. Where a field
``Normalized`` is 0, as in the files that are written here, a channel is the deviation from the nominal value.
"""

from __future__ import annotations

import math
import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from lftkit.errors import InputError
from lftkit.support.atomic_output import atomic_file
from lftkit.support.input_limits import UNPACKED
from lftkit.support.mat_structure import check_mat
from lftkit.systems.arguments import checked
from lftkit.systems.ports import Port
from lftkit.systems.signal_labels import labels_of_ports, ports_of_labels, zero_based
from lftkit.systems.system import System
from lftkit.uncertainty.elements import RealParameter

BLOCKS = "blocks"
"""Field with the elements of an uncertain system, in lower case."""
BLOCK_FIELDS = "Name", "Nominal", "Range", "Occurrences", "Unit"
"""Fields of each of its elements."""
DELAYS = "inputdelay", "outputdelay", "iodelay", "internaldelay"
"""Fields of an `ss` object, in lower case, that a system here cannot have unless they are zero."""


@checked
def write_mat(path: str | os.PathLike[str], **systems: System) -> None:
    """Write systems to a .mat file, each as a struct: ``write_mat("plants.mat", P=plant)``.

    In MATLAB: ``load plants; P = ss(P.A, P.B, P.C, P.D, P.Ts, 'InputName', P.InputName, 'OutputName', P.OutputName)``.
    Names of signals are those of MATLAB: ``w(1)``, ``w(2)`` for a port ``w`` of two signals. An uncertain system has
    the field ``Blocks``, too, see :func:`read_mat`; names are those of the signals behind the channels of Delta.

    Raises
    ------
    ValueError
        No system, one with complex or dynamic elements, or a port with the name of a signal.
    """
    from scipy import io

    if not systems:
        raise InputError("systems must be given by keyword, got none")
    content = {}
    for name, system in systems.items():
        system.require_real()
        A, B, C, D = system.sorted_channels().lft
        names = [
            _cells([re.sub(r"\[(\d+)\]$", lambda m: f"({int(m[1]) + 1})", x) for x in labels_of_ports(side)])
            for side in (system.inputs, system.outputs)
        ]
        units = [_cells([u for p in side for u in p.units]) for side in (system.inputs, system.outputs)]
        content[name] = {"A": A, "B": B, "C": C, "D": D, "Ts": system.dt, "Name": system.name}
        content[name] |= {"InputName": names[0], "OutputName": names[1], "InputUnit": units[0], "OutputUnit": units[1]}
        if system.elements:
            # Field ``Blocks`` of a system whose channels are sorted by elements
            rows = np.zeros(
                (len(system.elements), 1),
                dtype=[(k, object) for k in BLOCK_FIELDS],
            )
            for row, (e, count) in enumerate(zip(system.parameters, system.occurrences().values())):
                rows[row, 0] = e.name, e.nominal, np.array([[e.lower, e.upper]]), float(count), e.unit
            content[name] |= {"Blocks": rows, "Normalized": 0.0}
    file = Path(path)
    with atomic_file(file if file.suffix else file.with_suffix(".mat")) as made:
        io.savemat(made, content, appendmat=False)


@checked
def read_mat(path: str | os.PathLike[str], name: str | None = None) -> System:
    """Read a system from a .mat file (version 7.2 or older): matrices A, B, C, D or a struct with these fields.

    MATLAB: ``save('plant.mat', 'A', 'B', 'C', 'D')``, or ``P = struct('A', G.A, 'B', G.B, 'C', G.C, 'D', G.D, 'Ts',
    G.Ts, 'InputName', {G.InputName}, 'OutputName', {G.OutputName}); save('plant.mat', 'P')``. Fields may be lower case,
    all but A, B, C, D may be missing. Of an uncertain system ``usys`` of the Robust Control Toolbox::

        [M, ~, blk] = lftdata(usys);
        P = struct('A', M.A, 'B', M.B, 'C', M.C, 'D', M.D);
        P.InputName = usys.InputName;  P.OutputName = usys.OutputName;
        for k = 1:numel(blk)
            u = usys.Uncertainty.(blk(k).Name);
            P.Blocks(k) = struct('Name', u.Name, 'Nominal', u.NominalValue, 'Range', u.Range, ...
                                 'Occurrences', blk(k).Occurrences);
        end
        save('plant.mat', 'P')

    Parameters
    ----------
    path : str or path
    name : str, optional
        Variable with the struct; needed where the file has several.

    Raises
    ------
    ValueError
        Delays, a descriptor matrix E that is not the unit matrix, or a TimeUnit other than seconds, as the struct of a
        whole `ss` object has them: without them it would be another system.
        A file that cannot be read, no system or several (also several in one array of structs), an `ss` object that was
        saved as such (only MATLAB reads it), matrices that do not fit, or blocks that are no real parameters.
    """
    from scipy import io

    try:
        check_mat(path)
        content = io.loadmat(path, squeeze_me=False, struct_as_record=True)
    except (OSError, ValueError, NotImplementedError, TypeError, io.matlab.MatReadError) as error:
        text = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise InputError(f"{path} must be a .mat file of version 7.2 or older, got: {text}") from None
    opaque = content.get("__function_workspace__") is not None
    variables = {key: value for key, value in content.items() if not key.startswith("__")}
    structs = {k: v for k, v in variables.items() if getattr(v.dtype, "names", None) and _matrices_of(_fields(v))}
    if name is None and _matrices_of(variables):
        return _from_fields(variables, Path(path).stem, path)
    if name is None and len(structs) == 1:
        name = next(iter(structs))
    if name not in structs:
        advice = " (an ss object must be saved as a struct: see read_mat)" if opaque else ""
        present = ", ".join(structs) or "none"
        raise InputError(f"{path} must hold one system, or name must be one of its structs, got {present}{advice}")
    if structs[name].size != 1:
        raise InputError(f"{path}: {name} must be one system, got an array of {structs[name].size}")
    return _from_fields(_fields(structs[name]), name, path)


def _fields(struct: Any) -> dict[str, Any]:
    return {key: struct[key].flat[0] for key in struct.dtype.names} if struct.size else {}


def _matrices_of(fields: Mapping[str, Any]) -> bool:
    return {"a", "b", "c", "d"} <= {key.lower() for key in fields}


def _from_fields(fields: Mapping[str, Any], name: str, path: Any) -> System:
    lower = {key.lower(): value for key, value in fields.items()}
    # Refuse what would be lost: delays, a descriptor matrix, another unit of time
    file = f"{path}: {name}"
    for key in DELAYS:
        if np.size(lower.get(key, ())) and np.any(_full(lower[key]) != 0):
            raise InputError(f"{file} must have no delays (pade or absorbDelay in MATLAB), got {key}")
    E = _full(lower.get("e", ()))
    if E.size and not np.array_equal(E, np.eye(len(E))):
        raise InputError(f"{file} must be an explicit state space (ss(G, 'explicit') in MATLAB), got a matrix E")
    if (unit := "".join(_texts(lower.get("timeunit"))) or "seconds") != "seconds":
        raise InputError(f"{file} must have the TimeUnit seconds (chgTimeUnit in MATLAB), got {unit}")
    try:
        A, B, C, D = (_full(lower[key]) for key in "abcd")
        elements, channels = _elements(lower.get(BLOCKS))
        q = len(channels)
        m, p = (n - q for n in ((B.shape[1] if B.size else D.shape[1]), (C.shape[0] if C.size else D.shape[0])))
        if m < 0 or p < 0:
            raise InputError(
                f"{name} must have the {q} channels of its Blocks first, got {m + q} inputs, {p + q} outputs"
            )
        sides = []
        for kind, count, default in (("input", m, "u"), ("output", p, "y")):
            labels = _texts(lower.get(f"{kind}name"))
            units = _texts(lower.get(f"{kind}unit"))
            if not any(labels):
                labels = [f"{default}[{i}]" for i in range(count)] if count > 1 else [default] * count
            if len(labels) != count:  # labels of fewer signals would leave out columns or rows
                raise InputError(f"{kind.capitalize()}Name must have {count} names, got {len(labels)}")
            if not any(units):
                units = ["1"] * count
            if len(units) != count:
                raise InputError(f"{kind.capitalize()}Unit must have {count} units, got {len(units)}")
            ports, order = ports_of_labels([zero_based(x) for x in labels], None, kind)
            sides.append((_with_units(ports, [units[i] for i in order]), order))
        (inputs, columns), (outputs, rows) = sides
        dt = _number(lower.get("ts", 0.0), "Ts")
        title = "".join(_texts(lower.get("name"))) or name
        right, below = (np.r_[np.arange(q), q + np.asarray(order)] for order in (columns, rows))
        matrices = A, B[:, right], C[below], D[np.ix_(below, right)]
        system = System(*matrices, inputs, outputs, title, dt, channels, elements)
        normalised = _number(lower.get("normalized", 1.0), "Normalized")
        if normalised not in (0.0, 1.0):
            raise InputError(f"Normalized must be 0 or 1, got {normalised:g}")
        return _in_own_units(system, elements) if normalised else system
    except (IndexError, TypeError) as error:
        raise InputError(f"{path}: {name} must have matrices that fit its names, got: {error}") from None
    except ValueError as error:
        raise InputError(f"{path}: {error}") from None


def _number(value: Any, key: str) -> float:
    """The only entry of a field."""
    entries = np.ravel(value)
    if entries.size != 1 or entries.dtype.kind not in "biuf":
        raise InputError(f"{key} must be a number, got {', '.join(map(str, entries[:3])) or 'none'}")
    return float(entries[0])


def _elements(table: Any) -> tuple[tuple[RealParameter, ...], tuple[str, ...]]:
    """Elements of the field ``Blocks``, and the name of each channel of Delta."""
    if table is None or not np.size(table):
        return (), ()
    if getattr(table.dtype, "names", None) is None:
        raise InputError("Blocks must be an array of structs with Name, Nominal, Range and Occurrences, got another")
    parameters, channels = [], list[str]()
    for entry in np.asarray(table).flat:
        block = {key.lower(): entry[key] for key in table.dtype.names}
        if missing := [key for key in ("name", "nominal", "range", "occurrences") if key not in block]:
            raise InputError(
                f"Blocks must have the field {missing[0].capitalize()}, got {', '.join(table.dtype.names)}"
            )
        name = "".join(_texts(block["name"]))
        ends, nominal = np.asarray(block["range"]), np.asarray(block["nominal"])
        if ends.size != 2 or nominal.size != 1 or ends.dtype.kind not in "iuf" or nominal.dtype.kind not in "iuf":
            raise InputError(
                f"block {name} must be a real parameter with Nominal and Range of two numbers, got another"
            )
        count = float(np.asarray(block["occurrences"]).flat[0])
        if count < 1 or count != int(count):
            raise InputError(f"Occurrences of block {name} must be a whole number above 0, got {count:g}")
        low, high = (float(x) for x in ends.flat)
        unit = "".join(_texts(block.get("unit"))) or "1"
        parameters.append(RealParameter(name, float(nominal.flat[0]), low, high, unit))
        channels += [name] * int(count)
    return tuple(parameters), tuple(channels)


def _in_own_units(system: System, elements: Sequence[RealParameter]) -> System:
    """The system whose normalised channels of Delta are deviations from the nominal values, in units of the elements.

    The inverse of :meth:`System.normalised`.
    """
    maps = {e.name: e.bilinear for e in elements}
    if fixed := [name for name, (a, _) in maps.items() if a == 0.0]:
        raise InputError(f"Range of block {fixed[0]} must hold more than one value, got one")
    q = len(system.channels)
    ab = np.array([maps[c] for c in system.channels]).reshape(q, 2)
    B, D = system.B.copy(), system.D.copy()
    D[np.arange(q), np.arange(q)] += ab[:, 1]
    B[:, :q] /= ab[:, 0]
    D[:, :q] /= ab[:, 0]
    return replace(system, B=B, D=D)


def _with_units(ports: Sequence[Port], units: Sequence[str]) -> tuple[Port, ...]:
    """Ports with the units of their signals, in the order of the ports: the common one, or all with commas between."""
    with_units, rest = list[Port](), iter(units)
    for port in ports:
        of_port = [next(rest) for _ in range(port.size)]
        with_units.append(replace(port, unit=(of_port[0] if len(set(of_port)) == 1 else ",".join(of_port)) or "1"))
    return tuple(with_units)


def _full(matrix: Any) -> Any:
    """A matrix that may be sparse, in full."""
    if not hasattr(matrix, "todense"):
        return np.asarray(matrix)
    if 8 * math.prod(matrix.shape) > UNPACKED:
        raise InputError(f"a sparse matrix must have at most {UNPACKED // 8} entries in full, got {matrix.shape}")
    return np.asarray(matrix.todense())


def _texts(value: Any) -> list[str]:
    """Strings of a cell array or a char array."""
    if value is None:
        return []
    return [str(np.asarray(x).flat[0]) if np.size(x) else "" for x in np.asarray(value).flat]


def _cells(texts: Sequence[str]) -> Any:
    cells = np.empty((len(texts), 1), dtype=object)
    cells[:, 0] = texts
    return cells
