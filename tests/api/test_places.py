"""Whatever one client holds open, a stranger is answered: bodies, streams, sockets, orders."""

import base64
import json
import os
import socket
import sys
import threading
from contextlib import ExitStack, contextmanager

import httpx
import pytest

from api.errors import Problem
from api.guard.keys import Caller, Places, client_of, digest_of
from api.settings import SCOPES
from tests.api.conftest import wav
from tests.api.server import Server, serving, wait_for

MANY = 60
"""Requests that the greedy client sends at once, of 40 that a server takes."""
GREEDY, STRANGER = "dk_greedy-key-of-the-tests", "dk_stranger-key-of-the-tests"
PARTS = 20  # of the 40: it may take another while it has fewer than are free


@pytest.mark.parametrize(
    ("most", "held"), [(1, [1]), (4, [2, 1, 1]), (40, [20, 10, 5]), (256, [128, 64, 32])]
)
def test_each_greedy_holder_leaves_as_many_places_as_it_has(most, held):
    with ExitStack() as stack:
        places = Places(most)
        for holder, count in enumerate(held):
            for _ in range(count):
                stack.enter_context(places.hold(str(holder)))
            with pytest.raises(Problem) as refused:
                places.check(str(holder))
            assert refused.value.status == (503 if places.taken == most else 429)
        assert places.taken == sum(held)
    assert not places.held and places.taken == 0


def test_limit_of_a_key_is_below_its_part():
    places = Places(100)
    with places.hold("a", 2), places.hold("a", 2):
        with pytest.raises(Problem, match="has 2 at work"):
            places.check("a", 2)
        places.check("b", 2)


@pytest.mark.parametrize(
    ("address", "client"),
    [
        ("10.0.0.7", "10.0.0.7"),
        ("2001:db8:1:2:3:4:5:6", "2001:db8:1:2::/64"),
        ("2001:db8:1:2:ffff::1", "2001:db8:1:2::/64"),
        ("::1", "::/64"),
        ("unknown", "unknown"),
        ("a:b", "a:b"),
    ],
)
def test_addresses_of_one_network_of_ipv6_are_one_client(address, client):
    assert client_of(address) == client


def test_callers_without_keys_are_told_apart_by_their_address():
    local = Caller("local", SCOPES, 10, 600, address="10.0.0.7")
    assert local.holder == "address 10.0.0.7"
    assert Caller("farm", SCOPES, 10, 600).holder == "key farm"


@pytest.fixture(scope="module")
def keyed(tmp_path_factory):
    keys = [
        {"name": name, "sha256": digest_of(key), "requests_per_minute": 10**6, "concurrent": 10**4,
         "live": 100}
        for name, key in (("greedy", GREEDY), ("stranger", STRANGER))
    ]  # fmt: skip
    with serving(
        tmp_path_factory.mktemp("keyed"), keys=json.dumps(keys), connections=40, waiting=7,
        job_workers=0, live_sessions=6, body_seconds=30, header_seconds=30,
    ) as running:  # fmt: skip
        yield running


@pytest.fixture(scope="module")
def open_to_all(tmp_path_factory):
    """Without keys: clients are told apart by their address."""
    with serving(
        tmp_path_factory.mktemp("open"), connections=40, waiting=7, job_workers=0, live_sessions=6,
        body_seconds=30, header_seconds=30, requests_per_minute=10**6,
    ) as running:  # fmt: skip
        yield running


class Client:
    """One of the two clients of a server: a key, or an address of this machine."""

    def __init__(self, server: Server, key: str, address: str) -> None:
        self.server, self.job = server, ""
        self.headers = {"Authorization": f"Bearer {key}"} if key else {}
        self.source = "" if key else address

    def connect(self) -> socket.socket:
        return socket.create_connection(
            self.server.address, timeout=300, source_address=(self.source, 0)
        )

    def send(self, head: str, body: bytes = b"", **headers: str) -> socket.socket:
        """A connection that has sent a request."""
        given = {"Host": self.server.url[7:], **self.headers, **headers}
        lines = [f"{name.replace('_', '-')}: {value}\r\n" for name, value in given.items()]
        connection = self.connect()
        connection.sendall(f"{head} HTTP/1.1\r\n{''.join(lines)}\r\n".encode() + body)
        return connection

    def http(self) -> httpx.Client:
        transport = httpx.HTTPTransport(local_address=self.source or None)
        return httpx.Client(
            base_url=self.server.url, headers=self.headers, transport=transport, timeout=300
        )


