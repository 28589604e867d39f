"""The preview page: packing, data in the file, and the page in a browser."""

import base64
import gzip
import io
import json
import re
import struct
import sys

import numpy as np
import pytest

from deitalk.emotions import read_intensity_curve
from deitalk.errors import MissingError
from deitalk.preview import page as page_module
from deitalk.preview.pack import pack
from deitalk.preview.page import render_page
from deitalk.preview.source import PreviewError, PreviewSource
from deitalk.preview.warnings import bilabial_warnings
from rig import RigCurves, default_controls
from rig.errors import ExistsError, TargetError
from rig.face import build_head
from rig.face.poses import EMOTION_POSES, MOUTH_POSES, pose_values
from tests.browser import chromium, needs_player, opened

CONTROLS = default_controls()
RATE = 16000


def unpack(text: str) -> tuple[dict, dict]:
    """The decoding of data.ts in Python."""
    data = gzip.decompress(base64.b64decode(text))
    (length,) = struct.unpack("<I", data[:4])
    header = json.loads(data[4 : 4 + length])
    start = -(-(4 + length) // 8) * 8
    arrays = {
        e["name"]: np.frombuffer(data, e["kind"], e["length"], start + e["offset"])
        for e in header["arrays"]
    }
    return arrays, header["facts"]


def make_source(title: str = "take", frames: int = 90) -> PreviewSource:
    rng = np.random.default_rng(3)
    keys = list(MOUTH_POSES.values())
    neutral = np.stack([pose_values(keys[(k // 6) % 9 + 1], 0.8) for k in range(frames)])
    happy = pose_values(EMOTION_POSES["happy"]) - pose_values({})
    intensity = 0.5 + 0.4 * np.sin(np.arange(frames) / 9)
    values = np.clip(neutral + intensity[:, None] * happy * 0.8, CONTROLS.minimum, CONTROLS.maximum)
    emotion = np.zeros((frames, 5))
    emotion[:, 2] = 1
    curves = RigCurves(values, CONTROLS.names, 30.0, emotion, intensity)
    sound = (0.2 * rng.standard_normal(frames * RATE // 30)).astype(np.float32)
    phones = ((0.0, 0.06, "B"),)  # over an open vowel
    return PreviewSource(title, curves, sound, RATE, neutral.astype(np.float32), phones)


def test_pack_keeps_arrays_and_facts():
    arrays = {
        "a": np.array([[1.5, -2], [3, 4]], np.float32),
        "b": np.array([1, 65535, 3], np.uint16),
        "c": np.array([-7], np.int16),
    }
    found, facts = unpack(pack(arrays, {"name": "Zoë", "n": [1, 2]}))
    assert facts == {"name": "Zoë", "n": [1, 2]}
    for name, array in arrays.items():
        assert np.array_equal(found[name], array.ravel())


def test_pack_is_the_same_every_time():
    arrays = {"a": np.arange(5, dtype=np.float32)}
    assert pack(arrays, {}) == pack(arrays, {})


@pytest.fixture
def tiny_player(tmp_path, monkeypatch):
    bundle = tmp_path / "player.html"
    bundle.write_text("<html><body><!--deitalk-data--></body></html>")
    monkeypatch.setattr(page_module, "BUNDLE", bundle)


def block(page: str, name: str) -> str:
    found = re.search(rf'<script type="text/plain" id="{name}">(.*?)</script>', page)
    assert found is not None
    return found[1]


def test_page_holds_the_take_and_the_recording(tiny_player, tmp_path):
    import soundfile

    source = make_source()
    page = render_page(source, tmp_path / "p.html").read_text()
    arrays, facts = unpack(block(page, "take-0"))
    assert np.allclose(arrays["values"].reshape(90, 185), source.curves.values)
    assert np.allclose(arrays["neutral"].reshape(90, 185), source.neutral)
    assert facts["frames"] == 90 and facts["fps"] == 30
    samples, rate = soundfile.read(io.BytesIO(base64.b64decode(block(page, "audio-0"))))
    assert rate == RATE and np.abs(samples - source.samples).max() < 1e-3
    arrays, facts = unpack(block(page, "head"))
    assert facts["controls"] == list(CONTROLS.names)
    assert np.allclose(arrays["vertices"].reshape(-1, 3), build_head(0).mesh.vertices, atol=1e-5)


def test_page_without_recording_has_no_audio(tiny_player, tmp_path):
    source = make_source()
    silent = PreviewSource("s", source.curves, np.zeros(0, np.float32), 0)
    page = render_page(silent, tmp_path / "p.html").read_text()
    assert block(page, "audio-0") == ""


def test_missing_player_error_gives_the_build_steps(tmp_path, monkeypatch):
    monkeypatch.setattr(page_module, "BUNDLE", tmp_path / "none.html")
    with pytest.raises(MissingError, match="npm install && npm run build"):
        render_page(make_source(), tmp_path / "p.html")
    assert not (tmp_path / "p.html").exists()


@pytest.mark.parametrize(
    ("name", "message"), [("p.txt", r"\.html file"), ("no/p.html", "is not a folder")]
)
def test_bad_targets_are_refused(tiny_player, tmp_path, name, message):
    with pytest.raises((PreviewError, TargetError), match=message):
        render_page(make_source(), tmp_path / name)


def test_existing_page_is_kept_without_force(tiny_player, tmp_path):
    (tmp_path / "p.html").write_text("mine")
    with pytest.raises(ExistsError, match="exists"):
        render_page(make_source(), tmp_path / "p.html")
    assert (tmp_path / "p.html").read_text() == "mine"


def test_three_takes_are_refused(tiny_player, tmp_path):
    with pytest.raises(PreviewError, match="3 takes"):
        render_page([make_source()] * 3, tmp_path / "p.html")


# ------------------------------------------------------------------- in a browser


@pytest.fixture(scope="module")
def browser():
    with chromium() as running:
        yield running


@pytest.fixture(scope="module")
def page_file(tmp_path_factory):
    needs_player()
    folder = tmp_path_factory.mktemp("page")
    takes = [make_source("first"), make_source("second")]
    render_page(takes[:1], folder / "one.html")
    render_page(takes, folder / "two.html")
    return folder


@pytest.fixture
def page(browser, page_file):
    with opened(browser, page_file / "one.html") as tab:
        yield tab


@pytest.fixture(scope="module")
def shared(browser, page_file):
    """One tab of tests that leave it as it was."""
    with opened(browser, page_file / "one.html") as tab:
        yield tab


def shown_vertices(page) -> np.ndarray:
    return np.array(page.evaluate("Array.from(deitalk.page.state().vertices)")).reshape(-1, 3)


def test_page_opens_offline_without_console_errors(page):
    page.wait_for_timeout(300)
    assert page.complaints == []
    assert page.inner_text("#title") == "first"


def test_rig_of_the_page_equals_that_of_python(page):
    head, rng = build_head(0), np.random.default_rng(11)
    full = CONTROLS.minimum + (CONTROLS.maximum - CONTROLS.minimum) * rng.random((6, 185))
    values = np.where(rng.random((6, 185)) < 0.5, full, CONTROLS.rest)
    for row, expected in zip(values, head.pose(values), strict=True):
        posed = page.evaluate("v => Array.from(deitalk.page.pose(v))", row.tolist())
        assert np.abs(np.array(posed).reshape(-1, 3) - expected).max() < 0.01  # 0.1 mm


def test_shown_frame_agrees_with_the_audio_clock(page):
    medians = []
    for _ in range(3):  # a busy machine may delay one play; a wrong clock is late in all
        page.evaluate("deitalk.page.seek(0)")
        page.click("#play")
        late = []
        for _ in range(6):
            page.wait_for_timeout(200)
            late.append(
                page.evaluate(
                    """() => new Promise(done => requestAnimationFrame(() => setTimeout(() => {
                         const s = deitalk.page.state(); done(s.time - s.shown); }, 0)))"""
                )
            )
        assert page.evaluate("deitalk.page.state().time") > 1.0  # it plays
        page.click("#play")
        medians.append(float(np.median(np.abs(late))))
        if medians[-1] <= 0.017:
            break
    assert min(medians) <= 0.017


@pytest.mark.parametrize("seconds", [0.4, 1.1, 2.5])
def test_seeking_shows_the_curves_of_that_time(page, seconds):
    source, head = make_source("first"), build_head(0)
    page.evaluate("s => deitalk.page.seek(s)", seconds)
    page.wait_for_timeout(200)
    place = seconds * 30
    low = int(place)
    values = source.curves.values.astype(float)
    mixed = values[low] + (place - low) * (values[min(low + 1, 89)] - values[low])
    assert np.abs(shown_vertices(page) - head.pose(mixed)).max() < 0.02


def test_dragging_intensity_changes_the_face_and_saves(page, tmp_path):
    page.evaluate("deitalk.page.seek(1)")
    page.wait_for_timeout(200)
    before = shown_vertices(page)
    dot = page.locator("#intensity circle").nth(2)
    box = dot.bounding_box()
    page.mouse.move(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
    page.mouse.down()
    page.mouse.move(box["x"] + box["width"] / 2, box["y"] + 300)
    page.mouse.up()
    assert np.abs(shown_vertices(page) - before).max() > 0.05
    with page.expect_download() as download:
        page.click("#save")
    path = tmp_path / "intensity.csv"
    download.value.save_as(path)
    curve = read_intensity_curve(path)
    assert curve.at([1.0])[0] < 0.1  # dragged to the floor
    assert curve.at([2.9])[0] > 0.05


@pytest.mark.slow
def test_intensity_zero_is_the_neutral_reading(page):
    source, head = make_source("first"), build_head(0)
    page.evaluate("deitalk.page.seek(1)")
    dots = page.locator("#intensity circle")
    for k in range(dots.count()):
        dots.nth(k).focus()
        for _ in range(19):
            page.keyboard.press("ArrowDown")
    assert np.abs(shown_vertices(page) - head.pose(source.neutral[30])).max() < 0.02


def test_muting_a_region_rests_it(page):
    page.evaluate("deitalk.page.seek(1)")
    page.click("#regions button:has-text('mouth')")
    values = make_source("first").curves.values[30].astype(float)
    values[CONTROLS.subset("mouth")] = CONTROLS.rest[CONTROLS.subset("mouth")]
    assert np.abs(shown_vertices(page) - build_head(0).pose(values)).max() < 0.02


def test_warnings_of_python_are_listed_and_seek(page):
    (found,) = bilabial_warnings(make_source())
    assert found.text in page.inner_text("#warnings")
    page.evaluate("deitalk.page.seek(2)")
    page.click(f"#warnings li:has-text('{found.text}') button")
    assert page.evaluate("deitalk.page.state().time") == pytest.approx(found.time, abs=0.02)


def test_keys_step_and_turn(page):
    page.keyboard.press(".")
    assert page.evaluate("deitalk.page.state().frame") == 1
    page.keyboard.press("4")
    page.keyboard.press("?")
    assert page.is_visible("#help")


def test_a_control_can_be_added_by_name(page):
    page.fill("#search", "CTRL_C_tongue_inOut.ty")
    page.press("#search", "Enter")
    assert "C_tongue_inOut.ty" in page.inner_text("#curves")


def frame_of(page) -> int:
    return page.evaluate("deitalk.page.state().frame")


def is_playing(page) -> bool:
    return page.get_attribute("#play", "aria-pressed") == "true"


def test_keys_play_and_step_after_a_click_on_loop_or_speed(page):
    page.click("#loop")
    page.keyboard.press(".")
    assert frame_of(page) == 1
    page.keyboard.press("Space")
    assert is_playing(page) and page.is_checked("#loop")
    page.keyboard.press("Space")
    page.click("#speed")
    page.keyboard.press("Escape")
    page.select_option("#speed", "2")
    before = frame_of(page)
    page.keyboard.press(",")
    assert frame_of(page) == before - 1
    page.keyboard.press("Space")
    assert is_playing(page)


def test_checkbox_reached_by_tab_keeps_the_space_key(shared):
    shared.focus("#loop")
    shared.keyboard.press("Space")
    assert shared.is_checked("#loop") and not is_playing(shared)
    shared.uncheck("#loop")


def test_end_goes_to_the_last_frame_and_stays(shared):
    shared.click("#loop")
    shared.keyboard.press("End")
    shared.wait_for_timeout(150)
    assert frame_of(shared) == 90 and not is_playing(shared)
    shared.uncheck("#loop")


def test_twice_the_speed_plays_twice_as_fast(shared):
    shared.select_option("#speed", "2")
    assert shared.evaluate("deitalk.page.clock.audio.playbackRate") == 2


def test_solo_is_undone_by_a_second_press(shared):
    muted = "deitalk.page.takes[0].muted.size"
    solo = shared.get_by_role("button", name="Only mouth")
    solo.click()
    assert shared.evaluate(muted) > 5 and solo.get_attribute("aria-pressed") == "true"
    solo.click()
    assert shared.evaluate(muted) == 0 and solo.get_attribute("aria-pressed") == "false"


def test_search_finds_controls_by_words(shared):
    shared.fill("#search", "left TONGUE")
    assert "no control" in shared.inner_text("#found")
    shared.fill("#search", "tongue tip")
    found = shared.locator("#found button").all_inner_texts()
    assert found and all("tongue" in name and "tip" in name.lower() for name in found)
    shared.locator("#found button").first.click()
    assert found[0].replace("CTRL_", "") in shared.inner_text("#curves")


def test_status_gives_the_mean_of_the_applied_intensity(shared):
    source = make_source("first")
    assert f"(mean {source.curves.intensity.mean():.2f})" in shared.inner_text("#status")


def test_second_take_has_its_curves(browser, page_file):
    with opened(browser, page_file / "two.html") as tab:
        assert "C_jaw.ty (second)" in tab.inner_text("#curves")


def test_targets_are_at_least_24_pixels(shared):
    sizes = shared.evaluate(
        """() => [...document.querySelectorAll("button, select, input:not([type=file])")]
             .filter((e) => e.offsetParent).map((e) => [e.id || e.textContent, e.offsetWidth, e.offsetHeight])"""
    )
    assert len(sizes) > 20
    assert [small for small in sizes if min(small[1:]) < 24] == []


@pytest.mark.parametrize("scheme", ["dark", "light"])
def test_placeholder_has_the_contrast_of_text(shared, scheme):
    shared.emulate_media(color_scheme=scheme)
    color, back = shared.evaluate(
        """() => { const e = document.getElementById("search");
             return [getComputedStyle(e, "::placeholder").color, getComputedStyle(e).backgroundColor]; }"""
    )
    assert contrast(color, back) >= 4.5


def contrast(first: str, second: str) -> float:
    """Ratio of the relative luminances of two rgb() colours (WCAG 2)."""
    levels = []
    for color in (first, second):
        rgb = np.array([float(part) for part in re.findall(r"[\d.]+", color)[:3]]) / 255
        linear = np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)
        levels.append(float(linear @ [0.2126, 0.7152, 0.0722]))
    return (max(levels) + 0.05) / (min(levels) + 0.05)


@pytest.mark.parametrize("scheme", ["dark", "light"])
def test_narrow_page_does_not_scroll_sideways(browser, page_file, scheme):
    narrow = {"width": 390, "height": 844}
    with opened(browser, page_file / "two.html", viewport=narrow, color_scheme=scheme) as tab:
        assert tab.evaluate("document.documentElement.scrollWidth") <= 390
        assert tab.locator("#faces canvas").count() == 2


def test_page_is_below_its_size_limit(page_file):
    text = (page_file / "one.html").read_text()
    assert (len(text) - len(block(text, "audio-0"))) / 1e6 <= 4


@pytest.mark.slow
def test_page_is_fast_enough_without_a_gpu(page, capsys):
    speeds = [
        page.evaluate(
            """() => new Promise(done => { let n = 0; const t = performance.now();
                 const go = () => { deitalk.page.seek((n % 60) / 30); n++;
                   performance.now() - t < 2000 ? requestAnimationFrame(go) : done(n / 2); };
                 go(); })"""
        )
        for _ in range(3)
    ]
    listed = ", ".join(f"{speed:.0f}" for speed in speeds)
    with capsys.disabled():
        sys.stdout.write(f"\npage without a GPU: {listed} frames a second\n")
    assert max(speeds) >= 8  # frames a second without a GPU, once the page has adapted
