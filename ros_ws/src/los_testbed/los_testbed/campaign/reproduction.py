"""Command that reproduces the figure of one member of a campaign.

At depth time it is a recorded run of the member with its seed. At depth model there is no run: what is evaluated there
is the worst tone of unit norm and the noise, from the matrices, and a simulated run has other disturbances. The command
is then the evaluation of this one member at that depth.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from lftkit.errors import InputError
from los_testbed.campaign.sampling import MemberParameters
from los_testbed.config.run_config import RunConfig
from los_testbed.config.run_settings import SIMULATED, command_options
from pointing_analysis.formatting.number_text import digits, with_unit

SHARED = ("k_fsm", "k_pma", "parameters", "parameter_values")
MODEL_DIGITS = 6
"""Digits of a figure at depth model: it has no scatter."""


def member_command(row: Mapping[str, Any], base: RunConfig, depth: str) -> str:
    """Command line that reproduces the figure of a member.

    Parameters
    ----------
    row : mapping
        Row of the data set.
    base : RunConfig
        Settings that all members of the campaign share.
    depth : {"time", "model"}

    Examples
    --------
    >>> row = {"seed": 3, **dict.fromkeys(MemberParameters.of().columns, 0.5)}
    >>> member_command(row, RunConfig(mode="inprocess", loop="fsm"), "model")
    'los-testbed campaign --depth model --loop fsm --member=0.5,0.5,0.5,0.5,0.5,0.5,0.5'
    """
    parameters = MemberParameters.of(base.parameters, base.parameter_values)
    if depth == "model":
        values = ",".join(repr(float(row[name])) for name in parameters.columns)
        return f"los-testbed campaign --depth model --loop {base.loop}{command_options(base, SHARED)} --member={values}"
    length = f"{base.duration!r}".removesuffix(".0")
    stated = ("duration", "loop", "scenario", "parameter_values")
    further = command_options(base, [name for name in SIMULATED if name not in stated])
    return parameters.command(row, f" --duration {length} --loop {base.loop} --scenario {base.scenario}{further}")


def member_of(text: str, base: RunConfig) -> dict[str, float]:
    """Parameters of a member from the value of ``--member``.

    Raises
    ------
    ValueError
        Another number of values than there are parameters, or one outside its range.
    """
    member = MemberParameters.of(base.parameters, base.parameter_values)
    try:
        values = dict(zip(member.columns, map(float, text.split(",")), strict=True))
    except ValueError:
        raise InputError(f"--member must be {','.join(member.columns)}, got {text!r}") from None
    try:
        member.checked(values)
    except ValueError as error:
        raise InputError(f"--member: {error}") from None
    return values


def figure_text(row: Mapping[str, Any], metric: str, depth: str) -> str:
    """Figure by which the members of a depth are ranked, as its command prints it; of a lost member its status.

    Examples
    --------
    >>> figure_text({"status": "ok", "total_mas": 38.50072}, "total_mas", "model")
    '38.5007 mas'
    >>> figure_text({"status": "diverged"}, "rpe_window_p997_mas", "time")
    'diverged'
    """
    value = float(row.get(metric, math.nan))
    if not math.isfinite(value):
        return str(row["status"])
    return with_unit(digits(value, MODEL_DIGITS) if depth == "model" else digits(value), "mas")
