"""The command line in the process of a test."""

from __future__ import annotations

import pytest
from los_testbed.cli import app


def call_command(capsys: pytest.CaptureFixture[str], *arguments: object) -> tuple[int, str, str]:
    """Run ``los-testbed`` with these arguments: exit code, output and error output."""
    try:
        code = app.main([str(argument) for argument in arguments])
    except SystemExit as stop:
        code = int(stop.code or 0)
    out, err = capsys.readouterr()
    return code, out, err
