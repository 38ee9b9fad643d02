"""Paths, links, objects and commands that pages name exist, also objects that docstrings name."""

from __future__ import annotations

import re
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path
from pkgutil import resolve_name
from typing import Any

import pytest
from los_testbed.cli.app import app
from support.packages import FOLDERS, NAMES, files_of
from typer.main import get_command

ROOT = Path(__file__).parents[2]
PAGES = sorted(
    [ROOT / "README.md", ROOT / "CONTRIBUTING.md", ROOT / "CHANGELOG.md", ROOT / "bags/README.md"]
    + [ROOT / "ros_ws/README.md", *(ROOT / "docs").rglob("*.md")]
)
BASES = (ROOT, ROOT / "ros_ws/src/los_testbed")
"""A path in the documentation is relative to the root of the repository or to that of the ROS package."""
FILE = re.compile(r"[\w.*-]+(?:/[\w.*-]+)*\.(?:py|toml|json|md)")
MADE = {
    "damper.toml",
    "guide.toml",
    "lead.py",
    "my_damper.py",
    "start.json",
    "twice.toml",
    "day.toml",
    "mine.json",
    "mine.toml",
    "my_body.toml",
    "my_law.json",
    "my_observer.json",
    "my_payload.toml",
    "my_telescope.toml",
    "mission.toml",
    "my_module.py",
    "my_plant_node.py",
    "optics.toml",
    "panel.toml",
    "rounds.json",
}
"""Example files of the user."""
INSIDE_BAGS = {"k_fsm.json", "k_pma.json"}
"""Attachments of a bag."""
REPLACED = {
    "k_fsm_flown_nominal.json",
    "k_pma_flown_nominal.json",
    "k_fsm_implemented_nominal.json",
    "k_pma_implemented_nominal.json",
}
"""Names of files in CHANGELOG.md, without folder."""


GENERATED = r"<!-- ([\w:]+?)(?::begin)? -->.*?<!-- (?:\1:)?end -->"
"""Text between markers, written by commands and benchmarks."""


COMMANDS: dict[str, Any] = get_command(app).commands  # type: ignore[attr-defined]


def relative(page: Path) -> str:
    return str(page.relative_to(ROOT))


def without_blocks(text: str) -> str:
    return re.sub(r"^```.*?^```", "", text, flags=re.DOTALL | re.MULTILINE)


def code_spans(text: str) -> list[str]:
    """Content of the inline code of a page; a line break inside counts as a space."""
    return [" ".join(span.split()) for span in re.findall(r"`([^`]+)`", without_blocks(text))]


def named_files(text: str) -> set[str]:
    """Files named in inline code: the whole span, or words of it that contain a slash."""
    found = set()
    for span in code_spans(text):
        for word in span.split():
            match = FILE.fullmatch(word.strip("(),;:"))
            if match and ("/" in match[0] or word == span):
                found.add(match[0])
    return found


def exists(path: str) -> bool:
    return any(any(base.glob(path)) if "*" in path else (base / path).exists() for base in BASES)


def is_generic(path: str) -> bool:
    """A bare file name that is in the repository, for example `reference.toml` or `runtime.py`."""
    folders = [folder for folder in ROOT.iterdir() if folder.is_dir() and not folder.name.startswith((".", "build"))]
    return "/" not in path and any(any(folder.glob(f"**/{path}")) for folder in folders)


def missing_files(page: Path) -> set[str]:
    allowed = (
        MADE | (INSIDE_BAGS if "bags" in page.parts else set()) | (REPLACED if page.stem == "CHANGELOG" else set())
    )
    missing = {path for path in named_files(page.read_text("utf-8")) - allowed if not exists(path)}
    return {path for path in missing if not is_generic(path)}


def is_test(name: str) -> bool:
    """Whether a module of the tests, or one of their functions, has this name."""
    modules = list((ROOT / "tests").glob("**/test_*.py"))
    return any(m.stem == name or re.search(rf"^def {name}\b", m.read_text("utf-8"), re.MULTILINE) for m in modules)


