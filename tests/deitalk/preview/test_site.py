"""`deitalk export web`: recordings animated in Chromium by the page itself, against Python."""

import csv
import functools
import http.server
import io
import threading
from contextlib import contextmanager

import numpy as np
import pytest
import soundfile

from deitalk import animate
from deitalk.audio.load import load_audio
from deitalk.emotions import IntensityCurve
from deitalk.errors import CheckpointError
from deitalk.live.animator import LiveAnimator
from deitalk.preview import page as page_module
from deitalk.preview.site import WASM, export_site
from rig import default_controls, read_curves
from tests.browser import chromium, needs_player, numbers
from tests.command import ran

pytest.importorskip("onnx", reason="needs the extra onnx")
CONTROLS = default_controls()
SPAN = CONTROLS.maximum - CONTROLS.minimum
TOLERANCE = 1e-3
"""Of a control's range."""
ALIKE = {"model": "default", "life": "off", "variant": "plain"}
"""What the page does not draw."""


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    needs_player()
    if not page_module.BUNDLE.with_name(WASM).is_file():
        pytest.skip("needs the built player with ONNX Runtime: make page")
    folder = tmp_path_factory.mktemp("site") / "site"
    ran("export", "web", "-o", folder)
    return folder


class Quiet(http.server.SimpleHTTPRequestHandler):
    def log_message(self, *arguments):
        pass


@contextmanager
def served(folder):
    handler = functools.partial(Quiet, directory=str(folder))
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        try:
            yield f"http://127.0.0.1:{server.server_port}/"
        finally:
            server.shutdown()
            thread.join()


@contextmanager
def here(browser, address):
    """A tab that shows a site."""
    sharpness = {"device_scale_factor": 0.25}
    with browser.new_context(bypass_csp=False, permissions=["microphone"], **sharpness) as window:
        tab = window.new_page()
        tab.complaints = []
        tab.on("console", lambda m: m.type == "error" and tab.complaints.append(m.text))
        tab.on("pageerror", lambda error: tab.complaints.append(str(error)))
        tab.goto(address)
        until(tab, "window.deitalk?.ready && deitalk.site.isWarm")
        yield tab
        assert not tab.complaints, tab.complaints


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    """The one browser of these tests; its stand-in for a microphone plays a recording."""
    said = tmp_path_factory.mktemp("sound") / "said.wav"
    soundfile.write(said, load_audio("docs/samples/promise.flac").waveform, 16_000)
    flags = f"--use-file-for-fake-audio-capture={said}", "--use-fake-ui-for-media-stream"
    with chromium(*flags) as browser:
        yield browser


@pytest.fixture(scope="module")
def tab(browser, site):
    with served(site) as address, here(browser, address) as tab:
        yield tab


def until(tab, condition, seconds=120):
    """Wait without eval, which the page forbids."""
    for _ in range(10 * seconds):
        if tab.evaluate(f"() => Boolean({condition})"):
            return
        tab.wait_for_timeout(100)
    raise AssertionError(f"not within {seconds} s: {condition}; {tab.complaints}")


def recording(name, start, stop):
    """Samples at 16 kHz and a WAV file of them."""
    samples = np.array(load_audio(f"docs/samples/{name}.flac").waveform)[start:stop]
    stream = io.BytesIO()
    soundfile.write(stream, samples, 16_000, format="WAV", subtype="FLOAT")
    return samples, stream.getvalue()


def dropped(tab, name, content):
    tab.set_input_files("#file", {"name": name, "mimeType": "audio/wav", "buffer": content})
    until(tab, f"deitalk.page.take?.title === {name[:-4]!r}")


def shown(tab):
    return numbers(tab, "deitalk.page.take.values").reshape(-1, len(CONTROLS))


def off(found, made):
    return float((np.abs(found - made.curves.values) / SPAN).max())


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("name", "start", "stop"),
    [("promise", 0, None), ("amiable", 8_000, 60_000), ("promise", 30_000, 61_000)],
)
def test_curves_in_the_browser_are_those_of_python(tab, name, start, stop):
    samples, content = recording(name, start, stop)
    dropped(tab, f"{name}{start}.wav", content)
    made = animate(samples, "happy", sample_rate=16_000, **ALIKE)
    assert off(shown(tab), made) <= TOLERANCE
    seconds = tab.evaluate("() => deitalk.site.took") / (len(samples) / 16_000)
    print(f"{seconds:.3f} s per s of sound")  # noqa: T201


