"""Who gets to the servers of a run: names in Host and Origin, connections that are silent, addresses that are none."""

import asyncio
import contextlib
import os
import shutil
import ssl
import subprocess
from functools import partial

import pytest
from los_testbed.live import gate, page_server
from los_testbed.live.access import Access, certificate
from los_testbed.live.foxglove_server import FoxgloveServer
from los_testbed.live.page_server import MAX_VIEWERS, PageServer
from tornado.websocket import websocket_connect

pytest.importorskip("tornado")
pytest.importorskip("foxglove")

KEY = "Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n"
UPGRADE = f"Connection: Upgrade\r\nUpgrade: websocket\r\n{KEY}"
FOXGLOVE = f"{UPGRADE}Sec-WebSocket-Protocol: foxglove.sdk.v1\r\n"
ANSWER_S = 20.0
CROWD = 300


def page():
    return PageServer("127.0.0.1", 0, lambda seen: {"tick": 1}, lambda name, value: None)


def foxglove():
    return FoxgloveServer({"/telescope/truth/los": "geometry_msgs/msg/Vector3Stamped"}, "127.0.0.1", 0)


@contextlib.asynccontextmanager
async def serving(make):
    server = make()
    try:
        yield server
    finally:
        stopped = server.stop()
        if stopped is not None:
            await stopped


async def ask(server, target="/", host=None, headers=""):
    """Status of the answer to a request; 0 where the connection ends without one."""
    reader, writer = await asyncio.open_connection("127.0.0.1", server.port)
    name = f"127.0.0.1:{server.port}" if host is None else host
    writer.write(f"GET {target} HTTP/1.1\r\nHost: {name}\r\n{headers}\r\n".encode())
    line = await asyncio.wait_for(reader.readline(), ANSWER_S)
    writer.close()
    return int(line.split()[1]) if line else 0


def status(make, **request):
    async def once():
        async with serving(make) as server:
            return await ask(server, **request)

    return asyncio.run(once())


@pytest.mark.parametrize("host", ["127.0.0.1", "localhost:8765", "[::1]:80"])
def test_a_loopback_name_is_served(host):
    assert status(page, host=host) == 200
    assert status(page, target="/data", host=host, headers=UPGRADE) == 101
    assert status(foxglove, host=host, headers=FOXGLOVE) == 101


@pytest.mark.parametrize("host", ["rebound.example", "127.0.0.1.example", "a@localhost", "", "[::1"])
def test_another_name_in_host_is_refused(host):
    assert status(page, host=host) in (400, 403)
    assert status(page, target="/page.js", host=host) in (400, 403)
    assert status(page, target="/data", host=host, headers=UPGRADE) in (400, 403)
    assert status(foxglove, host=host, headers=FOXGLOVE) in (400, 403)


@pytest.mark.parametrize(
    "origin",
    ["https://evil.example", "http://127.0.0.1.evil.example", "null", "file://", "http://localhost@evil.example"],
)
def test_a_page_of_another_site_gets_no_web_socket(origin):
    origin = f"Origin: {origin}\r\n"
    assert status(page, target="/data", headers=UPGRADE + origin) == 403
    assert status(foxglove, headers=FOXGLOVE + origin) == 403


@pytest.mark.parametrize("origin", ["http://localhost:8080", "https://app.foxglove.dev", "http://127.0.0.1:5000"])
def test_a_viewer_on_this_machine_and_that_of_foxglove_get_a_web_socket(origin):
    assert status(foxglove, headers=f"{FOXGLOVE}Origin: {origin}\r\n") == 101


@pytest.mark.parametrize("target", ["/a%00b", "/../page_server.py", "/%2e%2e/frames.py"])
def test_an_address_that_is_no_file_of_the_page_is_not_found(target):
    assert status(page, target=target) in (400, 404)


def descriptors():
    return len(os.listdir("/proc/self/fd"))


@pytest.mark.parametrize(("make", "headers"), [(page, ""), (foxglove, FOXGLOVE)])
def test_silent_connections_have_a_limit_and_the_oldest_is_closed_for_a_new_one(make, headers):
    async def crowd():
        async with serving(make) as server:
            before = descriptors()
            silent = [await asyncio.open_connection("127.0.0.1", server.port) for _ in range(CROWD)]
            answer = await ask(server, headers=headers)
            held = descriptors() - before - len(silent)
            first = await asyncio.wait_for(silent[0][0].read(), ANSWER_S)
            for _, writer in silent:
                writer.close()
            return answer, held, first

    answer, held, first = asyncio.run(crowd())
    assert answer == (101 if headers else 200)
    assert held < CROWD
    assert first == b""


def test_web_sockets_that_never_answer_take_no_place_of_a_viewer():
    async def lock_out():
        async with serving(page) as server:
            silent = [await asyncio.open_connection("127.0.0.1", server.port) for _ in range(2 * MAX_VIEWERS)]
            for reader, writer in silent:
                writer.write(f"GET /data HTTP/1.1\r\nHost: localhost\r\n{UPGRADE}\r\n".encode())
                assert b"101" in await asyncio.wait_for(reader.readline(), ANSWER_S)
            viewer = await websocket_connect(f"ws://127.0.0.1:{server.port}/data")
            frame = await asyncio.wait_for(viewer.read_message(), ANSWER_S)
            viewer.close()
            for _, writer in silent:
                writer.close()
            return frame

    assert asyncio.run(lock_out()) == '{"tick":1}'


