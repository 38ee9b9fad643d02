"""The simulation step and the tones on small numbers, against their definitions."""

from __future__ import annotations

import importlib
import pickle
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy import linalg

from lftkit import Port, System
from titop_plant.disturbances.wheel_and_drive_tones import Tones
from titop_plant.interface import CAMERA, DT
from titop_plant.simulation.compilation import kernel
from titop_plant.simulation.constant_step import ConstantStep
from titop_plant.simulation.modal_plant import ModalPlant
from titop_plant.simulation.plant import Plant
from titop_plant.simulation.plant_step import held_step, in_turn, plant_step, step_matrix, tone_step
from titop_plant.simulation.sensor_samples import SensorModel

K = 3
SENSORS = SensorModel(np.linspace(0.1, 2.3, 22), np.linspace(-1.0, 1.0, 22), 4, 0.3, 11)
LIMITS = np.linspace(0.5, 1.2, 8)
TICKS = 150


def system(A: np.ndarray) -> System:
    rng, n = np.random.default_rng(0), len(A)
    B, C, D = (rng.standard_normal(shape) for shape in ((n, 30), (24, n), (24, 30)))
    return System(A, 100.0 * B, C, D, (Port("u", 30),), (Port("y", 24),))


def pair(decay: float, frequency: float) -> np.ndarray:
    return np.array([[-decay, frequency], [-frequency, -decay]])


MODES = linalg.block_diag(pair(1.0, 300.0), pair(0.5, 40.0), np.diag([-30.0, -7.0]))
FREE_MASS = np.array([[0.0, 1.0], [0.0, 0.0]])
COORDINATES = np.random.default_rng(9).standard_normal((6, 6))
PLANTS = {
    "pairs and real poles": COORDINATES @ MODES @ np.linalg.inv(COORDINATES),
    "a free mass beside a mode": linalg.block_diag(FREE_MASS, np.array([[0.0, 1.0], [-900.0, -0.1]])),
    "one real pole": np.array([[-50.0]]),
    "three free masses": np.kron(FREE_MASS, np.eye(3)),
    "an undamped mode": np.array([[0.0, 1.0, 0.0], [-900.0, 0.0, 0.0], [1.0, 2.0, -5.0]]),
    "no states": np.zeros((0, 0)),
}
ON_POLE = {"a free mass beside a mode": 0.0, "three free masses": 0.0, "an undamped mode": 30.0}
FREQUENCIES = np.array([3.0, 33.0, 2500.0])


def tones_at(frequency: np.ndarray) -> Tones:
    rng = np.random.default_rng(4)
    amplitude = rng.standard_normal((22, K)) + 1j * rng.standard_normal((22, K))
    return Tones(frequency, amplitude, np.zeros(K), np.full(K, -1))


def plant(A: np.ndarray, sensors: SensorModel = SENSORS, frequency: np.ndarray = FREQUENCIES) -> Plant:
    step = plant_step(system(A), tones_at(frequency))
    state = np.linspace(1.0, -2.0, len(A))
    return Plant(ConstantStep(step, state, frequency), sensors, LIMITS, "name")


