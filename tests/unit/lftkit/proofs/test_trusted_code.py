"""What has to be trusted of the checks: what they load and what they do not import."""

from __future__ import annotations

import subprocess
import sys

from support.trusted_code import CHECKERS, file_of, imported_by


def test_the_checks_import_only_their_own_package() -> None:
    folder = file_of(CHECKERS[0]).parent
    files = imported_by(*CHECKERS)
    assert files == {path for path in folder.glob("*.py") if path.name != "__init__.py"}, "and all of it is used"
    for path in files:
        lines = [line for line in path.read_text("utf-8").splitlines() if "lftkit." in line and "import" in line]
        assert all(line.lstrip().startswith("from lftkit.proofs.trusted.") for line in lines), "for types neither"


def test_what_runs_is_what_is_counted() -> None:
    """Modules of lftkit that a process has loaded when it can check, but for empty ones of packages."""
    code = f"import sys, {', '.join(CHECKERS)}; print(*(m for m in sys.modules if m.startswith('lftkit.')))"
    loaded = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.split()
    allowed = {path.resolve() for path in imported_by(*CHECKERS)} | {file_of("lftkit.support.on_demand").resolve()}
    assert {f for m in loaded if (f := file_of(m).resolve()) not in allowed and f.name != "__init__.py"} == set()
