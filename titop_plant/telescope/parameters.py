"""The telescope's parameter file: reading, name of its values, uncertain parameters, basis of a control design."""

from __future__ import annotations

import hashlib
import itertools
import json
import math
import pickle
import random
import sys
from collections.abc import Iterator, Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from types import MappingProxyType
from typing import Any

from lftkit.support.input_files import read_bytes, read_text
from lftkit.support.structured_text import StructuredTextError, parse
from lftkit.uncertainty.parameters import RealParameter
from titop_plant.interface import DesignBasis
from titop_plant.telescope.guide_camera import with_guide_camera, without_images
from titop_plant.telescope.layout import (
    ANGLE,
    APPENDAGES,
    ARRAYS,
    MountedBody,
    appendages,
    reaction_wheels,
    solar_arrays,
    without_sources,
)
from titop_plant.telescope.placed.devices import SENSOR
from titop_plant.telescope.requirements import (
    instant_probability,
    take_limits,
    telescope_requirements,
    window_probability,
    with_limits,
)
from titop_plant.telescope.tables.parameter_check import ParameterFile
from titop_plant.telescope.tables.uncertain import UNCERTAIN, checked_spreads, factors

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

Parameters = Mapping[str, Any]

REFERENCE = Path(__file__).with_name("reference.toml")
OWN_BODIES = ("body", "payload")
MOST_CORNERS = 256
"""Corners of the box that are looked at one by one: all of eight parameters."""
"""Bodies whose modal data may be a file of the user."""
SOURCES = "disturbance"
"""Tables ``[[disturbance]]`` of a user's file: sources that act in every run of the telescope."""
FOLDER = "folder"
"""Key of such a table for the folder of its file, to which other files in it are relative."""
FIRST_PROBABILITY = 0.997
"""Part of the windows, and of the instants, that kept their limit in designs whose names do not say it."""


def load_parameters(path: str | Path | None = None) -> Parameters:
    """Read a parameter file.

    Parameters
    ----------
    path : str or Path, optional
        TOML file of the form of ``reference.toml``, which stands where none is given; tables that are missing are taken
        from it, so that a user's file holds only what differs. Tables with a name, ``[[payload.equipment]]`` and
        ``[[requirement]]``, change those of the same name and are added to the others; ``replace = ["equipment"]`` in
        ``[payload]``, or ``replace = ["requirement"]`` at the head of the file, replaces all of them. Lists of tables
        without names are replaced. A relative ``body.modal_data``, ``payload.modal_data``, ``optics.pupil`` or
        ``camera.noise_curve`` is looked for beside it. Low-pass and noise of a camera that is no vector are those of
        its table, see :mod:`titop_plant.telescope.guide_camera`. Bearings and broadband noise of wheels and stepper
        motors of drives are tables of :mod:`titop_plant.telescope.tables.mechanisms`. Tables ``[[solar_array]]``,
        ``[[reaction_wheel]]`` and ``[[appendage]]`` say what is on board, see :mod:`titop_plant.telescope.layout`,
        ``[[sensor]]`` and ``[[actuator]]`` what is beside the loop, :mod:`titop_plant.telescope.placed.devices`,
        ``[uncertain]`` what varies beside the wheels, :mod:`titop_plant.telescope.tables.uncertain`.
        Tables ``[[disturbance]]`` are kept as they are, each with the folder of the file.

    Raises
    ------
    ValueError
        File missing or not TOML; a key that the reference does not have, or a value of another kind, length or
        sign than the reference's; requirements that :func:`titop_plant.telescope.requirements.with_limits` refuses.
        The message names the file, the line and the key.
    """
    path = path or REFERENCE
    reference, text = _read(REFERENCE)
    if Path(path) == REFERENCE:
        return MappingProxyType(with_limits(reference, reference, {}, ParameterFile(str(path), text)))
    from titop_plant.telescope.tables.mechanisms import take_mechanisms, with_mechanisms
    from titop_plant.telescope.tables.mounted import checked_layout, take_mounted  # loads scipy

    own, text = _read(Path(path))
    file = ParameterFile(str(path), text)
    limits, sources, mounted = take_limits(own, file), own.pop(SOURCES, []), take_mounted(own)
    spreads = own.pop(UNCERTAIN, {})
    if not isinstance(sources, list) or not all(isinstance(table, dict) for table in sources):
        raise file.error(SOURCES, f"must be tables [[{SOURCES}]], got {sources!r}")
    mechanisms = take_mechanisms(own)
    merged = with_limits(file.merged(reference, own), own, limits, file)
    merged |= with_mechanisms(merged, mechanisms, file)
    if merged["optics"]["pupil"]:
        merged["optics"] = {**merged["optics"], "pupil": str(Path(path).parent / merged["optics"]["pupil"])}
    if merged["camera"]["noise_curve"]:
        merged["camera"] = {
            **merged["camera"],
            "noise_curve": str(Path(path).parent / merged["camera"]["noise_curve"]),
        }
    merged = with_guide_camera(merged, own, file)
    merged |= checked_layout(mounted, merged, reference, file)
    if spreads:
        merged[UNCERTAIN] = checked_spreads(spreads, file, merged)
    for name in OWN_BODIES:
        file = merged[name]["modal_data"]
        if file:
            merged[name] = {**merged[name], "modal_data": str(Path(path).parent / file)}
    if sources:
        merged[SOURCES] = [{**table, FOLDER: str(Path(path).parent)} for table in sources]
    return MappingProxyType(merged)


