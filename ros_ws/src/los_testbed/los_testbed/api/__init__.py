"""Runs, analyses, campaigns and designs from scripts and notebooks, with the settings of the command line.

Examples
--------
>>> import tempfile
>>> from los_testbed.api import run
>>> with tempfile.TemporaryDirectory() as folder:
...     result = run(f"{folder}/bag", duration=2.0, loop="isolator", scenario="design", seed=3)
...     result.verdict, [row["name"] for row in result.requirements]
('not compliant', ['APE', 'RPE, fine'])
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import datetime
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from lftkit.support.counted_nouns import counted
from lftkit.support.on_demand import names_on_demand
from los_testbed.config.run_settings import completed, layered, of_designs, with_scenario, with_stage
from pointing_analysis.formatting.number_text import digits
from pointing_analysis.formatting.tables import TextTable, numbers, texts
from pointing_analysis.requirements.requirement import Requirement
from pointing_analysis.requirements.rows import BRIEF, requirement_table
from pointing_analysis.requirements.summary import Summary

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr

    from pointing_analysis.read.recording import Recording

PathLike = str | os.PathLike[str]

__getattr__ = names_on_demand(
    __name__,
    {
        "designs": (
            "DesignResult",
            "Verification",
            "certify",
            "design",
            "prove_designs",
            "verify_folder",
            "verify_stored",
        )
    },
)

LABELS = {"name": "requirement", "text": "definition", "quantile": "value", "status": "verdict"}
"""Columns of the table of requirements that are named differently in the JSON object."""


@dataclass(frozen=True, repr=False)
class RunResult:
    """A recorded run with its verdicts.

    Parameters
    ----------
    path : Path
        Bag, or file of another program.
    recording : Recording
        The open recording.
    summary : Summary
        Metrics, as :mod:`pointing_analysis.requirements.summary` documents them.
    remarks : tuple of str
        Remarks on the verdict, with restarted nodes and warnings.
    values : mapping
        The JSON object of the command line.
    """

    path: Path
    recording: Recording
    summary: Summary
    remarks: tuple[str, ...]
    values: Mapping[str, Any]

    def __repr__(self) -> str:
        """Path and verdict; notebooks show the table of requirements."""
        return f"RunResult({str(self.path)!r}, verdict={self.verdict!r})"

    @property
    def verdict(self) -> str:
        """One word for all requirements: the worst of them."""
        return self.summary.overall

    @property
    def requirements(self) -> list[dict[str, Any]]:
        """Each requirement with its value, limit, bound, unit and status."""
        return [row.as_dict() for row in self.summary.rows]

    @property
    def figures(self) -> dict[str, float]:
        """Metrics that need no requirement, by name with the unit."""
        return {f"{f.name} [{f.unit}]" if f.unit else f.name: float(f.value) for f in self.summary.figures}

    def to_pandas(self) -> pd.DataFrame:
        """Requirements, one row each (needs pandas)."""
        import pandas as pd

        wanted = ("name", "text", "quantile", "limit", "unit", "status", "statement")
        return pd.DataFrame([{LABELS.get(k, k): row[k] for k in wanted} for row in self.requirements])

    def to_xarray(self) -> xr.Dataset:
        """Line of sight minus its target [rad] over time [s], dimensions ``time`` and ``axis`` (needs xarray).

        Samples that were lost are NaN; the start-up is part of it.
        """
        import xarray as xr

        from pointing_analysis.indices.errors import performance_error

        error = performance_error(self.recording, 0.0)
        data = xr.DataArray(
            error.values,
            dims=("time", "axis"),
            coords={"time": ("time", error.time, {"units": "s"}), "axis": ["x", "y"]},
            attrs={"units": "rad", "long_name": "line of sight minus target"},
        )
        return xr.Dataset({"los_error": data}, attrs={"source": str(self.path), "start_up_s": self.summary.transient})

    def write_report(self, path: PathLike, *, transient: float | None = None) -> Path:
        """Report of the run, HTML or, where the path ends in ``.pdf``, PDF; an existing file is replaced."""
        from los_testbed.run.summary.summary import summarise_runs

        asked = tuple(v.requirement for v in self.summary.verdicts)
        summarise_runs([self.recording], Path(path), transient, asked if self.summary.kind != "bag" else None)
        return Path(path)

    def _repr_html_(self) -> str:
        table = requirement_table(self.summary.rows).only(*BRIEF)
        rows = [(name, digits(value, 4), "", "", "") for name, value in self.figures.items()]
        title = f"{self.path.name}: {self.verdict}"
        return replace(table, rows=(*table.rows, *rows), title=title).html(caption=True)


@dataclass(frozen=True)
class CampaignResult:
    """Rows and summary of a campaign.

    Parameters
    ----------
    path : Path
        Folder of the results.
    summary : mapping
        Quantiles, verdicts, influence of the parameters and the worst members, as the JSON object of the command line.
    warnings : tuple of str
        Of the controllers.
    """

    path: Path
    summary: Mapping[str, Any]
    warnings: tuple[str, ...] = ()

    def to_pandas(self) -> pd.DataFrame:
        """One row per member: parameters, metrics, status (needs pandas)."""
        return self._rows.to_pandas()

    @cached_property
    def _rows(self) -> Any:
        from los_testbed.campaign.dataset import ResultFolder

        return ResultFolder(self.path).table()

    def _repr_html_(self) -> str:
        rows = [
            (name, *(digits(quantiles.get(key), 4, none="") for key in ("q0.5", "q0.9", "q1")))
            for name, quantiles in self.summary["metrics"].items()
        ]
        title = f"{self.path.name}: {counted(self.summary['members'], 'member')}"
        return TextTable.of((*texts("metric"), *numbers("median", "90 %", "largest")), rows, title).html(caption=True)


def run(
    output: PathLike | None = None,
    *,
    designs: PathLike | None = None,
    plant: Any = None,
    report: bool = False,
    **settings: Any,
) -> RunResult:
    """Run the loop, record it, evaluate the record.

    Parameters
    ----------
    output : path, optional
        New folder of the bag; default: one under ``bags/``.
    designs : path, optional
        Folder of ``design all``: controllers and telescope.
    plant : object, optional
        A user's plant instead of the telescope, in the mode ``inprocess``.
    report : bool
        Write ``report.html`` into the folder of the bag.
    **settings
        As the options of ``los-testbed run``: ``duration``, ``loop``, ``scenario``, ``seed``, ``parameters`` and so on.
        The mode is ``inprocess`` where none is given.

    Raises
    ------
    ValueError
        Unknown settings, values that do not fit, a bag that exists.
    RunError, LoopDivergedError, RunFailedError
        The run failed, was interrupted, or missed more ticks in real time than ``max_missed``; the message says where
        its record is, and ``code`` is the exit code of the command.
    """
    from los_testbed.parts.run_parts import RunParts
    from los_testbed.run.bag_names import new_bag, recorded
    from los_testbed.run.execution import execute
    from los_testbed.run.results import RunError, check_missed
    from los_testbed.run.summary.summary import missed_share
    from pointing_analysis.command.exit_codes import ExitCode

    folder = "" if designs is None else str(designs)
    stated = layered({"mode": "inprocess"}, of_designs(folder), _plain(settings))
    if output is not None:
        stated["output"] = str(output)
    config = completed({**stated, **({"start": "rest"} if plant is not None else {})}, folder)
    if config.output is None:
        config = replace(config, output=str(new_bag(config)))
    results = execute(RunParts(config), plant=plant)
    if results.bag is None or results.interrupted:
        raise RunError(f"interrupted{recorded(config.bag)}", ExitCode.INTERRUPTED)
    analysed = analyse(results.bag, output=results.bag / "report.html" if report else None)
    check_missed(missed_share(analysed.values), config, f"; the bag is whole: {results.bag}")
    return replace(analysed, remarks=(*results.failures, *results.warnings, *analysed.remarks))


def analyse(
    path: PathLike,
    *,
    requirements: PathLike | Sequence[Requirement] | None = None,
    transient: float | None = None,
    output: PathLike | None = None,
    **source: Any,
) -> RunResult:
    """Evaluate a recording of the testbed or of another program.

    Parameters
    ----------
    path : path
        Bag (folder or .mcap), CSV, Parquet, .mat, HDF5, .npy or .npz file.
    requirements : path or sequence of Requirement, optional
        TOML or YAML file, or requirements; default: those of the recording.
    transient : float, optional
        Seconds of start-up to leave out.
    output : path, optional
        HTML page to write, or a PDF where it ends in ``.pdf``.
    **source
        ``los``, ``unit``, ``rate``, ``time``: as the options of ``los-testbed analyse``.

    Raises
    ------
    ValueError
        A file that cannot be read, missing columns or units.
    """
    from los_testbed.run.summary.summary import summarise_runs
    from pointing_analysis.read.los_source import open_los
    from pointing_analysis.requirements.requirement import load
    from titop_plant.interface import STAGES

    recording = open_los(Path(path), **source)
    asked = load(Path(requirements), STAGES) if isinstance(requirements, str | os.PathLike) else requirements
    judged = summarise_runs([recording], None if output is None else Path(output), transient, asked)
    return RunResult(Path(path), recording, judged.summaries[0], judged.remarks[0], judged.runs[0])


def campaign(
    output: PathLike | None = None,
    *,
    samples: int = 100,
    seed: int = 1,
    sampling: str = "uniform",
    depth: str = "time",
    workers: int = 0,
    resume: bool = False,
    **settings: Any,
) -> CampaignResult:
    """Evaluate many members of the telescope's family on the processors of this machine.

    Parameters
    ----------
    output : path, optional
        New folder of the results; default: one under ``bags/``.
    samples, seed, sampling, depth, resume
        As the options of ``los-testbed campaign``.
    workers : int
        Processes; 0: one per processor. Rows do not depend on them.
    **settings
        Of the run of each member: ``loop``, ``duration``, ``parameters`` and so on; ``designs``, a folder of ``design
        all``.

    Raises
    ------
    ValueError
        Settings that do not fit, a folder that exists, or another campaign in it.
    """
    from los_testbed.campaign.dataset import ResultFolder
    from los_testbed.campaign.execution import CampaignOptions, evaluate_campaign
    from los_testbed.campaign.overview import campaign_summary
    from los_testbed.config.run_config import RunConfig

    designs = settings.pop("designs", None)
    stated = layered({"mode": "inprocess"}, of_designs("" if designs is None else str(designs)), _plain(settings))
    base = with_scenario(RunConfig.from_mapping(with_stage(stated)), usual="unit_norm")
    folder = ResultFolder(Path(output or Path("bags") / f"{datetime.now():%Y%m%d-%H%M%S}-campaign"))
    options = CampaignOptions(samples, seed, sampling, depth, resume, workers)
    asked, warnings = evaluate_campaign(base, folder, options)
    return CampaignResult(folder.path, campaign_summary(asked, folder), warnings)


def _plain(settings: Mapping[str, Any]) -> dict[str, Any]:
    """Settings with paths and arrays converted for the configuration."""
    return {name: _value(value) for name, value in settings.items() if value is not None}


def _value(value: Any) -> Any:
    if isinstance(value, os.PathLike):
        return os.fspath(value)
    if isinstance(value, np.ndarray | tuple):
        return [float(v) for v in value]
    return value
