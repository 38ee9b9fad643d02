"""Named cases of a telescope, made of the ranges of its parameters, or of a file of the user's."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lftkit.errors import InputError
from los_testbed.config.members import member_settings
from los_testbed.config.run_config import read_yaml
from pointing_analysis.files.settings import proposal
from titop_plant.physical_settings import ANGLE
from titop_plant.telescope.load import load_telescope

if TYPE_CHECKING:
    from titop_plant.telescope.telescope import Telescope

Case = Mapping[str, Any]

WORST: Case = {"theta": 1.3962634015954636, "wheel_speed": [-1047.2] * 4, "omega_1": 0.70585, "omega_2": 2.7825}
"""Of the reference telescope, found on a grid."""


def telescope_cases(telescope: Telescope) -> dict[str, Case | str]:
    """Named cases of a telescope.

    Returns
    -------
    dict
        By name: run parameters with a ``description``, or a text that says why the telescope has no such case.

    Examples
    --------
    >>> cases = telescope_cases(load_telescope())
    >>> cases["arrays_half_turn"]["tau"], cases["spin_up"]["wheel_acceleration"][0]
    (1.0, 8.083333333333334)
    """
    return {
        "nominal": {
            "description": "arrays at 0, wheels at their own speeds, nominal frequencies",
            **({"theta": 0.0} if ANGLE in telescope.uncertain else {}),
        },
        **_array_cases(telescope),
        **_frequency_cases(telescope),
        "wheels_at_rest": _wheels(telescope, "no gyroscopic stiffness", 0.0),
        "wheels_fast": {
            "description": "all wheels at their largest speed, the same sense",
            "wheel_speed": [wheel.speed_range[1] for wheel in telescope.wheels],
        },
        "wheels_spinning_up": _wheels(
            telescope, "all wheels from 100 to 200 rad/s within 10 s", 100.0, 200.0, ramp_duration=10.0
        ),
        "spin_up": _wheels(
            telescope,
            "all wheels from 30 to 1000 rad/s, or to their largest speed, within 120 s, their tones cross all modes",
            30.0,
            min([1000.0, *(wheel.speed_range[1] for wheel in telescope.wheels)]),
            ramp_duration=120.0,
            scenario="ramp",
            duration=120.0,
        ),
        "zero_crossing": _wheels(
            telescope,
            "all wheels through rest, from 60 to -60 rad/s within 60 s",
            60.0,
            -60.0,
            ramp_duration=60.0,
            scenario="ramp",
            duration=60.0,
        ),
        "worst": {
            "description": "highest peak of the line of sight against the RPE template with the isolator alone",
            **WORST,
        }
        if _of_shipped_designs(telescope)
        else "it is known of the reference telescope alone; los-testbed design verify searches that of another one",
    }


def _of_shipped_designs(telescope: Telescope) -> bool:
    from los_design.synthesis.store import of_shipped_designs  # not loaded by commands without cases

    return of_shipped_designs(telescope)


def _array_cases(telescope: Telescope) -> dict[str, Case | str]:
    """Cases of solar arrays that turn."""
    names = ("arrays_quarter_turn", "arrays_half_turn", "arrays_turning", "array_turn")
    tau = telescope.uncertain.get(ANGLE)
    if tau is None:
        return dict.fromkeys(names, "none of its arrays turns")
    low, high = (4.0 * math.atan(bound) for bound in (tau.lower, tau.upper))
    turn = {"scenario": "ramp", "profile": "trapezoidal", "ramp_duration": 120.0, "duration": 120.0}
    cases: tuple[Case, ...] = (
        {"description": "arrays turned by 90 degrees, all else nominal", "theta": 0.5 * math.pi},
        {"description": "arrays turned to the end of their range, all else nominal", "tau": float(f"{tau.upper:.12g}")},
        {
            "description": "the arrays turn from 0 by 0.2 rad/s for 5 s",
            "theta": 0.0,
            "theta_rate": 0.2,
            "ramp_duration": 5.0,
        },
        {
            "description": "arrays through their range within 120 s, the rate rising and falling linearly",
            "theta": low,
            "theta_rate": (high - low) / 120.0,
            **turn,
        },
    )
    largest = (0.5 * math.pi, high, 1.0, high)
    too_far = "its arrays do not turn so far"
    return {
        name: case if angle <= high + 1e-9 else too_far for name, case, angle in zip(names, cases, largest, strict=True)
    }


def _frequency_cases(telescope: Telescope) -> dict[str, Case | str]:
    """Cases of uncertain frequencies of arrays and appendages."""
    table = {name: p for name, p in telescope.uncertain.items() if re.search(r"\.omega_\d+$", name)}
    if not table:
        return dict.fromkeys(("soft_arrays", "stiff_arrays"), "it has no uncertain frequencies of arrays")
    text = "frequencies of arrays and appendages at their {} ends"
    soft, stiff = (
        member_settings({name: float(f"{getattr(p, side):.12g}") for name, p in table.items()}, telescope)
        for side in ("lower", "upper")
    )
    return {
        "soft_arrays": {"description": text.format("lower"), **soft},
        "stiff_arrays": {"description": text.format("upper"), **stiff},
    }


def _wheels(telescope: Telescope, description: str, begin: float, end: float | None = None, **ramp: Any) -> Case | str:
    """Wheels of alternating sense at a speed, or from one to another [rad/s] within ``ramp_duration``."""
    wheels, speeds = telescope.wheels, [begin] if end is None else [begin, end]
    senses = [1.0 if k % 2 == 0 or wheel.speed_range[0] >= 0.0 else -1.0 for k, wheel in enumerate(wheels)]
    for wheel, sense in zip(wheels, senses):
        low, high = wheel.speed_range
        if not wheel.varies or not all(low <= sense * speed <= high for speed in speeds):
            return f"the wheel {wheel.name} is not driven through these speeds"
    case = {"description": description, "wheel_speed": [sense * begin for sense in senses], **ramp}
    if end is not None:
        case["wheel_acceleration"] = [sense * (end - begin) / ramp["ramp_duration"] for sense in senses]
    return case if wheels else "it has no wheels"


def named_cases(path: Path) -> dict[str, dict[str, Any]]:
    """Cases of a file: name to a table of run parameters, with an optional ``description``.

    Raises
    ------
    ValueError
        The file cannot be read or is not a table of tables.
    """
    content = read_yaml(path)
    for name, settings in content.items():
        if not isinstance(settings, dict):
            raise InputError(f"{path}: case {name!r} must be a table of parameters, got {settings!r}")
    return content


def case_settings(name: str, path: Path | None = None, parameters: str | None = None) -> dict[str, Any]:
    """Settings of one named case.

    Parameters
    ----------
    name : str
    path : Path, optional
        YAML file of cases; default: those of the telescope, :func:`telescope_cases`.
    parameters : str, optional
        Parameter file of the telescope; default: the reference telescope.

    Raises
    ------
    ValueError
        No such case, the nearest one is proposed; a telescope that does not have it.

    Examples
    --------
    >>> case_settings("arrays_half_turn")
    {'tau': 1.0}
    """
    cases: Mapping[str, Case | str] = telescope_cases(load_telescope(parameters)) if path is None else named_cases(path)
    if name not in cases:
        raise InputError(f"{path.name if path else 'the telescope'} has no case {name!r}{proposal(name, cases)}")
    case = cases[name]
    if isinstance(case, str):
        raise InputError(f"{parameters} has no case {name}: {case}")
    return {key: value for key, value in case.items() if key != "description"}
