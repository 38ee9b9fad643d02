"""Proofs with all that they are about in one file: controllers, telescope, requirements, versions, a hash of each.

A bundle is a zip file:

==========================  ========================================================================================
member                      content
==========================  ========================================================================================
``manifest.json``           format, versions, SHA-256 of every other member
``telescope.json``          all values of the telescope's parameters, its requirements among them; without sources of
                            disturbance and what only images need: no proof depends on them
``modal_data/BODY.*``       modal data of a body of the user, where the telescope has one; ``BODY-NUMBER.*`` of arrays
                            and appendages; ``modal_data/plant.*``: a plant that is a file
``k_fsm.json``              sampled controllers, as :class:`lftkit.SampledSystem` stores them
``k_pma.json``
``proofs/STAGE-FIGURE.npz`` of :class:`lftkit.proofs.sampled_loop.LoopProof`
``proofs/STAGE-noise.npz``  of :class:`lftkit.proofs.trusted.noise.NoiseProof`, where there is one
==========================  ========================================================================================

The hashes find damage; they are no defence against somebody who makes new ones. What counts is what
:func:`check_bundle` does: it makes the model of every figure anew from the telescope and the controllers of the bundle,
and checks the scalings of the proofs with it. So a statement is always about the controllers and the telescope that are
in the bundle, whose names (:class:`Subject`) it prints.
"""

from __future__ import annotations

import hashlib
import io
import json
import math
import platform
import tempfile
import zipfile
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np
import scipy

from lftkit import SampledSystem
from lftkit.errors import InputError
from lftkit.proofs.sampled_loop import CheckedLoop, LoopProof, check_loop_proof
from lftkit.proofs.sampled_loop.files import read_loop_proof, read_noise_proof
from lftkit.proofs.trusted.digests import digest
from lftkit.proofs.trusted.entries import mapping, parsed, record, require_small, text, zip_members
from lftkit.proofs.trusted.noise import NoiseBound, NoiseProof, check_noise_proof
from lftkit.proofs.trusted.proof import ProofError, ProofFileError
from lftkit.proofs.trusted.stability import whole_axis
from lftkit.support.atomic_output import atomic_file
from los_design.synthesis.provenance import commit
from los_design.verification.check_proof_texts import require_plain
from los_design.verification.combined_bounds import error_sums, in_few_bands
from los_design.verification.error_sum import FAST, PART, ErrorSum, window_limit
from los_design.verification.figure_texts import bound_text
from los_design.verification.frames import frames_share
from los_design.verification.loop_models import box_of, check_provable, provable, provable_open_loop
from los_design.verification.noise_certificate import NOISE, noise_of_loop
from los_design.verification.proof_comparison import proof_of_loop
from los_design.verification.subject import Subject
from los_loop.implemented_loop import ImplementedLoop
from titop_plant.interface import MIRROR_STAGES
from titop_plant.telescope.layout import APPENDAGES, ARRAYS
from titop_plant.telescope.loop_ports import LoopPorts
from titop_plant.telescope.plant_file import FILE, PLANT
from titop_plant.telescope.requirements import design_limits, read_requirements
from titop_plant.telescope.telescope import OWN_BODIES, SOURCES, Telescope

FORMAT = "los-testbed proof bundle 1"
MANIFEST, TELESCOPE, K_FSM, K_PMA = "manifest.json", "telescope.json", "k_fsm.json", "k_pma.json"
PROOFS, MODAL_DATA = "proofs", "modal_data"
MANIFEST_ENTRIES = record({"format": text, "versions": mapping(text), "commit": text, "sha256": mapping(text)})
SYNTAX_ERRORS = (KeyError, TypeError, ValueError, IndexError, ArithmeticError, AttributeError, RecursionError, OSError)


OF_WINDOWS = "of its index the rms in each window is compared with the limit here, not the error at each instant"
"""What is said of a requirement on the relative error at every instant."""


@dataclass(frozen=True)
class ProvenFigure:
    """What was proven of one figure.

    Parameters
    ----------
    stage, figure : str
    level : float
        Over the limit.
    limit : float
        [rad], or [N] of forces.
    band : (float, float)
        Frequencies of the tones [rad/s].
    strips, windows : int
    """

    stage: str
    figure: str
    level: float
    limit: float
    band: tuple[float, float]
    strips: int
    windows: int

    @property
    def text(self) -> str:
        """With bound and limit in the unit that people use."""
        return bound_text(self.figure, self.level, self.limit)


