"""Readout of the lips: what it changes of curves, in pieces, and as a stream."""

import numpy as np
import pytest
import torch
from safetensors.torch import load_file

from deitalk.config.curves import Config
from deitalk.live.animator import LiveAnimator
from deitalk.models.causal_model import TorchNetwork
from deitalk.models.checkpoint import load_model, save_model
from deitalk.models.curve_model import DECODE_FRAMES
from deitalk.models.joined import JoinedClips
from deitalk.models.lip_readout import (
    CHANNELS,
    MEASURES,
    MOST,
    OPEN,
    OUT,
    POWER,
    RAISED,
    TAPS,
    UNBITTEN,
    VOICE,
    LipReadout,
)
from deitalk.research.evaluation.benchmark_curves import speechlike
from deitalk.training.tuning.recipe import read_recipe
from tests.deitalk.models.test_onnx import CAUSAL, WHISPER, of_frontend, weights

NAMES = (
    "CTRL_C_jaw.ty", "CTRL_C_lipsTogetherUL", "CTRL_C_lipBiteD", "stretch", "tongue_inOut",
    "tongue_tipMove.ty", "mouth_funnelU", "mouth_purseD",
)  # fmt: skip
JAW, TOGETHER, BITE, STRETCH, OUT_OF, TIP, FUNNEL, PURSE = range(8)


def read_of(**channels):
    """A readout's row of channels in speech, whose measures are as the curves have them."""
    values = [({"voice": 1.0} | channels).get(name, 0.0) for name in CHANNELS]
    return torch.tensor([[*values, *[0.0] * len(MEASURES)]])


def filled(readout, std=0.1):
    """Random weights that matter."""
    torch.manual_seed(5)
    with torch.no_grad():
        for weight in readout.parameters():
            weight.normal_(std=std)
    return readout.eval()


@pytest.fixture
def readout():
    return filled(LipReadout(6, NAMES))


@torch.no_grad()
def test_a_contact_is_its_probability_times_a_power_of_the_curve(readout):
    readout.moves.weight.zero_()
    curves = torch.tensor([[[0.3, 0.81, 0.25, -0.2, 0.1, 0, 0, 0]]])
    found = readout.correct(curves, read_of(together=0.49, bite=1.0))[0, 0]
    together = 0.81**POWER * 0.49
    np.testing.assert_allclose(found[:5], [0.3, together, 0.25**POWER, -0.2, 0.1], atol=1e-6)


@pytest.mark.parametrize("denied", ["decoder", "readout"])
@torch.no_grad()
def test_what_one_of_both_denies_is_no_contact(readout, denied):
    readout.moves.weight.zero_()
    decoder, likely = (0.0, 0.9) if denied == "decoder" else (0.9, 0.0)
    curves = torch.full((1, 1, len(NAMES)), decoder)
    found = readout.correct(curves, read_of(together=likely, bite=likely))
    assert found[0, 0, [TOGETHER, BITE]].tolist() == [0, 0]


CASES = {
    "the tongue is out and bites nothing": ({"out": 1, "bite": 1}, OUT_OF, -0.42, -0.3),
    "a raised tip is not between the teeth": ({"out": 1, "tip": RAISED[1]}, OUT_OF, 0.0, -0.3),
    "half raised it is half out": ({"out": 1, "tip": sum(RAISED) / 2}, OUT_OF, -0.21, -0.3),
    "the decoder's tongue stays in": ({}, OUT_OF, 0.0, -0.5),
    "a tongue that is drawn in stays so": ({}, OUT_OF, 0.5, 0.5),
    "a little of the tongue does not show": ({"out": OUT[0]}, OUT_OF, 0.0, -0.1),
    "the lip leaves the teeth before": ({"out": sum(UNBITTEN) / 2, "bite": 1}, BITE, 0.45, 0.81),
    "and is away from them": ({"out": UNBITTEN[1], "bite": 1}, BITE, 0.0, 0.81),
    "the tip is that of the phones": ({"tip": 0.8}, TIP, 0.6, 0.1),
    "the funnel too": ({"funnel": 0.4}, FUNNEL, 0.3, 0.9),
    "pursed lips have some funnel": ({"purse": 1}, FUNNEL, 0.75 * 0.35, 0.9),
    "the purse is half the decoder's": ({"purse": 1}, PURSE, 0.45 + 0.5 * 0.4, 0.4),
}


@pytest.mark.parametrize("case", CASES.values(), ids=CASES)
@torch.no_grad()
def test_phones_move_the_controls_of_their_channels(readout, case):
    readout.moves.weight.zero_()
    channels, control, expected, before = case
    curves = torch.full((1, 1, len(NAMES)), 0.5)
    curves[..., control] = before
    found = readout.correct(curves, read_of(**channels))[0, 0]
    assert found[control] == pytest.approx(expected, abs=1e-6)
    assert found[JAW] == 0.5
    if channels.get("out") == 1:
        assert found[BITE] == 0


