"""`WS /v1/live`: sound in, frames out."""

import asyncio
import json
from contextlib import suppress

from fastapi import APIRouter, WebSocket
from starlette.websockets import WebSocketDisconnect

from api.errors import Problem, problem_for
from api.guard.keys import Caller, require
from api.guard.middleware import SUBPROTOCOL
from api.guard.protocol import SEND_SECONDS
from api.live.messages import Session, problem_message
from api.service import Service

router = APIRouter()
CLOSE_CODES = {400: 1008, 403: 1008, 404: 1008, 413: 1009, 422: 1007, 429: 1008, 503: 1013}
"""Of WebSocket, by the status of HTTP; others are 1011."""


@router.websocket("/v1/live")
async def live(websocket: WebSocket) -> None:
    """Serve one session; a problem is sent as JSON before the connection is closed."""
    service: Service = websocket.app.state.service
    caller: Caller = websocket.state.caller
    require(caller, "live")
    await service.check_quota(caller)
    with service.live.hold(caller.holder, caller.live):
        is_offered = SUBPROTOCOL in websocket.scope.get("subprotocols", [])
        await websocket.accept(subprotocol=SUBPROTOCOL if is_offered else None)
        await _serve(websocket, service, caller)


async def _serve(websocket: WebSocket, service: Service, caller: Caller) -> None:
    """Serve a session, and close the connection within `SEND_SECONDS`."""
    problem = None
    try:
        await Session(websocket, service, caller).run()
    except WebSocketDisconnect:
        return
    except Exception as error:
        problem = problem_for(error)
    with suppress(RuntimeError, WebSocketDisconnect, TimeoutError):
        await asyncio.wait_for(_close(websocket, problem), SEND_SECONDS)


async def _close(websocket: WebSocket, problem: Problem | None) -> None:
    if problem is None:
        await websocket.close()
        return
    await websocket.send_text(json.dumps(problem_message(problem)))
    await websocket.close(CLOSE_CODES.get(problem.status, 1011))
