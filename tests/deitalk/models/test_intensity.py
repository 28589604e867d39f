"""Dynamic emotional intensity against Eq. 4-6, by hand."""

import pytest
import torch

from deitalk.models.intensity import (
    DynamicIntensity,
    MotionEncoder,
    local_maximum,
)


def module(saliency_frames=None, in_size=6, emotion_size=4):
    torch.manual_seed(1)
    return DynamicIntensity(in_size, emotion_size, 8, 5, saliency_frames).eval()


def identity(saliency_frames=None):
    """S_emo is the speech itself."""
    plain = module(saliency_frames, 2, 2)
    with torch.no_grad():
        plain.project.weight.copy_(torch.eye(2))
        plain.project.bias.zero_()
    return plain


def test_equations_4_to_6_by_hand():
    # s_max = (4, 3); cosines with (4, 0), (0, 3), (-4, -3): 4/5, 3/5, -1
    output = identity()(torch.tensor([[[4.0, 0.0], [0.0, 3.0], [-4.0, -3.0]]]))
    assert output.embedding.tolist() == [[4, 3]]
    torch.testing.assert_close(output.saliency, torch.tensor([[0.8, 0.6, -1.0]]))
    expected = torch.tensor([[[3.2, 0.0], [0.0, 1.8], [4.0, 3.0]]])
    torch.testing.assert_close(output.guidance, expected)


def test_local_maximum_equals_a_loop():
    features = torch.randn(1, 20, 3)
    pooled = local_maximum(features, 7)
    for t in range(20):
        expected = features[0, max(t - 3, 0) : t + 4].amax(dim=0)
        assert torch.equal(pooled[0, t], expected)


def test_window_over_the_whole_clip_is_the_whole_clip():
    speech = torch.randn(2, 30, 6)
    whole, local = module(None)(speech), module(61)(speech)
    torch.testing.assert_close(local.saliency, whole.saliency)
    torch.testing.assert_close(local.guidance, whole.guidance)
    assert not torch.allclose(module(9)(speech).saliency, whole.saliency, atol=1e-3)


def test_piece_with_the_embedding_of_its_clip_equals_the_piece_of_the_clip():
    speech = torch.randn(1, 30, 6)
    whole = module()(speech)
    piece = module()(speech[:, 10:15], whole.embedding)
    torch.testing.assert_close(piece.saliency, whole.saliency[:, 10:15])


@pytest.mark.parametrize("slope", [-3.0, 0.0, 3.0])
def test_strength_rises_with_saliency_for_any_slope(slope):
    plain = identity()
    with torch.no_grad():
        plain.slope.fill_(slope)
    turn = torch.linspace(0, 3.1, 40)
    speech = torch.stack((turn.cos(), turn.sin()), dim=-1).unsqueeze(0)
    output = plain(speech, torch.tensor([[1.0, 0.0]]))
    assert (output.strength.diff() < 0).all()
    assert output.strength.min() >= 0
    assert output.strength.max() <= 1


def test_motion_encoder_spans_fifteen_frames_on_either_side():
    torch.manual_seed(0)
    encoder = MotionEncoder(5, (8, 8, 8, 8), 3, 4)
    for layer in encoder.layers:
        layer.conv.weight.data.abs_()
    curves = torch.rand(1, 60, 5)
    changed = curves.clone()
    changed[0, 30] += 10
    out = encoder(curves)
    assert out.shape == (1, 60, 4)
    moved = (encoder(changed) != out).any(dim=-1)[0].nonzero().flatten()
    assert (int(moved[0]), int(moved[-1])) == (15, 45)


def test_kept_projection_gives_the_guidance_that_it_gave_alone():
    torch.manual_seed(2)
    before, speech = module(5), torch.randn(2, 20, 6)
    tuned = DynamicIntensity(6, 4, 8, 5, 5, kept=True).eval()
    with torch.no_grad():
        tuned.kept.load_state_dict(before.project.state_dict())
    guidance = tuned(speech).guidance
    assert guidance.shape == (2, 20, 8)
    torch.testing.assert_close(guidance[..., 4:], before(speech).guidance)
    assert not torch.allclose(guidance[..., :4], guidance[..., 4:])


def test_effort_is_a_linear_readout_and_changes_nothing_else():
    torch.manual_seed(0)
    with_it = DynamicIntensity(6, 4, 3, 5, saliency_frames=5, effort=True).eval()
    without = DynamicIntensity(6, 4, 3, 5, saliency_frames=5).eval()
    without.load_state_dict({k: v for k, v in with_it.state_dict().items() if "effort" not in k})
    speech = torch.randn(2, 9, 6)
    found, plain = with_it(speech), without(speech)
    wanted = speech @ with_it.effort.weight[0] + with_it.effort.bias
    torch.testing.assert_close(found.effort, wanted)
    assert plain.effort is None
    for name in ("features", "saliency", "guidance", "strength"):
        torch.testing.assert_close(getattr(found, name), getattr(plain, name))
