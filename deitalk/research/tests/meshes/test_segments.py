"""Segments of mesh clips: spectra at given times, batches, augmentation."""

import numpy as np
import pytest
import torch

from deitalk.audio.mel import MelSpectrogram
from deitalk.audio.voice_activity import normalise_level
from deitalk.data.seeded_batches import Share
from deitalk.research.meshes.augmentation import MelWarp
from deitalk.research.meshes.folder import MeshSequence, read_mesh_folder, write_mesh_folder
from deitalk.research.meshes.segments import Spectra
from deitalk.research.tests.training.test_mesh_segments import (
    ENCODER,
    RATE,
    segments,
    sheet,
    written,
)
from deitalk.workers import DATA_WORKERS


def test_middle_spectrum_is_of_the_given_time():
    waveform = np.zeros(RATE, np.float32)
    waveform[int(0.4 * RATE)] = 1
    spectra = Spectra(ENCODER, 16)
    for time, place in ((0.4, 8), (0.4 + 3 / 125, 5)):
        features = spectra(waveform, time, MelWarp())
        assert features.shape == (3, 16, 16)
        assert features[0].sum(dim=0).argmax() == place


def test_pieces_equal_the_spectrogram_of_the_clip():
    """Derivatives too: a piece does not depend on where it was cut."""
    rng = np.random.default_rng(1)
    waveform = (0.1 * rng.standard_normal(RATE)).astype(np.float32)
    whole = MelSpectrogram(0.032, 125, 16)(torch.from_numpy(waveform)[None], 125)[0]
    spectra = Spectra(ENCODER, 16)
    for time, place in ((0.4, 50), (0.48, 60)):
        cut = spectra(waveform, time, MelWarp())
        torch.testing.assert_close(cut, whole[:, :, place - 8 : place + 8], atol=1e-4, rtol=1e-4)


def test_derivatives_are_of_the_warped_spectrogram():
    rng = np.random.default_rng(1)
    waveform = (0.1 * rng.standard_normal(RATE)).astype(np.float32)
    warp = MelWarp(padded=2, stretch=0.8, zeroed=(3,), sine=(5.0, 1.0, 0.3))
    mel, slope, curve = Spectra(ENCODER, 16)(waveform, 0.5, warp)
    torch.testing.assert_close(slope[:, 1:-1], (mel[:, 2:] - mel[:, :-2]) / 2, atol=1e-5, rtol=0)
    torch.testing.assert_close(
        curve[:, 1:-1], (slope[:, 2:] - slope[:, :-2]) / 2, atol=1e-5, rtol=0
    )
    assert (slope[3] == 0).all()


def test_segments_are_adjacent_frames_of_one_clip(tmp_path, rng):
    folder, _ = written(tmp_path, rng)
    source = segments(folder, n_frames=3)
    assert source.n_frames_total == 90
    known = {c.speaker: c.motion() for c in folder.split("train")}
    drawn = []
    for number in range(300):
        segment = source.item(number)
        speaker = folder.training_speakers[int(segment.speaker.argmax())]
        rows = known[speaker]["offsets"]
        at = int(np.abs(rows - segment.offsets[0].numpy()).sum(axis=1).argmin())
        for name in ("stretch", "rotation", "offsets", "lips"):
            given = getattr(segment, name)
            np.testing.assert_allclose(given, known[speaker][name][at : at + 3], atol=1e-5)
        drawn.append(speaker)
    assert drawn.count("bob") / 300 == pytest.approx(58 / 86, abs=0.09)  # by frames, not clips


def test_features_are_of_the_time_of_their_frames(tmp_path, rng):
    """Each frame's spectrum is the one of its time, whatever the segment about it."""
    folder, sequences = written(tmp_path, rng)
    rows = {c.speaker: c.motion()["offsets"] for c in folder.split("train")}
    sounds = {q.speaker: normalise_level(q.load()[0]) for q in sequences[:2]}
    source = segments(folder, n_frames=5)
    for number in range(5):
        segment = source.item(number)
        speaker = folder.training_speakers[int(segment.speaker.argmax())]
        at = int(np.abs(rows[speaker] - segment.offsets[0].numpy()).sum(axis=1).argmin())
        alone = Spectra(ENCODER, 2)
        middle, ends = segment.features[:, :, source.places[2]], source.places[[0, 4]]
        expected = alone(sounds[speaker], (at + 2) / 30, MelWarp())[:, :, 1]
        torch.testing.assert_close(middle, expected, atol=0.05, rtol=0)  # stored in 16 bits
        assert (ends - source.places[2]).tolist() == [-8, 8]  # 2 frames: 67 ms, 8 spectra of 8 ms


def test_augmented_segments_have_one_shift_and_linear_targets(tmp_path):
    """Motion that is linear in time keeps its difference, but for the stretch of time."""
    template = sheet()
    step = 0.01 * np.abs(template.vertices[:, :1]) * [1.0, 0, 0]
    vertices = (template.vertices + np.arange(40)[:, None, None] * step).astype(np.float32)
    sound = (0.1 * np.random.default_rng(0).standard_normal(40 * RATE // 30)).astype(np.float32)
    one = MeshSequence("a", "ann", "train", lambda: (sound, vertices))
    write_mesh_folder(tmp_path / "m", {"ann": template}, [one], fps=30, unit_mm=10)
    folder = read_mesh_folder(tmp_path / "m")
    plain, shifted = segments(folder), segments(folder, augment=True)
    rows = folder.clips[0].motion()["offsets"][:, 0]
    slope = float(rows[21] - rows[20])
    places, stretches = [], []
    for number in range(200):
        segment = shifted.item(number)
        place = (float(segment.offsets[:, 0].mean()) - rows[0]) / slope - 0.5
        whole = (float(plain.item(number).offsets[0, 0]) - rows[0]) / slope
        places.append(place - whole)
        if 1 < whole < 37:
            stretches.append(slope / float(segment.offsets[1, 0] - segment.offsets[0, 0]))
    assert np.abs(places).max() <= 0.7
    assert np.ptp(places) > 0.8
    np.testing.assert_allclose([min(stretches), max(stretches)], [0.8, 1.25], atol=0.05)
    assert 0.3 < np.mean(np.abs(np.array(stretches) - 1) < 0.01) < 0.7  # half are as they were


def test_batches_do_not_depend_on_workers_or_interruptions(tmp_path, rng):
    folder, _ = written(tmp_path, rng)
    first = [b for b, _ in zip(segments(folder, augment=True), range(4), strict=False)]
    assert first[0].features.shape[:3] == (4, 3, 16)
    assert first[0].stretch.shape[:2] == (4, 2)
    later = next(iter(segments(folder, augment=True, share=Share(skip=2))))
    assert torch.equal(later.features, first[2].features)
    loader = torch.utils.data.DataLoader(
        segments(folder, augment=True),
        batch_size=None,
        num_workers=2,
        multiprocessing_context=DATA_WORKERS,
    )
    for one, other in zip(first, loader, strict=False):
        assert torch.equal(one.features, other.features)
        assert torch.equal(one.rotation, other.rotation)