@dataclass(frozen=True)
class CheckedBundle:
    """What a bundle that passed guarantees.

    Parameters
    ----------
    subject : Subject
    figures : tuple of ProvenFigure
    stable : mapping of str to float
        Of each stage the frequency [rad/s] up to which no pole of a member crosses the axis, the nominal loop stable:
        infinite where all members are, zero where nothing was proven.
    box : mapping of str to (float, float)
        Deviations of the parameters from their nominal values, of all statements; of the angle [rad]. It is that of
        the telescope, also where the box of a proof is wider.
    requirements : tuple of str
        Of the telescope those that a limit of a proven figure, or of noise, is made of.
    name : str
        :attr:`ProofBundle.name`.
    frames : mapping of str to float
        Of stages that are proven stable and whose nominal loop is so with the camera's frames, the part of a sample
        that comes back by its images (:mod:`los_design.verification.frames`); below 1 all members are stable with them.
    noise : mapping of str to (NoiseBound, NoiseBound)
        Of stages with a proof of noise the bounds of the absolute and the relative error [rad].
    sums : mapping of str to tuple of ErrorSum
        Of each stage what the proven bounds make together.
    """

    subject: Subject
    figures: tuple[ProvenFigure, ...]
    stable: Mapping[str, float]
    box: Mapping[str, tuple[float, float]]
    requirements: tuple[str, ...]
    name: str
    noise: Mapping[str, tuple[NoiseBound, NoiseBound]] = field(default_factory=dict)
    sums: Mapping[str, tuple[ErrorSum, ...]] = field(default_factory=dict)
    frames: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class ProofBundle:
    """Content of a bundle whose hashes are right.

    Parameters
    ----------
    folder : Path
        Where its members are as files.
    names : frozenset of str
        Of the members.
    telescope : Telescope
        Of the telescope.
    k_fsm, k_pma : SampledSystem
    """

    folder: Path
    names: frozenset[str]
    telescope: Telescope
    k_fsm: SampledSystem
    k_pma: SampledSystem

    @cached_property
    def subject(self) -> Subject:
        """Names of its controllers and its telescope."""
        return Subject.of(self.k_fsm, self.k_pma, self.telescope.digest)

    @cached_property
    def name(self) -> str:
        """Digest of what is in it: subject and arrays of the proofs.

        However the files are compressed, and with whatever versions they were written.
        """
        proofs = []
        for stage, figure in (*self.figures, *((stage, NOISE) for stage in self.noise)):
            with np.load(self.folder / member_of(stage, figure), allow_pickle=False) as archive:
                proofs.append(digest([stage, figure], {name: archive[name] for name in sorted(archive.files)}))
        return digest([asdict(self.subject), proofs])

    @property
    def ports(self) -> LoopPorts:
        """Sensors and actuators of its loop."""
        return self.telescope.loop_ports.used_by(self.k_fsm, self.k_pma)

    @property
    def figures(self) -> tuple[tuple[str, str], ...]:
        """Stage and figure of each proof, in the order of stages and figures."""
        names = {name for name in self.names if name.startswith(PROOFS + "/")}
        names -= {member_of(stage, NOISE) for stage in MIRROR_STAGES}
        known = [(stage, figure) for stage in MIRROR_STAGES for figure in provable(self.telescope, stage, self.ports)]
        figures = tuple((stage, figure) for stage, figure in known if member_of(stage, figure) in names)
        if len(figures) != len(names) or not names:
            raise ProofError(f"a bundle must hold proofs of figures of {', '.join(MIRROR_STAGES)}, got {sorted(names)}")
        return figures

    @property
    def noise(self) -> tuple[str, ...]:
        """Stages with a proof of noise."""
        return tuple(stage for stage in MIRROR_STAGES if member_of(stage, NOISE) in self.names)

    def proof(self, stage: str, figure: str) -> LoopProof:
        """The proof of a figure as its file has it."""
        return read_loop_proof(self.folder / member_of(stage, figure))

    def noise_proof(self, stage: str) -> NoiseProof:
        """The proof of a stage's noise as its file has it."""
        return read_noise_proof(self.folder / member_of(stage, NOISE))

    def count_strips(self) -> int:
        """Strips of all proofs.

        Raises
        ------
        ProofError
            A proof cannot be read.
        """
        of_tones = sum(len(self.proof(*which).strips) for which in self.figures)
        return of_tones + sum(len(part.strips) for stage in self.noise for part in self.noise_proof(stage).parts)


