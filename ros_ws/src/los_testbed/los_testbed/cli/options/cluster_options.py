"""Options for the processes of a command: of this machine, or of a cluster."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from lftkit.support.workers import processors
from los_testbed.cli.options.options import with_options
from pointing_analysis.command.output import number

if TYPE_CHECKING:
    from lftkit.support.workers import Workers
    from los_testbed.campaign.cluster.tls_files import TlsFiles

WorkersOption = Annotated[
    int, typer.Option("--workers", help="Processes; 0: one per processor. Results do not depend on it.")
]
SchedulerOption = Annotated[
    str, typer.Option("--scheduler", metavar="tls://HOST:PORT", help="Address of a running Dask scheduler.")
]
TlsCaFile = Annotated[
    Path | None, typer.Option("--tls-ca-file", metavar="FILE", help="For tls://: CA certificates (PEM).")
]
TlsCertificate = Annotated[
    Path | None, typer.Option("--tls-cert", metavar="FILE", help="For tls://: client certificate (PEM).")
]
TlsKey = Annotated[
    Path | None, typer.Option("--tls-key", metavar="FILE", help="Private key of --tls-cert; default: in the same file.")
]


def with_cluster(command: Callable[..., None]) -> Callable[..., None]:
    """Give a command the options of the processes that compute; it gets them as ``cluster``, a :class:`Cluster`."""
    options = {
        "workers": (WorkersOption, 0),
        "scheduler": (SchedulerOption, ""),
        "tls_ca_file": (TlsCaFile, None),
        "tls_cert": (TlsCertificate, None),
        "tls_key": (TlsKey, None),
    }
    return with_options(command, "cluster", options, Cluster.of)


def processes(workers: int) -> int:
    """The number of processes of an option."""
    number("--workers", workers, 0, 1000)
    return workers or processors()


@dataclass(frozen=True)
class Cluster:
    """Processes of this machine, or the workers of a scheduler.

    Parameters
    ----------
    count : int
        Processes of this machine.
    scheduler : str
        Address; empty: there is none.
    tls : TlsFiles, optional
    """

    count: int
    scheduler: str = ""
    tls: TlsFiles | None = None

    @classmethod
    def of(
        cls, workers: int, scheduler: str, tls_ca_file: Path | None, tls_cert: Path | None, tls_key: Path | None
    ) -> Cluster:
        """From the options.

        Raises
        ------
        ValueError
            A number of processes out of range, or invalid certificates.
        """
        from los_testbed.campaign.cluster.tls_files import TlsFiles

        return cls(processes(workers), scheduler, TlsFiles.of(scheduler, tls_ca_file, tls_cert, tls_key))

    @contextmanager
    def workers(self) -> Iterator[Workers]:
        """Workers with the results of one.

        Raises
        ------
        ValueError
            No scheduler at the address, one without workers, or a worker with other versions.
        """
        from lftkit.support.workers import Workers

        if not self.scheduler:
            with Workers(self.count) as here:
                yield here
            return
        from los_testbed.campaign.cluster_work import ClusterWorkers, connected

        with connected(self.scheduler, self.tls) as client, ClusterWorkers(client, self.count) as there:
            yield there
