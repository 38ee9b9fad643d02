"""Bad input of systems and conversions, arguments of other types: one line that names what is wrong."""

from __future__ import annotations

import contextlib
import inspect
from collections.abc import Callable
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any

import control
import numpy as np
import pytest

import lftkit as lk
from lftkit import (
    ComplexParameter,
    DynamicElement,
    InputError,
    Port,
    RealParameter,
    SampledSystem,
    System,
    balred,
    complex_gain,
    connect,
    dynamic,
    from_control,
    invert,
    matrix,
    parallel,
    real,
    s,
    sampled,
    star,
    state_space,
    static_gain,
    to_json,
    to_scipy,
    transform,
    z,
)
from lftkit.analysis.frequency_response import frequency_response
from lftkit.proofs import BoundOptions, MuCertificate, check_mu, complex_block, mu
from lftkit.systems.arguments import checked
from lftkit.systems.connection.feedback import close_loop
from lftkit.systems.connection.filters import transfer
from lftkit.systems.sampled.bilinear import to_discrete
from lftkit.tuning import ClosedLoopPoles, HinfGain, Margins, TuningOptions, descend, gain, tune
from lftkit.tuning.structures import structures
from lftkit.tuning.structures.bounds import Bounds

WORD: Any = "w"
NUMBER: Any = 3
NUMBERS: Any = [1]
ONE: Any = [[1.0]]
U, Y = [Port("u", 1)], [Port("y", 1)]
SPRING, OTHER = RealParameter("k", 2.0, 1.0, 5.0), RealParameter("k", 2.0, 1.0, 4.0)
FAMILY = System([], [], [], [[0, 1], [1, 2]], U, Y, "p", channels=("k",), elements=(SPRING,))
NOTHING = static_gain([[0.0]], U, Y)
WIDE = static_gain(np.ones((1, 2)), [Port("u", 2)], Y)
BESIDE = static_gain(np.ones((1, 2)), [Port("u", 1), Port("v", 1)], Y)
RESPONSES: Any = control.frd([1.0, 2.0], [1.0, 2.0])
BOTH = {"a": static_gain(ONE, U, Y), "b": static_gain(ONE, U, Y)}


def discrete(dt: Any) -> Any:
    return control.ss([[0.5]], ONE, ONE, [[0.0]], dt)


def wired(wires: Any, y: Any = "b.y", b: Port | None = None, names: tuple[str, str] = ("a", "b")) -> Any:
    second = b or Port("u", 1)
    systems = {names[0]: BOTH["a"], names[1]: static_gain(np.ones((1, second.size)), [second], Y)}
    return connect(systems, wires, inputs=[Port("r", 1), Port("s", 2)], outputs={"y": y})


