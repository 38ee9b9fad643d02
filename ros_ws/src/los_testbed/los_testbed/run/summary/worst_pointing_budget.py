"""Budget over the box of a telescope's parameters: its total at many members beside the one at a point.

The members are those that the search of the design found worst, and random ones. The largest total is the largest that
was found, no bound: what is proven of tones over the whole box are the certificates.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from los_testbed.config.members import MEMBER, random_member, worst_member
from los_testbed.config.run_settings import layered
from pointing_analysis.budget.file import PointingBudget
from pointing_analysis.budget.result_table import name_of
from pointing_analysis.budget.total import PointingBudgetVerdict, evaluate

Overlay = Callable[[Mapping[str, Any]], Mapping[str, Any]]
"""From a table of type ``testbed`` to that of a member."""

Loader = Callable[[Overlay], PointingBudget]
"""Makes a budget with its tables of type ``testbed`` changed."""

WORST = ("APE", "slow", "fast")
"""Figures of merit whose worst points are members."""


@dataclass(frozen=True)
class WorstTotal:
    """A requirement over the members.

    Parameters
    ----------
    at : PointingBudgetVerdict
        At the point that the budget names.
    worst : PointingBudgetVerdict
        With the largest total.
    member : str
        Its name.
    settings : mapping
        Its parameters, as settings of a run.
    count : int
        Number of members.
    """

    at: PointingBudgetVerdict
    worst: PointingBudgetVerdict
    member: str
    settings: Mapping[str, Any]
    count: int

    @property
    def name(self) -> str:
        """Of the requirement, as in the table of results."""
        return name_of(self.at)

    def as_dict(self) -> dict[str, Any]:
        """For JSON."""
        return {
            "requirement": str(self.at.requirement),
            "at_the_point": self.at.total,
            "worst": self.worst.total,
            "margin": self.worst.margin,
            "member": self.member,
            "settings": dict(self.settings),
            "members": self.count,
        }


def members_of(table: Mapping[str, Any], designs: str, count: int) -> dict[str, dict[str, Any]]:
    """Members of the telescope of a table of type ``testbed``: the worst points of its stage, and random ones."""
    parameters, loop = table.get("settings", {}).get("parameters"), str(table.get("loop", "fsm+pma"))
    worst = {f"worst for {index}": worst_member(loop, index, parameters, designs) for index in WORST}
    drawn = {f"random, seed {seed}": random_member(seed, parameters) for seed in range(count)}
    return {name: member for name, member in (worst | drawn).items() if member}


def of_member(table: Mapping[str, Any], member: Mapping[str, Any]) -> dict[str, Any]:
    """The table for a member: its parameters stand in place of those of the table."""
    kept = {key: value for key, value in table.get("settings", {}).items() if key not in MEMBER}
    return {**table, "settings": layered(kept, member)}


def worst_totals(
    load: Loader,
    at: Sequence[PointingBudgetVerdict],
    members: Mapping[str, Mapping[str, Any]],
    tick: Callable[[int], None] = lambda done: None,
) -> tuple[WorstTotal, ...]:
    """The largest total of each requirement over some members.

    Parameters
    ----------
    load : callable
        Makes the budget with its tables of type ``testbed`` changed.
    at : sequence of PointingBudgetVerdict
        At the point of the budget.
    members : mapping
        Name to settings.
    tick : callable
        Called with the number of members that are done.
    """
    by_member: list[tuple[str, tuple[PointingBudgetVerdict, ...]]] = []
    for done, (name, member) in enumerate(members.items(), start=1):
        by_member.append((name, evaluate(load(lambda table, member=member: of_member(table, member)))))  # type: ignore[misc]
        tick(done)
    rows = []
    for k, verdict in enumerate(at):
        name, worst = max(((name, verdicts[k]) for name, verdicts in by_member), key=lambda entry: entry[1].total)
        rows.append(WorstTotal(verdict, worst, name, members[name], len(members)))
    return tuple(rows)
