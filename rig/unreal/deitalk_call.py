"""Animate a recording with the deitalk of this computer; used by ``deitalk_menu.py`` beside it.

The command line runs as a process of its own, as Unreal's Python has no packages; or a service of
deitalk is called over HTTP. Which of them is in `SETTINGS`, of ``deitalk install unreal PROJECT``.
"""

from __future__ import annotations

import contextlib
import glob
import json
import os
import subprocess
import threading
import time
import urllib.error
import urllib.parse
import urllib.request
from collections.abc import Callable
from typing import Any

from deitalk_clip import DeitalkError  # type: ignore[import-not-found]

SETTINGS = "deitalk_settings.json"
"""Beside the scripts: ``command`` (a list: program and first arguments), ``service`` (an address,
which goes before the command) and ``key`` (of that service)."""
EMOTIONS = ("neutral", "angry", "happy", "sad", "surprised", "fear", "disgust", "contempt",
            "calm", "auto")  # fmt: skip
"""``auto`` is suggested from the voice, by the command line only."""
POLL_SECONDS = 0.1
JOB_POLL_SECONDS = 1.0
LONGEST_SECONDS = 3600.0

Tick = Callable[[], None]
"""Called while something runs; it raises an error to end it."""


def read_settings(path: str = "") -> dict[str, Any]:
    """Return the settings of a file, by default `SETTINGS` beside this script.

    Raises
    ------
    DeitalkError
        If the file is damaged.
    """
    path = path or os.path.join(os.path.dirname(os.path.abspath(__file__)), SETTINGS)
    given: Any = {}
    if os.path.isfile(path):
        try:
            with open(path, encoding="utf-8") as stream:
                given = json.load(stream)
        except (OSError, ValueError) as error:
            raise DeitalkError(
                f"cannot read {path}: {error}; run: deitalk install unreal"
            ) from error
    if not isinstance(given, dict):
        raise DeitalkError(f"{path} is no object of settings; run: deitalk install unreal")
    settings = {"command": ["deitalk"], "service": "", "key": "", **given}
    command = settings["command"]
    if not (isinstance(command, list) and command and all(isinstance(c, str) for c in command)):
        raise DeitalkError(f"{path}: command is {command!r}; it must be a list of words")
    return settings


def animate(
    recording: str,
    folder: str,
    emotion: str = "neutral",
    intensity: float = 1.0,
    timecode: str = "zero",
    settings: dict[str, Any] | None = None,
    tick: Tick = lambda: None,
) -> str:
    """Animate a recording into a folder.

    Parameters
    ----------
    recording : str
        A sound file.
    folder : str
        Of the take, which replaces that of an earlier call; a service gives one file,
        ``<folder>.unreal.json``.
    emotion : str
        As of ``deitalk animate``: one of `EMOTIONS` or weights such as ``happy=0.7``.
    intensity : float
        Factor on the predicted intensity, 0 to 4.
    timecode : str
        As of ``deitalk animate``: zero, recording or HH:MM:SS:FF.
    settings : dict, optional
        As of `read_settings`.
    tick : callable
        Called several times a second.

    Returns
    -------
    str
        Path of a ``*.unreal.json``.

    Raises
    ------
    DeitalkError
        If the recording or deitalk is missing, or deitalk refuses them; one line.
    """
    settings = settings or read_settings()
    if not os.path.isfile(recording):
        raise DeitalkError(f"{recording} does not exist; choose a sound file")
    if not 0 <= intensity <= 4:
        raise DeitalkError(f"intensity {intensity:g} is outside 0 to 4")
    os.makedirs(os.path.dirname(os.path.abspath(folder)), exist_ok=True)
    factor = repr(float(intensity))
    if settings["service"]:
        asked = {"emotion": emotion, "intensity": factor, "timecode": timecode}
        return _by_service(settings, recording, folder, asked, tick)
    options = ["-e", emotion, "--intensity", factor, "--timecode", timecode]
    return _by_command([*settings["command"], "animate", recording, *options], folder, tick)