K, M = real("k", 1.0, 0.5, 2.0), real("m", 2.0, 1.0, 3.0)
COLUMN = matrix([[K], [K]])
ENDS: Any = [("r", "a.u"), ("r", "b.u")]
REFUSED: dict[str, Callable[[], Any]] = {
    r"'k'.*\[1, 5\].*got 6": lambda: FAMILY.at({"k": 6.0}),
    "parameter must be one of k, got 'q'": lambda: FAMILY.at({"q": 2.0}),
    "p: input port must be one of u, got 'v'": lambda: FAMILY.select(inputs=["v"]),
    "p: input port must be one of u, got 'x'": lambda: FAMILY["y", "x"],
    "port must be one of .*, got 'w'": lambda: FAMILY.renamed({"w": "x"}),
    "ports must be a mapping from names to values, got 'w'": lambda: FAMILY.renamed(WORD),
    "elements must be a mapping from names to values, got 3": lambda: FAMILY.renamed(elements=NUMBER),
    "name of a parameter must be text, got 3": lambda: FAMILY.renamed(elements={"k": NUMBER}),
    "outputs must be a name or names of ports, got 3": lambda: FAMILY.select(outputs=NUMBER),
    r"inputs must be a name or names of ports, got \[1\]": lambda: FAMILY[("y", NUMBERS)],
    "rng must be a numpy.random.Generator, got int": lambda: FAMILY.sample_values(NUMBER),
    r"count must be an integer, got \[\[1.0": lambda: FAMILY.sample_values(np.random.default_rng(0), ONE),
    "count must be at least 0, got -1": lambda: FAMILY.sample(np.random.default_rng(0), -1),
    "element 'd' must be numbers or a system, got 'a'": lambda: dynamic("d").system("u", "y").at({"d": "a"}),
    "element 'd' must be finite": lambda: dynamic("d").system("u", "y").at({"d": np.nan}),
    "gain, inputs: must be a sequence of ports, got 3": lambda: System.static(ONE, NUMBER, Y),
    "unit of port 'a' must be text, got 3": lambda: Port("a", 1, NUMBER),
    "read-only": lambda: FAMILY.D.__setitem__((0, 0), 1.0),
    "must have one definition, got two": lambda: System(
        [], [], [], np.zeros((3, 3)), U, Y, channels=("k", "k"), elements=(SPRING, OTHER)
    ),
    "parameter 'low'": lambda: RealParameter("low", 0.0, 1.0, 2.0),
    "parameter 'high'": lambda: RealParameter("high", 3.0, 1.0, 2.0),
    "parameter 'nan'": lambda: RealParameter("nan", np.nan, 0.0, 1.0),
    "matrix D must be 1 x 1 to fit states and ports, got 1 x 2": lambda: static_gain([[1.0, 2.0]], U, Y),
    "matrix A must be finite": lambda: System([[np.nan]], ONE, ONE, [[0.0]], U, Y),
    "matrix D must be finite": lambda: static_gain([[np.nan]], U, Y),
    "dt must be a finite real number, got True": lambda: System([[0.5]], ONE, ONE, [[0.0]], U, Y, dt=True),
    "port names must be unique, got 'u' twice": lambda: static_gain(np.zeros((1, 2)), U * 2, Y),
    "must be a rectangular array of real numbers": lambda: System([[-1 + 1j]], ONE, ONE, [[0]], U, Y),
    "must be a rectangular array of real": lambda: state_space([[-1 + 1j]], ONE, ONE, [[0]], U, Y),
    "must be a rectangular array": lambda: SampledSystem([[0.5j]], ONE, ONE, [[0]], tuple(U), tuple(Y), 0.1),
    "a rectangular array of real numbers": lambda: static_gain(np.array([[1j]]), U, Y),
    "values must be a mapping from names to values, got 3": lambda: FAMILY.at(3),  # type: ignore[arg-type]
    "parameter 'k' must be a finite real number, got 'x'": lambda: FAMILY.at({"k": "x"}),  # type: ignore[dict-item]
    "omega must be a vector of finite numbers, got nan": lambda: FAMILY.response(np.append(np.arange(5000.0), np.nan)),
    r"omega must be a vector of finite numbers, got shape \(2, 1\)": lambda: FAMILY.response([[1.0], [2.0]]),
    "omega must be a vector of finite numbers, got str": lambda: FAMILY.response("a"),  # type: ignore[arg-type]
    # expressions
    "lower must be a finite real number, got 'a'": lambda: real("k", 1, "a", 2),  # type: ignore[arg-type]
    "must be one number or those of both ends, got 'x'": lambda: real("k", 1, percent="x"),  # type: ignore[arg-type]
    "dt must be positive, got 'a'": lambda: z("a"),  # type: ignore[arg-type]
    "must have rows of expressions and numbers, got None": lambda: matrix(None),
    "numbers of an expression must be finite, got": lambda: np.inf / (s + 1),
    "expression must be proper": lambda: (s * K).system(),
    ".*expression must be proper": lambda: ((s + K) ** 3 / (s + M) ** 2).system(),
    "must have a value at the nominal elements": lambda: (1 / (K - K)).system(),
    "entries of a matrix must fit": lambda: matrix([[K, 1], [2]]),
    "matrix must have rows of expressions and numbers, got": lambda: matrix([[K, "a"]]),
    "sum must be of expressions of the same size, got 2 x 1 and 2 x 2": lambda: COLUMN + np.eye(2),
    "product must be of matrices that fit, got 2 x 1 and 2 x 1": lambda: COLUMN @ COLUMN,
    "inverse must be of a square expression, got 2 x 1": lambda: COLUMN.inverse(),
    "parameter 'k' must have one definition": lambda: K + real("k", 1.0, 0.9, 2.0),
    "element 'k' must have one definition": lambda: K + complex_gain("k", 1.0, 0.9),
    r"ports must have 1 signals, got a\[1\], b\[1\]": lambda: K.system(["a", "b"]),
    "exponent must be an integer, got 0.5": lambda: K**0.5,
    "transpose must be of an expression without matrices of dynamics": lambda: dynamic("d", 2, 1).T,
    "lower <= nominal <= upper, got 2.0 <= 1.0 <= 0.5$": lambda: real("k", 1.0, 2.0, 0.5),
    r"must be in \[0.5, 2\], got 7$": lambda: K.at(k=7.0),
    "lower and upper or plus_minus, got percent of nominal 0": lambda: real("k", 0.0, percent=10),
    "radius must be positive, got 0.0": lambda: complex_gain("c", 1.0, 0.0),
    "sizes must be at least 1, got 0 x 1": lambda: dynamic("d", 0),
    "bound must be positive, got -1.0": lambda: dynamic("d", bound=-1.0),
    # elements and ports
    "size of port 'u' must be an integer, got 2.5": lambda: Port("u", 2.5),  # type: ignore[arg-type]
    "size of port 'u' must be an integer, got '2'": lambda: Port("u", "2"),  # type: ignore[arg-type]
    "name of a port must be text, got 3": lambda: Port(3, 1),  # type: ignore[arg-type]
    r"a port must be a Port or \(name, size\), got 'u'": lambda: System([], [], [], ONE, ["u"], ["y"]),  # type: ignore[list-item]
    "dt must be a finite real number, got '0.1'": lambda: System([], [], [], ONE, U, Y, dt="0.1"),  # type: ignore[arg-type]
    "'k': nominal must be a finite real number, got '1'": lambda: RealParameter("k", "1", 0.0, 2.0),  # type: ignore[arg-type]
    "'c': nominal must be a finite real number, got 1j": lambda: ComplexParameter("c", 1j, 2.0),  # type: ignore[arg-type]
    "'d': outputs must be an integer, got 1.5": lambda: DynamicElement("d", 1.5),  # type: ignore[arg-type]
    # conversions
    "system must be in continuous time, got sampling period 0.1 s": lambda: frequency_response(
        from_control(discrete(0.1)), [1.0]
    ),
    "must have a sampling period in seconds, got dt True": lambda: from_control(discrete(True)),
    "must have a sampling period in seconds, got dt 0": lambda: SampledSystem.from_control(discrete(0)),
    "must have a sampling period in seconds, got dt None": lambda: SampledSystem.from_control(discrete(None)),
    r"control\.StateSpace or control\.TransferFunction, got FrequencyResponse": lambda: from_control(RESPONSES),
    r"control\.TransferFunction, got FrequencyResponse": lambda: SampledSystem.from_control(RESPONSES),
    r"input port must have a name without an index to become labels, got 'w\[0\]'": lambda: System.static(
        [[1.0, 2.0, 3.0]], [("w", 2), ("w[0]", 1)], Y
    ).to_control(),
    r"dt must be positive, got 0\.0": lambda: to_discrete(ONE, ONE, ONE, ONE, 0.0),
    "dt must be positive, got nan": lambda: to_discrete(ONE, ONE, ONE, ONE, np.nan),
    "method must be one of": lambda: sampled(NOTHING, 1e-2, method="magic"),  # type: ignore[arg-type]
    "proper transfer function": lambda: transfer([1, 0, 0], [1, 1]),
    # connections
    "need 2 x 1": lambda: close_loop(WIDE, System.static(ONE, Y, U), ["u"], ["y"]),
    "channel u -> y must be invertible": lambda: invert(NOTHING, {"u": "y"}),
    "must be square": lambda: invert(WIDE, {"u": "y"}),
    "sign must be": lambda: parallel(NOTHING, NOTHING, 0.5),
    "parallel systems must have the same ports": lambda: parallel(NOTHING, WIDE),
    "port names must be unique, got 'v' twice": lambda: star(BESIDE, BESIDE, {"upper.y": "lower.u"}),
    "must be 2 x 3": lambda: transform(WIDE, inputs={"u": (np.eye(2), Port("x", 3))}),
    "'b.u' must have one driver, got two: a.y and r": lambda: wired([*ENDS[:1], ("a.y", "b.u"), ("r", "b.u")]),
    "every input must have a driver, got none for b.u": lambda: wired(ENDS[:1]),
    "every input must have a driver, got none for a.u, b.u": lambda: wired([]),
    "input must be one of a.u, b.u, got 'b.w'": lambda: wired([("r", "a.u"), ("a.y", "b.w")]),
    "source must be one of .*, got 'c.y'": lambda: wired([("r", "a.u"), ("c.y", "b.u")]),
    "empty|at least one": lambda: wired([((), "a.u"), ("r", "b.u")]),
    "same size, got 1 and 2": lambda: wired([("r", "a.u"), ("a.y", "b.u")], b=Port("u", 2)),
    "same size": lambda: wired(ENDS, ("a.y", "s")),
    "same unit, got '1' and 'N'": lambda: wired([("r", "a.u"), ("a.y", "b.u")], b=Port("u", 1, "N")),
    "c.y": lambda: wired(ENDS, "c.y"),
    "must be well posed": lambda: wired([("b.y", "a.u"), ("a.y", "b.u")]),
    "must not contain a dot": lambda: wired([], names=("a.x", "b")),
    # structures and requirements that are made of them
    "at least one port": lambda: HinfGain((), "z"),
    "bound of a gain requirement must be positive": lambda: HinfGain("w", "z", bound=0.0),
    "must be stable": lambda: HinfGain("w", "z", weight_out=transfer([1], [1, 0])),
    "needs min_decay, min_damping or max_frequency": lambda: ClosedLoopPoles(),
    "form must be one of": lambda: structures.state_space(Y, U, 2, form="jordan"),
    "outside the 3 x 3 gain matrix": lambda: structures.state_space(Y, U, 2).with_fixed({(9, 0): 1.0}),
}
"""What the message must match: what is wrong."""


