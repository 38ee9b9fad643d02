"""The block Delta at values of the elements: as numbers at one frequency, and as a system."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from scipy import linalg

from lftkit.arrays import ComplexArray, IntArray, Matrices
from lftkit.errors import InputError
from lftkit.systems import lft
from lftkit.systems.ports import total_size
from lftkit.uncertainty.elements import ComplexParameter, DynamicElement, Element, RealParameter, checked_values, width

Value = Any
"""A number of a real or complex element; a number, matrix or system of dynamics."""


def chosen_values(elements: Sequence[Element], values: Mapping[str, Value], *, beyond_range: bool) -> dict[str, Value]:
    """Value of every element, checked: the given one, else the nominal one.

    Raises
    ------
    ValueError
        An unknown name, a value outside its range or disk unless `beyond_range`, or not finite; dynamics of another
        size or with a constant gain above the bound.
    """
    real = {e.name: e for e in elements if isinstance(e, RealParameter)}
    others = {e.name: e for e in elements if not isinstance(e, RealParameter)}
    unknown = sorted(set(values) - set(real) - set(others))
    if unknown:
        known = ", ".join(e.name for e in elements)
        raise InputError(f"parameter must be one of {known or '(none)'}, got {unknown[0]!r}")
    chosen: dict[str, Value] = {}
    chosen.update(checked_values(real, {k: v for k, v in values.items() if k in real}, beyond_range=beyond_range))
    for name, element in others.items():
        if isinstance(element, ComplexParameter):
            value = values.get(name, element.nominal)
            chosen[name] = value if beyond_range and np.isfinite(value) else element.check(value)
        else:
            chosen[name] = _dynamics(element, values.get(name, np.zeros((element.outputs, element.inputs))))
    return chosen


def _dynamics(element: DynamicElement, value: Value) -> Value:
    shape = element.outputs, element.inputs
    if hasattr(value, "matrices"):
        size = total_size(value.outputs), total_size(value.inputs)
    else:
        try:
            value = np.atleast_2d(np.asarray(value, dtype=complex))
        except (TypeError, ValueError):
            raise InputError(f"element {element.name!r} must be numbers or a system, got {value!r}") from None
        if not np.all(np.isfinite(value)):
            raise InputError(f"element {element.name!r} must be finite, got another number")
        size = value.shape
        if size == shape and linalg.norm(value, 2) > element.bound * (1 + 1e-12):
            raise InputError(
                f"element {element.name!r} must have a gain of at most {element.bound:g}, got {linalg.norm(value, 2):g}"
            )
    if size != shape:
        raise InputError(f"element {element.name!r} must be {shape[0]} x {shape[1]}, got {size[0]} x {size[1]}")
    return value


def occurrences(channels: Sequence[str], elements: Sequence[Element]) -> Iterator[tuple[Element, IntArray]]:
    """Each occurrence of each element, with its Delta channels."""
    for element in elements:
        places = np.array([i for i, name in enumerate(channels) if name == element.name], dtype=np.intp)
        for group in places.reshape(-1, width(element)):
            yield element, group


def delta_response(
    channels: Sequence[str], elements: Sequence[Element], chosen: Mapping[str, Value], point: complex
) -> ComplexArray:
    """Delta at s or z, shape (q, q)."""
    delta = np.zeros((len(channels), len(channels)), dtype=complex)
    for element, at in occurrences(channels, elements):
        value = chosen[element.name]
        if isinstance(element, DynamicElement):
            block = lft.response(value.matrices, point) if hasattr(value, "matrices") else value
            delta[np.ix_(at[: element.outputs], at[: element.inputs])] = block
        else:
            delta[at, at] = value - element.nominal
    return delta


def delta_system(channels: Sequence[str], elements: Sequence[Element], chosen: Mapping[str, Value]) -> Matrices:
    """Delta as a system of q inputs and outputs; the dynamics of an element have states for each occurrence.

    Raises
    ------
    ValueError
        A complex value.
    """
    q = len(channels)
    whole: Matrices = np.zeros((0, 0)), np.zeros((0, q)), np.zeros((q, 0)), np.zeros((q, q))
    A, B, C, D = whole
    for element, at in occurrences(channels, elements):
        value = chosen[element.name]
        rows, columns = at, at
        if isinstance(element, DynamicElement):
            rows, columns = at[: element.outputs], at[: element.inputs]
        if hasattr(value, "matrices"):
            a, b, c, d = value.matrices
        else:
            deviation = value if isinstance(element, DynamicElement) else np.array([[value - element.nominal]])
            if np.iscomplexobj(deviation) and np.any(deviation.imag):
                raise InputError(f"value of {element.name!r} must be real (response takes complex ones), got {value}")
            d = np.real(deviation).astype(float)
            a, b, c = np.zeros((0, 0)), np.zeros((0, d.shape[1])), np.zeros((d.shape[0], 0))
        n, new = len(A), len(a)
        A = np.block([[A, np.zeros((n, new))], [np.zeros((new, n)), a]])
        B, C = np.vstack([B, np.zeros((new, q))]), np.hstack([C, np.zeros((q, new))])
        B[n:, columns], C[rows, n:], D[np.ix_(rows, columns)] = b, c, d
    return A, B, C, D


def random_values(elements: Sequence[Element], rng: np.random.Generator, dt: float = 0.0) -> dict[str, Value]:
    """One draw of all elements: real and complex ones uniform in range or disk, dynamics random all-pass systems.

    The dynamics are ``g U (s - a) / (s + a) V'`` (or a delay-like all-pass in discrete time) with orthonormal U and V
    and gain g uniform up to the bound, and a spread over three decades around 1 rad/s.
    """
    drawn: dict[str, Value] = {}
    for e in elements:
        if isinstance(e, RealParameter):
            drawn[e.name] = float(rng.uniform(e.lower, e.upper))
        elif isinstance(e, ComplexParameter):
            size, angle = e.radius * math.sqrt(rng.uniform()), rng.uniform(0, 2 * math.pi)
            drawn[e.name] = e.nominal + size * complex(math.cos(angle), math.sin(angle))
        else:
            k = min(e.outputs, e.inputs)
            U = linalg.qr(rng.standard_normal((e.outputs, k)), mode="economic")[0]
            V = linalg.qr(rng.standard_normal((e.inputs, k)), mode="economic")[0]
            g = e.bound * rng.uniform()
            if dt:
                r = rng.uniform(-0.95, 0.95)  # (1 - r z) / (z - r)
                a, through, factor = r, -r, 1.0 - r * r
            else:
                pole = 10.0 ** rng.uniform(-1.5, 1.5)
                a, through, factor = -pole, 1.0, -2.0 * pole
            eye = np.eye(k)
            B, C, D = (np.asarray(M, dtype=float) for M in (V.T, g * factor * U, g * through * U @ V.T))
            drawn[e.name] = a * eye, B, C, D
    return drawn
