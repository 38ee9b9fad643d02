"""Pointing requirements: their text form, and files of them.

The text form is the requirement form of ECSS-E-ST-60-10C::

    prob(|RPE(20 ms)| < 40 mas) >= 0.997 at 95 % confidence

    prob(rms RPE(20 ms) < 40 mas) >= 0.997 at 95 % confidence

``|RPE|`` is the error at every instant of disjoint windows, ``rms RPE`` one value of each window: the root mean square
about its mean, both axes, which is what the weight W_RPE of the design weighs.

The forms have an index (APE, MPE, RPE, PDE, PRE, AKE, MKE, RKE; ``_x`` or ``_y`` for one axis), its window where it has
one (two times for PDE: window and separation), a limit, a probability, a confidence, and the interpretation:
``temporal`` (default: every run, over its time), ``ensemble`` (over runs, the worst instant of each) or ``mixed`` (over
runs and time together).

Indices of the image of a star have an exposure in place of a window, and one value for each exposure::

    prob(MTF(20 ms, Nyquist) > 0.90) >= 0.997 at 95 % confidence

    prob(EE80(20 ms) < 140 mas) >= 0.997 at 95 % confidence

===============  ====================================================================================================
MTF              transfer of the motion along the worst direction, at a spatial frequency: ``Nyquist`` of the pixels,
                 a part of it (``0.5 Nyquist``) or a number (``8 cycles/arcsec``); its limit is a lower one
Strehl           Strehl ratio of the motion; its limit is a lower one
EE50, EE80       radius that holds 50 or 80 % of the energy
ellipticity      absolute ellipticity of the image
===============  ====================================================================================================
"""

from __future__ import annotations

import math
import os
import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from decimal import Decimal
from pathlib import Path
from typing import Any

from lftkit.errors import InputError
from lftkit.support.counted_nouns import counted
from pointing_analysis.indices import metrics
from pointing_analysis.units import ANGLES

TIMES = {"us": 1e-6, "ms": 1e-3, "s": 1.0, "min": 60.0}
#: index -> number of times it takes
INDICES = {"APE": 0, "MPE": 1, "RPE": 1, "PDE": 2, "PRE": 1, "AKE": 0, "MKE": 1, "RKE": 1}
NYQUIST = "Nyquist"
"""Unit of a spatial frequency: the largest one that the pixels sample without ambiguity."""


@dataclass(frozen=True)
class ImageIndex:
    """An index of the image of a star.

    Parameters
    ----------
    lower : whether its limit is a lower one
    angle : whether its limit is an angle; else a number below `top`
    top : largest limit
    """

    lower: bool = False
    angle: bool = False
    top: float = 1.0


IMAGE_INDICES = {
    "MTF": ImageIndex(lower=True),
    "Strehl": ImageIndex(lower=True),
    "EE50": ImageIndex(angle=True, top=math.inf),
    "EE80": ImageIndex(angle=True, top=math.inf),
    "ellipticity": ImageIndex(),
}
INDICES |= dict.fromkeys(IMAGE_INDICES, 1)
INTERPRETATIONS = ("temporal", "ensemble", "mixed")
_FREQUENCY = re.compile(r"\s*(?P<value>[\d.eE+-]*)\s*(?:(?P<nyquist>nyquist)|cycles\s*/\s*(?P<unit>[a-z]+))\s*", re.I)
_TEXT = re.compile(
    r"prob\s*\(\s*(?P<sign>\||rms\s|)\s*(?P<index>[A-Za-z]+\d*)(?:_(?P<axis>[A-Za-z]\w*))?\s*(?:\((?P<times>[^)]*)\))?\s*"
    r"(?P<end>\|?)\s*(?P<relation>[<>])=?\s*"
    r"(?P<limit>[\d.eE+-]+)\s*(?P<unit>[a-z]*)\s*\)\s*>=?\s*(?P<p>[\d.]+)\s*(?P<pp>%?)\s*"
    r"at\s+(?P<c>[\d.]+)\s*(?P<cp>%?)\s*confidence\s*(?:,\s*(?P<kind>[a-z]+))?\s*"
)


