"""Emotion-guided decoder against a loop over Eq. 7."""

import pytest
import torch
from torch.nn import functional as F

from deitalk.models.rig_decoder import RigDecoder

DILATIONS = (1, 2, 4, 8, 1, 2, 4, 8)


def decoder(guidance_size=4, residual=False, dropout=0.0, channels=12, **options):
    torch.manual_seed(2)
    return RigDecoder(
        in_size=10,
        style_size=3,
        guidance_size=guidance_size,
        channels=channels,
        dilations=DILATIONS,
        kernel_size=3,
        n_emotions=5,
        rest=torch.tensor([0.0, 1.0, 0.5]),
        dropout=dropout,
        residual=residual,
        **options,
    )


def inputs(frames=90, guidance_size=4):
    emotion = F.one_hot(torch.tensor([2]), 5).float()
    return torch.randn(1, frames, 10), emotion, torch.randn(1, frames, guidance_size)


@pytest.mark.parametrize("residual", [False, True])
def test_decoder_equals_equation_7_frame_by_frame(residual):
    net = decoder(residual=residual)
    speech, emotion, guidance = inputs(25)
    style = net.style.weight[:, 2]  # a one-hot picks a column
    rows = list(speech[0])
    for i, (layer, dilation) in enumerate(zip(net.layers, DILATIONS, strict=True)):
        joined = [torch.cat((row, style, e)) for row, e in zip(rows, guidance[0], strict=True)]
        weight, bias = layer.conv.weight, layer.conv.bias
        out = []
        for t in range(25):
            value = bias.clone()
            for tap, shift in enumerate((-dilation, 0, dilation)):
                if 0 <= t + shift < 25:
                    value = value + weight[:, :, tap] @ joined[t + shift]
            value = value.clamp(min=0)
            out.append((rows[t] + value) / 2**0.5 if residual and i else value)
        rows = out
    expected = torch.stack([net.output.weight @ row + net.output.bias for row in rows])
    torch.testing.assert_close(net(speech, emotion, guidance)[0], expected, atol=1e-5, rtol=1e-5)


def test_new_decoder_predicts_the_face_at_rest():
    net = decoder()
    assert net.output.bias.tolist() == [0, 1, 0.5]
    with torch.no_grad():
        net.output.weight.zero_()
    curves = net(*inputs())
    assert torch.equal(curves, torch.tensor([0.0, 1.0, 0.5]).expand(1, 90, 3))


def test_style_of_one_frame_acts_near_that_frame_only():
    net = decoder().eval()
    speech, emotion, guidance = inputs(140)
    track = emotion.unsqueeze(1).repeat(1, 140, 1)
    torch.testing.assert_close(net(speech, track, guidance), net(speech, emotion, guidance))
    track[0, 100:] = F.one_hot(torch.tensor(3), 5).float()
    moved = (net(speech, track, guidance) != net(speech, emotion, guidance)).any(dim=-1)[0]
    assert not moved[:70].any()
    assert moved[100:].any()


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"causal": True},
        {"residual": True, "n_actors": 2},
        {"actor_layers": True, "n_actors": 2},
        {"direct": True, "actor_layers": True, "n_actors": 2},
        {"direct": True, "actor_layers": "offsets", "n_actors": 2},
    ],
)
@pytest.mark.parametrize("guidance_size", [0, 4])
def test_readings_equal_the_forward_pass_of_each(options, guidance_size):
    """Three readings of one speech; clips shorter and longer than the reach of the kernels."""
    net = decoder(guidance_size=guidance_size, **options).eval()
    with torch.no_grad():
        net.output.weight.normal_()
        for weight in () if net.actor_layers is None else net.actor_layers.parameters():
            weight.normal_()
    for frames in (1, 5, 40):
        speech = torch.randn(1, frames, 10)
        guidance = torch.randn(1, frames, guidance_size) if guidance_size else None
        emotions = torch.rand(3, frames, 5 + options.get("n_actors", 0))
        found = net.readings(speech, emotions, guidance)
        given = guidance if guidance is None else guidance.expand(3, -1, -1)
        expected = net(speech.expand(3, -1, -1), emotions, given)
        torch.testing.assert_close(found, expected, atol=1e-5, rtol=1e-5)