def member_of(stage: str, figure: str) -> str:
    """Name of a proof in a bundle."""
    return f"{PROOFS}/{stage}-{figure}.npz"


def write_bundle(
    path: Path,
    telescope: Telescope,
    controllers: tuple[SampledSystem, SampledSystem],
    proofs: Mapping[tuple[str, str], Path],
) -> None:
    """Write a bundle.

    Parameters
    ----------
    path : Path
    telescope : Telescope
        Of the telescope.
    controllers : (SampledSystem, SampledSystem)
        K_FSM and K_PMA.
    proofs : mapping of (stage, figure) to Path
        Files of ``design certify``.
    """
    members = {member_of(stage, figure): file.read_bytes() for (stage, figure), file in proofs.items()}
    of_loop = telescope.linear_tables()
    content = {k: dict(v) if isinstance(v, Mapping) else v for k, v in of_loop.items() if k != SOURCES}

    def member(body: str, file: str) -> str:
        name = f"{MODAL_DATA}/{body}{Path(file).suffix}"
        members[name] = Path(file).read_bytes()
        return name

    content = _with_modal_data(content, member)
    members[TELESCOPE] = json.dumps(content, indent=1).encode()
    with tempfile.TemporaryDirectory() as folder:
        for name, system in zip((K_FSM, K_PMA), controllers):
            system.to_file(Path(folder) / name)
            members[name] = (Path(folder) / name).read_bytes()
    manifest = {
        "format": FORMAT,
        "versions": {"numpy": np.__version__, "scipy": scipy.__version__, "python": platform.python_version()},
        "commit": commit(),
        "sha256": {name: hashlib.sha256(data).hexdigest() for name, data in sorted(members.items())},
    }
    text = json.dumps(manifest, indent=1).encode()
    with atomic_file(path) as temporary, zipfile.ZipFile(temporary, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in {MANIFEST: text, **members}.items():
            archive.writestr(zipfile.ZipInfo(name), data, zipfile.ZIP_DEFLATED)


@contextmanager
def open_bundle(path: Path) -> Iterator[ProofBundle]:
    """Read a bundle; its members are files of a temporary folder as long as it is open.

    Raises
    ------
    ProofFileError
        Not a bundle, or a text of the telescope has control characters.
    ProofError
        A member is damaged, missing or not named by the manifest, or controllers and telescope are none.
    """
    members = _members(path)
    with tempfile.TemporaryDirectory() as folder:
        try:
            bundle = _read(members, Path(folder))
            _ = bundle.subject, bundle.figures
        except SYNTAX_ERRORS as error:
            raise _refused(error) from None
        yield bundle


def _read(members: Mapping[str, bytes], folder: Path) -> ProofBundle:
    text = members[MANIFEST]
    _check_hashes(parsed(text, MANIFEST), {name: data for name, data in members.items() if name != MANIFEST})
    for name, data in members.items():
        if PurePosixPath(name).parts[:-1] not in ((), (PROOFS,), (MODAL_DATA,)) or name[-1] in "/.":
            raise ProofError(f"a member must be a file of {PROOFS} or {MODAL_DATA}, got {name!r}")
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).write_bytes(data)
    telescope = _telescope(folder, frozenset(members))
    for name in (K_FSM, K_PMA):
        parsed(members[name], name)
    k_fsm, k_pma = (SampledSystem.from_file(folder / name) for name in (K_FSM, K_PMA))
    check_provable(telescope, k_fsm, k_pma)
    return ProofBundle(folder, frozenset(members), telescope, k_fsm, k_pma)


def _refused(error: BaseException) -> ProofError:
    if isinstance(error, ProofError):
        return error
    reason = str(error) if isinstance(error, InputError) else "members that do not fit together"
    return ProofError(f"the file must be a bundle of proofs, got {reason}"[:300])


def _members(path: Path) -> dict[str, bytes]:
    """All members of a bundle."""
    try:
        members = zip_members(path)
        inner = [zipfile.ZipFile(file) for data in members.values() if zipfile.is_zipfile(file := io.BytesIO(data))]
        require_small(sum(info.file_size for proof in inner for info in proof.infolist()), path.stat().st_size)
    except ProofError as error:
        raise ProofFileError(str(error)) from None
    except Exception as error:  # of damaged streams the decompressors raise errors of their own
        raise ProofFileError("the file must be a bundle of proofs, got one that cannot be unpacked") from error
    if MANIFEST not in members:
        raise ProofFileError(f"a bundle must have {MANIFEST}, got {sorted(members)}"[:300])
    return members


