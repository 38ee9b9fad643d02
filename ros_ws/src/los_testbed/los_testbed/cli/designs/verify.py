"""Command ``los-testbed design verify``: recompute all metrics of stored designs."""

from __future__ import annotations

import json
from contextlib import nullcontext
from pathlib import Path
from typing import Annotated

import typer
from rich.text import Text

from lftkit.support.atomic_output import check_output
from los_testbed.cli.designs.redesign import show_implemented
from los_testbed.cli.interrupts import resume_hint
from los_testbed.cli.options.cluster_options import Cluster, with_cluster
from los_testbed.cli.options.options import Designs, Uncertain
from pointing_analysis.command.exit_codes import ExitCode
from pointing_analysis.command.options import Json
from pointing_analysis.command.output import number, print_json
from pointing_analysis.command.screen import Screen, tell, warn

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
    from los_testbed.api.designs import Verification, parts_file, verify_folder, verify_stored

    number("--samples", samples, 0, 1_000_000)
    if output is not None:
        check_output(output, "--output")
    state = None if output is None else parts_file(output)
    hint = nullcontext() if output is None else resume_hint("finished parts", output, state=state)
    with cluster.workers() as pool, hint:
        options = Verification(samples, uncertain or (), output, pool, tell, warn)
        if designs is not None:
            result = verify_folder(designs, options)
        else:
            stored = verify_stored(options)
    if designs is not None:
        show_implemented(result, json_)
        return
    if json_:
        print_json({**stored.values, "failures": list(stored.failures)})
    else:
        for name, content in stored.values.items():
            Screen().print(Text(name, style="bold"), json.dumps(content, indent=1))
    for text in stored.failures:
        tell(f"verification failed: {text}")
    if stored.failures:
        raise typer.Exit(ExitCode.NOT_MET)
