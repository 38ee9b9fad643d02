"""Small systems with known peaks, as matrices (A, B, C, D)."""

from __future__ import annotations

import numpy as np
import scipy.linalg

CERTIFICATES = ["interval", "hamiltonian"]
EVERY = ["auto", *CERTIFICATES]


def oscillator(w: float, zeta: float) -> tuple[np.ndarray, ...]:
    """w^2 / (s^2 + 2 zeta w s + w^2): peak 1 / (2 zeta sqrt(1 - zeta^2)) at w sqrt(1 - 2 zeta^2)."""
    A = np.array([[0.0, w], [-w, -2.0 * zeta * w]])
    return A, np.array([[0.0], [w]]), np.array([[1.0, 0.0]]), np.zeros((1, 1))


def resonator(radius: float, angle: float) -> tuple[np.ndarray, ...]:
    """1 / (z^2 - 2 r cos(a) z + r^2): peak 1 / ((1 - r^2) sin a) where cos(theta) = cos(a) (1 + r^2) / (2 r)."""
    A = np.array([[0.0, 1.0], [-(radius**2), 2.0 * radius * np.cos(angle)]])
    return A, np.array([[0.0], [1.0]]), np.array([[1.0, 0.0]]), np.zeros((1, 1))


def sum_of(*systems: tuple[np.ndarray, ...]) -> tuple[np.ndarray, ...]:
    """Block-diagonal system: each has inputs and outputs of its own, so the largest norm is the norm."""
    return tuple(scipy.linalg.block_diag(*parts) for parts in zip(*systems))


def mixed(system: tuple[np.ndarray, ...], seed: int = 0) -> tuple[np.ndarray, ...]:
    """The same system in other coordinates."""
    A, B, C, D = system
    T = np.eye(len(A)) + 0.2 * np.random.default_rng(seed).normal(size=A.shape)
    return T @ A @ np.linalg.inv(T), T @ B, C @ np.linalg.inv(T), D


def structure(feedthrough: float = 0.3) -> tuple[np.ndarray, ...]:
    rng = np.random.default_rng(8)
    A, B, C, _ = mixed(sum_of(*(oscillator(w, 0.02) for w in (0.5, 0.55, 4.0, 30.0))))
    return A, B @ rng.normal(size=(4, 3)), rng.normal(size=(2, 4)) @ C, feedthrough * rng.normal(size=(2, 3))
