"""`WS /v1/live`: sound in, frames out."""

import asyncio
import json
from contextlib import suppress

from fastapi import APIRouter, WebSocket
from starlette.websockets import WebSocketDisconnect

from api.errors import problem_for
from api.guard.keys import Caller, require
from api.guard.middleware import SUBPROTOCOL
from api.guard.protocol import SEND_SECONDS
from api.live.messages import problem_message
from api.live.session import Session
from api.service import Service

router = APIRouter()
CLOSE_CODES = {400: 1008, 403: 1008, 404: 1008, 413: 1009, 422: 1007, 429: 1008, 503: 1013}
"""Codes of WebSocket by the status of HTTP; others are 1011."""


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
        problem = None
        try:
            await Session(websocket, service, caller).run()
        except WebSocketDisconnect:
            return
        except Exception as error:
            problem = problem_for(error)
        with suppress(RuntimeError, WebSocketDisconnect, TimeoutError):
            async with asyncio.timeout(SEND_SECONDS):
                if problem is not None:
                    await websocket.send_text(json.dumps(problem_message(problem)))
                code = 1000 if problem is None else CLOSE_CODES.get(problem.status, 1011)
                await websocket.close(code)
