"""Forge files of small proofs for some minutes: ``python tests/fuzz/forge_proofs.py --minutes=10 [--seed=N]``.

Of one proof of each format, with known members, files are made that claim less than what a member has: scalings of any
magnitude, numbers out of range, other types that pass for the right ones, entries that are doubled, added or left out,
other frequencies, boxes and matrices, all with new hashes. A file that passes the check is a finding if what it states
is false: a member of its own system, in its own box and band, has a larger gain or is unstable, or its noise is larger.

Exit code: 0 nothing found; 1 something was found: the file is kept, and its name printed with the seed that makes it.
"""

from __future__ import annotations

import argparse
import collections
import contextlib
import copy
import io
import json
import math
import random
import re
import sys
import tempfile
import time
import zipfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from lftkit import Port, RealParameter, System
from lftkit.proofs import BoundOptions, ProofError, check_proof, robust_stability, worst_case_gain
from lftkit.proofs.sampled_loop import LoopProof, box_of, loop_model, prove_level, write_loop_proof
from lftkit.proofs.sampled_loop.bounds import member_gains
from lftkit.proofs.sampled_loop.files import read_loop_proof, read_noise_proof
from lftkit.proofs.trusted.cells import digest
from lftkit.proofs.trusted.noise import NoisePart, NoiseProof
from lftkit.synthesis import hinfsyn, lower_bound_proof
from lftkit.tuning.published_plants import published_plant

DT = 0.1
NYQUIST = math.pi / DT
ONE, TWO = 5.3, 7.5
"""Levels of the small proofs: of the loop, and of two equal rows, whose gains are 5.03 and 7.11."""
SPECIAL = (math.inf, -math.inf, math.nan, 0.0, 5e-324, 1e-310, 1e-160, 1e160, 1e300, 8.9e307, 1e308, 1.7e308, -1e308)
TYPES: tuple[Any, ...] = (True, False, None, "1", 1, 0, -1, 1.0, 0.5, [], [0], {}, [True], [False], 2**70)
LESS = (0.01, 0.3, 0.9, 0.98)
"""Parts of the known value that are claimed."""
MEMBERS, FREQUENCIES = 24, 400
SMALLEST = 1e-6
"""Part by which a statement must be exceeded to be false."""

Content = tuple[dict[str, Any], dict[str, Any]]


def read(path: Path) -> Content:
    """Header and arrays; a JSON file is a header."""
    if path.suffix == ".json":
        return json.loads(path.read_text("utf-8")), {}
    with np.load(path) as archive:
        arrays = {name: archive[name] for name in archive.files}
    return json.loads(bytes(arrays.pop("header"))), arrays


def write(path: Path, content: Content, twice: str = "") -> None:
    """A file with new hashes; `twice` is a key that comes again at its end, with another value."""
    header, arrays = content
    if path.suffix == ".json":
        header = {**header, "sha256": digest(header)}
    text = json.dumps(header)
    if twice:
        text = f"{text[:-1]}, {json.dumps(twice)}: 0.01}}"
    if path.suffix == ".json":
        path.write_text(text, "utf-8")
        return
    with zipfile.ZipFile(path, "w") as archive:
        for name, values in {"header": np.frombuffer(text.encode(), np.uint8), **arrays}.items():
            stream = io.BytesIO()
            np.save(stream, values)
            archive.writestr(f"{name}.npy", stream.getvalue())


def example() -> System:
    """A mode of 1 rad/s and gain 5 whose stiffness changes by 1 %; the parameter itself is from -1 to 1."""
    p = RealParameter("p", 0.0, -1.0, 1.0)
    B, C = [[0.0, 0.0], [-0.1, 1.0]], [[0.1, 0.0], [1.0, 0.0]]
    ports = [Port("f", 1)], [Port("x", 1)]
    return System([[0.0, 1.0], [-1.0, -0.2]], B, C, np.zeros((2, 2)), *ports, channels=("p",), elements=(p,))


