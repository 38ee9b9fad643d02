"""Roles of uncertain parameters: entries of a file, and what lists them."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from support.command_line import call_command

from titop_plant.interface import COMMANDED, MEASURED
from titop_plant.telescope.load import load_telescope
from titop_plant.telescope.summary import summarise

GAINS = "".join(f"{name}.gain = 0.05\n" for name in (*COMMANDED, *MEASURED))
MANY = f"""[uncertain]
isolator.stiffness = 0.1
isolator.damping = {{ spread = 0.3, role = "operating" }}
{GAINS}body.frequency_1 = 0.03
body.damping = 0.5
payload.frequency_1 = 0.02
payload.frequency_2 = 0.02
payload.damping_1 = 0.4
payload.damping_2 = 0.4
"""


def test_all_parameters_are_listed_with_range_and_role(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Those of sensors' gains, too, which are behind the sensors and not in the structure."""
    file = tmp_path / "many.toml"
    file.write_text('base = "reference"\n' + MANY)
    telescope = load_telescope(file)
    found = summarise(telescope)
    assert [p.name for p in found.parameters] == list(telescope.uncertain) == list(found.roles)
    assert len(found.parameters) == 22 and set(found.occurrences) == set(telescope.uncertain)
    assert [found.occurrences[f"{name}.gain"] for name in ("camera_los", "accel_M1", "fsm_command")] == [2, 6, 2]
    operating = {name for name, role in found.roles.items() if role == "operating"}
    assert operating == {*(f"wheel_{i}.speed" for i in range(1, 5)), "solar_array.tau", "isolator.damping"}
    code, out, _ = call_command(capsys, "plant", "check", file, "--json")
    listed = json.loads(out)["parameters"]
    assert code == 0 and list(listed) == list(telescope.uncertain)
    assert listed["isolator.damping"] == {"nominal": 1.0, "lower": 0.7, "upper": 1.3, "unit": "1", "role": "operating"}
    code, out, _ = call_command(capsys, "plant", "--parameters", file)
    assert all(name in out for name in telescope.uncertain) and out.count("operating") == 6


def test_a_stated_constant_is_the_number_alone(tmp_path: Path) -> None:
    """So hashes of files from before there were roles stay; another role is another telescope."""
    texts = ("0.1", '{ spread = 0.1, role = "constant" }', '{ spread = 0.1, role = "operating" }')
    hashes = []
    for form in ("isolator.stiffness", '"isolator.stiffness"'):
        for i, text in enumerate(texts):
            file = tmp_path / f"{i}.toml"
            file.write_text(f"base = 'reference'\n[uncertain]\n{form} = {text}\n")
            hashes.append(load_telescope(file).parameters_hash)
    assert hashes[0] == hashes[1] != hashes[2] and hashes[:3] == hashes[3:]
    given = load_telescope(tmp_path / "2.toml").with_uncertain(["isolator.stiffness=20%", "camera_los.gain=3%"])
    assert given.spreads == {"isolator.stiffness": 0.2, "camera_los.gain": 0.03}
    assert given.roles["isolator.stiffness"] == "operating" and given.roles["camera_los.gain"] == "constant"


@pytest.mark.parametrize(
    ("entry", "message"),
    [
        (
            '{ spread = 0.1, role = "fixed" }',
            r"must have a role that is one of constant, operating, got 'fixed'",
        ),
        ('{ role = "constant" }', r"stiffness must have spread and may have role, got role"),
        ("{ spread = 0.1, unit = 1 }", r"stiffness must have spread and may have role, got spread, unit"),
        ("{ spread = 2.0 }", r"stiffness must be above 0 and at most 0\.9, got 2\.0"),
    ],
)
def test_other_entries_are_refused(entry: str, message: str, tmp_path: Path) -> None:
    file = tmp_path / "mine.toml"
    file.write_text(f"base = 'reference'\n[uncertain]\nisolator.stiffness = {entry}\n")
    with pytest.raises(ValueError, match=rf"mine\.toml.*{message}"):
        load_telescope(file)
