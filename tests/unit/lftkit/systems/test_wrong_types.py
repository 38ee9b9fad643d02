"""Arguments of other types than the documented ones are one line, not a fault of the program."""

from __future__ import annotations

import contextlib
import inspect
from collections.abc import Callable
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import lftkit as lk
from lftkit import InputError, Port, RealParameter, System, balred, sampled, to_json, to_scipy
from lftkit.proofs import BoundOptions, MuCertificate, check_mu, complex_block, mu
from lftkit.systems.arguments import checked
from lftkit.tuning import ClosedLoopPoles, HinfGain, Margins, TuningOptions, descend, gain, state_space, tune
from lftkit.tuning.structures.bounds import Bounds

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
        (lambda big: state_space([("y", 1)], [("u", 1)], big), "order must be an integer within 64 bits, got 1000"),
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
