"""The application: routes, the guard around them, errors as problems, life of the workers."""

from collections.abc import AsyncIterator
from contextlib import AsyncExitStack, asynccontextmanager

from fastapi import FastAPI, Request, Response
from fastapi.exceptions import RequestValidationError
from starlette.datastructures import Headers
from starlette.exceptions import HTTPException
from starlette.middleware.cors import CORSMiddleware
from starlette.routing import Route

from api.errors import MEDIA_TYPE, STATUS_CODES, Problem
from api.guard.middleware import NO_PATH, Guard
from api.live import route as live
from api.routes import animations, catalogue, documentation, health, jobs, studio
from api.routes.schema import complete_schema
from api.service import Service
from api.settings import Settings, load_settings
from deitalk.config.section import rule
from deitalk.installed import __version__
from rig.errors import quoted

ROUTES = (animations, jobs, catalogue, health, live, studio, documentation)
SENT_HEADERS = (
    "Authorization", "Content-Type", "Idempotency-Key", "If-None-Match", "If-Range", "Range",
    "X-Request-ID",
)  # fmt: skip
READ_HEADERS = (
    "Content-Disposition", "Content-Range", "Deitalk-Notes", "ETag", "Location", "Retry-After",
    "X-Request-ID",
)  # fmt: skip
"""Headers that pages of the settings' `origins` may send and read."""
DESCRIPTION = (
    "MetaHuman facial animation from speech and an emotion. Errors are problem JSON: code, "
    "message, detail. A key is sent as `Authorization: Bearer <key>`."
)


def create_app(settings: Settings | None = None) -> FastAPI:
    """Make the application.

    Parameters
    ----------
    settings : Settings, optional
        By default those of the environment (`api.settings.load_settings`).

    Raises
    ------
    ConfigError
        If a setting is wrong, or the service would be open to a network without keys.
    """
    settings = settings or load_settings()
    settings.check()
    service = Service(settings)

    @asynccontextmanager
    async def lifespan(app: FastAPI) -> AsyncIterator[None]:
        await service.start()
        try:
            async with AsyncExitStack() as doors:
                if settings.grpc_port:
                    from api.live.audio2face import serving_grpc

                    await doors.enter_async_context(serving_grpc(service))
                yield
        finally:
            await service.stop()

    app = FastAPI(
        title="deitalk",
        version=__version__,
        description=DESCRIPTION,
        lifespan=lifespan,
        docs_url=None,
        redoc_url=None,
        openapi_url="/openapi.json",
        separate_input_output_schemas=False,
        redirect_slashes=False,  # to an address that a Host header names
        generate_unique_id_function=lambda route: route.name,
    )
    app.state.service = service
    for module in ROUTES:
        app.include_router(module.router)
    _add_handlers(app)
    app.add_middleware(Guard, settings=settings, metrics=service.metrics, traffic=service.traffic)
    if settings.origins:  # around the guard: a browser asks first, without a key
        app.add_middleware(
            Cors,
            allow_origins=settings.origins,
            allow_methods=["GET", "POST", "DELETE"],
            allow_headers=SENT_HEADERS,
            expose_headers=READ_HEADERS,
        )
    complete_schema(app)
    return app


def problem_answer(problem: Problem) -> Response:
    """Return a problem as an answer."""
    return Response(problem.body, problem.status, problem.headers, MEDIA_TYPE)


class Cors(CORSMiddleware):
    """Refuses by a problem what a browser asks before a request."""

    def preflight_response(self, request_headers: Headers) -> Response:
        """The answer to a browser that asks."""
        answer = super().preflight_response(request_headers)
        if answer.status_code < 400:
            return answer
        return problem_answer(Problem(403, bytes(answer.body).decode(), "cross_origin"))


def _add_handlers(app: FastAPI) -> None:
    @app.exception_handler(RequestValidationError)
    async def invalid(request: Request, error: RequestValidationError) -> Response:
        found = [
            {"option": ".".join(map(str, e["loc"][1:] or e["loc"])), "rule": rule(e)}
            for e in error.errors()
        ]
        option, stated = found[0].values()
        if not stated.startswith(f"{option} "):
            stated = f"{option} {quoted(error.errors()[0]['input'])}: {stated}"
        return problem_answer(Problem(422, stated, "option_invalid", found[:20]))

    @app.exception_handler(HTTPException)
    async def unknown(request: Request, error: HTTPException) -> Response:
        code, headers = STATUS_CODES.get(error.status_code, "error"), dict(error.headers or {})
        text = NO_PATH if error.status_code == 404 else str(error.detail)
        if error.status_code == 405:
            # Methods of every route that has a path.
            path = request.scope["path"]
            routes = [route for module in ROUTES for route in module.router.routes]
            fitting = [r for r in routes if isinstance(r, Route) and r.path_regex.match(path)]
            methods = {method for route in fitting for method in route.methods or ()}
            headers["Allow"] = ", ".join(
                sorted(methods | {"HEAD"} if "GET" in methods else methods)
            )
            text = f"this path takes {headers['Allow']}"
        return problem_answer(Problem(error.status_code, text, code, None, headers))
