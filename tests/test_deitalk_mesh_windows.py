"""Mesh sequences: folders in and out, windows in time with their frames, pairs, bases."""

import json

import numpy as np
import pytest
import soundfile
import torch
from dataset import CLICKS, JAW, SECONDS, write_dataset

from deitalk.activity import normalise_level
from deitalk.augment_mel import MelWarp
from deitalk.config import MelConfig, MeshDataConfig
from deitalk.data.mesh_folder import MeshSequence, read_mesh_folder, write_mesh_folder
from deitalk.data.mesh_sources import build_meshes, head_templates, open_meshes
from deitalk.data.mesh_windows import (
    MelWindows,
    MeshBatches,
    between_frames,
    fit_mesh_bases,
    mesh_solver,
)
from deitalk.errors import DataError
from deitalk.features import MelSpectrogram
from rig import default_controls
from rig.face import build_head
from rig.mesh import TriMesh, pack_vertices, write_ply, write_ply_sequence

RATE = 16_000
SMALL = MelConfig(window_seconds=0.032, frame_rate=125, n_mels=16, window_frames=16, query_frames=3)


def sheet(n=5, size=8.0):
    x, y = np.meshgrid(np.linspace(0, size, n), np.linspace(0, size, n))
    vertices = np.stack([x.ravel(), y.ravel(), 0.05 * x.ravel() ** 2], axis=1)
    corner = np.arange(n * n).reshape(n, n)
    a, b, c, d = (corner[i : n - 1 + i, j : n - 1 + j].ravel() for i in (0, 1) for j in (0, 1))
    return TriMesh(vertices, np.concatenate([np.stack([a, b, c], 1), np.stack([b, d, c], 1)]))


def moved(template, n_frames, rng):
    """Smooth motion of all but the first vertices (where the solver is pinned)."""
    phase = 2 * np.pi * np.arange(n_frames)[:, None, None] / 83  # no two alike
    shape = rng.standard_normal((2, *template.vertices.shape)) * 0.2
    shape[:, template.vertices[:, 2] < 1e-9] = 0
    return template.vertices + np.sin(phase) * shape[0] + np.cos(phase) * shape[1]


def sequence(name, speaker, split, template, rng, n_frames=30, fps=30):
    waveform = (0.1 * rng.standard_normal(n_frames * RATE // fps)).astype(np.float32)
    waveform -= waveform.mean()  # reading takes a recording's mean away
    return MeshSequence(
        name, speaker, split, waveform, moved(template, n_frames, rng).astype(np.float32)
    )


def written(tmp_path, rng, n_frames=30):
    templates = {"ann": sheet(), "bob": sheet(size=10.0)}
    sequences = [
        sequence("a1", "ann", "train", templates["ann"], rng, n_frames),
        sequence("b1", "bob", "train", templates["bob"], rng, 2 * n_frames),
        sequence("a2", "ann", "validation", templates["ann"], rng, n_frames),
    ]
    write_mesh_folder(tmp_path / "m", templates, sequences, fps=30, unit_mm=10)
    return read_mesh_folder(tmp_path / "m"), sequences


def batches(folder, augment=False, **options):
    options = {"n_pairs": 4, "seed": 0} | options
    speakers = folder.training_speakers
    return MeshBatches(
        folder.split("train"), speakers, folder.fps, SMALL, augment=augment, **options
    )


# The folder


def test_vertices_come_back_through_the_folder(tmp_path, rng):
    folder, sequences = written(tmp_path, rng)
    assert (folder.fps, folder.unit_mm) == (30, 10)
    assert folder.training_speakers == ("ann", "bob")
    assert [c.name for c in folder.split("validation")] == ["a2"]
    for clip, source in zip(folder.clips, sequences, strict=True):
        s, r = clip.gradients()
        assert s.dtype == r.dtype == np.float16
        out = mesh_solver(folder.templates[clip.speaker]).solve(s, r)
        np.testing.assert_allclose(out, source.vertices, atol=5e-3)  # cm: 0.05 mm
        np.testing.assert_allclose(clip.waveform(), source.waveform, atol=1e-4)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"speaker": "eve"}, "'eve' has no template"),
        ({"split": "dev"}, "split 'dev' is unknown"),
        ({"name": "../x"}, "must be usable as a file's"),
        ({"name": ""}, "must be usable as a file's"),
    ],
)
def test_bad_sequence_leaves_nothing(tmp_path, rng, change, said):
    template = sheet()
    values = {"name": "a", "speaker": "ann", "split": "train"} | change
    one = sequence(**values, template=template, rng=rng)
    with pytest.raises(DataError, match=said):
        write_mesh_folder(tmp_path / "m", {"ann": template}, [one], fps=30, unit_mm=10)
    assert not list(tmp_path.iterdir())


