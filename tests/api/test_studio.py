"""The studio at `/` in a browser: from a recording to edits and files, with this service alone."""

import base64
import json
import shlex
import shutil
import time
import zipfile
from contextlib import contextmanager

import numpy as np
import pytest

from deitalk import animate
from deitalk.audio.load import load_audio, write_wav
from rig import default_controls, read_curves
from tests.api.conftest import KEYS, wav
from tests.api.server import ROOT
from tests.api.test_live import resident_mb
from tests.browser import PATIENCE, SHARPNESS, chromium, needs_player, numbers
from tests.command import ran

SECONDS = 2.0


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    """A browser whose microphone gives a sample of speech, again and again."""
    spoken = tmp_path_factory.mktemp("microphone") / "speech.wav"
    write_wav(spoken, load_audio(ROOT / "docs/samples/promise.flac").waveform)
    with chromium(f"--use-file-for-fake-audio-capture={spoken}") as running:
        yield running


@pytest.fixture(scope="module")
def speech(tmp_path_factory):
    path = tmp_path_factory.mktemp("speech") / "my line.wav"
    path.write_bytes(wav(SECONDS))
    return path


STILL = """HTMLMediaElement.prototype.play =
  () => Promise.reject(new DOMException("not played", "NotAllowedError"));"""
"""As where a browser forbids to play: software draws each frame for nothing, for as long as it waits."""
SPARING = """(() => {
  const next = window.requestAnimationFrame.bind(window);
  window.requestAnimationFrame = (draw) => window.setTimeout(() => next(draw), 100);
  for (const kind of [WebGLRenderingContext, WebGL2RenderingContext])
    kind.prototype.drawElements = kind.prototype.drawArrays = () => {};
})();"""
"""Ten frames a second, without the head, of which software draws one in a second: tests of the page
look at it."""


@contextmanager
def studio(browser, server, *, plays=False, **context):
    """A tab of the studio; addresses of its requests and its complaints are kept."""
    with browser.new_context(**{"device_scale_factor": SHARPNESS, **context}) as window:
        window.set_default_timeout(PATIENCE)
        window.add_init_script(SPARING + ("" if plays else STILL))
        tab = window.new_page()
        tab.asked, tab.complaints = [], []
        tab.on("request", lambda request: tab.asked.append(request.url))
        tab.on("console", lambda m: m.type == "error" and tab.complaints.append(m.text))
        tab.on("pageerror", lambda error: tab.complaints.append(str(error)))
        tab.goto(server.url + "/")
        until(tab, "!!window.deitalk?.ready")
        yield tab


def until(tab, condition: str) -> None:
    """Wait for a condition; the page forbids eval, which Playwright's own waiting needs."""
    end = time.monotonic() + PATIENCE / 1000
    while not tab.evaluate(condition):
        assert time.monotonic() < end, (condition, tab.inner_text("#notice"), tab.complaints)
        time.sleep(0.05)


DROP = """([name, content]) => {
  const data = new DataTransfer(), bytes = Uint8Array.from(atob(content), c => c.charCodeAt(0));
  data.items.add(new File([bytes], name));
  document.body.dispatchEvent(new DragEvent("drop", { dataTransfer: data, bubbles: true, cancelable: true }));
}"""


def drop(tab, path) -> None:
    tab.evaluate(DROP, [path.name, base64.b64encode(path.read_bytes()).decode()])


def is_quiet(tab) -> None:
    """Wait until the shown curves are those of the service for the edits."""
    until(tab, "!deitalk.page.take.isBlend && deitalk.studio.isSettled")


@contextmanager
def spoken(browser, server, recording, **given):
    """A tab of the studio that shows the take of a recording."""
    with studio(browser, server, **given) as tab:
        drop(tab, recording)
        until(tab, "!!deitalk.page.take")
        is_quiet(tab)
        yield tab


def seek(tab, seconds: float) -> None:
    tab.evaluate("s => deitalk.page.seek(s)", seconds)


