"""Uncertain systems in .mat files, as MATLAB's lftdata writes them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy import io

from lftkit import InputError, Port, RealParameter, System, dynamic, read_mat, real, s, write_mat


def spring() -> System:
    """A mass on a spring; its stiffness occurs twice and its range is not symmetric."""
    stiffness, mass = real("k", 2.0, 1.0, 4.0, unit="N/m"), real("m", 1.0, 0.8, 1.2)
    found: System = (stiffness / (mass * s**2 + 0.1 * s + stiffness)).system("force", "position")
    return found


def test_a_system_comes_back_with_its_elements(tmp_path: Path) -> None:
    given = spring()
    write_mat(tmp_path / "p.mat", P=given)
    found = read_mat(tmp_path / "p.mat")
    assert found.inputs == given.inputs and set(found.elements) == set(given.elements)
    for values in given.sample_values(np.random.default_rng(0), 20):
        pair = [complex(one.at(values)(0.7j)) for one in (given, found)]
        assert pair[0] == pytest.approx(pair[1], rel=1e-12)


def by_hand(**changes: Any) -> dict[str, Any]:
    """A gain k in [1, 4] with nominal 2, ``k = 2 + a nu / (1 + b nu)``: -1, 0, 1 are 1, 2, 4."""
    a, b = 4.0 / 3.0, -1.0 / 3.0
    block = blocks(Name="k", Nominal=2.0, Range=np.array([[1.0, 4.0]]), Occurrences=1.0)
    content = {
        "A": np.zeros((0, 0)),
        "B": np.zeros((0, 2)),
        "C": np.zeros((2, 0)),
        "D": np.array([[-b, 1.0], [a, 2.0]]),
    }
    return {**content, "InputName": "u", "OutputName": "y", "Blocks": block, **changes}


def blocks(**values: Any) -> Any:
    table = np.zeros((1, 1), dtype=[(name, object) for name in values])
    table[0, 0] = tuple(values.values())
    return table


@pytest.mark.parametrize("value", [1.0, 1.7, 2.0, 4.0])
def test_delta_is_normalised_in_the_file(tmp_path: Path, value: float) -> None:
    """The matrices of an uncertain gain by hand: lowest, nominal and highest value are -1, 0 and 1."""
    io.savemat(tmp_path / "p.mat", {"P": by_hand()})
    found = read_mat(tmp_path / "p.mat")
    assert found.elements == (RealParameter("k", 2.0, 1.0, 4.0),)
    assert float(found.at({"k": value}).D[0, 0]) == pytest.approx(value, rel=1e-12)


RANGE = np.array([1.0, 4.0])


@pytest.mark.parametrize(
    ("table", "message"),
    [
        (blocks(Name="k", Nominal=2.0, Range=RANGE), "Blocks must have the field Occurrences"),
        (blocks(Name="k", Nominal=2.0, Range=4.0, Occurrences=1.0), "block k must be a real parameter"),
        (blocks(Name="k", Nominal=5.0, Range=RANGE, Occurrences=1.0), "lower <= nominal <= upper"),
        (blocks(Name="k", Nominal=2.0, Range=RANGE, Occurrences=3.0), "the 3 channels of its Blocks"),
        (blocks(Name="k", Nominal=2.0, Range=RANGE, Occurrences=0.5), "Occurrences of block k"),
        (blocks(Name="k", Nominal=2.0, Range=np.array([2.0, 2.0]), Occurrences=1.0), "must hold more than one value"),
        (np.ones((2, 2)), "Blocks must be an array of structs"),
    ],
)
def test_blocks_that_do_not_fit_are_refused(tmp_path: Path, table: Any, message: str) -> None:
    io.savemat(tmp_path / "p.mat", {"P": by_hand(Blocks=table)})
    with pytest.raises(ValueError, match=message) as refused:
        read_mat(tmp_path / "p.mat")
    assert "\n" not in str(refused.value)


def test_dynamics_are_not_written(tmp_path: Path) -> None:
    uncertain = ((1 + dynamic("d", bound=0.2)) / (s + 1)).system("u", "y")
    with pytest.raises(ValueError, match="real"):
        write_mat(tmp_path / "p.mat", P=uncertain)


@pytest.mark.parametrize(
    ("field", "value", "message"),
    [
        ("InputName", ["u1", "u2"], "InputName must have 3 names, got 2"),
        ("OutputName", ["y1", "y2", "y3"], "OutputName must have 2 names, got 3"),
        ("Ts", [0.1, 0.2], "Ts must be a number, got 0.1, 0.2"),
        ("Ts", 1j, "Ts must be a number, got"),
        ("Normalized", "no", "Normalized must be a number, got no"),
        ("Normalized", np.nan, "Normalized must be 0 or 1, got nan"),
    ],
)
def test_a_field_that_would_make_another_system_is_refused(
    tmp_path: Path, field: str, value: Any, message: str
) -> None:
    """Names of fewer signals left out the columns behind them; two periods were the first."""
    names = {"InputName": ["u1", "u2", "u3"], "OutputName": ["y1", "y2"]}
    content = {"A": [[-1.0]], "B": np.ones((1, 3)), "C": np.ones((2, 1)), "D": np.zeros((2, 3)), **names}
    content[field] = value
    named = {k: np.array(v, object) if k in names else v for k, v in content.items()}
    io.savemat(tmp_path / "plant.mat", named)
    with pytest.raises(InputError, match=message):
        read_mat(tmp_path / "plant.mat")


def test_units_go_with_the_names_of_the_signals(tmp_path: Path) -> None:
    """A port whose signals are not in order, among those of another one."""
    gain = {"A": np.zeros((0, 0)), "B": np.zeros((0, 3)), "C": np.zeros((1, 0)), "D": np.array([[1.0, 2.0, 3.0]])}
    names, units = np.array(["w(2)", "v", "w(1)"], dtype=object), np.array(["Nm", "rad", "N"], dtype=object)
    io.savemat(tmp_path / "p.mat", {"P": {**gain, "InputName": names, "InputUnit": units}})
    found = read_mat(tmp_path / "p.mat")
    assert found.inputs == (Port("w", 2, "N,Nm"), Port("v", 1, "rad")) and found.D.tolist() == [[3.0, 1.0, 2.0]]
    io.savemat(tmp_path / "p.mat", {"P": {**gain, "InputName": names, "InputUnit": units[:2]}})
    with pytest.raises(InputError, match="InputUnit must have 3 units, got 2"):
        read_mat(tmp_path / "p.mat")