@pytest.mark.parametrize("message", REFUSED)
def test_it_is_refused_in_one_line(message: str) -> None:
    with pytest.raises(ValueError, match=message) as refused:
        REFUSED[message]()
    assert "\n" not in str(refused.value)


P = RealParameter("p", 0.0, -1.0, 1.0)
MATRICES = [[-1.0]], [[1.0, 1.0]], [[1.0], [1.0]], [[0.0, 0.0], [0.0, 0.0]], [("u", 1)], [("y", 1)]
UNCERTAIN = System(*MATRICES, channels=("p",), elements=(P,))
NOMINAL = UNCERTAIN.nominal()


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda wrong: NOMINAL(wrong), "point must be a finite number"),
        (lambda wrong: UNCERTAIN.sorted_channels(wrong), "order must name p"),
        (lambda wrong: System(*MATRICES, channels=wrong, elements=(P,)), "channels must be a sequence of names"),
        (lambda wrong: System(*MATRICES, channels=("p",), elements=wrong), "elements must be a sequence of elements"),
        (lambda wrong: sampled(NOMINAL, 0.1, provenance=wrong), "provenance must be a mapping"),
        (to_json, "system must be a System"),
        (to_scipy, "system must be a System"),
    ],
)
@pytest.mark.parametrize("wrong", [object(), [None], ["q", 3]])
def test_another_type_is_a_line(call: Callable[[Any], Any], message: str, wrong: Any) -> None:
    with pytest.raises(InputError, match=message):
        call(wrong)


