"""Mutations of a bundle of proofs: is any accepted with another statement?

    python benchmarks/bundle_fuzz.py bundle.zip --count 2000 --seed 1 --figure "fsm+pma,fast, 128.5 to 132"

Half of the mutations change bytes of the file. The others change a field and make new hashes, as somebody would who
forges a bundle: a number or a text of telescope, controllers or manifest, the name of a member, an entry of a proof's
header, an element of one of its arrays, or the box of a proof with its strips, which is then wider than the
telescope's. Each is opened and checked as ``los-testbed design check-proof`` does, with the
models made anew. Outcomes:

==============  ========================================================================================================
``refused``     with a ``ProofError``
``same``        accepted, and subject, figures, levels, limits, bands, box and stability are those of the bundle
``subject``     opened, but it names another telescope or other controllers: not the statement of this pair
``fewer``       accepted without a proof that was taken out: what it still says the bundle says, too, and its name
                is another one
``wording``     accepted, but the requirements have other names, probabilities or confidence: the limits are the same,
                and what is proven has none of these
``proven``      accepted with another level, which the strips prove: it is above the largest value known
``FORGED``      anything else; the exit code is 1
==============  ========================================================================================================

Strips, stability and loops that were checked once are remembered by their content, so that a mutation costs what it
changes. ``--figure STAGE,FIGURE`` keeps some proofs of the bundle only.
"""

from __future__ import annotations

import argparse
import collections
import copy
import hashlib
import io
import json
import math
import random
import sys
import tempfile
import zipfile
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from lftkit.proofs.sampled_loop import LoopModel
from lftkit.proofs.trusted import sampled_loop
from lftkit.proofs.trusted.proof import ProofError, Strip
from lftkit.proofs.trusted.strips import check_strip
from los_design.search.worst_points import load_worst_points
from los_design.verification import bundle as bundles
from los_design.verification.bundle import MANIFEST, CheckedBundle, as_mapping, check_bundle, member_of, open_bundle
from los_design.verification.certify import model_digest
from los_design.verification.noise_certificate import NOISE

Members = dict[str, bytes]
STATED = ("subject", "box", "requirements", "stable_below")
SMALL = (1e-3, 1e-6, 1e-12)
"""Relative changes of a number that are tried beside large ones."""


class Remembered:
    """Outcomes of a pure function by a key of its arguments."""

    def __init__(self, function: Callable[..., Any], key: Callable[..., bytes]) -> None:
        self.function, self.key, self.known = function, key, dict[bytes, Any]()

    def __call__(self, *arguments: Any) -> Any:
        key = self.key(*arguments)
        if key not in self.known:
            self.known[key] = self.function(*arguments)
        return self.known[key]


def model_key(model: LoopModel, box: Any) -> str:
    """Of all that a model is."""
    return model_digest(model, box)


def strip_key(item: tuple[LoopModel, Strip, float]) -> bytes:
    """Of a strip with its model and level."""
    model, strip, level = item
    key = hashlib.sha256(repr((model_key(model, strip.box), level)).encode())
    for array in (strip.nodes, strip.factor, *strip.D, *strip.G):
        key.update(f"{array.dtype} {array.shape}".encode() + np.ascontiguousarray(array).tobytes())
    return key.digest()


def stability_key(model: LoopModel, band: Any, box: Any) -> bytes:
    """Of what is known of stability."""
    return repr((model_key(model, box), band)).encode()


def remember() -> Callable[..., Iterable[int | str]]:
    """Let checks of stability and loops be remembered; returns the map over strips that does so, too."""
    strip = Remembered(check_strip, strip_key)
    stability: Any = Remembered(sampled_loop.stable_below, stability_key)
    sampled_loop.stable_below = stability
    patched: Any = bundles
    make, made = patched.provable_open_loop, dict[Any, Any]()

    def open_loop(telescope: Any, *laws: Any) -> Any:
        key = telescope, *((law.inputs, law.outputs, law.dt) for law in laws)
        if key not in made:
            made[key] = make(telescope, *laws)
        return made[key]

    patched.provable_open_loop = open_loop

    def each(_: Any, items: Iterable[Any]) -> Iterator[int | str]:
        return (strip(item) for item in items)

    return each


def members_of(path: Path) -> Members:
    """Content of a zip file."""
    with zipfile.ZipFile(path) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


def written(members: Members, target: Path, hashed: bool = True) -> None:
    """A zip file of members, whose manifest has their hashes."""
    manifest = json.loads(members[MANIFEST])
    if hashed:
        manifest["sha256"] = {n: hashlib.sha256(data).hexdigest() for n, data in members.items() if n != MANIFEST}
    with zipfile.ZipFile(target, "w", zipfile.ZIP_STORED) as archive:
        for name, data in {**members, MANIFEST: json.dumps(manifest).encode()}.items():
            archive.writestr(name, data)


