"""Registration and transfer: geometry against brute force, laws on the embedded head, the ICT face."""

import json

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from rig.errors import FormatError, MeshError
from rig.mesh.closest import ClosestPoints, closest_barycentric
from rig.mesh.deformation import similarity
from rig.mesh.trimesh import TriMesh, components
from rig.retarget.found_landmarks import guess_landmarks
from rig.retarget.landmarks import LANDMARKS, NEEDED, check_landmarks, read_landmarks
from rig.retarget.lids import fit_lids
from rig.retarget.lips import _along_slit, lip_pairs
from rig.retarget.registration import lip_labels, register
from rig.retarget.transfer import local_jacobians, transfer_displacements

PLANES = TriMesh(
    [[0, 0, 0], [4, 0, 0], [0, 4, 0], [0, 0, 1], [4, 0, 1], [0, 4, 1]], [[0, 1, 2], [3, 5, 4]]
)
"""Two triangles one over the other, facing up and down."""


@pytest.fixture(scope="module")
def head():
    from rig.retarget.head_source import source_head

    return source_head()


def subset(head, *names):
    chosen = [head.rig.shapes.names.index(name) for name in names]
    return head.rig.shapes.deltas[chosen].astype(np.float64)


SHAPES = (
    "CTRL_C_jaw.ty",
    "CTRL_L_mouth_cornerPull.ty",
    "CTRL_L_eye_blink.ty",
    "CTRL_L_brow_down.ty",
)


def shuffled(mesh, landmarks, rng, matrix, shift):
    """The mesh moved by an affine map, its vertices and triangles in another order."""
    order = rng.permutation(len(mesh.vertices))
    new_index = np.argsort(order)
    moved = TriMesh(mesh.vertices[order] @ matrix.T + shift, rng.permutation(new_index[mesh.faces]))
    return moved, {name: int(new_index[v]) for name, v in landmarks.items()}, order


def test_closest_point_against_dense_sampling(rng):
    corners = rng.normal(size=(60, 3, 3))
    points = rng.normal(scale=2, size=(60, 3))
    weights, distance = closest_barycentric(points, corners)
    np.testing.assert_allclose(weights.sum(axis=1), 1.0)
    assert weights.min() >= 0
    u, v = np.meshgrid(np.linspace(0, 1, 120), np.linspace(0, 1, 120))
    inside = u + v <= 1
    grid = np.stack([1 - u - v, u, v], axis=-1)[inside]
    sampled = np.einsum("sk,qkc->qsc", grid, corners)
    brute = np.linalg.norm(sampled - points[:, None], axis=-1).min(axis=1)
    assert (distance <= brute + 1e-12).all()
    np.testing.assert_allclose(distance, brute, atol=0.03)
    foot = np.einsum("qk,qkc->qc", weights, corners)
    np.testing.assert_allclose(np.linalg.norm(points - foot, axis=1), distance)


def test_normals_and_labels_choose_the_triangle():
    search = ClosestPoints(PLANES, labels=[1, 1, 1, -1, -1, -1])
    point = [[1.0, 1.0, 0.9]]
    assert search.query(point).triangles[0] == 1
    assert search.query(point, normals=[[0, 0, 1]]).triangles[0] == 0
    assert search.query(point, labels=[1]).triangles[0] == 0
    refused = search.query(point, normals=[[0, 0, 1]], labels=[-1])
    assert not refused.allowed[0]


def test_similarity_is_recovered(rng):
    points = rng.normal(size=(12, 3))
    turn = Rotation.random(rng=rng).as_matrix()
    scale, rotation, shift = similarity(points, 0.01 * points @ turn.T + [1, 2, 3])
    assert scale == pytest.approx(0.01)
    np.testing.assert_allclose(rotation, turn, atol=1e-12)
    np.testing.assert_allclose(shift, [1, 2, 3], atol=1e-12)