def generalised() -> System:
    """An unstable plant with disturbance, noise, weighted state and command: no controller has a norm below 4.78."""
    ports = [Port("w", 2), Port("u", 1)], [Port("z", 2), Port("y", 1)]
    C, D = [[1.0, 0.0], [0.0, 0.0], [1.0, 0.0]], [[0.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, 1.0, 0.0]]
    return System([[0.0, 1.0], [1.0, -0.2]], [[0.0, 0.0, 0.0], [1.0, 0.0, 1.0]], C, D, *ports)


NAMES = "loop.npz", "noise.npz", "axis.npz", "cells.json", "stable.json", "bound.npz", "noiseless.npz"


def originals(folder: Path) -> list[Path]:
    """One small proof of each format."""
    system = example()
    model, box, names = loop_model(system, dt=DT), box_of(system), tuple(p.name for p in system.parameters)
    strips = tuple(prove_level(model, box, (0.0, NYQUIST), level=ONE).strips)
    files = [folder / name for name in NAMES]
    write_loop_proof(LoopProof(model, names, box, (0.0, NYQUIST), ONE, strips, {}), files[0])
    two = replace(model, C=np.vstack([model.C, model.C[-1:]]), D=np.vstack([model.D, model.D[-1:]]), rows=(0, 1))
    both = tuple(prove_level(two, box, (0.0, NYQUIST), level=TWO).strips)
    write_loop_proof(NoiseProof(two, names, box, (NoisePart((0, 1), (0.0, NYQUIST), TWO, both),)), files[1])
    for file, method in ((files[2], "axis"), (files[3], "cells")):
        proof: Any = worst_case_gain(system, options=BoundOptions(method=method)).proof
        proof.to_file(file)
    proven: Any = robust_stability(system, largest=1.0, options=BoundOptions(method="cells")).proof
    proven.to_file(files[4])
    for file, plant in ((files[5], generalised()), (files[6], published_plant("HE1"))):
        bound: Any = lower_bound_proof(plant, "y", "u").proof
        bound.to_file(file)
    for file in files:
        check_proof(file)
    return files


def members(box: list[tuple[float, float]]) -> np.ndarray[Any, Any]:
    """Some points of a box, corners among them."""
    ends = np.array(box, dtype=float).reshape(len(box), 2)
    points = np.random.default_rng(0).uniform(size=(MEMBERS, len(box)))
    points[::2] = np.round(points[::2])
    return np.asarray(ends[:, 0] + points * (ends[:, 1] - ends[:, 0]))


def grid(low: float, high: float) -> np.ndarray[Any, Any]:
    """Frequencies of a band; of one without an end up to 1e3 rad/s."""
    high = min(high, 1e3)
    return np.unique(np.clip(np.r_[low, np.geomspace(1e-3, 1e3, FREQUENCIES), np.linspace(0.5, 2.0, 101)], low, high))


def loop_exceeds(path: Path, checked: Any) -> bool:
    """Whether a member of a loop has a larger gain than was stated."""
    proof = read_loop_proof(path)
    points = members(list(proof.box))
    largest = max(float(member_gains(proof.model, max(float(w), 1e-6), points).max()) for w in grid(*proof.band))
    return largest > checked.level * (1.0 + SMALLEST)


def noise_exceeds(path: Path, checked: Any) -> bool:
    """Whether a member has a larger gain in a part than the level that counts there for all rows."""
    proof = read_noise_proof(path)
    points, rows = members(list(proof.box)), tuple(map(int, proof.model.rows))
    for part in proof.parts:
        model = replace(proof.model, rows=rows if part.rows == proof.model.rows else tuple(map(int, part.rows)))
        gains = [float(member_gains(model, max(float(w), 1e-6), points).max()) for w in grid(*part.band)]
        if max(gains) > part.level * (1.0 + SMALLEST):
            return True
    return False


