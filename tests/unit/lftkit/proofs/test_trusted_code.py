"""What has to be trusted of the check of sampled loops: what it loads and what it does not import."""

from __future__ import annotations

import subprocess
import sys

from support.trusted_code import CHECKER, file_of, imported_by


def test_the_checker_imports_only_its_own_package() -> None:
    assert {path.parent for path in imported_by(CHECKER)} == {file_of(CHECKER).parent}


def test_what_runs_is_what_is_counted() -> None:
    """Modules of lftkit that a process has loaded when it can check, but for empty ones of packages."""
    code = f"import sys, {CHECKER}; print(*(m for m in sys.modules if m.startswith('lftkit.')))"
    loaded = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.split()
    allowed = {path.resolve() for path in imported_by(CHECKER)} | {file_of("lftkit.support.on_demand").resolve()}
    assert {f for m in loaded if (f := file_of(m).resolve()) not in allowed and f.name != "__init__.py"} == set()
