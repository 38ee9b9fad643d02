"""One member of a campaign alone, ``los-testbed campaign --member``: its figures, without a cluster."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import typer

from lftkit.errors import InputError
from lftkit.support.progress import Progress
from los_testbed.config.run_config import RunConfig
from pointing_analysis.command.exit_codes import ExitCode
from pointing_analysis.command.output import print_json
from pointing_analysis.command.screen import Screen, on_screen, warn
from pointing_analysis.formatting.number_text import ABSENT, digits
from pointing_analysis.formatting.tables import TextTable, numbers, texts


def refuse_beside_member(options: Mapping[str, Any]) -> None:
    """Refuse options that are for many members.

    Raises
    ------
    ValueError
        One of them is given.
    """
    for name, value in options.items():
        if value:
            raise InputError(f"{name} must not be given with --member, got {value}")


def show_member(base: RunConfig, text: str, seed: int, depth: str, json_: bool) -> None:
    """Evaluate one member in this process and print its figures; a member that is lost or failed ends with code 1.

    Parameters
    ----------
    base : RunConfig
        Settings of the campaign.
    text : str
        Value of ``--member``.
    seed : int
        Of the noise and of the disturbance's phases; without effect at depth model.
    depth : {"time", "model"}
    json_ : bool
        Print the row as a JSON object, too.

    Raises
    ------
    ValueError
        No member of the family; settings that a campaign does not have.
    """
    from los_testbed.campaign.dataset import check_depth
    from los_testbed.campaign.member import MemberEvaluator
    from los_testbed.campaign.reproduction import MODEL_DIGITS, member_of
    from los_testbed.parts.run_parts import RunParts

    check_depth(base, depth)
    values = member_of(text, base)
    warn(RunParts(base).check())
    with Progress("member"):
        row = MemberEvaluator.of(base).row(0, {**values, "seed": seed}, depth)
    named = ("index", "seed", "status", "reason", "hash", *values)
    metrics = {name: value for name, value in row.items() if name not in named}
    title = f"one member, depth {depth}: {row['status']}"
    rows = [(name, digits(value, MODEL_DIGITS, infinite=ABSENT)) for name, value in metrics.items()]
    table = on_screen(TextTable.of((*texts("metric"), *numbers("value")), rows, title), whole=("metric",))
    console = Screen(stderr=json_)
    console.print(table)
    if json_:
        finite = {name: value if math.isfinite(value) else None for name, value in metrics.items()}
        print_json({**values, "status": row["status"], "reason": row["reason"], "metrics": finite})
    if row["status"] != "ok":
        console.print(f"{row['status']}: {row['reason']}", soft_wrap=True, highlight=False)
        raise typer.Exit(ExitCode.FAILED)