@pytest.mark.parametrize("channels", [{}, {"purse": 1.0}, {"funnel": 1.0}, {"purse": 0.5}])
@torch.no_grad()
def test_what_rounding_does_to_the_width_is_counted(readout, channels):
    """On a face whose width is linear in its controls, with one that nothing else moves."""
    width = MEASURES.index("width")
    for weight in (readout.shown.weight, readout.shown.bias, readout.moves.weight):
        weight.zero_()
    readout.shown.weight[width] = torch.tensor([0, 0, 0, 1.0, 0, 0, -0.4, -0.7])
    readout.moves.weight[STRETCH, width] = 1
    curves = torch.full((1, 1, len(NAMES)), 0.5)
    row = read_of(**channels)
    row[..., len(CHANNELS) + width] = 0.2
    found = readout.correct(curves, row)
    wanted = 0.2 + readout.kept[width] * readout.shown(curves)[..., width]
    np.testing.assert_allclose(readout.shown(found)[..., width], wanted, atol=1e-5)


@pytest.mark.parametrize(("voice", "moves"), [(VOICE[0], 0), (np.mean(VOICE), 0.5), (VOICE[1], 1)])
@torch.no_grad()
def test_speech_moves_the_mouth_by_the_voice_and_an_emotion_moves_what_it_moves(
    readout, voice, moves
):
    """Contacts stay as they are: a closure begins before the voice is heard."""
    neutral = torch.full((1, len(NAMES)), 0.5)
    curves = torch.stack((neutral, neutral + 0.2))
    whole = readout.correct(curves, read_of(together=1, bite=1, tip=0.4))
    found = readout.correct(curves, read_of(together=1, bite=1, tip=0.4, voice=float(voice)))
    spoken = [JAW, OUT_OF, TIP, FUNNEL, PURSE]
    np.testing.assert_allclose(found[0, 0, spoken], moves * whole[0, 0, spoken], atol=1e-6)
    np.testing.assert_allclose(found[1, 0, spoken], found[0, 0, spoken] + 0.2, atol=1e-6)
    contacts = [TOGETHER, BITE]
    np.testing.assert_allclose(found[:, 0, contacts], whole[:, 0, contacts], atol=1e-6)
    np.testing.assert_allclose(found[:, 0, STRETCH], whole[:, 0, STRETCH], atol=1e-6)


@pytest.mark.parametrize("measure", MEASURES)
@pytest.mark.parametrize("share", [0.0, 1.0])
@torch.no_grad()
def test_measures_stay_the_decoders_where_it_shuts_the_mouth(readout, measure, share):
    place = MEASURES.index(measure)
    readout.shown.weight.zero_()
    readout.shown.bias.zero_()
    readout.moves.weight.zero_()
    readout.moves.weight[STRETCH, place] = 1
    for jaw in (0.0, OPEN[0][place]) if share == 0 else (OPEN[1][place], 0.5):
        curves = torch.zeros(1, 1, len(NAMES))
        curves[..., JAW] = jaw
        row = read_of()
        row[..., len(CHANNELS) + place] = 0.1
        assert readout.correct(curves, row)[0, 0, STRETCH] == pytest.approx(0.1 * share, abs=1e-6)


@pytest.mark.parametrize("measure", MEASURES)
@torch.no_grad()
def test_no_correction_is_larger_than_that_of_usual_speech(readout, measure):
    place = MEASURES.index(measure)
    for part in (readout.shown.weight, readout.shown.bias, readout.moves.weight):
        part.zero_()
    readout.moves.weight[STRETCH, place] = 1
    row = read_of()
    row[..., len(CHANNELS) + place] = -5.0
    found = readout.correct(torch.full((1, 1, len(NAMES)), 0.5), row)
    assert found[0, 0, STRETCH] == pytest.approx(0.5 - MOST[place], abs=1e-6)


@torch.no_grad()
def test_what_an_emotion_adds_stays(readout):
    """The change is that of the neutral reading, except in contacts."""
    readings = torch.rand(2, 30, len(NAMES))
    read = torch.rand(30, len(CHANNELS) + len(MEASURES))
    found = readout.correct(readings, read)
    kept = [JAW, STRETCH, OUT_OF, TIP, FUNNEL, PURSE]
    before, after = (part[1, :, kept] - part[0, :, kept] for part in (readings, found))
    np.testing.assert_allclose(after, before, atol=1e-6)
    assert (found[0] - readings[0]).abs().max() > 0.05


