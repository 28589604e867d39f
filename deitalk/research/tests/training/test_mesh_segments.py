"""Mesh sequences: folders in and out, spectra in time with their frames, segments, bases."""

import json

import numpy as np
import pytest
import soundfile
import torch

from deitalk.audio.mel import MelSpectrogram
from deitalk.audio.voice_activity import normalise_level
from deitalk.config.frontends import SDFAMelConfig
from deitalk.data.seeded_batches import Share
from deitalk.errors import DataError
from deitalk.frontends.sdfa_encoder import SDFAEncoder
from deitalk.research.config import MeshDataConfig
from deitalk.research.meshes.augmentation import MelWarp
from deitalk.research.meshes.folder import Lips, MeshSequence, read_mesh_folder, write_mesh_folder
from deitalk.research.meshes.mesh_bases import fit_mesh_bases
from deitalk.research.meshes.packing import pack_vertices
from deitalk.research.meshes.segments import Segments, Spectra
from deitalk.research.meshes.sources import head_lips, head_templates, open_meshes
from deitalk.workers import DATA_WORKERS
from rig import default_controls
from rig.face import build_head
from rig.mesh import TriMesh, write_ply, write_ply_sequence
from rig.mesh.deformation import mesh_solver
from tests.dataset import CLICKS, JAW, write_dataset

RATE = 16_000
SMALL = SDFAMelConfig(
    window_seconds=0.032, frame_rate=125, n_mels=16, window_frames=16, query_frames=3
)
ENCODER = SDFAEncoder(SMALL)
LIPS = Lips(np.array([21, 22]), np.array([16, 17]))


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
    vertices = moved(template, n_frames, rng).astype(np.float32)
    return MeshSequence(name, speaker, split, lambda: (waveform, vertices))


def written(tmp_path, rng, n_frames=30):
    templates = {"ann": sheet(), "bob": sheet(size=10.0)}
    sequences = [
        sequence("a1", "ann", "train", templates["ann"], rng, n_frames),
        sequence("b1", "bob", "train", templates["bob"], rng, 2 * n_frames),
        sequence("a2", "ann", "validation", templates["ann"], rng, n_frames),
    ]
    write_mesh_folder(
        tmp_path / "m", templates, sequences, fps=30, unit_mm=10, lips=LIPS, basis_error_mm=0.01
    )
    return read_mesh_folder(tmp_path / "m"), sequences


def segments(folder, augment=False, **options):
    options = {"batch_size": 4, "n_frames": 2, "seed": 0} | options
    return Segments(
        folder.split("train"),
        folder.training_speakers,
        folder.fps,
        ENCODER,
        augment=augment,
        **options,
    )


# The folder


def test_vertices_come_back_through_the_folder(tmp_path, rng):
    folder, sequences = written(tmp_path, rng)
    assert (folder.fps, folder.unit_mm) == (30, 10)
    assert folder.training_speakers == ("ann", "bob")
    assert [c.name for c in folder.split("validation")] == ["a2"]
    for clip, source in zip(folder.clips[:2], sequences, strict=False):
        waveform, vertices = source.load()
        template, motion = folder.templates[clip.speaker], clip.motion()
        s, r = (getattr(folder.bases, k).expand(motion[k]) for k in ("stretch", "rotation"))
        out = mesh_solver(template).solve(s, r)
        np.testing.assert_allclose(out, vertices, atol=2e-2)  # cm: 0.2 mm
        offsets = folder.bases.offsets.expand(motion["offsets"]).reshape(vertices.shape)
        np.testing.assert_allclose(template.vertices + offsets, vertices, atol=2e-2)
        np.testing.assert_allclose(
            motion["lips"], (vertices - template.vertices)[:, [21, 22, 16, 17]], atol=1e-6
        )
        np.testing.assert_allclose(clip.waveform(), waveform, atol=1e-4)