@dataclass(frozen=True)
class SpatialFrequency:
    """A spatial frequency as a requirement has it.

    Parameters
    ----------
    value : positive
    unit : `NYQUIST`, or an angle of `ANGLES`: cycles per it

    Examples
    --------
    >>> print(SpatialFrequency(1.0, NYQUIST), SpatialFrequency(0.5, NYQUIST), SpatialFrequency(8.0, "arcsec"), sep=", ")
    Nyquist, 0.5 Nyquist, 8 cycles/arcsec
    """

    value: float
    unit: str

    def per_radian(self, nyquist: float) -> float:
        """[cycles/rad]; `nyquist` of the detector in the same unit."""
        return self.value * nyquist if self.unit == NYQUIST else self.value / ANGLES[self.unit]

    def __str__(self) -> str:
        number = f"{self.value:g}" if float(f"{self.value:g}") == self.value else repr(self.value)
        if self.unit == NYQUIST:
            return NYQUIST if self.value == 1.0 else f"{number} {NYQUIST}"
        return f"{number} cycles/{self.unit}"


def time_text(seconds: float) -> str:
    """A window as the forms write it.

    Examples
    --------
    >>> time_text(0.25), time_text(0.005), time_text(10.0)
    ('250 ms', '5 ms', '10 s')
    """
    return f"{1e3 * seconds:g} ms" if seconds < 1 else f"{seconds:g} s"


@dataclass(frozen=True)
class Requirement:
    """One pointing requirement; `parse` makes it from its text.

    Attributes
    ----------
    index : one of `INDICES`
    axis : "" for the norm of the 2-vector, ``x`` or ``y`` for one axis
    times : window, and separation for PDE [s]
    limit : [rad], of numbers (MTF, Strehl, ellipticity) the number
    unit : unit in which the limit is shown; empty for numbers
    probability, confidence : between 0 and 1
    interpretation : temporal, ensemble or mixed
    name : short name
    loops : loop stages it applies to; empty for all
    of_windows : of RPE and RKE whether each window has one value, its rms, instead of one at every instant
    frequency : of the MTF
    source : text that it was read from
    """

    index: str
    axis: str
    times: tuple[float, ...]
    limit: float
    unit: str
    probability: float
    confidence: float
    interpretation: str = "temporal"
    name: str = ""
    loops: tuple[str, ...] = ()
    of_windows: bool = False
    frequency: SpatialFrequency | None = None
    source: str = field(default="", repr=False, compare=False)

    @property
    def scale(self) -> float:
        """Radians per display unit; 1 for numbers."""
        return ANGLES[self.unit] if self.unit else 1.0

    @property
    def of_image(self) -> bool:
        """Whether the index is one of the image of a star."""
        return self.index in IMAGE_INDICES

    @property
    def lower(self) -> bool:
        """Whether the limit is a lower one: the index must be above it."""
        return self.of_image and IMAGE_INDICES[self.index].lower

    @property
    def across_runs(self) -> bool:
        """Whether it is judged on several runs together and not on each."""
        return self.interpretation != "temporal" or self.index == "PRE"

    @property
    def quantity(self) -> str:
        """The judged quantity, e.g. ``|RPE(20 ms)|`` or ``rms RPE(20 ms)``."""
        return self._quantity(", ".join(map(time_text, self.times)))

    def _quantity(self, times: str) -> str:
        if self.of_image:
            return f"{self.index}({times}{'' if self.frequency is None else f', {self.frequency}'})"
        axis = f"_{self.axis}" if self.axis else ""
        text = f"{self.index}{axis}{f'({times})' if times else ''}"
        return f"rms {text}" if self.of_windows else f"|{text}|"

    def __str__(self) -> str:
        return self._text(f"{self.limit / self.scale:g} {self.unit}".strip(), self.quantity)

    @property
    def exact_text(self) -> str:
        """Text that `parse` reads as the same requirement, bit for bit: that of its author unless it was changed since.

        Messages quote it.
        """
        if self.source and parse(self.source, self.name, self.loops) == self:
            return self.source
        value, wanted = self.limit / self.scale, self.limit
        near = (float(f"{value:g}"), value, math.nextafter(value, 0.0), math.nextafter(value, math.inf))
        shown = next((f"{x:g}" if x == near[0] else repr(x) for x in near if x * self.scale == wanted), "")
        times = ", ".join(_exact_time(t) for t in self.times)
        limit = f"{shown} {self.unit}".strip() if shown else f"{wanted!r} rad"
        return self._text(limit, self._quantity(times), exact=True)

    def _text(self, limit: str, quantity: str, exact: bool = False) -> str:
        tail = "" if self.interpretation == "temporal" else f", {self.interpretation}"
        sign = ">" if self.lower else "<"
        part, sure = f"{self.probability:.10g}", f"{100 * self.confidence:.10g} %"
        if part == "1" or (exact and float(part) != self.probability):
            part = format(Decimal(repr(self.probability)), "f")
        if sure == "100 %" or (exact and float(sure[:-2]) / 100 != self.confidence):
            sure = format(Decimal(repr(self.confidence)), "f")
        return f"prob({quantity} {sign} {limit}) >= {part} at {sure} confidence{tail}"


