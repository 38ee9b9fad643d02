"""Mutation score of one module: random small changes of its source, each of which the tests of its package must notice.

    python benchmarks/mutations.py los_design/verification/verification.py --count 20 --seed 1 --json

Kinds of change: comparison flipped, sign, arithmetic operator, numeric constant, off by one, condition negated,
and/or exchanged. Docstrings, type hints, decorators, messages of exceptions and format strings are left alone. The
tests run in a copy of the tree in a temporary folder; the working tree is never written to. A mutation is killed if the
tests fail or exceed the time limit. Survivors are printed with their line; whether one of them is equivalent to the
original is for the reader to decide. Which tests belong to a module is in `TESTS`; `--tests` names others.
"""

from __future__ import annotations

import argparse
import ast
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[1]
ROS_PACKAGE = "ros_ws/src/los_testbed"
TESTS: dict[str, tuple[str, ...]] = {
    "lftkit": ("tests/unit/lftkit",),
    "lftkit/systems/connection/interconnection.py": (
        "tests/unit/lftkit/systems/test_interconnection.py",
        "tests/properties/test_lft_laws.py",
    ),
    "lftkit/analysis/norms.py": (
        "tests/unit/lftkit/analysis/test_hinf_norm.py",
        "tests/unit/lftkit/analysis/test_norm_laws.py",
        "tests/published/test_norms.py",
    ),
    "lftkit/analysis/hinf/interval_norm.py": ("tests/unit/lftkit/analysis/test_interval_norm.py",),
    "lftkit/analysis/hinf/small_norm.py": (
        "tests/unit/lftkit/analysis/test_norm_laws.py",
        "tests/unit/lftkit/analysis/test_hinf_norm.py",
    ),
    "lftkit/analysis/hinf/peak_search.py": ("tests/unit/lftkit/analysis/test_hinf_norm.py",),
    "titop_plant": ("tests/unit/titop_plant",),
    "titop_plant/simulation/plant.py": (
        "tests/unit/titop_plant/test_sampled_steps.py",
        "tests/unit/titop_plant/test_sampled_plant.py",
    ),
    "titop_plant/simulation/constant_step.py": (
        "tests/unit/titop_plant/test_sampled_steps.py",
        "tests/unit/titop_plant/test_sampled_plant.py",
    ),
    "titop_plant/simulation/sensor_samples.py": (
        "tests/unit/titop_plant/test_sampled_steps.py",
        "tests/unit/titop_plant/test_sampled_plant.py",
    ),
    "titop_plant/disturbances/wheel_and_drive_tones.py": (
        "tests/unit/titop_plant/test_sampled_steps.py",
        "tests/unit/titop_plant/test_sampled_plant.py",
    ),
    "titop_plant/blocks": ("tests/unit/titop_plant/test_blocks.py",),
    "lftkit/tuning": ("tests/unit/lftkit/tuning",),
    "lftkit/tuning/robust/worst_case.py": ("tests/unit/lftkit/tuning/test_worst_case.py",),
    "los_estimator": ("tests/unit/los_testbed/run/test_runtime_controllers.py", "tests/unit/los_design"),
    "fsm_pma_controller": ("tests/unit/los_testbed/run/test_runtime_controllers.py", "tests/unit/los_design"),
    "los_design": ("tests/unit/los_design",),
    "lftkit/analysis/lft_response.py": ("tests/unit/lftkit/analysis/test_linear_algebra.py",),
    "los_loop/closing.py": ("tests/unit/los_loop/test_sampled_loop.py",),
    "los_loop/sampled_loop.py": ("tests/unit/los_loop/test_sampled_loop.py",),
    "los_loop/sampled_loop_norms.py": ("tests/unit/los_loop/test_sampled_loop_norms.py",),
    "los_design/verification/verification.py": ("tests/unit/los_design/test_verification.py",),
    "pointing_analysis": ("tests/unit/pointing_analysis",),
    "pointing_analysis/indices/confidence.py": (
        "tests/published/test_ecss.py",
        "tests/unit/pointing_analysis/test_long_recordings.py::test_autocorrelation_by_blocks",
        "tests/unit/pointing_analysis/test_confidence.py",
        "tests/unit/pointing_analysis/test_verdict_laws.py",
    ),
    "pointing_analysis/requirements/verdict.py": ("tests/unit/pointing_analysis/test_verdict_laws.py",),
    "pointing_analysis/requirements/requirement.py": ("tests/unit/pointing_analysis/test_requirement_text.py",),
    "pointing_analysis/requirements/rows.py": ("tests/unit/pointing_analysis/test_requirement_rows.py",),
    "pointing_analysis/indices/metrics.py": ("tests/unit/pointing_analysis/test_index_laws.py",),
    "pointing_analysis/requirements/summary.py": ("tests/unit/pointing_analysis/test_summary_figures.py",),
    f"{ROS_PACKAGE}/los_testbed": ("tests/unit/los_testbed",),
    f"{ROS_PACKAGE}/los_testbed/run/loop/stamp_synchronizer.py": (
        "tests/unit/los_testbed/run/test_stamp_synchronizer.py",
    ),
    f"{ROS_PACKAGE}/los_testbed/campaign/campaign_verdict.py": (
        "tests/unit/los_testbed/campaign/test_campaign_verdict.py",
    ),
    f"{ROS_PACKAGE}/los_testbed/run/summary/summary.py": (
        "tests/unit/los_testbed/run/test_summary_on_screen.py",
        "tests/unit/los_testbed/cli/test_requirement_outputs.py",
    ),
    f"{ROS_PACKAGE}/los_testbed/bags/repair.py": (
        "tests/unit/los_testbed/bags/test_bag_repair_records.py",
        "tests/unit/los_testbed/bags/test_bag_repair.py",
    ),
}
"""Tests of a folder or file; the longest path that fits a module counts. Its doctests always run too."""

