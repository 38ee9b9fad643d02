"""From a NASTRAN run to a run of the closed loop: BDF and OP2 of a payload, its modal data, a telescope, a verdict.

python examples/nastran_payload_to_run.py [BDF OP2] [--output FOLDER]

The run is ``SOL 103`` with grid point 1 (the isolator's interface I_p) clamped; grid points 2 to 5 are M1, M2, DET and
I_f (see docs/lftkit/structures.md). Without arguments, files of this form are written for the payload of the reference
telescope: the result must then be that of ``los-testbed run --mode inprocess --case nominal``.
Needs ``pip install 'los-testbed[nastran]'``.
"""

import argparse
import tempfile
from pathlib import Path

import numpy as np
from los_testbed.config.run_config import RunConfig
from los_testbed.run.loop.simulate import run_in_process
from scipy.linalg import eigh

from lftkit.arrays import FloatArray
from lftkit.errors import InputError
from pointing_analysis.read.run import Run
from pointing_analysis.requirements.summary import Summary, summarise
from titop_plant.nastran import nastran_mass, read_nastran
from titop_plant.structures import BeamFrame, mass_summary, write_modal_data
from titop_plant.structures.beam_element import beam_axes
from titop_plant.structures.beam_frame import assemble, rigid_body_modes
from titop_plant.telescope.bodies import payload_frame
from titop_plant.telescope.load import load_telescope

PARENT, PORTS = ("I_p", 1), {"M1": 2, "M2": 3, "DET": 4, "I_f": 5}
MODES = 36


def write_bulk_data(frame: BeamFrame, path: Path) -> None:
    """BDF of a frame: bars, rigid lumped masses, first node clamped."""
    from pyNastran.bdf.bdf import BDF

    model = BDF(debug=None)
    grids = {name: i for i, name in enumerate(frame.nodes, start=1)}
    for name, grid in grids.items():
        model.add_grid(grid, frame.nodes[name])
    for k, beam in enumerate(frame.beams, start=1):
        s = beam.section
        model.add_mat1(k, s.E, s.G, None, rho=s.density)
        model.add_pbar(k, k, A=s.A, i1=s.Iz, i2=s.Iy, j=s.J)
        ends = frame.nodes[beam.start], frame.nodes[beam.end]
        up = beam_axes(*ends, beam.up, frame.name)[1]
        model.add_cbar(k, k, [grids[beam.start], grids[beam.end]], up, None)
    for k, lump in enumerate(frame.masses, start=1001):
        i = lump.inertia
        lower = [i[0, 0], -i[1, 0], i[1, 1], -i[2, 0], -i[2, 1], i[2, 2]]
        model.add_conm2(k, grids[lump.node], lump.mass, X=lump.offset, I=lower)
    model.add_param("COUPMASS", [1])  # consistent masses, as the frame has
    model.add_spc1(1, "123456", [1])
    model.write_bdf(str(path), size=16, is_double=True)


def write_results(frame: BeamFrame, path: Path) -> None:
    """OP2 of a frame clamped at its first node: modes, constraint forces, grid point weight."""
    from pyNastran.op2.op2 import OP2
    from pyNastran.op2.result_objects.grid_point_weight import GridPointWeight
    from pyNastran.op2.tables.oqg_constraintForces.oqg_spc_forces import RealSPCForcesArray
    from pyNastran.op2.tables.oug.oug_eigenvectors import RealEigenvectorArray

    names, M, K = assemble(frame)
    squares, free_shapes = eigh(K[6:, 6:], M[6:, 6:], subset_by_index=(0, MODES - 1))
    shapes = np.vstack([np.zeros((6, MODES)), free_shapes])
    reaction = np.zeros_like(shapes)
    reaction[:6] = (K @ shapes - (M @ shapes) * squares)[:6]
    grids = np.column_stack([np.arange(1, len(names) + 1), np.ones(len(names))]).astype("int32")
    numbers, cycles = np.arange(1, MODES + 1), np.sqrt(squares) / (2 * np.pi)

    def rows(columns: FloatArray) -> FloatArray:
        return columns.T.reshape(MODES, len(names), 6).astype("float32")

    model = OP2(debug=None)
    model.set_as_msc()
    model.is_nx, model.is_msc, model.is_optistruct = False, True, False
    vectors = RealEigenvectorArray.add_modal_case("OUGV1", grids, rows(shapes), 1, numbers, squares, cycles)
    vectors.table_code = vectors.data_code["table_code"] = 7  # eigenvectors, not displacements
    model.eigenvectors[1] = vectors
    forces = RealSPCForcesArray.add_modal_case("OQG1", grids, rows(reaction), 1, numbers, squares, cycles)
    model.spc_forces[1] = forces
    rigid = rigid_body_modes(frame, names, np.zeros(3))
    eye = np.eye(3)
    model.grid_point_weight[""] = GridPointWeight(
        0, rigid.T @ M @ rigid, eye, np.ones(3), 0 * eye, eye, np.ones(3), eye
    )
    model.write_op2(str(path), nastran_format="msc")


def telescope_of(bdf: Path, op2: Path, folder: Path) -> Path:
    """Parameter file of the telescope with the payload of a NASTRAN run; written with its modal data."""
    payload = read_nastran(bdf, op2, name="payload", parent=PARENT, ports=PORTS, damping=0.003)
    write_modal_data(payload, folder / "my_payload.toml", f"from {bdf.name} and {op2.name}")
    print(mass_summary(payload, nastran_mass(bdf, parent=PARENT)))
    path = folder / "my_telescope.toml"
    path.write_text('base = "reference"\n[payload]\nmodal_data = "my_payload.toml"\n', "utf-8")
    return path


def judged(bag: Path, duration: float, parameters: Path | None = None) -> Summary:
    """Run of the closed loop in process, and what the analysis says of its bag."""
    config = RunConfig(mode="inprocess", duration=duration, parameters=str(parameters or ""))
    run_in_process(config, bag)
    return summarise(Run.open(bag))


def main(folder: Path, files: list[Path], duration: float = 10.0) -> Summary:
    """Import, run and print; the files of the telescope and the bag are written into the folder."""
    folder.mkdir(parents=True, exist_ok=True)
    if files:
        bdf, op2 = files
    else:
        bdf, op2 = folder / "payload.bdf", folder / "payload.op2"
        frame = payload_frame(load_telescope()).divided()
        write_bulk_data(frame, bdf)
        write_results(frame, op2)
    found = judged(folder / "bag", duration, telescope_of(bdf, op2, folder))
    print(f"APE {found.ape_max:.4f} arcsec, RPE rms {found.rpe_rms:.3f} mas in {found.ticks} ticks")
    return found


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("files", nargs="*", type=Path, metavar="BDF OP2")
    parser.add_argument("--output", type=Path, help="empty or new folder for telescope and bag")
    arguments = parser.parse_args()
    if len(arguments.files) not in (0, 2):
        parser.error(f"BDF and OP2 must both be given, or neither, got {len(arguments.files)} file")
    with tempfile.TemporaryDirectory() as temporary:
        try:
            main(arguments.output or Path(temporary), arguments.files)
        except (InputError, FileNotFoundError, ImportError) as error:
            parser.exit(2, f"error: {error}\n")
