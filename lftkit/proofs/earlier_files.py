"""Headers of proofs of version 0.1, which had five formats, as those of the present one; for one release."""

from __future__ import annotations

from typing import Any

from lftkit.proofs.trusted.cells import digest
from lftkit.proofs.trusted.entries import FORMAT, each, pair, refuse, text
from lftkit.proofs.trusted.proof import REAL, require
from lftkit.support.format_names import current_name

KINDS = {
    "lftkit proof 1": "cells",
    "lftkit proof in discrete time 1": "cells",
    "lftkit loop proof 1": "sampled loop",
    "lftkit axis proof 1": "axis",
    "lftkit noise proof 2": "noise",
}
CLAIM = {"kind": "property", "level": "level", "band": "band", "box": "box", "parts": "parts"}
"""Present names of entries that were in the header and are in its claim now."""
PLANT = {
    "names": "parameters",
    **{name: name for name in ("nominal", "groups", "kinds", "angle", "rows", "commands", "added", "returned")},
}
"""The same of its plant."""


def present_header(header: Any) -> Any:
    """Header of the present format; anything else as it is given.

    Raises
    ------
    ProofError
        A header of an earlier format whose SHA-256 is another, or whose names and box do not fit to each other.
    """
    name = current_name(header.get("format")) if isinstance(header, dict) else None
    if not isinstance(name, str) or name not in KINDS:
        return header
    require(not {"claim", "plant"} & header.keys(), f"a header of {name!r} must have no claim and no plant, got one")
    kind = KINDS[name]
    found: dict[str, Any] = {"format": FORMAT, "kind": kind}
    if kind == "cells":
        return _of_cells(header, found, "discrete" in name)
    names, box = each(text)(header.get("names"), "names"), each(pair)(header.get("box"), "box")
    if len(names) != len(box) or len(set(names)) != len(names):
        raise refuse("names", "one of its own for each interval of the box", names)
    placed = {"format", *CLAIM, *PLANT}
    claim = {CLAIM[key]: value for key, value in header.items() if key in CLAIM}
    plant = {PLANT[key]: value for key, value in header.items() if key in PLANT}
    defaults = {"sampled loop": {"property": "gain"}, "noise": {"property": "noise"}, "axis": {}}[kind]
    if kind == "axis":
        plant = {"kinds": [REAL] * len(names), **plant}
    found["claim"] = {**defaults, **claim, "box": {name: list(ends) for name, ends in zip(names, box)}}
    return {**found, "plant": plant, **{key: value for key, value in header.items() if key not in placed}}


def _of_cells(header: dict[str, Any], found: dict[str, Any], discrete: bool) -> dict[str, Any]:
    require(header.get("sha256") == digest(header), "the content must match its SHA-256: the file was altered")
    system = header.get("system")
    own = isinstance(system, dict) and ("dt" in system) == discrete
    require(own, "a proof must be one in discrete time where its system has dt, got another")
    moved = {key: name for key, name in CLAIM.items() if key in header}
    found["claim"] = {name: header[key] for key, name in moved.items()}
    found["plant"] = system
    known = {"format", "system", "sha256", *moved}
    found |= {key: value for key, value in header.items() if key not in known}
    return {**found, "sha256": digest(found)}
