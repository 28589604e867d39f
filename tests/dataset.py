"""A synthetic dataset folder of a few seconds: bursts of sound with the jaw open."""

from pathlib import Path

import numpy as np
import pandas as pd
import soundfile

from deitalk.emotions import EMOTIONS
from rig import RigCurves, default_controls, write_curves

RATE = 16_000
FPS = 60
SECONDS = 3.0
CLICKS = (0.8, 1.6, 2.2)
JAW = "CTRL_C_jaw.ty"


def waveform(seed: int, seconds: float = SECONDS) -> np.ndarray:
    """Bursts of 0.2 s at `CLICKS`, over a quiet floor."""
    rng = np.random.default_rng(seed)
    t = np.arange(int(seconds * RATE)) / RATE
    out = 1e-4 * rng.standard_normal(len(t))
    for start in CLICKS:
        burst = (t >= start) & (t < start + 0.2)
        out[burst] += 0.2 * np.sin(2 * np.pi * rng.uniform(150, 400) * t[burst])
    return out.astype(np.float32)


def jaw(seconds: float = SECONDS) -> np.ndarray:
    """1 within the bursts, at `FPS`."""
    t = np.arange(int(seconds * FPS)) / FPS
    return np.any([(t >= s) & (t < s + 0.2) for s in CLICKS], axis=0).astype(np.float32)


def write_dataset(
    folder: Path, n_train: int = 4, n_validation: int = 2, seconds: float = SECONDS
) -> Path:
    """Write clips.csv, audio, curves, phones and intensity; return the folder."""
    controls = default_controls()
    for name in ("audio", "curves", "phones", "intensity"):
        (folder / name).mkdir(parents=True, exist_ok=True)
    rows = []
    for i in range(n_train + n_validation):
        emotion = EMOTIONS[i % 5]
        values = np.tile(controls.rest, (int(seconds * FPS), 1))
        values[:, controls.index(JAW)] = 0.6 * jaw(seconds)
        for name in ("CTRL_L_mouth_lipsTogetherU.ty", "CTRL_L_mouth_lipsTogetherD.ty"):
            values[:, controls.index(name)] = 1 - jaw(seconds)
        soundfile.write(folder / f"audio/{i}.flac", waveform(i, seconds), RATE, subtype="PCM_16")
        write_curves(folder / f"curves/{i}.npz", RigCurves(values, controls.names, fps=FPS))
        phones = [
            (0, 0.7, "SIL"), (0.7, 0.8, "M"), (0.8, 1.0, "AA"), (1.0, 1.6, "SIL"),
            (1.6, 1.8, "EH"), (1.8, 3.0, "SIL"),
        ]  # fmt: skip
        phones = [(a, min(b, seconds), phone) for a, b, phone in phones if a < seconds]
        pd.DataFrame(phones, columns=["start", "end", "phone"]).to_csv(
            folder / f"phones/{i}.csv", index=False
        )
        (folder / f"intensity/{i}.csv").write_text(f"time,intensity\n0,0\n1,0.8\n{seconds},0\n")
        rows.append(
            {
                "clip": f"clip{i}",
                "audio": f"audio/{i}.flac",
                "curves": f"curves/{i}.npz",
                "emotion": emotion,
                "speaker": f"test:{i}",
                "split": "train" if i < n_train else "validation",
                "voice": emotion,
                "source": "recording" if i % 2 else "espeak",
                "phones": f"phones/{i}.csv",
                "intensity": f"intensity/{i}.csv",
            }
        )
    pd.DataFrame(rows).to_csv(folder / "clips.csv", index=False)
    return folder


def spoil(folder: Path, column: str, value: str, row: int = 0) -> None:
    """Put a value into the table of clips."""
    frame = pd.read_csv(folder / "clips.csv", dtype=str, keep_default_na=False)
    if column not in frame:
        frame[column] = ""
    frame.loc[row, column] = value
    frame.to_csv(folder / "clips.csv", index=False)
