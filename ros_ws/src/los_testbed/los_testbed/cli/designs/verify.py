"""Command ``los-testbed design verify``: recompute all metrics of stored designs."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.text import Text

from lftkit.support.atomic_output import check_output, write_text
from lftkit.support.job import Job
from lftkit.support.progress import Progress
from los_testbed.cli.designs.folders import designs_in, name_unseen_requirements
from los_testbed.cli.designs.mission import Mission, verify_mission
from los_testbed.cli.designs.redesign import show_implemented
from los_testbed.cli.interrupts import resume_hint
from los_testbed.cli.options.cluster_options import Cluster, with_cluster
from los_testbed.cli.options.options import Designs, Uncertain
from los_testbed.config.members import WORST_POINTS
from pointing_analysis.command.exit_codes import ExitCode
from pointing_analysis.command.options import Json
from pointing_analysis.command.output import number, print_json
from pointing_analysis.command.screen import Screen, warn

if TYPE_CHECKING:
    from lftkit import SampledSystem
    from lftkit.support.workers import Workers
    from titop_plant.telescope.telescope import Telescope

VERIFY_EXAMPLES = """Recompute all metrics of stored designs: certified norms, and those of the loop as implemented.

The parameter points are the nominal one, all corners, random ones and the worst points found by the search. The exit
code is 7 if a loop is unstable at any of them or if the robust design violates a requirement or a margin. A telescope
whose file has sources of disturbance is run under them and judged by its requirements.

With --output the result is written to a JSON file. Until then finished parts are in FILE.parts: the same command
resumes from them after an interrupt.

**Examples**

    los-testbed design verify                                   # the stored designs

    los-testbed design verify --designs designs/mine --output designs/mine/check.json
