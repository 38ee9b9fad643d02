"""Command ``los-testbed design check-proof``."""

from __future__ import annotations

import itertools
import json
import math
import re
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from lftkit.errors import InputError
from los_testbed.cli.options.cluster_options import Cluster, with_cluster
from pointing_analysis.command.options import Json
from pointing_analysis.command.output import print_json
from pointing_analysis.command.screen import printable, warn
from pointing_analysis.formatting.number_text import at_least, at_most
from pointing_analysis.units import RAD_PER_ARCSEC, RAD_PER_MAS
from titop_plant.interface import MIRROR_STAGES

if TYPE_CHECKING:
    from lftkit.support.progress import Progress
    from lftkit.support.workers import Workers
    from los_design.verification.bundle import CheckedBundle

CHECK_PROOF_EXAMPLES = """Verify a proof of a worst-case gain, of robust stability, or of a bound for all controllers.

The inequalities are verified by `lftkit/proofs/trusted`, which imports nothing else and optimises nothing. Exit code
1 if the proof is rejected, 2 if its texts have control characters or line breaks, which could look like lines of this
command.

A bundle holds controllers, telescope and proofs: the loop is rebuilt from them, and what is printed is proven for that
loop. A single proof is checked for the shipped controllers and telescope, or for those of `--designs FOLDER`; the
description in the file proves nothing.

**Examples**

    los-testbed design check-proof                # proofs of the shipped controllers, about 15 minutes

    los-testbed design check-proof proofs/bundle.zip

    los-testbed design check-proof proof.json

    los-testbed design check-proof soft-proofs/fsm+pma-slow.npz --designs designs/soft

    los-testbed design check-proof proofs/bundle.zip --scheduler tls://host:8786   # its workers check the strips
"""


@with_cluster
def check_proof(
    file: Annotated[
        Path | None,
        typer.Argument(
            help="Proof (.json, .npz), or bundle (.zip) or proof (.npz) of `design certify`; "
            "without one, the bundle of the shipped controllers."
        ),
    ] = None,
    designs: Annotated[
        Path | None, typer.Option(metavar="FOLDER", help="Folder of `design all` for which an .npz is checked.")
    ] = None,
    *,
    cluster: Cluster,
    json_: Json = False,
) -> None:
    """See CHECK_PROOF_EXAMPLES."""
    if designs is not None and (file is None or file.suffix.lower() != ".npz"):
        raise InputError(f"--designs must be given with an .npz of `design certify`, got {file or 'no file'}")
    if file is not None:
        from lftkit.proofs.checking import proof_kind
        from lftkit.proofs.sampled_loop.files import LOOP, NOISE
        from lftkit.proofs.trusted.proof import ProofError

        if not file.exists():
            raise InputError(f"FILE must be a proof file, got {file}, which does not exist")
        with _refusals(file):
            if file.suffix.lower() == ".zip":
                _check_bundle(file, cluster, json_)
            elif (kind := proof_kind(file)) == LOOP:
                _check_loop(file, cluster, designs, json_)
            elif kind == NOISE:
                raise ProofError("a proof of noise must be checked in its bundle, with controllers and telescope")
            else:
                _check_system(file, json_)
        return
    from los_design.verification.shipped_proofs import write_shipped_bundle
    from los_design.verification.subject import BUNDLE

    with tempfile.TemporaryDirectory() as folder, _refusals(Path(BUNDLE)):
        write_shipped_bundle(Path(folder) / BUNDLE)
        _check_bundle(Path(folder) / BUNDLE, cluster, json_)


@contextmanager
def _refusals(file: Path) -> Iterator[None]:
    """Report why a proof is rejected, with exit code 1; a file of no proof is wrong input."""
    from lftkit.proofs.trusted.proof import ProofError, ProofFileError

    try:
        yield
    except ProofFileError as error:
        raise InputError(f"{file}: {error}") from None
    except ProofError as error:
        sys.stderr.write(f"refused: {printable(str(error))}\n")
        raise typer.Exit(1) from None


def _named(name: str) -> str:
    """Name of a parameter; in quotation marks where it could be read as more than a name."""
    return name if re.fullmatch(r"[\w.\-]{1,80}", name) else printable(json.dumps(name, ensure_ascii=False))


def _interval(low: float, high: float) -> str:
    """Ends of an interval for all of which something is proven, rounded inwards."""
    return f"[{at_most(low, 6)}, {at_least(high, 6)}]"


