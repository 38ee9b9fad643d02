"""Systems go to other programs and files, MATLAB's among them, and come back without loss."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import control
import numpy as np
import pytest
from scipy import io, signal

import lftkit as lk
from lftkit import (
    ComplexParameter,
    DynamicElement,
    InputError,
    Port,
    RealParameter,
    SampledSystem,
    System,
    dynamic,
    read_mat,
    real,
    s,
    write_mat,
)


def system(dt: float = 0.0, order: int = 3) -> System:
    rng = np.random.default_rng(7)
    ports = [Port("w", 2, "N"), Port("u", 1)], [Port("y", 1, "m"), Port("z", 2, "rad")]
    M = [rng.standard_normal(shape) for shape in ((order, order), (order, 3), (3, order), (3, 3))]
    return System(*M, *ports, "plant", dt)


def same(a: System, b: System, names: bool = True) -> None:
    assert all(np.array_equal(x, y) and x.shape == y.shape for x, y in zip(a.lft, b.lft))
    assert (a.dt, a.channels, a.elements) == (b.dt, b.channels, b.elements)
    if names:
        assert (a.inputs, a.outputs, a.name) == (b.inputs, b.outputs, b.name)


@pytest.mark.parametrize("dt", [0.0, 0.25])
@pytest.mark.parametrize("order", [0, 3])
def test_round_trips_lose_nothing(dt: float, order: int, tmp_path: Path) -> None:
    made = system(dt, order)
    lk.write_mat(tmp_path / "a.mat", P=made, Q=2 * made)
    same(lk.read_mat(tmp_path / "a.mat", "P"), made)
    same(lk.read_mat(tmp_path / "a.mat", "Q"), 2 * made)
    same(lk.from_json(lk.to_json(made)), made)
    lk.write_system(tmp_path / "a.json", made)
    same(lk.read_system(tmp_path / "a.json"), made)
    if order:
        same(lk.from_scipy(lk.to_scipy(made)), made, names=False)
    again = System.from_control(made.to_control(), {p.name: p.unit for p in made.inputs + made.outputs})
    if order or dt:
        same(again, made)


def test_json_keeps_elements_of_every_kind_to_the_last_bit() -> None:
    k = RealParameter("k", 1 / 3, 0.1, 0.7, "N/m", "a")
    elements = (k, ComplexParameter("c", 0.1, 0.2), DynamicElement("f", 1, 2))
    rng, channels = np.random.default_rng(0), ("k", "f", "f", "c", "k")
    matrices = [rng.standard_normal(shape) / 3 for shape in ((2, 2), (2, 6), (6, 2), (6, 6))]
    made = System(*matrices, [("u", 1)], [("y", 1)], "s", 0.1, channels, elements)
    same(lk.from_json(lk.to_json(made)), made)


def test_files_of_matlab_are_read(tmp_path: Path) -> None:
    """As MATLAB writes them: four matrices, or a struct with names of signals in its way."""
    made = system()
    A, B, C, D = made.matrices
    io.savemat(tmp_path / "plain.mat", {"A": A, "B": B, "C": C, "D": D})
    plain = lk.read_mat(tmp_path / "plain.mat")
    same(plain, made, names=False)
    assert [p.name for p in plain.inputs] == ["u"] and plain.name == "plain" and plain.inputs[0].size == 3
    names = np.array([["w(2)"], ["u"], ["w(1)"]], dtype=object)
    struct = {"a": A, "b": B[:, [1, 2, 0]], "c": C, "d": D[:, [1, 2, 0]], "Ts": 0.5, "InputName": names}
    io.savemat(tmp_path / "struct.mat", {"G": struct, "unrelated": np.eye(2)})
    read = lk.read_mat(tmp_path / "struct.mat")
    assert read.dt == 0.5 and [(p.name, p.size) for p in read.inputs] == [("w", 2), ("u", 1)]
    np.testing.assert_array_equal(read.B, B)
    np.testing.assert_array_equal(read.D, D)
    assert read.outputs == (Port("y", 3),)


@pytest.mark.parametrize(
    "theirs",
    [
        signal.TransferFunction([1.0, 2.0], [1.0, 3.0, 5.0]),
        signal.ZerosPolesGain([-1.0], [-2.0, -3.0], 4.0),
        signal.StateSpace([[0.5]], [[1.0]], [[2.0]], [[0.0]], dt=0.1),
        signal.TransferFunction([0.5], [1.0, -0.5], dt=0.2),
    ],
)
def test_systems_of_scipy_keep_response_and_period(theirs: Any) -> None:
    ours = lk.as_system(theirs)
    w, expected = theirs.freqresp([0.3, 1.1]) if not theirs.dt else (None, None)
    assert ours.dt == (theirs.dt or 0.0)
    if w is None:
        _, expected = signal.dfreqresp(theirs, np.array([0.3, 1.1]))
        w = np.array([0.3, 1.1]) / theirs.dt
    np.testing.assert_allclose(ours.response(w)[:, 0, 0], expected, rtol=1e-12)


def test_anything_that_is_a_system_becomes_one() -> None:
    sampled = SampledSystem([[0.5]], [[1.0]], [[1.0]], [[0.0]], (Port("a", 1),), (Port("b", 1),), 0.1, "law")
    assert lk.as_system(sampled).dt == 0.1 and lk.as_system(sampled).name == "law"
    assert lk.as_system(3.0).D.tolist() == [[3.0]] and lk.as_system([[1, 2]]).inputs == (Port("u", 2),)
    assert lk.as_system(1 / (lk.s + 1), ["force"], ["speed"]).inputs == (Port("force", 1),)
    theirs = control.tf([1], [1, 1], inputs=["force"], outputs=["speed"])
    assert lk.as_system(theirs).outputs == (Port("speed", 1),)
    assert lk.as_system(system()) is not None and lk.as_system(system(), [Port("all", 3)]).inputs[0].size == 3
    with pytest.raises(ValueError, match=r"system must be a System, .* got str"):
        lk.as_system("plant")
    with pytest.raises(ValueError, match="got FrequencyResponseData"):
        lk.as_system(control.frd([1.0, 2.0], [1.0, 2.0]))


def test_what_cannot_be_exchanged_is_refused(tmp_path: Path) -> None:
    uncertain = (lk.real("k", 1.0, percent=10) / (lk.s + 1)).system()
    (tmp_path / "text.mat").write_text("no")
    (tmp_path / "text.json").write_text("[1]")
    io.savemat(
        tmp_path / "two.mat", {"P": {"A": 1.0, "B": 1.0, "C": 1.0, "D": 0.0}, "Q": {"a": 1, "b": 1, "c": 1, "d": 1}}
    )
    io.savemat(tmp_path / "none.mat", {"x": 1.0})
    io.savemat(tmp_path / "odd.mat", {"P": {"A": np.eye(2), "B": np.eye(3), "C": np.eye(2), "D": 0.0}})
    io.savemat(tmp_path / "bad.mat", {"A": np.eye(2), "B": np.eye(2), "C": np.eye(2), "D": np.full((2, 2), np.nan)})
    for call, message in (
        (lambda: lk.to_scipy(uncertain), "system must be certain"),
        (lambda: lk.write_mat(tmp_path / "a.mat"), "systems must be given by keyword"),
        (lambda: lk.read_mat(tmp_path / "missing.mat"), "must be a .mat file"),
        (lambda: lk.read_mat(tmp_path / "text.mat"), "must be a .mat file"),
        (lambda: lk.read_mat(tmp_path / "two.mat"), "name must be one of its structs, got P, Q"),
        (lambda: lk.read_mat(tmp_path / "none.mat"), "name must be one of its structs, got none"),
        (lambda: lk.read_mat(tmp_path / "odd.mat"), "odd.mat"),
        (lambda: lk.read_mat(tmp_path / "bad.mat"), "matrix D must be finite"),
        (lambda: lk.read_system(tmp_path / "text.json"), 'text must have "format"'),
        (lambda: lk.read_system(tmp_path / "missing.json"), "cannot read"),
        (lambda: lk.from_json("{"), "text must be JSON"),
        (lambda: lk.from_json('{"format": "lftkit/system", "version": 1}'), "'inputs' is missing"),
        (lambda: lk.from_scipy(1.0), "must be a scipy.signal lti or dlti, got float"),
        (lambda: lk.from_scipy(signal.TransferFunction([1.0], [1.0, 0.5], dt=True)), "sampling period in seconds"),
    ):
        with pytest.raises(ValueError, match=message) as caught:
            call()
        assert "\n" not in str(caught.value)


def test_connections_take_whatever_is_a_system() -> None:
    theirs = control.tf([1], [1, 1], inputs=["u"], outputs=["y"])
    for made in (
        lk.feedback(theirs, 2.0),
        lk.feedback(1 / (lk.s + 1), theirs * 0 + 2),
        lk.series(theirs, theirs, {"y": "u"}),
    ):
        assert isinstance(made, System)
    assert lk.feedback(theirs, 2.0).poles().real.tolist() == [-3.0]
    both: dict[str, Any] = {"a": theirs, "b": lk.real("k", 1.0, percent=10)}
    whole = lk.connect(both, [("r", "a.u"), ("a.y", "b.u")], inputs=[Port("r", 1)], outputs={"y": "b.y"})
    assert whole.occurrences() == {"k": 1} and abs(whole.at(k=1.1)(0) - 1.1) < 1e-12
    assert lk.append(theirs.copy(), lk.as_system(3.0, "v", "w")).D.tolist() == [[0.0, 0.0], [0.0, 3.0]]


def test_sensitivity_and_sampled_form_of_an_expression_of_two_channels() -> None:
    loop = lk.matrix([[1 / (lk.s + 1), 0.5], [0, 2 / (lk.s + 3)]])
    sensitivity, at = lk.feedback(1, loop), 0.7j
    assert np.allclose(sensitivity(at) @ (np.eye(2) + loop(at)), np.eye(2), atol=1e-12)
    assert sorted(loop.poles().real) == pytest.approx([-3.0, -1.0])
    dt = 0.1
    z = np.exp(at * dt)
    assert np.allclose(lk.discretise(loop, dt)(z), loop(2.0 / dt * (z - 1.0) / (z + 1.0)), atol=1e-12)


def test_numbers_of_numpy_are_numbers_of_a_file() -> None:
    elements = (
        RealParameter("k", np.float32(1.0), np.int64(0), 2.0),  # type: ignore[arg-type]
        ComplexParameter("c", np.float32(0.5), np.int64(2)),  # type: ignore[arg-type]
        DynamicElement("d", np.int64(1), np.int64(1), np.float32(0.5)),  # type: ignore[arg-type]
    )
    ports = [("u", np.int64(1))], [Port("y", np.int32(1))]  # type: ignore[arg-type]
    D = np.ones((4, 4)) - np.eye(4)
    given = System([], [], [], D, *ports, dt=np.float32(0.5), channels=("k", "c", "d"), elements=elements)
    back = lk.from_json(lk.to_json(given))
    same(given, back)
    assert back.dt == 0.5 and back.elements == elements and (lk.s ** np.int64(2))(2.0) == 4.0  # type: ignore[operator]


def test_complex_coefficients_of_scipy_are_refused() -> None:
    one, none = np.array([[1.0]]), np.array([[0.0]])
    fraction: Any = signal.TransferFunction
    zpk: Any = signal.ZerosPolesGain
    for given in (
        signal.StateSpace(np.array([[-1.0 + 2.0j]]), one, one, none),
        fraction([1.0], [1.0, 1.0 + 2.0j]),
        zpk([], [-1.0], 1.0j),
    ):
        with pytest.raises(ValueError, match=r"^system must have real coefficients, got complex ones$"):
            lk.from_scipy(given)
        with pytest.raises(ValueError, match="real coefficients"):
            lk.as_system(given)
    nearly = zpk([], [-1.0 + 0.1j, -1.0 - 0.1j * (1.0 + 1e-15)], 1.0)  # conjugate but for rounding
    assert lk.from_scipy(nearly).poles() == pytest.approx([-1.0 + 0.1j, -1.0 - 0.1j])


@pytest.mark.parametrize(
    ("given", "dt"),
    [
        (([], [0.98] * 12, 1e-20), 0.01),
        (signal.butter(15, 0.05, output="zpk"), 0.01),
        (signal.ellip(9, 0.5, 60.0, 1000.0, analog=True, output="zpk"), 0.0),
        (([3.0, -1.0], [-2.0, -1.0 + 2.0j, -5.0, -1.0 - 2.0j], -2.5), 0.0),
        (([0.5 + 0.1j, 0.5 - 0.1j, 0.2], [0.1, 0.2, 0.3], 2.0), 0.01),
        (([1e-17 + 900.0j, 1e-18 + 500.0j, -900.0j, 1e-16 - 500.0j], [-1.0, -2.0, -3.0, -4.0], 3.0), 0.0),
        (([], [], 4.0), 0.0),
    ],
    ids=["equal poles", "Butterworth", "elliptic", "real and complex", "as many zeros", "zeros on the axis", "a gain"],
)
def test_zeros_and_poles_of_scipy_stay_where_they_are(given: Any, dt: float) -> None:
    """By the coefficients of a fraction twelve poles at 0.98 came back at up to 1.08, an unstable system."""
    zeros, poles, gain = given
    with pytest.raises(lk.InputError, match=r"^zeros must be at most as many as poles"):
        lk.from_scipy(signal.ZerosPolesGain(np.zeros(len(poles) + 1), poles, gain))  # type: ignore[arg-type]
    zpk: Any = signal.ZerosPolesGain
    found = lk.from_scipy(zpk(zeros, poles, gain, **({"dt": dt} if dt else {})))
    at = np.exp(0.1j) if dt else 800.0j
    value = gain * np.prod(at - np.asarray(zeros)) / np.prod(at - np.asarray(poles))
    assert found(at) == pytest.approx(value, rel=1e-10) and found.dt == dt
    expected = np.sort_complex(np.asarray(poles, dtype=complex))
    assert np.allclose(np.sort_complex(found.poles()), expected, rtol=1e-9)


@pytest.mark.parametrize(
    ("field", "value", "message"),
    [
        ("InputDelay", [[0.5]], r"no delays .*, got inputdelay"),
        ("InternalDelay", [[0.1], [0.2]], r"no delays .*, got internaldelay"),
        ("E", [[2.0]], "an explicit state space .*, got a matrix E"),
        ("TimeUnit", "minutes", "the TimeUnit seconds .*, got minutes"),
    ],
)
def test_what_a_system_here_cannot_have_is_not_dropped(tmp_path: Path, field: str, value: Any, message: str) -> None:
    """Fields of the struct of a whole `ss` object that make it another system; without effect they are taken."""
    plain = {"A": [[-1.0]], "B": [[1.0]], "C": [[1.0]], "D": [[0.0]]}
    for content, name in (({"P": {**plain, field: value}}, "P"), ({**plain, field: value}, "plant")):
        io.savemat(tmp_path / "plant.mat", content)
        with pytest.raises(lk.InputError, match=rf"{name} must have {message}".replace("have an", "be an")):
            lk.read_mat(tmp_path / "plant.mat")
    none = {"E": [[1.0]], "InputDelay": [[0.0]], "OutputDelay": [], "TimeUnit": "seconds"}
    io.savemat(tmp_path / "plant.mat", {"P": {**plain, **none}})
    assert lk.read_mat(tmp_path / "plant.mat").poles() == [-1.0]


@pytest.mark.parametrize(("key", "value"), [("dt", "0.1"), ("dt", True), ("elements", "k"), ("A", [["-1.0"]])])
def test_text_of_another_type_is_not_read_as_a_number(key: str, value: Any) -> None:
    content = json.loads(lk.to_json((1.0 / (lk.s + 1.0)).system()))
    with pytest.raises(lk.InputError) as caught:
        lk.from_json(json.dumps(content | {key: value}))
    assert "\n" not in str(caught.value)


def test_an_array_of_structs_is_not_one_system(tmp_path: Path) -> None:
    array = np.empty((1, 2), dtype=[(key, object) for key in "ABCD"])
    for k, pole in enumerate((-1.0, -2.0)):
        array[0, k] = tuple(np.array([[value]]) for value in (pole, 1.0, 1.0, 0.0))
    io.savemat(tmp_path / "two.mat", {"P": array})
    for name in (None, "P"):
        with pytest.raises(ValueError, match=r"two\.mat: P must be one system, got an array of 2$"):
            lk.read_mat(tmp_path / "two.mat", name)
    io.savemat(tmp_path / "one.mat", {"P": array[:, 1:]})
    assert lk.read_mat(tmp_path / "one.mat").poles() == [-2.0]


def spring() -> System:
    """A mass on a spring; its stiffness occurs twice and its range is not symmetric."""
    stiffness, mass = real("k", 2.0, 1.0, 4.0, unit="N/m"), real("m", 1.0, 0.8, 1.2)
    found: System = (stiffness / (mass * s**2 + 0.1 * s + stiffness)).system("force", "position")
    return found


def test_a_system_comes_back_with_its_elements(tmp_path: Path) -> None:
    given = spring()
    write_mat(tmp_path / "p.mat", P=given)
    found = read_mat(tmp_path / "p.mat")
    assert found.inputs == given.inputs and set(found.elements) == set(given.elements)
    for values in given.sample_values(np.random.default_rng(0), 20):
        pair = [complex(one.at(values)(0.7j)) for one in (given, found)]
        assert pair[0] == pytest.approx(pair[1], rel=1e-12)


def by_hand(**changes: Any) -> dict[str, Any]:
    """A gain k in [1, 4] with nominal 2, ``k = 2 + a nu / (1 + b nu)``: -1, 0, 1 are 1, 2, 4."""
    a, b = 4.0 / 3.0, -1.0 / 3.0
    block = blocks(Name="k", Nominal=2.0, Range=np.array([[1.0, 4.0]]), Occurrences=1.0)
    content = {
        "A": np.zeros((0, 0)),
        "B": np.zeros((0, 2)),
        "C": np.zeros((2, 0)),
        "D": np.array([[-b, 1.0], [a, 2.0]]),
    }
    return {**content, "InputName": "u", "OutputName": "y", "Blocks": block, **changes}


def blocks(**values: Any) -> Any:
    table = np.zeros((1, 1), dtype=[(name, object) for name in values])
    table[0, 0] = tuple(values.values())
    return table


@pytest.mark.parametrize("value", [1.0, 1.7, 2.0, 4.0])
def test_delta_is_normalised_in_the_file(tmp_path: Path, value: float) -> None:
    """The matrices of an uncertain gain by hand: lowest, nominal and highest value are -1, 0 and 1."""
    io.savemat(tmp_path / "p.mat", {"P": by_hand()})
    found = read_mat(tmp_path / "p.mat")
    assert found.elements == (RealParameter("k", 2.0, 1.0, 4.0),)
    assert float(found.at({"k": value}).D[0, 0]) == pytest.approx(value, rel=1e-12)


RANGE = np.array([1.0, 4.0])


@pytest.mark.parametrize(
    ("table", "message"),
    [
        (blocks(Name="k", Nominal=2.0, Range=RANGE), "Blocks must have the field Occurrences"),
        (blocks(Name="k", Nominal=2.0, Range=4.0, Occurrences=1.0), "block k must be a real parameter"),
        (blocks(Name="k", Nominal=5.0, Range=RANGE, Occurrences=1.0), "lower <= nominal <= upper"),
        (blocks(Name="k", Nominal=2.0, Range=RANGE, Occurrences=3.0), "the 3 channels of its Blocks"),
        (blocks(Name="k", Nominal=2.0, Range=RANGE, Occurrences=0.5), "Occurrences of block k"),
        (blocks(Name="k", Nominal=2.0, Range=np.array([2.0, 2.0]), Occurrences=1.0), "must hold more than one value"),
        (np.ones((2, 2)), "Blocks must be an array of structs"),
    ],
)
def test_blocks_that_do_not_fit_are_refused(tmp_path: Path, table: Any, message: str) -> None:
    io.savemat(tmp_path / "p.mat", {"P": by_hand(Blocks=table)})
    with pytest.raises(ValueError, match=message) as refused:
        read_mat(tmp_path / "p.mat")
    assert "\n" not in str(refused.value)


def test_dynamics_are_not_written(tmp_path: Path) -> None:
    uncertain = ((1 + dynamic("d", bound=0.2)) / (s + 1)).system("u", "y")
    with pytest.raises(ValueError, match="real"):
        write_mat(tmp_path / "p.mat", P=uncertain)


@pytest.mark.parametrize(
    ("field", "value", "message"),
    [
        ("InputName", ["u1", "u2"], "InputName must have 3 names, got 2"),
        ("OutputName", ["y1", "y2", "y3"], "OutputName must have 2 names, got 3"),
        ("Ts", [0.1, 0.2], "Ts must be a number, got 0.1, 0.2"),
        ("Ts", 1j, "Ts must be a number, got"),
        ("Normalized", "no", "Normalized must be a number, got no"),
        ("Normalized", np.nan, "Normalized must be 0 or 1, got nan"),
    ],
)
def test_a_field_that_would_make_another_system_is_refused(
    tmp_path: Path, field: str, value: Any, message: str
) -> None:
    """Names of fewer signals left out the columns behind them; two periods were the first."""
    names = {"InputName": ["u1", "u2", "u3"], "OutputName": ["y1", "y2"]}
    content = {"A": [[-1.0]], "B": np.ones((1, 3)), "C": np.ones((2, 1)), "D": np.zeros((2, 3)), **names}
    content[field] = value
    named = {k: np.array(v, object) if k in names else v for k, v in content.items()}
    io.savemat(tmp_path / "plant.mat", named)
    with pytest.raises(InputError, match=message):
        read_mat(tmp_path / "plant.mat")


def test_units_go_with_the_names_of_the_signals(tmp_path: Path) -> None:
    """A port whose signals are not in order, among those of another one."""
    gain = {"A": np.zeros((0, 0)), "B": np.zeros((0, 3)), "C": np.zeros((1, 0)), "D": np.array([[1.0, 2.0, 3.0]])}
    names, units = np.array(["w(2)", "v", "w(1)"], dtype=object), np.array(["Nm", "rad", "N"], dtype=object)
    io.savemat(tmp_path / "p.mat", {"P": {**gain, "InputName": names, "InputUnit": units}})
    found = read_mat(tmp_path / "p.mat")
    assert found.inputs == (Port("w", 2, "N,Nm"), Port("v", 1, "rad")) and found.D.tolist() == [[3.0, 1.0, 2.0]]
    io.savemat(tmp_path / "p.mat", {"P": {**gain, "InputName": names, "InputUnit": units[:2]}})
    with pytest.raises(InputError, match="InputUnit must have 3 units, got 2"):
        read_mat(tmp_path / "p.mat")