"""

NOMINAL_POINTS = 60
"""Parameter points at which the nominal design is evaluated."""

VERIFIED = ("implemented", "implemented_nominal")
"""Variants of the stored designs that are evaluated."""


@with_cluster
def verify(
    *,
    designs: Designs = None,
    samples: Annotated[int, typer.Option(help="Random parameter points beside nominal and corners.")] = 200,
    uncertain: Uncertain = None,
    output: Annotated[
        Path | None, typer.Option(metavar="FILE", help="JSON file of the result; resumes from its finished parts.")
    ] = None,
    cluster: Cluster,
    json_: Json = False,
) -> None:
    """See VERIFY_EXAMPLES."""
    from lftkit.support.threads import one_thread

    number("--samples", samples, 0, 1_000_000)
    if output is not None:
        check_output(output, "--output")
    folder = None if designs is None else Path(designs)
    with one_thread(), cluster.workers() as pool:
        if folder is None:
            result, failed = _stored(samples, pool, uncertain or (), output)
        else:
            implemented, not_met, mission = _of_folder(folder, samples, pool, uncertain or (), output)
    if folder is not None:
        show_implemented(folder, implemented, not_met, json_, mission=mission)
        return
    if json_:
        print_json({**result, "failures": failed})
    else:
        for name, content in result.items():
            Screen().print(Text(name, style="bold"), json.dumps(content, indent=1))
    for text in failed:
        sys.stderr.write(f"verification failed: {text}\n")
    if failed:
        raise typer.Exit(ExitCode.NOT_MET)


@contextmanager
def _resumable(
    workers: Workers, output: Path | None, telescope: Telescope, designs: Sequence[SampledSystem], at: Sequence[Any]
) -> Iterator[Workers]:
    """Workers that store their results beside the output until the verification is finished."""
    if output is None:
        yield workers
        return
    from lftkit.support.kept_workers import KeptWorkers
    from los_design.synthesis.provenance import source_digest
    from los_design.verification.stage_check import RESULTS
    from los_testbed.campaign.cluster_work import versions
    from los_testbed.run.identity import telescope_digest

    depends = {
        "software": [versions(), source_digest()],
        "telescope": telescope_digest(telescope),
        "points": [dict(values) for values in at],
        "designs": [one.to_json() for one in designs],
    }
    parts, done = output.with_name(f"{output.name}.parts"), False
    kept = KeptWorkers(workers, Job("verification", depends, parts), RESULTS)
    if kept.known:
        sys.stderr.write(f"{kept.known} parts are read from {parts}\n")
    with resume_hint("finished parts", output, state=parts):
        try:
            yield kept
            done = True
        finally:
            kept.close(done)


def _of_folder(
    folder: Path, samples: int, workers: Workers, uncertain: Sequence[str], output: Path | None
) -> tuple[dict[str, Any], list[str], Mission]:
    """Values of the pair of a folder at nominal, corners, random and stored worst points, what is not met, mission."""
    from los_design.search.worst_points import load_adversarial
    from los_design.verification.verification import broken_requirements, check_implemented, verification_points
    from titop_plant.interface import design_warnings
    from titop_plant.telescope.control_plant import loop_plant

    telescope, k_fsm, k_pma = designs_in(folder)
    telescope = telescope.with_uncertain(uncertain)
    name_unseen_requirements(telescope)
    warn(design_warnings((k_fsm, k_pma), telescope.design_basis, closed=True))
    with Progress(f"{folder.name} as implemented") as bar:
        system = loop_plant(telescope, telescope.loop_ports.used_by(k_fsm, k_pma))
        adversarial = load_adversarial(folder) if (folder / WORST_POINTS).exists() else []
        at = [*verification_points(telescope, system, samples), *adversarial]
        step = _counted(bar, len(telescope.mirror_stages) * len(at))
        with _resumable(workers, output, telescope, (k_fsm, k_pma), at) as kept:
            check = check_implemented(system, telescope, k_fsm, k_pma, at, step, workers=kept)
            mission = verify_mission(folder, bar.print)
            implemented, not_met = check.to_mapping(), [*broken_requirements(check), *mission.not_met]
            shown = {"implemented": implemented, **mission.to_mapping(), "not_met": not_met}
            _write(output, {"folder": str(folder), **shown})
    return implemented, not_met, mission


def _stored(
    samples: int, workers: Workers, uncertain: Sequence[str], output: Path | None
) -> tuple[dict[str, Any], list[str]]:
    """Values of the stored designs, robust and nominal, and what fails."""
    from los_design.search.worst_points import load_adversarial
    from los_design.synthesis.store import load_designs
    from los_design.verification.verification import (
        broken_requirements,
        check_implemented,
        failures,
        verification_points,
    )
    from titop_plant.interface import design_warnings
    from titop_plant.telescope.control_plant import control_loop_plant
    from titop_plant.telescope.load import load_telescope

    telescope = load_telescope().with_uncertain(uncertain)
    for variant in VERIFIED:
        warn(design_warnings(load_designs(variant), telescope.design_basis, closed=True))
    system = control_loop_plant(telescope)
    at = [*verification_points(telescope, system, samples), *load_adversarial()]
    some = at[:: max(1, len(at) // NOMINAL_POINTS)]
    pair, nominal = load_designs("implemented"), load_designs("implemented_nominal")
    with _resumable(workers, output, telescope, (*pair, *nominal), at) as kept:
        with Progress("loops as implemented") as bar:
            step = _counted(bar, 2 * (len(at) + len(some) + 1))
            implemented = check_implemented(system, telescope, *pair, at, step, workers=kept)
            alone = check_implemented(system, telescope, *nominal, [{}], step, changes=False)
            spread = check_implemented(system, telescope, *nominal, some, step, changes=False, workers=kept)
        checks = {
            "robust design": implemented,
            "nominal design, nominal model": alone,
            "nominal design, uncertain model": spread,
        }
        result = {
            "implemented": implemented.to_mapping(),
            "nominal_design": {"nominal_model": alone.to_mapping(), "uncertain_model": spread.to_mapping()},
        }
        failed = failures(checks) + [f"robust design: {line}" for line in broken_requirements(implemented)]
        _write(output, {**result, "failures": failed})
    return result, failed


def _write(output: Path | None, content: dict[str, Any]) -> None:
    if output is not None:
        write_text(output, json.dumps(content, indent=1) + "\n")


def _counted(bar: Progress, total: int) -> Callable[[], None]:
    """Function that counts its calls on a progress bar."""
    calls = count(1)
    return lambda: bar.report(next(calls), total)
