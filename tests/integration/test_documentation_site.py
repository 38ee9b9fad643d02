"""The documentation site: navigation, an API page for every public name, links, nothing loaded from elsewhere."""

from __future__ import annotations

import ast
import doctest
import os
import re
import subprocess
import sys
import zlib
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
import yaml
from support import axe, headless_browser
from support.packages import FOLDERS, ROOT, files_of, tree
from support.scripts import script


@pytest.fixture(scope="module")
def hooks() -> ModuleType:
    return script(ROOT / "docs/site/hooks.py")


@pytest.fixture(scope="module")
def links() -> ModuleType:
    return script(ROOT / "docs/site/check_links.py")


def leaves(node: Any) -> list[str]:
    if isinstance(node, str):
        return [node]
    return [leaf for child in (node.values() if isinstance(node, dict) else node) for leaf in leaves(child)]


def test_examples(hooks: ModuleType, links: ModuleType) -> None:
    for module in (hooks, links):
        result = doctest.testmod(module)
        assert result.attempted > 1
        assert result.failed == 0


def test_every_page_is_in_the_navigation_once(hooks: ModuleType) -> None:
    listed = leaves(yaml.safe_load((ROOT / "mkdocs.yml").read_text("utf-8"))["nav"])
    pages = [str(path.relative_to(ROOT / "docs")) for path in (ROOT / "docs").rglob("*.md")]
    assert sorted(listed) == sorted([*pages, *hooks.OUTSIDE.values()])


def test_links_lead_from_the_start_page_to_every_page(hooks: ModuleType) -> None:
    """In at most three steps."""
    reached, last = {ROOT / "docs/index.md"}, {ROOT / "docs/index.md"}
    for _ in range(3):
        links = {(page, link) for page in last for link in re.findall(r"\]\(([^)#:]+\.md)", page.read_text("utf-8"))}
        last = {(page.parent / link).resolve() for page, link in links} - reached
        reached |= last
    assert {*(ROOT / "docs").rglob("*.md"), *(ROOT / page for page in hooks.OUTSIDE)} <= reached


def public_objects() -> set[str]:
    """Full names of the public functions and classes of all packages."""
    found = set()
    for folder in (ROOT / name for name in FOLDERS):
        for path in files_of(folder):
            if path.stem == "__main__":
                continue
            parts = path.relative_to(folder.parent).with_suffix("").parts
            name = ".".join(part for part in parts if part != "__init__")
            kinds = (ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef)
            body = [node for node in tree(path).body if isinstance(node, kinds)]
            found |= {f"{name}.{node.name}" for node in body if not node.name.startswith("_")}
    return found


@pytest.mark.further
def test_every_public_name_has_a_page_of_the_api(hooks: ModuleType, monkeypatch: pytest.MonkeyPatch) -> None:
    pages = hooks.modules()
    monkeypatch.setattr(hooks, "modules", lambda: pages)  # they are read once
    assert {name.rpartition(".")[0] for name in public_objects()} <= set(pages)
    listed = leaves(hooks.api_nav())
    assert sorted(listed) == sorted(f"api/{name}.md" for name in pages)
    assert "[`hinf_norm`][lftkit.analysis.norms.hinf_norm]" in hooks.api_page("lftkit", pages["lftkit"])


def test_broken_links_and_outside_addresses_are_found(links: ModuleType, tmp_path: Path) -> None:
    (tmp_path / "a.html").write_text(
        '<a href="b.html">1</a><a href="c.html">2</a><a href="b.html#no">3</a><a href="b.html#yes">4</a>'
        '<a href="https://example.org/">5</a><script src="https://example.org/x.js"></script>'
    )
    (tmp_path / "b.html").write_text('<h1 id="yes">b</h1>')
    assert links.problems(tmp_path) == [
        "a.html: no file for c.html",
        "a.html: no anchor for b.html#no",
        "a.html: loads https://example.org/x.js",
    ]


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """The site, built in strict mode, in which a warning is an error, and what the builder says."""
    pytest.importorskip("mkdocs")
    pytest.importorskip("mkdocstrings")
    site = tmp_path_factory.mktemp("documentation") / "site"
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(site)]
    environment = os.environ | {"NO_MKDOCS_2_WARNING": "1"}
    done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, timeout=280)
    assert done.returncode == 0, done.stderr
    return site, done.stderr


@pytest.mark.slow
def test_the_site_is_built_without_warnings(links: ModuleType, built: tuple[Path, str]) -> None:
    """Every public object is in the inventory; equations are MathML."""
    site, said = built
    assert "WARNING" not in said
    assert links.problems(site) == []
    inventory = zlib.decompress((site / "objects.inv").read_bytes().split(b"zlib.\n", 1)[1]).decode()
    assert not public_objects() - {line.split()[0] for line in inventory.splitlines()}
    for name in ("lftkit/structures", "lftkit/linear_systems", "certificates_mathematics", "pointing_analysis"):
        assert "<math" in (site / f"{name}.html").read_text("utf-8")
    assert (site / "search" / "search_index.js").stat().st_size > 100_000


@pytest.mark.slow
@pytest.mark.skipif(headless_browser.browser() is None, reason="no chromium on this machine")
def test_no_finding_of_axe(built: tuple[Path, str]) -> None:
    """Pages with signatures, code of all kinds, tables, figures and mathematics, in both schemes and widths."""
    api = (
        "lftkit.systems.connection.interconnection",
        "los_design.synthesis.synthesis",
        "los_design.search.worst_case_search",
    )
    names = (
        "404",
        "overview",
        "certificates_mathematics",
        "results",
        "lftkit/structures",
        *(f"api/{name}" for name in api),
    )
    with headless_browser.Page() as browser:
        found = {
            (name, width, scheme): axe.findings(browser, built[0] / f"{name}.html", width, scheme)
            for name in names
            for width in (390, 1280)
            for scheme in ("light", "dark")
        }
    assert not {key: value for key, value in found.items() if value}