def expected(A: np.ndarray, commands: np.ndarray, sensors: SensorModel, frequency: np.ndarray):
    """States with held commands and tones by one matrix exponential, with their own noise and frames."""
    noise, camera = (np.random.default_rng(s) for s in np.random.SeedSequence(sensors.seed).spawn(2))
    draws = np.vstack([noise.standard_normal((64, 22)) for _ in range(len(commands) // 64 + 1)]) * sensors.sigma
    data, tones, n = system(A), tones_at(frequency), len(A)
    drive = data.B[:, 8:] @ tones.amplitude
    whole = np.zeros((n + 8 + 2 * K, n + 8 + 2 * K))
    whole[:n, :n], whole[:n, n : n + 8] = data.A, data.B[:, :8]
    for k, w in enumerate(frequency):
        re, im = n + 8 + 2 * k, n + 8 + 2 * k + 1
        whole[:n, re], whole[:n, im] = drive[:, k].imag, drive[:, k].real
        whole[re, im], whole[im, re] = -w, w
    over = linalg.expm(whole * DT)
    x, measured, truth = np.linspace(1.0, -2.0, n), [], []
    for k, command in enumerate(commands):
        p, v = np.exp(1j * frequency * k * DT), np.clip(command, -LIMITS, LIMITS)
        out = data.C @ x + data.D[:, :8] @ v + (data.D[:, 8:] @ tones.amplitude @ p).imag
        y = out[:22] + draws[k] + sensors.bias
        lost = k % sensors.frame_ticks == 0 and sensors.dropout > 0 and camera.random(3)[0] < sensors.dropout
        if k % sensors.frame_ticks or lost:
            y[CAMERA] = np.nan
        measured.append(y)
        truth.append(out[22:])
        x = (over @ np.concatenate([x, v, np.column_stack([p.real, p.imag]).ravel()]))[:n]
    return np.array(measured), np.array(truth), x


@pytest.mark.parametrize("dropout", [0.0, 0.3, 1.0])
@pytest.mark.parametrize("name", PLANTS)
@pytest.mark.parametrize("on_a_pole", [False, True])
def test_a_run_is_the_one_of_matrix_exponentials(name: str, dropout: float, on_a_pole: bool) -> None:
    """More than two blocks of noise, commands beyond their limits, lost frames; a tone on a pole, or beside them."""
    A = PLANTS[name]
    frequency = np.array([ON_POLE.get(name, 3.0), 33.0, 2500.0]) if on_a_pole else FREQUENCIES
    sensors = replace(SENSORS, dropout=dropout)
    commands = 2.0 * np.random.default_rng(3).standard_normal((TICKS, 8))
    model = plant(A, sensors, frequency)
    y, t, x = expected(A, commands, sensors, frequency)
    for compiled in (False, True):
        if compiled:
            model.compile()
        model.reset()
        assert model.tick == 0
        np.testing.assert_allclose(model.state, np.linspace(1.0, -2.0, len(A)), rtol=1e-12)
        measured, truth = np.zeros((TICKS, 22)), np.zeros((TICKS, 2))
        for k in range(TICKS):
            model.step(commands[k], measured[k], truth[k])
        scale = np.abs(t).max()
        np.testing.assert_allclose(measured, y, rtol=1e-10, atol=1e-11 * scale)
        np.testing.assert_allclose(truth, t, rtol=1e-10, atol=1e-11 * scale)
        np.testing.assert_allclose(model.state, x, rtol=1e-9, atol=1e-11 * np.abs(x).max(initial=0.0))
    frames = np.isfinite(measured[:, 18])
    assert np.isfinite(np.delete(measured, [18, 19], axis=1)).all()
    assert frames.sum() == {0.0: 38, 1.0: 0}.get(dropout, frames.sum())
    assert np.all(np.flatnonzero(frames) % 4 == 0)


@pytest.mark.parametrize("name", PLANTS)
def test_compiled_code_has_the_bits_of_numpy(name: str) -> None:
    """Tick by tick, over changes of its settings too."""
    if kernel() is None:
        pytest.skip("could not import 'numba'")
    records = []
    for compiled in (False, True):
        model = plant(PLANTS[name])
        if compiled:
            model.compile()
        commands = 2.0 * np.random.default_rng(3).standard_normal((TICKS, 8))
        rows = np.zeros((TICKS, 24))
        for k in range(TICKS):
            if k in (40, 90):
                model.change("disturbance", float(k == 90))
            model.step(commands[k], rows[k, :22], rows[k, 22:])
        records.append(rows.tobytes() + model.state.tobytes())
    assert records[0] == records[1]


def test_the_state_is_a_copy_and_the_settings_are_kept() -> None:
    model = plant(PLANTS["one real pole"])
    model.state[:] = 9.0
    assert model.state.tolist() == pytest.approx([1.0])
    assert (model.dt, model.frame_ticks, model.parameters_hash) == (DT, 4, "name")
    assert model.tones is FREQUENCIES and model.authority is LIMITS


def tones() -> Tones:
    """Two tones of wheel 1, one of wheel 3 (which turns backwards), one of fixed frequency."""
    amplitude = (np.arange(88.0).reshape(22, 4) + 1.0) * np.exp(0.3j)
    return Tones(
        np.array([200.0, 500.0, 150.0, 7.0]), amplitude, np.array([1.0, 2.5, 1.0, 0.0]), np.array([1, 1, 3, -1])
    )


@pytest.mark.parametrize("name", PLANTS)
def test_a_step_in_modal_coordinates_is_the_matrix_exponential(name: str) -> None:
    """Commands held and tones integrated, both from one large matrix exponential; also the response in steady state."""
    data = system(PLANTS[name])
    modal, n, tones = ModalPlant.of(data, 8), len(data.A), tones_at(FREQUENCIES)
    whole, basis = step_matrix(data, tones), modal.form.basis
    held = held_step(modal)
    moved, seen = tone_step(modal, tones)
    scale = np.abs(whole).max()
    np.testing.assert_allclose(basis @ held[:n, :n], whole[:n, :n] @ basis, atol=1e-11 * scale)
    np.testing.assert_allclose(basis @ held[:n, n:], whole[:n, n : n + 8], atol=1e-11 * scale)
    np.testing.assert_allclose(held[n:, :n], whole[n:, :n] @ basis, atol=1e-11 * scale)
    np.testing.assert_array_equal(held[n:, n:], whole[n:, n : n + 8])
    np.testing.assert_allclose(in_turn(basis @ moved), whole[:n, n + 8 :], atol=1e-11 * scale)
    np.testing.assert_allclose(in_turn(seen), whole[n:, n + 8 :], atol=1e-11 * scale)
    for w, found in zip(FREQUENCIES, modal.response.at(FREQUENCIES)):
        resolvent = np.linalg.solve(1j * w * np.eye(n) - data.A, data.B[:, 8:])
        np.testing.assert_allclose(found, data.C @ resolvent + data.D[:, 8:], atol=1e-10 * scale)


MODULE = """from titop_plant.simulation.compiled import compiled


@compiled
def double(x):
    return 2.0 * x
"""


def doubled(folder: Path) -> str:
    code = "import sys; sys.path.insert(0, sys.argv[1]); from twice import double; print(double(2.0))"
    done = subprocess.run([sys.executable, "-c", code, str(folder)], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


def test_an_index_with_a_type_that_is_gone_is_written_anew(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """An upgrade in place may leave one behind that names a class of the version before."""
    pytest.importorskip("numba", reason="compiled code needs numba")
    (tmp_path / "twice.py").write_text(MODULE)
    monkeypatch.syspath_prepend(tmp_path)
    assert importlib.import_module("twice").double(2.0) == 4.0
    (index,) = tmp_path.rglob("*.nbi")
    with index.open("rb") as file:
        version = pickle.load(file)
    index.write_bytes(pickle.dumps(version) + b"ctwice\nGone\n.")
    assert doubled(tmp_path) == "4.0"
    assert b"Gone" not in index.read_bytes()