COMPARISONS = {
    ast.Lt: ">=",
    ast.GtE: "<",
    ast.Gt: "<=",
    ast.LtE: ">",
    ast.Eq: "!=",
    ast.NotEq: "==",
    ast.Is: "is not",
    ast.IsNot: "is",
    ast.In: "not in",
    ast.NotIn: "in",
}
BOUNDARIES = {ast.Lt: "<=", ast.LtE: "<", ast.Gt: ">=", ast.GtE: ">"}
SIGNS = {ast.Add: "-", ast.Sub: "+"}
OPERATORS = {
    ast.Mult: "/",
    ast.Div: "*",
    ast.FloorDiv: "/",
    ast.Mod: "*",
    ast.Pow: "*",
    ast.BitAnd: "|",
    ast.BitOr: "&",
    ast.LShift: ">>",
    ast.RShift: "<<",
}
KINDS = ("comparison", "boundary", "sign", "operator", "constant", "off by one", "condition", "and/or")


@dataclass(frozen=True)
class Mutation:
    """One change of a source text.

    Parameters
    ----------
    kind : str
        One of `KINDS`.
    start, stop : int
        Part of the text (in bytes of UTF-8) that is replaced.
    new : str
        What stands there afterwards.
    line : int
        Number of the line, from 1.
    """

    kind: str
    start: int
    stop: int
    new: str
    line: int

    def apply(self, source: str) -> str:
        """The changed text."""
        data = source.encode()
        return (data[: self.start] + self.new.encode() + data[self.stop :]).decode()


