"""Command line ``los-testbed`` with all its commands, from run to export."""

from __future__ import annotations

import errno
import os
import signal
import sys
import traceback
from collections.abc import Callable, Sequence
from functools import cache
from pathlib import Path
from typing import Annotated, Any

import typer

from lftkit.support.progress import choose_output, write_log
from los_testbed import __version__
from los_testbed.cli.analyse import ANALYSE_EXAMPLES, analyse
from los_testbed.cli.bag import bag_app
from los_testbed.cli.bag_checks import INFO_EXAMPLES, SIGN_EXAMPLES, VERIFY_EXAMPLES, info, sign, verify
from los_testbed.cli.bag_topics import TOPICS_EXAMPLES, topics
from los_testbed.cli.budget import BUDGET_EXAMPLES, budget
from los_testbed.cli.campaign import CAMPAIGN_EXAMPLES, campaign
from los_testbed.cli.check_proof import CHECK_PROOF_EXAMPLES, check_proof
from los_testbed.cli.control import control_app
from los_testbed.cli.design import design_app
from los_testbed.cli.export import export_app
from los_testbed.cli.image import image_app
from los_testbed.cli.keys import KEYS_EXAMPLES, keys
from los_testbed.cli.plant import plant_app
from los_testbed.cli.proofs import CERTIFY_EXAMPLES, certify
from los_testbed.cli.replay import REPLAY_EXAMPLES, replay
from los_testbed.cli.report import REPORT_EXAMPLES, report
from los_testbed.cli.run import RUN_EXAMPLES, SUPERVISED, run, with_lone_options
from los_testbed.cli.stages import STAGES_EXAMPLES, stages
from los_testbed.exit_codes import ExitCode
from los_testbed.loop.simulate import LoopDivergedError
from los_testbed.run.memory import TOO_LITTLE_MEMORY
from los_testbed.run.screen import printable

app = typer.Typer(
    name="los-testbed",
    help="Testbed for fine line-of-sight control of a flexible space telescope.",
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode="markdown",
)
app.command(name="run", help=RUN_EXAMPLES)(run)
app.command(name="analyse", help=ANALYSE_EXAMPLES)(analyse)
app.command(name="report", help=REPORT_EXAMPLES)(report)
app.command(name="replay", help=REPLAY_EXAMPLES)(replay)
app.command(name="budget", help=BUDGET_EXAMPLES)(budget)
app.command(name="stages", help=STAGES_EXAMPLES)(stages)
app.command(name="campaign", help=CAMPAIGN_EXAMPLES)(campaign)
app.command(name="keys", help=KEYS_EXAMPLES)(keys)
bag_app.command(name="topics", help=TOPICS_EXAMPLES)(topics)
bag_app.command(name="info", help=INFO_EXAMPLES)(info)
bag_app.command(name="verify", help=VERIFY_EXAMPLES)(verify)
bag_app.command(name="sign", help=SIGN_EXAMPLES)(sign)
app.add_typer(bag_app, name="bag")
app.add_typer(image_app, name="image")
app.add_typer(control_app, name="control")
app.add_typer(plant_app, name="plant")
design_app.command("certify", help=CERTIFY_EXAMPLES)(certify)
design_app.command("check-proof", help=CHECK_PROOF_EXAMPLES)(check_proof)
app.add_typer(design_app, name="design")
app.add_typer(export_app, name="export")


def _print_version(asked: bool) -> None:
    if asked:
        sys.stdout.write(f"los-testbed {__version__}\n")
        raise typer.Exit


@app.callback()
def _options(
    version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version and exit.")
    ] = False,
    quiet: Annotated[bool, typer.Option("--quiet", help="No progress; warnings and errors stay.")] = False,
    verbose: Annotated[bool, typer.Option("--verbose", help="Progress each second; errors with their place.")] = False,
    log: Annotated[Path | None, typer.Option("--log", metavar="FILE", help="Also append progress to a file.")] = None,
) -> None:
    """Testbed for fine line-of-sight control of a flexible space telescope."""
    if quiet and verbose:
        raise ValueError("--quiet and --verbose must not be given together, got both")
    if verbose:
        os.environ[TRACEBACK] = "1"
    try:
        choose_output(quiet=quiet or bool(os.environ.get(QUIET)), interval=1.0 if verbose else 10.0, log=log)
    except OSError as error:
        raise ValueError(f"--log must be a file that can be written, got {log}: {error.strerror}") from None


QUIET, TRACEBACK = "LOS_TESTBED_QUIET", "LOS_TESTBED_TRACEBACK"
"""Variables of the environment: as ``--quiet``; unexpected errors with their place."""
COMMON = ("--quiet", "--verbose", "--log")
"""Options of all commands, which may stand anywhere on the command line."""