def parse(text: str, name: str = "", loops: Sequence[str] = ()) -> Requirement:
    """Read a requirement from its text.

    Raises
    ------
    InputError
        The text has another form, or names an unknown index, unit or interpretation.

    Examples
    --------
    >>> r = parse("prob(|RPE(20 ms)| < 40 mas) >= 99.7 % at 95 % confidence")
    >>> print(r)
    prob(|RPE(20 ms)| < 40 mas) >= 0.997 at 95 % confidence
    """
    m = _TEXT.fullmatch(text.strip())
    if m is None or (m["sign"] == "|") != bool(m["end"]):
        raise InputError(f"requirement must read like '{EXAMPLE}', got {text!r}")
    any_case, kind = m["index"].upper(), m["kind"] or "temporal"
    index = {known.upper(): known for known in INDICES}.get(any_case, any_case)
    if index not in IMAGE_INDICES and not (m["sign"] and m["unit"]):
        _member("index", index, INDICES)
        raise InputError(f"requirement must read like '{EXAMPLE}', got {text!r}")
    _member("index", index, INDICES)
    if m["axis"]:
        _member("axis", m["axis"], metrics.AXES)
    _check_relation(m, index, text)
    of_windows = m["sign"].startswith("rms")
    if of_windows:
        _member("index of rms", index, ("RPE", "RKE"))
    if m["unit"]:
        _member("unit", m["unit"], ANGLES)
    _member("interpretation", kind, INTERPRETATIONS)
    arguments = [part for part in (m["times"] or "").split(",") if part.strip()]
    frequency = _frequency(arguments, text) if index == "MTF" else None
    times = tuple(_time(part) for part in (arguments[:-1] if frequency else arguments))
    if len(times) != INDICES[index]:
        raise InputError(f"{index}(...) must have {counted(INDICES[index], 'time')}, got {len(times)} in {text!r}")
    probability, confidence = (
        _float(m[value]) / (100 if m[percent] else 1) for value, percent in (("p", "pp"), ("c", "cp"))
    )
    for what, value in (("probability", probability), ("confidence", confidence)):
        if not 0 < value < 1:
            raise InputError(f"{what} must be between 0 and 1 (or 0 and 100 %), got {value:g} in {text!r}")
    limit = _float(m["limit"]) * (ANGLES[m["unit"]] if m["unit"] else 1.0)
    if not 0 < limit < math.inf:
        raise InputError(f"limit must be positive, got {m['limit']} in {text!r}")
    if index in IMAGE_INDICES and not limit < IMAGE_INDICES[index].top:
        raise InputError(f"limit of {index} must be below {IMAGE_INDICES[index].top:g}, got {m['limit']} in {text!r}")
    return Requirement(
        index,
        m["axis"] or "",
        times,
        limit,
        m["unit"],
        probability,
        confidence,
        kind,
        name or index,
        tuple(loops),
        of_windows,
        frequency,
        " ".join(text.split()),
    )


EXAMPLE = "prob(|RPE(20 ms)| < 40 mas) >= 0.997 at 95 % confidence"


def _check_relation(m: re.Match[str], index: str, text: str) -> None:
    """Refuse a limit on the wrong side, of the wrong kind, and signs or axes of other indices."""
    image = IMAGE_INDICES.get(index, ImageIndex(angle=True))
    if image.lower != (m["relation"] == ">"):
        side, sign = ("a lower", ">") if image.lower else ("an upper", "<")
        raise InputError(f"{index} must have {side} limit ({sign}), got {m['relation']!r} in {text!r}")
    if index not in IMAGE_INDICES:
        return
    if m["sign"] or m["axis"]:
        raise InputError(f"{index} must be given without |...|, rms and axis, got {text!r}")
    if image.angle != bool(m["unit"]):
        want = f"in one of {', '.join(ANGLES)}" if image.angle else "without a unit"
        raise InputError(f"{index} must have a limit {want}, got {m['unit'] or 'none'} in {text!r}")