def system_exceeds(path: Path, checked: Any) -> bool:
    """Whether a member of a system has a larger gain than stated, or is unstable where stability is."""
    header, arrays = read(path)
    own, names = {**header["plant"], **arrays}, list(checked.box)
    A, B, C, D = (np.array(own[key], dtype=float) for key in "ABCD")
    cells = path.suffix == ".json"
    nominal = [p["nominal"] for p in own["parameters"]] if cells else own["nominal"]
    groups = [[i for i, c in enumerate(own["channels"]) if c == n] for n in names] if cells else own["groups"]
    q = sum(map(len, groups))
    for point in members([checked.box[name] for name in names]):
        delta = np.zeros(q)
        for group, value, at in zip(groups, point, nominal):
            delta[list(group)] = value - at
        inner = np.diag(delta) @ np.linalg.inv(np.eye(q) - D[:q, :q] * delta)
        left, right = {"x": B[:, :q], "e": D[q:, :q]}, {"x": C[:q], "d": D[:q, q:]}
        of = {("x", "x"): A, ("x", "d"): B[:, q:], ("e", "x"): C[q:], ("e", "d"): D[q:, q:]}
        closed = {key: M + left[key[0]] @ inner @ right[key[1]] for key, M in of.items()}
        if checked.stable and np.linalg.eigvals(closed["x", "x"]).real.max(initial=-1.0) > 0.0:
            return True
        for w in grid(*checked.band) if checked.kind == "gain" else ():
            states = np.linalg.solve(1j * w * np.eye(len(A)) - closed["x", "x"], closed["x", "d"])
            T = closed["e", "x"] @ states + closed["e", "d"]
            if np.linalg.norm(T, 2) > checked.level * (1.0 + SMALLEST):
                return True
    return False


def bound_exceeds(path: Path, checked: Any) -> bool:
    """Whether the loop of a controller, which is made for the plant of the file, has a norm below the bound."""
    _, arrays = read(path)
    (rows, columns), y, u = arrays["D"].shape, checked.measured, checked.commanded
    z, w = ([k for k in range(size) if k not in own] for size, own in ((rows, y), (columns, u)))
    outputs, inputs = [*z, *y], [*w, *u]
    ports = [Port("w", len(w)), Port("u", len(u))], [Port("z", len(z)), Port("y", len(y))]
    B, C, D = arrays["B"][:, inputs], arrays["C"][outputs], arrays["D"][np.ix_(outputs, inputs)]
    return hinfsyn(System(arrays["A"], B, C, D, *ports, dt=checked.dt), "y", "u").value < checked.level


FALSE: dict[str, Callable[[Path, Any], bool]] = {
    "loop": loop_exceeds,
    "noise": noise_exceeds,
    **dict.fromkeys(("axis", "cells", "stable"), system_exceeds),
    **dict.fromkeys(("bound", "noiseless"), bound_exceeds),
}