def differences(path: str | Path) -> list[str]:
    """Values of a parameter file that differ from the reference, one line each, both values in it.

    Raises
    ------
    ValueError
        As :func:`load_parameters`.

    Examples
    --------
    >>> differences(REFERENCE)
    []
    """
    own, reference = (dict(_flat("", load_parameters(file))) for file in (path, REFERENCE))
    lines = [
        f"{name} = {_shown(own[name])}" + (f", reference {_shown(reference[name])}" if name in reference else ", added")
        for name in own
        if name not in reference or own[name] != reference[name]
    ]
    return lines + [f"{name} removed" for name in reference if name not in own]


def _flat(prefix: str, value: Any) -> Iterator[tuple[str, Any]]:
    """Full name and value of each entry; of tables in a list the name counts, not the place."""
    if isinstance(value, Mapping):
        for key, entry in value.items():
            yield from _flat(f"{prefix}.{key}" if prefix else key, entry)
    elif isinstance(value, list) and value and all(isinstance(item, Mapping) for item in value):
        for i, item in enumerate(value):
            yield from _flat(f"{prefix}[{item.get('name', i)}]", {k: v for k, v in item.items() if k != "name"})
    else:
        yield prefix, value


def _shown(value: Any) -> str:
    return f"{value:g}" if isinstance(value, float) else str(value)


def _read(path: Path) -> tuple[dict[str, Any], str]:
    """Content of a TOML file, and its text."""
    try:
        text = read_text(path)
        return pickle.loads(_parsed(text)), text
    except OSError as error:
        raise ValueError(f"cannot read the parameter file {path}: {error.strerror}") from None
    except UnicodeDecodeError:
        raise ValueError(f"{path} is not a TOML file: expected UTF-8 text") from None
    except StructuredTextError as error:
        raise ValueError(f"{path} is not a TOML file: {error}") from None


@lru_cache(maxsize=4)
def _parsed(text: str) -> bytes:
    """Content of a TOML text, pickled: a copy of its own for each caller, a hundred times as fast as parsing."""
    return pickle.dumps(parse(text, "it", "TOML", tomllib.loads))


def parameters_hash(parameters: Parameters) -> str:
    """Twelve hexadecimal digits that name these parameter values: the first ones of :func:`parameters_digest`."""
    return parameters_digest(parameters)[:12]


def parameters_digest(parameters: Parameters) -> str:
    """128 bits, as hexadecimal digits, that name these parameter values; of a modal data file the content counts.

    Of the requirements only the limits in ``weights`` count, and of the finest one the probability where it is not
    that of the designs from before it could be another: nothing else of them is in a plant or a design. Of the
    optics those of images (`IMAGE_OPTICS`) do not count, nor does the table of the guide camera, of which the low-pass
    and the noise under ``sensors`` count where they follow from it, nor do sources of disturbance and further sensors:
    no design depends on them.
    """
    known = without_sources(without_images(parameters))
    content = {key: value for key, value in known.items() if key not in ("requirement", SOURCES, SENSOR)}
    requirements = telescope_requirements(parameters)
    parts = {
        "window_probability": window_probability(requirements),
        "instant_probability": instant_probability(requirements),
    }
    content.update({name: part for name, part in parts.items() if part != FIRST_PROBABILITY})
    for name in OWN_BODIES:
        content[name] = _with_digest(content[name])
    for name in (ARRAYS, APPENDAGES):
        if isinstance(content.get(name), list):
            content[name] = [_with_digest(table) for table in content[name]]
    text = json.dumps(content, sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:32]


