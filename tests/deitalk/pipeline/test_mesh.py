"""Speech to meshes: closed lips, emotion, every kind of model, the command."""

import json
from dataclasses import replace

import numpy as np
import pytest
from typer.testing import CliRunner

from deitalk.audio.load import load_audio, write_wav
from deitalk.cli import app
from deitalk.emotions import IntensityCurve
from deitalk.errors import CheckpointError, DeitalkError, EmotionError
from deitalk.models.checkpoint import load_model, save_model
from deitalk.pipeline import mesh as module
from deitalk.pipeline.mesh import animate_mesh, retarget_speech
from deitalk.postprocess.lip_seal import known_skins
from deitalk.research.meshes.frames import read_ply_sequence
from deitalk.research.meshes.predict import predict_mesh
from rig import ControlSet, default_controls
from rig.errors import ExistsError, RigError, TargetError
from rig.face import build_head
from rig.face.identity import identity_of
from rig.mesh.glb import read_container
from rig.mesh.glb_reader import read_accessor, read_glb
from rig.retarget.head_import import import_head
from rig.retarget.retarget_files import RetargetReport
from tests.meshes import write_obj
from tests.rig.retarget.test_head_import import Face
from tests.rig.retarget.test_retarget_files import ict

pytestmark = pytest.mark.usefixtures("one_analysis")
SAMPLE = "docs/samples/promise.flac"
SAMPLE_BILABIALS = (
    (0.22, 0.26), (0.42, 0.46), (0.74, 0.80), (1.12, 1.22), (1.74, 1.82), (2.74, 2.84),
    (3.04, 3.10), (3.48, 3.52), (3.91, 4.01), (4.51, 4.55), (5.02, 5.11), (5.22, 5.32),
    (8.04, 8.08), (8.31, 8.61),
)  # fmt: skip
"""Every m, b, p of the sample (may·be you be·lieve me ... mo·ther ... prom·ised every·bo·dy ...),
aligned with pocketsphinx by `deitalk.research.corpus.alignment`; seconds."""
WIDEN_SECONDS = 2 / 30


@pytest.fixture(scope="module")
def network(default):
    return default


@pytest.fixture(scope="module")
def acted(request, network):
    """The sample acted in two emotions by the embedded weights."""
    recording = load_audio(request.config.rootpath / SAMPLE)
    return {e: animate_mesh(recording, e, model=network) for e in ("neutral", "happy")}


def lip_gaps_mm(vertices, head):
    """Median gap of the lips over the middle of the mouth [shape=(T,)]."""
    former = known_skins()[1]
    lips = former.lips if vertices.shape[1] == former.n_vertices else head.motion.lips
    upper, lower = (lip.weight @ vertices[:, lip.rim] for lip in lips)
    quarter = upper.shape[1] // 4
    return 10 * np.median(np.abs(upper - lower)[:, quarter:-quarter, 1], axis=1)


def assert_lips_seal(performance):
    """Within 1 mm at seven of ten bilabials at least; the mouth is open elsewhere."""
    gaps = lip_gaps_mm(performance.vertices, build_head(0))
    times = np.arange(len(gaps)) / 30
    closed = [
        gaps[(times >= start - WIDEN_SECONDS) & (times <= end + WIDEN_SECONDS)].min()
        for start, end in SAMPLE_BILABIALS
    ]
    assert np.mean(np.array(closed) <= 1.0) >= 0.7
    assert np.median(closed) <= 0.5
    assert np.percentile(gaps, 90) > 4


def corners_rise_mm(performance, neutral):
    corners = [performance.landmarks[f"mouth_corner_{side}"] for side in ("left", "right")]
    return 10 * (performance.vertices - neutral.vertices)[:, corners, 1].mean()


@pytest.mark.parametrize("emotion", ["neutral", "happy"])
def test_lips_seal_at_bilabials(acted, emotion):
    assert_lips_seal(acted[emotion])