def download(tab, name: str, folder):
    with tab.expect_download() as given:
        tab.get_by_role("button", name=name, exact=True).click()
    path = folder / given.value.suggested_filename
    given.value.save_as(path)
    return path


def command(*words) -> None:
    ran(*[str(word) for word in words])


def edit(tab) -> None:
    """Happy that turns to sad, twice the intensity from the middle on, half the mouth."""
    tab.get_by_role("button", name="happy", exact=True).click()
    seek(tab, 1.5)
    tab.click("#add-key")
    tab.get_by_role("button", name="sad", exact=True).click()
    is_quiet(tab)
    seek(tab, 0.5)
    tab.keyboard.press("p")
    seek(tab, 1.0)
    tab.keyboard.press("p")
    for _ in range(9):
        tab.keyboard.press("ArrowUp")
    tab.get_by_role("slider", name="Gain of mouth").fill("0.5")
    tab.get_by_role("slider", name="Motion of brows").fill("2")
    tab.get_by_role("textbox", name="What is said").fill("Bob's promise")
    change = "slider => slider.dispatchEvent(new Event('input', { bubbles: true }))"
    tab.get_by_role("slider", name="Gain of mouth").evaluate(change)  # typed text outlasts it
    tab.get_by_role("textbox", name="What is said").press("Enter")
    tab.get_by_label("look at").fill("10,-5")
    tab.get_by_label("look at").press("Enter")
    tab.get_by_label("seed").fill("7")
    tab.get_by_label("seed").press("Enter")
    is_quiet(tab)


def test_recording_is_spoken_edited_and_exported_as_by_the_command_line(
    browser, server, speech, tmp_path, monkeypatch
):
    with studio(browser, server, plays=True) as tab:
        drop(tab, speech)
        until(tab, "deitalk.page.take?.seconds > 1 && deitalk.page.clock.playing")
        tab.keyboard.press("Space")
        edit(tab)
        exported = download(tab, "CSV", tmp_path)
        assert exported.name == "my line.csv"
        with tab.expect_download(
            lambda given: given.suggested_filename == "intensity.csv"
        ) as given:
            tab.on("download", lambda d: d.save_as(tmp_path / d.suggested_filename))
            tab.get_by_role("button", name="Edits", exact=True).click()
        given.value.path()
        until(tab, "document.getElementById('notice').textContent.includes('--emotion')")
        shown = shlex.split(tab.inner_text("#notice"))
        assert tab.complaints == []
        assert all(url.startswith((server.url, "blob:", "data:")) for url in tab.asked)
    assert shown[:3] == ["deitalk", "animate", "my line.wav"] and shown[-1] == "take/"
    monkeypatch.chdir(tmp_path)
    command("animate", speech, *shown[3:-1], "scaled.csv")
    expected = read_curves(tmp_path / "scaled.csv").values
    assert np.abs(read_curves(exported).values - expected).max() <= 2e-6
    command("animate", speech, "-o", tmp_path / "neutral.csv")
    assert np.abs(read_curves(tmp_path / "neutral.csv").values - expected).max() > 0.05


@contextmanager
def waiting(tab):
    """Requests for takes and files wait; those in the list go on at the end."""
    held = []
    tab.route("**/v1/animations", lambda route: held.append(route))
    yield held
    for request in held:
        request.continue_()
    tab.unroute("**/v1/animations")


def wait_for(tab, held, count: int) -> None:
    end = time.monotonic() + PATIENCE / 1000
    while len(held) < count:
        assert time.monotonic() < end, tab.complaints
        tab.wait_for_timeout(20)


def emotions(tab, edit: str = "deitalk.page.history.edit") -> list[str]:
    return tab.evaluate(f"{edit}.keys.map((key) => key.emotion)")


def press(tab, name: str) -> None:
    tab.get_by_role("button", name=name, exact=True).click()


