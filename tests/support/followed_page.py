"""The steps of a page of docs/extend, carried out on a copy of the packages."""

from __future__ import annotations

import ast
import json
import re
import shlex
import shutil
import subprocess
import sys
import textwrap
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from support.packages import FOLDERS, ROOT, ROS_PACKAGE

STEP = re.compile(
    r"^[^\n]*?(?P<verb>[Ww]rite|[Aa]dd to) `(?P<target>[^`]+)`(?: in `(?P<file>[^`]+)`)?(?:, before `(?P<before>\w+)`)?"
    r"[^\n`]*:\n\n```(?P<language>\w+)\n(?P<block>.*?)^```"
    r"|^    los-testbed (?P<command>[^\n]*)$",
    re.MULTILINE | re.DOTALL,
)
BEGIN = "import sys; sys.path[:0] = [{!r}, {!r}]\n"
COMMAND = "from los_testbed.cli.app import main\nsys.exit(main(sys.argv[1:]))"
NO_PICTURES = """from los_testbed.run.summary import loop_curves
from pointing_analysis.report import report
report.PICTURES, loop_curves.broken_loops = (), lambda *_: ()
"""
"""Before a command that writes a report: its pictures, and the curves of some, take more than a second."""
REPORTING = ("run", "report")
"""Commands that write a report."""


def section(title: str) -> str:
    """Text of the page of docs/extend with this title."""
    texts = [path.read_text("utf-8") for path in (ROOT / "docs/extend").glob("*.md")]
    (found,) = [text for text in texts if text.startswith(f"# {title}\n")]
    return found


@dataclass(frozen=True)
class PackageCopy:
    """A copy of the packages of the repository, which steps change.

    Parameters
    ----------
    folder : Path
        Its root, where files of the user are written and commands are run.
    pictures : bool
        Whether reports have their pictures.
    """

    folder: Path
    pictures: bool = False

    @classmethod
    def of(cls, folder: Path, pictures: bool = False) -> PackageCopy:
        """Copy the packages to `folder`, with the reference bag beside them."""
        for name in FOLDERS:
            shutil.copytree(ROOT / name, folder / name)
        (folder / "bags").mkdir()
        (folder / "bags/reference").symlink_to(ROOT / "bags/reference")
        return cls(folder, pictures)

    def follow(self, title: str) -> list[str]:
        """Carry out the steps of a page in their order; what its commands print."""
        text = section(title)
        steps = list(STEP.finditer(text))
        blocks = sum(step["command"] is None for step in steps)
        if not steps or blocks != len(re.findall(r"^```\w+$", text, flags=re.MULTILINE)):
            raise ValueError(f"{title}: every block must be a step, got {blocks} steps with a block")
        printed = []
        for step in steps:
            if step["command"]:
                printed.append(self.run(step["command"]))
            elif step["verb"].lower() == "write":
                (self.folder / step["target"]).write_text(step["block"])
            elif step["file"]:
                self._add_to_table(self.file(step["file"]), step["target"], step["block"])
            else:
                self._add_before(self.file(step["target"]), step["before"], step["block"])
        return printed

    def file(self, name: str) -> Path:
        """File of the copy that a page names."""
        path = self.folder / (Path(ROS_PACKAGE) / name if name.startswith("los_testbed/") else name)
        if not path.is_file():
            raise ValueError(f"{name} must be a file of the repository, got none")
        return path

    def run(self, command: str) -> str:
        """What `los-testbed` of the copy prints; a failure is an error."""
        words = shlex.split(command)
        plain = NO_PICTURES if words[0] in REPORTING and not self.pictures else ""
        return self.python(plain + COMMAND, *words)

    def python(self, code: str, *arguments: str) -> str:
        """What a program prints that imports the copy."""
        begin = BEGIN.format(str(self.folder), str(self.folder / ROS_PACKAGE))
        done = subprocess.run(
            [sys.executable, "-c", begin + code, *arguments],
            cwd=self.folder,
            capture_output=True,
            text=True,
            check=False,
        )
        if done.returncode:
            raise RuntimeError(f"{arguments or code}: exit code {done.returncode}: {done.stdout}{done.stderr}")
        return done.stdout

    def values(self, code: str) -> dict[str, Any]:
        """Dictionary `found` of a program that imports the copy."""
        found: dict[str, Any] = json.loads(
            self.python(f"{code}\nimport json; print(json.dumps(found))").splitlines()[-1]
        )
        return found

    @staticmethod
    def _add_to_table(path: Path, name: str, block: str) -> None:
        """Add an entry to the end of a tuple, dictionary or class, or lines to the head of a table of TOML."""
        text = path.read_text("utf-8")
        if path.suffix == ".toml":
            (header,) = re.findall(rf"^{re.escape(name)}.*\n", text, flags=re.MULTILINE)
            path.write_text(text.replace(header, header + block))
            return
        classes = {node.name: node for node in ast.parse(text).body if isinstance(node, ast.ClassDef)}
        if name in classes:
            lines, end = text.splitlines(keepends=True), classes[name].end_lineno
            path.write_text("".join([*lines[:end], textwrap.indent(block, "    "), *lines[end:]]))
            return
        assigned = {
            ast.unparse(node.targets[0] if isinstance(node, ast.Assign) else node.target): node.value
            for node in ast.parse(text).body
            if isinstance(node, (ast.Assign, ast.AnnAssign))
        }
        if name not in assigned:
            raise ValueError(f"{name} must be a table of {path.name}, got {', '.join(assigned)}")
        table = assigned[name]
        if isinstance(table, ast.Call):
            table = table.args[0]
        if not isinstance(table, (ast.Tuple, ast.Dict)) or table.end_lineno is None or table.end_col_offset is None:
            raise ValueError(f"{name} must be a tuple or a dictionary, got {type(table).__name__}")
        lines = text.splitlines(keepends=True)
        end = len("".join(lines[: table.end_lineno - 1]).encode()) + table.end_col_offset - 1
        head, tail = text.encode()[:end].decode().rstrip(), text.encode()[end:].decode()
        path.write_text(f"{head}{'' if head.endswith(',') else ','}\n{block.rstrip()},\n{tail}")

    @staticmethod
    def _add_before(path: Path, name: str, block: str) -> None:
        """Put a block before the definition or assignment of a name."""
        text = path.read_text("utf-8")
        (place,) = re.finditer(rf"^(?:def {name}\(|class {name}\b|{name}\b.*=)", text, flags=re.MULTILINE)
        path.write_text(f"{text[: place.start()]}{block}\n\n{text[place.start() :]}")