def missing_tests(page: Path) -> set[str]:
    names = {span for span in code_spans(page.read_text("utf-8")) if re.fullmatch(r"test_\w+", span)}
    return {name for name in names if not is_test(name)}


def named_objects(text: str, changelog: bool) -> set[str]:
    """Dotted names of this project in inline code; of CHANGELOG.md the right column of its table only."""
    if changelog:
        text = "\n".join(line.split("|")[-2] for line in text.splitlines() if line.startswith("  | `"))
    return {
        span
        for span in code_spans(text)
        if re.fullmatch(
            r"(?:lftkit|titop_plant|los_loop|los_estimator|"
            r"fsm_pma_controller|los_design|pointing_analysis|los_testbed)(?:\.\w+)+",
            span,
        )
    }


def is_object(name: str) -> bool:
    """Whether a dotted name is a module or an attribute; modules of nodes, which import rclpy, are not imported."""
    if name.startswith("los_testbed.nodes"):
        module, _, attribute = name.rpartition(".")
        source = find_spec(module)
        if source is not None and source.submodule_search_locations and find_spec(name):
            return True
        return source is not None and f"class {attribute}" in Path(str(source.origin)).read_text("utf-8")
    try:
        resolve_name(name)
    except (ImportError, AttributeError):
        return is_field(name)
    return True


def is_field(name: str) -> bool:
    """Whether a dotted name is a field without default of a class."""
    owner, _, field = name.rpartition(".")
    try:
        return field in getattr(resolve_name(owner), "__annotations__", {})
    except (ImportError, AttributeError):
        return False


def missing_objects(page: Path) -> set[str]:
    names = named_objects(page.read_text("utf-8"), page.stem == "CHANGELOG")
    return {name for name in names if not is_object(name)}


REFERENCE = re.compile(r":(?:mod|func|class|data|meth|attr|exc):`~?(\w+(?:\.\w+)+)`")
"""Dotted name in a docstring or comment."""


def test_objects_that_docstrings_name_exist() -> None:
    found = {
        f"{relative(path)}: {name}"
        for folder in FOLDERS
        for path in files_of(ROOT / folder)
        for name in set(REFERENCE.findall(path.read_text("utf-8")))
        if name.partition(".")[0] in NAMES and not is_object(name)
    }
    assert found == set()


def links_without_target(page: Path) -> list[str]:
    text = without_blocks(page.read_text("utf-8"))
    links = re.findall(r"\]\(([^)#]+)(?:#[^)]*)?\)", text) + re.findall(r'src="([^"]+)"', text)
    return [link for link in links if "://" not in link and not (page.parent / link).exists()]


def named_commands(text: str) -> list[str]:
    """Command lines of `los-testbed` in inline code and in blocks, without comments."""
    blocks = re.findall(r"^```\w*\n(.*?)^```", text, flags=re.DOTALL | re.MULTILINE)
    lines = [line for block in blocks for line in block.splitlines()]
    lines += re.findall(r"^ {4,}(.*)$", without_blocks(text), flags=re.MULTILINE) + code_spans(text)
    return [match[1] for line in lines if (match := re.match(r"(?:\.venv/bin/)?los-testbed\s+([^#:]+)", line.strip()))]


def check_command(line: str, commands: dict[str, Any]) -> str:
    """Problem of a command line (``a|b`` and ``a, b`` stand for several commands), or an empty text."""
    first, *rest = line.split()
    if first.startswith(("-", "{")):
        return ""
    for name in first.split("|"):
        if name not in commands:
            return f"no command {name!r}"
        inner = getattr(commands[name], "commands", None)
        words = [word for word in rest if not word.startswith(("-", "["))]
        if inner and words and "".join(words[0]).islower():
            unknown = [one for one in words[0].split("|") if one not in inner]
            if unknown:
                return f"no command {name!r} {unknown[0]!r}"
            options = {
                o for one in words[0].split("|") for p in inner[one].params for o in (*p.opts, *p.secondary_opts)
            }
        else:
            options = {o for p in commands[name].params for o in (*p.opts, *p.secondary_opts)}
        given = {word.split("=")[0].strip("[],") for word in rest if word.strip("[").startswith("--")}
        if given - options:
            return f"{name} has no option {sorted(given - options)[0]}"
    return ""