def test_what_is_done_while_a_recording_is_opened_is_not_lost(browser, server, speech, tmp_path):
    """A choice of emotion, an edit of the take before, another recording in the place of the file."""
    other = tmp_path / "other.wav"
    other.write_bytes(wav(SECONDS / 2))
    with studio(browser, server) as tab:
        with waiting(tab) as held:
            drop(tab, speech)
            wait_for(tab, held, 1)
            press(tab, "angry")
        until(tab, "!!deitalk.page.take")
        is_quiet(tab)
        assert emotions(tab) == ["angry"] and tab.inner_text("#status").startswith("angry")
        with waiting(tab) as held:
            tab.set_input_files("#file", other)
            wait_for(tab, held, 1)
            press(tab, "sad")
            wait_for(tab, held, 2)
        until(tab, "deitalk.page.take.seconds < 1.5")
        is_quiet(tab)
        assert tab.inner_text("#title") == "other" and tab.inner_text("#status").startswith("sad")
        other.write_bytes(speech.read_bytes())
        press(tab, "happy")
        until(tab, "document.getElementById('status').textContent.startsWith('happy')")
        assert tab.evaluate("deitalk.page.take.seconds") < 1.5
        take = download(tab, "Take", tmp_path)
        with waiting(tab) as held:
            drop(tab, take)
            wait_for(tab, held, 1)
            press(tab, "surprised")
        until(tab, "document.getElementById('status').textContent.startsWith('surprised')")
        assert emotions(tab, "deitalk.studio.session.edit") == ["surprised"]
        assert tab.complaints == []


@pytest.mark.slow
def test_files_of_two_kinds_are_written_at_once(browser, server, speech):
    saved = []
    with spoken(browser, server, speech) as tab:
        tab.on("download", lambda given: saved.append(given.suggested_filename))
        with waiting(tab) as held:
            press(tab, "CSV")
            press(tab, "JSON")
            wait_for(tab, held, 2)
        end = time.monotonic() + PATIENCE / 1000
        while len(saved) < 2:
            assert time.monotonic() < end, saved
            tab.wait_for_timeout(20)
        assert sorted(saved) == ["my line.csv", "my line.json"]


def test_reload_goes_on_with_an_edit_that_was_being_animated(browser, server, speech):
    with spoken(browser, server, speech) as tab:
        tab.evaluate("deitalk.page.transport.pause()")
        with waiting(tab) as held:
            press(tab, "angry")
            wait_for(tab, held, 1)
            tab.evaluate("deitalk.page.transport.setRange([0.5, 1])")
            seek(tab, 0.7)
            held.clear()
            tab.reload()
            until(tab, "!!window.deitalk?.ready && !!deitalk.page.take")
        until(tab, "document.getElementById('status').textContent.startsWith('angry')")
        assert emotions(tab) == ["angry"]
        assert tab.evaluate("deitalk.page.transport.range") == [0.5, 1]
        assert tab.evaluate("deitalk.page.state().shown") == pytest.approx(0.7)


@pytest.mark.slow
def test_copy_of_an_open_tab_has_a_session_of_its_own(browser, server, speech, tmp_path):
    other = tmp_path / "other.wav"
    other.write_bytes(wav(SECONDS))
    with spoken(browser, server, speech) as tab:
        tab.wait_for_timeout(500)  # until it is saved
        with tab.expect_popup() as opened:
            tab.evaluate("open('/')")
        copy = opened.value
        copy.complaints = []
        until(copy, "!!window.deitalk?.ready && deitalk.page.take?.title === 'my line'")
        drop(copy, other)
        until(copy, "deitalk.page.take.title === 'other'")
        press(tab, "angry")
        is_quiet(tab)
        for page, title in ((tab, "my line"), (copy, "other")):
            page.reload()
            until(page, f"!!window.deitalk?.ready && deitalk.page.take?.title === '{title}'")
        third = tab.context.new_page()
        third.complaints = []
        third.goto(server.url + "/")
        until(third, "!!window.deitalk?.ready")
        third.get_by_role("button", name="Continue with").click()
        until(third, "!!deitalk.page.take")


