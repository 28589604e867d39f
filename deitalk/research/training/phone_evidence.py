"""Fit of `deitalk.pipeline.words.evidence`; ``python -m deitalk.research.training.phone_evidence``.

Labels are the phone times of a dataset folder's training speakers: of speech engines, and of
recordings aligned with their transcripts (`deitalk.research.corpus.alignment`). Multinomial
logistic regression on the features of `default`, by Adam with decoupled decay. The command prints
the share of rows of the validation speakers whose phone, and whose class of lips, is the most
probable; with ``--embedded`` it fits nothing and scores the map of the package. Letters: N rows, D
features, P phones.
"""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from safetensors.numpy import save_file
from torch.nn import functional as F

from deitalk.audio.load import load_audio
from deitalk.data.clips import Clip, read_clips, read_phones
from deitalk.errors import DataError
from deitalk.models.checkpoint import require_model
from deitalk.models.curve_model import DEITalk
from deitalk.pipeline.speech import Speech
from deitalk.pipeline.words.evidence import (
    CONTEXT,
    MODEL,
    RATE,
    WEIGHTS,
    PhoneEvidence,
    phone_evidence,
    phone_features,
)
from deitalk.postprocess.phones import BILABIALS, LABIODENTALS, PHONES, Phones
from deitalk.research.arguments import new_file, one_line_errors
from deitalk.research.evaluation.report import identified, shipped, write_json
from rig.arrays import Float32, Int64
from rig.files import atomic_write

EPOCHS, BATCH, RATE_OF_LEARNING, DECAY, SMOOTHING = 4, 1024, 2e-3, 1e-3, 0.02
LEAST_PRIOR = 1e-4


class Rows(NamedTuple):
    """Features and phones of recordings, one after the other."""

    features: Float32
    """[shape=(N, D)], float16."""
    phones: Int64
    """[shape=(N,)]."""


def read_rows(folder: Path, split: str, every: int = 4) -> Rows:
    """Measure all speech of engines, and every `every`-th other recording of a split.

    Raises
    ------
    DataError
        If no clip has phone times.
    """
    network = require_model(MODEL, DEITalk)
    clips = list({clip.audio: clip for clip in read_clips(folder, split) if clip.phones}.values())
    recorded = [clip for clip in clips if clip.source == "recording"]
    chosen = recorded[::every] + [clip for clip in clips if clip.source != "recording"]
    if not chosen:
        raise DataError(f"{folder}: no clip of the split {split!r} has phone times")
    parts = [_measured(network, clip) for clip in chosen]
    features, phones = zip(*parts, strict=True)
    return Rows(np.concatenate(features), np.concatenate(phones))


def _measured(network: DEITalk, clip: Clip) -> Rows:
    assert clip.phones is not None
    speech = Speech.of(load_audio(clip.audio).waveform)
    features = phone_features(network, speech)
    return Rows(features.astype(np.float16), labels(read_phones(clip.phones), len(features)))


def labels(phones: Phones, n_rows: int) -> Int64:
    """Phone of each row [shape=(N,)]; the last one lasts to the end."""
    ends = np.array([end for _, end, _ in phones])
    names = np.array([PHONES.index(name) for *_, name in phones])
    places = np.searchsorted(ends, np.arange(n_rows) / RATE, side="right")
    return np.asarray(names[np.minimum(places, len(names) - 1)], np.int64)


def fit(rows: Rows, seed: int = 0) -> PhoneEvidence:
    """Fit the map to features and phones."""
    sample = rows.features[:: max(1, len(rows.features) // 100_000)].astype(np.float32)
    mean, spread = sample.mean(axis=0), sample.std(axis=0) + 1e-3
    scaled = torch.tensor(((rows.features - mean) / spread).astype(np.float16))
    targets, last = torch.tensor(rows.phones), len(scaled) - 1
    generator = torch.Generator().manual_seed(seed)
    layer = torch.nn.Linear(len(CONTEXT) * scaled.shape[1], len(PHONES))
    torch.nn.init.zeros_(layer.weight)
    torch.nn.init.zeros_(layer.bias)
    optimiser = torch.optim.AdamW(layer.parameters(), RATE_OF_LEARNING, weight_decay=DECAY)
    steps = max(1, EPOCHS * len(scaled) // BATCH)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, steps)
    offsets = torch.tensor(CONTEXT)
    for _ in range(steps):
        places = torch.randint(len(scaled), (BATCH,), generator=generator)
        beside = (places[:, None] + offsets).clamp(0, last)
        score = layer(scaled[beside].flatten(1).float())
        loss = F.cross_entropy(score, targets[places], label_smoothing=SMOOTHING)
        optimiser.zero_grad()
        loss.backward()  # type: ignore[no-untyped-call]
        optimiser.step()
        schedule.step()
    counts = np.bincount(rows.phones, minlength=len(PHONES))
    return PhoneEvidence(
        {
            "mean": mean,
            "spread": spread,
            "weight": layer.weight.detach().numpy(),
            "bias": layer.bias.detach().numpy(),
            "prior": np.maximum(counts / counts.sum(), LEAST_PRIOR),
        }
    )


def score(found: PhoneEvidence, rows: Rows) -> dict[str, float]:
    """Share of rows whose phone, and whose class of lips (closed, bitten, other), comes first."""
    best = found.log_probabilities(rows.features.astype(np.float32)).argmax(axis=1)
    lips = np.array([(p in BILABIALS) + 2 * (p in LABIODENTALS) for p in PHONES])
    return {
        "phone": float((best == rows.phones).mean()),
        "lips": float((lips[best] == lips[rows.phones]).mean()),
        "closed where p, b, m": float((lips[best] == 1)[lips[rows.phones] == 1].mean()),
        "rows": len(best),
    }


@one_line_errors
def main(arguments: Sequence[str] | None = None) -> None:
    """Fit, print the scores of the validation speakers, and write the map in half precision."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--data", type=Path, required=True, help="dataset folder with phones")
    parser.add_argument("--every", type=int, default=4, help="of the recordings of people")
    parser.add_argument("--embedded", action="store_true", help="score the map of the package")
    parser.add_argument("--json", type=new_file, help="also write the scores to this file")
    parser.add_argument("-o", "--out", type=new_file, help=".safetensors to write")
    options = parser.parse_args(arguments)
    if options.embedded:
        found = phone_evidence()
    else:
        found = fit(read_rows(options.data, "train", options.every))
    scores = score(found, read_rows(options.data, "validation", options.every))
    for name, value in scores.items():
        sys.stdout.write(f"{name}: {value:.3g}\n")
    known = shipped("deitalk.pipeline.words", WEIGHTS) if options.embedded else {}
    write_json(options.json, {**identified(MODEL), **known, "validation": scores})
    if options.out is not None:
        with atomic_write(options.out) as beside:
            save_file({k: v.astype(np.float16) for k, v in found.weights.items()}, beside)


if __name__ == "__main__":
    sys.exit(main())