class Finder(ast.NodeVisitor):
    """Collects all mutations of a source text."""

    def __init__(self, source: str) -> None:
        self.found: list[Mutation] = []
        self._data = source.encode()
        self._starts = [0]
        for line in self._data.splitlines(keepends=True):
            self._starts.append(self._starts[-1] + len(line))
        self.visit(ast.parse(source))

    def _span(self, node: ast.AST) -> tuple[int, int]:
        n: ast.expr = node  # type: ignore[assignment]
        assert n.end_lineno is not None and n.end_col_offset is not None
        return self._starts[n.lineno - 1] + n.col_offset, self._starts[n.end_lineno - 1] + n.end_col_offset

    def _text(self, node: ast.AST) -> str:
        start, stop = self._span(node)
        return f"({self._data[start:stop].decode()})"

    def _add(self, kind: str, node: ast.AST, new: str) -> None:
        self.found.append(Mutation(kind, *self._span(node), new, node.lineno))  # type: ignore[attr-defined]

    def _visit_all(self, *nodes: ast.AST | None) -> None:
        for node in nodes:
            if node is not None:
                self.visit(node)

    def visit_FunctionDef(self, node: ast.FunctionDef) -> None:
        self._visit_all(*node.args.defaults, *node.args.kw_defaults, *node.body)

    def visit_ClassDef(self, node: ast.ClassDef) -> None:
        self._visit_all(*node.body)

    def visit_AnnAssign(self, node: ast.AnnAssign) -> None:
        self._visit_all(node.value)

    def visit_Raise(self, node: ast.Raise | ast.JoinedStr) -> None:
        """Messages and format strings are left alone."""

    visit_JoinedStr = visit_Raise

    def visit_If(self, node: ast.If | ast.While | ast.IfExp) -> None:
        """Condition negated; a block for type checkers is skipped."""
        if isinstance(node.test, ast.Name) and node.test.id == "TYPE_CHECKING":
            return
        self._condition(node.test)
        self.generic_visit(node)

    visit_While = visit_IfExp = visit_If

    def visit_comprehension(self, node: ast.comprehension) -> None:
        for test in node.ifs:
            self._condition(test)
        self.generic_visit(node)

    def _condition(self, test: ast.expr) -> None:
        self._add("condition", test, f"(not {self._text(test)})")

    def visit_Compare(self, node: ast.Compare) -> None:
        parts = [self._text(node.left), *(self._text(part) for part in node.comparators)]
        for kind, table in (("comparison", COMPARISONS), ("boundary", BOUNDARIES)):
            for i, op in enumerate(node.ops):
                if type(op) in table:
                    signs = [table[type(op)] if k == i else _symbol(o) for k, o in enumerate(node.ops)]
                    words = [parts[0], *(word for pair in zip(signs, parts[1:]) for word in pair)]
                    self._add(kind, node, f"({' '.join(words)})")
        self.generic_visit(node)

    def visit_BoolOp(self, node: ast.BoolOp) -> None:
        word = " or " if isinstance(node.op, ast.And) else " and "
        self._add("and/or", node, f"({word.join(self._text(value) for value in node.values)})")
        self.generic_visit(node)

    def visit_BinOp(self, node: ast.BinOp) -> None:
        kind, table = ("sign", SIGNS) if type(node.op) in SIGNS else ("operator", OPERATORS)
        texts = any(isinstance(n, (ast.JoinedStr, ast.List, ast.Tuple)) or _is_text(n) for n in (node.left, node.right))
        if type(node.op) in table and not texts:
            self._add(kind, node, f"({self._text(node.left)} {table[type(node.op)]} {self._text(node.right)})")
        self.generic_visit(node)

    def visit_AugAssign(self, node: ast.AugAssign) -> None:
        table = {**SIGNS, **OPERATORS}
        if type(node.op) in table and not isinstance(node.value, (ast.List, ast.JoinedStr)):
            start, stop = self._span(node.target)
            target = self._data[start:stop].decode()
            self._add("sign", node, f"{target} {table[type(node.op)]}= {self._text(node.value)}")
        self.generic_visit(node)

    def visit_UnaryOp(self, node: ast.UnaryOp) -> None:
        if isinstance(node.op, ast.USub):
            self._add("sign", node, self._text(node.operand))
        self.generic_visit(node)

    def visit_Constant(self, node: ast.Constant) -> None:
        """Numbers changed: floats doubled, integers off by one."""
        value = node.value
        if isinstance(value, (bool, str, bytes)) or not isinstance(value, (int, float)):
            return
        if isinstance(value, float):
            self._add("constant", node, repr(2.0 * value if value else 1.0))
        else:
            self._add("off by one", node, repr(value + 1))
            if value > 1:
                self._add("off by one", node, repr(value - 1))


def _is_text(node: ast.expr) -> bool:
    return isinstance(node, ast.Constant) and isinstance(node.value, str)


def _symbol(op: ast.cmpop) -> str:
    return ast.unparse(ast.Compare(ast.Name("a"), [op], [ast.Name("b")])).removeprefix("a ").removesuffix(" b")


def mutations(source: str) -> list[Mutation]:
    """All mutations of a source text, in the order of their places."""
    return sorted(Finder(source).found, key=lambda m: (m.start, m.stop, m.kind, m.new))


