"""Command ``los-testbed budget``: a pointing budget, its contributions and margins."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from lftkit.errors import InputError
from lftkit.support.counted_nouns import counted
from los_testbed.cli.options.options import Designs, TelescopeFile
from pointing_analysis.command.options import Gate, Json
from pointing_analysis.command.output import leave_by_gate, number, print_json
from pointing_analysis.command.screen import Screen, on_screen
from pointing_analysis.formatting.number_text import digits, percent
from pointing_analysis.formatting.tables import Marked, TextTable, numbers, texts

if TYPE_CHECKING:
    from los_testbed.run.summary.worst_pointing_budget import Loader, Overlay, WorstTotal
    from pointing_analysis.budget.file import PointingBudget
    from pointing_analysis.budget.total import PointingBudgetVerdict

BUDGET_EXAMPLES = """Evaluate a pointing budget: contributions, total and margin for each requirement.

Without FILE, the budget of the testbed itself: wheels, array drives and sensor noise through its closed loop, against
the requirements of the reference telescope.

**Examples**

    los-testbed budget

    los-testbed budget from_peet.xlsx --table results.xlsx

    los-testbed budget --designs examples/spacecraft/small_telescope

    los-testbed budget --members 20                     # also the worst of 20 members of the family

    los-testbed budget my_budget.toml --output budget.html --json
