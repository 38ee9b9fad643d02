"""Bad input of systems, ports, connections and conversions: one line that names what is wrong, and what came."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import control
import numpy as np
import pytest

from lftkit import (
    Port,
    RealParameter,
    SampledSystem,
    System,
    connect,
    dynamic,
    from_control,
    invert,
    matrix,
    parallel,
    real,
    s,
    star,
    state_space,
    static_gain,
    transform,
    z,
)
from lftkit.analysis.frequency_response import frequency_response
from lftkit.systems.connection.feedback import close_loop
from lftkit.systems.connection.filters import transfer
from lftkit.systems.sampled.bilinear import to_discrete
from lftkit.systems.sampling import sampled
from lftkit.tuning.requirements import ClosedLoopPoles, HinfGain
from lftkit.tuning.structures import structures

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