def test_a_message_is_one_line_whatever_came() -> None:
    """The text of a system has several."""
    with pytest.raises(InputError) as caught:
        balred(NOMINAL, NOMINAL)
    assert "\n" not in str(caught.value)


PLANT = lk.static_gain([[2.0]], [Port("u", 1)], [Port("y", 1)])
FEW = TuningOptions(starts=1, iterations=3)
LAW, GOAL = gain([("y", 1)], [("u", 1)]), HinfGain("u", "y")
WRONG = {
    "None": None,
    "text": "text",
    "names": ["a", "b"],
    "complex": 1 + 2j,
    "NaN": float("nan"),
    "mapping": {"a": object()},
    "nothing": np.zeros(0),
    "three axes": np.ones((3, 2, 2)),
    "function": lambda: None,
    "bytes": b"x",
    "integers": [1, 2],
    "integer": 0,
    "beyond 64 bits": 10**30,
    "beyond a double": 10**400,
    "nested": [[None]],
}
CERTIFICATE = MuCertificate(2.0, (np.eye(1, dtype=complex),), (np.zeros((1, 1), dtype=complex),))
CALLS: list[tuple[Callable[..., Any], dict[str, Any]]] = [
    (lk.cascade, {"first": PLANT, "second": PLANT}),
    (lk.close_loop, {"plant": PLANT, "controller": PLANT, "inputs": ["u"], "outputs": ["y"]}),
    (lk.connect, {"systems": {"G": PLANT}, "connections": [("u", "G.u")], "outputs": {"y": "G.y"}}),
    (lk.disk_margin, {"loop": PLANT, "skew": 0.0}),
    (lk.from_json, {"text": "{}"}),
    (lk.high_pass, {"port": Port("u", 1), "corner": 1.0}),
    (lk.invert, {"system": PLANT, "channels": {"u": "y"}}),
    (lk.minimal_realisation, {"system": PLANT, "tolerance": 1e-11}),
    (lk.read_mat, {"path": "none.mat", "name": "G"}),
    (lk.read_system, {"path": "none.json"}),
    (lk.transfer, {"num": [1.0], "den": [1.0, 1.0], "size": 1}),
    (lk.transform, {"system": PLANT, "inputs": {"u": ([[1.0]], Port("v", 1))}, "outputs": {}}),
    (lk.SampledSystem.from_file, {"path": "none.json"}),
    (PLANT.select, {"inputs": ["u"], "outputs": ["y"]}),
    (PLANT.input_port, {"name": "u"}),
    (BoundOptions, {"gap": 0.1, "max_tests": 1}),
    (complex_block, {"repeated": 1}),
    (mu, {"M": np.eye(1), "structure": [complex_block()], "starts": 1}),
    (HinfGain, {"inputs": "u", "outputs": "y", "bound": 1.0}),
    (ClosedLoopPoles, {"max_frequency": 1.0}),
    (check_mu, {"M": np.eye(1), "structure": [complex_block()], "certificate": CERTIFICATE}),
    (descend, {"source": None, "x": np.zeros(1), "report": print}),
    (Margins, {"location": "u", "gain_margin": 2.0}),
    (partial(tune, options=FEW), {"models": [PLANT], "requirements": [GOAL], "structure": LAW, "initial": [[0.1]]}),
]


