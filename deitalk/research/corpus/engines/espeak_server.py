"""A server that gives every utterance of espeak-ng a fresh process.

The library keeps noise, phase and pitch from one utterance to the next, even through its own
termination, so that the waveform of a text depends on the utterances before it. `Server` starts a
small process that loads the library once and forks for each utterance: every one begins from the
same state, and a crash or a hang affects one utterance only.

Protocol on the pipes: one JSON line in; one JSON line with the sample count and the events out,
then the samples as 16-bit integers.
"""

import json
import os
import signal
import subprocess
import sys
import threading
from typing import Any

from deitalk.errors import DataError
from deitalk.research.corpus.engines.espeak_library import library

TIMEOUT_SECONDS = 20
"""Time limit of an utterance; usual are some milliseconds."""


class Server:
    """A process that synthesises texts, each from the same initial state."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._process = subprocess.Popen(
            [sys.executable, "-P", "-W", "ignore", "-c", f"from {__name__} import serve; serve()"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path), "OMP_NUM_THREADS": "1"},
        )

    def synthesise(
        self, text: str, voice: str, parameters: dict[str, int], *, ssml: bool
    ) -> tuple[bytes, list[tuple[int, str]]]:
        """`Synthesiser.synthesise` in a fresh process.

        Raises
        ------
        DataError
            If espeak-ng crashes or hangs on the text.
        """
        job = {"text": text, "voice": voice, "parameters": parameters, "ssml": ssml}
        with self._lock:
            answered, given = self._process.stdin, self._process.stdout
            assert answered is not None and given is not None
            answered.write(json.dumps(job).encode() + b"\n")
            answered.flush()
            header = json.loads(given.readline() or b'{"bytes": 0, "events": null}')
            samples = given.read(header["bytes"])
        if header["events"] is None:
            raise DataError(f"text={text!r} crashes espeak-ng in the voice {voice}; leave it out")
        return samples, [(sample, ipa) for sample, ipa in header["events"]]

    def close(self) -> None:
        """End the process."""
        for pipe in (self._process.stdin, self._process.stdout):
            if pipe is not None:
                pipe.close()
        self._process.wait(timeout=TIMEOUT_SECONDS)


def serve() -> None:
    """Process the jobs on standard input until it or the reader of the answers ends."""
    library()
    for line in sys.stdin.buffer:
        answer = _in_fork(json.loads(line))
        try:
            sys.stdout.buffer.write(answer or b'{"bytes": 0, "events": null}\n')
            sys.stdout.buffer.flush()
        except BrokenPipeError:  # the owner was killed; Python would write the rest at its end
            os._exit(1)


def _in_fork(job: dict[str, Any]) -> bytes:
    """Result of one job from a child process; empty if the child fails."""
    reading, writing = os.pipe()
    child = os.fork()
    if child == 0:
        signal.alarm(TIMEOUT_SECONDS)  # its default action ends the child
        samples, events = library().synthesise(job.pop("text"), job.pop("voice"), **job)
        with os.fdopen(writing, "wb") as pipe:
            pipe.write(json.dumps({"bytes": len(samples), "events": events}).encode() + b"\n")
            pipe.write(samples)
        os._exit(0)
    os.close(writing)
    with os.fdopen(reading, "rb") as pipe:
        answer = pipe.read()
    _, status = os.waitpid(child, 0)
    return answer if status == 0 else b""
