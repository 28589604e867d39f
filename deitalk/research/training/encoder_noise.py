r"""Tuning of the first layers of a Whisper encoder to noise, without labels.

The encoder is given speech in noise and rooms and learns to give the states that the published
weights give for the same speech without them (feature distillation, as `train.teacher` does for a
whole model): what is trained on the clean states hears the noisy ones better::

    python -m deitalk.research.training.encoder_noise SPEECH --checkpoint WHISPER --noise NOISE \
        --rooms ROOMS -o encoder.safetensors

SPEECH holds recordings as for ``deitalk corpus build``; only training speakers are used. Not in the
papers.

B batch, S samples, K features, D width.
"""

import argparse
import sys
import time
from collections.abc import Iterator, Sequence
from functools import lru_cache
from pathlib import Path

import numpy as np
import torch
from safetensors.torch import save_file
from torch import Tensor

from deitalk.audio.frames import SAMPLE_RATE
from deitalk.audio.load import load_audio
from deitalk.audio.voice_activity import normalise_level
from deitalk.config import WhisperConfig
from deitalk.data.augment_waveform import Surroundings, augment, change_speed, speed_factor
from deitalk.errors import DeitalkError
from deitalk.frontends.strided import LARGEST
from deitalk.frontends.whisper import WhisperEncoder, WhisperFrontend
from deitalk.research.corpus.performance import split_of
from deitalk.research.corpus.recordings import recordings
from rig.arrays import Float32
from rig.files import atomic_write, new_file

WINDOW_SECONDS = 4.0
BATCH = 8
CLEAN_SHARE = 0.2
"""Windows that stay clean, so that their states do."""
RATE = 1.5e-4
WARM_STEPS = 50
MOTION_WEIGHT = 2.0
"""Of the distance between neighbouring features: speaker and room change slowly, lips fast."""
AVERAGE = 0.995
"""Of the moving mean of the weights, which is kept."""
STATISTICS_BATCHES = 12
REPORT_STEPS = 50


class EncoderNoise:
    """The published encoder, its student, and the scale of each state.

    Parameters
    ----------
    config : WhisperConfig
    sounds : sequence of Path
        Recordings of the training speakers.
    surroundings : Surroundings
        Noise and rooms.
    seed : int
    """

    def __init__(
        self, config: WhisperConfig, sounds: Sequence[Path], surroundings: Surroundings, seed: int
    ) -> None:
        self.config, self.sounds, self.surroundings = config, sounds, surroundings
        self.seed = seed
        teacher = WhisperFrontend.build(config).eval()
        self.mel, self.teacher = teacher.mel, teacher.encoder
        self.student = WhisperFrontend.build(config).encoder.requires_grad_(True)
        self.student.embed_positions.requires_grad_(False)
        batches = [
            self.states(self.teacher, self.batch(-1 - k)[0]) for k in range(STATISTICS_BATCHES)
        ]
        every = torch.cat([states.flatten(0, 1) for states in batches])  # (N, L, D)
        self.mean, self.scale = every.mean(dim=0), every.std(dim=0) + 1e-5

    def batch(self, number: int) -> tuple[Tensor, Tensor]:
        """Windows (B, S) of a number: clean, and augmented."""
        rng = np.random.default_rng((self.seed, number + 1_000_000))
        pairs = [self._window(rng) for _ in range(BATCH)]
        clean, noisy = (torch.from_numpy(np.stack(part)) for part in zip(*pairs, strict=True))
        return clean, noisy

    def _window(self, rng: np.random.Generator) -> tuple[Float32, Float32]:
        length = int(WINDOW_SECONDS * SAMPLE_RATE)
        sound = _sound(self.sounds[int(rng.integers(len(self.sounds)))])
        start = int(rng.integers(max(len(sound) - length, 0) + 1))
        speed = speed_factor(rng)
        piece = sound[start : start + int(length * speed) + 8].astype(np.float32)
        piece = change_speed(piece, speed)[:length]
        clean = np.pad(piece, (0, length - len(piece))).astype(np.float32)
        if rng.random() < CLEAN_SHARE:
            return clean, clean
        voices = [_sound(self.sounds[int(k)]) for k in rng.integers(len(self.sounds), size=4)]
        return clean, augment(clean, rng, self.surroundings, voices if rng.random() < 0.3 else ())

    def states(self, encoder: WhisperEncoder, sound: Tensor) -> Tensor:
        """States of the layers [shape=(B, K, L, D)] of windows (B, S)."""
        given = encoder(self.mel(sound))
        return torch.stack([given[place] for place in self.config.layers], dim=2)

    def scaled(self, states: Tensor) -> Tensor:
        """States with the mean and deviation of speech, limited as in the frontend."""
        return ((states - self.mean) / self.scale).clamp(-LARGEST, LARGEST)

    def loss(self, number: int) -> Tensor:
        """Squared distance of the noisy states and the clean ones, and of their motion."""
        clean, noisy = self.batch(number)
        with torch.no_grad():
            wanted = self.scaled(self.states(self.teacher, clean))
        given = self.scaled(self.states(self.student, noisy))
        moved = (given.diff(dim=1) - wanted.diff(dim=1)).square().mean()
        return (given - wanted).square().mean() + MOTION_WEIGHT * moved


