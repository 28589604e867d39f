"""Scores of recordings in noise."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from deitalk.audio.load import load_audio
from deitalk.audio.noise import SNRS_DB, mix
from deitalk.data.clips import Clip
from deitalk.evaluation.lip_closures import closure_scores, summarise_closures
from deitalk.evaluation.opening import JAW
from deitalk.evaluation.validation import lips_together, load_example
from deitalk.metrics import correlation
from deitalk.models.curve_model import DEITalk
from deitalk.pipeline.curves import animate
from rig.arrays import Float32


def noise_report(
    model: DEITalk,
    clips: Sequence[Clip],
    noises: Sequence[Float32],
    progress: Callable[[], None] = lambda: None,
) -> dict[str, dict[str, float]]:
    """Bilabials and jaw, clean and in noise; keys are ``clean`` and decibels."""
    steps: tuple[float | None, ...] = (None, *SNRS_DB)
    examples = [(load_audio(clip.audio), load_example(clip, model.controls)) for clip in clips]
    report = {}
    for snr in steps:
        scores, jaws = [], []
        for i, (recording, example) in enumerate(examples):
            mixture = recording
            if snr is not None:
                noisy = mix(recording.waveform, noises[i % len(noises)], snr)
                mixture = replace(recording, waveform=noisy)
            take = animate(mixture, example.emotion, model=model, life="off")
            curves = take.curves.values[: len(example.curves)]
            scores.append(closure_scores(lips_together(curves, model.controls), example.phones))
            place = model.controls.index(JAW)
            jaws.append(correlation(example.curves[: len(curves), place], curves[:, place]))
            progress()
        found = summarise_closures(scores)
        report["clean" if snr is None else f"{snr:g} dB"] = {
            "bilabial_window_auc": found.window_auc,
            "bilabial_hits_at_5_percent": found.hit_rate,
            "jaw_r": float(np.nanmean(jaws)) if np.isfinite(jaws).any() else float("nan"),
        }
    return report