@pytest.mark.slow
def test_silence_after_the_speech_is_shown_and_its_end_too(browser, server, speech):
    with spoken(browser, server, speech) as tab:
        for listen in (1, 0):
            tab.get_by_label("listen").fill(str(listen))
            tab.get_by_label("listen").press("Enter")
            is_quiet(tab)
            until(tab, "deitalk.page.clock.audio.duration > 0")
            seek(tab, 99)
            lengths = ["take.seconds", "clock.audio.duration", "span.end", "state().shown"]
            found = tab.evaluate(f"[{', '.join('deitalk.page.' + name for name in lengths)}]")
            assert found == pytest.approx([SECONDS + listen] * 4, abs=0.05)


@pytest.mark.slow
def test_key_in_focus_takes_the_emotion_until_the_focus_leaves_it(browser, server, speech):
    with spoken(browser, server, speech) as tab:
        press(tab, "happy")
        tab.evaluate("deitalk.page.transport.pause()")
        tab.evaluate("deitalk.page.seek(1)")
        tab.click("#add-key")
        for emotion in ("sad", "angry"):
            press(tab, emotion)
        assert emotions(tab) == ["happy", "angry"]
        tab.click("#sound", position={"x": 100, "y": 20})
        press(tab, "surprised")
        assert emotions(tab) == ["happy", "surprised", "angry"]


@pytest.mark.slow
def test_plain_address_keeps_the_session_and_says_why_there_is_no_microphone(
    browser, server, speech
):
    """What browsers leave out of pages that are neither of https nor of localhost."""
    with studio(browser, server) as tab:
        tab.add_init_script(
            """Object.defineProperty(crypto, "randomUUID", { value: undefined });
               Object.defineProperty(navigator, "mediaDevices", { value: undefined });"""
        )
        tab.reload()
        until(tab, "!!window.deitalk?.ready")
        tab.click("#record")
        assert tab.inner_text("#notice").endswith("https and of localhost only")
        assert tab.is_enabled("#record") and tab.is_enabled("#live")
        drop(tab, speech)
        until(tab, "!!deitalk.page.take")
        is_quiet(tab)
        tab.reload()
        until(tab, "!!window.deitalk?.ready && !!deitalk.page.take")
        assert tab.inner_text("#notice") == ""


@pytest.mark.slow
def test_service_that_does_not_answer_is_named_and_the_next_edit_is_made(browser, server, speech):
    with spoken(browser, server, speech) as tab:
        tab.context.set_offline(True)
        press(tab, "angry")
        until(tab, "document.getElementById('notice').textContent.includes('does not answer')")
        tab.context.set_offline(False)
        press(tab, "sad")
        until(tab, "document.getElementById('status').textContent.startsWith('sad')")


@pytest.mark.slow
def test_second_press_while_the_microphone_is_asked_for_opens_no_other(browser, server):
    with studio(browser, server, permissions=["microphone"]) as tab:
        tab.evaluate(
            """() => {
                 const devices = navigator.mediaDevices, open = devices.getUserMedia.bind(devices);
                 window.streams = [];
                 devices.getUserMedia = async (what) => { streams.push(await open(what)); return streams.at(-1); };
               }"""
        )
        for name in ("live", "record"):
            tab.evaluate(
                "(id) => { for (let k = 0; k < 2; k++) document.getElementById(id).click(); }", name
            )
            until(tab, f"document.getElementById('{name}').textContent.startsWith('Stop')")
            assert tab.is_disabled("#record" if name == "live" else "#live")
            tab.click(f"#{name}")
            until(tab, f"!document.getElementById('{name}').textContent.startsWith('Stop')")
        states = "streams.map((stream) => stream.getTracks()[0].readyState)"
        assert tab.evaluate(states) == ["ended", "ended"]


def test_page_is_one_script_that_reaches_this_service_only(server):
    needs_player()
    with server.client() as client:
        answer = client.get("/", headers={"Sec-Fetch-Site": "cross-site"})
    assert answer.status_code == 200 and answer.headers["content-type"].startswith("text/html")
    policy = answer.headers["content-security-policy"]
    assert "default-src 'none'" in policy and "connect-src 'self' blob: data:" in policy
    assert "script-src 'sha256-" in policy and "frame-ancestors 'none'" in policy
    assert policy.count("unsafe") == 1  # of styles


