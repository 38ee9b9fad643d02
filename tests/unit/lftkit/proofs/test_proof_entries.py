"""What files of proofs hold is read with exact types and shapes: entries are replaced, doubled, added, left out."""

from __future__ import annotations

import copy
import io
import json
import math
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.forged_proofs import zip_of_zeros
from support.uncertain_examples import aligned_modes

from lftkit.proofs import BoundOptions, ProofError, check_proof, worst_case_gain
from lftkit.proofs.sampled_loop import LoopProof, box_of, loop_model, prove_level, write_loop_proof
from lftkit.proofs.trusted import entries
from lftkit.proofs.trusted.cells import digest
from lftkit.proofs.trusted.entries import each, file_content, index, number, record, table, text, truth
from lftkit.proofs.trusted.noise import NoisePart, NoiseProof

OTHERS: tuple[Any, ...] = (True, False, None, "1", 1, 0, -1, 1.5, [], {}, [0], [[0]], math.nan, math.inf, 2**70)
FORMS = {"number": number, "index": index, "text": text, "truth": truth, "rows": each(index), "table": table}
ACCEPTED: dict[str, tuple[Any, ...]] = {
    "number": (1, 0, -1, 1.5, 2**70),
    "index": (1, 0),
    "text": ("1",),
    "truth": (True, False),
    "rows": ([], [0]),
    "table": ([], [[0]]),
}


@pytest.mark.parametrize("name", FORMS)
def test_a_form_takes_its_type_and_no_other(name: str) -> None:
    for value in OTHERS:
        wanted = any(type(value) is type(own) and value == own for own in ACCEPTED[name])
        if wanted:
            FORMS[name](value, "entry")
        else:
            with pytest.raises(ProofError, match=r"^entry.* must be .*, got "):
                FORMS[name](value, "entry")


def test_records_have_their_keys_and_no_others() -> None:
    form = record({"a": number, "b": entries.maybe(text)}, {"c": entries.mapping(truth)})
    assert form({"a": 1, "b": None, "c": {"x": True}}, "p") == {"a": 1.0, "b": None, "c": {"x": True}}
    others: tuple[Any, ...] = ({"a": 1}, {"a": 1, "b": None, "d": 1}, [], None, {"a": 1, "b": None, "c": {"x": 1}})
    for wrong in others:
        with pytest.raises(ProofError):
            form(wrong, "p")
    for ragged in ([[1, 2], [3]], [1, [2]], [[1, True]], [[1.0, math.inf]], "ab"):
        with pytest.raises(ProofError):
            table(ragged, "p")
    with pytest.raises(ProofError):
        entries.fixed(number, number)([1.0], "p")
    for values in (np.zeros(2), np.zeros((2, 3), int), np.array([[1.0, math.nan]]), np.zeros((2, 2), bool), [[1.0]]):
        with pytest.raises(ProofError):
            entries.array("float64", None, 2)(values, "p")


NO_JSON = ['{"a": 1, "a": 2}', '{"a": NaN}', '{"a": [Infinity]}', '{"a": 1e999}', "[" * 100_000, "{", "\ud800"]


@pytest.mark.parametrize("content", NO_JSON)
def test_json_has_no_key_twice_and_finite_numbers(content: str) -> None:
    with pytest.raises(ProofError):
        entries.parsed(content.encode("utf-8", "surrogatepass"), "the file")


def npz(path: Path, members: list[tuple[str, bytes]]) -> Path:
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in members:
            archive.writestr(name, data)
    return path


def npy(values: Any) -> bytes:
    stream = io.BytesIO()
    np.save(stream, values, allow_pickle=True)
    return stream.getvalue()


HEADER = npy(np.frombuffer(b'{"format": "none"}', np.uint8))
CLAIMS = npy(np.zeros(3)).replace(b"(3,), ", b"(900000000000,), ").replace(b"            ", b"", 1)


@pytest.mark.parametrize(
    "members",
    [
        [],
        [("a.npy", npy(np.zeros(2)))],
        [("header.npy", HEADER), ("a.npy", npy(np.array([{}], object)))],
        [("header.npy", HEADER), ("a.npy", npy(np.zeros(2, np.float16)))],
        [("header.npy", HEADER), ("a.npy", npy(np.zeros(2, ">f8")))],
        [("header.npy", HEADER), ("a.npy", npy(np.zeros(2)) + b"more")],
        [("header.npy", HEADER), ("a.npy", npy(np.zeros(2))[:-1])],
        [("header.npy", HEADER), ("a.npy", CLAIMS)],
        [("header.npy", HEADER), ("a.txt", b"text")],
        [("header.npy", HEADER), ("a.npy", npy(np.zeros(1))), ("a.npy", npy(np.ones(1)))],
    ],
)
@pytest.mark.filterwarnings("ignore:Duplicate name")
def test_members_are_arrays_of_their_size_with_names_of_their_own(tmp_path: Path, members: Any) -> None:
    with pytest.raises(ProofError):
        file_content(npz(tmp_path / "proof.npz", members))


