"""A user's parameter file: limits of verdict and design, tables merged by name, what differs from the reference."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from pointing_analysis.requirements.requirement import parse
from pointing_analysis.units import ANGLES
from titop_plant.telescope.load import differences, load_telescope
from titop_plant.telescope.requirements import design_limits
from titop_plant.telescope.sections import Equipment
from titop_plant.telescope.telescope import Telescope

MAS, ARCSEC = ANGLES["mas"], ANGLES["arcsec"]
SHIPPED_HASH = "9449a3d3599c"
"""Of the telescope that the shipped designs are made for."""


def own(tmp_path: Path, text: str) -> Telescope:
    file = tmp_path / "mine.toml"
    file.write_text('base = "reference"\n' + text, "utf-8")
    return load_telescope(file)


def limits(telescope: Telescope) -> dict[str, float]:
    return {r.name: r.limit for r in telescope.requirements}


def test_a_requirement_of_the_file_is_the_limit_of_the_design(tmp_path: Path) -> None:
    found = own(
        tmp_path,
        '[[requirement]]\nname = "RPE, finest"\ntext = "prob(rms RPE(20 ms) < 10 mas) >= 0.997 at 95 % confidence"\n',
    )
    assert found.weights == replace(load_telescope().weights, rpe_limit_fine=10 * MAS)
    assert limits(found) == {**limits(load_telescope()), "RPE, finest": 10 * MAS}
    assert found.requirements[2].loops == ("fsm+pma",)  # the stage stays that of the reference
    assert found.parameters_hash != SHIPPED_HASH


def test_limits_may_be_given_as_weights(tmp_path: Path) -> None:
    found = own(tmp_path, "[weights]\nrpe_limit_fine = 4.848e-8\nape_limit = 4.848e-6\n")
    assert limits(found) == {"APE": 4.848e-6, "RPE, fine": 100 * MAS, "RPE, finest": 4.848e-8}
    assert (found.weights.rpe_limit_fine, found.weights.ape_limit) == (4.848e-8, 4.848e-6)
    assert any("RPE, finest" in line for line in differences(tmp_path / "mine.toml"))
    window = own(tmp_path, "[weights]\nrpe_window = 0.05\n")
    assert [r.times for r in window.requirements] == [(), (0.05,), (0.05,)]
    mirror = own(tmp_path, "[weights]\nrpe_limit = 9.696e-8\n")  # below the limit of the last stage
    assert limits(mirror)["RPE, fine"] == mirror.weights.rpe_limit == 9.696e-8
    assert mirror.weights.rpe_limit_fine == 40 * MAS


def test_both_forms_must_agree(tmp_path: Path) -> None:
    text = (
        '[[requirement]]\nname = "APE"\ntext = "prob(|APE| < {} arcsec) >= 0.997 at 95 % confidence"\n'
        "[weights]\nape_limit = 9.69627362219072e-06\n"
    )
    assert own(tmp_path, text.format(2)).weights.ape_limit == 9.69627362219072e-06
    with pytest.raises(
        ValueError,
        match=r"line 6: 'weights.ape_limit' must agree with the requirement 'APE', prob\(\|APE\| < 3.0 arcsec\)",
    ):
        own(tmp_path, text.format("3.0"))


def test_a_requirement_beside_the_design_changes_no_basis(tmp_path: Path) -> None:
    """A drift is judged and not designed for: the shipped controllers stay those of this telescope."""
    text = '[[requirement]]\nname = "drift"\ntext = "prob(|PDE(1 s, 10 s)| < 1 arcsec) >= 0.9 at 90 % confidence"\n'
    found = own(tmp_path, text)
    assert found.parameters_hash == SHIPPED_HASH and [r.name for r in found.requirements][-1] == "drift"


def test_the_whole_list_is_replaced_where_asked(tmp_path: Path) -> None:
    text = (
        'replace = ["requirement"]\n'
        '[[requirement]]\nname = "A"\ntext = "prob(|APE| < 3 arcsec) >= 0.9 at 90 % confidence"\n'
        '[[requirement]]\nname = "B"\ntext = "prob(|RPE(50 ms)| < 30 mas) >= 0.9 at 90 % confidence"\n'
    )
    found = own(tmp_path, text)
    assert list(limits(found)) == ["A", "B"]
    assert found.weights.rpe_window == 0.05 and found.weights.rpe_limit == 30 * MAS
    again = text + '[[requirement]]\nname = "B"\ntext = "prob(|APE| < 3 arcsec) >= 0.9 at 90 % confidence"\n'
    with pytest.raises(ValueError, match=r"line 10: 'requirement\[2\].name' must be given once, got 'B' twice"):
        own(tmp_path, again)


def test_the_strictest_of_the_stage_counts() -> None:
    """Axes, other windows and instants beside windows are judged, and are no limit of the design."""
    texts = {
        "prob(|APE| < 5 arcsec) >= 0.9 at 90 % confidence": (),
        "prob(|APE| < 2 arcsec) >= 0.9 at 90 % confidence": ("fsm+pma",),
        "prob(|APE_x| < 1 arcsec) >= 0.9 at 90 % confidence": (),
        "prob(rms RPE(20 ms) < 80 mas) >= 0.9 at 90 % confidence": ("fsm",),
        "prob(rms RPE(20 ms) < 60 mas) >= 0.9 at 90 % confidence": (),
        "prob(rms RPE(20 ms) < 30 mas) >= 0.9 at 90 % confidence": ("fsm+pma", "isolator"),
        "prob(rms RPE(1 s) < 50 mas) >= 0.9 at 90 % confidence": ("fsm",),
        "prob(|RPE(20 ms)| < 10 mas) >= 0.9 at 90 % confidence": (),
        "prob(rms RPE_y(20 ms) < 5 mas) >= 0.9 at 90 % confidence": (),
    }
    found, places = design_limits([parse(text, loops=loops) for text, loops in texts.items()])
    assert found["ape_limit"] == pytest.approx(5 * ARCSEC) and found["rpe_window"] == 0.02
    assert (found["rpe_limit"], found["rpe_limit_fine"]) == (60 * MAS, 30 * MAS)
    assert places == {"ape_limit": [0], "rpe_limit": [4], "rpe_limit_fine": [5], "rpe_window": [4, 5]}


def equipment(tmp_path: Path, text: str) -> dict[str, Equipment]:
    file = tmp_path / "own.toml"
    file.write_text('base = "reference"\n' + text, "utf-8")
    return {item.name: item for item in load_telescope(file).payload.equipment}


def test_a_table_changes_that_of_its_name_and_leaves_the_others(tmp_path: Path) -> None:
    reference = {item.name: item for item in load_telescope().payload.equipment}
    found = equipment(tmp_path, '[[payload.equipment]]\nname = "front-end electronics"\nmass = 48.5\n')
    assert list(found) == list(reference)
    changed = found.pop("front-end electronics")
    assert changed == replace(reference.pop("front-end electronics"), mass=48.5)
    assert found == reference


def test_the_whole_list_is_replaced_only_when_asked(tmp_path: Path) -> None:
    one = '[[payload.equipment]]\nname = "all"\nmass = 30.0\nsize = [0.5, 0.5, 0.5]\nnode = "bench"\n'
    assert list(equipment(tmp_path, '[payload]\nreplace = ["equipment"]\n' + one)) == ["all"]


def test_the_differences_are_those_of_the_file(tmp_path: Path) -> None:
    file = tmp_path / "own.toml"
    file.write_text(
        'base = "reference"\n'
        '[isolator]\nmass = 2.0\n[fsm]\nlos_sensitivity = 0.1\n[[payload.equipment]]\nname = "FSM mount"\nmass = 1.5\n'
    )
    assert differences(file) == [
        "payload.equipment[FSM mount].mass = 1.5, reference 0.9",
        "isolator.mass = 2, reference 1.5",
    ]
    file.write_text(
        'base = "reference"\n[body]\nreplace = ["equipment"]\n[[body.equipment]]\n'
        'name = "battery"\nmass = 1.0\nsize = [1, 1, 1]\nnode = "G"\n'
    )
    lines = differences(file)
    assert "body.equipment[battery].mass = 1, reference 117.6" in lines
    assert "body.equipment[computer].mass removed" in lines
    assert "body.equipment[battery].node = G, added" in lines