def test_other_bad_sources(tmp_path, rng):
    template = sheet()
    one = sequence("a", "ann", "train", template, rng)
    short = MeshSequence("s", "ann", "train", one.waveform, one.vertices[:1])
    for sequences, said in (
        ([one, one], "appears twice"),
        ([short], "at least 2"),
        ([], "no sequences"),
    ):
        with pytest.raises(DataError, match=said):
            write_mesh_folder(tmp_path / "m", {"ann": template}, sequences, fps=30, unit_mm=1)
    with pytest.raises(DataError, match="one topology"):
        templates = {"ann": template, "bob": sheet(4)}
        write_mesh_folder(tmp_path / "m", templates, [one], fps=30, unit_mm=1)
    with pytest.raises(DataError, match="exists already"):
        write_mesh_folder(tmp_path, {"ann": template}, [one], fps=30, unit_mm=1)


def test_damaged_folders(tmp_path, rng):
    folder, _ = written(tmp_path, rng)
    path = tmp_path / "m"
    np.save(path / "gradients/a1.s.npy", np.zeros((3, 6), np.float16))
    with pytest.raises(DataError, match="at least two frames"):
        folder.clips[0].gradients()
    (path / "gradients/a1.s.npy").write_bytes(b"no")
    with pytest.raises(DataError, match=r"a1\.s\.npy: cannot be read"):
        folder.clips[0].gradients()
    table = (path / "clips.csv").read_text()
    (path / "clips.csv").write_text(table.replace("a1,", "../a1,"))
    with pytest.raises(DataError, match="leaves the folder"):
        read_mesh_folder(path)
    (path / "clips.csv").write_text(table.replace(",bob,", ",eve,"))
    with pytest.raises(DataError, match="'eve' has no template"):
        read_mesh_folder(path)
    (path / "mesh.json").write_text(json.dumps({"format_version": 99, "fps": 1, "unit_mm": 1}))
    with pytest.raises(DataError, match="version 99"):
        read_mesh_folder(path)
    (path / "mesh.json").write_text("{}")
    with pytest.raises(DataError, match="no mesh folder"):
        read_mesh_folder(path)


# Sources