def test_readings_of_kept_controls_are_those_of_the_kept_decoder():
    net = decoder(kept=torch.tensor([True, False, False])).eval()
    with torch.no_grad():
        for layer in (net.output, net.kept.output):
            layer.weight.normal_()
    speech, guidance = torch.randn(1, 20, 10), torch.randn(1, 20, 8)
    emotions = torch.rand(2, 20, 5)
    found = net.readings(speech, emotions, guidance)
    twice = speech.expand(2, -1, -1), emotions, guidance.expand(2, -1, -1)
    torch.testing.assert_close(found, net(*twice), atol=1e-5, rtol=1e-5)


def test_an_actor_has_a_last_layer_and_a_stranger_that_of_all():
    """The second actor's second control has the first column of the input, less 0.1, in addition."""
    net, plain = decoder(actor_layers=True, n_actors=2).eval(), decoder(n_actors=2).eval()
    plain.load_state_dict(net.state_dict(), strict=False)
    speech, _, guidance = inputs(30)
    stranger, second = torch.eye(7)[2][None], torch.eye(7)[2][None] + torch.eye(7)[6]
    with torch.no_grad():
        net.actor_layers.weight[1, 1, 0], net.actor_layers.bias[1, 1] = 1.0, -0.1
    before = plain(speech, stranger, guidance)
    torch.testing.assert_close(net(speech, stranger, guidance), before)
    torch.testing.assert_close(net(speech, stranger[:, :5], guidance), before)
    changed = plain(speech, second, guidance)
    changed[..., 1] += plain.hidden(speech, second, guidance)[..., 0] - 0.1
    torch.testing.assert_close(net(speech, second, guidance), changed)


def test_an_actor_of_many_has_an_offset():
    """Half the second actor has half of it."""
    net, plain = (decoder(actor_layers=how, n_actors=2).eval() for how in ("offsets", False))
    plain.load_state_dict(net.state_dict(), strict=False)
    speech, _, guidance = inputs(30)
    style = torch.eye(7)[2][None] + 0.5 * torch.eye(7)[6]
    with torch.no_grad():
        net.actor_layers.bias[1, 1] = -0.1
    expected = plain(speech, style, guidance)
    expected[..., 1] -= 0.05
    torch.testing.assert_close(net(speech, style, guidance), expected)


def test_a_direct_last_layer_has_the_speech_of_its_frame():
    net, plain = decoder(direct=True).eval(), decoder().eval()
    with torch.no_grad():
        plain.load_state_dict(
            {k: v[:, :12] if k == "output.weight" else v for k, v in net.state_dict().items()}
        )
    speech, emotion, guidance = inputs(30)
    expected = plain(speech, emotion, guidance) + speech @ net.output.weight[:, 12:].T
    torch.testing.assert_close(net(speech, emotion, guidance), expected)


def test_frames_of_a_stream_with_last_layers_of_actors_equal_the_whole():
    net = decoder(causal=True, direct=True, actor_layers=True, n_actors=2).eval()
    with torch.no_grad():
        net.actor_layers.weight.normal_()
    speech, _, guidance = inputs(20)
    second = (torch.eye(7)[2] + torch.eye(7)[6]).expand(1, 20, -1)
    past, parts = net.first_past(1), []
    for piece in (slice(0, 7), slice(7, 20)):
        given = speech[:, piece], second[:, piece], guidance[:, piece]
        rows, past = net.advance(*given, past)
        parts.append(rows)
    whole = net(speech, second, guidance)
    torch.testing.assert_close(torch.cat(parts, dim=1), whole, atol=1e-5, rtol=1e-5)


def changed(captured, taught=1.0, n_base=None, causal=False, kept=None):
    """A decoder whose base changes with the emotion, carried by random numbers."""
    net = decoder(
        captured=[k in captured for k in range(5)], n_base=n_base, causal=causal, kept=kept
    ).eval()
    with torch.no_grad():
        for each_decoder in (net, net.kept):
            each_decoder.output.weight.normal_()
            each_decoder.style.weight.normal_(std=2.0)
        net.change.carry.normal_()
        net.change.teach(torch.full((5, 3), taught))
    return net


