"""Command ``los-testbed campaign``: many members of the telescope's family, on all processors or on a Dask cluster."""

from __future__ import annotations

import sys
from dataclasses import replace
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.console import Console

from lftkit.errors import InputError
from lftkit.support.progress import Progress
from los_testbed.cli.campaign_member import refuse_beside_member, show_member
from los_testbed.cli.command_group import HelpAll
from los_testbed.cli.interrupts import resume_hint
from los_testbed.cli.options.cluster_options import (
    Cluster,
    SchedulerOption,
    TlsCaFile,
    TlsCertificate,
    TlsKey,
    processes,
)
from los_testbed.cli.options.options import Designs, NewFolder, chosen, with_settings
from los_testbed.config.run_settings import SIMULATED
from pointing_analysis.command.options import Gate, Json
from pointing_analysis.command.output import MET, leave_by_gate, number, print_json
from pointing_analysis.command.screen import Screen, on_screen

if TYPE_CHECKING:
    from los_testbed.campaign.dataset import Campaign, ResultFolder
    from los_testbed.config.run_config import RunConfig

CAMPAIGN_EXAMPLES = """Evaluate many members of the telescope's family; one row per member in a Parquet data set.

Needs the extra campaign (Dask, pyarrow). The same seed gives the same rows with any number of workers; an interrupted
campaign continues with --resume.

**Examples**

    los-testbed campaign --samples 200                           # simulated runs of 10 s, on all processors

    los-testbed campaign --samples 1000 --depth model            # gains, noise and stability from the matrices

    los-testbed campaign --samples 500 --sampling lhs --output bags/lhs ; los-testbed campaign --samples 500
    --sampling lhs --output bags/lhs --resume

    los-testbed campaign --samples 0 --sampling corners --loop fsm --keep 3    # bags of the three worst

    los-testbed campaign --samples 10000 --scheduler tls://host:8786 --tls-ca-file ca.pem --tls-cert me.pem
    --tls-key me.key
"""


@with_settings(
    SIMULATED,
    helps={"scenario": "Disturbance scenario; default: unit_norm, or none with sources in the parameter file."},
)
def campaign(
    *,
    samples: Annotated[int, typer.Option(help="Number of members; 0: all corners, or all rows of a file.")] = 100,
    seed: Annotated[int, typer.Option(help="Seed of the members and of their noise.")] = 1,
    sampling: Annotated[
        str, typer.Option(help="uniform, lhs, corners, adversarial, or a CSV file of members.")
    ] = "uniform",
    depth: Annotated[str, typer.Option(help="time: simulated runs; model: from the matrices of the loop.")] = "time",
    designs: Designs = None,
    given: dict[str, Any],
    scheduler: SchedulerOption = "",
    tls_ca_file: TlsCaFile = None,
    tls_cert: TlsCertificate = None,
    tls_key: TlsKey = None,
    workers: Annotated[int, typer.Option(help="Processes of the local cluster; 0: one per processor.")] = 0,
    keep: Annotated[int, typer.Option(help="Keep the bags of this many worst members.")] = 0,
    resume: Annotated[bool, typer.Option("--resume", help="Continue in the folder --output.")] = False,
    output: NewFolder = None,
    member: Annotated[
        str | None,
        typer.Option(metavar="VALUE,...", help="Evaluate this member alone; --seed is the seed of its noise."),
    ] = None,
    gate: Gate = False,
    json_: Json = False,
    help_all: HelpAll = False,
) -> None:
    """See CAMPAIGN_EXAMPLES."""
    from los_testbed.campaign.cluster.tls_files import TlsFiles
    from los_testbed.campaign.dataset import ResultFolder
    from los_testbed.campaign.execution import CampaignOptions, evaluate_campaign
    from los_testbed.campaign.overview import campaign_summary
    from los_testbed.campaign.page import write_page
    from los_testbed.config.run_config import RunConfig
    from los_testbed.config.run_settings import with_scenario, with_stage

    number("--samples", samples, 0, 1_000_000)  # their parameters are in memory
    number("--seed", seed, 0, 2**31 - 1)
    number("--workers", workers, 0, 10_000)
    number("--keep", keep, 0, 1000)
    if resume and output is None:
        raise InputError("--output must be given with --resume, got none")
    stated = with_stage({"mode": "inprocess", **chosen(given, designs)})
    base = with_scenario(RunConfig.from_mapping(stated), usual="unit_norm")
    if member is not None:
        refuse_beside_member({"--scheduler": scheduler, "--keep": keep, "--resume": resume, "--output": output})
        show_member(base, member, seed, depth, json_)
        return
    tls = TlsFiles.of(scheduler, tls_ca_file, tls_cert, tls_key)
    folder = ResultFolder(output or Path("bags") / f"{datetime.now():%Y%m%d-%H%M%S}-campaign")
    # an adversarial sampling is a search, the others need no workers
    searched = Cluster(workers or processes(0), scheduler, tls).workers() if sampling == "adversarial" else None
    options = CampaignOptions(samples, seed, sampling, depth, resume, workers, scheduler, tls)
    evaluating = resume_hint("the rows so far", folder.path, further=("--resume",))
    asked, _ = evaluate_campaign(base, folder, options, searched, evaluating)
    console = Screen(stderr=json_)
    with resume_hint("all rows", folder.path, further=("--resume",)), Progress("summary and report"):
        summary = campaign_summary(asked, folder, max(keep, 5))
        summary["bags"] = _keep(asked, folder, summary["worst"][:keep])
        summary["report"] = str(write_page(asked, folder, summary, folder.path / "report.html"))
    _show(console, summary, folder)
    if json_:
        print_json(summary)
    if gate:
        verdicts = [(f"{v['requirement']} ({v['interpretation']})", MET.get(v["status"])) for v in summary["verdicts"]]
        leave_by_gate([*verdicts, *((text, None) for text in summary["not_judged"])])


def _show(console: Console, summary: dict[str, Any], folder: ResultFolder) -> None:
    """Tables, the commands of the worst members, and where the results are."""
    from los_testbed.campaign.overview import metric_table, verdict_table, worst_lines

    console.print(on_screen(metric_table(summary), whole=("metric",)))
    if summary["verdicts"]:
        console.print(on_screen(verdict_table(summary)))
    for text in summary["not_judged"]:
        console.print(f"no campaign verdict on {text}", soft_wrap=True, highlight=False, markup=False)
    for line in worst_lines(summary)[:5]:
        console.print(line, soft_wrap=True, highlight=False)
    console.print(f"rows       {folder.path}", soft_wrap=True)
    console.print(f"report     {summary['report']}", soft_wrap=True)


def _keep(asked: Campaign, folder: ResultFolder, worst: list[dict[str, Any]]) -> list[str]:
    """Run members again and record them; their bags."""
    from los_testbed.run.loop.closed_loop import LoopDivergedError
    from los_testbed.run.loop.simulate import run_in_process

    if not worst:
        return []
    rows = folder.table(["index", "seed", *asked.parameters.columns])
    bags = []
    for member in worst:
        row = rows.slice(member["index"], 1).to_pylist()[0]
        bag = folder.path / "bags" / f"member-{row['index']:07d}"
        if not bag.exists():
            config: RunConfig = replace(asked.base, **asked.parameters.settings(row))
            try:
                run_in_process(config, bag)
            except LoopDivergedError as error:
                sys.stderr.write(f"warning: member {row['index']}: {error}\n")
        bags.append(str(bag))
    return bags