def test_lips_seal_and_corners_rise_with_the_mesh_head(acted):
    neutral, happy = (
        animate_mesh(acted["happy"].recording, emotion, model="mesh_head")
        for emotion in ("neutral", "happy")
    )
    assert_lips_seal(neutral)
    assert_lips_seal(happy)
    assert corners_rise_mm(happy, neutral) > 1.5


def test_emotion_and_intensity_reach_the_mesh(acted, network):
    """Corners rise when happy, less at half the intensity; intensity 0 is the neutral reading."""
    whole = acted["neutral"].recording
    start = replace(whole, waveform=whole.waveform[:40_000])
    neutral, full, half, none = (
        animate_mesh(start, emotion, model=network, intensity=intensity)
        for emotion, intensity in (("neutral", 1), ("happy", 1), ("happy", 0.5), ("happy", 0))
    )
    rise_mm = corners_rise_mm(full, neutral)
    assert rise_mm > 1.5
    assert 0.25 * rise_mm < corners_rise_mm(half, neutral) < 0.8 * rise_mm
    np.testing.assert_allclose(none.vertices, neutral.vertices, atol=1e-4)


def test_a_rig_without_a_head_is_refused_before_any_work(speech, network, monkeypatch):
    monkeypatch.setattr(network, "controls", ControlSet("mine@1", default_controls().controls[:2]))
    with pytest.raises(CheckpointError, match="mine@1, which has no head here"):
        animate_mesh(speech, model=network)


def test_speaker_chooses_the_embedded_head(speech, network):
    bruno = animate_mesh(speech, model=network, speaker="Bruno")
    head = build_head("Bruno")
    np.testing.assert_allclose(bruno.mesh.vertices, head.mesh.vertices)
    assert bruno.landmarks == head.landmarks
    with pytest.raises(RigError, match="'Nobody' is unknown"):
        animate_mesh(speech, model=network, speaker="Nobody")


def test_a_head_of_your_own_speaks_and_moves_no_other_mesh(sdfa_folder, speech, network, tmp_path):
    import_head(Face().write(tmp_path / "mine.glb"), tmp_path / "mine.npz")
    mine = identity_of(str(tmp_path / "mine.npz"))
    found = animate_mesh(speech, model=network, speaker=mine)
    np.testing.assert_array_equal(found.mesh.vertices, build_head(mine).neutral)
    assert np.abs(found.vertices - found.mesh.vertices).max() > 0.05 and found.landmarks is None
    with pytest.raises(CheckpointError, match=r"mine.npz is a head for curves.*a mesh of yours"):
        animate_mesh(speech, model=sdfa_folder, speaker=mine)
    with pytest.raises(DeitalkError, match=r"identity mine is a head of ours.*leave one out"):
        retarget_speech(speech, tmp_path / "mine.glb", tmp_path / "o.npz", speaker=mine)


@pytest.fixture(scope="module")
def sdfa_folder(tmp_path_factory):
    """Two sheets that a network of random weights moves."""
    from tests.deitalk.models.test_mesh_model import model, tiny

    folder = tmp_path_factory.mktemp("sdfa") / "model"
    save_model(folder, model(fps=30), tiny(), {})
    return folder


@pytest.fixture
def speech(tmp_path):
    noise = np.random.default_rng(0).standard_normal(16_000)
    write_wav(tmp_path / "speech.wav", (0.1 * noise).astype(np.float32))
    return tmp_path / "speech.wav"


def test_sdfa_moves_the_template_of_its_speaker(sdfa_folder, speech):
    network, shares = load_model(sdfa_folder), []
    performance = animate_mesh(speech, model=network, speaker="bob", progress=shares.append)
    assert (performance.fps, performance.unit_mm, performance.landmarks) == (30, 10, None)
    wanted = predict_mesh(network, load_audio(speech).waveform, "bob")
    np.testing.assert_allclose(performance.vertices, wanted, atol=1e-6)
    np.testing.assert_array_equal(performance.mesh.vertices, network.template("bob").vertices)
    assert shares[-1] == 1
    assert np.abs(wanted - network.template("bob").vertices).max() > 0.01  # it moves