def clients_of(request, by):
    """The greedy client and the stranger, told apart by their keys or their addresses."""
    if by == "keys":
        server = request.getfixturevalue("keyed")
        return Client(server, GREEDY, ""), Client(server, STRANGER, "")
    if not sys.platform.startswith("linux"):
        pytest.skip("only Linux has every address of 127.0.0.0/8")
    server = request.getfixturevalue("open_to_all")
    return Client(server, "", "127.0.0.1"), Client(server, "", "127.0.0.2")


def trickling_body(client):
    return client.send("POST /v1/animations", b"RIFF", Content_Length="9000")


def trickling_form(client):
    return client.send(
        "POST /v1/jobs", b"--x\r\n", Content_Length="9000",
        Content_Type="multipart/form-data; boundary=x",
    )  # fmt: skip


def trickling_chunks(client):
    return client.send("POST /v1/validate", b"1\r\n-", Transfer_Encoding="chunked",
                       Content_Type="multipart/form-data; boundary=x")  # fmt: skip


def half_a_head(client):
    connection = client.connect()
    connection.sendall(b"GET /v1/models HTTP/1.1\r\nHost: 127.0.0.1\r\nX: ")
    return connection


def half_a_handshake(client):
    connection = client.connect()
    connection.sendall(b"GET /v1/live HTTP/1.1\r\nHost: 127.0.0.1\r\nUpgrade: websocket\r\n")
    return connection


def silent_session(client):
    key = base64.b64encode(os.urandom(16)).decode()
    return client.send(
        "GET /v1/live", Upgrade="websocket", Connection="Upgrade", Sec_WebSocket_Version="13",
        Sec_WebSocket_Key=key,
    )  # fmt: skip


def event_stream(client):
    if not client.job:
        with client.http() as http:
            client.job = http.post("/v1/jobs?format=csv", content=wav(0.3)).json()["id"]
    return client.send(f"GET /v1/jobs/{client.job}/events")


KINDS = [
    *(
        (kind, "keys")
        for kind in (trickling_form, trickling_chunks, half_a_handshake, event_stream)
    ),
    *((kind, "addresses") for kind in (trickling_body, half_a_head, silent_session)),
]


@contextmanager
def held(client, kind):
    """As many open requests of a kind as a client can make, some of them trickling on."""
    over = threading.Event()
    with ExitStack() as stack:
        connections = [stack.enter_context(kind(client)) for _ in range(MANY)]

        def trickle():
            while not over.wait(0.2):
                for connection in connections:
                    try:
                        connection.send(b"0")
                    except OSError:
                        continue

        thread = threading.Thread(target=trickle, daemon=True)
        if kind in (trickling_body, trickling_form, half_a_head):
            thread.start()
        try:
            yield connections
        finally:
            over.set()
            if thread.ident:
                thread.join()


def is_refused(connection):
    """Whether an answer has come that there are too many."""
    connection.setblocking(False)
    try:
        return b" 429 " in connection.recv(4096)
    except OSError:
        return False


@pytest.mark.parametrize(("kind", "by"), KINDS)
def test_stranger_is_answered_whatever_another_holds_open(request, kind, by):
    greedy, stranger = clients_of(request, by)
    with held(greedy, kind) as connections, stranger.http() as http:
        assert http.get("/v1/models").status_code == 200
        assert http.post("/v1/animations?format=csv", content=wav(0.3)).status_code == 200
        answer = http.post("/v1/jobs?format=csv", content=wav(0.3))
        assert answer.status_code == 202
        with stranger.send(f"GET /v1/jobs/{answer.json()['id']}/events") as stream:
            assert b" 200 OK" in stream.recv(4096)
        with silent_session(stranger) as session:
            assert b" 101 " in session.recv(4096)
        if kind in (trickling_body, trickling_form, trickling_chunks, event_stream):
            refused = set()

            def count():
                refused.update(c.fileno() for c in connections if is_refused(c))
                return len(refused)

            wait_for(lambda: count() >= MANY - PARTS)


@pytest.mark.parametrize("by", ["keys", "addresses"])
def test_orders_that_wait_leave_room_for_a_stranger(request, by):
    """Of eight places at the worker processes the greedy client gets four."""
    greedy, stranger = clients_of(request, by)
    recording = wav(4.0)
    with ExitStack() as stack, stranger.http() as http:
        for _ in range(20):
            stack.enter_context(
                greedy.send("POST /v1/animations", recording, Content_Length=str(len(recording)))
            )
        assert http.post("/v1/animations?format=csv", content=wav(0.3)).status_code == 200


def test_probes_are_answered_while_every_place_is_held(keyed):
    one, other = Client(keyed, GREEDY, ""), Client(keyed, STRANGER, "")
    with held(one, trickling_body), held(other, trickling_body):
        for path in ("/healthz", "/readyz"):
            assert httpx.get(keyed.url + path, timeout=300, trust_env=False).status_code == 200