def with_common_options_first(arguments: Sequence[str]) -> list[str]:
    """The command line with the options of all commands before the command.

    Examples
    --------
    >>> with_common_options_first(["run", "--seed", "3", "--quiet", "--log", "run.log"])
    ['--quiet', '--log', 'run.log', 'run', '--seed', '3']
    """
    first, rest, waiting = [], [], iter(arguments)
    for argument in waiting:
        if argument == "--":
            rest += [argument, *waiting]
        elif argument.split("=")[0] in COMMON:
            first.append(argument)
            if argument == "--log":
                if (file := next(waiting, None)) is None:
                    raise ValueError("--log must be followed by a FILE, got nothing")
                first.append(file)
        else:
            rest.append(argument)
    return first + rest


NO_PATH = (errno.ENAMETOOLONG, errno.ELOOP)
"""Errors that only a path on the command line, or in a file of the user, can be the cause of."""

AGAIN_S = 0.05


def _interrupt(number: int, frame: Any) -> None:
    raise KeyboardInterrupt


def _not_raised(lost: sys.UnraisableHookArgs) -> None:
    """Raise an interrupt again that came where no exception can leave: in a callback of the garbage collector."""
    if issubclass(lost.exc_type, KeyboardInterrupt):
        signal.setitimer(signal.ITIMER_REAL, AGAIN_S)
    else:
        sys.__unraisablehook__(lost)


@cache
def command_line() -> Callable[..., Any]:
    """The commands with their options, put together once."""
    made: Callable[..., Any] = typer.main.get_command(app)
    return made


def main(arguments: list[str] | None = None) -> int:
    """Entry point: mistakes are one line on the error output and exit code 2, failures 1.

    SIGINT, SIGTERM and SIGHUP end a command alike: what it was writing is removed or completed, the exit code is 130.
    """
    if arguments is None:  # this is the program: what ends it is ours to tell
        os.environ[SUPERVISED] = "1"
    for number in (signal.SIGTERM, signal.SIGHUP):
        if signal.getsignal(number) is not signal.SIG_IGN:  # nohup
            signal.signal(number, _interrupt)
    signal.signal(signal.SIGALRM, _interrupt)
    sys.unraisablehook = _not_raised
    try:
        given = with_common_options_first(with_lone_options(sys.argv[1:] if arguments is None else arguments))
        result = command_line()(args=given, prog_name="los-testbed", standalone_mode=False)
    except typer.Exit as stop:
        return _leave(int(stop.exit_code))
    except (typer.Abort, KeyboardInterrupt):
        return _fail("interrupted", ExitCode.INTERRUPTED)
    except ValueError as error:
        return _fail(str(error), int(getattr(error, "code", ExitCode.USER_ERROR)))
    except OSError as error:
        if error.errno in NO_PATH:
            return _fail(
                f"a path must be one that can exist, got {str(error.filename)[:80]!r}: {error.strerror}",
                ExitCode.USER_ERROR,
            )
        return _fail(str(error), ExitCode.FAILED)
    except LoopDivergedError as error:
        return _fail(str(error), ExitCode.FAILED)
    except RuntimeError as error:
        return _fail(str(error), int(getattr(error, "code", ExitCode.FAILED)))
    except MemoryError as error:
        return _fail(f"{TOO_LITTLE_MEMORY}: {error or 'an allocation failed'}", ExitCode.FAILED)
    except Exception as error:
        if type(error).__module__.startswith(("click", "typer")) and hasattr(error, "format_message"):
            return _fail(error.format_message(), ExitCode.USER_ERROR)
        return _fail(_unexpected(error), ExitCode.FAILED)
    except BaseException as error:  # of another package: no class of this one is that
        if isinstance(error, (SystemExit, GeneratorExit)):
            raise
        return _fail(_unexpected(error), ExitCode.FAILED)
    if result == ExitCode.INTERRUPTED:  # typer makes this of a KeyboardInterrupt
        return _fail("interrupted", ExitCode.INTERRUPTED)
    return _leave(result if isinstance(result, int) else 0)


def _unexpected(error: BaseException) -> str:
    """One line about an error that no check has foreseen; the whole of it where it is asked for."""
    if os.environ.get(TRACEBACK):
        traceback.print_exception(error)
    frames = traceback.extract_tb(error.__traceback__)
    place = f"{Path(frames[-1].filename).name}, line {frames[-1].lineno}" if frames else "unknown place"
    return f"unexpected {type(error).__name__} in {place}: {error} (a mistake of this program: please report it)"


def _leave(code: int) -> int:
    if code:
        sys.exit(code)
    return 0


def _fail(message: str, code: int) -> int:
    line = f"los-testbed: {printable(' '.join(message.split()))}"
    sys.stderr.write(f"{line}\n")
    write_log(line)
    sys.exit(code)


if __name__ == "__main__":
    main()
