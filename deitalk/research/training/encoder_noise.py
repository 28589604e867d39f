r"""Tuning of the first layers of a Whisper encoder to 30 Hz, to noise and to a voice that goes on.

The encoder is given speech in noise and rooms at the rig's rate and learns to give the states that
the published weights give for the same speech without them (feature distillation, as
`train.teacher` does for a whole model)::

    python -m deitalk.research.training.encoder_noise SPEECH --checkpoint WHISPER --noise NOISE \
        --rooms ROOMS -o encoder.safetensors

A part of every batch is read with a bounded past and look-ahead, as a stream would be, so that one
set of weights serves both.

SPEECH are folders of recordings as for ``corpus build``; only training speakers are used.
Not in the papers.

B batch, S samples, K features at 50 Hz, T rig frames, D width.
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

from deitalk.audio.frames import FRAME_RATE, SAMPLE_RATE
from deitalk.audio.load import load_audio
from deitalk.audio.voice_activity import normalise_level
from deitalk.config.frontends import WhisperConfig
from deitalk.data.augment_waveform import Surroundings, augment, change_speed, speed_factor
from deitalk.frontends.causal_whisper import LOOKAHEAD_FRAMES, PAST_FRAMES, PEAK, PERIOD
from deitalk.frontends.strided import LARGEST
from deitalk.frontends.whisper import WhisperFrontend, encoder_weights, scaled
from deitalk.research.arguments import new_file, one_line_errors
from deitalk.research.corpus.performance import split_of
from deitalk.research.corpus.recordings import recordings
from deitalk.research.training.surroundings import read_surroundings
from rig.arrays import Float32
from rig.files import atomic_write

WINDOW_FRAMES = 120
"""Rig frames of a window: 4 s."""
BATCH = 10
CLEAN_SHARE = 0.2
"""Windows that stay clean, so that their states do."""
RATE = 2e-4
WARM_STEPS = 50
CAUSAL_ROWS = 4
"""Rows of a batch that are read as a stream; the others are read whole."""
CAUSAL_GAIN_DB = 4.0
"""A running level differs from that of the recording by up to this."""
MOTION_WEIGHT = 2.0
"""Weight of the distance between neighbouring features: speaker and room change slowly, lips
fast."""
AVERAGE = 0.995
"""Factor of the moving mean of the weights, which is kept."""
STATISTICS_BATCHES = 12
REPORT_STEPS = 50


class EncoderNoise:
    """The published encoder, its student at 30 Hz, and the scale of each state.

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
        published = config.model_copy(update={"rate": 50})
        self.teacher = WhisperFrontend.build(published).eval()
        self.student = WhisperFrontend.build(config)
        self.student.encoder.requires_grad_(True)
        after = torch.arange(WINDOW_FRAMES) - torch.arange(WINDOW_FRAMES).unsqueeze(1)
        self.mask = (after <= LOOKAHEAD_FRAMES) & (after >= -PAST_FRAMES)
        batches = [self.wanted(self.batch(-1 - k)[0]) for k in range(STATISTICS_BATCHES)]
        every = torch.cat([states.flatten(0, 1) for states in batches])  # (N, L, D)
        self.mean, self.scale = every.mean(dim=0), every.std(dim=0) + 1e-5

    def batch(self, number: int) -> tuple[Tensor, Tensor]:
        """Windows (B, S) of a number: clean, and augmented."""
        rng = np.random.default_rng((self.seed, number + 1_000_000))
        pairs = [self._window(rng) for _ in range(BATCH)]
        clean, noisy = (torch.from_numpy(np.stack(part)) for part in zip(*pairs, strict=True))
        return clean, noisy

    def _window(self, rng: np.random.Generator) -> tuple[Float32, Float32]:
        length = WINDOW_FRAMES * SAMPLE_RATE // FRAME_RATE
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

    @torch.no_grad()
    def wanted(self, sound: Tensor) -> Tensor:
        """States of the published layers at rig frames [shape=(B, T, L, D)] of windows (B, S)."""
        frontend = self.teacher
        states = frontend.encoder(frontend.mel(sound, frontend.count(sound.shape[1]) * 2))
        rows = [
            frontend.rows(states[k], 0, WINDOW_FRAMES, first_sample=0) for k in self.config.layers
        ]
        return torch.stack(rows, dim=2)

    def given(self, sound: Tensor, number: int) -> Tensor:
        """States of the student's layers [shape=(B, T, L, D)]; the first rows are read causally."""
        rng = np.random.default_rng((self.seed, number + 1_000_000, 1))
        mel, encoder = self.student.mel, self.student.encoder
        decades = mel.decades(mel.windows(sound, 3 * WINDOW_FRAMES))
        gains = rng.uniform(-CAUSAL_GAIN_DB, CAUSAL_GAIN_DB, (CAUSAL_ROWS, 1, 1)) / 10
        causal = decades[:CAUSAL_ROWS] + torch.from_numpy(gains).float()
        whole = decades[CAUSAL_ROWS:]
        first = torch.from_numpy(rng.integers(PERIOD, size=(CAUSAL_ROWS, 1)))
        halves = (
            encoder(
                scaled(causal, PEAK), self.mask, (first + torch.arange(WINDOW_FRAMES)) % PERIOD
            ),
            encoder(scaled(whole, whole.amax(dim=(1, 2), keepdim=True))),
        )
        return torch.stack(
            [torch.cat([half[k] for half in halves]) for k in self.config.layers], dim=2
        )

    def scaled(self, states: Tensor) -> Tensor:
        """States with the mean and deviation of speech, limited as in the frontend."""
        return ((states - self.mean) / self.scale).clamp(-LARGEST, LARGEST)

    def loss(self, number: int) -> Tensor:
        """Squared distance of the noisy states and the clean ones, and of their motion."""
        clean, noisy = self.batch(number)
        wanted = self.scaled(self.wanted(clean))
        given = self.scaled(self.given(noisy, number))
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
    encoder = task.student.encoder
    weights = list(encoder.parameters())
    optimizer = torch.optim.AdamW(weights, lr=RATE, weight_decay=0.01)
    average = {name: value.clone() for name, value in encoder.state_dict().items()}
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
        for name, value in encoder.state_dict().items():
            average[name].lerp_(value, 1 - share)
        losses.append(loss.item())
        if (step + 1) % REPORT_STEPS == 0 or step + 1 == steps:
            with atomic_write(out) as path:
                save_file({name: value.half() for name, value in average.items()}, path)
            yield step + 1, float(np.mean(losses[-REPORT_STEPS:]))


