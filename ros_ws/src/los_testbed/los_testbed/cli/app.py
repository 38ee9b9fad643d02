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

from lftkit.errors import InputError
from lftkit.support.progress import choose_output, write_log
from los_testbed import __version__
from los_testbed.cli.command_group import CommandGroup
from los_testbed.cli.environment import QUIET, SUPERVISED, TRACEBACK
from los_testbed.cli.interrupts import remember_command
from los_testbed.run.processes.memory import TOO_LITTLE_MEMORY, names_memory
from pointing_analysis.command.exit_codes import ExitCode
from pointing_analysis.command.screen import printable

app = typer.Typer(
    cls=CommandGroup,
    name="los-testbed",
    help="Testbed for fine line-of-sight control of a flexible space telescope.",
    no_args_is_help=True,
    add_completion=True,
    rich_markup_mode="markdown",
)


def _print_version(asked: bool) -> None:
    if asked:
        sys.stdout.write(f"los-testbed {__version__}\n")
        raise typer.Exit


@app.callback()
def _options(
    version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version and exit.")
    ] = False,
    quiet: Annotated[
        bool, typer.Option("--quiet", help="Suppress progress output; warnings and errors remain.")
    ] = False,
    verbose: Annotated[bool, typer.Option("--verbose", help="Progress each second; errors with traceback.")] = False,
    log: Annotated[
        Path | None, typer.Option("--log", metavar="FILE", help="Also append progress to this file.")
    ] = None,
) -> None:
    """Testbed for fine line-of-sight control of a flexible space telescope."""
    if quiet and verbose:
        raise InputError("--quiet and --verbose must not be given together, got both")
    if verbose:
        os.environ[TRACEBACK] = "1"
    try:
        choose_output(quiet=quiet or bool(os.environ.get(QUIET)), interval=1.0 if verbose else 10.0, log=log)
    except OSError as error:
        raise InputError(f"--log must be a writable file, got {log}: {error.strerror}") from None


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
                    raise InputError("--log must be followed by a FILE, got nothing")
                first.append(file)
        else:
            rest.append(argument)
    return first + rest


NO_PATH = (errno.ENAMETOOLONG, errno.ELOOP)
"""Errors caused only by a path on the command line or in a user's file."""

AGAIN_S = 0.05


def _interrupt(number: int, frame: Any) -> None:
    raise KeyboardInterrupt


def _not_raised(lost: sys.UnraisableHookArgs) -> None:
    """Re-raise an interrupt from a callback of the garbage collector, where exceptions are swallowed."""
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
    """Entry point: a user error is one line on the error output and exit code 2, a failure 1.

    SIGINT, SIGTERM and SIGHUP end a command alike: what it was writing is removed or completed, the exit code is 130.
    """
    if arguments is None:  # the program itself: it reports what ends it
        os.environ[SUPERVISED] = "1"
    for number in (signal.SIGTERM, signal.SIGHUP):
        if signal.getsignal(number) is not signal.SIG_IGN:  # nohup
            signal.signal(number, _interrupt)
    signal.signal(signal.SIGALRM, _interrupt)
    sys.unraisablehook = _not_raised
    try:
        words = sys.argv[1:] if arguments is None else arguments
        remember_command(words)
        ordered = with_common_options_first(_with_lone_options(words))
        result = command_line()(args=ordered, prog_name="los-testbed", standalone_mode=False)
    except typer.Exit as stop:
        return _leave(int(stop.exit_code))
    except (typer.Abort, KeyboardInterrupt):
        return _fail("interrupted", ExitCode.INTERRUPTED)
    except ValueError as error:
        if not _is_refusal(error):
            return _fail(_unexpected(error), ExitCode.FAILED)
        return _fail(str(error), int(getattr(error, "code", ExitCode.USER_ERROR)))
    except OSError as error:
        if error.errno in NO_PATH:
            return _fail(
                f"a path must be valid, got {str(error.filename)[:80]!r}: {error.strerror}",
                ExitCode.USER_ERROR,
            )
        return _fail(_with_memory(error), ExitCode.FAILED)
    except RuntimeError as error:
        return _fail(_with_memory(error), int(getattr(error, "code", ExitCode.FAILED)))
    except (MemoryError, ImportError) as error:
        return _fail(_with_memory(error), ExitCode.FAILED)
    except Exception as error:
        if type(error).__module__.startswith(("click", "typer")) and hasattr(error, "format_message"):
            return _fail(error.format_message(), ExitCode.USER_ERROR)
        return _fail(_with_memory(error) if names_memory(str(error)) else _unexpected(error), ExitCode.FAILED)
    except BaseException as error:  # of another package: no class of this one is that
        if isinstance(error, (SystemExit, GeneratorExit)):
            raise
        return _fail(_unexpected(error), ExitCode.FAILED)
    if result == ExitCode.INTERRUPTED:  # typer makes this of a KeyboardInterrupt
        return _fail("interrupted", ExitCode.INTERRUPTED)
    return _leave(result if isinstance(result, int) else 0)


def _with_lone_options(arguments: Sequence[str]) -> Sequence[str]:
    """Result of :func:`los_testbed.cli.run.with_lone_options` for the words of a command."""
    if all(argument.startswith("-") for argument in arguments):
        return arguments  # without a command: help or version, which need no import
    from los_testbed.cli.run import with_lone_options

    return with_lone_options(arguments)


def _is_refusal(error: ValueError) -> bool:
    """Whether an error says what was wrong with the input; any other ValueError is a bug of this program."""
    if isinstance(error, InputError):
        return True
    from lftkit.proofs.trusted.proof import ProofError  # the trusted code imports nothing else of the library

    return isinstance(error, ProofError)


def _with_memory(error: BaseException) -> str:
    """Message of an error; a memory limit causes errors of many types."""
    if isinstance(error, MemoryError) or names_memory(f"{type(error).__name__}: {error}"):
        return f"{TOO_LITTLE_MEMORY}: {str(error) or 'an allocation failed'}"
    return f"a package cannot be loaded: {error}" if isinstance(error, ImportError) else str(error)


def _unexpected(error: BaseException) -> str:
    """One line about an unexpected error; with a traceback if requested."""
    if os.environ.get(TRACEBACK):
        traceback.print_exception(error)
    frames = traceback.extract_tb(error.__traceback__)
    place = f"{Path(frames[-1].filename).name}, line {frames[-1].lineno}" if frames else "unknown place"
    return f"unexpected {type(error).__name__} in {place}: {error} (a bug: please report it)"


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
