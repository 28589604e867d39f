"""The preview page: packing, data in the file, and the page in a browser."""

import base64
import gzip
import io
import json
import re
import struct

import numpy as np
import pytest

from deitalk.emotions import read_intensity_curve
from deitalk.errors import MissingError
from deitalk.preview import page as page_module
from deitalk.preview.packing import pack
from deitalk.preview.page import render_page
from deitalk.preview.source import PreviewError, PreviewSource
from deitalk.preview.speech_warnings import bilabial_warnings
from deitalk.research.poses import EMOTION_POSES, MOUTH_POSES, pose_values
from rig import RigCurves, clamp, default_controls, gain
from rig.errors import TargetError
from rig.face import build_head
from rig.face.identity import identity_of
from rig.retarget.head_import import import_head
from tests.browser import chromium, lateness, needs_player, numbers, opened
from tests.command import ran

CONTROLS = default_controls()
RATE = 16000


def unpack(text: str) -> tuple[dict, dict]:
    """The decoding of data.ts in Python."""
    data = gzip.decompress(base64.b64decode(text))
    (length,) = struct.unpack("<I", data[:4])
    header = json.loads(data[4 : 4 + length])
    start = -(-(4 + length) // 8) * 8
    arrays = {}
    for e in header["arrays"]:
        size = np.dtype(e["kind"]).itemsize
        planes = np.frombuffer(data, np.uint8, size * e["length"], start + e["offset"])
        arrays[e["name"]] = planes.reshape(size, -1).T.copy().view(e["kind"])[:, 0]
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


@pytest.fixture
def tiny_player(tmp_path, monkeypatch):
    bundle = tmp_path / "player.html"
    bundle.write_text("<html><body><!--deitalk-data--></body></html>")
    monkeypatch.setattr(page_module, "BUNDLE", bundle)


def block(page: str, name: str) -> str:
    found = re.search(rf'<script type="text/plain" id="{name}">(.*?)</script>', page)
    assert found is not None
    return found[1]


def test_a_take_gets_a_page_and_no_video_unless_one_is_asked_for(tiny_player, tmp_path):
    from deitalk import animate

    take = animate(np.zeros(16_000, np.float32), sample_rate=16_000).save(tmp_path / "take")
    before = {path.name for path in take.iterdir()}
    ran("preview", take)
    assert {path.name for path in take.iterdir()} - before == {"preview.html"}
    assert list(tmp_path.rglob("*.mp4")) == []


def test_animate_adds_a_page_alone_and_needs_no_encoder(tiny_player, tmp_path, monkeypatch):
    import av
    import soundfile

    monkeypatch.setattr(av, "codecs_available", set())  # of a video
    soundfile.write(tmp_path / "a.wav", np.zeros(8_000), 16_000)
    command = ["animate", str(tmp_path / "a.wav"), "--preview", "-o", str(tmp_path / "take")]
    ran(*command)
    files = json.loads((tmp_path / "take/take.json").read_text())["files"]
    assert [name for name in files if "preview" in name] == ["preview.html"]
    assert [path.name for path in tmp_path.rglob("preview.*")] == ["preview.html"]


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
    assert np.allclose(arrays["points"].reshape(-1, 3) / 800, build_head(0).straight, atol=1e-5)


def test_missing_player_error_gives_the_build_steps(tmp_path, monkeypatch):
    monkeypatch.setattr(page_module, "BUNDLE", tmp_path / "none.html")
    with pytest.raises(MissingError, match="make page"):
        render_page(make_source(), tmp_path / "p.html")
    assert not (tmp_path / "p.html").exists()


@pytest.mark.parametrize(
    ("name", "message"), [("p.txt", r"\.html file"), ("no/p.html", "is not a folder")]
)
def test_bad_targets_are_refused(tiny_player, tmp_path, name, message):
    with pytest.raises((PreviewError, TargetError), match=message):
        render_page(make_source(), tmp_path / name)


@pytest.fixture(scope="module")
def browser():
    with chromium() as running:
        yield running


@pytest.fixture(scope="module")
def page_file(tmp_path_factory):
    needs_player()
    folder = tmp_path_factory.mktemp("page")
    takes = [make_source(name) for name in ("first", "second", "third")]
    render_page(takes[:1], folder / "one.html")
    render_page(takes, folder / "three.html")
    return folder


RESET = """() => {
  const { page } = deitalk;
  page.transport.pause();
  page.history.reset({ points: [], keys: [], gains: {}, muted: [], layers: [], life: {} });
  page.transport.setRange();
  page.span.fit();
  document.getElementById("loop").checked = false;
  for (const [id, value] of [["speed", "1"], ["search", ""]]) document.getElementById(id).value = value;
  document.getElementById("speed").dispatchEvent(new Event("change"));
  document.getElementById("help").close();
  document.activeElement.blur();
  page.seek(0);
}"""


@pytest.fixture(scope="module")
def tab(browser, page_file):
    with opened(browser, page_file / "one.html") as tab:
        yield tab


@pytest.fixture
def page(tab):
    """The page of one take as it was opened."""
    tab.complaints.clear()
    tab.evaluate(RESET)
    return tab


def shown_vertices(page) -> np.ndarray:
    return numbers(page, "deitalk.page.state().vertices").reshape(-1, 3)


def test_rig_of_the_page_equals_that_of_python(page):
    head, rng = build_head(0), np.random.default_rng(11)
    full = CONTROLS.minimum + (CONTROLS.maximum - CONTROLS.minimum) * rng.random((6, 185))
    values = np.where(rng.random((6, 185)) < 0.5, full, CONTROLS.rest)
    for row, expected in zip(values, head.pose(values), strict=True):
        posed = numbers(page, "deitalk.page.pose(given)", row.tolist()).reshape(-1, 3)
        assert np.abs(posed - expected).max() < 0.01  # 0.1 mm


def test_a_users_head_moves_in_the_page_as_in_python(browser, tmp_path):
    from tests.rig.retarget.test_head_import import Face

    import_head(Face().write(tmp_path / "mine.glb"), tmp_path / "mine.npz")
    mine = identity_of(str(tmp_path / "mine.npz"))
    render_page(make_source(), tmp_path / "p.html", identity=mine)
    head, rng = build_head(mine), np.random.default_rng(12)
    values = CONTROLS.minimum + (CONTROLS.maximum - CONTROLS.minimum) * rng.random((4, 185))
    with opened(browser, tmp_path / "p.html") as tab:
        for row, expected in zip(values, head.pose(values), strict=True):
            posed = numbers(tab, "deitalk.page.pose(given)", row.tolist()).reshape(-1, 3)
            assert np.abs(posed - expected).max() < 0.01  # 0.1 mm
        assert not tab.complaints


def test_buttons_of_the_studio_are_not_in_a_file(page):
    for name in ("#intake", "#pick", "#record", "#compare", "#hint"):
        assert not page.is_visible(name), name


def test_shown_frame_agrees_with_the_audio_clock(page):
    """Within one frame of 30 Hz: software draws the head in more than half of one."""
    assert lateness(page, 0.034) <= 0.034


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


def applied_after(tmp_path, page) -> np.ndarray:
    """Intensity of the saved file at the frames of the take."""
    with page.expect_download() as download:
        page.click("#save")
    download.value.save_as(tmp_path / "intensity.csv")
    return read_intensity_curve(tmp_path / "intensity.csv").at(np.arange(90) / 30)


def lane_place(page, seconds: float, factor: float) -> tuple[float, float]:
    """Where the lane of intensity, whose axis is linear, has a time and a factor of the take's."""
    box = page.locator("#intensity").bounding_box()
    top = float(page.locator("#intensity .axis text").last.text_content())
    predicted = make_source("first").curves.intensity[round(30 * seconds)]
    height = (1 - float(factor * predicted) / top) * (box["height"] - 20) + 10
    return box["x"] + seconds / 3 * box["width"], box["y"] + height


def drag(page, start: tuple[float, float], end: tuple[float, float]) -> None:
    page.mouse.move(*start)
    page.mouse.down()
    page.mouse.move(*end, steps=4)
    page.mouse.up()


def test_points_are_a_factor_on_the_intensity(page, tmp_path):
    intensity = make_source("first").curves.intensity
    for seconds in (1, 2):
        page.evaluate("s => deitalk.page.seek(s)", seconds)
        page.keyboard.press("p")
    assert page.locator("#intensity circle").count() == 2
    drag(page, lane_place(page, 2.0, 1.0), lane_place(page, 2.5, 1.5))  # both ways
    factor = np.interp(np.arange(90) / 30, [1.0, 2.5], [1.0, 1.5])
    assert applied_after(tmp_path, page) == pytest.approx(factor * intensity, abs=0.04)
    page.keyboard.press("Control+z")
    page.keyboard.press("Control+z")
    assert page.locator("#intensity circle").count() == 1
    page.keyboard.press("Control+y")
    assert page.locator("#intensity circle").count() == 2
    page.locator("#intensity circle").nth(1).focus()
    page.keyboard.press("Delete")
    page.locator("#intensity circle").nth(0).dblclick()
    assert np.abs(applied_after(tmp_path, page) - intensity).max() < 1e-5


def test_the_line_itself_is_dragged_and_bends_nearby(page, tmp_path):
    intensity = make_source("first").curves.intensity
    drag(page, lane_place(page, 1.5, 1.0), lane_place(page, 1.5, 0.5))
    applied = applied_after(tmp_path, page)
    assert applied[45] == pytest.approx(0.5 * intensity[45], abs=0.03)
    far = np.abs(np.arange(90) - 45) > 13  # 0.43 s
    assert np.abs(applied - intensity)[far].max() < 1e-5
    page.keyboard.press("Control+z")
    assert page.locator("#intensity circle").count() == 0


def test_double_click_on_the_line_adds_one_point_and_a_click_none(page):
    place = lane_place(page, 1.5, 1.0)
    page.mouse.click(*place)
    assert page.locator("#intensity circle").count() == 0
    page.mouse.dblclick(*place)
    (point,) = page.evaluate("deitalk.page.history.edit.points")
    assert point["time"] == pytest.approx(1.5, abs=0.01) and point["factor"] == pytest.approx(
        1, abs=0.05
    )
    drag(page, place, lane_place(page, 2.0, 1.0))
    (point,) = page.evaluate("deitalk.page.history.edit.points")
    assert point["time"] == pytest.approx(2.0, abs=0.01)
    place = lane_place(page, 2.0, point["factor"])
    page.mouse.dblclick(*place)
    assert page.locator("#intensity circle").count() == 0
    assert page.evaluate("String(getSelection())") == ""


def middle(point) -> tuple[float, float]:
    box = point.bounding_box()
    return box["x"] + box["width"] / 2, box["y"] + box["height"] / 2


def add_points(page, *seconds: float) -> None:
    """Points of factor 1."""
    points = [{"time": time, "factor": 1} for time in seconds]
    page.evaluate("points => deitalk.page.history.change({ points })", points)


def points_of(page) -> list[tuple[float, float]]:
    return page.evaluate("deitalk.page.history.edit.points.map((p) => [p.time, p.factor])")


def test_undo_in_a_drag_ends_it(page):
    add_points(page, 1)
    add_points(page, 0.5, 1, 2)
    x, y = middle(page.locator("#intensity circle").nth(0))
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(x + 20, y, steps=3)
    page.keyboard.press("Control+z")  # the drag
    page.keyboard.press("Control+z")  # the points beside the first
    page.mouse.move(x + 60, y, steps=3)
    page.mouse.up()
    assert points_of(page) == [[1, 1]]
    assert page.complaints == []


def test_keys_raise_a_point_beyond_the_axis_and_each_press_is_undone(page):
    add_points(page, 0.5)  # where the intensity is .9 and the axis ends at 1.5
    top = page.locator("#intensity .axis text").last.text_content
    assert top() == "1.5"
    page.locator("#intensity circle").focus()
    for _ in range(12):
        page.keyboard.press("ArrowUp")
    assert top() == "2.0"
    ((_, raised),) = points_of(page)
    page.keyboard.press("ArrowDown")
    page.keyboard.press("Control+z")
    assert points_of(page) == [[0.5, raised]]
    page.click("#reset")
    assert top() == "1.5"


def test_factor_zero_is_the_neutral_reading(page):
    source = make_source("first")
    page.evaluate("deitalk.page.seek(1)")
    page.keyboard.press("p")
    assert page.locator("#intensity circle:focus").count() == 1
    for _ in range(30):
        page.keyboard.press("ArrowDown")
    assert np.abs(shown_vertices(page) - build_head(0).pose(source.neutral[30])).max() < 0.02


def test_gain_scales_the_distance_from_rest(page):
    page.evaluate("deitalk.page.seek(1)")
    page.get_by_role("slider", name="Gain of mouth").fill("0.5")
    scaled = gain(make_source("first").curves, {"mouth": 0.5})
    assert (
        np.abs(shown_vertices(page) - build_head(0).pose(clamp(scaled)[0].values[30])).max() < 0.02
    )


def test_zoom_shows_a_part_and_fit_all(page):
    span = "[deitalk.page.span.start, deitalk.page.span.end]"
    page.evaluate("deitalk.page.seek(1.5)")
    page.keyboard.press("z")
    start, end = page.evaluate(span)
    assert 0 < start < 1.5 < end < 3 and end - start == pytest.approx(2.1)
    page.keyboard.press("f")
    assert page.evaluate(span) == [0, 3]


def test_steps_and_ends_are_followed_by_the_zoomed_lanes(page):
    for _ in range(4):
        page.keyboard.press("z")
    for key in ("End", "Home", "End", ","):
        page.keyboard.press(key)
        start, end, shown = page.evaluate(
            "[deitalk.page.span.start, deitalk.page.span.end, deitalk.page.state().shown]"
        )
        assert end - start < 1 and start - 1e-9 <= shown <= end + 1e-9


@pytest.mark.parametrize(
    "files, words", [(["a.pdf"], "a.pdf: drop a"), (["a.wav", "b.wav"], "drop one"), ([], "")]
)
def test_a_file_is_taken_and_text_falls_where_it_is_dropped(page, files, words):
    is_taken, notice = page.evaluate(
        """(files) => {
             const data = new DataTransfer(), notice = document.getElementById("notice");
             notice.textContent = "";
             files.forEach((name) => data.items.add(new File(["a"], name)));
             if (!files.length) data.setData("text/plain", "jaw");
             const event = new DragEvent("drop", { dataTransfer: data, bubbles: true, cancelable: true });
             document.getElementById("search").dispatchEvent(event);
             return [event.defaultPrevented, notice.textContent];
           }""",
        files,
    )
    page.evaluate("document.getElementById('notice').textContent = ''")
    assert is_taken is bool(files) and notice.startswith(words) and bool(notice) is bool(words)


TIMES_UNTIL_IT_GOES_BACK = """() => new Promise(done => {
  const times = [];
  const look = () => {
    times.push(deitalk.page.state().time);
    if (times.at(-1) < times.at(-2) - 0.1 || !deitalk.page.clock.playing) done(times);
    else requestAnimationFrame(look);
  };
  look(); })"""
"""Of each drawn frame."""


def test_loop_repeats_its_range(page):
    for seconds, key in ((0.5, "["), (0.8, "]")):
        page.evaluate("s => deitalk.page.seek(s)", seconds)
        page.wait_for_function(f"Math.abs(deitalk.page.state().time - {seconds}) < 0.01")
        page.keyboard.press(key)
    page.evaluate("deitalk.page.seek(0.5)")
    page.keyboard.press("Space")
    times = page.evaluate(TIMES_UNTIL_IT_GOES_BACK)
    assert min(times) > 0.45 and np.median(times) < 0.85
    assert times[-1] == pytest.approx(0.5, abs=0.05), "it begins again"


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


def test_held_space_starts_once_and_altgr_makes_brackets(page):
    for _ in range(4):
        page.keyboard.down("Space")
    page.keyboard.up("Space")
    assert is_playing(page)
    page.keyboard.press("Space")
    for seconds, key in ((1, "["), (2, "]")):
        page.evaluate(
            """([seconds, key]) => {
                 deitalk.page.seek(seconds);
                 const keys = { key, ctrlKey: true, altKey: true, modifierAltGraph: true, bubbles: true };
                 document.body.dispatchEvent(new KeyboardEvent("keydown", keys));
               }""",
            [seconds, key],
        )
    assert page.evaluate("deitalk.page.transport.range") == pytest.approx([1, 2], abs=0.02)


@pytest.mark.parametrize(
    "given",
    [
        {"values": []},
        {"values": [[0.1], [0.2]], "intensity": [1]},
        {"values": [[0.1], [0.2]], "head": [[0, 0, 0, 0, 0, 0]]},
    ],
)
def test_take_whose_tracks_have_other_lengths_is_refused(page, given):
    message = page.evaluate(
        """async (given) => {
             const curves = { names: ["CTRL_C_jaw.ty"], fps: 30, ...given };
             const files = new Map([["curves.json", new TextEncoder().encode(JSON.stringify(curves))]]);
             return deitalk.page.intake.take(files, "cut").then(() => "", (error) => error.message);
           }""",
        given,
    )
    assert message == "its tracks are not of one length" and page.inner_text("#title") == "first"


def test_end_goes_to_the_last_frame_and_stays(page):
    page.click("#loop")
    page.keyboard.press("End")
    page.wait_for_timeout(150)
    assert frame_of(page) == 90 and not is_playing(page)


def test_solo_is_undone_by_a_second_press(page):
    muted = "deitalk.page.history.edit.muted.length"
    solo = page.get_by_role("button", name="Only mouth")
    solo.click()
    assert page.evaluate(muted) > 5 and solo.get_attribute("aria-pressed") == "true"
    solo.click()
    assert page.evaluate(muted) == 0 and solo.get_attribute("aria-pressed") == "false"


def test_search_finds_controls_by_words(page):
    page.fill("#search", "left TONGUE")
    assert "no control" in page.inner_text("#found")
    page.fill("#search", "tongue tip")
    found = page.locator("#found button").all_inner_texts()
    assert found and all("tongue" in name and "tip" in name.lower() for name in found)
    page.locator("#found button").first.click()
    assert found[0].replace("CTRL_", "") in page.inner_text("#curves")


def test_status_gives_the_mean_of_the_applied_intensity_over_speech(browser, tmp_path, monkeypatch):
    needs_player()
    speech = (np.arange(90) >= 30) & (np.arange(90) < 60)
    monkeypatch.setattr(page_module, "speech_activity", lambda samples: speech * 1.0)
    source = make_source()
    render_page(source, tmp_path / "page.html")
    with opened(browser, tmp_path / "page.html") as tab:
        mean = source.curves.intensity[30:60].mean()
        assert f"(mean over speech {mean:.2f})" in tab.inner_text("#status")


def test_other_takes_have_their_faces_and_curves_and_fit_a_narrow_page(browser, page_file):
    narrow = {"width": 390, "height": 844}
    with opened(browser, page_file / "three.html", viewport=narrow, color_scheme="dark") as tab:
        curves, names = tab.inner_text("#curves"), tab.inner_text("#faces")
        for name in ("second", "third"):
            assert f"C_jaw.ty ({name})" in curves and name in names
        for scheme in ("dark", "light"):
            tab.emulate_media(color_scheme=scheme)
            assert tab.evaluate("document.documentElement.scrollWidth") <= 390
            assert tab.locator("#faces canvas").count() == 3


def test_page_is_below_its_size_limit(page_file):
    text = (page_file / "one.html").read_text()
    assert (len(text) - len(block(text, "audio-0"))) / 1e6 <= 4