def tests_of(module: str) -> tuple[str, ...]:
    """Test paths of a module given by its path in the tree."""
    fitting = [key for key in TESTS if module == key or module.startswith(key + "/")]
    if not fitting:
        raise SystemExit(f"MODULE must be below one of {', '.join(TESTS)}, got {module}; --tests names its tests")
    return TESTS[max(fitting, key=len)]


def run_tests(tree: Path, paths: list[str], limit: float) -> tuple[bool, float]:
    """Whether the tests pass in a tree within the limit [s], and the seconds they took."""
    env = {"OPENBLAS_NUM_THREADS": "1", **os.environ, "PYTHONDONTWRITEBYTECODE": "1"}
    env["PYTHONPATH"] = f"{tree}:{tree / ROS_PACKAGE}"
    command = [
        sys.executable,
        "-m",
        "pytest",
        "-x",
        "-q",
        "-p",
        "no:cacheprovider",
        "-m",
        "not slow",
        "--doctest-modules",
        *paths,
    ]
    begin = time.monotonic()
    with (tree / "tests.log").open("w") as log:
        process = subprocess.Popen(command, cwd=tree, env=env, stdout=log, stderr=log, start_new_session=True)
        try:
            passed = process.wait(limit) == 0
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)
            process.wait()
            passed = False
    return passed, time.monotonic() - begin


def score(module: str, chosen: list[Mutation], paths: list[str], factor: float) -> Iterator[tuple[Mutation, bool]]:
    """Each mutation with whether the tests killed it."""
    with tempfile.TemporaryDirectory(prefix="mutations-") as folder:
        tree = Path(folder) / "tree"
        ignored = shutil.ignore_patterns(".git", ".venv*", "__pycache__", ".*_cache", "build", "*.egg-info")
        shutil.copytree(ROOT, tree, ignore=ignored)
        passed, seconds = run_tests(tree, [module, *paths], 1800.0)
        if not passed:
            raise SystemExit(f"the tests must pass without a mutation:\n{(tree / 'tests.log').read_text()[-3000:]}")
        source = (ROOT / module).read_text("utf-8")
        for mutation in chosen:
            (tree / module).write_text(mutation.apply(source), "utf-8")
            yield mutation, not run_tests(tree, [module, *paths], factor * seconds + 20.0)[0]


def main() -> int:
    """Command line; the exit code is 0 whatever the score."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("module", help="file of the project, for example lftkit/analysis/norms.py")
    parser.add_argument("--count", type=int, default=20, help="number of mutations (default 20)")
    parser.add_argument("--seed", type=int, default=0, help="seed of the choice (default 0)")
    parser.add_argument("--tests", nargs="+", help="test paths instead of those of the module's package")
    parser.add_argument("--timeout", type=float, default=4.0, help="limit: run times without mutation, plus 20 s")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    args = parser.parse_args()
    path = (ROOT / args.module).resolve()
    if not path.is_file() or not path.is_relative_to(ROOT) or args.count < 1:
        parser.error(f"MODULE must be a file of the project and COUNT positive, got {args.module} and {args.count}")
    module, source = path.relative_to(ROOT).as_posix(), path.read_text("utf-8")
    everything = mutations(source)
    chosen = random.Random(args.seed).sample(everything, min(args.count, len(everything)))
    survivors = []
    for mutation, killed in score(module, chosen, args.tests or list(tests_of(module)), args.timeout):
        old = source.encode()[mutation.start : mutation.stop].decode()
        row = {"kind": mutation.kind, "line": mutation.line, "old": old, "new": mutation.new}
        survivors += [] if killed else [row]
        text = f"{mutation.line}: {mutation.kind}: {' '.join(old.split())}  ->  {' '.join(mutation.new.split())}"
        if not args.json:
            print(f"{'killed  ' if killed else 'SURVIVED'} {module}:{text}", flush=True)
    result = {
        "module": module,
        "seed": args.seed,
        "possible": len(everything),
        "mutations": len(chosen),
        "killed": len(chosen) - len(survivors),
        "survivors": survivors,
    }
    print(json.dumps(result) if args.json else f"{result['killed']} of {len(chosen)} killed")
    return 0


if __name__ == "__main__":
    sys.exit(main())