def test_head_of_the_page_is_chosen_in_its_address(server):
    needs_player()
    before = resident_mb(server.process.pid)
    with server.client() as client:
        usual, child = client.get("/"), client.get("/", params={"head": "child"})
        unknown = client.get("/", params={"head": "nobody"})
    assert child.status_code == 200 and child.text != usual.text
    assert unknown.status_code == 422 and "female, male, child" in unknown.text
    assert resident_mb(server.process.pid) < before + 50  # a head is built in another process


def shown_values(tab) -> np.ndarray:
    return numbers(tab, "deitalk.page.take.frame(40)")


@pytest.mark.slow
def test_every_export_is_a_file_of_its_kind(browser, server, speech, tmp_path):
    begins = {
        "Live Link": b"Timecode",
        "GLB": b"glTF",
        "Page": b"<!doctype html>",
        "Take": b"PK",
        "JSON": b"{",
    }
    with spoken(browser, server, speech) as tab:
        for name, begin in begins.items():
            assert download(tab, name, tmp_path).read_bytes().startswith(begin), name
        # the limit of pixels of this server is less than the video has
        tab.get_by_role("button", name="Video", exact=True).click()
        until(tab, "document.getElementById('notice').textContent.includes('at most')")


def test_recording_begins_in_the_suggested_emotion_until_one_is_chosen(browser, server, speech):
    """As `auto` of the command line; the next recording keeps what was chosen."""
    from deitalk import suggest_emotion

    suggested = suggest_emotion(speech)
    with studio(browser, server) as tab:
        drop(tab, speech)
        shown = "document.getElementById('suggested').textContent"
        until(tab, f"{shown}.startsWith('{suggested.line}')")
        is_quiet(tab)
        assert emotions(tab) == [suggested.label]
        press(tab, "angry")
        is_quiet(tab)
        drop(tab, speech)
        until(tab, f"{shown} === ''")
        is_quiet(tab)
        assert emotions(tab) == ["angry"]


@pytest.mark.slow
def test_sample_is_spoken_gladly_and_its_emotion_suggested(browser, server):
    """The status has the mean that the command prints; a neutral take has none."""
    with studio(browser, server) as tab:
        tab.click("#sample")
        until(tab, "deitalk.page.take?.seconds > 1")
        mean = animate(ROOT / "docs/samples/amiable.flac", "happy").mean_applied_intensity
        until(tab, f"document.getElementById('status').textContent.includes('{mean:.2f})')")
        assert tab.inner_text("#status").startswith("happy, intensity")
        tab.get_by_role("button", name="auto", exact=True).click()
        until(tab, "document.getElementById('suggested').textContent.startsWith('neutral (0.')")
        assert all(f"{name} 0." in tab.inner_text("#suggested") for name in ("angry", "happy"))
        until(tab, "document.getElementById('status').textContent === 'neutral'")


def test_emotions_takes_and_captures_are_compared(browser, server, speech, tmp_path):
    with spoken(browser, server, speech) as tab:
        tab.click("#compare")
        until(tab, "document.querySelectorAll('#faces figure').length === 5")
        tab.locator("#faces figcaption button", has_text="surprised").click()
        is_quiet(tab)
        assert "surprised" in tab.inner_text("#status")
        values = shown_values(tab)
        tab.click("#keep")
        tab.get_by_role("button", name="sad", exact=True).click()
        is_quiet(tab)
        assert tab.locator("#faces figure").count() == 2
        tab.click("#wipe")
        kept = numbers(tab, "deitalk.page.takes[1].frame(40)")
        assert (
            np.abs(kept - values).max() < 1e-6 and np.abs(shown_values(tab) - values).max() > 0.05
        )
        tab.keyboard.press("Control+z")
        is_quiet(tab)
        curves = download(tab, "CSV", tmp_path)
        tab.click("#drop-other")
        drop(tab, curves)  # a captured reference over the curves
        until(tab, "deitalk.page.takes.length === 2")
        assert "(my line)" in tab.inner_text("#curves")
        drop(tab, download(tab, "Live Link", tmp_path))  # of an iPhone: the service converts it
        until(tab, "deitalk.page.takes[1]?.title !== 'my line'")
        found = tab.evaluate(
            "deitalk.page.takes[1].frame(40)[deitalk.page.board.controls.indexOf('CTRL_C_jaw.ty')]"
        )
        jaw = values[default_controls().index("CTRL_C_jaw.ty")]
        assert found == pytest.approx(jaw, abs=0.1)


