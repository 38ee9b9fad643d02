"""Dask's scheduler and worker without their web servers, which listen without TLS and certificates."""

from __future__ import annotations

from distributed import Scheduler, Worker


class SchedulerWithoutPages(Scheduler):  # type: ignore[misc, unused-ignore]
    """A scheduler without web server."""

    def start_http_server(self, *_: object, **__: object) -> None:
        """None is started."""


class WorkerWithoutPages(Worker):  # type: ignore[misc, unused-ignore]
    """A worker without web server."""

    def start_http_server(self, *_: object, **__: object) -> None:
        """None is started."""