@pytest.mark.parametrize("causal", [False, True])
@torch.no_grad()
def test_a_row_depends_on_the_frames_of_its_taps(causal):
    readout, speech = filled(LipReadout(6, NAMES, causal=causal)), torch.randn(1, 40, 6)
    changed = speech.clone()
    changed[:, 20] += 1
    moved = (readout(changed) - readout(speech))[0].abs().amax(dim=1) > 1e-6
    first, last = (20, 20 + TAPS - 1) if causal else (20 - TAPS // 2, 20 + TAPS // 2)
    assert moved.nonzero().flatten().tolist() == list(range(first, last + 1))


@torch.no_grad()
def test_a_stream_in_blocks_equals_the_whole(readout):
    causal = filled(LipReadout(6, NAMES, causal=True))
    speech, past, parts = torch.randn(2, 50, 6), causal.first_past(2), []
    for block in speech.split([1, 7, 30, 12], dim=1):
        parts.append(causal(block, past))
        past = causal.next_past(past, block)
    np.testing.assert_allclose(torch.cat(parts, dim=1), causal(speech), atol=1e-5)


@pytest.mark.parametrize("causal", [False, True])
@torch.no_grad()
def test_a_recording_is_read_as_if_silence_were_around_it(causal):
    readout = filled(LipReadout(6, NAMES, causal=causal))
    readout.silence.normal_()
    speech, quiet = torch.randn(1, 12, 6), readout.silence.expand(1, TAPS, 6)
    inner = readout(torch.cat((quiet, speech, quiet), dim=1))[:, TAPS:-TAPS]
    np.testing.assert_allclose(readout(speech), inner, atol=1e-5)
    stream = readout(speech, readout.first_past(1)) if causal else inner
    np.testing.assert_allclose(stream, inner, atol=1e-5)
    clips = JoinedClips([5, 7], torch.device("cpu"))
    parts = torch.cat([readout(part) for part in speech.split([5, 7], dim=1)], dim=1)
    np.testing.assert_allclose(readout(speech, None, clips), parts, atol=1e-5)


def model_of(frontend, **settings):
    model = of_frontend(frontend, lips=True, **settings)
    filled(model.lips, 0.05)
    return model


@torch.no_grad()
def test_long_clips_are_read_in_pieces_as_at_once():
    model = model_of(WHISPER)
    speech = torch.randn(DECODE_FRAMES + 100, 32)
    whole = model.lips(speech[None])[0]
    np.testing.assert_allclose(model._read_lips(speech), whole, atol=1e-4)


def test_curves_of_a_recording_are_corrected_and_contacts_lie_between_0_and_1():
    model = model_of(WHISPER)
    sound, rows = speechlike(2.0), weights(60, happy=1.0)
    found = model.read(sound, rows)
    readout, model.lips = model.lips, None
    plain = model.read(sound, rows)
    places = readout.places.sum(dim=0).numpy() > 0
    assert places.sum() == 6
    assert (found.neutral[:, places] >= 0).all() and (found.emotional[:, places] <= 1).all()
    assert np.abs(found.neutral - plain.neutral)[:, ~places].max() > 1e-3


def test_a_stream_gives_the_curves_of_the_whole_recording():
    model = model_of(CAUSAL, positions=False)
    sound, rows = speechlike(2.0), weights(60, happy=1.0)
    whole = model.read(sound, rows)
    network = TorchNetwork(model)
    assert len(network.first_state(1)[-1][0]) == TAPS - 1
    pieces = []
    for size in (160, 3001):
        animator = LiveAnimator(network, life="off", rules=False)
        blocks = [animator.feed(sound[k : k + size]) for k in range(0, len(sound), size)]
        pieces.append(np.concatenate([*blocks, animator.finish()]))
    np.testing.assert_allclose(pieces[0], pieces[1], atol=1e-4)
    low, high = model.controls.minimum, model.controls.maximum
    np.testing.assert_allclose(pieces[0], np.clip(whole.neutral, low, high), atol=1e-3)


def test_the_readout_is_a_file_of_its_own(tmp_path):
    model = model_of(WHISPER)
    config = Config(model=model.config)
    save_model(tmp_path / "m", model, config, {})
    stored = load_file(tmp_path / "m" / "lips.safetensors")
    assert set(stored) == {f"lips.{name}" for name in model.lips.state_dict()}
    read = load_model(tmp_path / "m").lips
    assert torch.equal(read.listen.weight, model.lips.listen.weight)


def test_a_model_that_is_tuned_to_an_actor_is_not_corrected(tmp_path):
    model = model_of(WHISPER)
    save_model(tmp_path / "m", model, Config(model=model.config), {})
    assert not read_recipe(None, base=str(tmp_path / "m")).model.lips
