"""What a session shows of a system is a line, not its matrices."""

from __future__ import annotations

import pytest

from lftkit import SampledSystem, System
from los_design.synthesis.store import load_designs
from titop_plant.telescope.assembly import assembled_telescope


@pytest.fixture(scope="module")
def whole() -> System:
    return assembled_telescope().system


def test_line_of_each_type(whole: System) -> None:
    k_fsm, _ = load_designs("implemented")
    assert repr(k_fsm).startswith("SampledSystem('K_FSM, implemented', order 22, inputs accel_Ip (6), ")
    assert repr(k_fsm).endswith("output los_estimate (2), dt 0.001 s)")
    assert repr(System.static([[2.0]], [("u", 1)], [("y", 1)], "gain")) == (
        "System 'gain': gain without states\n  1 input: u (1)\n  1 output: y (1)"
    )
    ports = [(f"y{i}", 1) for i in range(8)]
    many = SampledSystem([], [], [], [[1.0]] * 8, [("u", 1)], ports, 0.5)
    assert "outputs y0 (1), y1 (1), y2 (1), y3 (1) and 4 more, dt 0.5 s)" in repr(many)
    assert repr(whole).startswith("System 'system': order 204, continuous time")


def test_the_telescope_is_summarised_in_one_line(whole: System) -> None:
    lines = repr(whole).splitlines()
    assert lines[1].startswith(f"  {sum(p.size for p in whole.inputs)} inputs: ") and len(lines) == 4
    assert whole.occurrences()["solar_array.tau"] == 32
    assert "48 occurrences in Delta" in whole.summary()


def test_none_is_longer_than_some_lines_of_a_terminal(whole: System) -> None:
    shown = [whole, whole.at({}), *load_designs("implemented")]
    assert max(len(repr(system)) for system in shown) < 5 * 80
    assert len(repr(assembled_telescope())) < 15 * 80
