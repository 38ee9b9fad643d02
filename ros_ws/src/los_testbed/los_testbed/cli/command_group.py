"""The commands by name: each is imported on demand; the list of commands imports none."""

from __future__ import annotations

from collections import UserDict
from collections.abc import Mapping
from dataclasses import dataclass
from importlib import import_module
from typing import Annotated, Any

import typer
from typer.core import TyperCommand, TyperGroup


@dataclass(frozen=True)
class CommandEntry:
    """A command or a group of commands.

    Parameters
    ----------
    module : str
        Below ``los_testbed.cli``.
    about : str
        First paragraph of its help, which the list of commands shows.
    attribute : str
        Of the module: the function of a command, or the Typer of a group.
    help : str
        Of the module: the help of a command; empty for a group, which has its own.
    """

    module: str
    about: str
    attribute: str
    help: str = ""


ENTRIES = {
    "run": CommandEntry("run", "Run the loop, record it, evaluate the record.", "run", "RUN_EXAMPLES"),
    "analyse": CommandEntry(
        "analysis.analyse", "Evaluate recorded runs and write a report, HTML or PDF.", "analyse", "ANALYSE_EXAMPLES"
    ),
    "report": CommandEntry(
        "analysis.report",
        "Write a report about one or several bags, a page or a PDF: verdict, figures, tables, provenance.",
        "report",
        "REPORT_EXAMPLES",
    ),
    "replay": CommandEntry("replay", "Drive controllers with the sensors of a bag.", "replay", "REPLAY_EXAMPLES"),
    "budget": CommandEntry(
        "analysis.budget",
        "Evaluate a pointing budget: contributions, total and margin for each requirement.",
        "budget",
        "BUDGET_EXAMPLES",
    ),
    "stages": CommandEntry(
        "stages", "Compare the four stages: none, isolator, fsm, fsm+pma.", "stages", "STAGES_EXAMPLES"
    ),
    "campaign": CommandEntry(
        "campaign",
        "Evaluate many members of the telescope's family; one row per member in a Parquet data set.",
        "campaign",
        "CAMPAIGN_EXAMPLES",
    ),
    "bag": CommandEntry("groups", "Describe, check, export, sign, repair and trace recorded runs.", "bag_app"),
    "image": CommandEntry("analysis.image", "Image quality: pictures, and jitter for other programs.", "image_app"),
    "control": CommandEntry(
        "control",
        "Change a run on this machine: start, stop, reset, stage, noise, disturbance, authority, camera, life cycle.",
        "control_app",
    ),
    "device": CommandEntry("device", "Check a rig before the first closed loop.", "device_app"),
    "plant": CommandEntry("plant", "The telescope's model: order, parameters, poles, inertia, bodies.", "plant_app"),
    "design": CommandEntry("groups", "Make and check the controllers.", "design_app"),
    "export": CommandEntry("designs.export", "Flight code of the laws in C.", "export_app"),
}
"""In the order of the help."""


class GroupedCommand(TyperCommand):
    """A command whose ``--help`` shows the options of no group where :data:`HelpAll` shows those of all groups."""

    whole = False

    def format_help(self, ctx: Any, formatter: Any) -> None:
        """With the names of the groups that are left out."""
        options = [p for p in self.params if getattr(p, "rich_help_panel", None) and not getattr(p, "hidden", False)]
        some = not self.whole and any("--help-all" in p.opts for p in self.params)
        grouped: list[Any] = options if some else []
        names = ", ".join(dict.fromkeys(str(option.rich_help_panel) for option in grouped))
        try:
            self.epilog = f"{len(grouped)} further options (--help-all): {names}." if grouped else None
            for option in grouped:
                option.hidden = True
            super().format_help(ctx, formatter)
        finally:
            for option in grouped:
                option.hidden = False


def _show_all(ctx: typer.Context, value: bool) -> None:
    command: Any = ctx.command
    if value and not ctx.resilient_parsing:
        command.whole = True
        try:
            typer.echo(ctx.get_help())
        finally:
            command.whole = False
        raise typer.Exit


HelpAll = Annotated[
    bool,
    typer.Option("--help-all", is_eager=True, callback=_show_all, help="Show the options of all groups and exit."),
]
"""Option of a command with groups of options."""


def _none() -> None:
    """Callback that makes a group of one command."""


def loaded(name: str) -> Any:
    """The command of an entry, imported."""
    entry, whole = ENTRIES[name], typer.Typer(rich_markup_mode="markdown")
    module = import_module(f"los_testbed.cli.{entry.module}")
    whole.callback()(_none)
    if entry.help:
        whole.command(name=name, help=getattr(module, entry.help), cls=GroupedCommand)(getattr(module, entry.attribute))
    else:
        whole.add_typer(getattr(module, entry.attribute), name=name)
    group: Any = typer.main.get_command(whole)
    return group.commands[name]


class Commands(UserDict[str, Any]):
    """Commands by name, each imported on demand, and commands that a program adds."""

    def __init__(self, further: Mapping[str, Any]) -> None:
        super().__init__({**dict.fromkeys(ENTRIES), **further})

    def __getitem__(self, name: str) -> Any:
        command = super().__getitem__(name)
        if command is None:
            command = self[name] = loaded(name)
        return command


class CommandGroup(TyperGroup):
    """The program: its help shows the commands by their entries."""

    def __init__(self, **attributes: Any) -> None:
        super().__init__(**attributes)
        self.commands = Commands(self.commands)
        self._listing = False

    def format_help(self, ctx: Any, formatter: Any) -> None:
        """Without importing a command."""
        self._listing = True
        try:
            super().format_help(ctx, formatter)
        finally:
            self._listing = False

    def list_commands(self, ctx: Any) -> list[str]:
        """In the order of the entries."""
        return list(self.commands)

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """The command of a name; its list entry while the list is built."""
        if self._listing and cmd_name in ENTRIES:
            return TyperCommand(cmd_name, help=ENTRIES[cmd_name].about)
        return self.commands.get(cmd_name)
