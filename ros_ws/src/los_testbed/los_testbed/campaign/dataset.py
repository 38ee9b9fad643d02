"""Results of a campaign on disk: a folder with its definition, and rows in Parquet files.

``campaign.json`` defines the campaign; each ``rows/part-*.parquet`` has the rows of one chunk of members, written
completely or not at all. An interrupted campaign resumes with the missing chunks; the rows of a chunk do not depend on
when or where it was computed.
"""

from __future__ import annotations

import contextlib
import hashlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from lftkit.arrays import FloatArray
from lftkit.errors import InputError
from lftkit.support.atomic_output import check_output, write_bytes
from lftkit.support.input_files import read_text
from lftkit.support.job import Job
from lftkit.support.structured_text import load_json
from lftkit.support.workers import Workers
from los_testbed.campaign.adversarial import adversarial_members
from los_testbed.campaign.campaign_verdict import judged
from los_testbed.campaign.meanings import TOTAL, WITHOUT_LIMIT, RequirementColumns
from los_testbed.campaign.member import CRASHED, DEPTHS, metric_columns, unformed
from los_testbed.campaign.sampling import MemberParameters, member_seeds, members
from los_testbed.config.members import check_ranges
from los_testbed.config.run_config import RunConfig
from los_testbed.config.run_settings import SIMULATED, with_scenario
from los_testbed.parts.run_parts import RunParts
from pointing_analysis.requirements.exposure import exposure_of, finest
from pointing_analysis.requirements.requirement import Requirement

MANIFEST, ROWS = "campaign.json", "rows"
FORMAT = 2
CHUNK = {"time": 10, "model": 100}
"""Members of a chunk: one task and one file."""
MODELLED = ("duration", "loop", "scenario", "k_fsm", "k_pma", "parameters", "parameter_values", "camera_rate")
"""Settings that members may have at depth model, whose figures are those of the loop's matrices."""
PLACE = ("mode", "output", "domain", "namespace")
"""Settings that rows do not depend on."""