def vocaset(root, rng, speakers=("ann", "bob", "cyd"), n_frames=6):
    """The layout of VOCASET, by hand."""
    vertices = {}
    (root / "templates").mkdir(parents=True)
    for i, speaker in enumerate(speakers):
        template = sheet(size=0.1 + 0.01 * i)
        write_ply(root / f"templates/{speaker}.ply", template)
        for sentence in ("sentence01", "sentence02"):
            frames = template.vertices + 0.001 * rng.standard_normal((n_frames, 25, 3))
            vertices[f"{speaker}.{sentence}"] = frames
            folder = root / "unposedcleaneddata" / speaker
            folder.mkdir(parents=True, exist_ok=True)
            write_ply_sequence(folder / sentence, template, frames)
            (root / "audio" / speaker).mkdir(parents=True, exist_ok=True)
            sound = 0.1 * rng.standard_normal(n_frames * 22_000 // 60)
            soundfile.write(root / f"audio/{speaker}/{sentence}.wav", sound, 22_000)
    return vertices


def test_vocaset_layout(tmp_path, rng):
    vertices = vocaset(tmp_path / "v", rng)
    folder = open_meshes(tmp_path / "v", MeshDataConfig(), tmp_path / "built")
    assert folder.unit_mm == 1000
    splits = {clip.name: clip.split for clip in folder.clips}
    assert splits["ann.sentence01"] == splits["bob.sentence02"] == "train"
    assert splits["cyd.sentence01"] == "validation"
    for clip in folder.clips:
        s, r = clip.gradients()
        solver = mesh_solver(folder.templates[clip.speaker])
        pins = vertices[clip.name][:, solver.pins]
        out = solver.solve(s, r, pin_positions=pins)
        np.testing.assert_allclose(out, vertices[clip.name], atol=1e-4)  # m: 0.1 mm
        assert len(clip.waveform()) == pytest.approx(6 / 60 * RATE, abs=2)  # 22 kHz to 16


def test_vocaset_splits_may_be_given(tmp_path, rng):
    root = tmp_path / "v"
    vocaset(root, rng, ("ann", "bob"), 2)
    (root / "splits.csv").write_text("speaker,split\nann,test\nbob,train\n")
    build_meshes(root, MeshDataConfig(), tmp_path / "m")
    clips = read_mesh_folder(tmp_path / "m").clips
    assert {(c.speaker, c.split) for c in clips} == {("ann", "test"), ("bob", "train")}
    (root / "splits.csv").write_text("speaker,split\nann,test\n")
    with pytest.raises(DataError, match="split None of 'bob'"):
        build_meshes(root, MeshDataConfig(), tmp_path / "n")


def test_vocaset_that_lacks_something(tmp_path, rng):
    root = tmp_path / "v"
    vocaset(root, rng, ("ann",), 2)
    recording = root / "audio/ann/sentence02.wav"
    recording.unlink()
    with pytest.raises(DataError, match=r"sentence02\.wav: missing"):
        build_meshes(root, MeshDataConfig(), tmp_path / "m")
    (root / "templates/ann.ply").unlink()
    with pytest.raises(DataError, match=r"holds no \.ply"):
        build_meshes(root, MeshDataConfig(), tmp_path / "m")
    with pytest.raises(DataError, match="neither"):
        build_meshes(tmp_path / "nothing", MeshDataConfig(), tmp_path / "m")
    assert not (tmp_path / "m").exists()


def test_heads_act_a_dataset_folder(tmp_path):
    data = write_dataset(tmp_path / "d", 3, 1)
    config = MeshDataConfig(fps=30, identities=(2, 5), clips=2)
    folder = open_meshes(data, config, tmp_path / "m")
    assert folder.unit_mm == 10
    first, second, third = folder.clips
    assert first.speaker == third.speaker != second.speaker
    assert [c.split for c in folder.clips] == ["train", "train", "validation"]
    assert set(folder.templates) == set(head_templates((2, 5)))
    controls, head = default_controls(), build_head(2)
    s, r = first.gradients()
    assert len(s) == 90
    out = mesh_solver(folder.templates[first.speaker]).solve(s[[10, 27]], r[[10, 27]])
    shut, opened = (controls.rest.copy() for _ in range(2))
    opened[controls.index(JAW)] = 0.6  # 0.9 s is within the first burst
    for name in ("CTRL_L_mouth_lipsTogetherU.ty", "CTRL_L_mouth_lipsTogetherD.ty"):
        shut[controls.index(name)] = 1
    assert CLICKS[0] < 27 / 30 < CLICKS[0] + 0.2
    for frame, values in zip(out, (shut, opened), strict=True):
        truth = head.pose(values)[head.slices["skin"]]
        np.testing.assert_allclose(frame, truth, atol=5e-3)
    with pytest.raises(DataError, match=r"set data\.fps=30"):
        open_meshes(data, MeshDataConfig(), tmp_path / "m")
    assert SECONDS * 30 == 90


# Windows


def test_window_is_centred_on_its_moment():
    waveform = np.zeros(RATE, np.float32)
    waveform[int(0.4 * RATE)] = 1
    windows = MelWindows(SMALL)
    loudness = windows(waveform, np.array([0.4, 0.4 + 3 / 125]), MelWarp())[:, 0].sum(dim=1)
    assert loudness.shape == (2, 16)
    assert loudness.argmax(dim=1).tolist() == [8, 5]  # half of 16, and three spectra before it


def test_windows_are_pieces_of_the_clip_s_spectrogram():
    """Derivatives too: a window must not know where it was cut."""
    rng = np.random.default_rng(1)
    waveform = (0.1 * rng.standard_normal(RATE)).astype(np.float32)
    whole = MelSpectrogram(0.032, 125, 16)(torch.from_numpy(waveform)[None], 125)[0]
    cut = MelWindows(SMALL)(waveform, np.array([0.4, 0.48]), MelWarp())
    torch.testing.assert_close(cut[0], whole[:, :, 50 - 8 : 50 + 8], atol=1e-4, rtol=1e-4)
    torch.testing.assert_close(cut[1], whole[:, :, 60 - 8 : 60 + 8], atol=1e-4, rtol=1e-4)


def test_derivatives_are_of_the_warped_spectrogram():
    rng = np.random.default_rng(1)
    waveform = (0.1 * rng.standard_normal(RATE)).astype(np.float32)
    warp = MelWarp(padded=2, stretch=0.8, zeroed=(3,), sine=(5.0, 1.0, 0.3))
    mel, slope, curve = MelWindows(SMALL)(waveform, np.array([0.5]), warp)[0]
    torch.testing.assert_close(slope[:, 1:-1], (mel[:, 2:] - mel[:, :-2]) / 2, atol=1e-5, rtol=0)
    torch.testing.assert_close(
        curve[:, 1:-1], (slope[:, 2:] - slope[:, :-2]) / 2, atol=1e-5, rtol=0
    )
    assert (slope[3] == 0).all()


@pytest.mark.parametrize("time", [-1.0, 0.0, 0.999, 5.0])
def test_beyond_the_recording_is_silence(time):
    mel = MelWindows(SMALL)(np.full(RATE, 0.1, np.float32), np.array([time]), MelWarp())
    assert mel.shape == (1, 3, 16, 16)
    assert torch.isfinite(mel).all()


# Pairs


def test_pairs_are_adjacent_frames_of_one_clip(tmp_path, rng):
    folder, _ = written(tmp_path, rng)
    source = batches(folder)
    assert source.n_frames == 90
    known = {c.speaker: c.gradients()[0].astype(np.float32) for c in folder.split("train")}
    drawn = []
    for number in range(300):
        pair = source.pair(number)
        speaker = folder.training_speakers[int(pair.speaker.argmax())]
        rows = known[speaker]
        at = int(np.abs(rows - pair.s[0].numpy()).sum(axis=1).argmin())
        np.testing.assert_array_equal(pair.s[0], rows[at])
        np.testing.assert_array_equal(pair.s[1], rows[at + 1])
        drawn.append(speaker)
    assert drawn.count("bob") / 300 == pytest.approx(59 / 88, abs=0.09)  # by frames, not clips


def test_sound_belongs_to_the_frames(tmp_path, rng):
    folder, sequences = written(tmp_path, rng)
    rows = {c.speaker: c.gradients()[0].astype(np.float32) for c in folder.split("train")}
    sounds = {q.speaker: normalise_level(q.waveform) for q in sequences[:2]}
    for number in range(5):
        pair = batches(folder).pair(number)
        speaker = folder.training_speakers[int(pair.speaker.argmax())]
        at = int(np.abs(rows[speaker] - pair.s[0].numpy()).sum(axis=1).argmin())
        times = np.array([at, at + 1]) / 30
        expected = MelWindows(SMALL)(sounds[speaker], times, MelWarp())
        torch.testing.assert_close(pair.mel, expected, atol=0.05, rtol=0)  # stored in 16 bits


def test_augmented_pairs_keep_one_shift_and_linear_targets(tmp_path, rng):
    """Motion that is linear in time keeps its difference whatever the shift."""
    template = sheet()
    step = 0.01 * np.abs(template.vertices[:, :1]) * [1.0, 0, 0]
    vertices = template.vertices + np.arange(40)[:, None, None] * step
    sound = (0.1 * rng.standard_normal(40 * RATE // 30)).astype(np.float32)
    one = MeshSequence("a", "ann", "train", sound, vertices.astype(np.float32))
    write_mesh_folder(tmp_path / "m", {"ann": template}, [one], fps=30, unit_mm=10)
    folder = read_mesh_folder(tmp_path / "m")
    s, _ = pack_vertices(template, vertices)
    plain, shifted = batches(folder), batches(folder, augment=True)
    slope = s[21] - s[20]
    fast = int(np.abs(slope).argmax())
    places = []
    for number in range(200):
        pair = shifted.pair(number)
        place = (float(pair.s[0, fast]) - s[0, fast]) / slope[fast]
        whole = (float(plain.pair(number).s[0, fast]) - s[0, fast]) / slope[fast]
        places.append(place - whole)
        if 0.5 < whole < 37.5:
            np.testing.assert_allclose(pair.s[1] - pair.s[0], slope, atol=2e-3)
    assert np.abs(places).max() <= 0.55
    assert np.ptp(places) > 0.8


def test_augmentation_changes_the_sound_of_both_frames(tmp_path, rng):
    folder, _ = written(tmp_path, rng)
    changed = 0
    for number in range(20):
        plain, rich = (batches(folder, augment=a).pair(number) for a in (False, True))
        assert torch.isfinite(rich.mel).all()
        changed += bool(((plain.mel - rich.mel).abs().amax(dim=(1, 2, 3)) > 0.1).all())
    assert changed >= 18


def test_batches_are_the_same_for_any_number_of_workers_and_go_on(tmp_path, rng):
    folder, _ = written(tmp_path, rng)
    first = [b for b, _ in zip(batches(folder, augment=True), range(4), strict=False)]
    assert first[0].mel.shape == (4, 2, 3, 16, 16)
    later = next(iter(batches(folder, augment=True, skip=2)))
    assert torch.equal(later.mel, first[2].mel)
    loader = torch.utils.data.DataLoader(
        batches(folder, augment=True), batch_size=None, num_workers=2
    )
    for one, other in zip(first, loader, strict=False):
        assert torch.equal(one.mel, other.mel) and torch.equal(one.r, other.r)


def test_no_clips_is_one_line():
    with pytest.raises(DataError, match="no mesh sequences"):
        MeshBatches([], (), 30, SMALL, n_pairs=1, augment=False, seed=0)


def test_between_frames_by_hand():
    rows = np.array([[0.0, 3.0], [1.0, -3.0], [4.0, -3.0]], np.float16)
    out = between_frames(rows, np.array([-1.0, 0.25, 0.75, 1.5, 9.0]))
    np.testing.assert_allclose(out[:, 0], [0, 0.25, 0.75, 2.5, 4])
    # 3 and -3 rad are a third of a radian apart the other way: no mean of the two lies between.
    np.testing.assert_allclose(out[:, 1], [3, 3, -3, -3, -3])


# Bases


def test_bases_keep_held_out_frames_within_the_bound(tmp_path, rng):
    template = sheet()
    shapes = 0.05 * rng.standard_normal((4, 25, 3))
    shapes[:, template.vertices[:, 2] < 1e-9] = 0

    def acted(seed, n_frames=80):
        weights = np.random.default_rng(seed).standard_normal((n_frames, 4))
        return (template.vertices + np.einsum("tk,kvc->tvc", weights, shapes)).astype(np.float32)

    sound = np.zeros(80 * RATE // 30, np.float32)
    sequences = [
        MeshSequence(split, "ann", split, sound, acted(i))
        for i, split in enumerate(("train", "validation"))
    ]
    write_mesh_folder(tmp_path / "m", {"ann": template}, sequences, fps=30, unit_mm=10)
    folder = read_mesh_folder(tmp_path / "m")
    loose, tight = (
        fit_mesh_bases(folder, MeshDataConfig(basis_error_mm=bound)) for bound in (1.0, 0.2)
    )
    for bases, bound in ((loose, 1.0), (tight, 0.2)):
        last = bases.table[-1]
        assert last["lively_p99_mm"] <= bound
        assert all(row["lively_p99_mm"] > bound for row in bases.table[:-1])
        assert last["stretch"] == len(bases.stretch.components)
    assert len(tight.table) > len(loose.table)
    s, r = pack_vertices(template, acted(1)[::9])
    kept = (
        tight.stretch.expand(tight.stretch.project(s)),
        tight.rotation.expand(tight.rotation.project(r)),
    )
    error = np.linalg.norm(mesh_solver(template).solve(*kept) - acted(1)[::9], axis=-1)
    assert error.mean() * 10 < 0.2
