"""Dask's scheduler and worker without their web servers, which listen beside TLS and ask nobody for a certificate."""

from __future__ import annotations

from distributed import Scheduler, Worker


class SchedulerWithoutPages(Scheduler):  # type: ignore[misc, unused-ignore]
    """A scheduler that listens for Dask alone."""

    def start_http_server(self, *_: object, **__: object) -> None:
        """None is started."""


class WorkerWithoutPages(Worker):  # type: ignore[misc, unused-ignore]
    """A worker that listens for Dask alone."""

    def start_http_server(self, *_: object, **__: object) -> None:
        """None is started."""
