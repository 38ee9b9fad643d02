"""Settings of a run from sources of several settings: folder of designs, member of the family, scenario.

A later layer overrides an earlier one: folder of designs, file, named case, random member, single settings.
"""

from __future__ import annotations

import shlex
from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lftkit.errors import InputError
from los_design.files import CONTROLLERS, TELESCOPE
from los_testbed.config.cases import case_settings
from los_testbed.config.members import MEMBER, random_member, worst_member
from los_testbed.config.run_config import RunConfig
from titop_plant.interface import NO_SCENARIO, SCENARIOS
from titop_plant.physical_settings import PROFILES, PhysicalSettings
from titop_plant.simulation.plant_config import stated_values
from titop_plant.telescope.load import load_telescope
from titop_plant.telescope.uncertain_parameters import SPEED, moves

if TYPE_CHECKING:
    from titop_plant.telescope.telescope import Telescope

SIMULATED = (
    *("duration", "loop", "scenario", "worst_of", "k_fsm", "k_pma", "ports_in_order", "parameters"),
    *("start", "fsm_authority", "pma_authority", "hold_ticks", "fade_ticks", "nonlinear"),
    *("noise", "disturbance", "camera_rate", "camera_dropout", "camera_latency", "old_frames", "lost_samples"),
    "parameter_values",
)
"""Settings of runs in one process that campaigns, comparisons and trades share, beside members and seeds; parameters
that have values do not vary among the members."""


def layered(*layers: Mapping[str, Any]) -> dict[str, Any]:
    """Settings of all layers; a later one wins, also its ``tau`` over an earlier ``theta`` and the other way round.

    Where one of them names parameters, those of all layers become ``parameter_values``.

    Raises
    ------
    ValueError
        A layer gives a parameter twice, or one that the telescope does not have; a parameter file that cannot be read.

    Examples
    --------
    >>> layered({"theta": 0.5, "seed": 1}, {"tau": 0.3})
    {'seed': 1, 'tau': 0.3}
    >>> layered({"tau": 0.5, "omega_1": 0.73}, {"parameter_values": {"solar_array.tau": 0.2}})
    {'parameter_values': {'solar_array.tau': 0.2, 'solar_array.omega_1': 0.73}}
    """
    values: dict[str, Any] = {}
    for layer in layers:
        for name, other in (("tau", "theta"), ("theta", "tau")):
            if name in layer and other not in layer:
                values.pop(other, None)
        values.update(layer)
    if not any(layer.get("parameter_values") for layer in layers):
        return values
    telescope, by_name = load_telescope(values.get("parameters")), dict[str, float]()
    for layer in layers:
        of_layer = PhysicalSettings.from_mapping({name: layer[name] for name in MEMBER if name in layer})
        by_name |= stated_values(of_layer, telescope)
    by_name = {name: value for name, value in by_name.items() if name in telescope.uncertain}
    if values.get("profile", PROFILES[0]) not in PROFILES:  # a file has what moves, but for what a layer names itself
        named = {name for layer in layers for name in layer.get("parameter_values") or ()}
        by_name = {name: value for name, value in by_name.items() if name in named or not moves(name)}
    kept = () if any(map(SPEED.fullmatch, by_name)) else ("wheel_speed",)  # of wheels whose speeds are no parameters
    others = {name: value for name, value in values.items() if name in kept or name not in MEMBER}
    return {**others, "parameter_values": by_name}


def of_designs(designs: str) -> dict[str, Any]:
    """Settings of a folder of designs: its controllers, and its telescope if it has one.

    Raises
    ------
    ValueError
        A controller is missing.
    """
    if not designs:
        return {}
    folder = Path(designs)
    settings = {name: str(folder / file) for name, file in CONTROLLERS.items()}
    for path in settings.values():
        if not Path(path).exists():
            raise InputError(f"designs must hold {' and '.join(CONTROLLERS.values())}, got no {path}")
    telescope = folder / TELESCOPE
    return {**settings, **({"parameters": str(telescope)} if telescope.exists() else {})}


def command_options(config: RunConfig, names: Iterable[str]) -> str:
    """Options of a command line that give some settings, those that are not at their defaults.

    Examples
    --------
    >>> command_options(RunConfig(loop="fsm", noise=False, camera_latency=3.0), ("loop", "noise", "camera_latency"))
    ' --loop fsm --no-noise --camera-latency 3'
    """
    words = ""
    for name in names:
        value, option = getattr(config, name), name.replace("_", "-")
        if value is None or value == RunConfig.SETTINGS[name].default:
            continue
        if isinstance(value, Mapping):
            words += "".join(f" --set {parameter}={number!r}" for parameter, number in value.items())
        elif isinstance(value, bool):
            words += f" --{'' if value else 'no-'}{option}"
        else:
            text = repr(value).removesuffix(".0") if isinstance(value, float) else shlex.quote(str(value))
            words += f" --{option} {text}"
    return words