@pytest.mark.parametrize("wrong", WRONG.values(), ids=WRONG)
@pytest.mark.parametrize(("call", "given"), CALLS, ids=[getattr(call, "__qualname__", "tune") for call, _ in CALLS])
def test_no_argument_leads_to_a_fault(call: Callable[..., Any], given: dict[str, Any], wrong: Any) -> None:
    """It is accepted, or refused in one line."""
    for name in given:
        with contextlib.suppress(ValueError):
            call(**{**given, name: wrong})


def test_the_file_to_be_written_is_named() -> None:
    with pytest.raises(InputError, match="path must be text or a path, got None"):
        lk.write_system(None, PLANT)  # type: ignore[arg-type]
    with pytest.raises(InputError, match="system must be a System"):
        lk.write_system(Path("never.json"), None)  # type: ignore[arg-type]
    assert not Path("never.json").exists()


def test_a_fault_with_arguments_of_the_right_types_stays() -> None:
    @checked
    def wanting(values: dict[str, float], others: tuple[float, ...] = ()) -> float:
        return values["missing"] + sum(others)

    with pytest.raises(KeyError):
        wanting({"a": 1.0})
    with pytest.raises(TypeError, match="positional"):
        wanting({}, (), ())  # type: ignore[call-arg]
    with pytest.raises(InputError, match="others must be a sequence of numbers, got 'b'"):
        wanting({"missing": 1.0}, "b")  # type: ignore[arg-type]


def test_a_large_integer_is_the_number_that_it_is() -> None:
    """For numpy one beyond 64 bits is an object."""
    assert HinfGain("u", "y", bound=10**30).bound == 1e30
    assert ClosedLoopPoles(max_frequency=10**30).max_frequency == 1e30
    with pytest.raises(InputError, match="dt must be positive, got 1000"):
        sampled(NOMINAL, 10**400)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda big: lk.transfer([1.0], [1.0, 1.0], size=big), "size must be an integer within 64 bits, got 1000"),
        (
            lambda big: structures.state_space(Y, U, big),
            "order must be an integer within 64 bits, got 1000",
        ),
        (lambda big: gain([("y", big)], [("u", 1)]), "size of port 'y' must be an integer within 64 bits, got 1000"),
        (lambda big: LAW.with_bounds({"D[0,0]": (0.0, big**14)}), "bound of D.0,0. must be a finite real number"),
        (lambda big: LAW.with_fixed({"D[0,0]": big**14}), "value of D.0,0. must be a finite real number"),
        (lambda big: Bounds([0.0], [big**14]), "upper must be an array of numbers, got .1000"),  # type: ignore[arg-type]
        (lambda big: System([[big**14]], *MATRICES[1:]), "A must be a rectangular array of real numbers"),
        (lambda big: TuningOptions(seed=-big), "seed must be zero or positive"),
    ],
)
def test_sizes_and_bounds_beyond_those_of_arrays_are_named(call: Callable[[int], Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        call(10**30)


def test_the_checks_of_others_name_their_arguments() -> None:
    with pytest.raises(InputError, match="certificate must be a MuCertificate, got None"):
        check_mu(np.eye(1), [complex_block()], None)  # type: ignore[arg-type]
    with pytest.raises(InputError, match="source must be a DescentSource, got None"):
        descend(None, np.zeros(1))  # type: ignore[arg-type]


@pytest.mark.parametrize("package", ["lftkit", "lftkit.synthesis", "lftkit.proofs", "lftkit.tuning"])
def test_every_public_function_names_its_arguments(package: str) -> None:
    public = import_module(package)
    functions = {name: getattr(public, name) for name in public.__all__}
    bare = [n for n, f in functions.items() if inspect.isfunction(f) and not hasattr(f, "__wrapped__")]
    assert bare == []