@pytest.mark.slow
def test_take_that_is_dropped_shows_its_arguments_and_gives_the_same_files(
    browser, server, speech, tmp_path
):
    fields = (
        "[...document.querySelectorAll('#acting input, #words, #life input')].map((e) => e.value)"
    )
    with spoken(browser, server, speech) as tab:
        edit(tab)
        before, shown = shown_values(tab), tab.evaluate(fields)
        curves = read_curves(download(tab, "CSV", tmp_path)).values
        take = download(tab, "Take", tmp_path)
        drop(tab, speech)
        until(tab, "document.getElementById('words').value === '' && deitalk.studio.isSettled")
        drop(tab, take)
        until(tab, "document.getElementById('words').value && deitalk.studio.isSettled")
        assert tab.evaluate(fields) == shown and "Bob's promise" in shown and "7" in shown
        assert np.abs(shown_values(tab) - before).max() < 1e-3
        again = read_curves(download(tab, "CSV", tmp_path / "again")).values
        assert np.abs(again - curves).max() < 1e-3
        tab.get_by_label("seed").fill("0")
        tab.get_by_label("seed").press("Enter")
        is_quiet(tab)
        other = read_curves(download(tab, "CSV", tmp_path / "other")).values
        assert np.abs(other - curves).max() > 0.05


def spoken_command(tab, folder) -> list[str]:
    """The command of the button Edits, whose files are saved."""
    tab.on("download", lambda d: d.save_as(folder / d.suggested_filename))
    tab.get_by_role("button", name="Edits", exact=True).click()
    until(tab, "document.getElementById('notice').textContent.startsWith('deitalk ')")
    words = shlex.split(tab.inner_text("#notice"))[1:]
    end = time.monotonic() + PATIENCE / 1000
    while not all((folder / word).exists() for word in words if word.endswith((".csv", ".json"))):
        assert time.monotonic() < end, words
        tab.wait_for_timeout(20)
    return words


def choose_file(tab, name: str, path) -> None:
    """Give a file for an option of the acting, and wait for the take with it."""
    tab.set_input_files(f"#acting input[name={name}]", path)
    until(tab, f"'{name}' in deitalk.page.history.edit.acting")
    is_quiet(tab)