def _check_system(file: Path, json_: bool) -> None:
    """Check a proof of a gain or of the stability of an uncertain system, or of what no controller can do better."""
    from lftkit.proofs import CheckedLowerBound, CheckedProof, ProofError
    from lftkit.proofs import check_proof as check
    from lftkit.support.threads import one_thread
    from los_design.verification.check_proof_texts import require_plain

    with one_thread():
        checked = check(file)
    if isinstance(checked, CheckedLowerBound):
        print_json(checked._asdict()) if json_ else sys.stdout.write(f"{checked}\n")
        return
    if not isinstance(checked, CheckedProof):
        raise ProofError(f"the file must be a proof of a system, got one of {type(checked).__name__}")
    require_plain((checked.box, checked.disks), "names of a proof")
    band = [checked.band[0], None if math.isinf(checked.band[1]) else checked.band[1]]
    if json_:
        print_json({**vars(checked), "band": band, "margin": min(checked.margin, 1e300)})
        return
    box = ", ".join(f"{_named(name)} in {_interval(*ends)}" for name, ends in checked.box.items())
    upper = "on" if band[1] is None else f"to {at_least(checked.band[1], 6)} rad/s"
    frequencies = f"from {at_most(checked.band[0], 6)} rad/s {upper}"
    sys.stdout.write(f"plant {checked.plant}\n")
    if checked.kind == "gain":
        sys.stdout.write(f"proven: gain below {at_most(checked.level or 0.0, 6)} at all frequencies {frequencies}\n")
    sys.stdout.write("proven: stable\n" if checked.stable else f"{_stability(0.0)}\n")
    sys.stdout.write(f"for all {box or 'parameters (there are none)'}\n")
    sys.stdout.write(
        f"{checked.cells} parts; smallest margin {at_least(checked.margin, 3)} times the bound of all rounding\n"
    )


def _check_loop(file: Path, cluster: Cluster, designs: Path | None, json_: bool) -> None:
    """Check a proof of a sampled loop, and of which loop it is."""
    from lftkit.proofs.sampled_loop import check_loop_proof, read_loop_proof
    from lftkit.proofs.trusted.proof import ProofError
    from lftkit.support.progress import Progress
    from lftkit.support.threads import one_thread
    from los_design.verification.check_proof_texts import require_plain
    from los_design.verification.figure_proofs import loops_of
    from los_design.verification.proof_comparison import ProofComparison, compare_proof, proof_of_loop

    whose = "the shipped controllers and telescope" if designs is None else f"those of {designs}"
    proof = read_loop_proof(file)
    require_plain((proof.names, proof.about), "names and description of a proof")
    stage, figure = (str(proof.about.get(key)) for key in ("stage", "figure"))
    compared = ProofComparison((f"stage, got {stage}",))
    if stage in MIRROR_STAGES:
        loop = loops_of(designs, [stage], warn=warn).stages[stage]
        compared = compare_proof(proof, loop, figure)
        proof = proof_of_loop(proof, loop, figure) if compared.same else proof
    other = printable(", ".join(compared.mismatches))
    if designs is not None and other:
        raise ProofError(f"it is not for {whose}, mismatch: {other}")
    with one_thread(), cluster.workers() as pool, Progress(f"{file.name} [strips]") as bar:
        checked = check_loop_proof(proof, _counted(pool, bar, len(proof.strips)))
    if json_:
        below = checked.stable_below if math.isfinite(checked.stable_below) else None
        mismatches = {"of": str(designs or "shipped"), "mismatches": list(compared.mismatches)}
        print_json({**vars(checked), "stable_below": below, **mismatches})
        return
    sys.stdout.write(f"plant {checked.plant}\n")
    if compared.same:
        sys.stdout.write(f"for {whose}: the loop was rebuilt, and the scalings of the file prove the bound for it\n")
    else:
        sys.stdout.write(f"not for {whose} (mismatch: {other}); the description in the file is not confirmed\n")
    box = ", ".join(f"{_named(name)} {_interval(*ends)}" for name, ends in zip(checked.names, checked.box))
    about = ", ".join(f"{k} {v:.6g}" if isinstance(v, float) else f"{k} {v}" for k, v in checked.about.items())
    box, about = printable(box), printable(about)
    sys.stdout.write(f"proven: {about}: below {at_most(checked.level, 6)} of the limit\n")
    low, high = at_most(checked.band[0], 6), at_least(checked.band[1], 6)
    sys.stdout.write(f"at all frequencies from {low} to {high} rad/s\n")
    sys.stdout.write(f"{_stability(checked.stable_below)}\n")
    sys.stdout.write(f"for all deviations from the nominal values {box} (of an angle [rad])\n")
    sys.stdout.write(f"{checked.strips} strips, {checked.windows} windows of frequency\n")


