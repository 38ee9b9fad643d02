"""Pictures of uncertain systems: band of the frequency response, singular values, poles.

Each function returns a `matplotlib.figure.Figure`; nothing is shown or written. A band is the envelope of the members
that were evaluated, not a bound over the box: for that see `lftkit.proofs`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import ArrayLike
from scipy import linalg

from lftkit.analysis.batched_linalg import largest_gains
from lftkit.analysis.frequency_grid import frequency_grid, pole_range
from lftkit.analysis.frequency_response import frequency_response
from lftkit.arrays import FloatArray
from lftkit.errors import InputError
from lftkit.systems.arguments import checked
from lftkit.systems.exchange import as_system
from lftkit.systems.ports import Port, port_slices
from lftkit.systems.system import System

Samples = int | Sequence[Mapping[str, float]]
Channel = str | tuple[str, int]

LINE, BAND, MEMBERS = "#0b5d8a", "#8fb9d3", "#d95f02"


@checked
def bode_band(
    system: Any,
    samples: Samples = 20,
    *,
    output: Channel,
    input: Channel,
    omega: ArrayLike | None = None,
    seed: int = 0,
) -> Figure:
    """Magnitude and phase of one channel: the nominal system as a line, its members as a band.

    Parameters
    ----------
    system : System, or what :func:`lftkit.as_system` takes
    samples : int or sequence of mappings
        Number of random members, uniform in the box, or parameter values of the members.
    output, input : str or (str, int)
        Port, and the index in it (default 0).
    omega : array_like, shape (k,), optional
        Frequencies [rad/s]; by default a grid that resolves the resonances of all members.
    seed : int
        Of the random members.

    Returns
    -------
    matplotlib.figure.Figure
        Magnitude [unit of the output / unit of the input] above, phase [deg] below; the phase of each member is
        unwrapped from the lowest frequency, where it is within half a turn of the nominal one.

    Raises
    ------
    ValueError
        Unknown port, index outside the port, value outside its range.

    Examples
    --------
    A spring of 1 to 3 N/m: the static gain 1/k is between 1/3 and 1 m/N.

    >>> from lftkit import RealParameter
    >>> k = RealParameter("k", 2.0, 1.0, 3.0)
    >>> A, B, C, D = [[0, 1], [-2, -0.1]], [[0, 0], [1, 1]], [[-1, 0], [1, 0]], [[0, 0], [0, 0]]
    >>> ports = (Port("force", 1, "N"),), (Port("x", 1, "m"),)
    >>> mass = System(A, B, C, D, *ports, channels=("k",), elements=(k,))
    >>> ends = [{"k": 1.0}, {"k": 3.0}]
    >>> top = bode_band(mass, ends, output="x", input="force", omega=[0.001, 0.002]).axes[0]
    >>> top.collections[0].get_datalim(top.transData).ymin.round(4).item(), top.get_ylabel()
    (0.3333, 'x / force [m/N]')
    """
    system = as_system(system)
    row, label_out, unit_out = _signal(system.outputs, output, "output")
    column, label_in, unit_in = _signal(system.inputs, input, "input")
    models = _members(system, samples, seed)
    w = _frequencies(models, omega)
    ports = (Port("u", 1),), (Port("y", 1),)
    parts = [(m.A, m.B[:, [column]], m.C[[row]], m.D[[row]][:, [column]]) for m in models]
    one = [frequency_response(System(*matrices, *ports), w) for matrices in parts]
    response = np.array(one)[:, :, 0, 0]
    figure = Figure(figsize=(7.0, 5.0), layout="constrained")
    upper, lower = figure.subplots(2, 1, sharex=True)
    phase = np.rad2deg(np.unwrap(np.angle(response), axis=1))
    phase -= 360.0 * np.round((phase[:, :1] - phase[0, 0]) / 360.0)
    for axes, values in ((upper, np.abs(response)), (lower, phase)):
        if len(models) > 1:
            axes.fill_between(
                w,
                values.min(axis=0),
                values.max(axis=0),
                color=BAND,
                alpha=0.6,
                linewidth=0,
                label=f"{len(models) - 1} members",
            )
        axes.plot(w, values[0], color=LINE, linewidth=1.4, label="nominal")
        axes.grid(True, which="major", color="#dddddd", linewidth=0.6)
    upper.set(yscale="log", ylabel=f"{label_out} / {label_in} [{unit_out}/{unit_in}]")
    lower.set(xscale="log", xlabel="frequency [rad/s]", ylabel="phase [deg]")
    upper.legend(frameon=False)
    return figure


@checked
def sigma_plot(system: Any, samples: Samples = 0, *, omega: ArrayLike | None = None, seed: int = 0) -> Figure:
    """Singular values over frequency: all of the nominal system, and the band of the largest of its members.

    Parameters are those of :func:`bode_band`. Ports are not scaled: select those of one kind first.

    Examples
    --------
    The largest singular value of two decoupled gains is the larger one:

    >>> gains = System.static(np.diag([3.0, 1.0]), [("u", 2)], [("y", 2)])
    >>> [float(line.get_ydata()[0]) for line in sigma_plot(gains, omega=[1.0, 2.0]).axes[0].lines]
    [3.0, 1.0]
    """
    models = _members(system, samples, seed)
    w = _frequencies(models, omega)
    figure = Figure(figsize=(7.0, 3.6), layout="constrained")
    axes = figure.subplots()
    for i, values in enumerate(np.array([linalg.svdvals(g) for g in frequency_response(models[0], w)]).T):
        axes.plot(w, values, color=LINE, linewidth=1.4 if i == 0 else 0.8, label="nominal" if i == 0 else None)
    if len(models) > 1:
        gains = np.array([largest_gains(frequency_response(m, w)) for m in models])
        axes.fill_between(
            w,
            gains.min(axis=0),
            gains.max(axis=0),
            color=BAND,
            alpha=0.6,
            linewidth=0,
            label=f"largest, {len(models) - 1} members",
        )
    axes.set(xscale="log", yscale="log", xlabel="frequency [rad/s]", ylabel="singular values")
    axes.grid(True, color="#dddddd", linewidth=0.6)
    axes.legend(frameon=False)
    return figure


@checked
def pole_map(system: Any, samples: Samples = 0, *, seed: int = 0) -> Figure:
    """Poles in the complex plane [rad/s]: the nominal ones as crosses, those of the members as dots.

    Parameters are those of :func:`bode_band`. The imaginary axis is drawn; poles to its right are unstable. Both axes
    are logarithmic about zero, so that light damping is visible beside fast poles.

    Examples
    --------
    >>> lag = System([[-2.0]], [[1.0]], [[1.0]], [[0.0]], [("u", 1)], [("y", 1)])
    >>> pole_map(lag).axes[0].collections[0].get_offsets().tolist()
    [[-2.0, 0.0]]
    """
    models = _members(system, samples, seed)
    poles = [linalg.eigvals(m.A) for m in models]
    figure = Figure(figsize=(6.0, 5.0), layout="constrained")
    axes = figure.subplots()
    axes.scatter(poles[0].real, poles[0].imag, marker="x", color=LINE, s=32, zorder=3, label="nominal")
    if len(poles) > 1:
        others = np.concatenate(poles[1:])
        axes.scatter(others.real, others.imag, color=MEMBERS, s=4, label=f"{len(poles) - 1} members")
    size: FloatArray = np.abs(np.concatenate([np.zeros(0, dtype=complex), *(p[np.abs(p) > 0] for p in poles)]))
    damping = np.abs(np.concatenate([p.real for p in poles]))
    damping = damping[damping > 1e-9 * max(size.max(initial=0.0), 1e-300)]
    axes.set_xscale("symlog", linthresh=float(damping.min(initial=1.0)))
    axes.set_yscale("symlog", linthresh=float(size.min(initial=1.0)))
    axes.axvline(0.0, color="#777777", linewidth=0.8)
    axes.grid(True, color="#dddddd", linewidth=0.6)
    axes.set(xlabel="real part [rad/s]", ylabel="imaginary part [rad/s]")
    axes.legend(frameon=False)
    return figure


def _members(model: Any, samples: Samples, seed: int) -> list[System]:
    """The nominal system first, then its members."""
    system = as_system(model)
    system.require_continuous()
    if system.certain:
        if samples != 0:
            raise InputError(f"samples must be 0 for a system without uncertain elements, got {samples!r}")
        return [system]
    if isinstance(samples, int) and samples < 0:
        raise InputError(f"samples must be 0 or more, got {samples}")
    values = system.sample_values(np.random.default_rng(seed), samples) if isinstance(samples, int) else samples
    return [system.at({}), *(system.at(v) for v in values)]


def _frequencies(models: Sequence[System], omega: ArrayLike | None) -> FloatArray:
    if omega is not None:
        return np.asarray(omega, dtype=float)
    poles = np.concatenate([np.zeros(0, dtype=complex), *(linalg.eigvals(m.A) for m in models)])
    low, high = pole_range(poles)
    return frequency_grid(poles, min(low, 1.0) / 3.0, max(high, 1.0) * 3.0, points=300)


def _signal(ports: Sequence[Port], channel: Channel, kind: str) -> tuple[int, str, str]:
    """Row or column of a signal among all of its side, its label and its unit."""
    name, index = (channel, 0) if isinstance(channel, str) else channel
    slices = port_slices(ports)
    if name not in slices:
        raise InputError(f"{kind} port must be one of {', '.join(slices)}, got {name!r}")
    port = next(p for p in ports if p.name == name)
    if not 0 <= index < port.size:
        raise InputError(f"index of {kind} port {name} must be from 0 to {port.size - 1}, got {index}")
    return slices[name].start + index, name if port.size == 1 else f"{name}[{index}]", port.unit