def test_landmarks_from_json_and_csv(tmp_path):
    mesh = TriMesh(
        np.arange(60.0).reshape(20, 3) + np.eye(20, 3), [[i, i + 1, i + 2] for i in range(18)]
    )
    wanted = {name: i for i, name in enumerate(NEEDED)}
    (tmp_path / "a.json").write_text(
        json.dumps(wanted | {"chin": (mesh.vertices[7] + 0.1).tolist()})
    )
    assert read_landmarks(tmp_path / "a.json", mesh) == wanted | {"chin": 7}
    (tmp_path / "a.csv").write_text(
        "name,vertex\n" + "".join(f"{n},{v}\n" for n, v in wanted.items())
    )
    assert read_landmarks(tmp_path / "a.csv", mesh) == wanted
    (tmp_path / "a.csv").write_text(
        "\ufeffvertex;Name\r\n;\r\n" + "".join(f"{v};{n}\r\n" for n, v in wanted.items())
    )
    assert read_landmarks(tmp_path / "a.csv", mesh) == wanted
    rows = [f"{n};{';'.join(map(str, mesh.vertices[v]))}\n" for n, v in wanted.items()]
    (tmp_path / "b.csv").write_text("name;x;y;z\n" + "".join(rows).replace(".", ","))
    assert read_landmarks(tmp_path / "b.csv", mesh) == wanted
    rows = [f"{n},{','.join(map(str, mesh.vertices[v]))}\n" for n, v in wanted.items()]
    (tmp_path / "b.csv").write_text("name,x,y,z\n" + "".join(rows))
    assert read_landmarks(tmp_path / "b.csv", mesh) == wanted


@pytest.mark.parametrize(
    ("text", "error", "words"),
    [
        ("[1, 2]", FormatError, "is no landmark file"),
        ('{"chin": "low"}', MeshError, "give a vertex number or"),
        ('{"chin": 3}', MeshError, "landmarks lack mouth_corner_left"),
        ('{"beard": 3}', MeshError, "unknown landmark 'beard'"),
    ],
)
def test_read_landmarks_rejects(tmp_path, text, error, words):
    (tmp_path / "a.json").write_text(text)
    with pytest.raises(error, match=words):
        read_landmarks(tmp_path / "a.json", PLANES)


def test_head_has_all_landmarks_at_their_places(head):
    assert set(head.landmarks) == set(LANDMARKS)
    at = {name: head.mesh.vertices[v] for name, v in head.landmarks.items()}
    for name, point in at.items():
        if name.endswith("left"):
            mirror = at[name[:-4] + "right"]
            assert point[0] > 0.5
            np.testing.assert_allclose(point * [-1, 1, 1], mirror, atol=0.1)
        elif not name.endswith("right"):
            assert abs(point[0]) < 0.05
    heights = [at[n][1] for n in ("brow_left", "eye_upper_left", "eye_lower_left", "nose_tip",
               "nose_base", "upper_lip_top", "upper_rim", "lower_lip_bottom", "chin")]  # fmt: skip
    assert heights == sorted(heights, reverse=True)
    assert at["nose_tip"][2] == max(p[2] for p in at.values())


def test_labels_do_not_cross_the_slit(head):
    labels = lip_labels(head.mesh, head.landmarks)
    jaw = subset(head, "CTRL_C_jaw.ty")[0]
    pairs = lip_pairs(head.mesh, head.landmarks, labels)
    assert len(pairs.upper) >= 20
    # Opening the jaw parts every pair: none lies within one lip.
    parted = np.linalg.norm(jaw[pairs.upper] - jaw[pairs.lower], axis=1)
    assert np.median(parted) > 0.5 and (parted > 0.02).mean() > 0.95


def test_shapes_follow_an_affine_map_of_the_head(head, rng):
    """Other units, another pose, other indices, inside out: displacements turn and scale along."""
    turn = Rotation.from_euler("xyz", [5, 30, -10], degrees=True).as_matrix()
    matrix = 0.01 * turn @ np.diag([1.15, 0.9, 1.0])
    target, landmarks, order = shuffled(head.mesh, head.landmarks, rng, matrix, [3, 2, 1])
    registration = register(head.mesh, head.landmarks, target.flipped(), landmarks)
    assert registration.inside_out
    assert registration.residual < 1e-3
    jacobian = local_jacobians(registration)
    assert np.abs(jacobian - matrix).max() < 0.05 * 0.01
    source = subset(head, *SHAPES)
    skin = registration.target_labels != 0
    moved = transfer_displacements(registration, source)
    expected = source[:, order] @ matrix.T
    error = np.linalg.norm(moved - expected, axis=-1) / 0.01
    assert error[:, skin].mean() < 0.03  # cm of the head's size
    assert error.mean() < 0.02