def test_sdfa_rejects_emotion_and_other_rates(sdfa_folder, speech):
    curve = IntensityCurve(np.zeros(1), np.ones(1))
    for argument in ({"emotion": "happy"}, {"intensity": 0.5}, {"intensity_curve": curve}):
        with pytest.raises(EmotionError, match="no emotion and no intensity"):
            animate_mesh(speech, model=sdfa_folder, **argument)
    with pytest.raises(CheckpointError, match="fps=60: this SDFA model makes 30"):
        animate_mesh(speech, model=sdfa_folder, fps=60)
    with pytest.raises(CheckpointError, match=r"speaker 'eve' is unknown.*ann, bob"):
        animate_mesh(speech, model=sdfa_folder, speaker="eve")


@pytest.mark.parametrize("kind", ["curves", "mesh"])
def test_retarget_speech_follows_the_product_of_the_model(
    kind, sdfa_folder, network, speech, tmp_path, monkeypatch
):
    """Curves drive the mesh; a mesh model's sequence is carried to it."""
    calls = {}
    report = RetargetReport(tmp_path / "out.npz", "neutral", 3, 30, None, ("a note",))

    def curves(curves, mesh, out, **options):
        calls["curves"] = curves
        return report

    def sequence(template, vertices, mesh, out, **options):
        calls["mesh"] = vertices, options["fps"]
        return report

    monkeypatch.setattr(module, "retarget_curves", curves)
    monkeypatch.setattr(module, "retarget_sequence", sequence)
    monkeypatch.setattr(module, "load_model", lambda name, device: network)
    options = {"model": "default", "fps": 60}
    if kind == "mesh":
        monkeypatch.setattr(module, "load_model", load_model)
        options = {"model": sdfa_folder, "speaker": "bob"}
    found, fps, notes = retarget_speech(
        speech, tmp_path / "own.obj", tmp_path / "out.npz", **options
    )
    assert found is report and notes[-1] == "a note" and list(calls) == [kind]
    if kind == "mesh":
        vertices, rate = calls["mesh"]
        assert (rate, fps) == (30, 30)
        np.testing.assert_array_equal(
            vertices, animate_mesh(speech, model=sdfa_folder, speaker="bob").vertices
        )
    else:
        assert (calls["curves"].fps, fps) == (60, 60)


def run(*arguments):
    return CliRunner().invoke(app, ["animate", "--vertices", *map(str, arguments)])


def test_command_writes_the_same_motion_three_ways(sdfa_folder, speech, tmp_path):
    model = ("--model", sdfa_folder, "--identity", 1)
    for name in ("a.npz", "a.glb", "frames"):
        result = run(speech, "-o", tmp_path / name, *model)
        assert result.exit_code == 0, result.output
        assert "30 frames at 30 per second, 16 vertices" in result.stderr.replace("\n", " ")
    with np.load(tmp_path / "a.npz") as file:
        vertices = file["vertices"]
    np.testing.assert_allclose(read_ply_sequence(tmp_path / "frames")[1], vertices, atol=1e-6)
    document, binary = read_container(tmp_path / "a.glb")
    sampler = document["animations"][0]["samplers"][0]
    weights = read_accessor(document, binary, sampler["output"]).reshape(30, -1)
    metres = read_glb(tmp_path / "a.glb").evaluate(weights)
    np.testing.assert_allclose(metres, 0.01 * vertices, atol=2.1e-5)  # 0.02 mm
    again = run(speech, "-o", tmp_path / "a.npz", *model)
    assert isinstance(again.exception, ExistsError)
    summary = json.loads(run(speech, "-o", tmp_path / "a.npz", *model, "--force", "--json").stdout)
    assert (summary["frames"], summary["fps"], summary["vertices"]) == (30, 30, 16)