@pytest.mark.thorough
def test_emotion_intensity_and_files_of_the_page(tab, tmp_path):
    """Another emotion, a dragged intensity, and the three files, read by deitalk."""
    samples, content = recording("amiable", 8_000, 60_000)
    dropped(tab, "amiable.wav", content)
    tab.click("#emotions button:has-text('angry')")
    until(tab, "deitalk.page.take.emotionAt(0) === 'angry'")
    made = animate(samples, "angry", sample_rate=16_000, **ALIKE)
    assert off(shown(tab), made) <= TOLERANCE
    tab.evaluate("() => deitalk.page.history.change({points: [{time: 0, factor: 0.5}]})")
    until(tab, "deitalk.page.take.exact")
    applied = 0.5 * made.predicted.astype(float)
    curve = IntensityCurve(np.arange(len(applied)) / 30, applied)
    made = animate(samples, "angry", sample_rate=16_000, intensity_curve=curve, **ALIKE)
    exact = numbers(tab, "deitalk.page.take.exact.take.values").reshape(-1, len(CONTROLS))
    assert off(exact, made) <= TOLERANCE
    for label, end in (("CSV", "csv"), ("JSON", "json")):
        with tab.expect_download() as download:
            tab.click(f"#exports button:text-is('{label}')")
        path = tmp_path / f"curves.{end}"
        download.value.save_as(path)
        np.testing.assert_allclose(read_curves(path).values, exact, atol=1e-5)
    with tab.expect_download() as download:
        tab.click("#exports button:text-is('Live Link')")
    path = tmp_path / "take_1_deitalk.csv"
    download.value.save_as(path)
    expected = tmp_path / "expected.livelink-raw.csv"
    made.save(expected)
    ours, theirs = (list(csv.reader(file.read_text().splitlines())) for file in (path, expected))
    assert ours[0] == theirs[0] and [row[0] for row in ours] == [row[0] for row in theirs]
    differ = [np.array([row[1:] for row in rows[1:]], float) for rows in (ours, theirs)]
    assert np.abs(differ[0][:, :252] - differ[1][:, :252]).max() <= 2e-3


@pytest.mark.thorough
def test_a_site_with_one_model_and_head_is_small(site):
    sizes = {path.name: path.stat().st_size for path in site.iterdir()}
    live = sizes["live.onnx.planes.gz"]
    assert sum(sizes.values()) - live <= 32e6
    assert live <= 6e6  # its encoder's weights are those of the other file


SPOKEN = """() => {
  const { engine } = deitalk.site, { next } = engine, log = (window.spoken = { windows: [], curves: [] });
  engine.next = async (sound, ...given) => {
    const curves = await next.call(engine, sound, ...given);
    log.windows.push(sound.slice());
    log.curves.push(curves);
    return curves;
  };
}"""
"""Keeps what the model is given and what it gives; the first run, of silence, only reads the model."""
RUNS, FRAMES = 30, 3
HEARD = np.arange(RUNS) * FRAMES * 16_000 // 30 - 512
"""First samples of the windows of the runs."""


@pytest.mark.thorough
def test_microphone_moves_the_face_as_the_live_model_of_python_does(browser, site):
    """Curves of what the stand-in for a microphone says."""
    with served(site) as address, here(browser, address) as tab:
        tab.evaluate(SPOKEN)
        tab.click("#emotions button:has-text('angry')")
        tab.click("#live")
        until(tab, f"spoken.curves.length > {RUNS + 1} && deitalk.page.live")
        assert tab.text_content("#recorded").endswith("s late")
        shown = numbers(tab, "deitalk.page.live.values")
        size = tab.evaluate("spoken.windows[0].length")
        windows = numbers(tab, f"spoken.windows.slice(1, {RUNS + 1}).flatMap((x) => [...x])")
        curves = numbers(tab, f"spoken.curves.slice(1, {RUNS + 1}).flatMap((x) => [...x])")
        every = numbers(tab, "spoken.curves.flatMap((x) => [...x])").reshape(-1, len(CONTROLS))
        tab.click("#live")
        until(tab, "document.getElementById('live').textContent === 'Live'")
        assert not tab.complaints, tab.complaints
    assert np.abs(every - shown).max(axis=1).min() < 1e-6  # a frame of the model is on the screen
    sound = np.zeros(HEARD[-1] + size, np.float32)
    for begin, window in zip(HEARD, windows.reshape(RUNS, size), strict=True):
        sound[max(begin, 0) : begin + size] = window[max(-begin, 0) :]
    assert sound.std() > 0.01
    expected = LiveAnimator("live", "angry", life="off", variant="plain").feed(sound)
    found = curves.reshape(RUNS * FRAMES, -1)[5:]
    assert len(expected) >= len(found)
    assert (np.abs(found - expected[: len(found)]) / SPAN).max() <= TOLERANCE


@pytest.mark.thorough
def test_site_without_live_has_no_button_for_it(browser, tmp_path):
    ran("export", "web", "-o", tmp_path / "site", "--no-live")
    assert not (tmp_path / "site/live.onnx.planes.gz").exists()
    with served(tmp_path / "site") as address, here(browser, address) as tab:
        assert not tab.is_visible("#live")


def test_a_model_for_live_voices_is_refused_in_one_line(tmp_path):
    needs_player()
    if not page_module.BUNDLE.with_name(WASM).is_file():
        pytest.skip("needs the built player with ONNX Runtime: make page")
    with pytest.raises(CheckpointError, match="a site has a model for whole recordings"):
        export_site(tmp_path / "site", "live")
    assert not (tmp_path / "site").exists()
