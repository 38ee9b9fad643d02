"""What Foxglove's protocol may change of a run: as the page, with its token, and nothing else."""

from __future__ import annotations

import asyncio
import contextlib
import json
from collections.abc import AsyncIterator, Awaitable, Callable
from typing import Any

import pytest

pytest.importorskip("tornado")
pytest.importorskip("foxglove")
from foxglove_client import FoxgloveSession
from los_testbed.live.foxglove_controls import NO_TOKEN, SERVICES, FoxgloveControls
from los_testbed.live.foxglove_server import FoxgloveServer
from tornado.httpclient import HTTPClientError

TOKEN = "that of the page"
STAGE, NOISE, DROPOUT = "/tele/controller.loop", "/tele/plant.noise", "/tele/plant.camera_dropout"
START = {"loop": "fsm+pma", "noise": True, "disturbance": True, "camera_dropout": 0.0}


class Served:
    """A server in front of a run that takes any stage but "none"."""

    def __init__(self) -> None:
        self.settings: dict[str, Any] = dict(START)
        self.done: list[tuple[str, Any]] = []
        controls = FoxgloveControls("/tele", lambda: dict(self.settings), self._act, TOKEN)
        self.server = FoxgloveServer({}, "127.0.0.1", 0, controls=controls)
        self.address = f"ws://127.0.0.1:{self.server.port}"

    def _act(self, name: str, value: Any) -> None:
        if value == "none" or name == "start":
            raise ValueError(f"{name} must be another, got {value}")
        self.done.append((name, value))
        self.settings.update({name: value} if name in self.settings else {})


@contextlib.asynccontextmanager
async def served() -> AsyncIterator[Served]:
    made = Served()
    try:
        yield made
    finally:
        made.server.stop()


def run(body: Callable[[Served], Awaitable[None]]) -> None:
    async def once() -> None:
        async with served() as run_:
            await body(run_)

    asyncio.run(once())


@pytest.mark.parametrize("token", [None, "another", TOKEN + "x", True])
def test_without_the_token_nothing_is_done_and_the_reason_is_told(token: object) -> None:
    async def body(run_: Served) -> None:
        async with FoxgloveSession(run_.address) as viewer:
            if token is not None:
                assert await viewer.set({"token": token}) == {"token": ""}
            assert await viewer.set({NOISE: False, STAGE: "fsm"}) == {NOISE: True, STAGE: "fsm+pma"}
            for name in SERVICES:
                assert await viewer.call(f"/tele/{name}") == {"success": False, "message": NO_TOKEN}
            assert f"{NOISE}: {NO_TOKEN}" in viewer.told
        assert not run_.done

    run(body)


def test_the_token_is_for_the_connection_that_has_set_it() -> None:
    async def body(run_: Served) -> None:
        async with FoxgloveSession(run_.address) as mine, FoxgloveSession(run_.address) as other:
            assert await mine.set({"token": TOKEN}) == {"token": ""}
            assert (await other.call("/tele/plant/stop"))["success"] is False
            assert await other.set({NOISE: False}) == {NOISE: True}
            assert await mine.set({NOISE: False, STAGE: "fsm", DROPOUT: 1}) == {NOISE: False, STAGE: "fsm", DROPOUT: 1}
            await mine.set({"token": "another"})
            assert (await mine.call("/tele/plant/stop"))["message"] == NO_TOKEN
        async with FoxgloveSession(run_.address) as later:
            assert (await later.call("/tele/plant/stop"))["success"] is False
            assert TOKEN not in json.dumps(await later.parameters())
        assert sorted(run_.done) == [("camera_dropout", 1), ("loop", "fsm"), ("noise", False)]

    run(body)


@pytest.mark.parametrize("headers", [{"Host": "evil.example"}, {"Origin": "https://evil.example"}])
def test_who_may_not_look_may_not_act(headers: dict[str, str]) -> None:
    async def body(run_: Served) -> None:
        with pytest.raises(HTTPClientError) as refused:
            async with FoxgloveSession(run_.address, **headers):
                pass
        assert refused.value.code == 403

    run(body)
