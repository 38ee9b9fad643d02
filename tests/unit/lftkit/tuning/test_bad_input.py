"""Bad input of tuner, goals, structures and worst-case search: one line that names what is wrong, and what came."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from support.worst_case_plants import GAIN, OPEN, oscillator

from lftkit import System, discretise, real, s
from lftkit.tuning import (
    ClosedLoopPoles,
    ConicSector,
    Decentralised,
    H2Gain,
    HinfGain,
    Margins,
    MinLoopGain,
    Overshoot,
    Passivity,
    RobustOptions,
    Sensitivity,
    StableStateSpace,
    Tracking,
    TuningOptions,
    WorstCaseOptions,
    certify,
    gain,
    pid,
    plot_goals,
    tune,
    tune_discrete,
    tune_robust,
    worst_case,
)
from lftkit.tuning.goals import resolved

NEED = [HinfGain("w", "z")]
LAW = gain([("y", 1)], [("u", 1)])
PID, SAMPLED_PID = (pid("y", "u", derivative_filter=0.5, dt=dt) for dt in (0.0, 0.2))
BOTH = Decentralised((gain([("y", 1)], [("a", 1)]), pid("y", "b", derivative_filter=0.1)))
PORTS: Any = [("w", 1), ("u", 1)], [("z", 1), ("effort", 1), ("y", 1)]
LAG = System([[-1]], [[1, 1]], [[1], [0], [1]], [[0, 0], [0, 1], [0, 0]], *PORTS, "lag")
SAMPLED = discretise(LAG, 0.1)
LOUD = System([[-1]], [[0, 1]], [[0], [1]], [[0, 1], [1, 0]], [("n", 1), ("u", 1)], [("effort", 1), ("y", 1)])
FORCED = System([[-1]], [[1, 1]], [[1], [0], [1]], [[0, 0], [0, 0], [0, 0]], *PORTS)
K = System.static([[-1.0]], [("y", 1)], [("u", 1)], "K")
SAMPLED_K = replace(K, dt=0.1)
STRETCHED = replace(K, dt=0.3)
TWO, LINES = np.eye(2), np.ones((3, 1))
BOX: dict[str, tuple[float, float]] = {"a": (0.0, 1.0)}
SPRING = real("k", 1.0, percent=10)


def tuned(models: Any = (LAG,), needs: Any = NEED, structure: Any = LAW, **more: Any) -> Any:
    return tune(models, needs, structure, options=TuningOptions(starts=1, target=1e6), **more)


def discrete(needs: Any = NEED, structure: Any = LAW, models: Any = (SAMPLED,)) -> Any:
    return tune_discrete(models, needs, structure, options=TuningOptions(starts=1))


def searched(box: Any, **options: Any) -> Any:
    return worst_case(oscillator, box, OPEN, [GAIN], options=WorstCaseOptions(**options))


REFUSED: dict[str, Callable[[], Any]] = {
    "at least one model": lambda: tuned([]),
    "at least one requirement": lambda: tuned(needs=[]),
    "output port must be one of z, effort, y, got 'position'": lambda: tuned(needs=[HinfGain("w", "position")]),
    "no measurement port 'x'; there are z, effort, y": lambda: tuned(structure=gain([("x", 1)], [("u", 1)])),
    "has size 1, the controller has 2": lambda: tuned(structure=gain([("y", 2)], [("u", 1)])),
    "a start must be 1 finite parameters": lambda: tuned(initial=[[1.0, 2.0]]),
    "names must be unique": lambda: tuned(needs=NEED * 2),
    "direct feedthrough": lambda: tuned([LOUD], [H2Gain("n", "effort")]),
    "got discrete ones: tune_discrete takes them$": lambda: tuned([SAMPLED]),
    r"must be certain.*got elements k$": lambda: tuned([(SPRING / (s**2 + s + SPRING)).system("u", "y")]),
    r"^options must be RobustOptions, got TuningOptions$": lambda: tune_robust(
        oscillator, BOX, NEED, LAW, options=TuningOptions()
    ),
    "hold must be positive, got 0": lambda: TuningOptions(hold=0.0),
    "slack.*-0.1": lambda: RobustOptions(slack=-0.1),
    "max_rounds.*0": lambda: RobustOptions(max_rounds=0),
    "carried.*0": lambda: RobustOptions(carried=0),
    r"first_share.*0\.0": lambda: RobustOptions(first_share=0.0),
    r"round_share.*1\.1": lambda: RobustOptions(round_share=1.1),
    # discrete time
    r"^structure of u must be made for sampling period 0\.1 s, got continuous time$": lambda: discrete(structure=PID),
    r"^structure of u must be made for sampling period 0\.1 s, got sampling period 0\.2 s$": lambda: discrete(
        structure=Decentralised((SAMPLED_PID,))
    ),
    r"^structure of u must be made for continuous time, got sampling period 0\.2 s$": lambda: tuned(
        structure=SAMPLED_PID
    ),
    "must have entries of discrete matrices, got StableStateSpace": lambda: discrete(
        structure=StableStateSpace([("y", 1)], [("u", 1)], 1)
    ),
    r"sampling period must be 0\.1 s, got 0\.2 s$": lambda: discrete(models=[SAMPLED, replace(SAMPLED, dt=0.2)]),
    r"band must begin below pi / T = 31\.4159 rad/s, got 40$": lambda: discrete(
        [HinfGain("w", "z", band=(40.0, 50.0))]
    ),
    r"loop_delay must be 0 in discrete time, where delays are states, got 0\.1 s": lambda: certify(
        [SAMPLED], SAMPLED_K, NEED, 0.1
    ),
    r"loop_delay must be 0 in discrete time, where delays are states, got 0\.2 s": lambda: worst_case(
        lambda _: SAMPLED, BOX, SAMPLED_K, NEED, loop_delay=0.2
    ),
    "same sampling period": lambda: certify([SAMPLED], STRETCHED, NEED),
    ".*same sampling period": lambda: worst_case(lambda _: SAMPLED, BOX, STRETCHED, NEED),
    # boxes and options of the worst-case search
    "box of parameters is empty": lambda: searched({}),
    "'swapped': expected finite bounds": lambda: searched({**BOX, "swapped": (1.0, 0.0)}),
    "'nan': expected finite bounds": lambda: searched({"nan": (0.0, np.nan)}),
    "'open': expected finite bounds": lambda: searched({"open": (-np.inf, 0.0)}),
    "samples": lambda: searched(BOX, samples=-1),
    "climbs": lambda: searched(BOX, climbs=-1),
    "iterations": lambda: searched(BOX, iterations=0),
    "step.*got 0.0": lambda: searched(BOX, step=0.0),
    "step.*got 0.1": lambda: searched(BOX, step=0.1),
    # structures
    r"^entry \(2, 2\) depends on Kp and Kd: fix parameters by name$": lambda: PID.with_fixed({(2, 2): 1.0}),
    "^parameter must be one of Kp, Ki, Kd, got 'Kx'$": lambda: PID.with_fixed({"Kx": 1.0}),
    r"^Kd must be fixed once, got 1 and 0\.5$": lambda: PID.with_fixed({"Kd": 1.0, (2, 1): -1.0}),
    "^value of Kd must be finite, got nan$": lambda: PID.with_fixed({"Kd": np.nan}),
    r"^parameter must be one of a.D\[0,0\], b.Kp, b.Ki, b.Kd, got 'a.Kp'$": lambda: BOTH.with_fixed({"a.Kp": 1.0}),
    r"^entry \(2, 0\) of the gain matrix is in no part": lambda: BOTH.with_fixed({(2, 0): 1.0}),
    "^parameters of u cannot be fixed or bounded, got a StableStateSpace": lambda: Decentralised(
        (StableStateSpace([("y", 1)], [("u", 1)], 1),)
    ).with_fixed({"u.x[0]": 1.0}),
    r"start of D\[0,0\] must be within its bounds \(-3, 0\), got 7": lambda: tuned(
        structure=LAW.with_bounds({"D[0,0]": (-3.0, 0.0)}), initial=[[7.0]]
    ),
    "must be a lowest and a higher highest value.*": lambda: LAW.with_bounds({"D[0,0]": (1.0, 1.0)}),
    "must be a lowest and a higher highest value": lambda: LAW.with_bounds({"D[0,0]": (np.nan, 1.0)}),
    # goals and their weights
    "band must be a lowest and a higher highest frequency": lambda: HinfGain("w", "z", band=(3.0, 1.0)),
    "gain_margin or phase_margin must ask for something, got 1 and 0": lambda: Margins("u"),
    "gain_margin must be at least 1": lambda: Margins("u", gain_margin=0.5),
    "location must name at least one command or measurement of the controller": lambda: Sensitivity(()),
    r"crossover must be positive \[rad/s\], got -1": lambda: MinLoopGain("u", crossover=-1.0),
    "response_time must be positive, got 0": lambda: Tracking("w", "z", response_time=0.0),
    "percent must be between 0 and 100, got 0": lambda: Overshoot("w", "z", percent=0.0),
    "location must be an input or an output of .*; got 'v'": lambda: resolved([LAG], [Sensitivity("v")]),
    "a design needs at least one model, got none": lambda: resolved([], [Sensitivity("u")]),
    "must be below 1/4, got 1.0 and 0.3": lambda: Passivity("w", "z", input_index=1.0, output_index=0.3),
    "output_index finite and not negative": lambda: Passivity("w", "z", output_index=-0.1),
    "unit must be positive, got 0.0": lambda: Passivity("w", "z", unit=0.0),
    "low must be below high, one of them finite, got 1.0 and 1.0": lambda: ConicSector("w", "z", low=1.0, high=1.0),
    "one of them finite": lambda: ConicSector("w", "z", low=-np.inf),
    "as many outputs as inputs, got 2 and 1": lambda: resolved([LAG], [Passivity("w", ("z", "y"))]),
    "a hard goal must have a band that ends before": lambda: resolved([FORCED], [Passivity("w", "z", hard=True)]),
    "a hard goal must have a band": lambda: resolved([FORCED], [ConicSector("w", "z", 0.0, 2.0, hard=True)]),
    "HinfGain w -> z: weight_out must have 1 inputs, as many as z, got 2": lambda: tuned(
        needs=[HinfGain("w", "z", weight_out=TWO)]
    ),
    "weight_out must have 2 inputs, as many as z[+]y, got 1": lambda: tuned(
        needs=[HinfGain("w", ("z", "y"), weight_out=2.0)]
    ),
    "weight_in must have 1 outputs, as many as w, got 3": lambda: discrete([HinfGain("w", "z", weight_in=LINES)]),
    "H2Gain w -> z: weight_in must have 1 outputs, as many as w, got 3": lambda: tuned(
        needs=[H2Gain("w", "z", weight_in=LINES)]
    ),
    "H2Gain w -> z: weight_out must have 1 inputs, as many as z, got 2": lambda: discrete(
        [H2Gain("w", "z", weight_out=TWO)]
    ),
    "Sensitivity u: weight_out must have 1 inputs, as many as u.applied, got 2": lambda: tuned(
        needs=[Sensitivity("u", weight=TWO)]
    ),
    "weight_out must have 1 inputs, as many as z, got 2": lambda: certify(
        [LAG], K, [HinfGain("w", "z", weight_out=TWO)]
    ),
    "weight_out must have 1 inputs, as many as z": lambda: worst_case(
        lambda _: LAG, BOX, K, [HinfGain("w", "z", weight_out=TWO)]
    ),
    "^weight_out: system must be a System, .* got str$": lambda: HinfGain("w", "z", weight_out="low-pass"),  # type: ignore[arg-type]
    "^weight: system must be a System, .* got str$": lambda: Sensitivity("u", weight="low-pass"),  # type: ignore[arg-type]
    "^weight_out: .* must be certain .* got elements k$": lambda: HinfGain("w", "z", weight_out=1 / (s + SPRING)),
    "must be stable": lambda: HinfGain("w", "z", weight_out=1 / (s - 1)),
    r"^K: controller must make every loop stable": lambda: plot_goals(replace(LAG, A=[[5.0]]), [Sensitivity("u")], K),  # type: ignore[arg-type]
}
"""What the message must match: what is wrong."""


@pytest.mark.parametrize("message", REFUSED)
def test_it_is_refused_in_one_line(message: str) -> None:
    with pytest.raises(ValueError, match=message) as refused:
        REFUSED[message]()
    assert "\n" not in str(refused.value)


def test_what_is_at_the_limits_is_taken() -> None:
    options = WorstCaseOptions(samples=0, climbs=0, iterations=1, step=0.099)
    assert (options.samples, options.climbs, options.iterations) == (0, 0, 1)
    resolved([FORCED], [Passivity("w", "z", input_index=-0.01, hard=True)])
    assert tuned(needs=[H2Gain("w", "effort"), *NEED]).feasible, "no feedthrough from w to the effort: a finite norm"
    assert tuned([LAG], [ClosedLoopPoles(min_decay=0.5), *NEED]).feasible