def test_performance_is_dubbed_as_by_the_command_line(
    browser, server, speech, tmp_path, monkeypatch
):
    """A zipped take, then without it again; a gain, an edit and a shift are written too."""
    other = ROOT / "docs/samples/promise.flac"
    face = animate(load_audio(other).waveform[:48_000], "surprised", sample_rate=16_000)
    zipped = tmp_path / shutil.make_archive("face", "zip", face.save(tmp_path / "face"))
    monkeypatch.chdir(tmp_path)
    shutil.move(zipped, tmp_path / "face.zip")
    shutil.copy(speech, tmp_path)
    with spoken(browser, server, speech) as tab:
        own = curve(tab)
        tab.set_input_files("#performance", tmp_path / "face.zip")
        until(tab, "document.getElementById('dub').textContent === 'Dubs face.zip'")
        is_quiet(tab)
        assert "unchanged" in tab.inner_text("#notice")
        dubbed = curve(tab)
        brow = face.curves["CTRL_L_brow_raiseIn.ty"]
        assert np.abs(dubbed - own).max() > 0.05
        assert abs(dubbed[0] - brow[0]) < 0.01 < abs(own[0] - brow[0]), "as the performance begins"
        tab.get_by_role("slider", name="Gain of brow").fill("0.5")
        tab.evaluate("deitalk.page.workbench.layers.choose('CTRL_L_nose.ty')")
        seek(tab, 1.0)
        tab.click("#add-edit")
        for _ in range(9):
            tab.keyboard.press("ArrowUp")
        tab.fill("#delay", "2")
        tab.fill("#handles", "4")
        take = download(tab, "Take", tmp_path)
        shown = spoken_command(tab, tmp_path)
        assert tab.complaints == []
        tab.reload()
        until(tab, "document.getElementById('dub').textContent === 'Dubs face.zip'")
        is_quiet(tab)
        tab.click("#dub")
        until(tab, "document.getElementById('dub').textContent === 'Dub a performance'")
        is_quiet(tab)
        tab.get_by_role("slider", name="Gain of brow").fill("1")
        is_quiet(tab)
        assert np.abs(curve(tab) - own).max() < 1e-3
    assert shown[:2] == ["dub", "face.zip"]
    with zipfile.ZipFile(take) as archive:
        archive.extractall("exported")
    command(*shown[:-1], "again/")
    found, wanted = (read_curves(f"{name}/curves.json") for name in ("exported", "again"))
    assert np.abs(found.values - wanted.values).max() < 1e-5
    about = json.loads((tmp_path / "exported/take.json").read_text())
    assert (about["delay_frames"], about["handles_frames"]) == (2, 4)
    assert json.loads((tmp_path / "exported/dub.json").read_text())["kept"]


def curve(tab) -> np.ndarray:
    """A brow of all frames as the page shows it."""
    rows = "Float32Array.from(Array.from({ length: deitalk.page.take.frames }, (_, k) => deitalk.page.take.frame(k)[deitalk.page.board.controls.indexOf('CTRL_L_brow_raiseIn.ty')]))"
    return numbers(tab, rows)


def test_files_of_the_acting_are_chosen_kept_and_left_out(
    browser, server, speech, tmp_path, monkeypatch
):
    """Another voice and the take before, as files; the command line and the take have them."""
    other = tmp_path / "other.wav"
    other.write_bytes(wav(1.0))
    animate(load_audio(other).waveform, "sad", sample_rate=16_000).save(tmp_path / "before.json")
    shutil.copy(speech, tmp_path)
    monkeypatch.chdir(tmp_path)
    with spoken(browser, server, speech) as tab:
        choose_file(tab, "listen_to", other)
        choose_file(tab, "after", tmp_path / "before.json")
        take = download(tab, "Take", tmp_path)
        shown = spoken_command(tab, tmp_path)
        assert tab.complaints == []
        drop(tab, take)
        until(
            tab,
            "typeof deitalk.page.history.edit.acting.after === 'string' && deitalk.studio.isSettled",
        )
        text = tab.inner_text("#acting")
        assert text.count("of the take") == 2
        again = download(tab, "CSV", tmp_path)
        tab.get_by_role("button", name="No after", exact=True).click()
        is_quiet(tab)
        assert tab.evaluate("Object.keys(deitalk.page.history.edit.acting)") == ["listen_to"]
    with zipfile.ZipFile(take) as archive:
        archive.extractall("exported")
    settings = json.loads((tmp_path / "exported/take.json").read_text())["settings"]
    assert settings["after"]["pose"] and settings["listen_to"]["phrases"]
    command(*shown[:-1], "again.csv")
    assert "--listen-to" in shown and "--after" in shown
    wanted = read_curves("again.csv").values
    for found in (read_curves("exported/curves.json"), read_curves(again)):
        assert np.abs(found.values - wanted).max() < 1e-3