def _with_digest(table: Mapping[str, Any]) -> Mapping[str, Any]:
    """The table of a body, of its modal data file the content in place of the name."""
    file = table.get("modal_data", "")
    return {**table, "modal_data": hashlib.sha256(read_bytes(file)).hexdigest()} if file else table


def design_basis(parameters: Parameters) -> DesignBasis:
    """What of this telescope a controller is made for, or must have been made for."""
    return DesignBasis(
        parameters_hash=parameters_hash(parameters),
        los_sensitivity=float(parameters["fsm"]["los_sensitivity"]),
        fsm_authority=float(parameters["fsm"]["authority"]),
        pma_authority=float(parameters["pma"]["authority"]),
    )


def uncertain_parameters(parameters: Parameters) -> dict[str, RealParameter]:
    """The varying and uncertain parameters of the telescope, in the order of Delta.

    ``wheel_1.speed`` and so on [rad/s]; of each array the uncertain frequencies ``<parameters>.omega_1`` and so on
    [rad/s]; ``solar_array.tau`` = tan(theta / 4), one theta for all arrays that turn; of appendages their uncertain
    frequencies; factors of the table ``[uncertain]``, where there is one. The arrays of the reference share
    ``solar_array.omega_1`` and ``solar_array.omega_2``.
    """
    result = {}
    for i, wheel in enumerate(reaction_wheels(parameters), start=1):
        name, top = f"wheel_{i}.speed", wheel.maximum_speed
        result[name] = RealParameter(name, 0.0, -top, top, "rad/s", f"speed of reaction wheel {i}")
    arrays, others = solar_arrays(parameters), appendages(parameters)
    result |= _frequencies(arrays)
    turning = [array for array in arrays if array.turns]
    if turning:
        low, high = (math.tan(theta / 4) for theta in turning[0].table["theta_range"])
        about = f"tan(theta/4), theta the angle of {_words(turning, arrays)}"
        result[ANGLE] = RealParameter(ANGLE, 0.0, low, high, "1", about)
    return result | _frequencies(others) | factors(parameters)


def _frequencies(bodies: Sequence[MountedBody]) -> dict[str, RealParameter]:
    """Uncertain frequencies of mounted bodies, those that several share once."""
    found: dict[str, RealParameter] = {}
    for prefix in dict.fromkeys(body.parameters for body in bodies):
        owners = [body for body in bodies if body.parameters == prefix]
        found |= _frequencies_of(owners[0], _words(owners, bodies))
    return found


def _frequencies_of(body: MountedBody, owners: str) -> dict[str, RealParameter]:
    table, result = body.table, {}
    spread = table.get("relative_uncertainty", 0.0)
    if not spread:
        return {}
    if table.get("modal_data"):
        from titop_plant.structures.modal_file import read_modal_data  # loads scipy

        frequencies = read_modal_data(table["modal_data"]).frequencies
    else:
        frequencies = table["frequencies"]
    for i, w in enumerate(frequencies[: table.get("uncertain_modes", len(frequencies))], start=1):
        name, about = f"{body.parameters}.omega_{i}", f"clamped frequency of mode {i} of {owners}"
        result[name] = RealParameter(name, float(w), w * (1 - spread), w * (1 + spread), "rad/s", about)
    return result


def _words(owners: Sequence[MountedBody], bodies: Sequence[MountedBody]) -> str:
    """What a parameter belongs to, in words."""
    if len(owners) == len(bodies) == 2 and all("drive_axis" in body.table for body in owners):
        return "both arrays"
    return ", ".join(body.name for body in owners)


def parameter_box(parameters: Parameters) -> dict[str, tuple[float, float]]:
    """Ranges of the uncertain parameters by name: (lowest, highest)."""
    return {name: (p.lower, p.upper) for name, p in uncertain_parameters(parameters).items()}


def parameter_corners(parameters: Parameters) -> list[dict[str, float]]:
    """All corners of the box of uncertain parameters (2^7 for the reference), or `MOST_CORNERS` random ones of more."""
    box = parameter_box(parameters)
    if 2 ** len(box) <= MOST_CORNERS:
        return [dict(zip(box, ends)) for ends in itertools.product(*box.values())]
    chance, drawn = random.Random(0), dict[tuple[float, ...], None]()
    while len(drawn) < MOST_CORNERS:
        drawn[tuple(map(chance.choice, box.values()))] = None
    return [dict(zip(box, ends)) for ends in drawn]