def with_stage(settings: Mapping[str, Any]) -> dict[str, Any]:
    """The settings with the last stage of their telescope where they name no loop.

    Raises
    ------
    ValueError
        The parameter file cannot be read.

    Examples
    --------
    >>> with_stage({"seed": 1})
    {'seed': 1}
    """
    parameters = settings.get("parameters")
    if not parameters or "loop" in settings:
        return {**settings}
    return {**settings, "loop": load_telescope(parameters).stages[-1]}


def chosen_member(
    case: str | None, cases: Path | None, sample: str | None, before: Mapping[str, Any], after: Mapping[str, Any]
) -> tuple[dict[str, Any], dict[str, Any]]:
    """Settings of ``--case`` and ``--sample``.

    The ranges of a random member are those of the parameter file that the rest of the configuration names.

    Raises
    ------
    ValueError
        No such case, a file of cases without a case, a seed that is no whole number.
    """
    if cases is not None and case is None:
        raise InputError(f"--case must be given with --cases {cases}, got none")
    parameters = layered(before, after).get("parameters")
    named = {} if case is None else case_settings(case, cases, parameters)
    if sample is None:
        return named, {}
    try:
        seed = int(sample)
    except ValueError:
        raise InputError(f"sample must be a whole number, the seed of the member, got {sample!r}") from None
    return named, random_member(seed, layered(before, named, after).get("parameters"))


def of_scenario(settings: Mapping[str, Any], designs: str = "") -> dict[str, Any]:
    """Default scenario, and the member of the family that it selects, for settings without them.

    The scenario worst_case: the worst member of the stage. The scenario imbalance: wheel speeds at which harmonics are
    at structural modes. Sources of the user without a scenario: none.

    Parameters
    ----------
    settings : mapping
        Of the run, those that are given.
    designs : str
        Folder of designs; empty for the stored ones.
    """
    stated = RunConfig.from_mapping({**settings})
    config = with_scenario(stated)
    implied: dict[str, Any] = {} if stated.scenario else {"scenario": config.scenario}
    if config.scenario == "worst_case" and not any(name in settings for name in MEMBER):
        implied |= worst_member(config.loop, config.worst_of, config.parameters, designs)
    named = any(SPEED.fullmatch(name) for name in config.parameter_values or ())
    if config.scenario == "imbalance" and "wheel_speed" not in settings and not named:
        from titop_plant.simulation.build import resonant_speeds

        implied["wheel_speed"] = list(resonant_speeds(config.parameters))
    return implied


def completed(settings: Mapping[str, Any], designs: str = "") -> RunConfig:
    """Configuration of a run from the settings that are given: stage, scenario and member where they name none.

    With a plant of the user, or a rig, the start is at rest: what is steady is known of the telescope only.

    Parameters
    ----------
    settings : mapping
    designs : str
        Folder of designs, whose worst members count; empty for the stored ones.

    Raises
    ------
    ValueError
        Unknown names, values that do not fit.
    """
    stated = with_stage(settings)
    if stated.get("plant") or stated.get("device"):
        return RunConfig.from_mapping({"start": "rest", **stated})
    return RunConfig.from_mapping({**stated, **of_scenario(stated, designs)})


def with_scenario(config: RunConfig, telescope: Telescope | None = None, usual: str = SCENARIOS[0]) -> RunConfig:
    """The configuration with the scenario that acts where it says none: the usual one, or none beside other sources.

    Parameters
    ----------
    config : RunConfig
    telescope : Telescope, optional
        Default: read from its file, if the configuration names one.
    usual : str
        Scenario of a run without other sources.

    Raises
    ------
    ValueError
        The file cannot be read.
    """
    if config.scenario is not None:
        return config
    alone = config.disturbance and not config.other_plant and _has_sources(config, telescope)
    return replace(config, scenario=NO_SCENARIO if alone else usual)


def _has_sources(config: RunConfig, telescope: Telescope | None) -> bool:
    """Whether files, code or the telescope's tables make disturbances."""
    if config.disturbance_source or config.files_of_disturbance:
        return True
    if not config.parameters:
        return False
    known = load_telescope(config.parameters) if telescope is None else telescope
    return bool(known.sources) or bool(known.source_tables)
