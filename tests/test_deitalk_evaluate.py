"""Evaluation: hand-made cases, and the weights we ship on human voices no training heard."""

import numpy as np
import pytest
from conftest import SHARED

from deitalk.checkpoint import embedded_models, load_model
from deitalk.evaluate import as_markdown, evaluate, loudness


def test_loudness_is_one_at_the_loudest_and_falls_40_db_to_zero():
    tone = np.sin(2 * np.pi * 200 * np.arange(32_000) / 16_000).astype(np.float32)
    tone[16_000:] *= 0.01  # 40 dB less
    level = loudness(tone, 60)
    np.testing.assert_allclose(level[5:25], 1, atol=0.02)
    np.testing.assert_allclose(level[35:55], 0, atol=0.02)


def test_report_reads_as_a_table():
    report = {
        "split": "test",
        "lpe_set": "lip (86)",
        "epe_set": "upper_face (18)",
        "groups": {"a": {"clips": 2, "jaw_r": 0.5}, "b": {"clips": 3}},
        "emotions": {"happy-sad": 1.0},
    }
    text = as_markdown(report)
    assert "| jaw_r | 0.5 | – |" in text
    assert "lip (86)" in text
    assert "- happy-sad: 1.000" in text


@pytest.fixture(scope="module")
def held_out(tmp_path_factory):
    """Recordings of test speakers, aligned, as a dataset folder."""
    pytest.importorskip("pocketsphinx", reason="alignment needs pocketsphinx")
    if not (SHARED / "data/speech").is_dir():
        pytest.skip("needs the development data in ../shared")
    from deitalk.corpus.build import build, recorded_shards, split_of
    from deitalk.corpus.recordings import recordings

    everything = recordings(SHARED / "data/speech")
    readers = [r for r in everything if r.speaker.startswith("librispeech")]
    chosen = [r for r in readers if split_of(r.speaker) == "test"][::6]
    out = tmp_path_factory.mktemp("held_out")
    build(out, recorded_shards(chosen, 0, None), workers=1)
    return out


def test_default_weights_follow_human_voices(held_out):
    if "default" not in embedded_models():
        pytest.skip("the default weights are not in this checkout")
    scores = evaluate(load_model("default"), held_out)["groups"]["librispeech"]
    assert scores["bilabials"] > 50
    assert scores["bilabial_window_auc"] >= 0.80
    assert scores["jaw_r"] >= 0.75
    assert scores["loudness_bilabial_window_auc"] < scores["bilabial_window_auc"] - 0.1
    assert scores["loudness_jaw_r"] < scores["jaw_r"]
    assert abs(scores["lag_frames"]) < 0.5
    assert scores["opening_in_silence"] <= 0.01