"""
ROWS = 12


def _shown(v: PointingBudgetVerdict) -> TextTable:
    """Contributions, total and margin of a requirement."""
    from pointing_analysis.report.pointing_budget_page import vector

    rows = [(s.source.name, vector(s.sigma.tolist()), digits(s.level, 4), percent(s.share)) for s in v.shares[:ROWS]]
    if len(v.shares) > ROWS:
        rows.append((f"{len(v.shares) - ROWS} others", "", "", percent(sum(s.share for s in v.shares[ROWS:]))))
    margin = Marked(digits(v.margin, 4), "ok" if v.compliant else "bad")
    rows += [(name, "", cell, "") for name, cell in (("total", digits(v.total, 4)), ("limit", digits(v.limit, 4)))]
    rows.append(("margin", "", margin, ""))
    return TextTable.of((*texts("source"), *numbers("sigma", "alone", "share")), rows, str(v.requirement))


def budget(
    file: Annotated[
        Path | None, typer.Argument(help="TOML file of the budget, or table of its sources (.csv, .xlsx).")
    ] = None,
    output: Annotated[Path | None, typer.Option(help="HTML page to write.")] = None,
    table: Annotated[
        Path | None, typer.Option(help="Results file to write (.csv, .xlsx), by steps AST-1 to 4.")
    ] = None,
    sources: Annotated[
        Path | None, typer.Option(help="Sources file to write (.csv, .xlsx); it is a valid FILE.")
    ] = None,
    designs: Designs = None,
    parameters: TelescopeFile = None,
    members: Annotated[
        int,
        typer.Option(help="Also evaluate this many random members of the telescope's family, and its worst points."),
    ] = 0,
    gate: Gate = False,
    json_: Json = False,
) -> None:
    """See BUDGET_EXAMPLES."""
    import pointing_analysis.budget.file as budget_file
    from lftkit.support.atomic_output import check_output, write_text
    from los_testbed.run.summary.pointing_budget_sources import testbed_requirements, testbed_sources, with_designs
    from los_testbed.run.summary.worst_pointing_budget import members_of
    from pointing_analysis.budget.result_table import result_rows
    from pointing_analysis.budget.source_table import COLUMNS, source_rows
    from pointing_analysis.budget.table_files import ENDINGS, require_writable, write_rows
    from pointing_analysis.budget.total import as_dict, evaluate
    from pointing_analysis.report.paper import PAGES
    from pointing_analysis.report.pointing_budget_page import render_budget

    number("--members", members, 0, 100_000)
    shipped = Path(budget_file.__file__).with_name("budget_testbed.toml")
    outputs = ((output, "--output", PAGES), (table, "--table", ENDINGS), (sources, "--sources", ENDINGS))
    for path, what, suffixes in outputs:
        if path is not None:
            check_output(path, what, suffixes=suffixes)
            require_writable(path)

    def of_designs(table: Mapping[str, Any]) -> Mapping[str, Any]:
        return with_designs(table, designs, parameters)

    def load(overlay: Overlay) -> PointingBudget:
        return budget_file.load_budget(
            file or shipped,
            lambda path, table, unit: testbed_sources(path, overlay(of_designs(table)), unit),
            lambda table: testbed_requirements(of_designs(table)),
        )

    content = budget_file.read_content(file or shipped)
    named = budget_file.testbed_table(content.get("sources", {}))
    _check_testbed(named, {"--members": members, "--designs": designs, "--parameters": parameters})
    rows = [] if sources is None else source_rows(content)
    nominal = load(lambda table: table)
    verdicts = evaluate(nominal)
    page = "" if output is None else render_budget(nominal, verdicts)
    console = Screen(stderr=json_)
    _print(console, nominal, verdicts)
    worst: tuple[WorstTotal, ...] = ()
    if members and named is not None:
        worst = _over_members(console, load, verdicts, members_of(of_designs(named), designs or "", members))
    results = result_rows(nominal, verdicts, {row.name: (row.member, row.worst.total) for row in worst})
    # Files are written after all computations: an error must not destroy existing ones.
    if sources is not None:
        write_rows(sources, rows, COLUMNS)
    if output is not None:
        write_text(output, page)
        console.print(f"page    {output}", soft_wrap=True, highlight=False)
    if table is not None:
        write_rows(table, results)
        console.print(f"table   {table}", soft_wrap=True, highlight=False)
    if json_:
        over = {"over_members": [row.as_dict() for row in worst]} if worst else {}
        print_json({**as_dict(nominal, verdicts), **over})
    if gate:
        leave_by_gate((str(v.requirement), v.compliant) for v in [*verdicts, *(row.worst for row in worst)])


def _print(console: Screen, evaluated: PointingBudget, verdicts: Sequence[PointingBudgetVerdict]) -> None:
    """Requirements and totals of a budget for the screen."""
    from pointing_analysis.budget.total import axis_total
    from pointing_analysis.report.pointing_budget_page import vector

    console.print(f"{evaluated.title} [{evaluated.unit}]", highlight=False, soft_wrap=True)
    for v in verdicts:
        console.print(on_screen(_shown(v)))
    for rule in evaluated.totals:
        total = axis_total(evaluated, rule)
        axes = ", ".join(evaluated.axes)
        text = f"{rule.index}, factor {rule.factor:g}, {axes}: RSS {vector(total.rss.tolist())}"
        console.print(f"{text}; level {vector(total.level.tolist())}", highlight=False, soft_wrap=True)


def _check_testbed(table: Mapping[str, Any] | None, options: Mapping[str, Any]) -> None:
    """Refuse options that would have no effect: no source is of the testbed, or it names its telescope itself."""
    for name, value in options.items():
        if value and table is None:
            raise InputError(f"{name} must be left out for a budget without a source of type testbed, got {value}")
    settings = {} if table is None else table.get("settings", {})
    if options["--parameters"] and "parameters" in settings:
        raise InputError(
            f"--parameters must be left out where the budget names parameters, got {settings['parameters']}"
        )


def _over_members(
    console: Screen, load: Loader, verdicts: Sequence[PointingBudgetVerdict], members: Mapping[str, Mapping[str, Any]]
) -> tuple[WorstTotal, ...]:
    """Totals over members of the family, shown beside those at the point of the budget."""
    from lftkit.support.progress import Progress
    from los_testbed.run.summary.worst_pointing_budget import worst_totals

    with Progress("members", equal=True) as bar:
        worst = worst_totals(load, verdicts, members, lambda done: bar.report(done, len(members)))
    rows = []
    for row in worst:
        v = row.worst
        margin = Marked(digits(v.margin, 4), "ok" if v.compliant else "bad")
        totals = (digits(total, 4) for total in (row.at.total, v.total, v.limit))
        rows.append((str(v.requirement), *totals, margin, row.member))
    heads = (*texts("requirement"), *numbers("at the point", "worst", "limit", "margin", "member"))
    title = f"Over {counted(len(members), 'member')} of the family: worst found, no bound"
    console.print(on_screen(TextTable.of(heads, rows, title)))
    return worst
