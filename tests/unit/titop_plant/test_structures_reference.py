"""Structures of the reference telescope: ranges of mass and frequency, ports, files that replace them."""

from __future__ import annotations

import dataclasses
import sys
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from titop_plant.structures import (
    ModalData,
    port_visibility,
    write_modal_data,
)
from titop_plant.telescope.assembly import build_telescope
from titop_plant.telescope.bodies import build_body, build_payload
from titop_plant.telescope.load import load_telescope
from titop_plant.telescope.telescope import Telescope

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib


@pytest.fixture(scope="module")
def telescope() -> Telescope:
    return Telescope(tomllib.loads(files("titop_plant.telescope").joinpath("reference.toml").read_text("utf-8")))


@pytest.fixture(scope="module")
def body(telescope: Telescope) -> ModalData:
    return build_body(telescope)


@pytest.fixture(scope="module")
def payload(telescope: Telescope) -> ModalData:
    return build_payload(telescope)


def test_every_mode_is_visible_at_a_port_and_distinct(body: ModalData, payload: ModalData) -> None:
    """A mode that no port excites, or two modes at one frequency, would be removed in the minimal realisation."""
    for data in (body, payload):
        assert port_visibility(data).min() > 5e-3
        assert np.min(np.diff(data.frequencies) / data.frequencies[1:]) > 5e-4


def test_positions_of_the_ports_agree_with_the_optics(
    telescope: Telescope, body: ModalData, payload: ModalData
) -> None:
    optics = telescope.optics
    m1, m2, detector = (payload.child(name).position for name in ("M1", "M2", "DET"))
    np.testing.assert_allclose(m2 - m1, [0, 0, optics.mirror_distance], atol=1e-12)
    assert m1[2] - detector[2] == pytest.approx(optics.back_focal_distance)
    assert optics.mirror_distance < optics.primary_focal_length
    assert body.child("A1").position[1] > 0 > body.child("A2").position[1]
    np.testing.assert_array_equal(payload.parent_position, 0.0)


@pytest.mark.parametrize(
    ("change", "word"),
    [
        (lambda data: dataclasses.replace(data, parent="X"), "parent must be 'I_p', got 'X'"),
        (lambda data: dataclasses.replace(data, children=data.children[:2]), "child ports must be .*, got no 'DET'"),
    ],
)
def test_a_modal_data_file_with_other_points_is_an_error(
    telescope: Telescope, payload: ModalData, tmp_path: Path, change: Any, word: str
) -> None:
    path = tmp_path / "mine.toml"
    write_modal_data(change(payload), path)
    with pytest.raises(ValueError, match=f"mine.toml: payload: {word}"):
        build_payload(telescope.changed({"payload": {"modal_data": str(path)}}))


def test_modal_files_of_both_bodies_reproduce_the_telescope(
    body: ModalData, payload: ModalData, tmp_path: Path
) -> None:
    """Written to files, named in a parameter file and read again: the same model bit for bit."""
    for data in (body, payload):
        write_modal_data(data, tmp_path / f"{data.name}.toml")
    mine = tmp_path / "mine.toml"
    mine.write_text('[body]\nmodal_data = "body.toml"\n[payload]\nmodal_data = "payload.toml"\n')
    again, reference = build_telescope(load_telescope(mine)).system, build_telescope().system
    assert again.occurrences() == reference.occurrences()
    for key in "ABCD":
        np.testing.assert_array_equal(getattr(again, key), getattr(reference, key))


def test_the_hash_of_the_parameters_follows_the_content_of_a_modal_file(payload: ModalData, tmp_path: Path) -> None:
    hashes = []
    for folder, modes in (("a", 5), ("b", 5), ("c", 4)):
        (tmp_path / folder).mkdir()
        write_modal_data(payload.truncate(modes), tmp_path / folder / "payload.toml")
        mine = tmp_path / folder / "mine.toml"
        mine.write_text('[payload]\nmodal_data = "payload.toml"\n')
        hashes.append(load_telescope(mine).parameters_hash)
    assert hashes[0] == hashes[1] != hashes[2]
    (tmp_path / "c" / "payload.toml").unlink()
    with pytest.raises(
        ValueError, match=r"'payload.modal_data' must be a readable file, got .*payload.toml: No such file"
    ):
        build_payload(load_telescope(tmp_path / "c" / "mine.toml"))