def leaves(value: Any, path: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    """Paths of all numbers, texts and truth values of a JSON value."""
    if isinstance(value, dict):
        return [found for key, item in value.items() for found in leaves(item, (*path, key))]
    if isinstance(value, list):
        return [found for key, item in enumerate(value) for found in leaves(item, (*path, key))]
    return [path]


def other_value(old: Any, chance: random.Random) -> Any:
    """Another value in place of an entry."""
    if isinstance(old, bool):
        return not old
    if isinstance(old, (int, float)):
        step = chance.choice((*SMALL, -1e-3, -1e-6, 0.1, -0.1, 1.0, -2.0))
        return chance.choice((old * (1.0 + step), old + step, float(np.nextafter(float(old), np.inf)), int(old) + 1))
    return chance.choice((f"{old}x", "", None, 0, [old]))


def other_json(text: bytes, chance: random.Random) -> bytes:
    """JSON with one entry changed or left out."""
    content = json.loads(text)
    *way, last = chance.choice(leaves(content))
    place = content
    for key in way:
        place = place[key]
    if chance.random() < 0.15 and isinstance(place, (dict, list)):
        del place[last]
    else:
        place[last] = other_value(place[last], chance)
    return json.dumps(content).encode()


def other_proof(data: bytes, chance: random.Random) -> bytes:
    """A proof with another entry of its header, another number in an array, or an array left out."""
    with np.load(io.BytesIO(data), allow_pickle=False) as archive:
        arrays = {name: archive[name] for name in archive.files}
    kind = chance.random()
    name = chance.choice(sorted(arrays))
    if kind < 0.4:
        arrays["header"] = np.frombuffer(other_json(bytes(arrays["header"]), chance), np.uint8)
    elif kind < 0.45:
        del arrays[name]
    elif arrays[name].size:
        flat = arrays[name].copy().reshape(-1)
        k = chance.randrange(flat.size)
        step = chance.choice((*SMALL, -1e-3, 0.1, -0.1, 1.0, -2.0))
        flat[k] = chance.choice((flat[k] * (1.0 + step), -flat[k], 0)) if flat.dtype.kind in "fc" else flat[k] + 1
        arrays[name] = flat.reshape(arrays[name].shape)
    target = io.BytesIO()
    np.savez(target, **arrays)
    return target.getvalue()


def wider_box(data: bytes, chance: random.Random) -> bytes:
    """A proof and its strips of a wider range of some parameter: what holds there holds in the telescope's box.

    Levels are raised for some: a proof at a level that is far above its gain holds in a box that is much wider.
    """
    with np.load(io.BytesIO(data), allow_pickle=False) as archive:
        arrays = {name: archive[name] for name in archive.files}
    header = json.loads(bytes(arrays["header"]))
    claim, names = header["claim"], header["plant"]["parameters"]
    boxes, k, factor = arrays["boxes"].copy(), chance.randrange(len(names)), 1.0 + chance.choice((*SMALL, 0.1))
    ends = claim["box"][names[k]]
    for end in (0, 1):
        face = boxes[:, k, end]
        boxes[:, k, end] = np.where(face == ends[end], factor * face, face)
        ends[end] *= factor
    if "level" in claim:
        claim["level"] *= chance.choice((1.0, 1.5, 1e3))
    arrays |= {"boxes": boxes, "header": np.frombuffer(json.dumps(header).encode(), np.uint8)}
    target = io.BytesIO()
    np.savez(target, **arrays)
    return target.getvalue()


def other_names(members: Members, chance: random.Random) -> Members:
    """Members exchanged, renamed or left out."""
    names = sorted(set(members) - {MANIFEST})
    one, two = chance.choice(names), chance.choice(names)
    changed = dict(members)
    kind = chance.randrange(3)
    if kind == 0:
        changed[one], changed[two] = members[two], members[one]
    elif kind == 1:
        stage, figure = chance.choice(("fsm", "fsm+pma")), chance.choice(("slow", "fast", "APE", "noise", "mirror"))
        changed[member_of(stage, figure)] = changed.pop(one)
    else:
        del changed[one]
    return changed


def mutated(members: Members, data: bytes, target: Path, chance: random.Random) -> str:
    """Write a mutation; returns its kind."""
    if chance.random() < 0.5:
        other = bytearray(data)
        for _ in range(chance.choice((1, 1, 2, 8))):
            other[chance.randrange(len(other))] = chance.randrange(256)
        target.write_bytes(bytes(other))
        return "bytes"
    kind = chance.choice(("proof", "proof", "proof", "box", "json", "manifest", "names"))
    if kind == "names":
        written(other_names(members, chance), target)
        return kind
    of_proof = kind in ("proof", "box")
    names = [name for name in members if name.endswith(".npz") == of_proof and name != MANIFEST]
    if kind == "box":
        names = [name for name in names if not name.endswith(f"-{NOISE}.npz")]  # its strips are in other arrays
    name = MANIFEST if kind == "manifest" else chance.choice(names)
    change = {"proof": other_proof, "box": wider_box}.get(kind, other_json)
    changed = change(members[name], chance)
    written({**members, name: changed}, target, hashed=kind != "manifest")
    return kind


def stated(checked: CheckedBundle) -> dict[str, Any]:
    """What a bundle states, without counts of strips and windows."""
    content = json.loads(json.dumps(as_mapping(checked)))
    rows = [[row[k] for k in ("stage", "figure", "level", "limit", "band")] for row in content["figures"]]
    return {**{name: content[name] for name in STATED}, "figures": rows, "noise": content["noise"]}


def outcome(path: Path, own: dict[str, Any], each: Callable[..., Iterable[int | str]]) -> str:
    """What becomes of a mutation."""
    try:
        with open_bundle(path) as bundle:
            subject = json.loads(json.dumps(vars(bundle.subject)))
            if subject != own["subject"]:
                return "subject"
            said = stated(check_bundle(bundle, each))
    except ProofError:
        return "refused"
    if said == own:
        return "same"
    if {**said, "requirements": own["requirements"]} == own:
        return "wording"
    if fewer(said, own):
        return "fewer"
    other = copy.deepcopy(said)
    for row, first in zip(other["figures"], own["figures"]):
        row[2] = first[2]
    known = {(p.stage, p.requirement): p.gamma for t in load_worst_points(None).values() for p in t.values()}
    above = all(row[2] > known.get((row[0], row[1]), 0.0) for row in said["figures"])
    return "proven" if other == own and above else "FORGED"


def fewer(said: dict[str, Any], own: dict[str, Any]) -> bool:
    """Whether a statement is a part of another one: some of its figures and noise, stability no further."""
    reach = {s: math.inf if at is None else at for s, at in own["stable_below"].items()}
    stable = all((math.inf if at is None else at) <= reach[s] for s, at in said["stable_below"].items())
    noise = all(own["noise"].get(stage) == bounds for stage, bounds in said["noise"].items())
    rows = len(said["figures"]) < len(own["figures"]) and all(row in own["figures"] for row in said["figures"])
    without = len(said["noise"]) < len(own["noise"])
    same = all(said[name] == own[name] for name in ("subject", "box", "requirements"))
    return (rows or (without and said["figures"] == own["figures"])) and stable and noise and same


def reduced(path: Path, figures: list[str], target: Path) -> Path:
    """The bundle with some proofs only."""
    members = members_of(path)
    kept = {member_of(*name.split(",", 1)) for name in figures}
    written({n: d for n, d in members.items() if not n.endswith(".npz") or n in kept or not kept}, target)
    return target


def attacked(
    source: Path, count: int, seed: int, each: Callable[..., Iterable[int | str]], target: Path
) -> collections.Counter[tuple[str, str]]:
    """Kinds and outcomes of some mutations; what is accepted with another statement is left as a file."""
    counts: collections.Counter[tuple[str, str]] = collections.Counter()
    chance = random.Random(seed)
    with open_bundle(source) as bundle:
        own = stated(check_bundle(bundle, each))
    members, data = members_of(source), source.read_bytes()
    for number in range(count):
        kind = mutated(members, data, target, chance)
        found = outcome(target, own, each)
        counts[kind, found] += 1
        if found == "FORGED":
            Path(f"forged-{seed}-{number}.zip").write_bytes(target.read_bytes())
        if number % 50 == 49:
            sys.stderr.write(f"{number + 1} of {count}: {dict(counts)}\n")
    return counts


def main() -> None:
    """Mutate and print the counts."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("bundle", type=Path)
    parser.add_argument("--count", type=int, default=2000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--figure", action="append", default=[], help="STAGE,FIGURE")
    options = parser.parse_args()
    each = remember()
    with tempfile.TemporaryDirectory() as folder, threadpool_limits(1):
        source = reduced(options.bundle, options.figure, Path(folder) / "bundle.zip")
        counts = attacked(source, options.count, options.seed, each, Path(folder) / "mutated.zip")
    print(json.dumps({f"{kind}, {found}": n for (kind, found), n in sorted(counts.items())}, indent=1))
    sys.exit(any(found == "FORGED" for _, found in counts))


if __name__ == "__main__":
    main()