def own(net, speech, emotion, guidance):
    return net.output(net.hidden(speech, emotion, guidance))


@pytest.mark.parametrize(
    ("captured", "wanted", "reference"),
    [((0,), 3, 0), ((0, 2), 1, 0), ((2, 4), 0, 2), ((1,), 4, 1)],
)
@pytest.mark.parametrize("n_base", [None, 7])
def test_an_emotion_that_captures_lack_adds_the_change_of_the_base(
    captured, wanted, reference, n_base
):
    net = changed(captured, n_base=n_base)
    speech, _, guidance = inputs(20)
    emotion, plain = (torch.eye(5)[[k]] for k in (wanted, reference))
    change = net.kept(speech, emotion, guidance) - net.kept(speech, plain, guidance)
    expected = own(net, speech, plain, guidance) + change @ net.change.carry.T
    torch.testing.assert_close(net(speech, emotion, guidance), expected)
    torch.testing.assert_close(net(speech, plain, guidance), own(net, speech, plain, guidance))


def test_a_captured_emotion_is_the_captures_where_they_teach_it():
    """The first control is taught in the second emotion, the others move as the base."""
    net = changed((0, 1))
    taught = torch.ones(5, 3)
    taught[1, 1:] = 0
    net.change.teach(taught)
    speech, _, guidance = inputs(20)
    emotion, plain = (torch.eye(5)[[k]] for k in (1, 0))
    change = net.kept(speech, emotion, guidance) - net.kept(speech, plain, guidance)
    expected = own(net, speech, plain, guidance) + change @ net.change.carry.T
    expected[..., 0] = own(net, speech, emotion, guidance)[..., 0]
    torch.testing.assert_close(net(speech, emotion, guidance), expected)


@pytest.mark.parametrize("taught", [1.0, 0.0])
@pytest.mark.parametrize("causal", [False, True])
@pytest.mark.parametrize("kept", [None, torch.tensor([True, False, False])])
def test_readings_and_streams_with_a_change_equal_whole_clips(taught, causal, kept):
    """A stream is advanced by pieces of several lengths."""
    net = changed((0, 1), taught, causal=causal, kept=kept)
    frames = 40
    speech, guidance = torch.randn(1, frames, 10), torch.randn(1, frames, 4)
    emotions = torch.rand(2, frames, 5)
    emotions[0] = torch.eye(5)[0]
    twice = speech.expand(2, -1, -1), emotions, guidance.expand(2, -1, -1)
    expected = net(*twice)
    if not causal:
        found = net.readings(speech, emotions, guidance)
    else:
        past, parts = net.first_past(2), []
        for start, stop in ((0, 1), (1, 3), (3, 20), (20, frames)):
            curves, past = net.advance(*(part[:, start:stop] for part in twice), past)
            parts.append(curves)
        found = torch.cat(parts, dim=1)
    torch.testing.assert_close(found, expected, atol=1e-5, rtol=1e-5)


def test_equal_readings_of_a_tuned_decoder_are_computed_once(monkeypatch):
    net = decoder(captured=(True, False, False, False, False)).eval()
    with torch.no_grad():
        net.change.carry.normal_()
    speech, _, guidance = inputs(30)
    emotions = F.one_hot(torch.tensor([0, 2, 0]), 5).float()[:, None].expand(-1, 30, -1)
    computed, plain = [], RigDecoder.hidden_readings

    def counted(decoder, speech, emotions, *rest):
        computed.append((decoder is net, len(emotions)))
        return plain(decoder, speech, emotions, *rest)

    with monkeypatch.context() as patch:
        patch.setattr(RigDecoder, "hidden_readings", counted)
        found = net.readings(speech, emotions, guidance)
    assert sorted(computed) == [(False, 2), (True, 1)]
    assert (found[1] - found[0]).abs().max() > 0.01
    for curves, emotion in zip(found, emotions, strict=True):
        torch.testing.assert_close(curves, net(speech, emotion[None], guidance)[0])