def test_command_rejects_bad_arguments_and_writes_nothing(sdfa_folder, speech, tmp_path):
    out = ("-o", tmp_path / "out.glb")
    for arguments, error, said in (
        ((speech, "-o", tmp_path / "out.fbx"), TargetError, "files end with .glb, .npz"),
        ((speech, *out, "--landmarks", "a.json"), DeitalkError, "points of a --mesh"),
        ((speech, *out, "--model", sdfa_folder, "-e", "sad"), EmotionError, "no emotion"),
        ((speech, *out, "--model", tmp_path), CheckpointError, "no model there"),
        ((speech, *out, "--identity", tmp_path / "none.npz"), RigError, "none.npz does not exist"),
        ((tmp_path / "none.wav", *out), DeitalkError, "there is no recording"),
        ((speech, *out, "--mesh", tmp_path / "none.obj"), RigError | OSError, "none.obj"),
    ):
        result = run(*arguments)
        assert isinstance(result.exception, error), (arguments, result.exception)
        assert said in str(result.exception) and "\n" not in str(result.exception)
    assert [p.name for p in tmp_path.iterdir()] == ["speech.wav"]


@pytest.mark.slow
def test_speech_moves_the_ict_face(shared, tmp_path, acted, request):
    """One command from speech to a foreign topology; the corners of the mouth rise with joy."""
    target, landmarks = ict(shared)
    write_obj(tmp_path / "ict.obj", target)
    (tmp_path / "marks.json").write_text(json.dumps(landmarks))
    sample = request.config.rootpath / SAMPLE
    rises = {}
    for emotion in ("neutral", "happy"):
        result = run(
            sample, "-e", emotion, "-o", tmp_path / f"{emotion}.npz", "--mesh",
            tmp_path / "ict.obj", "--landmarks", tmp_path / "marks.json",
        )  # fmt: skip
        assert result.exit_code == 0, result.output
        with np.load(tmp_path / f"{emotion}.npz") as file:
            vertices = file["vertices"]
        corner = landmarks["mouth_corner_left"]
        rises[emotion] = (vertices - target.vertices)[:, corner, 1].mean()
    assert len(vertices) == len(acted["happy"].vertices)
    assert rises["happy"] - rises["neutral"] > 0.1  # cm


@pytest.mark.slow
def test_retargeted_sequence_closes_the_lips_of_another_head(acted, network, tmp_path):
    """Ada's motion on Bruno's mesh, against Bruno's head in the poses of the same curves."""
    from rig.mesh import TriMesh
    from rig.retarget.retarget_files import retarget_sequence

    happy, cage = acted["happy"], build_head(0).slices["cage"]
    ada, bruno = build_head(0), build_head("Bruno")
    write_obj(tmp_path / "bruno.obj", TriMesh(bruno.cage.vertices, bruno.cage.faces))
    (tmp_path / "marks.json").write_text(json.dumps(bruno.landmarks))
    report = retarget_sequence(
        TriMesh(ada.cage.vertices, ada.cage.faces), happy.vertices[:, cage],
        tmp_path / "bruno.obj", tmp_path / "out.npz", fps=30, tolerance=0.002,
        source_landmarks=ada.landmarks, landmarks=tmp_path / "marks.json",
    )  # fmt: skip
    assert report.way == "sequence" and report.frames == len(happy.vertices)
    with np.load(tmp_path / "out.npz") as file:
        carried = file["vertices"]
    truth = animate_mesh(happy.recording, "happy", model=network, speaker="Bruno").vertices[:, cage]
    lips = np.concatenate(bruno.lip_rims)
    moved = np.linalg.norm(truth - bruno.cage.vertices, axis=-1)[:, lips].mean()
    error = np.linalg.norm(carried - truth, axis=-1)[:, lips].mean()
    gaps, wanted = (
        10 * np.median(np.abs(x[:, bruno.lip_rims[0], 1] - x[:, bruno.lip_rims[1], 1]), axis=1)
        for x in (carried, truth)
    )
    assert error < 0.2 * moved
    closed = wanted < 0.3
    assert closed.any() and np.median(gaps[closed]) < 1.0