def test_triangles_at_rest_are_skipped_with_equal_results(tmp_path, rng):
    """The sheet's first row stays: its numbers must be those of the whole computation, zero."""
    folder, sequences = written(tmp_path, rng)
    template, (_, vertices) = folder.templates["ann"], sequences[0].load()
    vertices = vertices.copy()
    vertices[:, :15] = template.vertices[:15]
    one = MeshSequence("x", "ann", "train", lambda: (np.zeros(RATE, np.float32), vertices))
    write_mesh_folder(
        tmp_path / "n", {"ann": template}, [one], fps=30, unit_mm=10, basis_error_mm=0.001
    )
    bases = read_mesh_folder(tmp_path / "n").bases
    stays = np.abs(vertices - template.vertices).max(axis=(0, 2)) < 1e-6
    still = stays[template.faces].all(axis=1)
    assert 16 <= still.sum() < 20
    s, r = pack_vertices(template, vertices)
    motion = read_mesh_folder(tmp_path / "n").clips[0].motion()
    np.testing.assert_allclose(bases.stretch.expand(motion["stretch"]), s, atol=5e-2)
    np.testing.assert_allclose(bases.rotation.expand(motion["rotation"]), r, atol=5e-2)
    assert np.abs(s).max() > 0.3
    kept = bases.stretch.components.reshape(-1, len(still), 6)
    assert (kept[:, still] == 0).all() and (kept[:, ~still] != 0).any(axis=(0, 2)).all()


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"speaker": "eve"}, "'eve' has no template"),
        ({"split": "dev"}, "split 'dev' is unknown"),
        ({"name": "../x"}, "must be usable as a file's"),
        ({"name": ""}, "must be usable as a file's"),
    ],
)
def test_write_mesh_folder_rejects_a_bad_sequence_and_writes_nothing(tmp_path, rng, change, said):
    template = sheet()
    values = {"name": "a", "speaker": "ann", "split": "train"} | change
    one = sequence(**values, template=template, rng=rng)
    with pytest.raises(DataError, match=said):
        write_mesh_folder(tmp_path / "m", {"ann": template}, [one], fps=30, unit_mm=10)
    assert not list(tmp_path.iterdir())


def test_read_mesh_folder_rejects_damaged_files(tmp_path, rng):
    folder, _ = written(tmp_path, rng)
    path = tmp_path / "m"
    rows = np.zeros((3, 1), np.float16)
    np.savez(path / "motion/a1.npz", stretch=rows, rotation=rows, offsets=rows[:2])
    with pytest.raises(DataError, match=r"arrays of \[2, 3\] frames"):
        folder.clips[0].motion()
    (path / "motion/a1.npz").write_bytes(b"no")
    with pytest.raises(DataError, match=r"a1\.npz: cannot be read"):
        folder.clips[0].motion()
    lips = (path / "lips.npz").read_bytes()
    (path / "lips.npz").write_bytes(b"no")
    with pytest.raises(DataError, match=r"lips\.npz: cannot be read"):
        read_mesh_folder(path)
    (path / "lips.npz").write_bytes(lips)
    bases = (path / "bases.npz").read_bytes()
    (path / "bases.npz").write_bytes(b"no")
    with pytest.raises(DataError, match="build it again"):
        read_mesh_folder(path)
    (path / "bases.npz").write_bytes(bases)
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


def test_vocaset_folder_is_read(tmp_path, rng):
    vertices = vocaset(tmp_path / "v", rng)
    folder = open_meshes(tmp_path / "v", MeshDataConfig(), tmp_path / "built")
    assert folder.unit_mm == 1000
    splits = {clip.name: clip.split for clip in folder.clips}
    assert splits["ann.sentence01"] == splits["bob.sentence02"] == "train"
    assert splits["cyd.sentence01"] == "validation"
    assert folder.lips is None
    for clip in folder.split("train"):
        s, r = pack_vertices(folder.templates[clip.speaker], vertices[clip.name])
        kept = (getattr(folder.bases, k).expand(clip.motion()[k]) for k in ("stretch", "rotation"))
        for given, wanted in zip(kept, (s, r), strict=True):  # noise: all of it is in the basis
            assert np.abs(given - wanted).max() < 0.02 * np.abs(wanted).max()
        assert len(clip.waveform()) == pytest.approx(6 / 60 * RATE, abs=2)  # 22 kHz to 16


