"""The web server of the page: how many viewers it serves, and what it does with the others."""

import asyncio

import pytest

pytest.importorskip("tornado")
from los_testbed.live.page_server import MAX_VIEWERS, PageServer
from tornado.websocket import websocket_connect

CROWD = 60


async def visit():
    """Codes with which connections were closed, and the number that got frames, before and after one has left."""
    server = PageServer("127.0.0.1", 0, lambda seen: {"tick": 1}, lambda name, value: None)
    address = f"ws://127.0.0.1:{server.port}/data"
    crowd = [await websocket_connect(address) for _ in range(CROWD)]
    first = [await connection.read_message() for connection in crowd]
    codes = [connection.close_code for connection, frame in zip(crowd, first) if frame is None]
    crowd[0].close()
    while len(server.viewers) >= MAX_VIEWERS:
        await asyncio.sleep(0.01)
    late = await websocket_connect(address)
    again = await late.read_message()
    await server.stop()
    return codes, sum(frame is not None for frame in first), again


def test_a_crowd_of_viewers_is_served_up_to_a_number_and_the_others_are_sent_away():
    codes, served, again = asyncio.run(visit())
    assert served == MAX_VIEWERS
    assert codes == [1013] * (CROWD - MAX_VIEWERS)
    assert again == '{"tick":1}'