def places(value: Any, path: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    """Paths of all entries of a JSON value."""
    items = list(value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ())
    return [found for key, item in items for found in [(*path, key), *places(item, (*path, key))]]


def changed(value: Any, path: tuple[Any, ...], change: Callable[[Any], Any]) -> None:
    """Replace an entry of a JSON value in place."""
    for key in path[:-1]:
        value = value[key]
    value[path[-1]] = change(value[path[-1]])


def claim(content: Content, chance: random.Random) -> None:
    """Claim less than a member has (5 at least, 7.07 of two rows); more than the bound of all controllers."""
    header, part = content[0], chance.choice(LESS)
    own = header["claim"]
    if "unseen" in content[1]:
        own["level"] /= part
        return
    if own.get("level") is not None:
        own["level"] = 4.99 * part
    for entry in own.get("parts", ()):
        entry[3] *= 0.9 * part
    if own["property"] == "stability" and "A" in header["plant"]:
        header["plant"]["A"][-1][-1] = abs(header["plant"]["A"][-1][-1])  # damping that is negative


def scaling(content: Content, chance: random.Random) -> None:
    """All scalings, or those of one name, times a number of any magnitude or sign."""
    header, arrays = content
    exponent = chance.choice((chance.uniform(-330, 308), chance.uniform(300, 308.3), chance.uniform(-324, -300)))
    factor = chance.choice((1.0, 1.0, -1.0)) * (10.0 ** max(exponent, -323.0))
    if arrays:
        own = "unseen|unmoved|left|right|noiseless|decaying_adjoint|undisturbed|(.*_)?[DG][0-9]+|.*factors.*"
        names = [n for n in arrays if re.fullmatch(own, n)]
        for name in names if chance.random() < 0.6 else [chance.choice(names)]:
            values = arrays[name].astype(np.result_type(arrays[name], np.float64))
            size = float(np.abs(values).max()) if chance.random() < 0.5 else 1.0
            arrays[name] = values / (size or 1.0) * factor
        return
    keys = chance.choice((("P", "Q", "D", "G", "performance"), ("P", "Q"), ("D", "G"), ("performance",)))
    for cell in header["cells"]:
        for path in [p for p in places(cell) if p[0] in keys]:
            changed(cell, path, lambda old: old * factor if isinstance(old, (int, float)) else old)


def special(content: Content, chance: random.Random) -> None:
    """Some numbers out of range, in arrays or in the header."""
    header, arrays = content
    for _ in range(chance.choice((1, 1, 3, 20))):
        value = chance.choice(SPECIAL)
        if arrays and chance.random() < 0.8:
            name = chance.choice(sorted(arrays))
            flat = arrays[name].reshape(-1).copy()
            if flat.size and flat.dtype.kind in "fc":
                flat[chance.randrange(flat.size)] = value
                arrays[name] = flat.reshape(arrays[name].shape)
        else:
            numbers = [p for p in places(header) if p[0] != "sha256"]
            changed(header, chance.choice(numbers), lambda old, v=value: v if isinstance(old, (int, float)) else old)


def types(content: Content, chance: random.Random) -> None:
    """Entries of another type; rows, groups and parts most of all. Arrays of another type or shape."""
    header, arrays = content
    own = [p for p in places(header) if p[0] != "sha256"]
    some = [p for p in own if {*p} & {"rows", "groups", "parts", "angle", "kinds", "added", "returned", "commands"}]
    for _ in range(chance.choice((1, 2, 3))):
        path = chance.choice(some if some and chance.random() < 0.7 else own)
        with_bools = chance.random() < 0.4

        def other(old: Any, with_bools: bool = with_bools) -> Any:
            if with_bools and isinstance(old, (int, list)):
                numbers = isinstance(old, list) and all(isinstance(x, int) for x in old)
                return [bool(x) for x in old] if numbers else bool(old)
            return copy.deepcopy(chance.choice(TYPES))

        try:
            changed(header, path, other)
        except (KeyError, IndexError, TypeError):
            continue
    if arrays and chance.random() < 0.3:
        name = chance.choice(sorted(arrays))
        kinds = (bool, np.float32, np.int64, object, ">f8", np.complex128)
        with np.errstate(all="ignore"):
            values = arrays[name].real if chance.random() < 0.5 else arrays[name]
            arrays[name] = values.astype(kinds[chance.randrange(3)]) if chance.random() < 0.7 else values[None]


def masks(content: Content, chance: random.Random) -> None:
    """Rows as truth values, in the model and in its parts, at the level of one row."""
    header, _ = content
    plant = header["plant"]
    if "rows" in plant:
        plant["rows"] = [bool(row) for row in plant["rows"]]
        for part in header["claim"].get("parts", ()):
            part[0] = [bool(row) for row in part[0]]
            part[3] = TWO * chance.choice((0.72, 0.75, 0.8))


def uniform(content: Content, chance: random.Random) -> None:
    """One number as all D, no G: of such forms the largest overflow where they are made Hermitian."""
    _, arrays = content
    magnitude, factor = 10.0 ** chance.uniform(300.0, 308.2), 10.0 ** chance.uniform(-300.0, 300.0)
    for name in arrays:
        last = name.split("_")[-1]
        if last[1:].isdecimal() and last[0] in "DG":
            shape = arrays[name].shape
            arrays[name] = np.broadcast_to(np.eye(shape[-1]) * (magnitude if last[0] == "D" else 0.0), shape) + 0j
        elif last == "factors":
            arrays[name] = np.full(arrays[name].shape, factor)


def entries(content: Content, chance: random.Random) -> None:
    """Entries left out, added, exchanged."""
    header, arrays = content
    target = arrays if arrays and chance.random() < 0.5 else chance.choice((header, header["claim"], header["plant"]))
    name = chance.choice(sorted(target))
    if chance.random() < 0.5:
        del target[name]
    else:
        target[chance.choice((f"{name}x", "dt", "posed", "disks", "kinds", "added"))] = copy.deepcopy(target[name])


def frequencies(content: Content, chance: random.Random) -> None:
    """Other nodes, bands, boxes: narrower strips than the claim, subnormal windows, holes."""
    header, arrays = content
    factor = chance.choice((0.5, 2.0, 1e-300, 5e-324, -1.0, 1.0 + 1e-9))
    names = [n for n in arrays if n.endswith(("nodes", "boxes", "counts"))]
    if names and chance.random() < 0.7:
        name = chance.choice(names)
        with np.errstate(all="ignore"):
            arrays[name] = (arrays[name] * factor).astype(arrays[name].dtype)
    else:
        own = [p for p in places(header) if {*p} & {"band", "box", "border", "nominal", "intervals", "centre"}]
        changed(header, chance.choice(own), lambda old: old * factor if isinstance(old, (int, float)) else old)


KINDS = (scaling, uniform, uniform, special, types, masks, entries, frequencies)


def forged(file: Path, target: Path, chance: random.Random) -> str:
    """Write a forgery of a proof; returns its kind."""
    header, arrays = read(file)
    content = header, dict(arrays)
    kinds = [chance.choice(KINDS) for _ in range(chance.choice((1, 1, 2)))]
    claim(content, chance)
    for kind in kinds:
        with contextlib.suppress(KeyError, IndexError, TypeError, ValueError, OverflowError, AttributeError):
            kind(content, chance)  # where an earlier change has left a place for this one
    twice = chance.choice(sorted(header)) if header and chance.random() < 0.05 else ""
    write(target, content, twice)
    return "+".join(kind.__name__ for kind in kinds)


def outcome(target: Path, kind: str) -> str:
    """``refused``, ``true`` (it passes, and what it states was not seen to be false), ``FALSE`` or ``raised``."""
    try:
        checked = check_proof(target)
    except ProofError:
        return "refused"
    except Exception as error:  # anything else is a finding of its own
        return f"RAISED {type(error).__name__}"
    with np.errstate(all="ignore"):
        try:
            return "FALSE" if FALSE[kind](target, checked) else "true"
        except (ValueError, KeyError, TypeError, IndexError, ArithmeticError, np.linalg.LinAlgError) as error:
            return f"UNKNOWN {type(error).__name__}"


def main(minutes: float, seed: int, kept: Path) -> int:
    """Forge until the time is over; the exit code."""
    counts, found = collections.Counter[str](), list[str]()
    with tempfile.TemporaryDirectory() as name:
        files, number = originals(Path(name)), 0
        end = time.monotonic() + 60.0 * minutes
        while time.monotonic() < end:
            chance = random.Random(f"{seed} {number}")
            file = chance.choice(files)
            target = Path(name) / f"forged{file.suffix}"
            number += 1
            try:
                kind = forged(file, target, chance)
            except (ValueError, OverflowError):
                continue  # no file can be written of it
            said = outcome(target, file.stem)
            counts[said] += 1
            if said not in ("refused", "true"):
                copy_of = kept / f"forged-{seed}-{number - 1}{file.suffix}"
                copy_of.write_bytes(target.read_bytes())
                found.append(f"{copy_of}: {file.stem}, {kind}: {said}")
    sys.stdout.write("".join(f"{line}\n" for line in found[:50]))
    word = "something was found" if found else "nothing found" if counts else "no forgery was made"
    sys.stdout.write(f"{sum(counts.values())} forgeries, {dict(counts)}, seed {seed}: {word}\n")
    return int(bool(found) or not counts)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--minutes", type=float, default=10.0)
    parser.add_argument("--seed", type=int, default=random.SystemRandom().randrange(10**6))
    parser.add_argument("--kept", type=Path, default=Path(), help="folder of the files that are findings")
    given = parser.parse_args()
    sys.exit(main(given.minutes, given.seed, given.kept))