def _check_hashes(manifest: Any, members: Mapping[str, bytes]) -> None:
    stated = manifest.get("format") if isinstance(manifest, dict) else None
    if stated != FORMAT:
        raise ProofFileError(f"format must be {FORMAT!r}, got {str(stated)[:60]!r}")
    hashes = MANIFEST_ENTRIES(manifest, MANIFEST)["sha256"]
    if set(hashes) != set(members):
        raise ProofError(f"members must be those of the manifest, got other {sorted(set(hashes) ^ set(members))}")
    for name, data in members.items():
        if hashlib.sha256(data).hexdigest() != hashes[name]:
            raise ProofError(f"{name} must have the SHA-256 of the manifest, got another one")


def _telescope(folder: Path, names: frozenset[str]) -> Telescope:
    """Parameters of the telescope; modal data are members."""
    content = parsed((folder / TELESCOPE).read_bytes(), TELESCOPE)
    require_plain({k: v for k, v in content.items() if k != SOURCES}, "texts of the telescope")

    def file(body: str, name: str) -> str:
        if name not in names or PurePosixPath(name).parent != PurePosixPath(MODAL_DATA):
            raise ProofError(f"modal data of {body} must be a member in {MODAL_DATA}, got {name!r}")
        return str(folder / name)

    content = _with_modal_data(content, file)
    _check_limits(content)
    return Telescope(content)


def _with_modal_data(content: Mapping[str, Any], changed: Callable[[str, str], str]) -> dict[str, Any]:
    """The telescope with another name of each file of modal data, made of the body's name and the file's."""

    def of(table: Mapping[str, Any], body: str) -> Mapping[str, Any]:
        file = table.get("modal_data", "")
        return {**table, "modal_data": changed(body, file)} if file else table

    moved = dict(content)
    for name in (*OWN_BODIES, ARRAYS, APPENDAGES):
        tables = content.get(name)
        if isinstance(tables, (list, tuple)):
            moved[name] = [of(table, f"{name}-{number}") for number, table in enumerate(tables, 1)]
        elif tables is not None:
            moved[name] = of(tables, name)
    if PLANT in content:
        moved[PLANT] = {FILE: changed(PLANT, content[PLANT][FILE])}
    return moved


def _check_limits(content: Mapping[str, Any]) -> None:
    """Requirements are printed beside what is proven: the limits must be theirs."""
    limits, _ = design_limits(read_requirements(content))
    for name, limit in limits.items():
        if not math.isclose(float(content["weights"][name]), limit, rel_tol=1e-9):
            raise ProofError(
                f"{name} must be that of the requirements, {limit:.9g}, got {content['weights'][name]!r}"[:300]
            )


def figures_proven(bundle: ProofBundle, stage: str) -> tuple[str, ...]:
    """Each figure of a stage with its bound and its limit, as a bundle says without a check."""
    limits = provable(bundle.telescope, stage, bundle.ports)
    return tuple(
        bound_text(figure, bundle.proof(stage, figure).level, limits[figure].limit)
        for where, figure in bundle.figures
        if where == stage and not figure.startswith(PART)
    )


def levels_proven(bundle: ProofBundle, stage: str) -> dict[str, float]:
    """Bound of each figure of a stage in its own unit, as a bundle says without a check."""
    limits = provable(bundle.telescope, stage, bundle.ports)
    return {
        figure: bundle.proof(stage, figure).level * limits[figure].limit
        for where, figure in bundle.figures
        if where == stage
    }