@pytest.mark.slow
def test_the_head_onto_itself_keeps_eyes_and_teeth_whole(head):
    registration = register(head.mesh, head.landmarks, head.mesh, head.landmarks)
    names = ("CTRL_C_jaw.ty", "CTRL_L_eye.tx", "CTRL_C_tongue_inOut.ty")
    source = subset(head, *names)
    moved = transfer_displacements(registration, source)
    error = np.linalg.norm(moved - source, axis=-1)  # cm
    labels = components(head.mesh)
    assert error[:, labels == 0].mean() < 0.01 and error[:, labels == 0].max() < 0.3
    assert error[:, labels > 0].mean() < 0.03
    # What is rigid on the head (gaze, teeth) stays rigid; the tongue bends.
    bent = np.zeros(len(names), bool)
    for label in range(1, labels.max() + 1):
        here = labels == label
        rest = head.mesh.vertices[here]
        for k, (before, after) in enumerate(zip(source[:, here], moved[:, here], strict=True)):
            assert bends(rest, before) or not bends(rest, after)
            bent[k] |= bends(rest, after)
    assert bent[2]


def bends(rest, delta):
    _, rotation, shift = similarity(rest, rest + delta, is_rigid=True)
    return bool(np.abs(rest @ rotation.T + shift - rest - delta).max() > 0.01)


@pytest.mark.slow
def test_lids_travel_as_far_as_the_eye_opens(head):
    """With landmarks of an eye half as open, the blink across the slit halves."""
    registration = register(head.mesh, head.landmarks, head.mesh, head.landmarks)
    blink = subset(head, "CTRL_L_eye_blink.ty", "CTRL_C_jaw.ty")
    at = head.mesh.vertices
    upper, lower = head.landmarks["eye_upper_left"], head.landmarks["eye_lower_left"]
    middle = 0.5 * (at[upper] + at[lower])
    half = int(np.argmin(np.linalg.norm(at - (0.5 * at[upper] + 0.5 * middle), axis=1)))
    same = fit_lids(registration, head.landmarks, head.landmarks, blink)
    np.testing.assert_allclose(same, blink, atol=0.02)
    marks = head.landmarks | {"eye_upper_left": half}
    fitted = fit_lids(registration, head.landmarks, marks, blink)
    slit = at[half] - at[lower]
    ratio = np.linalg.norm(slit) / np.linalg.norm(at[upper] - at[lower])
    across = slit / np.linalg.norm(slit)
    near = np.linalg.norm(at - middle, axis=1) < 0.3 * np.linalg.norm(
        at[head.landmarks["eye_outer_left"]] - at[head.landmarks["eye_inner_left"]]
    )
    near &= components(head.mesh) == 0
    before, after = blink[0, near] @ across, fitted[0, near] @ across
    assert after.sum() / before.sum() == pytest.approx(ratio, abs=0.12)
    chin = head.landmarks["chin"]
    np.testing.assert_allclose(fitted[1, chin], blink[1, chin], atol=1e-6)


@pytest.mark.slow
def test_landmarks_are_found_without_help(head):
    """The head itself, z up and in metres: rims exactly a pair, everything within millimetres.

    Its lids have no open rims, so they are not found.
    """
    axes = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
    mesh = TriMesh(0.01 * head.mesh.vertices @ axes.T, head.mesh.faces)
    guess = guess_landmarks(mesh, head.mesh, head.landmarks)
    check_landmarks(guess, len(mesh.vertices))
    at = head.mesh.vertices
    apart = {n: np.linalg.norm(at[v] - at[head.landmarks[n]]) for n, v in guess.items()}
    assert np.mean(list(apart.values())) < 0.25
    for side in ("left", "right"):
        assert apart[f"mouth_corner_{side}"] < 0.6
    assert not any("eye_upper" in name for name in guess)
    labels = lip_labels(head.mesh, head.landmarks)
    assert labels[guess["upper_rim"]] == 1
    assert labels[guess["lower_rim"]] == -1


def test_correction_of_one_pair_is_spread_along_the_slit():
    """Corrections are a weighted mean along the slit: even ones stay, a lone one is spread."""
    slit = np.column_stack([np.linspace(0, 5, 51), np.zeros(51), np.zeros(51)])
    even = np.full((1, 51, 3), 0.3)
    np.testing.assert_allclose(_along_slit(slit, even, 0.2), even)
    lone = np.zeros((1, 51, 3))
    lone[0, 25, 1] = 1
    spread = _along_slit(slit, lone, 0.2)[0, :, 1]
    assert spread[25] < 0.35 and spread.argmax() == 25
    np.testing.assert_allclose(spread, spread[::-1], atol=1e-12)
    assert spread[25 + 2] / spread[25] == pytest.approx(np.exp(-1))  # 2 mm off, at the reach
    assert spread.sum() == pytest.approx(1, abs=1e-6)