def test_what_unpacks_to_far_more_than_its_file_is_refused_before_it_is_unpacked(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    bomb = zip_of_zeros(tmp_path / "proof.npz", "scalings.npy", megabytes=300)
    assert bomb.stat().st_size < 1_000_000
    monkeypatch.setattr(zipfile.ZipFile, "read", lambda *_: pytest.fail("it was unpacked"))
    with pytest.raises(ProofError, match=r"^the file must unpack to at most 200 MB, got 300 MB$"):
        check_proof(bomb)


NO_ARRAY = npy(np.zeros(2)).replace(b"NUMPY", b"numpy")


@pytest.mark.parametrize(
    "members",
    [[("a.npy", npy(np.zeros(2)))], [("header.npy", npy(np.zeros(2, np.uint8)))], [("header.npy", NO_ARRAY)], []],
)
def test_a_file_is_refused_in_words_and_not_by_the_name_of_an_exception(members: Any, tmp_path: Path) -> None:
    whole = npz(tmp_path / "proof.npz", members)
    cut = tmp_path / "cut.npz"
    cut.write_bytes(whole.read_bytes().replace(b"header", b"\0eader", 1))
    for file in (whole, cut):
        with pytest.raises(ProofError) as refusal:
            check_proof(file)
        assert " must " in str(refusal.value) and "Error" not in str(refusal.value)


def test_arrays_are_those_that_numpy_reads(tmp_path: Path) -> None:
    own = {
        "x": np.arange(6.0).reshape(2, 3),
        "y": np.asfortranarray(np.eye(3) * 1j),
        "n": np.zeros((0, 2)),
        "s": np.array(2.0),
    }
    path = npz(tmp_path / "p.npz", [("header.npy", HEADER), *((f"{k}.npy", npy(v)) for k, v in own.items())])
    header, arrays = file_content(path)
    assert header == {"format": "none"} and arrays.keys() == own.keys()
    for name, values in own.items():
        np.testing.assert_array_equal(arrays[name], values)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A small proof of each format."""
    found = tmp_path_factory.mktemp("proofs")
    system = aligned_modes(1, damping=0.1)
    model, box, band = loop_model(system, dt=0.5), box_of(system), (0.0, math.pi / 0.5)
    names = tuple(p.name for p in system.parameters)
    strips = tuple(prove_level(model, box, band, level=11.0).strips)
    write_loop_proof(
        LoopProof(model, names, box, band, 11.0, strips, {"what": "modes", "limit": 1.0}), found / "loop.npz"
    )
    noise = NoiseProof(model, names, box, (NoisePart(model.rows, band, 11.0, strips),))
    write_loop_proof(noise, found / "noise.npz")
    for method, name in (("axis", "axis.npz"), ("cells", "cells.json")):
        proof: Any = worst_case_gain(system, options=BoundOptions(method=method)).proof
        proof.to_file(found / name)
    return found


def read(path: Path) -> tuple[dict[str, Any], dict[str, Any]]:
    """Header and arrays of a proof; a JSON file is a header."""
    if path.suffix == ".json":
        return json.loads(path.read_text()), {}
    with np.load(path) as archive:
        arrays = {name: archive[name] for name in archive.files}
    return json.loads(bytes(arrays.pop("header"))), arrays


def write(path: Path, header: dict[str, Any], arrays: dict[str, Any]) -> Path:
    if path.suffix == ".json":
        path.write_text(json.dumps({**header, "sha256": digest(header)}))
    else:
        np.savez(path, header=np.frombuffer(json.dumps(header).encode(), np.uint8), **arrays)
    return path


def refused(path: Path, header: dict[str, Any], arrays: dict[str, Any]) -> None:
    with pytest.raises(ProofError):
        check_proof(write(path, header, arrays))


def places(value: Any, path: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    """Paths of all entries of a JSON value; of long lists the first two."""
    items = list(value.items() if isinstance(value, dict) else enumerate(value[:2]) if isinstance(value, list) else ())
    return [found for key, item in items for found in [(*path, key), *places(item, (*path, key))]]


FILES = ("loop.npz", "noise.npz", "axis.npz", "cells.json")


@pytest.mark.parametrize("name", FILES)
def test_the_files_themselves_are_proofs(folder: Path, name: str, tmp_path: Path) -> None:
    """Written anew it has the same content, which is what is checked."""
    again = write(tmp_path / name, *read(folder / name))
    (header, arrays), (first, own) = file_content(again), file_content(folder / name)
    assert header == first and arrays.keys() == own.keys()
    assert all(np.array_equal(values, own[key]) and values.dtype == own[key].dtype for key, values in arrays.items())
    check_proof(again)


@pytest.mark.parametrize("name", FILES)
def test_a_truth_value_is_no_entry_of_a_header(folder: Path, name: str, tmp_path: Path) -> None:
    """In place of each number, text and list, and a number in place of each truth value."""
    header, arrays = read(folder / name)
    for path in places(header):
        forged = copy.deepcopy(header)
        place: Any = forged
        for key in path[:-1]:
            place = place[key]
        old = place[path[-1]]
        for other in (0, 1) if isinstance(old, bool) else (True, False):
            place[path[-1]] = other
            if path[0] != "sha256":
                refused(tmp_path / name, forged, arrays)


@pytest.mark.parametrize("name", FILES)
def test_an_entry_more_and_one_less_are_refused(folder: Path, name: str, tmp_path: Path) -> None:
    header, arrays = read(folder / name)
    file = tmp_path / name
    for changed in changes(header):
        if changed.keys() ^ header.keys() != {"sha256"}:
            refused(file, changed, arrays)
    for part in ("claim", "plant"):
        for changed in changes(header[part]):
            refused(file, {**header, part: changed}, arrays)
    for changed in changes(arrays, np.zeros(1)) if arrays else ():
        refused(file, header, changed)
    for key, values in arrays.items():
        for other in (values.astype(bool), values.real.astype(np.float32), values[None]):
            refused(file, header, {**arrays, key: other})


def changes(own: dict[str, Any], more: Any = 1) -> list[dict[str, Any]]:
    """An entry more, and each one less."""
    return [{**own, "more": more}, *({k: v for k, v in own.items() if k != gone} for gone in own)]


@pytest.mark.parametrize("name", FILES)
def test_a_proof_is_of_no_other_kind(folder: Path, name: str, tmp_path: Path) -> None:
    """Its header with another kind, or that of another kind with its arrays; other formats and properties."""
    header, arrays = read(folder / name)
    headers = {other: read(folder / other) for other in FILES if other != name}
    for its_header, its_arrays in headers.values():
        forged = [{**header, "kind": its_header["kind"]}, {**its_header, "kind": header["kind"]}]
        forged += [its_header] if its_arrays.keys() != arrays.keys() else []  # one of noise has those of a gain
        for content in forged:
            refused(tmp_path / name, content, arrays)
    for other in ({"format": "lftkit proof 3"}, {"format": None}, {"kind": "part of a proof"}, {"kind": ["axis"]}):
        refused(tmp_path / name, {**header, **other}, arrays)
    for what in {"gain", "stability", "noise", ""} - {header["claim"]["property"]}:
        refused(tmp_path / name, {**header, "claim": {**header["claim"], "property": what}}, arrays)


@pytest.mark.parametrize("name", FILES)
def test_a_box_is_one_of_the_parameters(folder: Path, name: str, tmp_path: Path) -> None:
    header, arrays = read(folder / name)
    ((own, ends),) = header["claim"]["box"].items()
    more = {own: ends, "other": ends}
    for box in ({}, {"other": ends}, more, {own: [ends[1], ends[0]]}, [ends], {own: [*ends, 0.0]}):
        refused(tmp_path / name, {**header, "claim": {**header["claim"], "box": box}}, arrays)


def test_keys_and_members_that_come_twice_are_refused(folder: Path, tmp_path: Path) -> None:
    text = (folder / "cells.json").read_text("utf-8")
    for key in ("level", "claim", "kind"):
        twice = text.replace(f'"{key}": ', f'"{key}": 1, "{key}": ', 1)
        (tmp_path / "cells.json").write_text(twice, "utf-8")
        with pytest.raises(ProofError, match="no key twice"):
            check_proof(tmp_path / "cells.json")
    header, arrays = read(folder / "loop.npz")
    data = npy(np.frombuffer(json.dumps(header).encode(), np.uint8))
    members = [("header.npy", data), *((f"{name}.npy", npy(values)) for name, values in arrays.items())]
    check_proof(npz(tmp_path / "once.npz", members))
    for name, member in members[:3]:
        with pytest.warns(UserWarning, match="Duplicate name"), pytest.raises(ProofError, match="no member twice"):
            check_proof(npz(tmp_path / "twice.npz", [*members, (name, member)]))


def test_rows_that_are_truth_values_are_no_rows(folder: Path, tmp_path: Path) -> None:
    """``[false, true]`` equals ``(0, 1)`` and would act as a mask: one row alone would be bounded."""
    header, arrays = read(folder / "noise.npz")
    header["plant"]["rows"] = [False]
    header["claim"]["parts"][0][0] = [False]
    with pytest.raises(ProofError, match=r"header\.\w+.* must be a whole number from zero on, got False"):
        check_proof(write(tmp_path / "noise.npz", header, arrays))


def test_scalings_that_belong_to_no_strip_are_refused(folder: Path, tmp_path: Path) -> None:
    header, arrays = read(folder / "loop.npz")
    more = {"counts": arrays["counts"] + 1, "nodes": np.append(arrays["nodes"], 40.0), "factors": arrays["factors"][1:]}
    for name, values in more.items():
        refused(tmp_path / "loop.npz", header, {**arrays, name: values})