@lru_cache(maxsize=3000)
def _sound(path: Path) -> Float32:
    """A recording at the normal level, in half precision to save memory."""
    return normalise_level(load_audio(path).waveform).astype(np.float16)


def train(task: EncoderNoise, out: Path, steps: int) -> Iterator[tuple[int, float]]:
    """Train and write the mean weights every 50 steps; gives step and mean loss.

    Parameters
    ----------
    task : EncoderNoise
        What is trained.
    out : Path
        Weights: ``model.safetensors`` of an encoder alone.
    steps : int
        The rate rises over `WARM_STEPS` and falls as a cosine to 0.
    """
    weights = [p for p in task.student.parameters() if p.requires_grad]
    optimizer = torch.optim.AdamW(weights, lr=RATE, weight_decay=0.01)
    average = {name: value.clone() for name, value in task.student.state_dict().items()}
    losses: list[float] = []
    for step in range(steps):
        rate = min((step + 1) / WARM_STEPS, 1) * (1 + np.cos(np.pi * step / steps)) / 2
        optimizer.param_groups[0]["lr"] = RATE * rate
        loss = task.loss(step)
        optimizer.zero_grad()
        loss.backward()  # type: ignore[no-untyped-call]
        torch.nn.utils.clip_grad_norm_(weights, 1.0)
        optimizer.step()
        share = min(AVERAGE, (step + 1) / (step + 10))
        for name, value in task.student.state_dict().items():
            average[name].lerp_(value, 1 - share)
        losses.append(loss.item())
        if (step + 1) % REPORT_STEPS == 0 or step + 1 == steps:
            with atomic_write(out) as path:
                save_file({name: value.half() for name, value in average.items()}, path)
            yield step + 1, float(np.mean(losses[-REPORT_STEPS:]))


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command of the module's docstring; an error is one line on stderr."""
    parser = argparse.ArgumentParser(prog="python -m deitalk.research.training.encoder_noise")
    parser.add_argument("speech", type=Path, help="folder of recordings")
    parser.add_argument("--checkpoint", required=True, help="Whisper's weights: hub name or folder")
    parser.add_argument("--noise", help="folder of recordings of noise")
    parser.add_argument("--rooms", help="folder of impulse responses")
    parser.add_argument("--layers", type=int, nargs="+", default=[2, 3])
    parser.add_argument("--steps", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument(
        "-o", "--out", type=new_file, required=True, help="weights: FILE.safetensors"
    )
    given = parser.parse_args(arguments)
    try:
        paths = [r.path for r in recordings(given.speech) if split_of(r.speaker) == "train"]
        config = WhisperConfig(checkpoint=given.checkpoint, layers=tuple(given.layers))
        task = EncoderNoise(config, paths, Surroundings.read(given.noise, given.rooms), given.seed)
        begun = time.monotonic()
        for step, loss in train(task, given.out, given.steps):
            seconds = time.monotonic() - begun
            print(f"step {step}: loss {loss:.4f}, {seconds:.0f} s", flush=True)  # noqa: T201
    except DeitalkError as error:
        sys.exit(str(error))


if __name__ == "__main__":
    main()
