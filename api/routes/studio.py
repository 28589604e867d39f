"""Pages for people: the studio at `/`, whose only requests go to this service, and `/docs`."""

import base64
import hashlib
import re
from collections.abc import AsyncIterator
from functools import lru_cache
from pathlib import Path
from typing import Annotated

from fastapi import APIRouter, Query
from starlette.responses import FileResponse, StreamingResponse

from api.routes.deps import ServiceDep
from deitalk.preview.page import BUNDLE

router = APIRouter()
PIECE_BYTES = 1 << 16
"""A page is sent in pieces: what a slow client has not read is not kept for it."""
SAMPLES = (
    BUNDLE.with_name("sample.flac"),
    Path(__file__).parents[2] / "docs/samples/amiable.flac",
)
"""Places of the sample in a wheel, and in a checkout."""
_SCRIPT = re.compile(rb"<script type=\"module\"[^>]*>(.*?)</script>", re.DOTALL)


@router.get("/", include_in_schema=False)
async def studio(
    service: ServiceDep, head: Annotated[str, Query(max_length=40)] = "0"
) -> StreamingResponse:
    """The page with a head (`/?head=child`); 503 if this installation was built without it."""
    page = await service.pages.page(head)
    headers = {"Content-Security-Policy": _policy(page), "Content-Length": str(len(page))}
    return StreamingResponse(_pieces(page), headers=headers, media_type="text/html")


@router.get("/sample", include_in_schema=False)
async def sample() -> FileResponse:
    """A recording to try the page with: docs/samples/README.md names its reader and licence."""
    return FileResponse(next(path for path in SAMPLES if path.is_file()), media_type="audio/flac")


async def _pieces(page: bytes) -> AsyncIterator[bytes]:
    for start in range(0, len(page), PIECE_BYTES):
        yield page[start : start + PIECE_BYTES]


@lru_cache(maxsize=16)
def _policy(page: bytes) -> str:
    """Return the page's policy: its own script, nothing from elsewhere, in no frame."""
    digests = [hashlib.sha256(script).digest() for script in _SCRIPT.findall(page)]
    hashes = " ".join(f"'sha256-{base64.b64encode(digest).decode()}'" for digest in digests)
    return (
        f"default-src 'none'; script-src {hashes}; style-src 'unsafe-inline'; "
        "img-src data: blob:; media-src blob:; connect-src 'self' blob: data:; "
        "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    )