@dataclass(frozen=True)
class Campaign:
    """Definition of a campaign: two with equal fields have equal rows.

    Parameters
    ----------
    base : RunConfig
        Settings that all members share.
    sampling : str
        See :func:`los_testbed.campaign.sampling.members`.
    samples : int
        Number of members.
    seed : int
    depth : {"time", "model"}
    points_hash : str
        Of the members' parameters and seeds.
    identity : mapping
        Version of the package, hashes of the parameter file and of the controllers.
    points : ndarray, shape (samples, parameters)
        Of the members, in the order of :attr:`parameters`.
    """

    base: RunConfig
    sampling: str
    samples: int
    seed: int
    depth: str
    points_hash: str
    identity: Mapping[str, str]
    points: FloatArray = field(compare=False, repr=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "base", with_scenario(self.base))

    @classmethod
    def of(
        cls,
        base: RunConfig,
        sampling: str,
        samples: int,
        seed: int,
        depth: str,
        identity: Mapping[str, str],
        workers: Workers | None = None,
    ) -> Campaign:
        """Campaign with the members that `sampling` gives; an adversarial one takes a search, for which `workers` are.

        Raises
        ------
        ValueError
            An unknown depth; a setting that members do not have; a scenario in which they would move; a camera rate
            that the depth model does not have; runs shorter than a window; what
            :func:`los_testbed.campaign.sampling.members` refuses.
        """
        check_depth(base, depth)
        if sampling == "adversarial":
            points = adversarial_members(base, samples, seed, workers)
        else:
            points = members(sampling, samples, seed, base.parameters, base.parameter_values)
        seeds = member_seeds(len(points), seed)
        digest = hashlib.sha256(points.tobytes() + seeds.tobytes()).hexdigest()[:16]
        return cls(base, sampling, len(points), seed, depth, digest, dict(identity), points)

    def chunks(self, skip: frozenset[int] = frozenset()) -> Iterator[tuple[int, list[dict[str, Any]]]]:
        """Number of each chunk that is not in `skip`, and its members: index, seed and parameters."""
        points, columns = self.points, self.parameters.columns
        seeds = member_seeds(self.samples, self.seed)
        size = CHUNK[self.depth]
        for number in range(self.chunk_count):
            if number not in skip:
                yield (
                    number,
                    [
                        {"index": k, "seed": int(seeds[k]), **dict(zip(columns, map(float, points[k])))}
                        for k in range(number * size, min((number + 1) * size, self.samples))
                    ],
                )

    @property
    def parameters(self) -> MemberParameters:
        """Parameters that vary among the members."""
        return MemberParameters.of(self.base.parameters, self.base.parameter_values)

    @property
    def requirements(self) -> tuple[Requirement, ...]:
        """Requirements of the telescope."""
        return RunParts(self.base).telescope.requirements

    @property
    def exposure(self) -> float:
        """Window of the relative error [s]."""
        return exposure_of(self.requirements)

    @property
    def refusals(self) -> dict[Requirement, str]:
        """Requirements that the simulated run of a member cannot be judged by, and why; none at depth model."""
        return unformed(RunParts(self.base)) if self.depth == "time" else {}

    @property
    def judged(self) -> tuple[Requirement, ...]:
        """Requirements of the telescope but `refusals`."""
        refusals = self.refusals
        return tuple(r for r in self.requirements if r not in refusals)

    @property
    def ranked(self) -> str:
        """Metric by which members are ranked: that of the strictest limit of the stage on the relative error."""
        if self.depth == "model":
            return TOTAL
        strictest = finest(judged(self.judged, self.base.loop))
        return WITHOUT_LIMIT if strictest is None else RequirementColumns.of(strictest, self.exposure).quantile

    @property
    def metrics(self) -> tuple[str, ...]:
        """Columns of metrics."""
        return metric_columns(self.depth, self.judged, self.sources, self.exposure)

    @property
    def sources(self) -> tuple[str, ...]:
        """Names of the sources of disturbance of the parameter file, which act in each simulated member."""
        return tuple(source.name for source in RunParts(self.base).sources) if self.depth == "time" else ()

    @property
    def chunk_count(self) -> int:
        """Number of chunks."""
        return -(-self.samples // CHUNK[self.depth])

    def job(self, folder: Path) -> Job:
        """The campaign as a job whose rows lie in a folder; its record is ``campaign.json``."""
        return Job("campaign", self.manifest(), folder / MANIFEST, "output")

    def manifest(self) -> dict[str, Any]:
        """Dependencies of the rows."""
        return {
            "format": FORMAT,
            "depth": self.depth,
            "sampling": self.sampling,
            "samples": self.samples,
            "seed": self.seed,
            "points_hash": self.points_hash,
            "identity": dict(self.identity),
            "run": _settings(self.base),
        }


def check_depth(base: RunConfig, depth: str) -> None:
    """Reject settings with which members cannot be evaluated.

    Raises
    ------
    ValueError
        An unknown depth; a setting that members do not have; a parameter out of its range; a scenario in which they
        would move; a camera rate that the depth model does not have; runs shorter than a window.
    """
    if depth not in DEPTHS:
        raise InputError(f"depth must be one of {', '.join(DEPTHS)}, got {depth!r}")
    for name, setting in RunConfig.SETTINGS.items():
        value = getattr(base, name)
        if name in PLACE or value is None or value == setting.default:
            continue
        if name not in SIMULATED:
            raise InputError(f"{name} must be absent in a campaign, got {value}")
        if depth == "model" and name not in MODELLED:
            raise InputError(f"{name} must be {setting.default} at depth model, got {value}")
    check_ranges(base, RunParts(base).telescope)
    if base.scenario == "ramp":
        raise InputError("scenario must be unit_norm, design, imbalance, worst_case or none in a campaign, got ramp")
    if depth == "time" and base.duration < (window := exposure_of(RunParts(base).telescope.requirements)):
        raise InputError(f"duration must be at least the window of {window:g} s, got {base.duration:g} s")


class ResultFolder:
    """Folder of one campaign.

    Parameters
    ----------
    path : Path
    """

    def __init__(self, path: Path) -> None:
        self.path = path

    def check(self, resume: bool) -> None:
        """Reject, before any computation, a folder where no rows can be written.

        Raises
        ------
        ValueError
            It exists and `resume` is not asked for; it holds no campaign; another process writes to it; it cannot be
            made or written to.
        """
        if resume:
            read_manifest(self.path)
        elif self.path.exists():
            raise InputError(f"output must be a new folder, or --resume given, got {self.path}, which exists")
        check_output(self.path, "output", folder=True)
        if resume:
            with self.alone():
                pass

    def compare(self, campaign: Campaign) -> None:
        """Reject a campaign other than the one in the folder.

        Settings that an older version did not have count as what they are by default.

        Raises
        ------
        ValueError
            Another campaign, or none.
        """
        present = read_manifest(self.path)
        with contextlib.suppress(ValueError, KeyError):  # unknown settings are compared unchanged
            present["run"] = _settings(RunConfig.from_mapping(present["run"]))
        campaign.job(self.path).require_same(present)

    def open(self, campaign: Campaign, resume: bool) -> frozenset[int]:
        """Create the folder, or resume in it; the finished chunks.

        Chunks with crashed members, or without a column of the campaign's metrics, are not among them.

        Raises
        ------
        ValueError
            What :meth:`check` and :meth:`compare` refuse; a part that the campaign does not have.
        """
        self.check(resume)
        if not resume:
            campaign.job(self.path).begin()
            (self.path / ROWS).mkdir()
            return frozenset()
        self.compare(campaign)
        (self.path / ROWS).mkdir(exist_ok=True)
        parts = {self.part(number): (number, members) for number, members in campaign.chunks()}
        for file in self.parts():
            if file not in parts:
                raise InputError(f"{self.path} must hold parts 0 to {len(parts) - 1} of its campaign, got {file.name}")
        wanted = frozenset(campaign.metrics)
        return frozenset(number for file, (number, members) in parts.items() if _complete(file, members, wanted))

    @contextlib.contextmanager
    def alone(self) -> Iterator[None]:
        """No other process writes rows here during the block, see :meth:`lftkit.support.job.Job.alone`.

        Raises
        ------
        ValueError
            Another process does.
        """
        with Job("campaign", {}, self.path / MANIFEST).alone(self.path / ROWS):
            yield

    def parts(self) -> list[Path]:
        """Files of rows, in the order of the members."""
        return sorted((self.path / ROWS).glob("part-*.parquet"))

    def part(self, number: int) -> Path:
        """File of the rows of a chunk."""
        return self.path / ROWS / f"part-{number:07d}.parquet"

    def write(self, number: int, rows: Sequence[Mapping[str, Any]]) -> None:
        """Rows of a chunk, whole or not at all."""
        import pyarrow
        import pyarrow.parquet

        sink = pyarrow.BufferOutputStream()
        pyarrow.parquet.write_table(pyarrow.Table.from_pylist([dict(row) for row in rows]), sink)
        write_bytes(self.part(number), sink.getvalue().to_pybytes(), durable=True)

    def table(self, columns: Sequence[str] | None = None) -> Any:
        """All rows as a ``pyarrow.Table``, in the order of the members."""
        import pyarrow
        import pyarrow.parquet

        tables = [pyarrow.parquet.read_table(part, columns=columns) for part in self.parts()]
        if not tables:
            raise InputError(f"{self.path} must hold rows of a campaign, got none")
        return pyarrow.concat_tables(tables)

    def rows_hash(self) -> str:
        """Hash of the hashes of all rows, in the order of the members."""
        hashes = self.table(["hash"]).column("hash").to_pylist()
        return hashlib.sha256("".join(hashes).encode()).hexdigest()[:16]


def read_manifest(path: Path) -> dict[str, Any]:
    """Content of ``campaign.json`` in a folder.

    Raises
    ------
    ValueError
        It is not there or cannot be read.
    """
    try:
        content = load_json(read_text(path / MANIFEST), "it")
    except OSError as error:
        raise InputError(f"{path} must be the folder of a campaign: {MANIFEST}: {error.strerror}") from None
    except (ValueError, RecursionError):
        raise InputError(f"{path / MANIFEST} is not JSON") from None
    if not isinstance(content, dict):
        raise InputError(f"{path / MANIFEST} must be an object, got {type(content).__name__}")
    return content


def _settings(config: RunConfig) -> dict[str, Any]:
    """Those of each member, from the folder."""
    return {name: value for name, value in config.to_plain().items() if name not in ("output", "domain")}


def _complete(part: Path, members: Sequence[Mapping[str, Any]], metrics: frozenset[str]) -> bool:
    """Whether a part holds rows of these members and need not be computed again, as it must where one crashed.

    Rows from before a requirement had columns have not all `metrics`.
    """
    import pyarrow
    import pyarrow.parquet

    if not part.exists():
        return False
    try:
        if not metrics <= set(pyarrow.parquet.read_schema(part).names):
            return False
        written = pyarrow.parquet.read_table(part, columns=["index", "seed", "status"]).to_pydict()
    except (OSError, KeyError, pyarrow.ArrowInvalid):
        return False
    same = all(written[key] == [member[key] for member in members] for key in ("index", "seed"))
    return same and CRASHED not in written["status"]
