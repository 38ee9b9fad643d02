"""Picture of goals: what each asks for and what a controller reaches, a panel each.

Frequencies that a goal does not look at are grey, what it does not allow is red. The number in the title is the
certified value, of which at most 1 is met.
"""

from __future__ import annotations

from collections.abc import Sequence

import control
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import ArrayLike
from scipy import linalg

from lftkit.analysis.batched_linalg import largest_gains
from lftkit.analysis.frequency_grid import frequency_grid, pole_range
from lftkit.arrays import ComplexArray, FloatArray
from lftkit.errors import InputError
from lftkit.systems.arguments import checked
from lftkit.systems.connection.feedback import close_loop
from lftkit.systems.sampled.image import rates
from lftkit.systems.system import System
from lftkit.tuning.certificate import certify
from lftkit.tuning.goals.goal import Goal, resolved
from lftkit.tuning.goals.reference_goals import StepTracking
from lftkit.tuning.requirements import ControllerPoles, H2Gain, HinfGain, Poles, SectorGain, TuningRequirement
from lftkit.tuning.requirements.assembled_loop import delayed_controller

RESULT, LIMIT, REFUSED, IDLE = "#0b5d8a", "#b3261e", "#f6d5d2", "#e6e6e6"


@checked
def plot_goals(
    models: System | Sequence[System],
    goals: Sequence[TuningRequirement | Goal],
    controller: System,
    *,
    loop_delay: float = 0.0,
    omega: ArrayLike | None = None,
) -> Figure:
    """Limit and result of each goal.

    Parameters
    ----------
    models : System or sequence of System
        Continuous, or discrete with one period; a line of the result for each.
    goals : sequence
        Requirements and goals of :mod:`lftkit.tuning`, as they were tuned.
    controller : System
        For instance that of a result.
    loop_delay : float
        Delay of the loop [s], approximated as in :func:`lftkit.tuning.certify`.
    omega : array_like, shape (k,), optional
        Frequencies [rad/s]; by default a grid that resolves the resonances of all loops.

    Returns
    -------
    matplotlib.figure.Figure
        Gains over frequency (largest singular value) with the limit that bound and weights make; where a weight differs
        between signals the weighted gain. Indices of sectors with the limit 1. Variances as root mean squares of each
        model. Poles with the edges of their region, in discrete time those of ``log(z) / T``. Step responses beside
        that of the reference model.

    Raises
    ------
    ValueError
        A loop that is not stable, no goal at all.

    Examples
    --------
    >>> from lftkit.tuning import Sensitivity
    >>> lag = System([[-1.0]], [[1.0]], [[1.0]], [[0.0]], [("u", 1)], [("y", 1)])
    >>> K = System.static([[-3.0]], [("y", 1)], [("u", 1)])
    >>> figure = plot_goals(lag, [Sensitivity("u", bound=2.0)], K)
    >>> figure.axes[0].get_title()
    'Sensitivity u: 0.5'
    """
    all_models = [models] if isinstance(models, System) else list(models)
    if not goals:
        raise InputError("expected at least one goal, got none")
    ready, needs = resolved(all_models, goals)
    K = delayed_controller(controller, loop_delay)
    certificate = certify(ready, controller, needs, loop_delay)
    if not certificate.stable:
        raise InputError(f"{controller.name}: controller must make every loop stable, got an unstable one")
    panels = [(goal, r) for goal in goals for r in resolved(all_models, [goal])[1]]
    columns = min(len(panels), 3)
    rows = -(-len(panels) // 3)
    figure = Figure(figsize=(4.2 * columns, 3.2 * rows), layout="constrained")
    for number, (goal, r) in enumerate(panels):
        axes = figure.add_subplot(rows, columns, number + 1)
        values = certificate.values[number]
        if isinstance(r, Poles):
            _poles(axes, r, ready, K)
        elif isinstance(goal, StepTracking):
            _steps(axes, goal, ready, K)
        elif isinstance(r, HinfGain):
            _gains(axes, r, ready, K, omega, float(values.max()))
        elif isinstance(r, H2Gain):
            rms = r.bound * values
            axes.bar(np.arange(len(rms)), rms, color=RESULT, width=0.6, zorder=2)
            axes.axhline(r.bound, color=LIMIT, linestyle="--", linewidth=1.2)
            top = 1.2 * max(float(rms.max()), r.bound)
            axes.axhspan(r.bound, top, color=REFUSED, zorder=0, linewidth=0)
            axes.set(ylim=(0.0, top), xlabel="model", ylabel="root mean square", xticks=np.arange(len(rms)))
        axes.set_title(f"{r.name}{' (hard)' if r.hard else ''}: {values.max():.3g}", fontsize=9)
        axes.grid(True, color="#dddddd", linewidth=0.6)
    return figure


def _gains(axes: Axes, r: HinfGain, models: Sequence[System], K: System, omega: ArrayLike | None, value: float) -> None:
    loops = [close_loop(model, K, r.inputs, r.outputs) for model in models]
    if omega is not None:
        w = np.asarray(omega, dtype=float)
        results, limit, label = _curves(r, loops, w)
    else:
        w = _frequencies(loops, r)
        results, limit, label = _curves(r, loops, w)
        if (results / limit)[:, r.counts(w)].max(initial=0.0) < 0.98 * value:  # it is where a weight is, not the loop
            w = _frequencies([*loops, *(x for x in (r.weight_in, r.weight_out) if x is not None)], r, np.inf)
            results, limit, label = _curves(r, loops, w)
    axes.plot(w, results.T, color=RESULT, linewidth=1.2)
    axes.plot(w, limit, color=LIMIT, linestyle="--", linewidth=1.2)
    axes.set(xscale="log", yscale="log", xlabel="frequency [rad/s]", ylabel=label, xlim=(w[0], w[-1]))
    # Red above the limit, grey where it does not count
    counts = r.counts(w)
    low, high = axes.get_ylim()
    high = max(high, 3.0 * float(limit.min()))
    axes.fill_between(w, limit, np.maximum(limit, high), where=counts, color=REFUSED, linewidth=0, zorder=0)
    if not counts.all():
        axes.fill_between(w, low, high, where=~counts, color=IDLE, linewidth=0, zorder=0)
    axes.set_ylim(low, high)


def _curves(r: HinfGain, loops: Sequence[System], w: FloatArray) -> tuple[FloatArray, FloatArray, str]:
    """Gains (loops, N), their limit (N,), and what they are."""
    weighted = r.sampled(loops[0].dt)
    into, out = (None if x is None else x.response(w) for x in (weighted.weight_in, weighted.weight_out))
    responses = [loop.response(w) for loop in loops]
    if not isinstance(r, SectorGain) and _scalar(into) and _scalar(out):
        sizes = [np.abs(x[:, 0, 0]) for x in (into, out) if x is not None]
        limit = r.bound / np.maximum(np.prod([np.ones(len(w)), *sizes], axis=0), 1e-300)
        return np.array([largest_gains(T) for T in responses]), limit, "gain"
    responses = [T if into is None else T @ into for T in responses]
    responses = [T if out is None else out @ T for T in responses]
    if isinstance(r, SectorGain):
        indices = np.array([largest_gains(r.indexed(T / r.bound, w)) for T in responses])
        return indices, np.ones(len(w)), "index of the sector"
    return np.array([largest_gains(T) for T in responses]), np.full(len(w), r.bound), "weighted gain"


def _poles(axes: Axes, r: Poles, models: Sequence[System], K: System) -> None:
    dt = models[0].dt
    matrices = [K.A] if isinstance(r, ControllerPoles) else [close_loop(m, K, (), ()).A for m in models]
    poles: ComplexArray = np.concatenate([linalg.eigvals(A) for A in matrices])
    if dt:
        poles = rates(poles, dt)
    size = np.abs(poles[np.abs(poles) > 0.0])
    reach = 10.0 * max(
        float(size.max(initial=1.0)), r.min_decay, r.max_frequency if np.isfinite(r.max_frequency) else 0
    )
    least = 0.3 * min([float(size.min(initial=1.0)), *([r.min_decay] if r.min_decay else [])])
    axes.set_xscale("symlog", linthresh=least)
    axes.set_yscale("symlog", linthresh=least)
    right = max(least, float(poles.real.max(initial=0.0)) * 2.0)
    edges: list[tuple[FloatArray, FloatArray]] = [(np.zeros(2), np.array([-reach, reach]))]
    radii: FloatArray = np.asarray(np.geomspace(1e-3 * least, reach, 200))
    if r.min_decay:
        edges.append((np.full(2, -r.min_decay), np.array([-reach, reach])))
    if r.min_damping:
        across = float(np.sqrt(1.0 - r.min_damping**2))
        edges += [(-r.min_damping * radii, sign * across * radii) for sign in (1.0, -1.0)]
    if np.isfinite(r.max_frequency):
        turn = np.linspace(0.5 * np.pi, 1.5 * np.pi, 200)
        edges.append((r.max_frequency * np.cos(turn), r.max_frequency * np.sin(turn)))
    axes.plot(*edges[0], color="#777777", linewidth=0.8)
    for real, imaginary in edges[1:]:
        axes.plot(real, imaginary, color=LIMIT, linestyle="--", linewidth=1.2)
    axes.axvspan(-r.min_decay, right, color=REFUSED, zorder=0, linewidth=0)
    axes.scatter(poles.real, poles.imag, marker="x", color=RESULT, s=24, zorder=3)
    axes.set(xlim=(-reach, right), ylim=(-reach, reach), xlabel="real part [rad/s]", ylabel="imaginary part [rad/s]")


def _steps(axes: Axes, goal: StepTracking, models: Sequence[System], K: System) -> None:
    dt, end = models[0].dt, 8.0 * goal.time_constant
    period = dt or end / 400
    time, drawn = period * np.arange(int(end / period) + 1), "steps-post" if dt else "default"
    for model in models:
        loop = close_loop(model, K, (goal.reference,), (goal.output,))
        # outputs by inputs by time: of each reference its own output
        values = control.step_response(loop.to_control(), time, squeeze=False).outputs
        axes.plot(time, np.einsum("iit->ti", values), color=RESULT, linewidth=1.2, drawstyle=drawn)
    axes.plot(time, 1.0 - np.exp(-time / goal.time_constant), color=LIMIT, linestyle="--", linewidth=1.2)
    axes.set(xlabel="time [s]", ylabel=f"{goal.output} after a step", xlim=(0.0, time[-1]))


def _frequencies(systems: Sequence[System], r: HinfGain, decades: float = 6.0) -> FloatArray:
    """Grid about the poles of systems, the first one of the loops, and the edges of the band."""
    dt = systems[0].dt
    of_systems = [rates(x.poles(), x.dt) if x.dt else x.poles() for x in systems]
    poles: ComplexArray = np.concatenate([np.zeros(0, dtype=complex), *of_systems])
    least, most = pole_range(poles)
    edges = [1.0, *(w for w in r.band if 0.0 < w < np.inf)]
    low, high = min(least, *edges) / 10.0, max(most, *edges) * 10.0
    low = max(low, high / 10.0**decades)
    if dt:
        high = np.pi / dt
        low = min(low, 1e-3 * high)
    return frequency_grid(poles, low, high, points=300)


def _scalar(response: ComplexArray | None) -> bool:
    """Whether a weight is a multiple of the identity at all frequencies."""
    if response is None:
        return True
    if response.shape[1] != response.shape[2]:
        return False
    rest = response - response[:, :1, :1] * np.eye(response.shape[1])
    return bool(np.abs(rest).max() <= 1e-9 * np.abs(response).max())