@pytest.mark.slow
@pytest.mark.parametrize("scheme", ["dark", "light"])
def test_studio_fits_a_phone_and_names_everything(browser, server, speech, scheme):
    narrow = {"width": 390, "height": 844}
    with spoken(browser, server, speech, viewport=narrow, color_scheme=scheme) as tab:
        assert tab.evaluate("document.documentElement.scrollWidth") <= 390
        unnamed = """() => [...document.querySelectorAll("button, input, select, [role=slider], [role=group]")]
            .filter((e) => e.checkVisibility() && !e.textContent.trim() && !e.getAttribute("aria-label")
              && !e.getAttribute("aria-labelledby") && !e.labels?.length).map((e) => e.outerHTML)"""
        assert tab.evaluate(unnamed) == []


@pytest.mark.slow
def test_microphone_is_recorded_and_spoken(browser, server):
    with studio(browser, server, permissions=["microphone"]) as tab:
        tab.click("#record")
        until(tab, "parseFloat(document.getElementById('recorded').textContent) > 1")
        assert tab.get_attribute("#record", "aria-pressed") == "true"
        tab.click("#record")
        until(tab, "deitalk.page.take?.seconds > 0.8")
        assert tab.evaluate("deitalk.page.take.audioSeconds") > 0.8


@pytest.mark.slow
def test_live_microphone_moves_the_face(browser, server):
    with studio(browser, server, permissions=["microphone"]) as tab:
        rest = numbers(tab, "deitalk.page.state().vertices")
        tab.click("#live")
        until(tab, "document.getElementById('recorded').textContent.endsWith('late')")
        tab.get_by_role("button", name="surprised", exact=True).click()
        seen = 0.0
        for _ in range(40):
            time.sleep(0.1)
            shown = numbers(tab, "deitalk.page.state().vertices")
            seen = max(seen, np.abs(shown - rest).max())
        assert seen > 0.05
        tab.click("#live")
        until(tab, "document.getElementById('live').textContent === 'Live'")
        assert tab.complaints == []


@pytest.mark.slow
def test_longer_recordings_and_their_edits_are_jobs_whose_results_are_shown(
    browser, server, tmp_path
):
    (tmp_path / "long.wav").write_bytes(wav(62.0))
    with studio(browser, server) as tab:
        drop(tab, tmp_path / "long.wav")
        until(tab, "!document.querySelector('#works .work').hidden")
        assert tab.get_by_role("button", name="Cancel").is_visible()
        until(tab, "deitalk.page.take?.seconds >= 62")
        assert any("/v1/jobs/" in url for url in tab.asked)
        tab.get_by_role("button", name="angry", exact=True).click()
        seek(tab, 10)
        tab.keyboard.press("p")
        for _ in range(9):
            tab.keyboard.press("ArrowUp")
        is_quiet(tab)
        shown = shown_values(tab)
        exported = read_curves(download(tab, "CSV", tmp_path))
        assert np.abs(shown - exported.values[40]).max() < 1e-3  # packed in 16 bits
        assert tab.complaints == []


@pytest.mark.slow
def test_page_asks_for_a_key_where_one_is_needed(browser, keyed_server, speech):
    with studio(browser, keyed_server) as tab:
        drop(tab, speech)
        until(tab, "document.getElementById('key-dialog').open")
        tab.fill("#key", KEYS["viewer"])
        tab.click("#key-dialog button[value=ok]")
        until(tab, "!!deitalk.page.take")


@pytest.mark.slow
def test_what_cannot_be_read_is_one_line(browser, server, tmp_path):
    (tmp_path / "noise.wav").write_bytes(b"RIFF" + bytes(100))
    (tmp_path / "text.pdf").write_bytes(b"%PDF")
    (tmp_path / "table.csv").write_text("a,b\n1,2\n3,4\n")
    with studio(browser, server) as tab:
        for name in ("noise.wav", "text.pdf", "table.csv"):
            tab.evaluate("document.getElementById('notice').textContent = ''")
            drop(tab, tmp_path / name)
            until(tab, "!!document.getElementById('notice').textContent")
            assert len(tab.inner_text("#notice").splitlines()) == 1
        assert tab.evaluate("deitalk.page.take === undefined")