def check_bundle(bundle: ProofBundle, each: Callable[..., Iterable[int | str]] = map) -> CheckedBundle:
    """Verify all proofs of a bundle with models made anew of its telescope and controllers.

    Parameters
    ----------
    bundle : ProofBundle
    each : callable
        Maps a function over the strips of a proof; they may be checked in several processes.

    Raises
    ------
    ProofError
        A proof is refused.
    """
    try:
        telescope = bundle.telescope
        open_loop = provable_open_loop(telescope, bundle.k_fsm, bundle.k_pma)
        stages = dict.fromkeys((*(s for s, _ in bundle.figures), *bundle.noise))
        loops = {s: ImplementedLoop(open_loop, bundle.k_fsm, bundle.k_pma, s) for s in stages}
        figures, stable = [], dict.fromkeys(loops, 0.0)
        for stage, figure in bundle.figures:
            proof = proof_of_loop(bundle.proof(stage, figure), loops[stage], figure)
            first = not stable[stage] and whole_axis(proof.band, proof.model.dt)
            checked = _checked(proof, each, first)
            stable[stage] = max(stable[stage], checked.stable_below)
            limit = provable(telescope, stage, bundle.ports)[figure].limit
            figures.append(
                ProvenFigure(stage, figure, checked.level, limit, checked.band, checked.strips, checked.windows)
            )
        frames = {}
        for stage, loop in loops.items():
            levels = {f.figure: f.level * f.limit for f in figures if f.stage == stage}
            share = frames_share(levels, telescope.frame_ticks)
            steady = share is not None and math.isinf(stable[stage])
            if share is not None and steady and loop.sampled_at({})[1].spectral_radius() < 1.0:
                frames[stage] = share
        noise = {s: checked_noise(bundle, loops[s], each, stable) for s in bundle.noise}
        loop = next(iter(loops.values()))
        box = dict(zip((p.name for p in loop.system.parameters), box_of(loop)))  # every proof holds it
    except SYNTAX_ERRORS as error:
        raise _refused(error) from None
    requirements = requirements_of(telescope, figures, tuple(noise))
    sums = {
        s: error_sums(telescope, s, {f.figure: f.level * f.limit for f in figures if f.stage == s}, noise.get(s))
        for s in loops
    }
    return CheckedBundle(bundle.subject, tuple(figures), stable, box, requirements, bundle.name, noise, sums, frames)


def requirements_of(telescope: Telescope, figures: Iterable[ProvenFigure], noise: Iterable[str]) -> tuple[str, ...]:
    """Texts of the requirements that the limits of proven figures, and of stages with a bound of noise, are made of.

    Others of the telescope, of another stage for instance, are no part of what a bundle says. Of a requirement on the
    relative error at every instant the rms of a window is proven, which is smaller: that is said with it.
    """
    limits = {window_limit(f.stage) for f in figures if f.figure in ("slow", FAST) or f.figure.startswith(PART)}
    limits |= {"ape_limit" for f in figures if f.figure == "APE"}
    limits |= {name for stage in noise for name in ("ape_limit", window_limit(stage))}
    of_telescope = telescope.requirements
    made = design_limits(of_telescope)[1]
    places = sorted({place for name in limits for place in made[name]})
    texts = [(of_telescope[place], telescope.requirement_texts[place]) for place in places]
    return tuple(f"{text}; {OF_WINDOWS}" if r.index == "RPE" and not r.of_windows else text for r, text in texts)


def checked_noise(
    bundle: ProofBundle, loop: ImplementedLoop, each: Callable[..., Iterable[int | str]], stable: dict[str, float]
) -> tuple[NoiseBound, NoiseBound]:
    """Bounds of a stage's noise; of unstable members there are none."""
    stage = loop.stage
    proof = noise_of_loop(bundle.noise_proof(stage), loop)
    window = loop.telescope.weights.rpe_window
    try:
        checked = check_noise_proof(proof, each, not math.isinf(stable[stage]), window)
    except ProofError as error:
        raise ProofError(f"{stage}, {NOISE}: {error}") from None
    stable[stage] = max(stable[stage], checked.stable_below)
    if not math.isinf(stable[stage]):
        raise ProofError(f"{stage}, {NOISE}: noise needs that every member is stable, which was not proven")
    if checked.relative is None:
        raise ProofError(f"{stage}, {NOISE}: the telescope must have a window of the relative error, got {window} s")
    return replace(checked.absolute, powers=()), in_few_bands(checked.relative)


def _checked(proof: LoopProof, each: Callable[..., Iterable[int | str]], stability: bool) -> CheckedLoop:
    try:
        return check_loop_proof(proof, each, stability)
    except ProofError as error:
        raise ProofError(f"{proof.about['stage']}, {proof.about['figure']}: {error}") from None


def as_mapping(checked: CheckedBundle) -> dict[str, Any]:
    """For JSON; an infinite frequency is null."""
    content = asdict(replace(checked, stable={}, sums={}))
    del content["stable"]
    return {
        **content,
        "figures": [{**asdict(figure), "text": figure.text} for figure in checked.figures],
        "sums": {s: [{**asdict(x), "text": x.text, "kept": x.kept} for x in rows] for s, rows in checked.sums.items()},
        "stable_below": {stage: at if math.isfinite(at) else None for stage, at in checked.stable.items()},
    }