@one_line_errors
def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command of the module's docstring; an error is one line on stderr."""
    parser = argparse.ArgumentParser(prog="python -m deitalk.research.training.encoder_noise")
    parser.add_argument("speech", type=Path, nargs="+", help="folders of recordings")
    parser.add_argument("--checkpoint", required=True, help="Whisper's weights: hub name or folder")
    parser.add_argument("--start", help="weights to begin with instead: hub name or folder")
    parser.add_argument("--noise", help="folder of recordings of noise")
    parser.add_argument("--rooms", help="folder of impulse responses")
    parser.add_argument("--layers", type=int, nargs="+", default=[2, 3])
    parser.add_argument("--steps", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument(
        "-o", "--out", type=new_file, required=True, help="weights: FILE.safetensors"
    )
    given = parser.parse_args(arguments)
    every = [recording for folder in given.speech for recording in recordings(folder)]
    paths = [recording.path for recording in every if split_of(recording.speaker) == "train"]
    config = WhisperConfig(checkpoint=given.checkpoint, layers=tuple(given.layers))
    task = EncoderNoise(config, paths, read_surroundings(given.noise, given.rooms), given.seed)
    if given.start:
        wanted = task.student.encoder.state_dict()
        task.student.encoder.load_state_dict(encoder_weights(given.start, wanted))
    begun = time.monotonic()
    for step, loss in train(task, given.out, given.steps):
        seconds = time.monotonic() - begun
        print(f"step {step}: loss {loss:.4f}, {seconds:.0f} s", flush=True)  # noqa: T201


if __name__ == "__main__":
    sys.exit(main())
