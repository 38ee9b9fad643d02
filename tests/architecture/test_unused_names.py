"""No function, class, method or property that nothing but tests uses: product, benchmarks, examples or a page do."""

from __future__ import annotations

import re

from support.packages import FOLDERS, ROOT, files_of
from vulture import Vulture  # type: ignore[import-untyped]

USERS = ("benchmarks", "examples", "docs", "environment")
HOOKS = {
    "__getattr__, __dir__, _repr_html_": "Python and Jupyter",
    "list_commands, image_group, bag_group, _group": "typer",
    "repair, export_c, export_check, export_fmu, activate, deactivate, analyse, report": "commands",
    "on_get_parameters, on_set_parameters": "Foxglove",
    "parse_url_path, set_extra_headers, on_pong, on_close, post": "tornado",
    "on_configure, on_activate, on_deactivate, on_cleanup, on_shutdown": "life cycle of ROS",
    "can_execute, beginning_execution, ending_execution": "rclpy",
    "start_http_server": "Dask",
    "ignore_aliases": "PyYAML",
    "rotated, renamed": "what users do to modal data and systems",
    "displacement, ticks_done": "state of proof masses and of a run that cannot be seen otherwise",
}
"""Names that only a library calls, or the users of this one, and who that is."""


def test_no_name_is_without_use() -> None:
    found = Vulture()
    found.scavenge([str(ROOT / folder) for folder in (*FOLDERS, *USERS)], exclude=["*/build/*"])
    taught = set(re.findall(r"\w+", " ".join(page.read_text("utf-8") for page in files_of(ROOT / "docs", "*.md"))))
    called = {name for names in HOOKS for name in names.split(", ")}
    unused = {
        f"{item.filename.relative_to(ROOT)}: {item.name}"
        for item in found.get_unused_code(min_confidence=60)
        if item.typ in ("function", "class", "method", "property")
        and item.name not in taught | called
        and item.filename.relative_to(ROOT).parts[0] not in USERS
    }
    assert unused == set()


def test_every_hook_is_one() -> None:
    """A name that the product has no more leaves the list."""
    text = " ".join(path.read_text("utf-8") for folder in FOLDERS for path in files_of(ROOT / folder))
    words = set(re.findall(r"\w+", text))
    assert not {name for names in HOOKS for name in names.split(", ")} - words
