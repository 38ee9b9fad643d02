"""Command ``los-testbed control``: change a run in progress."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Annotated

import typer

from lftkit.errors import InputError
from los_testbed.cli.options.options import option
from los_testbed.config.run_config import NAMESPACE, RunConfig
from los_testbed.run.loop.changes import owner_of
from pointing_analysis.command.output import number, seconds
from pointing_analysis.files.structured_text import load_yaml

if TYPE_CHECKING:
    from los_testbed.nodes.remote_control import RemoteControl

control_app = typer.Typer(
    help="Change a run on this machine: start, stop, reset, stage, noise, disturbance, authority, camera, life cycle.",
    no_args_is_help=True,
)

Domain = Annotated[int | None, option("domain")]
Namespace = Annotated[str, option("namespace")]
At = Annotated[float | None, typer.Option(metavar="SECONDS", help="Time from the start of the run; default: now.")]
Timeout = Annotated[float, typer.Option(metavar="SECONDS", help="Longest wait for a response [s].")]


@contextmanager
def _remote(domain: int | None, namespace: str, timeout: float, at: float | None = None) -> Iterator[RemoteControl]:
    domain = RunConfig(namespace=namespace, domain=domain).domain
    number("--timeout", timeout, 0.0, 86400.0, "s")
    seconds("--at", at, 1e6)
    from los_testbed.run.processes.node_launch import check_ros

    check_ros(domain)
    from los_testbed.nodes.remote_control import remote_control

    with remote_control(domain, namespace, timeout) as remote:
        yield remote


@control_app.command()
def stage(
    loop: Annotated[str, typer.Argument(help="isolator, fsm or fsm+pma.")],
    at: At = None,
    domain: Domain = None,
    namespace: Namespace = NAMESPACE,
    timeout: Timeout = 10.0,
) -> None:
    """Switch to another stage at one tick; commands fade in and out within fade_ticks."""
    RunConfig(loop=loop)
    with _remote(domain, namespace, timeout, at) as remote:
        remote.change("stage", loop, at)


@control_app.command()
def fault(
    name: Annotated[str, typer.Argument(help="noise, disturbance, camera_dropout, fsm_authority or pma_authority.")],
    value: Annotated[str, typer.Argument(help="New value, such as true, false or 0.2.")],
    at: At = None,
    domain: Domain = None,
    namespace: Namespace = NAMESPACE,
    timeout: Timeout = 10.0,
) -> None:
    """Change a setting of plant or controller at one tick."""
    owner_of(name)
    content = load_yaml(value, "VALUE")
    if not isinstance(content, (bool, int, float, str)):
        raise InputError(f"VALUE must be true, false, a number or a name, got {value!r}")
    with _remote(domain, namespace, timeout, at) as remote:
        remote.change(name, content, at)


@control_app.command()
def start(domain: Domain = None, namespace: Namespace = NAMESPACE, timeout: Timeout = 10.0) -> None:
    """Start a run that waits for its start (run --set wait_for_start=true)."""
    with _remote(domain, namespace, timeout) as remote:
        remote.trigger("start")


def _end(name: str, at: float | None, domain: int | None, namespace: str, timeout: float) -> None:
    with _remote(domain, namespace, timeout, at) as remote:
        if at is None:
            remote.trigger(name)
        else:
            remote.change(name, True, at)


@control_app.command()
def stop(at: At = None, domain: Domain = None, namespace: Namespace = NAMESPACE, timeout: Timeout = 10.0) -> None:
    """End the run at one tick; its bag is complete."""
    _end("stop", at, domain, namespace, timeout)


@control_app.command()
def reset(at: At = None, domain: Domain = None, namespace: Namespace = NAMESPACE, timeout: Timeout = 10.0) -> None:
    """Restart the run at one tick, with its initial settings and another bag (NAME-2)."""
    _end("reset", at, domain, namespace, timeout)


def _turn(node: str, transition: str, domain: int | None, namespace: str, timeout: float) -> None:
    if node not in ("estimator", "controller"):
        raise InputError(f"node must be estimator or controller, got {node!r}")
    with _remote(domain, namespace, timeout) as remote:
        remote.turn(node, transition)


@control_app.command()
def deactivate(
    node: Annotated[str, typer.Argument(help="estimator or controller.")],
    domain: Domain = None,
    namespace: Namespace = NAMESPACE,
    timeout: Timeout = 10.0,
) -> None:
    """Fade the output of a node to zero."""
    _turn(node, "deactivate", domain, namespace, timeout)


@control_app.command()
def activate(
    node: Annotated[str, typer.Argument(help="estimator or controller.")],
    domain: Domain = None,
    namespace: Namespace = NAMESPACE,
    timeout: Timeout = 10.0,
) -> None:
    """Fade the output of a node in again."""
    _turn(node, "activate", domain, namespace, timeout)
