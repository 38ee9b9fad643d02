"""Findings of axe-core on a page: the rules of the package axe-core-python, or of a newer axe-core of npm."""

from __future__ import annotations

import json
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from support.headless_browser import Page

SCRIPT = "axe.run().then(r => JSON.stringify(r.violations.map(v => [v.id, v.nodes.map(n => n.html.slice(0, 120))])))"


def rules() -> str:
    """Source of axe-core; the package must be installed."""
    newer = Path(__file__).parents[2] / "node_modules" / "axe-core" / "axe.min.js"
    if newer.exists():
        return newer.read_text("utf-8")
    spec = find_spec("axe_core_python")
    assert spec is not None and spec.origin is not None
    return (Path(spec.origin).parent / "axe.min.js").read_text("utf-8")


def findings(browser: Page, page: Path, width: int, scheme: str) -> Any:
    """Violations [rule, elements] of a page at a width in CSS pixels, in the light or dark scheme."""
    browser.call("Emulation.setEmulatedMedia", features=[{"name": "prefers-color-scheme", "value": scheme}])
    browser.open(page, width, phone=width < 500)
    found = findings_here(browser)
    browser.call("Emulation.setEmulatedMedia", features=[])
    return found


def findings_here(browser: Page) -> Any:
    """Violations [rule, elements] of the page that is open, as it is."""
    browser.value(rules() + "; 0")
    answer = browser.call("Runtime.evaluate", expression=SCRIPT, awaitPromise=True, returnByValue=True)
    return json.loads(answer["result"]["value"])
