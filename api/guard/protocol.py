"""uvicorn's protocols with time limits: for a request's headers, and for reading of a WebSocket."""

import asyncio
from typing import Any

from uvicorn.protocols.http.h11_impl import H11Protocol
from uvicorn.protocols.websockets.websockets_sansio_impl import WebSocketsSansIOProtocol

SEND_SECONDS = 10.0
"""Time in which the client of a WebSocket must take a message."""


class GuardedProtocol(H11Protocol):
    """Closes a connection whose request line and headers are not there in time.

    The size of the headers is limited by uvicorn (``h11_max_incomplete_event_size``), the time of
    a body by `api.guard.middleware`.
    """

    header_seconds = 10.0

    @classmethod
    def limited(cls, seconds: float) -> type["GuardedProtocol"]:
        """Return the protocol with another limit, in seconds."""
        return type(cls.__name__, (cls,), {"header_seconds": seconds})

    def connection_made(self, transport: Any) -> None:
        """Start the clock."""
        super().connection_made(transport)
        self._clock: asyncio.TimerHandle | None = None
        self._start_clock()

    def data_received(self, data: bytes) -> None:
        """Stop the clock when the headers are whole; start it with the next request's."""
        if self._clock is None and (self.cycle is None or self.cycle.response_complete):
            self._start_clock()
        super().data_received(data)
        self._stop_clock_in_request()

    def on_response_complete(self) -> None:
        """Look at what the client has sent since."""
        super().on_response_complete()
        self._stop_clock_in_request()

    def handle_websocket_upgrade(self, event: Any) -> None:
        """Stop the clock: the headers are whole, another protocol goes on with the connection."""
        self._stop_clock()
        super().handle_websocket_upgrade(event)

    def connection_lost(self, exc: Exception | None) -> None:
        """Stop the clock."""
        self._stop_clock()
        super().connection_lost(exc)

    def _start_clock(self) -> None:
        self._clock = self.loop.call_later(self.header_seconds, self._too_slow)

    def _stop_clock_in_request(self) -> None:
        if self.cycle is not None and not self.cycle.response_complete:
            self._stop_clock()

    def _stop_clock(self) -> None:
        if self._clock is not None:
            self._clock.cancel()
            self._clock = None

    def _too_slow(self) -> None:
        self._clock = None
        if not self.transport.is_closing():
            self.transport.close()


class GuardedSocket(WebSocketsSansIOProtocol):
    """Cuts off a client that does not read for `SEND_SECONDS`: a closing would wait for it too."""

    _clock: asyncio.TimerHandle | None = None

    def pause_writing(self) -> None:
        """Start the clock: as much as may wait for the client waits."""
        super().pause_writing()
        self._clock = self.loop.call_later(SEND_SECONDS, self.transport.abort)

    def resume_writing(self) -> None:
        """Stop the clock: the client has read."""
        self._stop_clock()
        super().resume_writing()

    def connection_lost(self, exc: Exception | None) -> None:
        """Stop the clock."""
        self._stop_clock()
        super().connection_lost(exc)

    def _stop_clock(self) -> None:
        if self._clock is not None:
            self._clock.cancel()
            self._clock = None
