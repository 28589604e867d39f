"""Numbers of the rule `pose_size`: run it by ``python -m`` and this module's name, and a table.

For each trained emotion, the mean size of a model's pose over speech divided by the mean intensity
that it predicts there, over every twelfth recording of the training actors read as that emotion.
"""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from deitalk.acting import Acting
from deitalk.config.rules import PoseSize
from deitalk.models.checkpoint import require_model
from deitalk.models.curve_model import DEITalk
from deitalk.pipeline.curves import prepare
from deitalk.postprocess.control_groups import ControlGroups
from deitalk.research.evaluation.acted import ACTORS, read_strength_clips

EVERY = 12


def pose_size(model: DEITalk, sounds: Sequence[Path], emotion: str) -> float:
    """Size of the pose of an emotion at intensity 1."""
    posing = ControlGroups(model.controls).posing
    sizes, intensities = [], []
    for sound in sounds:
        prepared = prepare(sound, Acting.of(emotion=emotion), lambda: model)
        neutral, emotional, tracks = prepared.read().first(len(prepared.weights))
        speaking = prepared.speech.activity > 0
        assert tracks.strength is not None
        change = np.abs(emotional - neutral)[speaking][:, posing].sum(axis=1)
        sizes.append(float(change.mean()))
        intensities.append(float(tracks.strength[speaking].mean()))
    return float(np.mean(sizes) / np.mean(intensities))


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command of the module's docstring."""
    parser = argparse.ArgumentParser(prog="python -m deitalk.research.training.pose_size")
    parser.add_argument("actors", type=Path, help="table of actors")
    parser.add_argument("--model", default="default")
    given = parser.parse_args(arguments)
    clips = [clip for clip in read_strength_clips(given.actors, ACTORS) if clip.split == "train"]
    sounds, model = [clip.path for clip in clips[::EVERY]], require_model(given.model, DEITalk)
    for emotion in PoseSize.model_fields:
        sys.stdout.write(f"{emotion}: {pose_size(model, sounds, emotion):.2f}\n")


if __name__ == "__main__":
    main()
