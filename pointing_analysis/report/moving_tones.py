"""Pictures of a run whose tones move: waterfall, Campbell diagram, relative error over time.

The bag of such a run has the motion (:mod:`pointing_analysis.indices.motion`).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure

from pointing_analysis.arrays import FloatArray
from pointing_analysis.indices import metrics
from pointing_analysis.indices.errors import RAD_PER_MAS
from pointing_analysis.indices.motion import Motion, motion_of
from pointing_analysis.report.figures import LIMIT, Picture, RunView, legend_above, picture, stroke, windows_text
from pointing_analysis.requirements.requirement import Requirement

SEGMENT = 1024
"""Samples of a spectrum of the waterfall."""

COLUMNS, DECADES = 300, 4.0
"""Largest number of spectra in a picture; range of its colours below the largest value, in decades."""

PIECES = 400
"""Stretches of time whose worst window is drawn."""

GUIDE = {"color": "#a8a8a8", "linewidth": 1.0, "linestyle": (0, (1, 4))}
"""Lines on a spectrum that leave the ridge below them visible; grey shows on the dark picture and on a white legend."""

MODES = "#ff9d5c"

HARMONICS = 6
"""Rays of a Campbell diagram: the lowest harmonics."""

RAYS_SHOWN, LOWEST_TOP = 2.2, 500.0
"""A Campbell diagram ends at so many times the largest speed, or at this frequency [rad/s]."""


def moving_pictures(views: Sequence[RunView], requirements: Sequence[Requirement]) -> list[Picture | str]:
    """Pictures of the runs in which something moves, or why there are none; empty where nothing does.

    Parameters
    ----------
    views : sequence of RunView
    requirements : sequence of Requirement
        Of all runs.
    """
    moving = [(view, motion) for view in views if (motion := motion_of(view.run)) is not None]
    made: list[Picture | str] = []
    if moving:
        made.append(error_over_time([view for view, _ in moving], requirements))
    for k, (view, motion) in enumerate(moving):
        if len(view.series.values) < 2 * SEGMENT or not np.isfinite(view.series.values).all():
            made.append(f"No waterfall for {view.label}: it needs {2 * SEGMENT} samples without a missing one.")
            continue
        made.append(waterfall(view, motion, k))
        if motion.turns:
            made.append(campbell(view, motion, k))
    return made


def _spectra(view: RunView) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Frequencies [rad/s], times [s] and amplitude densities [mas/sqrt(Hz)], shape (frequencies, times)."""
    from scipy import signal  # slow to import, and in most pages nothing moves

    n = len(view.series.values)
    step = max(SEGMENT // 4, -(-(n - SEGMENT) // COLUMNS))
    f, t, power = signal.spectrogram(
        view.series.values.T, 1.0 / view.series.dt, window="hann", nperseg=SEGMENT, noverlap=max(0, SEGMENT - step)
    )
    return 2.0 * np.pi * f[1:], view.series.start + t, np.sqrt(power.sum(axis=0)[1:]) / RAD_PER_MAS


def _image(figure: Figure, x: FloatArray, omega: FloatArray, values: FloatArray) -> Any:
    axis = figure.subplots()
    highest = float(values.max()) or 1.0
    scale = LogNorm(highest * 10.0**-DECADES, highest, clip=True)
    image = axis.pcolormesh(x, omega, values, shading="nearest", rasterized=True, cmap="viridis", norm=scale)
    figure.colorbar(image, label="line of sight [mas/√Hz]", location="bottom", aspect=40)
    axis.set_ylabel("frequency [rad/s]")
    axis.set_ylim(0.0, omega[-1])
    axis.grid(False)
    return axis


def waterfall(view: RunView, motion: Motion, k: int) -> Picture:
    """Spectrum of the line of sight over time."""
    omega, time, values = _spectra(view)

    def draw(figure: Figure) -> None:
        axis = _image(figure, time, omega, values)
        axis.set_xlabel("time [s]")
        if motion.turns:
            speed = np.abs(np.interp(time, motion.time, motion.speed[:, motion.wheel]))
            axis.plot(time, speed, **GUIDE, label=f"speed of wheel {motion.wheel + 1}")
            legend_above(figure, axis)

    title = f"Waterfall: {view.label}"
    alt = f"Spectrum of the line of sight over time, {view.label}; dotted: speed of wheel {motion.wheel + 1}."
    return picture(f"waterfall-{k + 1}", title, alt, 4.0, draw)


def campbell(view: RunView, motion: Motion, k: int) -> Picture:
    """Spectrum over the speed of the wheel that changes most, rays of its harmonics, modes of the structure.

    Modes are marked at the speeds that were recorded: a ramp may continue after the end of the record.
    """
    omega, time, values = _spectra(view)
    of_wheel = motion.speed[:, motion.wheel]
    speed = np.interp(time, motion.time, of_wheel)
    keep = np.concatenate([[True], np.diff(speed) != 0.0])
    order = np.argsort(speed[keep], kind="stable")
    x, shown = speed[keep][order], values[:, keep][:, order]
    x, first = np.unique(x, return_index=True)
    end = view.series.start + len(view.series.values) * view.series.dt
    during = np.clip(motion.time, view.series.start, end)
    recorded = np.interp(during, motion.time, of_wheel)
    low, high = float(recorded.min()), float(recorded.max())
    top = min(float(omega[-1]), max(RAYS_SHOWN * float(np.abs(motion.speed).max()), LOWEST_TOP))

    def draw(figure: Figure) -> None:
        axis = _image(figure, x, omega, shown[:, first])
        for i, harmonic in enumerate(np.sort(motion.harmonics)[:HARMONICS]):
            axis.plot(x, harmonic * np.abs(x), **GUIDE, label=None if i else "harmonics of the speed")
        marks = [(np.interp(at, motion.time, of_wheel), modes) for at, modes in motion.modes]
        for i, (where, modes) in enumerate((where, modes) for where, modes in marks if low <= where <= high):
            below = modes[modes < top]
            axis.plot(
                np.full(below.size, where),
                below,
                "_",
                color=MODES,
                markersize=4.0,
                mew=0.7,
                clip_on=False,
                label=None if i else "modes of the structure",
            )
        legend_above(figure, axis)
        axis.set_xlabel(f"speed of wheel {motion.wheel + 1} [rad/s]")
        axis.set_xlim(low, high)
        axis.set_ylim(0.0, top)

    alt = (
        f"Spectrum of the line of sight over the speed of wheel {motion.wheel + 1}, {view.label}; dotted: harmonics of "
        f"the speed; dashes: modes of the structure."
    )
    return picture(f"campbell-{k + 1}", f"Campbell diagram: {view.label}", alt, 4.0, draw)


def error_over_time(views: Sequence[RunView], requirements: Sequence[Requirement]) -> Picture:
    """Rms of the worst window of each stretch of time, against the limits on the rms in such windows."""
    relative = [r for r in requirements if r.index == "RPE" and r.of_windows and not r.axis]
    limits = sorted({(r.limit, r.probability) for r in relative if {r.times} == {(v.window,) for v in views}})

    def draw(figure: Figure) -> None:
        axis = figure.subplots()
        for i, view in enumerate(views):
            windows = metrics.windows(view.series.values, view.series.dt, view.window)
            error = metrics.radial(np.sqrt(windows.variance))
            size = max(1, len(error) // PIECES)
            count = len(error) // size
            worst = np.fmax.reduce(error[: count * size].reshape(count, size), axis=1)
            first = np.asarray(windows.start)[: count * size : size]
            time = view.series.start + view.series.dt * first + 0.5 * size * view.window
            shown = np.maximum(worst, 1e-6 * RAD_PER_MAS) / RAD_PER_MAS
            axis.semilogy(time, shown, label=view.label, **stroke(i, len(views)))
        for limit, probability in limits:
            text = f"limit {limit / RAD_PER_MAS:.6g} mas for {100 * probability:.6g} %"
            axis.axhline(limit / RAD_PER_MAS, color=LIMIT, linestyle="--", lw=0.9, label=text)
        axis.set_xlabel("time [s]")
        axis.set_ylabel("relative error [mas rms]")
        legend_above(figure, axis)

    window = windows_text(views)
    alt = f"Relative error over time, rms of the worst windows of {window}, one curve a run; dashed: limits."
    return picture("rpe-over-time", "Relative error over time", alt, 2.8, draw)
