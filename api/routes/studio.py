"""The studio: one page at `/`, whose only requests go to this service."""

import base64
import hashlib
import re
from functools import lru_cache

import anyio
from fastapi import APIRouter
from starlette.responses import HTMLResponse

router = APIRouter()
_SCRIPT = re.compile(r"<script type=\"module\"[^>]*>(.*?)</script>", re.DOTALL)


@router.get("/", include_in_schema=False)
async def studio(head: str = "0") -> HTMLResponse:
    """The page with a head (`/?head=child`); 503 if this installation was built without it."""
    page, policy = await anyio.to_thread.run_sync(_page, head)
    return HTMLResponse(page, headers={"Content-Security-Policy": policy})


@lru_cache(maxsize=4)
def _page(head: str) -> tuple[str, str]:
    """The page and its policy: its own script, nothing from elsewhere, in no frame."""
    from deitalk.preview.page import render_studio  # takes as long to import as all else here

    page = render_studio(head)
    digests = [hashlib.sha256(script.encode()).digest() for script in _SCRIPT.findall(page)]
    hashes = " ".join(f"'sha256-{base64.b64encode(digest).decode()}'" for digest in digests)
    policy = (
        f"default-src 'none'; script-src {hashes}; style-src 'unsafe-inline'; "
        "img-src data: blob:; media-src blob:; connect-src 'self' blob: data:; "
        "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    )
    return page, policy