def _frequency(arguments: Sequence[str], text: str) -> SpatialFrequency:
    """Spatial frequency of the MTF: the last argument."""
    m = _FREQUENCY.fullmatch(arguments[-1]) if arguments else None
    value = math.nan if m is None else _float(m["value"]) if m["value"] else 1.0 if m["nyquist"] else math.nan
    if m is None or not 0 < value < math.inf:
        form = "MTF(20 ms, Nyquist), MTF(20 ms, 0.5 Nyquist) or MTF(20 ms, 8 cycles/arcsec)"
        raise InputError(f"MTF must have a spatial frequency, as in {form}, got {text!r}")
    if m["nyquist"]:
        return SpatialFrequency(value, NYQUIST)
    _member("unit of a spatial frequency", m["unit"], ANGLES)
    return SpatialFrequency(value, m["unit"])


def _member(what: str, value: str, known: Any) -> None:
    if value not in known:
        raise InputError(f"{what} must be one of {', '.join(known)}, got {value!r}")


def _time(text: str) -> float:
    m = re.fullmatch(r"\s*([\d.]+)\s*(us|ms|s|min)\s*", text)
    if m is None or not 0 < _float(m[1]) < 1e9:
        raise InputError(f"time must read like '20 ms', got {text.strip()!r}")
    return float(m[1]) * TIMES[m[2]]


def _exact_time(seconds: float) -> str:
    """Text of a time that `parse` reads as the same number of seconds."""
    for value, unit in ((f"{1e3 * seconds:g}", "ms"), (f"{seconds:g}", "s"), (repr(seconds), "s")):
        if "e" not in value and float(value) * TIMES[unit] == seconds and (seconds < 1 or unit == "s"):
            return f"{value} {unit}"
    return f"{seconds:.40f}".rstrip("0") + " s"


def _float(text: str) -> float:
    """A number, NaN where the text is none."""
    try:
        return float(text)
    except ValueError:
        return math.nan


def load(path: str | os.PathLike[str], stages: Sequence[str] = ()) -> tuple[Requirement, ...]:
    """Read a requirement file: TOML with ``[[requirement]]`` tables, or YAML with a list ``requirement``.

    Each entry has a ``text`` and may have a ``name`` and a ``loop`` (list of loop stages it applies to, which must be
    among `stages` where there are any).

    Raises
    ------
    InputError
        A file that cannot be read, or an entry of another form.
    """
    from pointing_analysis.files.structured_text import load_toml, load_yaml, read_text

    file = Path(path)
    read = load_yaml if file.suffix.lower() in (".yaml", ".yml") else load_toml
    content = read(read_text(file), file)
    rows = content.get("requirement") if isinstance(content, dict) else None
    if not isinstance(rows, list) or not rows:
        raise InputError(f"{file}: must hold a list 'requirement' whose entries have a 'text'")
    return from_entries(rows, str(file), stages)


def from_entries(rows: Sequence[Any], where: str, stages: Sequence[str] = ()) -> tuple[Requirement, ...]:
    """Requirements from the entries of a list: ``text``, and where given ``name`` and ``loop``.

    Parameters
    ----------
    rows : entries, as `entries` makes them or a file has them
    where : name of the list, for the messages
    stages : names that ``loop`` may have; any where there are none

    Raises
    ------
    InputError
        An entry of another form.
    """
    from pointing_analysis.files.settings import refuse_unknown  # slow to import

    made = []
    for i, entry in enumerate(rows):
        if not isinstance(entry, dict) or "text" not in entry:
            raise InputError(f"{where}: must hold a list 'requirement' whose entries have a 'text'")
        loops = entry.get("loop", ())
        loops = [loops] if isinstance(loops, str) else loops
        if not isinstance(loops, (list, tuple)) or not all(isinstance(loop, str) for loop in loops):
            raise InputError(f"{where}: loop must be a name or a list of names, got {loops!r}")
        try:
            refuse_unknown(entry, ("text", "name", "loop"))
            made.append(parse(str(entry["text"]), str(entry.get("name", "")), loops))
            for loop in loops if stages else ():
                _member("loop", loop, stages)
        except ValueError as error:
            raise InputError(f"{where}: requirement[{i}]: {error}") from None
    return tuple(made)


def entries(requirements: Sequence[Requirement]) -> list[dict[str, Any]]:
    """Entries of a list from which `from_entries` makes the same requirements, with bit-identical limits.

    Examples
    --------
    >>> limit = parse("prob(|APE| < 4.848e-6 rad) >= 0.997 at 95 % confidence", "APE", ["fsm"])
    >>> entries([limit])
    [{'name': 'APE', 'text': 'prob(|APE| < 4.848e-6 rad) >= 0.997 at 95 % confidence', 'loop': ['fsm']}]
    """
    return [
        {"name": r.name, "text": r.exact_text, **({"loop": list(r.loops)} if r.loops else {})} for r in requirements
    ]
