"""Command group ``los-testbed device``: a rig before the first closed loop."""

from __future__ import annotations

import math
import time
from dataclasses import asdict
from typing import TYPE_CHECKING, Annotated, Any

import typer

from lftkit.support.counted_nouns import counted
from los_testbed.cli.options.options import TelescopeFile, option
from los_testbed.config.run_config import RunConfig
from pointing_analysis.command.exit_codes import ExitCode
from pointing_analysis.command.options import Json
from pointing_analysis.command.output import number, print_json
from pointing_analysis.command.screen import Screen, on_screen, say, warn
from pointing_analysis.formatting.number_text import digits
from pointing_analysis.formatting.tables import TextTable, numbers, texts

if TYPE_CHECKING:
    from los_testbed.rig.check import DeviceCheckRow

CHECK_EXAMPLES = """Excite mirror and proof masses and compare the response of each sensor with the model.

Four seconds without motion, then five with all actuators at once, each at three frequencies of its own from 5 to 16.5
Hz: the mirror by up to 1 %, the forces by up to 10 % of their limits, times `--scale`. The table has gain, delay and
noise of each channel of each sensor; each fault is one line: exchanged axes, a wrong sign, a gain or noise unlike the
model's, stamps newer than the values, a dead sensor or actuator. A deviation that all sensors of an actuator share is
a fault of the actuator. No loop is closed; mirror and forces are at zero afterwards.

Exit code 0: no fault, 1: faults, 6: the device failed.

**Examples**

    los-testbed device check my_rig:Rig

    los-testbed device check los_testbed.rig.udp:UdpRig --device-address 127.0.0.1:47800 --json
"""

device_app = typer.Typer(
    help="Check a rig before the first closed loop.", no_args_is_help=True, rich_markup_mode="markdown"
)


@device_app.callback()
def _group() -> None:
    """Check a rig before the first closed loop."""


@device_app.command("check", help=CHECK_EXAMPLES)
def check(
    device: Annotated[str, typer.Argument(help="Rig, MODULE:NAME or entry point.")],
    device_address: Annotated[str, option("device_address")] = RunConfig.SETTINGS["device_address"].default,
    device_key: Annotated[str | None, option("device_key")] = None,
    scale: Annotated[float, typer.Option(help="Scale of the excitation, 0.01 to 10.")] = 1.0,
    parameters: TelescopeFile = None,
    json_: Json = False,
) -> None:
    """See CHECK_EXAMPLES."""
    from los_testbed.config.run_settings import with_stage
    from los_testbed.parts.device_contract import make_device
    from los_testbed.parts.run_parts import RunParts
    from los_testbed.rig.check import faults, judge
    from los_testbed.rig.motions import model_response, peaks_of, record
    from los_testbed.rig.supervisor import Supervisor
    from los_testbed.run.loop.scheduling import PRIORITIES, real_time_thread

    number("--scale", scale, 0.01, 10.0)
    telescope = with_stage({"start": "rest", "parameters": None if parameters is None else str(parameters)})
    rig = {"device": device, "device_address": device_address, "device_key": device_key}
    config = RunParts(RunConfig.from_mapping({**telescope, **rig})).config
    supervisor = Supervisor(make_device(config), config)
    parts = RunParts(RunConfig.from_mapping(telescope))
    peaks = peaks_of(parts.basis.authority, scale)
    model = model_response(parts.plant(), peaks)
    supervisor.open()
    opened_s = time.monotonic()
    try:
        with real_time_thread(PRIORITIES["plant"]):
            recorded = record(supervisor, peaks)
    finally:
        supervisor.end()
    rows = judge(recorded, model)
    fault_lines = faults(rows)
    console = Screen(stderr=json_)
    console.print(on_screen(_table(rows), whole=("value",)))
    noise_only = sum(not math.isfinite(row.gain) for row in rows)
    agreed = "no fault: directions, gains, delays and noise agree with the model"
    agreed += f"; of {counted(noise_only, 'value')} only the noise was compared" if noise_only else ""
    for line in fault_lines or (agreed,):
        say(console, line)
    if (pause := recorded.longest_pause_ms) > config.hold_ticks:
        warn([f"commands paused for up to {pause:.0f} ms, the machine is busy: directions are valid, repeat the rest"])
    if json_:
        print_json(
            {
                "passed": not fault_lines,
                "faults": list(fault_lines),
                "rows": [{name: _json(value) for name, value in asdict(row).items()} for row in rows],
                "peaks": peaks.tolist(),
                "longest_pause_ms": round(pause, 1),
                "seconds": round(time.monotonic() - opened_s, 1),
                "statistics": supervisor.statistics(),
            }
        )
    if fault_lines:
        raise typer.Exit(ExitCode.FAILED)


def _json(value: Any) -> Any:
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _table(rows: tuple[DeviceCheckRow, ...]) -> TextTable:
    heads = (*texts("value"), *numbers("gain", "delay [ms]", "noise", "model's", "age [ms]"), *texts(""))
    cells = [
        (
            f"{row.part}[{row.value}]",
            *(digits(x, none="") for x in (row.gain, row.delay_ms, row.noise, row.expected_noise, row.age_ms)),
            row.fault or ("pass" if math.isfinite(row.gain) else "pass (noise only)"),
        )
        for row in rows
    ]
    return TextTable.of(heads, cells)
