"""Neutral geometry of the head: manifold, symmetric, closed; distinct identities."""

import numpy as np
import pytest

from rig.errors import RigError
from rig.face import IDENTITIES, Identity, build_head
from rig.face.geometry.mesh import (
    Mesh,
    edge_counts,
    ellipsoid,
    head_distance,
    mirrored,
    project,
    vertex_normals,
)
from rig.face.geometry.skin import build_skin
from rig.face.geometry.topology import EYE_L, EYE_R, FILLER, MOUTH, MOUTH_COUNT
from tests.each import each


@pytest.fixture(scope="module")
def head():
    return build_head(0)


def test_skin_has_no_edge_with_more_than_two_faces(head):
    _, uses = edge_counts(head.skin.faces)
    assert uses.max() == 2


def test_skin_is_open_only_at_the_neck_and_behind_the_lids(head):
    edges, uses = edge_counts(head.skin.faces)
    border = np.unique(edges[uses == 1])
    kind, ring = head.features.kind[border], head.features.ring[border]
    neck = kind == FILLER
    assert np.allclose(head.skin.vertices[border[neck], 1], head.skin.vertices[:, 1].min())
    assert set(kind[~neck]) == {EYE_L, EYE_R} and set(ring[~neck]) == {-1}


def test_skin_is_one_piece_of_a_few_thousand_triangles(head):
    from scipy.sparse.csgraph import connected_components

    from rig.face.geometry.mesh import adjacency

    count, _ = connected_components(adjacency(head.skin.faces, len(head.skin.vertices)))
    assert count == 1
    assert 4000 <= len(head.skin.faces) <= 9000


def test_neighbouring_faces_have_the_same_orientation(head):
    faces = head.skin.faces
    directed = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    assert len(np.unique(directed, axis=0)) == len(directed)


def test_normals_point_away_from_the_head(head):
    normals = vertex_normals(head.skin.vertices, head.skin.faces)
    crown = head.skin.vertices[:, 1].argmax()
    nose = np.where(head.features.kind == FILLER, head.skin.vertices[:, 2], 0).argmax()
    assert normals[crown, 1] > 0.8
    assert normals[nose, 2] > 0.5


def test_left_and_right_are_mirror_images(head):
    flipped = head.skin.vertices[head.features.mirror] * [-1, 1, 1]
    assert np.abs(flipped - head.skin.vertices).max() < 1e-9
    assert (head.features.mirror[head.features.mirror] == np.arange(len(flipped))).all()


def test_lips_meet_at_rest(head):
    rim = head.skin.vertices[head.features.loop(MOUTH, 0)]
    upper = np.arange(1, MOUTH_COUNT // 2)
    gap = np.linalg.norm(rim[upper] - rim[MOUTH_COUNT - upper], axis=1)
    assert gap.max() < 0.02  # 0.2 mm


def test_teeth_stand_behind_the_closed_lips(head):
    rim = head.skin.vertices[head.features.loop(MOUTH, 0)]
    for name in ("teeth_upper", "teeth_lower"):
        assert head.parts[name].vertices[:, 2].max() < rim[:, 2].max() - 0.2


@pytest.mark.slow
@pytest.mark.parametrize("number", range(len(IDENTITIES)))
def test_every_identity_shares_topology_and_keeps_lids_off_the_eye(number):
    skin = build_skin(IDENTITIES[number])
    assert np.array_equal(skin.faces, build_head(0).skin.faces)
    for kind, side in ((EYE_L, 1), (EYE_R, -1)):
        away = skin.vertices[skin.kind == kind] - skin.anatomy.eye * [side, 1, 1]
        assert np.linalg.norm(away, axis=1).min() > skin.anatomy.eye_radius


@pytest.mark.slow
def test_identities_are_distinct_people():
    skins = np.stack([build_skin(i).vertices for i in IDENTITIES])
    assert len(IDENTITIES) >= 8
    for a in range(len(skins)):
        for b in range(a):
            distance = np.linalg.norm(skins[a] - skins[b], axis=1)
            assert np.percentile(distance, 90) > 0.15, (IDENTITIES[a].name, IDENTITIES[b].name)


@each("identity", [-1, 12, "Nobody"])
def test_unknown_identity_lists_the_known_ones(identity):
    with pytest.raises(RigError, match="Ada, Bruno"):
        build_head(identity)


def test_ellipsoid_distance_is_exact_on_a_sphere():
    points = np.array([[3.0, 0, 0], [0, 0, 0.5], [0, -2, 0]])
    distance = ellipsoid(points, (0, 0, 0), (2, 2, 2))
    assert distance == pytest.approx([1.0, -1.5, 0.0], abs=1e-6)


def test_projected_points_lie_on_the_surface():
    directions = np.array([[0, 0, 1.0], [1, 0, 0], [0, 1, 0], [0.3, -0.4, 0.8]])
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    points = project(directions, Identity())
    assert np.abs(head_distance(points, Identity())).max() < 1e-4


def test_mirrored_mesh_keeps_its_volume_positive():
    corner = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1.0]])
    faces = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
    mesh = Mesh(corner, faces, np.ones((4, 3)), np.ones(4))

    def volume(m):
        a, b, c = (m.vertices[m.faces[:, k]] for k in range(3))
        return (a * np.cross(b, c)).sum() / 6

    assert volume(mesh) == pytest.approx(1 / 6)
    assert volume(mirrored(mesh)) == pytest.approx(1 / 6)
