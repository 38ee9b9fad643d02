"""Each constant of the loop is written down once; the analysis, which imports nothing of ours, agrees with it."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterable, Iterator

import pytest
from support.packages import FOLDERS, ROOT, files_of, tree

from pointing_analysis.indices.telescope_values import DEFAULTS
from titop_plant import interface
from titop_plant.telescope.load import REFERENCE, load_telescope

FILES = sorted(path for package in FOLDERS for path in files_of(ROOT / package))
HOME = ROOT / "titop_plant/interface.py"
OF_FOREIGN_BAGS = ROOT / "pointing_analysis/indices/telescope_values.py"
PERIOD = re.compile(r"^_?(DT|RATE|TICK(_?S|_?NS|_?US)?|SAMPLING|SAMPLE_(TIME|PERIOD)|NOMINAL_HZ|TICK_RATE)$")
CAMERA = re.compile(r"^_?(CAMERA_PERIOD|HOLD_DELAY|LOOP_DELAY|(?i:CAMERA_RATE|FRAME_TICKS))$")
SENSITIVITY = re.compile(r"sensitivity|mirror_gain|fsm_to_los", re.IGNORECASE)
LIMITS = (5.3e-3, 31.6)


NAMED = (ast.Assign, ast.AnnAssign, ast.keyword, ast.Dict, ast.arguments)
LOOKED_AT = (*NAMED, ast.Constant, ast.Tuple, ast.List, ast.Set, ast.Call, ast.Slice)


def number(node: ast.AST | None) -> bool:
    return isinstance(node, ast.Constant) and isinstance(node.value, (int, float)) and not isinstance(node.value, bool)


def named_numbers(nodes: Iterable[ast.AST]) -> Iterator[tuple[str, ast.expr]]:
    """Numbers with a name: assigned, default or keyword arguments, entries of a dictionary."""
    for node in nodes:
        pairs: list[tuple[str, ast.expr | None]] = []
        if isinstance(node, ast.Assign):
            pairs = [(t.id, node.value) for t in node.targets if isinstance(t, ast.Name)]
        elif isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name):
            pairs = [(node.target.id, node.value)]
        elif isinstance(node, ast.keyword) and node.arg:
            pairs = [(node.arg, node.value)]
        elif isinstance(node, ast.Dict):
            pairs = [(str(k.value), v) for k, v in zip(node.keys, node.values) if isinstance(k, ast.Constant)]
        elif isinstance(node, ast.arguments):
            named = [*node.posonlyargs, *node.args]
            pairs = [(a.arg, d) for a, d in zip(named[len(named) - len(node.defaults) :], node.defaults)]
            pairs += [(a.arg, d) for a, d in zip(node.kwonlyargs, node.kw_defaults)]
        yield from ((name, value) for name, value in pairs if value is not None and number(value))


def texts(node: ast.AST) -> tuple[str, ...] | None:
    """Texts of a tuple, list or set that holds nothing else."""
    if isinstance(node, (ast.Tuple, ast.List, ast.Set)) and node.elts:
        values = [item.value if isinstance(item, ast.Constant) else None for item in node.elts]
        if all(isinstance(value, str) for value in values):
            return tuple(str(value) for value in values)
    return None


def faults(source: ast.AST) -> list[str]:
    """Constants of the loop that this source writes down."""
    nodes = [node for node in ast.walk(source) if isinstance(node, LOOKED_AT)]
    found = []
    for name, _ in named_numbers(nodes):
        if PERIOD.match(name) or CAMERA.match(name) or SENSITIVITY.search(name):
            found.append(name)
    for node in nodes:
        if isinstance(node, ast.Constant) and type(node.value) is float and abs(node.value) in LIMITS:
            found.append(f"{node.value:g} in line {node.lineno}")
        named = texts(node)
        if named is not None and (set(named) == set(interface.STAGES) or set(named) == set(interface.SCENARIOS)):
            found.append(f"{named}")
        if named is not None and set(interface.MIRROR_STAGES) == set(named):
            found.append(f"{named}")
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "slice":
            ends = tuple(a.value for a in node.args if isinstance(a, ast.Constant))
            if ends in ((18, 20), (20, 22), (6, 12), (12, 18)):
                found.append(f"slice{ends} in line {node.lineno}")
        if isinstance(node, ast.Slice) and all(map(number, (node.lower, node.upper))):
            found.append(f"slice {ast.unparse(node)}") if ast.unparse(node) in ("18:20", "20:22") else None
    return found


def test_constants_of_the_loop_are_written_down_in_one_place() -> None:
    found: dict[str, list[str]] = {}
    for path in sorted({*FILES} - {HOME, OF_FOREIGN_BAGS, ROOT / "pointing_analysis/replay/replay.py"}):
        faulty = faults(tree(path))
        if path.parent == ROOT / "titop_plant/disturbances":
            faulty = [fault for fault in faulty if not fault.startswith("slice(20, 22)")]  # channels of the disturbance
        if faulty:
            found[str(path.relative_to(ROOT))] = faulty
    assert found == {}


@pytest.mark.parametrize(
    "line",
    [
        "DT = 1e-3",
        "RATE = 1000",
        "TICK_NS = 1_000_000",
        "SAMPLING: float = 0.001",
        "CAMERA_PERIOD = 0.02",
        "FRAME_TICKS = 20",
        "LOOP_DELAY = 1.5e-3",
        "def f(camera_rate: float = 50.0): pass",
        "MIRROR_GAIN = 0.1",
        "def f(fsm_sensitivity=0.1): pass",
        "x = {'fsm_to_los': 0.1}",
        "limit = -0.0053",
        "f(limit=31.6)",
        "S = ('none', 'isolator', 'fsm', 'fsm+pma')",
        "S = ['worst_case', 'unit_norm', 'design', 'imbalance', 'ramp']",
        "if loop in ('fsm', 'fsm+pma'): pass",
        "CAMERA = slice(18, 20)",
        "y[18:20] = 0.0",
        "y[:, 20:22] = 0.0",
    ],
)
def test_the_search_finds_what_it_is_for(line: str) -> None:
    assert len(faults(ast.parse(line))) == 1


def test_physical_values_are_in_the_parameter_file_alone() -> None:
    """Nor does the interface hold them; what the analysis takes for bags that say nothing is the reference's."""
    assert not [fault for fault in faults(tree(HOME)) if SENSITIVITY.search(fault) or "in line" in fault]
    telescope = load_telescope(REFERENCE)
    known = dict(zip(("fsm_frequency", "fsm_damping"), telescope.fsm.dynamics)) | telescope.design_basis.to_mapping()
    assert {name: known[name] for name in DEFAULTS} == pytest.approx(dict(DEFAULTS), rel=3e-3)


def test_rate_and_tick_are_one() -> None:
    assert interface.DT * interface.RATE == 1.0
    assert interface.TICK_NS * interface.RATE == 1_000_000_000
    assert (interface.ESTIMATES, interface.TRUTH) == (2, 2)
