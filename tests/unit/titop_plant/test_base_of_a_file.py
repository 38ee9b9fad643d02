"""What a parameter file builds on: the reference, another file, or nothing."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from los_testbed.cli.app import main

from los_design.copied_files import with_files_beside
from pointing_analysis.read.run import Run
from titop_plant.structures.modal_file import write_modal_data
from titop_plant.telescope import load
from titop_plant.telescope.bodies import build_body, build_payload
from titop_plant.telescope.load import base_of, differences, load_telescope
from titop_plant.telescope.standalone import standalone

EXAMPLES = Path(__file__).parents[3] / "examples"
FILES = [None, *sorted(EXAMPLES.glob("spacecraft/*.toml")), EXAMPLES / "paper/telescope.toml"]


ALONE = standalone(EXAMPLES / "spacecraft" / "small_telescope.toml")


@pytest.fixture
def without_reference(monkeypatch: pytest.MonkeyPatch) -> None:
    load._reference.cache_clear()
    monkeypatch.setattr(load, "REFERENCE", Path("/no/reference.toml"))


@pytest.mark.parametrize("file", FILES, ids=lambda file: file and file.stem)
def test_the_tables_of_a_file_stand_alone(file: Path | None, tmp_path: Path) -> None:
    alone = tmp_path / "alone.toml"
    alone.write_text(standalone(file))
    assert load_telescope(alone).parameters_hash == load_telescope(file).parameters_hash
    assert base_of(alone) is None and differences(alone) == []
    assert standalone(alone) == standalone(alone, list(load_telescope(alone).to_mapping()))


def test_a_file_without_a_base_names_all_that_it_lacks(tmp_path: Path) -> None:
    text = standalone()
    for gone in ("washout = 0.1", "strut = {", "A2 = [0.05", "mass = 0.05 ", "exposure = ", "dark = ", "pixel_mas = "):
        text = "\n".join(line for line in text.splitlines() if not line.startswith(gone))
    cut = text.index("[imbalance]"), text.index("[design_scenario]")
    (tmp_path / "mine.toml").write_text(text[: cut[0]] + text[cut[1] :])
    with pytest.raises(ValueError, match=r'base = "reference" takes .* los-testbed plant rows') as refused:
        load_telescope(tmp_path / "mine.toml")
    lacks = str(refused.value).partition("got no ")[2].split(", ")
    assert sorted(lacks) == sorted(
        [
            *("[imbalance]", "body.ports.A2", "payload.sections.strut", "fsm.mass", "sensors.washout"),
            *("camera.exposure", "camera.dark", "optics.pixel_mas"),
        ]
    )


def test_a_chain_of_files_has_the_values_of_each(tmp_path: Path) -> None:
    """The nearest one that states a value has it; files are found beside the file that names them."""
    (tmp_path / "family").mkdir()
    write_modal_data(build_payload(load_telescope()), tmp_path / "family" / "payload.toml")
    (tmp_path / "family" / "base.toml").write_text(
        'base = "reference"\n[payload]\nmodal_data = "payload.toml"\n[isolator]\nmass = 2.0\n[uncertain]\n'
        '"isolator.stiffness" = 0.1\n[[sensor]]\nname = "gyro"\nkind = "rate_gyro"\n'
    )
    write_modal_data(build_body(load_telescope()), tmp_path / "base.toml")  # the name of its base
    (tmp_path / "one.toml").write_text(
        'base = "family/base.toml"\n[body]\nmodal_data = "base.toml"\n[isolator]\nmass = 2.5\n[fsm]\nmass = 0.06\n'
        '[uncertain]\n"isolator.damping" = 0.2\n'
    )
    telescope = load_telescope(tmp_path / "one.toml")
    assert (telescope.isolator.mass, telescope.fsm.mass, telescope.pma.stiffness) == (2.5, 0.06, 70.0)
    assert dict(telescope.spreads) == {"isolator.stiffness": 0.1, "isolator.damping": 0.2}
    assert [row.name for row in telescope.placed_sensors] == ["gyro"]
    assert differences(tmp_path / "one.toml") == [
        f"body.modal_data = {tmp_path}/base.toml, {tmp_path}/family/base.toml ",
        f"isolator.mass = 2.5, {tmp_path}/family/base.toml 2",
        f"fsm.mass = 0.06, {tmp_path}/family/base.toml 0.05",
        "uncertain.isolator.damping = 0.2, added",
    ]
    text, beside = with_files_beside(tmp_path / "one.toml")
    for name, content in {"copy.toml": text.encode(), **beside}.items():
        (tmp_path / "copy" / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / "copy" / name).write_bytes(content)
    copied = load_telescope(tmp_path / "copy" / "copy.toml")
    assert copied.parameters_hash == telescope.parameters_hash
    for name in ("body", "payload"):
        assert Path(copied.modal_file(name)).is_relative_to(tmp_path / "copy")


@pytest.mark.parametrize(
    ("base", "message"),
    [
        ("3", "line 1: 'base' must be \"reference\" or the name of a parameter file, got 3"),
        ('"none.toml"', r"'base' must be a telescope: cannot read the parameter file .*none\.toml"),
        ('"mine.toml"', "'base' must be a file that does not build on this one, got 'mine.toml'"),
        (
            '"other.toml"',
            r"'base' must be a telescope: .*other\.toml, line 1: 'base' must be a file that does not build",
        ),
        (
            '"wrong.toml"',
            r"'base' must be a telescope: .*wrong\.toml, line 3: 'isolator.mass' must be above 0 kg, got -1",
        ),
    ],
)
def test_a_base_that_is_none_is_refused(base: str, message: str, tmp_path: Path) -> None:
    (tmp_path / "mine.toml").write_text(f"base = {base}\n")
    (tmp_path / "other.toml").write_text('base = "mine.toml"\n')
    (tmp_path / "wrong.toml").write_text('base = "reference"\n[isolator]\nmass = -1.0\n')
    with pytest.raises(ValueError, match=message):
        load_telescope(tmp_path / "mine.toml")


def test_a_structure_from_a_file_needs_no_frame(tmp_path: Path) -> None:
    reference = load_telescope()
    write_modal_data(build_body(reference), tmp_path / "body.toml")
    write_modal_data(build_payload(reference), tmp_path / "payload.toml")
    tables = [name for name in reference.to_mapping() if name not in ("body", "payload", "materials")]
    own = '[body]\nmodal_data = "body.toml"\n[payload]\nmodal_data = "payload.toml"\n'
    (tmp_path / "mine.toml").write_text(own + standalone(names=tables))
    telescope = load_telescope(tmp_path / "mine.toml")
    for build in (build_body, build_payload):
        assert np.allclose(build(telescope).frequencies, build(reference).frequencies, rtol=1e-12)


@pytest.mark.usefixtures("without_reference")
def test_a_telescope_that_stands_alone_needs_no_reference(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    here, designs = tmp_path, EXAMPLES / "spacecraft" / "small_telescope"
    file = here / "alone.toml"
    file.write_text(ALONE)
    laws = [f"--k-fsm={designs / 'k_fsm.json'}", f"--k-pma={designs / 'k_pma.json'}"]
    own = f"--parameters={file}"
    for command in (
        ["plant", own, "--json"],
        ["plant", "check", str(file)],
        ["plant", "cases", own],
        ["plant", "export", own, f"--output={here / 'plant.json'}"],
        ["run", "--mode=inprocess", "--duration=2", own, *laws, f"--output={here / 'bag'}"],
        ["replay", str(here / "bag")],
        ["bag", "verify", str(here / "bag")],
    ):
        assert main(command) == 0, (command, capsys.readouterr())
    assert len(Run.open(here / "bag")["truth/los"]) == 2000
    with pytest.raises(ValueError, match=r"cannot read the parameter file /no/reference\.toml"):
        load_telescope()
