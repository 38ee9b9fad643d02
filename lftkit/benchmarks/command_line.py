"""Norms, frequency responses or tuning beside others: one JSON object for each row."""

from __future__ import annotations

import argparse
import json
import sys
from contextlib import suppress

from lftkit.benchmarks import norms, responses, tuning
from lftkit.support.threads import one_thread
from lftkit.tuning.published_plants import PLANTS


def whole_numbers(text: str) -> tuple[int, ...]:
    """Positive whole numbers separated by commas."""
    parts = text.split(",")
    if not all(part.isdigit() and int(part) > 0 for part in parts):
        raise argparse.ArgumentTypeError(f"expected positive whole numbers separated by commas, got {text!r}")
    return tuple(map(int, parts))


def whole_number(text: str) -> int:
    """A whole number from 0 on."""
    if not text.isdigit():
        raise argparse.ArgumentTypeError(f"expected a whole number from 0 on, got {text!r}")
    return int(text)


def names_of_plants(text: str) -> tuple[str, ...]:
    """Names of published plants separated by commas."""
    names = tuple(text.split(","))
    if unknown := [name for name in names if name not in PLANTS]:
        raise argparse.ArgumentTypeError(f"expected some of {', '.join(PLANTS)}, got {', '.join(unknown)}")
    return names


def positive(text: str) -> float:
    """A positive number."""
    with suppress(ValueError):
        if 0.0 < float(text) < float("inf"):
            return float(text)
    raise argparse.ArgumentTypeError(f"expected a positive number, got {text!r}")


def parser() -> argparse.ArgumentParser:
    """Of the command line."""
    whole = argparse.ArgumentParser(prog="python -m lftkit.benchmarks", description=__doc__)
    commands = whole.add_subparsers(dest="command", required=True)
    command = commands.add_parser("norms", help=norms.__doc__)
    command.add_argument("--orders", type=whole_numbers, default=norms.ORDERS, help="numbers of states")
    command.add_argument(
        "--samples", type=lambda text: whole_numbers(text)[0], default=10, help="systems of each order"
    )
    command = commands.add_parser("responses", help=responses.__doc__)
    command.add_argument("--orders", type=whole_numbers, default=responses.ORDERS, help="numbers of states, 2 at least")
    command = commands.add_parser("tuning", help=tuning.__doc__)
    command.add_argument("--plants", type=names_of_plants, default=tuple(PLANTS), help="names, separated by commas")
    command.add_argument("--order", type=whole_number, default=0, help="states of the controller")
    command.add_argument("--seconds", type=positive, default=60.0, help="wall limit of the tuner for a plant [s]")
    return whole


def main(arguments: list[str] | None = None) -> None:
    """Measure and print."""
    options = parser().parse_args(arguments)
    with one_thread():
        if options.command == "norms":
            rows = norms.compared(options.orders, options.samples)
        elif options.command == "responses":
            rows = responses.compared(options.orders)
        else:
            rows = tuning.compared(options.plants, options.order, options.seconds)
        for row in rows:
            sys.stdout.write(json.dumps(row) + "\n")
            sys.stdout.flush()