def _counted(pool: Workers, bar: Progress, total: int) -> Callable[..., Iterator[int | str]]:
    """Map of a check over the strips of successive proofs, `total` in all, with a progress bar."""
    done = itertools.count(1)

    def each(function: Callable[[Any], int | str], strips: Sequence[Any]) -> Iterator[int | str]:
        for outcome in pool.each(function, strips):
            bar.report(next(done), total)
            yield outcome

    return each


def _check_bundle(file: Path, cluster: Cluster, json_: bool) -> None:
    """Check all proofs of a bundle and print what they prove, of what, and what they do not."""
    from lftkit.support.progress import Progress
    from lftkit.support.threads import one_thread
    from los_design.verification.bundle import as_mapping, check_bundle, open_bundle

    shown = Progress(f"{file.name} [strips]")
    with open_bundle(file) as bundle, one_thread(), cluster.workers() as pool, shown as bar:
        checked = check_bundle(bundle, _counted(pool, bar, bundle.count_strips()))
    if json_:
        print_json(as_mapping(checked))
        return
    sys.stdout.write("\n".join(map(printable, _sentences(checked))) + "\n")


def _sentences(checked: CheckedBundle) -> list[str]:
    """Proven statements of a bundle."""
    subject = checked.subject
    box = ", ".join(f"{_named(name)} {_interval(*ends)}" for name, ends in checked.box.items())
    lines = [
        f"bundle {checked.name}: K_FSM {subject.k_fsm}, K_PMA {subject.k_pma}, telescope {subject.telescope}",
        *(f"requirement: {text}" for text in checked.requirements),
        f"for all deviations from the nominal values {box} (of an angle [rad])",
        "and every tone whose amplitudes over all weighted channels of disturbance have norm 1 together:",
    ]
    for figure in checked.figures:
        low, high = at_most(figure.band[0], 6), at_least(figure.band[1], 6)
        lines.append(
            f"proven: {figure.stage}, {figure.text}, {at_most(figure.level)} of the limit, from {low} to {high} rad/s"
        )
    lines += [f"{stage}: {_stability(below, checked.frames.get(stage))}" for stage, below in checked.stable.items()]
    for stage, (absolute, relative) in checked.noise.items():
        both, along = (
            (at_most(wide / RAD_PER_ARCSEC), at_most(fine / RAD_PER_MAS))
            for wide, fine in ((absolute.rms, relative.rms), (absolute.along, relative.along))
        )
        lines.append(
            f"proven: {stage}, noise of the sensors, rms of both axes: {both[0]} arcsec, relative error {both[1]} mas; "
            f"along any axis {along[0]} arcsec and {along[1]} mas"
        )
    lines += [f"from these bounds: {stage}, {row.text}" for stage, rows in checked.sums.items() for row in rows]
    missing = [stage for stage in checked.stable if stage not in checked.noise]
    noise = f"noise of {', '.join(missing)} and its sum with tones, " if missing else ""
    lines.append(
        f"not proven: {noise}saturation, tones above half of the sampling rate, sidebands of sampling, "
        "parameters that vary in time"
    )
    return lines


def _stability(below: float, frames: float | None = None) -> str:
    """Statement about stability, with its condition, if no pole crosses the axis up to a frequency [rad/s].

    `frames`: part of a camera's sample that comes back by its images, where that was proven.
    """
    if math.isinf(below) and frames is not None and frames < 1.0:
        return (
            "proven: stable with the camera's frames, of whose samples images return less than "
            f"{at_most(frames, 2)} (the nominal loop with frames by its eigenvalues), as a loop without the images "
            "that held commands get by uncertain parameters above half of the tick rate"
        )
    if math.isinf(below):
        return "proven: stable, as a loop without the sidebands that sampling makes of uncertain parameters and frames"
    if below:
        return (
            f"proven: stable nominal loop, and no pole crosses the axis up to {at_least(below, 6)} rad/s; "
            "not proven: stable, as poles may cross above"
        )
    return "not proven: stable; the level is that of the frequency response"
