"""Outcome of a run with processes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from los_testbed.config.run_config import RunConfig
from los_testbed.config.topics import LATE_REPORTS, LIVELINESS_LOST, REPORT_DEADLINE_S
from pointing_analysis.command.exit_codes import ExitCode

MAX_MISSED = float(RunConfig.SETTINGS["max_missed"].default)
"""Percent of the ticks of a run in real time that may be missed."""


class RunError(RuntimeError):
    """A node failed; `code` is the exit code that fits."""

    def __init__(self, message: str, code: int = 1) -> None:
        super().__init__(message)
        self.code = code


@dataclass(frozen=True)
class Exercised:
    """Answers to the ticks with which the loop was tried before a run.

    Parameters
    ----------
    ticks, late, lost : int
        Ticks that were sent, those of them without an answer within their period, and periods that the plant lost.
    median_us : float
        Median time from a tick to its answer [us]; 0 without any.
    """

    ticks: int
    late: int
    lost: int
    median_us: float

    @property
    def share(self) -> float:
        """Late answers [%].

        Examples
        --------
        >>> Exercised(1400, 7, 0, 300.0).share
        0.5
        """
        return 100.0 * self.late / max(self.ticks, 1)


def in_statistics(exercised: Exercised) -> dict[str, str]:
    """As the statistics of the plant have it."""
    return {
        "exercised_ticks": str(exercised.ticks),
        "exercised_late": str(exercised.late),
        "exercised_lost": str(exercised.lost),
        "exercised_median_us": f"{exercised.median_us:.0f}",
    }


def check_missed(share: float, config: RunConfig, rest: str = "") -> None:
    """Reject a real-time run with too many missed ticks.

    Parameters
    ----------
    share : float
        Missed ticks [%].
    config : RunConfig
    rest : str
        End of the message.

    Raises
    ------
    RunError
        More than ``max_missed``.

    Examples
    --------
    >>> check_missed(0.4, RunConfig())
    >>> check_missed(24.0, RunConfig(mode="lockstep"))
    """
    if config.mode != "realtime" or share <= config.max_missed:
        return
    remedy = "" if config.device else "; --mode lockstep misses none"
    raise RunError(
        f"missed ticks must be at most {config.max_missed:g} % (--max-missed), got {share:.2f} %: a node, or this "
        f"machine, was too slow or too busy for the loop{remedy}{rest}",
        ExitCode.MISSED_TICKS,
    )


def counted(statistics: Mapping[str, Mapping[str, str]], beginning: str) -> dict[str, int]:
    """Largest count that a node has of each topic, from the statistics whose names begin so.

    Examples
    --------
    >>> counted({"plant": {"foreign_/a": "3"}, "recorder": {"foreign_/a": "5", "messages": "9"}}, "foreign_")
    {'/a': 5}
    """
    counts: dict[str, int] = {}
    for values in statistics.values():
        for name, text in values.items():
            if name.startswith(beginning) and text.isdecimal():
                topic = name.removeprefix(beginning)
                counts[topic] = max(counts.get(topic, 0), int(text))
    return counts


def late_reports(recorder: Mapping[str, str]) -> list[str]:
    """Lines about nodes with late reports, from the statistics of the recorder.

    Examples
    --------
    >>> late_reports({"late_reports_plant": "2", "liveliness_lost_plant": "1", "messages": "9"})
    ['plant: 2 reports missed their deadline of 3 s, its liveliness was lost 1 times']
    """
    late, lost = (counted({"recorder": recorder}, kind) for kind in (LATE_REPORTS, LIVELINESS_LOST))
    return [
        f"{name}: {late.get(name, 0)} reports missed their deadline of {REPORT_DEADLINE_S:g} s, "
        f"its liveliness was lost {lost.get(name, 0)} times"
        for name in sorted({*late, *lost})
    ]


@dataclass
class Results:
    """Results of a run, from the last reports of the nodes.

    Attributes
    ----------
    statistics : last statistics of each node
    bag : folder of the bag; None if nothing was recorded
    warnings, failures : what was not permitted; which nodes ended unexpectedly, one line each
    latency : histogram of the plant's latencies, microseconds to counts
    earlier : bags of the same run from before its plant was started again
    interrupted : whether the run was ended before its time
    too_slow : measured trial if the machine was too slow for the run to begin; else None
    """

    statistics: dict[str, dict[str, str]] = field(default_factory=dict)
    bag: Path | None = None
    warnings: list[str] = field(default_factory=list)
    failures: list[str] = field(default_factory=list)
    latency: dict[int, int] = field(default_factory=dict)
    earlier: list[Path] = field(default_factory=list)
    interrupted: bool = False
    too_slow: Exercised | None = None
