"""Command group ``los-testbed export``: the laws as flight code in C."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from lftkit.errors import InputError
from los_testbed.cli.options.options import Designs, TelescopeFile
from pointing_analysis.command.exit_codes import ExitCode
from pointing_analysis.command.options import Json
from pointing_analysis.command.output import print_json
from pointing_analysis.command.screen import Screen, warn

EXPORT_EXAMPLES = """Export the laws as C99: observer, mirror law, proof-mass law, command gates, with a self test.

The C code is bit-identical to the testbed. If there is a C compiler (CC, or cc, gcc, clang), the self test is built
and run; exit code 1 if it fails.

**Examples**

    los-testbed export c                                              # the shipped pair, into flight_code

    los-testbed export c --designs designs/mine --output mine_c
"""

CHECK_EXAMPLES = """Compare the tables in a folder of flight code with a pair of designs.

The hashes are computed from the numbers in the C files, and compared with those that the files state and with those of
the designs. Exit code 1 if any of them differ.

**Examples**

    los-testbed export check flight_code                              # against the shipped pair

    los-testbed export check mine_c --designs designs/mine

    los-testbed export check mine_c --proof proofs.zip                # against the designs of a bundle of proofs
"""

FMU_EXAMPLES = """Export FMI 2.0 co-simulation units for Simulink and other simulators: the laws, or the telescope.

A step is one tick of 1 ms, or several with the same inputs. If the telescope is stepped before the laws, the loop is
bit-identical to the testbed's without sensor noise. The units include their sources, and the library for this system if
there is a C compiler (CC, or cc, gcc, clang).

**Examples**

    los-testbed export fmu                                            # los_law.fmu, the shipped pair

    los-testbed export fmu --telescope --output telescope.fmu             # the telescope under its worst tone

    los-testbed export fmu --windows                                  # with a library for Windows, too
"""

export_app = typer.Typer(help="Flight code of the laws in C.", no_args_is_help=True, rich_markup_mode="markdown")


@export_app.command("c", help=EXPORT_EXAMPLES)
def export_c(
    designs: Designs = None,
    output: Annotated[Path, typer.Option(metavar="FOLDER", help="New folder for the files.")] = Path("flight_code"),
    json_: Json = False,
) -> None:
    """See EXPORT_EXAMPLES."""
    from lftkit.support.atomic_output import check_output
    from los_testbed.flight.export import FILES, write_flight_code
    from los_testbed.flight.laws import laws_of
    from los_testbed.flight.tables import common_hash

    check_output(output, "--output", new=True, folder=True)
    laws = laws_of(designs)
    warn(laws.warnings)
    result = write_flight_code(laws, output)
    digest = common_hash({unit: tables.sha256 for unit, tables in laws.tables().items()})
    console = Screen(stderr=json_)
    lines = {
        "files": f"{len(FILES)} in {output}",
        "laws": f"{laws.k_fsm.name}, order {laws.k_fsm.order}; {laws.k_pma.name}, order {laws.k_pma.order}",
        "tables": f"SHA-256 {digest}",
        "self test": f"{result.status}: {result.text}" + (f" ({result.compiler})" if result.compiler else ""),
    }
    for name, text in lines.items():
        console.print(f"{name:<10}{text}", soft_wrap=True, highlight=False, markup=False)
    if not result.compiler:
        console.print(f"{'':<10}with a compiler: make -C {output} check", soft_wrap=True, highlight=False, markup=False)
    if json_:
        self_test = {"status": result.status, "compiler": result.compiler, "text": result.text}
        print_json({"output": str(output), "files": list(FILES), "tables_sha256": digest, "self_test": self_test})
    if result.status == "failed":
        raise typer.Exit(ExitCode.FAILED)


@export_app.command("check", help=CHECK_EXAMPLES)
def export_check(
    folder: Annotated[Path, typer.Argument(help="Folder of `export c`.")],
    designs: Designs = None,
    proof: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Bundle of `design certify`, instead of the designs.")
    ] = None,
    json_: Json = False,
) -> None:
    """See CHECK_EXAMPLES."""
    from los_testbed.flight.laws import laws_of, laws_of_bundle
    from los_testbed.flight.tables import check_tables

    if not folder.is_dir():
        raise InputError(f"FOLDER must be a folder of flight code, got {folder}")
    if proof is not None and designs is not None:
        raise InputError(f"--proof must be given without --designs, got {designs}")
    laws = laws_of(designs) if proof is None else laws_of_bundle(proof)
    checked = check_tables(folder, laws.tables())
    whose = designs or (f"the proofs in {proof}" if proof else "the shipped designs")
    console = Screen(stderr=json_)
    verdict = "differs:" if checked.faults else f"has the tables of {whose}, SHA-256 {checked.found}"
    console.print(f"{folder} {verdict}", soft_wrap=True, highlight=False, markup=False)
    for fault in checked.faults:
        console.print(f"  {fault}", soft_wrap=True, highlight=False, markup=False)
    if json_:
        print_json({"found": checked.found, "expected": checked.expected, "faults": list(checked.faults)})
    if checked.faults:
        raise typer.Exit(ExitCode.FAILED)


@export_app.command("fmu", help=FMU_EXAMPLES)
def export_fmu(
    designs: Designs = None,
    telescope: Annotated[bool, typer.Option("--telescope", help="The telescope instead of the laws.")] = False,
    parameters: TelescopeFile = None,
    windows: Annotated[bool, typer.Option("--windows", help="Also a library for 64 bit Windows.")] = False,
    output: Annotated[Path | None, typer.Option(metavar="FILE", help="New file, NAME.fmu.")] = None,
    json_: Json = False,
) -> None:
    """See FMU_EXAMPLES."""
    from lftkit.support.atomic_output import check_output
    from los_testbed.config.run_config import RunConfig
    from los_testbed.config.run_settings import of_designs, with_stage
    from los_testbed.flight.fmu import LAW, PLANT, law_model, plant_model, write_fmu
    from los_testbed.flight.laws import laws_of
    from los_testbed.parts.run_parts import RunParts

    path = output or Path(f"{PLANT if telescope else LAW}.fmu")
    check_output(path, "--output", new=True, suffixes=(".fmu",))
    if telescope:
        parameters_setting = {"parameters": None if parameters is None else str(parameters)}
        stated = with_stage({**of_designs(designs or ""), **parameters_setting})
        config = RunConfig.from_mapping({**stated, "mode": "inprocess", "start": "rest"})
        parts = RunParts(config)
        model = plant_model(parts.plant(), parts.ports)
    elif parameters is not None:
        raise InputError("--parameters must be given with --telescope: the laws are those of their designs")
    else:
        laws = laws_of(designs)
        warn(laws.warnings)
        model = law_model(laws)
    built = write_fmu(model, path, windows=windows)
    console = Screen(stderr=json_)
    for name, text in {"unit": str(path), "model": model.description, **built}.items():
        console.print(f"{name:<10}{text}", soft_wrap=True, highlight=False, markup=False)
    if json_:
        print_json({"output": str(path), "tables_sha256": model.sha256, "libraries": built})