def wrong_commands(page: Path) -> list[str]:
    problems = (check_command(line, COMMANDS) for line in named_commands(page.read_text("utf-8")))
    return [problem for problem in problems if problem]


def does_not_refer_to_the_glossary(page: Path) -> bool:
    with_it = page.name == "reference.md" or page.parent.name == "extend"
    return not with_it and "reference.md#glossary)" not in page.read_text("utf-8")


def long_lines(page: Path) -> list[str]:
    """Lines of prose have fewer than 120 characters; tables, code, images, HTML and generated text may be longer."""
    text = re.sub(GENERATED, "", without_blocks(page.read_text("utf-8")), flags=re.DOTALL)
    prose = [line for line in text.splitlines() if not re.match(r" {4}|\s*[|<!]", line)]
    return [line for line in prose if len(line) >= 120]


def broken_tables(page: Path) -> list[str]:
    """First rows of those without a head and its separator, or with rows of different numbers of cells."""
    text = re.sub(r"\\\||`[^`\n]*`", "", without_blocks(page.read_text("utf-8")))
    tables = [table.splitlines() for table in re.findall(r"^\|.*(?:\n\|.*)*", text, re.MULTILINE)]
    headed = [len(rows) > 2 and re.fullmatch(r"\|[\s:|-]+\|", rows[1]) for rows in tables]
    return [rows[0] for rows, head in zip(tables, headed) if not head or len({row.count("|") for row in rows}) > 1]


RULES: tuple[Callable[[Path], object], ...] = (
    missing_files,
    missing_tests,
    missing_objects,
    links_without_target,
    wrong_commands,
    does_not_refer_to_the_glossary,
    long_lines,
    broken_tables,
)


@pytest.mark.parametrize("rule", RULES, ids=lambda rule: rule.__name__)
def test_pages_keep_the_rule(rule: Callable[[Path], object]) -> None:
    assert {relative(page): found for page in PAGES if (found := rule(page))} == {}


def test_the_pages_are_few_and_short() -> None:
    """Those of the top folder are 20; all of them, with those of developers and of the library, have 45 000 words."""
    assert len(list((ROOT / "docs").glob("*.md"))) <= 20
    pages = [*(ROOT / "docs").rglob("*.md"), *(ROOT / "lftkit").glob("*.md")]
    assert sum(len(page.read_text("utf-8").split()) for page in pages) <= 45_000
    assert len((ROOT / "CONTRIBUTING.md").read_bytes()) <= 8_000


def test_the_checks_find_mistakes() -> None:
    """A wrong path, a wrong command and a wrong option are found; shorthand and wildcards are resolved."""
    assert named_files("see `lftkit/no_such.py` and `run x/y.toml now`") == {"lftkit/no_such.py", "x/y.toml"}
    assert not exists("lftkit/no_such.py")
    assert named_objects("`lftkit.no_such`", False) == {"lftkit.no_such"} and not is_object("lftkit.no_such")
    assert not is_test("test_no_such") and is_test("test_faults") and is_test("test_pages_keep_the_rule")
    assert exists("los_testbed/config/run_config.py")
    assert exists("los_estimator/designs/*.json")
    commands = COMMANDS
    assert check_command("desing verify", commands) == "no command 'desing'"
    assert check_command("design verfy", commands) == "no command 'design' 'verfy'"
    assert check_command("run --k-fms x.json", commands) == "run has no option --k-fms"
    assert check_command("design k-fsm|verify", commands) == ""
    assert named_commands("see `los-testbed no-such`\n") == ["no-such"]
    assert named_commands("```sh\nlos-testbed run --seed 1   # comment\n```\n") == ["run --seed 1   "]
