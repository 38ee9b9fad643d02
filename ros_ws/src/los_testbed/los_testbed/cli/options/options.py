"""Options that several commands have."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterable, Mapping
from functools import wraps
from pathlib import Path
from typing import Annotated, Any

import typer

from lftkit.errors import InputError
from los_testbed.config.run_config import RunConfig, parse_value, settings_of
from los_testbed.config.run_settings import of_designs
from titop_plant.physical_settings import TELESCOPE
from titop_plant.settings import Setting

TelescopeFile = Annotated[Path | None, typer.Option(metavar="FILE", help="Parameter file of your telescope.")]
Uncertain = Annotated[
    list[str] | None,
    typer.Option(
        "--uncertain",
        metavar="ENTRY=SPREAD",
        help="Further uncertain factor of the telescope, e.g. isolator.stiffness=10%; repeatable.",
    ),
]
Designs = Annotated[str | None, typer.Option(metavar="FOLDER", help="Controllers and telescope of `design all`.")]
Case = Annotated[
    str | None,
    typer.Option(metavar="NAME", help="A named case: los-testbed plant cases.", rich_help_panel=TELESCOPE),
]
Cases = Annotated[Path | None, typer.Option(help="YAML file of named cases of your own.", rich_help_panel=TELESCOPE)]
NewFolder = Annotated[Path | None, typer.Option(help="New folder; default: one under bags/.")]
DesignSeed = Annotated[int, typer.Option(help="Seed of starts and searches.")]

FILES = "Files"
"""Heading of options of files in a help page."""

METAVARS = {"s": "SECONDS", "Hz": "HERTZ", "rad": "RADIANS", "rad/s": "RAD/S", "N": "NEWTONS", "ms": "TICKS"}
"""Metavariable of a number in the help, by its unit."""

WORDS = {int: "INTEGER", float: "NUMBER", str: "TEXT", tuple: "NUMBER"}


def option(name: str, **more: Any) -> Any:
    """Option of a command for a setting of a run; its help is made from the setting.

    Parameters
    ----------
    name : str
    **more
        As :func:`typer.Option` takes them.
    """
    setting = RunConfig.SETTINGS[name]
    metavar = None if setting.kind is bool else METAVARS.get(setting.unit, WORDS[setting.kind])
    if setting.kind is tuple:
        metavar = f"{metavar} ..."
    return typer.Option(**{"metavar": metavar, "help": help_text(setting), "show_default": False, **more})


def help_text(setting: Setting) -> str:
    """Description with unit, range and default.

    Examples
    --------
    >>> help_text(RunConfig.SETTINGS["duration"]), help_text(RunConfig.SETTINGS["domain"])
    ('Length of the run [s], 0.001 to 86400; default: 10.', 'ROS domain, 0 to 232; default: ROS_DOMAIN_ID or 0.')
    """
    text = setting.text[0].upper() + setting.text[1:]
    if setting.choices:
        text += f": {', '.join(setting.choices[:-1])} or {setting.choices[-1]}"
    elif setting.low is not None:
        text += f", {_in_short(setting.low)} to {_in_short(setting.high)}"
    return f"{text}; default: {setting.absent if setting.default is None else _in_short(setting.default)}."


def _in_short(value: Any) -> str:
    return f"{value:g}" if isinstance(value, float) else str(value).lower() if isinstance(value, bool) else str(value)


PARAMETER = typer.Option(
    "--set",
    metavar="PARAMETER=VALUE",
    help="Value of a parameter of the telescope, e.g. wheel_2.speed=120; repeatable.",
    rich_help_panel=TELESCOPE,
)

METAVARS_OF = {"loop": "STAGE", "scenario": "SCENARIO", "parameters": "FILE", "k_fsm": "FILE", "k_pma": "FILE"}
"""Metavariable of a setting in the help of all commands."""
HELPS_OF = {
    "loop": "Stage, the loops that are closed: none, isolator, fsm or fsm+pma; default: the telescope's last.",
}
"""Help of settings whose default is none of their own."""


def with_settings(
    names: Iterable[str], metavars: Mapping[str, str] | None = None, helps: Mapping[str, str] | None = None
) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Give a command an option for each of some settings of a run, in the groups of the settings.

    It gets their values as ``given``, ``None`` where an option is not given.

    The values are texts, except for switches; a list is its numbers separated by spaces, a mapping the texts of
    ``--set``: :func:`chosen` parses them.
    `metavars` and `helps` replace those of the setting.
    """
    metavars, helps = {**METAVARS_OF, **(metavars or {})}, {**HELPS_OF, **(helps or {})}
    options = {name: (_option(name, metavars, helps), None) for name in names}
    return lambda command: with_options(command, "given", options, dict)


def with_options(
    command: Callable[..., None], name: str, options: Mapping[str, tuple[Any, Any]], made: Callable[..., Any]
) -> Callable[..., None]:
    """A command with several options instead of one of its parameters.

    Parameters
    ----------
    command : callable
    name : str
        Of the parameter.
    options : mapping
        Name to type, annotated with the option, and default.
    made : callable
        Makes the value of the parameter from those of the options.
    """
    signature = inspect.signature(command, eval_str=True)
    parameters: list[inspect.Parameter] = []
    for known in signature.parameters.values():
        if known.name != name:
            parameters.append(known)
            continue
        for key, (kind, default) in options.items():
            parameters.append(inspect.Parameter(key, known.kind, default=default, annotation=kind))

    @wraps(command)
    def called(**values: Any) -> None:
        value = made(**{key: values.pop(key) for key in options})
        command(**{name: value}, **values)

    facade: Any = called
    facade.__signature__ = signature.replace(parameters=parameters)
    facade.__annotations__ = {parameter.name: parameter.annotation for parameter in parameters}
    return called


def _option(name: str, metavars: Mapping[str, str], helps: Mapping[str, str]) -> Any:
    """Annotated type of the option for a setting; None where it is not given."""
    setting = RunConfig.SETTINGS[name]
    if setting.kind is dict:
        return Annotated[list[str] | None, PARAMETER]
    kind: Any = bool if setting.kind is bool else str
    more = {"metavar": metavars[name]} if name in metavars else {}
    more |= {"help": helps[name]} if name in helps else {}
    return Annotated[kind | None, option(name, rich_help_panel=setting.group or None, **more)]


def chosen(words: Mapping[str, Any], designs: str | None = None) -> dict[str, Any]:
    """Settings from the options of :func:`with_settings`, which win over a folder of designs.

    Raises
    ------
    ValueError
        A value that cannot be read; the folder lacks a controller.
    """
    stated = {name: parse_value(name, v) if isinstance(v, str) else v for name, v in words.items() if v is not None}
    for name in [name for name, value in stated.items() if RunConfig.SETTINGS[name].kind is dict]:
        by_name = settings_of(stated.pop(name))
        if others := [other for other in by_name if other != name]:
            raise InputError(f"--set must name a parameter of the telescope here, got {others[0]}")
        stated |= by_name
    return {**of_designs(designs or ""), **stated}