def test_a_viewer_that_stops_to_answer_loses_its_place(monkeypatch):
    monkeypatch.setattr(page_server, "PING_S", 1.0)

    async def lock_out():
        async with serving(page) as server:
            address = f"ws://127.0.0.1:{server.port}/data"
            viewers = [await websocket_connect(address) for _ in range(MAX_VIEWERS)]
            for viewer in viewers:
                await asyncio.wait_for(viewer.read_message(), ANSWER_S)
            for viewer in viewers:  # it reads no more, so it answers no ping
                viewer.protocol.stream.io_loop.remove_handler(viewer.protocol.stream.socket)
            while len(server.viewers) >= MAX_VIEWERS:
                await asyncio.sleep(0.05)
            late = await websocket_connect(address)
            return await asyncio.wait_for(late.read_message(), ANSWER_S)

    assert asyncio.run(asyncio.wait_for(lock_out(), 60.0)) == '{"tick":1}'


def test_viewers_of_foxglove_that_take_nothing_are_closed_for_another_one(monkeypatch):
    """Each is a viewer with its first frame; where all of them take what is sent, one more is sent away."""

    async def lock_out():
        async with serving(foxglove) as server:
            viewers = [await asyncio.open_connection("127.0.0.1", server.port) for _ in range(gate.MAX_VIEWERS)]
            for reader, writer in viewers:
                writer.write(f"GET / HTTP/1.1\r\nHost: localhost\r\n{FOXGLOVE}\r\n".encode())
                await asyncio.wait_for(reader.readuntil(b"\r\n\r\n"), ANSWER_S)
                writer.write(bytes([0x89, 0x80, 0, 0, 0, 0]))  # a ping, masked
                await asyncio.wait_for(reader.readuntil(bytes([0x8A, 0])), ANSWER_S)
            monkeypatch.setattr(gate, "STALE_S", 1e6)
            refused = await ask(server, headers=FOXGLOVE)
            monkeypatch.setattr(gate, "STALE_S", 0.0)
            served = await ask(server, headers=FOXGLOVE)
            await asyncio.wait_for(viewers[0][0].read(), ANSWER_S)
            for _, writer in viewers:
                writer.close()
            return refused, served

    assert asyncio.run(lock_out()) == (503, 101)


def test_a_server_that_listens_everywhere_lets_no_page_of_another_address_in():
    """A page at any bare address of the internet is no page of this machine; it has numbers and its own name."""
    access = Access("0.0.0.0")
    assert access.origin("http://192.0.2.5:8080", "192.0.2.5:8765")
    assert access.origin("http://localhost:8080", "192.0.2.5:8765")
    assert access.origin(f"http://{os.uname().nodename}", "192.0.2.5:8765")
    for origin in ("http://203.0.113.9", "https://[2001:db8::9]:443", "http://0.0.0.0", "http://192.0.2.50"):
        assert not access.origin(origin, "192.0.2.5:8765")
        assert not access.origin(origin, "localhost:8765")
    assert not Access("::").origin("http://203.0.113.9", "[2001:db8::5]:8765")
    server = partial(FoxgloveServer, {}, "0.0.0.0", 0)
    for page, wanted in (("http://203.0.113.9", 403), ("http://127.0.0.1:8080", 101)):
        assert status(server, headers=f"{FOXGLOVE}Origin: {page}\r\n") == wanted
    assert access.host("192.0.2.5:8765") and access.host(os.uname().nodename)
    assert not access.host("rebound.example:8765")
    assert Access("testbed.example").host("testbed.example:8766")


@pytest.fixture(scope="module")
def pem(tmp_path_factory):
    if shutil.which("openssl") is None:
        pytest.skip("no openssl on this machine")
    cert, key = (tmp_path_factory.mktemp("tls") / name for name in ("cert.pem", "key.pem"))
    subject = ["-subj", "/CN=localhost", "-addext", "subjectAltName=DNS:localhost", "-days", "1"]
    command = ["openssl", "req", "-x509", "-newkey", "rsa:2048", "-nodes", "-keyout", str(key), "-out", str(cert)]
    subprocess.run([*command, *subject], check=True, capture_output=True)
    return cert, key


@pytest.mark.parametrize(("make", "headers"), [(PageServer, UPGRADE), (FoxgloveServer, FOXGLOVE)])
def test_with_a_certificate_both_servers_are_encrypted(pem, make, headers):
    async def once():
        tls = certificate(*pem)
        server: PageServer | FoxgloveServer
        if make is PageServer:
            server = PageServer("127.0.0.1", 0, lambda seen: {}, lambda name, value: None, tls)
        else:
            server = FoxgloveServer({}, "127.0.0.1", 0, (), tls)
        async with serving(lambda: server):
            trusted = ssl.create_default_context(cafile=str(pem[0]))
            reader, writer = await asyncio.open_connection("localhost", server.port, ssl=trusted)
            writer.write(f"GET /data HTTP/1.1\r\nHost: localhost\r\n{headers}\r\n".encode())
            line = await asyncio.wait_for(reader.readline(), ANSWER_S)
            writer.close()
            plain = 0
            with contextlib.suppress(ConnectionResetError):
                plain = await ask(server, headers=headers)
            return int(line.split()[1]), plain

    assert asyncio.run(once()) == (101, 0)


VISITORS = 60


async def visit():
    """Codes with which connections were closed, and the number that got frames, before and after one has left."""
    server = PageServer("127.0.0.1", 0, lambda seen: {"tick": 1}, lambda name, value: None)
    address = f"ws://127.0.0.1:{server.port}/data"
    crowd = [await websocket_connect(address) for _ in range(VISITORS)]
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
    assert codes == [1013] * (VISITORS - MAX_VIEWERS)
    assert again == '{"tick":1}'
