"""Directions, gains, delays and noise of a rig from small test motions, against the model: faults in words.

At the lines of :mod:`los_testbed.rig.motions` the model has the response of each sensor to each actuator. A sensor with
exchanged, negative, smaller, later or no values is at fault; an actuator is if all its sensors have the same deviation.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lftkit.arrays import ComplexArray, FloatArray, IntArray
from lftkit.support.counted_nouns import counted
from los_testbed.rig.motions import (
    FREQUENCIES,
    QUIET_S,
    RAMP_S,
    ModelResponse,
    MotionRecord,
    amplitudes,
    held,
    lines_of,
    scatter,
)
from titop_plant.interface import COLUMNS, COMMANDED, MEASURED

GAIN_TOLERANCE, DELAY_TOLERANCE_S, NOISE_FACTOR = 0.2, 5e-3, 3.0
DEAD_GAIN, CLEAR_SHARE, UNEXPLAINED = 0.05, 0.2, 0.3
NUMBER = re.compile(r"\d+(?:\.\d+)?(?:e[-+]\d+)?%?")
DELAYS = tuple(5e-3 * k for k in range(-2, 17))
NEAR = tuple(5e-4 * k for k in range(-10, 11))
"""Delays [s] that are tried, and then near the best of them: the highest line has a period of 61 ms."""


@dataclass(frozen=True)
class DeviceCheckRow:
    """One value of a sensor, or of a command.

    Attributes
    ----------
    part, value : port and number of the value in it
    gain : of the model's amplitude; nan: not known, as of a value that fits no motion
    delay_ms : behind the model, by the times of acquisition; nan: not known
    noise, expected_noise : of a sample [SI]; nan for a command
    age_ms : median, when it was read; nan for a command
    fault : description; empty: none
    """

    part: str
    value: int
    gain: float
    delay_ms: float
    noise: float
    expected_noise: float
    age_ms: float
    fault: str


@dataclass(frozen=True)
class _Match:
    """Best match of some amplitudes: index of the model, its gain, unexplained share."""

    index: int
    gain: float
    rest: float


@dataclass(frozen=True)
class _Seen:
    """A sensor: amplitudes, disturbance before the motion, the model and the lines of the actuators that move it."""

    port: str
    moved: ComplexArray
    still: ComplexArray
    gains: ComplexArray
    driver: str
    actuators: IntArray

    @property
    def known(self) -> bool:
        return bool(np.isfinite(self.moved).all() and np.isfinite(self.still).all())

    def lines(self) -> IntArray:
        return np.sort(np.concatenate([lines_of(int(a)) for a in self.actuators]))

    def late(self, delay: float) -> ComplexArray:
        """The amplitudes without a delay [s]."""
        return np.asarray(self.moved * np.exp(2j * np.pi * FREQUENCIES * delay))


def judge(record: MotionRecord, model: ModelResponse) -> tuple[DeviceCheckRow, ...]:
    """Rows of all values of sensors, then of commands."""
    commanded = amplitudes(*held(record.commands, RAMP_S), RAMP_S)
    sensors = [_seen(port, record, model, commanded) for port in MEASURED]
    rows: list[DeviceCheckRow] = []
    for driver in COMMANDED:
        of_driver = [sensor for sensor in sensors if sensor.driver == driver]
        clear = [sensor for sensor in of_driver if sensor.known and not _quiet(sensor, commanded)]
        delays = {sensor.port: _delay(sensor, commanded) for sensor in clear}
        common = min(delays.values(), default=0.0)
        common = common if common > DELAY_TOLERANCE_S else 0.0
        actuators = _actuators(driver, of_driver, clear, delays, commanded)
        corrected = _corrected(actuators, commanded, driver)
        rows += _command_rows(driver, actuators, max(0.0, common), [s.port for s in of_driver])
        for sensor in of_driver:
            rows += _sensor_rows(sensor, corrected, delays.get(sensor.port, 0.0), common, record, model)
    order = {part: k for k, part in enumerate((*MEASURED, *COMMANDED))}
    return tuple(sorted(rows, key=lambda row: (order[row.part], row.value)))


def faults(rows: Sequence[DeviceCheckRow]) -> tuple[str, ...]:
    """One line for each fault of each part."""
    by_fault: dict[tuple[str, str], list[DeviceCheckRow]] = {}
    for row in rows:
        if row.fault:
            by_fault.setdefault((row.part, NUMBER.sub("{}", row.fault)), []).append(row)
    sizes = {part: COLUMNS[part].stop - COLUMNS[part].start for part in (*MEASURED, *COMMANDED)}
    lines = []
    for (part, text), faulty in by_fault.items():
        columns = zip(*(NUMBER.findall(row.fault) for row in faulty))
        numbers = [", ".join(column if len(set(column)) > 1 else column[:1]) for column in columns]
        which = "" if len(faulty) == sizes[part] else f"[{', '.join(str(row.value) for row in faulty)}]"
        lines.append(f"{part}{which}: {text.format(*numbers)}")
    return tuple(lines)


def _seen(port: str, record: MotionRecord, model: ModelResponse, commanded: ComplexArray) -> _Seen:
    times, values, _ = record.samples[port]
    gains = model.gains[COLUMNS[port]]
    parts = [np.einsum("jbl,bl->jl", gains[:, COLUMNS[name]], commanded[COLUMNS[name]]) for name in COMMANDED]
    driver = COMMANDED[int(np.argmax([float(np.abs(part).max()) for part in parts]))]
    actuators = np.arange(COLUMNS[driver].start, COLUMNS[driver].stop)
    moved = amplitudes(times, values, RAMP_S)
    return _Seen(port, moved, amplitudes(times, values, -QUIET_S), gains, driver, actuators)


def _expected(sensor: _Seen, commanded: ComplexArray) -> ComplexArray:
    """Amplitudes (n, 24) by the model."""
    return np.asarray(np.einsum("jbl,bl->jl", sensor.gains, commanded))


def _quiet(sensor: _Seen, commanded: ComplexArray) -> bool:
    """Whether its response is not above that without motion."""
    lines = sensor.lines()
    level = np.maximum(DEAD_GAIN * _rms(_expected(sensor, commanded)[:, lines]), 2 * _rms(sensor.still[:, lines]))
    return bool(np.all(_rms(sensor.moved[:, lines]) < level))


def _clear(sensor: _Seen, commanded: ComplexArray) -> bool:
    """Whether most of its values should see the motion above what there is without."""
    lines = sensor.lines()
    expected = _rms(_expected(sensor, commanded)[:, lines])
    return bool(np.median(_rms(sensor.still[:, lines]) / np.maximum(expected, 1e-300)) < CLEAR_SHARE)


def _rms(values: ComplexArray) -> FloatArray:
    """Over the last axis."""
    return np.asarray(np.sqrt(np.mean(np.abs(values) ** 2, axis=-1)))


def _match(seen: ComplexArray, models: Sequence[ComplexArray], expected: int) -> _Match:
    """The model with the smallest residual; its own one, if that has a small residual."""
    power = float(np.sum(np.abs(seen) ** 2))
    matches: list[_Match] = []
    for model in models:
        size = float(np.sum(np.abs(model) ** 2))
        gain = float(np.sum((model.conj() * seen).real)) / size if size else 0.0
        rest = float(np.sum(np.abs(seen - gain * model) ** 2)) / power if power else 1.0
        matches.append(_Match(len(matches), gain, rest))
    best = min(matches, key=lambda match: match.rest)
    return matches[expected] if matches[expected].rest < max(UNEXPLAINED**2, 2 * best.rest) else best


def _by_values(sensor: _Seen, delay: float, commanded: ComplexArray) -> list[_Match]:
    lines = sensor.lines()
    expected = _expected(sensor, commanded)[:, lines]
    seen = sensor.late(delay)[:, lines]
    return [_match(seen[j], list(expected), j) for j in range(len(seen))]


def _by_actuators(sensor: _Seen, delay: float, commanded: ComplexArray) -> list[_Match]:
    """For each actuator the one to which the sensor responds at its lines; values are scaled by the model."""
    weight = 1.0 / np.maximum(_rms(_expected(sensor, commanded)[:, sensor.lines()]), 1e-300)[:, None]
    seen = sensor.late(delay)
    matches = []
    for index, a in enumerate(sensor.actuators):
        lines = lines_of(int(a))
        models = [weight * sensor.gains[:, b][:, lines] * commanded[a, lines] for b in sensor.actuators]
        matches.append(_match(weight * seen[:, lines], models, index))
    return matches


def _delay(sensor: _Seen, commanded: ComplexArray) -> float:
    """Delay [s] with the smallest residual of the values, or of the actuators."""

    def left(delay: float) -> float:
        both = (_by_values(sensor, delay, commanded), _by_actuators(sensor, delay, commanded))
        return min(float(np.mean([match.rest for match in matches])) for matches in both)

    coarse = min(DELAYS, key=left)
    return min((coarse + step for step in NEAR), key=left)


def _actuators(
    driver: str, sensors: Sequence[_Seen], clear: Sequence[_Seen], delays: dict[str, float], commanded: ComplexArray
) -> list[_Match]:
    """Motion of each actuator of a port: its own, unless all sensors agree on another one; NaN where none shows it."""
    size = COLUMNS[driver].stop - COLUMNS[driver].start
    if not clear:
        still = sum(sensor.known and _clear(sensor, commanded) for sensor in sensors)  # these should see a motion
        dead = bool(sensors) and still >= min(2, len(sensors))
        return [_Match(k, 0.0 if dead else np.nan, 0.0) for k in range(size)]
    matched = [_by_actuators(sensor, delays[sensor.port], commanded) for sensor in clear]
    actuators = []
    for k in range(size):
        matches = [sensor[k] for sensor in matched]
        gains = np.array([match.gain for match in matches])
        middle = float(np.median(gains))
        dead = bool(np.all(np.abs(gains) < DEAD_GAIN))
        agreed = len({match.index for match in matches}) == 1 and max(match.rest for match in matches) < UNEXPLAINED
        agreed = agreed and bool(np.all(np.abs(gains - middle) < GAIN_TOLERANCE * abs(middle)))
        wrong = matches[0].index != k or abs(middle - 1.0) > GAIN_TOLERANCE
        if dead:
            actuators.append(_Match(k, 0.0, 0.0))
        else:
            actuators.append(_Match(matches[0].index, middle, 0.0) if agreed and wrong else _Match(k, 1.0, 0.0))
    return actuators


def _corrected(actuators: Sequence[_Match], commanded: ComplexArray, driver: str) -> ComplexArray:
    """Motion of the actuators of a port for the commands (8, 24); zero where none moves."""
    if not any(match.gain for match in actuators):
        return np.zeros_like(commanded)
    first = COLUMNS[driver].start
    done = commanded.copy()
    done[COLUMNS[driver]] = 0.0
    for k, match in enumerate(actuators):
        done[first + match.index] += (1.0 if np.isnan(match.gain) else match.gain) * commanded[first + k]
    return done


def _command_rows(
    driver: str, actuators: Sequence[_Match], delay: float, seen_by: Sequence[str]
) -> list[DeviceCheckRow]:
    rows = []
    for k, match in enumerate(actuators):
        fault = _words(match, k, "moves")
        if not seen_by:
            fault = "no sensor responds"
        elif np.isnan(match.gain):
            fault = "not judged: no sensor responds above its noise"
        elif not fault and delay > DELAY_TOLERANCE_S:
            fault = f"{1e3 * delay:.0f} ms late, by all sensors"
        rows.append(DeviceCheckRow(driver, k, match.gain, 1e3 * delay, np.nan, np.nan, np.nan, fault))
    return rows


def _words(match: _Match, expected: int, verb: str) -> str:
    """Fault of a gain; empty without one."""
    if abs(match.gain) < DEAD_GAIN:
        return f"dead: {verb} nothing"
    sign = "wrong sign" if match.gain < 0 else ""
    size = f"gain {abs(match.gain):.2f}" if abs(abs(match.gain) - 1.0) > GAIN_TOLERANCE else ""
    swapped = f"swapped: {verb} like value {match.index}" if match.index != expected else ""
    return ", ".join(part for part in (swapped, sign, size) if part)


def _sensor_rows(
    sensor: _Seen, commanded: ComplexArray, delay: float, common: float, record: MotionRecord, model: ModelResponse
) -> list[DeviceCheckRow]:
    times, values, ages = record.samples[sensor.port]
    columns = COLUMNS[sensor.port]
    quiet = values[times < 0.0]
    noise = scatter(quiet) if len(quiet) else np.full(columns.stop - columns.start, np.nan)
    lines = sensor.lines()
    expected = _rms(_expected(sensor, commanded)[:, lines])
    matches = _by_values(sensor, delay, commanded) if sensor.known else []
    beyond, rows = record.beyond_range[sensor.port], []
    for j in range(columns.stop - columns.start):
        low, high = model.noise[columns][j], model.disturbed[columns][j]
        gain = behind = np.nan
        if beyond > len(times):
            fault = (
                f"beyond range: {beyond} of {counted(beyond + len(times), 'sample')}, which are not used (other unit?)"
            )
        elif not matches:
            odd = record.not_finite[sensor.port]
            fault = f"too few samples: {len(times)}" + (f", {odd} not finite" if odd else "")
        elif expected[j] == 0.0:
            fault = _noise_fault(noise[j], low, high)
        else:
            fault, loud = _unknown(sensor, j, matches[j], expected[j]), _noise_fault(noise[j], low, high)
            if fault:
                fault = "; ".join(filter(None, (loud, fault)))
            else:
                gain, behind = matches[j].gain, 1e3 * (delay - common)
                fault = _fault(sensor, j, matches[j], expected[j], delay - common) or loud
        age = 1e3 * float(np.median(ages)) if len(ages) else np.nan
        rows.append(DeviceCheckRow(sensor.port, j, gain, behind, noise[j], low, age, fault))
    return rows


def _unknown(sensor: _Seen, j: int, match: _Match, expected: float) -> str:
    """Why gain and delay of a value cannot be estimated; empty: they can."""
    still = float(_rms(sensor.still[j, sensor.lines()]))
    if still > CLEAR_SHARE * expected:
        return f"not judged: without motion {still / expected:.0%} of the response to the motion"
    if match.rest > UNEXPLAINED and not _dead(sensor, j, expected):
        return f"matches no actuator: {match.rest:.0%} of its power unexplained"
    return ""


def _dead(sensor: _Seen, j: int, expected: float) -> bool:
    """Whether a value does not respond to the motion."""
    return float(_rms(sensor.moved[j, sensor.lines()])) < DEAD_GAIN * expected


def _fault(sensor: _Seen, j: int, match: _Match, expected: float, delay: float) -> str:
    if _dead(sensor, j, expected):
        return "dead: no response"
    fault = _words(match, j, "sees")
    if not fault and abs(delay) > DELAY_TOLERANCE_S:
        fault = f"values {abs(1e3 * delay):.0f} ms {'older' if delay > 0 else 'newer'} than their stamps"
    return fault


def _noise_fault(noise: float, low: float, high: float) -> str:
    if not np.isfinite(noise) or low == 0.0:
        return ""
    if noise > NOISE_FACTOR * max(low, high):
        return f"noise {noise:.2g}, {noise / low:.1f} times the model's"
    return f"noise {noise:.2g}, {noise / low:.2f} times the model's" if noise < low / NOISE_FACTOR else ""
