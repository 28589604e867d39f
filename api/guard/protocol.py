"""uvicorn's protocols with limits of time, for a request's headers and for reading, and of number.

A connection on which nothing is asked makes room for a new one: a flood of them refuses nobody.
"""

import asyncio
from collections import Counter
from typing import Any

import h11
from uvicorn.protocols.http.h11_impl import H11Protocol
from uvicorn.protocols.websockets.websockets_sansio_impl import WebSocketsSansIOProtocol
from websockets.http11 import Request, Response

from api.errors import MEDIA_TYPE, Problem
from api.settings import Settings

SEND_SECONDS = 10.0
"""Time in which the client of a WebSocket must take a message."""


class _Reader:
    """Cuts off a client that does not read: a closing would wait for it too."""

    read_seconds = SEND_SECONDS
    loop: asyncio.AbstractEventLoop
    transport: asyncio.Transport
    _reading: asyncio.TimerHandle | None = None

    def pause_writing(self) -> None:
        """Start the clock: as much as may wait for the client waits."""
        super().pause_writing()  # type: ignore[misc]
        self._reading = self.loop.call_later(self.read_seconds, self.transport.abort)

    def resume_writing(self) -> None:
        """Stop the clock: the client has read."""
        self._stop_reading()
        super().resume_writing()  # type: ignore[misc]

    def connection_lost(self, exc: Exception | None) -> None:
        """Stop the clock."""
        self._stop_reading()
        super().connection_lost(exc)  # type: ignore[misc]

    def _stop_reading(self) -> None:
        if self._reading is not None:
            self._reading.cancel()
            self._reading = None


class GuardedProtocol(_Reader, H11Protocol):
    """Closes a connection whose request line and headers are not there in time.

    The size of the headers is limited by uvicorn (``h11_max_incomplete_event_size``), the time of
    a body by `api.guard.middleware`.
    """

    header_seconds, read_seconds, most = 10.0, 60.0, 256

    @classmethod
    def limited(cls, settings: Settings) -> type["GuardedProtocol"]:
        """Return the protocol with the limits of the settings."""
        limits = {"read_seconds": settings.body_seconds, "most": settings.connections}
        return type(cls.__name__, (cls,), limits | {"header_seconds": settings.header_seconds})

    def connection_made(self, transport: Any) -> None:
        """Start the clock; beyond the most connections close an idle one.

        It is that which is idle longest, of the address with most of them.
        """
        super().connection_made(transport)
        self.idle_since = self.loop.time()
        if len(self.connections) > self.most:
            guarded = [other for other in self.connections if isinstance(other, GuardedProtocol)]
            idle = [other for other in guarded if other.is_idle and other is not self]
            own = Counter(_address(other) for other in idle)
            longest = min(idle, key=lambda o: (-own[_address(o)], o.idle_since), default=None)
            if longest is not None:
                longest.transport.close()
                self.connections.discard(longest)
        self._clock: asyncio.TimerHandle | None = None
        self._start_clock()

    def data_received(self, data: bytes) -> None:
        """Stop the clock when the headers are whole; start it with the next request's."""
        if self._clock is None and self.is_idle:
            self._start_clock()
        super().data_received(data)
        self._stop_clock_in_request()

    def on_response_complete(self) -> None:
        """Look at what the client has sent since."""
        super().on_response_complete()
        self.idle_since = self.loop.time()
        self._stop_clock_in_request()

    def handle_websocket_upgrade(self, event: Any) -> None:
        """Stop the clock: the headers are whole, another protocol goes on with the connection."""
        self._stop_clock()
        super().handle_websocket_upgrade(event)

    def connection_lost(self, exc: Exception | None) -> None:
        """Stop the clock."""
        self._stop_clock()
        super().connection_lost(exc)

    def send_400_response(self, msg: str) -> None:
        """Answer what is no HTTP by a problem, unless another answer has begun."""
        if self.conn.our_state in (h11.IDLE, h11.SEND_RESPONSE):
            body = malformed(msg).body
            about = {"content-type": MEDIA_TYPE, "content-length": str(len(body))}
            headers = [*about.items(), ("connection", "close")]
            head = h11.Response(status_code=400, headers=headers, reason="Bad Request")
            for event in (head, h11.Data(data=body), h11.EndOfMessage()):
                self.transport.write(self.conn.send(event) or b"")
        self.transport.close()

    def _start_clock(self) -> None:
        self._clock = self.loop.call_later(self.header_seconds, self.transport.close)

    def _stop_clock_in_request(self) -> None:
        if not self.is_idle:
            self._stop_clock()

    def _stop_clock(self) -> None:
        if self._clock is not None:
            self._clock.cancel()
            self._clock = None

    @property
    def is_idle(self) -> bool:
        """Whether nothing is asked on the connection."""
        return self.cycle is None or self.cycle.response_complete


def _address(connection: Any) -> str:
    return connection.client[0] if connection.client else ""


class GuardedSocket(_Reader, WebSocketsSansIOProtocol):
    """A WebSocket whose client must take a message within `SEND_SECONDS`."""

    def handle_connect(self, event: Request) -> None:
        """Answer a handshake that is wrong by a problem."""
        reject = self.conn.reject

        def refused(status: int, text: str) -> Response:
            answer = reject(status, text)
            answer.body = malformed(text).body
            for name, value in (("Content-Type", MEDIA_TYPE), ("Content-Length", len(answer.body))):
                del answer.headers[name]
                answer.headers[name] = str(value)
            return answer

        self.conn.reject = refused  # type: ignore[method-assign]
        super().handle_connect(event)

    def data_received(self, data: bytes) -> None:
        """Answer a request that is no handshake by a problem; the first data is a whole one."""
        super().data_received(data)
        if self.handshake_initiated:
            return
        body = malformed(str(self.conn.handshake_exc)).body
        head = f"HTTP/1.1 400 Bad Request\r\nContent-Type: {MEDIA_TYPE}\r\nConnection: close\r\n"
        self.transport.write(f"{head}Content-Length: {len(body)}\r\n\r\n".encode() + body)
        self.transport.close()


def malformed(text: str) -> Problem:
    """The answer to a request that breaks its protocol."""
    return Problem(400, text.strip())