def test_heads_act_a_dataset_folder(tmp_path):
    data = write_dataset(tmp_path / "d", 3, 2, 2.0)
    config = MeshDataConfig(fps=30, identities=(2, 3), clips=2, validation_clips=1, basis_frames=60)
    folder = open_meshes(data, config, tmp_path / "m")
    assert folder.unit_mm == 10
    first, second, third = folder.clips
    assert first.speaker == third.speaker != second.speaker
    assert [c.split for c in folder.clips] == ["train", "train", "validation"]
    assert set(folder.templates) == set(head_templates((2, 3)))
    controls, head = default_controls(), build_head(2)
    motion = first.motion()
    assert len(motion["stretch"]) == 60
    s, r = (getattr(folder.bases, k).expand(motion[k][[10, 27]]) for k in ("stretch", "rotation"))
    out = mesh_solver(folder.templates[first.speaker]).solve(s, r)
    shut, opened = (controls.rest.copy() for _ in range(2))
    opened[controls.index(JAW)] = 0.6  # 0.9 s is within the first burst
    for name in ("CTRL_L_mouth_lipsTogetherU.ty", "CTRL_L_mouth_lipsTogetherD.ty"):
        shut[controls.index(name)] = 1
    assert CLICKS[0] < 27 / 30 < CLICKS[0] + 0.2
    lips = head_lips()
    np.testing.assert_array_equal(folder.lips.both, lips.both)
    for i, values in enumerate((shut, opened)):
        truth = head.pose(values)[head.slices["cage"]]
        np.testing.assert_allclose(out[i], truth, atol=0.1)  # cm
        assert np.abs(out[i] - truth).mean() < 1e-2
        rims = motion["lips"][[10, 27][i]]
        np.testing.assert_allclose(rims, (truth - head.cage.vertices)[lips.both], atol=1e-4)
    with pytest.raises(DataError, match=r"set data\.fps=30"):
        open_meshes(data, MeshDataConfig(), tmp_path / "m")


# Spectra


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


# Segments


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


# Bases


def test_bases_keep_a_share_of_the_variance_with_all_triangles_alike():
    """As the paper has it: plain principal components of s and r (§4.4)."""
    template = sheet()
    rng = np.random.default_rng(0)
    moving = template.vertices + 0.02 * rng.standard_normal((60, 25, 3))
    bases = fit_mesh_bases(
        {"ann": template}, [("ann", lambda: moving)], [("ann", lambda: moving)],
        n_frames=60, error_mm=1e-9, unit_mm=10, variance=0.97, weigh_triangles=False,
    )  # fmt: skip
    s, r = pack_vertices(template, moving)
    for values, basis in ((s, bases.stretch), (r, bases.rotation)):
        power = np.linalg.svd(values - values.mean(axis=0), compute_uv=False) ** 2
        share = np.cumsum(power) / power.sum()
        assert len(basis.components) == 1 + np.searchsorted(share, 0.97)
        np.testing.assert_array_equal(basis.weights, 1)
        left = values - basis.expand(basis.project(values))
        assert (left**2).sum() <= 0.0301 * power.sum()


def test_bases_keep_held_out_frames_within_the_bound():
    rng = np.random.default_rng(0)
    template = sheet()
    shapes = 0.05 * rng.standard_normal((4, 25, 3))
    shapes[:, template.vertices[:, 2] < 1e-9] = 0

    def acted(seed, n_frames=80):
        weights = np.random.default_rng(seed).standard_normal((n_frames, 4))
        moving = template.vertices + np.einsum("tk,kvc->tvc", weights, shapes)
        return [("ann", lambda: moving.astype(np.float32))]

    def fitted(bound):
        return fit_mesh_bases(
            {"ann": template}, acted(0), acted(1), n_frames=400, error_mm=bound, unit_mm=10
        )

    loose, tight = fitted(1.0), fitted(0.2)
    for bases, bound in ((loose, 1.0), (tight, 0.2)):
        for kind in (0.0, 1.0):
            rows = [row for row in bases.table if row["offsets"] == kind]
            assert rows[-1]["lively_p99_mm"] <= bound
            assert all(row["lively_p99_mm"] > bound for row in rows[:-1])
        assert rows[-1]["first"] == len(bases.offsets.components)
    assert len(tight.table) > len(loose.table)
    assert len(tight.offsets.components) == 4  # as many as there are shapes
    frames = acted(1)[0][1]()[::9]
    s, r = pack_vertices(template, frames)
    kept = (
        tight.stretch.expand(tight.stretch.project(s)),
        tight.rotation.expand(tight.rotation.project(r)),
    )
    error = np.linalg.norm(mesh_solver(template).solve(*kept) - frames, axis=-1)
    assert error.mean() * 10 < 0.2