def _by_command(command: list[str], folder: str, tick: Tick) -> str:
    words = [*command, "-o", folder, "--force"]
    log = folder.rstrip("/\\") + ".log"
    # Without the paths of Unreal's own Python.
    clean = {k: v for k, v in os.environ.items() if k not in ("PYTHONHOME", "PYTHONPATH")}
    with open(log, "w+", encoding="utf-8", errors="replace") as output:
        try:
            process = subprocess.Popen(
                words, stdin=subprocess.DEVNULL, stdout=output, stderr=output, env=clean,
                creationflags=getattr(subprocess, "CREATE_NO_WINDOW", 0),
            )  # fmt: skip
        except OSError as error:
            raise DeitalkError(
                f"cannot start {command[0]}: {error.strerror or error}; run where deitalk is "
                "installed: deitalk install unreal PROJECT --force"
            ) from error
        try:
            _wait(lambda: process.poll() is not None, tick)
        except BaseException:
            process.kill()
            process.wait()
            raise
        output.seek(0)
        lines = [line.strip() for line in output.read().splitlines() if line.strip()]
    if process.returncode:
        reason = lines[-1] if lines else f"it ended with code {process.returncode}"
        raise DeitalkError(f"deitalk: {reason} (all of it in {log})")
    os.remove(log)
    found = glob.glob(os.path.join(glob.escape(folder), "*.unreal.json"))
    if not found:
        raise DeitalkError(f"{folder} has no *.unreal.json; the model is of another rig")
    return found[0]


def _by_service(
    settings: dict[str, Any], recording: str, folder: str, options: dict[str, str], tick: Tick
) -> str:
    address = settings["service"].rstrip("/")
    with open(recording, "rb") as stream:
        sound = stream.read()
    url = f"{address}/v1/animations?{urllib.parse.urlencode({**options, 'format': 'unreal'})}"
    headers = {"Content-Type": "application/octet-stream"}
    headers.update({"Authorization": f"Bearer {settings['key']}"} if settings["key"] else {})
    status, body = _request(url, headers, sound, tick)
    if status == 202:
        job = json.loads(body)
        place = f"{address}/v1/jobs/{job['id']}"
        while job["status"] in ("queued", "running"):
            pause = time.monotonic() + JOB_POLL_SECONDS
            _wait(lambda end=pause: time.monotonic() > end, tick)  # type: ignore[misc]
            job = json.loads(_request(place, headers, None, tick)[1])
        body = _request(f"{place}/result", headers, None, tick)[1]
    path = folder.rstrip("/\\") + ".unreal.json"
    beside = f"{path}.{os.getpid()}"
    with open(beside, "wb") as output:
        output.write(body)
    os.replace(beside, path)
    return path


def _request(
    url: str, headers: dict[str, str], body: bytes | None, tick: Tick
) -> tuple[int, bytes]:
    """Return status and body of an answer; it is awaited in a thread, so that `tick` is called."""
    answer: list[Any] = []

    def send() -> None:
        try:
            request = urllib.request.Request(url, data=body, headers=headers)
            with urllib.request.urlopen(request, timeout=LONGEST_SECONDS) as response:
                answer.append((response.status, response.read()))
        except urllib.error.HTTPError as error:
            answer.append(DeitalkError(f"the service refuses: {_reason(error)}"))
        except (OSError, ValueError) as error:
            reason = getattr(error, "reason", None) or error
            answer.append(DeitalkError(f"no service at {url.split('/v1')[0]}: {reason}"))

    thread = threading.Thread(target=send, daemon=True)
    thread.start()
    _wait(lambda: not thread.is_alive(), tick)
    if not answer:
        raise DeitalkError(f"the request to {url.split('/v1')[0]} broke off")
    if isinstance(answer[0], DeitalkError):
        raise answer[0]
    status, content = answer[0]
    return int(status), bytes(content)


def _reason(error: urllib.error.HTTPError) -> str:
    """Return the line of a problem of the service (RFC 9457), or the status."""
    with contextlib.suppress(ValueError, OSError, AttributeError):
        return str(json.loads(error.read()).get("detail") or error)
    return str(error)


def _wait(is_over: Callable[[], bool], tick: Tick) -> None:
    end = time.monotonic() + LONGEST_SECONDS
    while not is_over():
        tick()
        time.sleep(POLL_SECONDS)
        if time.monotonic() > end:
            raise DeitalkError(f"deitalk has not ended within {LONGEST_SECONDS:g} s")
