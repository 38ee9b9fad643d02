"""Check and execute a run in the mode that was chosen, in this process or with those of the nodes."""

from __future__ import annotations

import sys
from dataclasses import dataclass, replace

from lftkit.errors import InputError
from lftkit.support.progress import Progress
from los_testbed.bags.writer import check_new_bag
from los_testbed.config.members import check_ranges
from los_testbed.parts.run_parts import RunParts
from los_testbed.parts.stepped_plant import SteppedPlant
from los_testbed.run.modes import in_lockstep, late_answers
from los_testbed.run.processes.viewers import Live
from los_testbed.run.results import Results, RunError
from pointing_analysis.command.exit_codes import ExitCode
from pointing_analysis.command.screen import warn
from titop_plant.telescope.load import difference_summary


@dataclass(frozen=True)
class Nodes:
    """Options of the nodes of a run besides their parameters.

    Attributes
    ----------
    live : server for viewers
    lock_domain : whether their domain has to be held; False where it is held already
    """

    live: Live | None = None
    lock_domain: bool = True


ALONE = Nodes()
"""No viewers."""


def check(parts: RunParts, plant: SteppedPlant | None = None) -> tuple[str, ...]:
    """Check all that can be checked before anything is started or written; warnings about the controllers.

    Raises
    ------
    ValueError
        A bag that exists, a telescope outside the family, a file that is no controller, a plant that breaks the
        contract, ROS missing.
    """
    config = parts.config
    check_new_bag(config.bag)
    check_ranges(config, parts.telescope)
    if plant is not None and config.mode != "inprocess":
        raise InputError(f"mode must be inprocess with a plant that is an object, got {config.mode}")
    if plant is not None or config.plant:
        from los_testbed.run.loop.contract import check_plant

        tried, ports = (parts.plant(), parts.ports) if plant is None else (plant, parts.ports.used_by())
        check_plant(tried, ports)
    if config.device:
        from los_testbed.parts.device_contract import make_device

        make_device(parts.config)
    if config.disturbance_source and config.disturbance:
        parts.disturbance()
    warnings = parts.check()
    for source in parts.sources:
        warnings += tuple(f"disturbance {source.name}: {remark}" for remark in source.remarks)
    if config.mode != "inprocess":
        from los_testbed.run.processes.node_launch import check_ros

        check_ros(config.domain)
    return warnings


def execute(parts: RunParts, nodes: Nodes = ALONE, plant: SteppedPlant | None = None) -> Results:
    """Run, with a progress bar and optionally a server for viewers; the results.

    Parameters
    ----------
    parts : RunParts
    nodes : Nodes
    plant : SteppedPlant, optional
        Instead of the plant of `parts`, in the mode ``inprocess``; the controllers start at rest.

    Raises
    ------
    ValueError
        See :func:`check`.
    RunError
        The run failed, was interrupted before there was a bag, or did not begin as this machine is too slow for it.
    LoopDivergedError, RunFailedError
        Of the mode ``inprocess``.
    """
    config = parts.config
    warnings = check(parts, plant)
    warn(warnings)
    for line in difference_summary(config.parameters) if config.parameters else ():
        sys.stderr.write(f"telescope: {line}\n")
    if config.mode == "inprocess" and config.mode_choice:
        sys.stderr.write(f"{config.mode_choice}: run in one process\n")
    with Progress(f"{config.loop}, {config.mode} [ticks]", equal=True) as bar:

        def progress(ticks: int) -> None:
            bar.report(ticks, config.ticks)

        if config.mode == "inprocess":
            from los_testbed.run.bag_names import recorded
            from los_testbed.run.loop.closed_loop import LoopDivergedError
            from los_testbed.run.loop.contract import RunFailedError
            from los_testbed.run.loop.simulate import record

            try:
                record(parts, config.bag, progress, plant)
            except (LoopDivergedError, RunFailedError) as error:
                raise type(error)(f"{error}{recorded(config.bag)}") from None
            except KeyboardInterrupt:
                raise RunError(f"interrupted{recorded(config.bag)}", ExitCode.INTERRUPTED) from None
            return Results(bag=config.bag)
        from los_testbed.run.runner import Runner

        watched = replace(config, wait_for_recorder=True)
        results = Runner(watched, progress, live=nodes.live, lock_domain=nodes.lock_domain, tell=bar.print).run()
    if results.too_slow is not None:
        reason = late_answers(config, results.too_slow)
        if config.mode_choice is None:
            raise RunError(f"{reason} in the trial before the run, which did not start", ExitCode.MISSED_TICKS)
        sys.stderr.write(f"{reason}: the run continues in lockstep; --mode realtime enforces real time\n")
        return execute(replace(parts, config=in_lockstep(config, results.too_slow)), nodes)
    results.warnings = [warning for warning in results.warnings if warning not in warnings]
    return results
