"""Disturbances and telescope of a run, from its recording: figures of two runs are compared for equal ones."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from pointing_analysis.read.recording import Recording

ACTING = "acting"
"""Key of what acts in the metadata of a bag: a list of entries with name, kind and, where there is more to say, what.
An empty list: no disturbance."""
LINES = "lines_rad_s"
"""Key of an entry of a source with tones: their frequencies [rad/s]."""
MEMBER = "member"
"""Key of the telescope's parameter values in the metadata of a bag, in words."""
WHEEL_SPEEDS = "wheel_speeds_rad_s"
"""Key of the wheels' speeds at the start [rad/s], signed, those of the parameter file included."""
TELESCOPE = "parameters_hash"
"""Key of the hash of the telescope's parameter file."""
START_UP, MEASURED = "start_up", "measured"
"""Key and value of a run that does not begin in its steady state (:mod:`pointing_analysis.requirements.settling`)."""
NEVER = "never ends"
"""Value of a run whose loop is known to be unstable: no record of it says what a longer one would."""
NOTHING = "no disturbance"


@dataclass(frozen=True)
class Conditions:
    """Disturbances of a run, and the telescope.

    Attributes
    ----------
    names : tuple of str
        Of the disturbances, or their absence; empty if the recording does not state them.
    acting : tuple of str
        The same with tone, kind and place.
    member : str
        Parameter values of the telescope; empty where they are not known.
    telescope : str
        Of its parameter file.
    """

    names: tuple[str, ...] = ()
    acting: tuple[str, ...] = ()
    member: str = ""
    telescope: str = ""

    @property
    def lines(self) -> tuple[tuple[str, str], ...]:
        """Label and text of each line for screen and page."""
        rows = ("sources", "; ".join(self.acting)), ("member", self.member)
        return tuple((label, text) for label, text in rows if text)


UNKNOWN_CONDITIONS = Conditions()
"""Of a recording that does not state them."""


def conditions_of(run: Recording) -> Conditions:
    """Conditions of a run."""
    entries = run.parameters.get(ACTING)
    member, telescope = (str(run.parameters.get(key, "")) for key in (MEMBER, TELESCOPE))
    if not isinstance(entries, list) or not all(isinstance(entry, Mapping) for entry in entries):
        return Conditions((), (), member, telescope)
    if not entries:
        return Conditions((NOTHING,), (NOTHING,), member, telescope)
    names = tuple(str(entry.get("name", "?")) for entry in entries)
    what = (str(entry.get("what", "")) for entry in entries)
    acting = tuple(f"{name} ({text})" if text else name for name, text in zip(names, what))
    return Conditions(names, acting, member, telescope)


def differences(runs: Sequence[Recording]) -> tuple[str, ...]:
    """For each run a sentence on what acted otherwise than in the first one; empty where nothing did, or is not known.

    Figures of such runs do not compare their controllers. The disturbances are listed in :attr:`Conditions.lines`.
    """
    conditions = [conditions_of(run) for run in runs]
    return tuple(_difference(conditions[0], one, runs[0].path.name) for one in conditions)


def _difference(first: Conditions, other: Conditions, name: str) -> str:
    pairs = {
        "disturbance": (first.acting, other.acting),
        "member": (first.member, other.member),
        "telescope": (first.telescope, other.telescope),
    }
    differences = [what for what, (a, b) in pairs.items() if a and b and a != b]
    return f"{' and '.join(differences)} differ from {name}: no comparison of controllers" if differences else ""
