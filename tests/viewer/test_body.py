"""The body that is grown around a skeleton is closed, symmetric, moves with its joints, and stays at its bones."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy.spatial import KDTree

from pfnn_jax.motion.clip import MotionClip
from pfnn_jax.motion.clip_files import read_clip
from pfnn_jax.motion.gltf.write import glb_bytes
from pfnn_jax.motion.kinematics import forward_kinematics, quat_from_axis_angle, quat_multiply, quat_rotate
from pfnn_jax.motion.retargeting.reference import find_reference
from pfnn_jax.motion.roles import assign_roles
from pfnn_jax.motion.skeleton import Skeleton
from pfnn_jax.motion.skinned_mesh import SkinnedMesh
from pfnn_jax.motion.synthetic.walks import synthesise, synthetic_skeleton
from pfnn_jax.viewer.body import grow_body
from pfnn_jax.viewer.draw.annotated_clip import annotate_clips
from pfnn_jax.viewer.draw.own_mesh import own_mesh
from pfnn_jax.viewer.draw.palette import BODY, INK, rgb
from tests.motion.rigs import tree
from tests.motion.skeletons import BODY as ADULT

EXACT = 1e-9
MOST_FACES = 6000
SOLE = 0.015  # metres: the soles of a person who walks are this close to the floor when they stand
THICKEST = 0.2  # metres from the skin of a person to the nearest bone: at the head, whose joint is below it
WRITTEN = 1e-4  # metres: files of glTF hold 32-bit numbers
TILTED = 15.0  # degrees: how a person who walks holds the head
SYMMETRIC = 1e-6  # of the body's size
FOLDED = 1.15  # factor by which this distance may grow where limbs bend

Rows = list[tuple[str, int, tuple[float, float, float]]]


def skeleton_of(rows: Rows) -> Skeleton:
    """A skeleton with its map of rows (name, parent, offset)."""
    names = [name for name, _, _ in rows]
    return assign_roles(tree([(name, names[parent] if parent >= 0 else "", offset) for name, parent, offset in rows]))


def without(*words: str) -> Skeleton:
    """The adult without the joints whose names hold one of these words, and without what hangs on them."""
    kept: list[int] = []
    for joint, (name, parent, _) in enumerate(ADULT):
        if not any(word in name for word in words) and (parent < 0 or parent in kept):
            kept.append(joint)
    return skeleton_of([(ADULT[j][0], kept.index(ADULT[j][1]) if j else -1, ADULT[j][2]) for j in kept])


def scaled(factor: float, words: tuple[str, ...] = ("",)) -> Skeleton:
    """The adult with some bones shorter or longer."""
    return skeleton_of(
        [
            (name, parent, tuple(factor * np.array(offset)) if any(word in name for word in words) else offset)
            for name, parent, offset in ADULT
        ]  # type: ignore[arg-type]
    )


def with_spine(bones: int) -> Skeleton:
    """The adult with another number of joints in the spine."""
    spine = [(f"spine{k + 1}", k, (0.0, 0.47 / (bones + 1), 0.0)) for k in range(bones)]
    rows: Rows = [ADULT[0], *spine]
    last = bones
    for name, parent, offset in ADULT[2:]:
        if parent == 1:
            height = 0.47 / (bones + 1) + offset[1] - 0.35
            rows.append((name, last, (offset[0], height, offset[2])))
        else:
            rows.append((name, 0 if parent == 0 else parent + bones - 1, offset))
    return skeleton_of(rows)


BODIES = {
    "procedural": synthetic_skeleton,
    "adult": lambda: scaled(1.0),
    "child": lambda: scaled(0.5),
    "giant": lambda: scaled(30.0),
    "chibi": lambda: scaled(0.35, ("thigh", "calf", "foot")),
    "long arms": lambda: scaled(1.8, ("forearm", "hand")),
    "no arms": lambda: without("clavicle"),
    "no hands": lambda: without("hand"),
    "no feet": lambda: without("foot"),
    "no toes": lambda: without("toe"),
    "no clavicles": lambda: without("nothing"),
    "no head": lambda: without("head"),
    "one spine joint": lambda: with_spine(1),
    "seven spine joints": lambda: with_spine(7),
}


@pytest.fixture(scope="module")
def bodies() -> dict[str, tuple[Skeleton, SkinnedMesh]]:
    grown = {name: make() for name, make in BODIES.items()}
    return {name: (skeleton, grow_body(skeleton)) for name, skeleton in grown.items()}


@pytest.fixture(params=list(BODIES))
def grown(request, bodies) -> tuple[Skeleton, SkinnedMesh]:
    return bodies[request.param]


def parts_of(mesh: SkinnedMesh) -> np.ndarray:
    """The number of the connected part [V] of every vertex."""
    part = np.arange(len(mesh.vertices))
    while True:
        least = part.copy()
        for a, b in ((0, 1), (1, 2), (2, 0)):
            np.minimum.at(least, mesh.faces[:, a], part[mesh.faces[:, b]])
            np.minimum.at(least, mesh.faces[:, b], part[mesh.faces[:, a]])
        if np.array_equal(least, part):
            return part
        part = least


def volumes(mesh: SkinnedMesh, vertices: np.ndarray) -> np.ndarray:
    """The volume of every connected part."""
    a, b, c = np.moveaxis((vertices - vertices.mean(axis=0))[mesh.faces], 1, 0)
    _, part = np.unique(parts_of(mesh)[mesh.faces[:, 0]], return_inverse=True)
    return np.bincount(part, np.sum(np.cross(a, b) * c, axis=-1) / 6)


def test_bodies_have_a_map_and_few_faces(bodies):
    assert all(skeleton.humanoid is not None for skeleton, _ in bodies.values())
    assert all(1000 < len(mesh.faces) < MOST_FACES for _, mesh in bodies.values())


def test_parts_are_closed_and_look_outwards(grown):
    _, mesh = grown
    assert np.isfinite(mesh.vertices).all() and (volumes(mesh, mesh.vertices) > 0).all()
    edges = np.concatenate([mesh.faces[:, [a, b]] for a, b in ((0, 1), (1, 2), (2, 0))])
    assert len(np.unique(edges, axis=0)) == len(edges)  # no edge is run through twice in the same sense
    assert {tuple(edge) for edge in edges} == {tuple(edge) for edge in edges[:, ::-1]}
    np.testing.assert_allclose(np.linalg.norm(mesh.normals, axis=-1), 1.0, atol=EXACT)


def test_weights_sum_to_one_over_existing_joints(grown):
    skeleton, mesh = grown
    np.testing.assert_allclose(mesh.weights.sum(axis=1), 1.0, atol=EXACT)
    assert mesh.joints.shape[1] <= 4 and (mesh.weights >= 0).all()
    assert mesh.joints.min() >= 0 and mesh.joints.max() < skeleton.num_joints


def test_the_bind_pose_reproduces_the_vertices(grown):
    _, mesh = grown
    size = np.ptp(mesh.vertices, axis=0).max()
    posed = mesh.pose(mesh.bind_positions, mesh.bind_rotations)
    np.testing.assert_allclose(posed, mesh.vertices, atol=EXACT * size)


def test_a_rigid_motion_of_the_skeleton_moves_the_body_rigidly(grown):
    _, mesh = grown
    turn, shift = quat_from_axis_angle(np.array([0.6, 0.0, 0.8]), np.array(2.0)), np.array([1.0, -2.0, 3.0])
    moved = mesh.pose(quat_rotate(turn, mesh.bind_positions) + shift, quat_multiply(turn, mesh.bind_rotations))
    size = np.ptp(mesh.vertices, axis=0).max()
    np.testing.assert_allclose(moved, quat_rotate(turn, mesh.vertices) + shift, atol=EXACT * (1 + size))


def test_bodies_of_symmetric_skeletons_are_symmetric(grown):
    _, mesh = grown
    swapped = {rgb(BODY[f"left {part}"]): rgb(BODY[f"right {part}"]) for part in ("limb", "end")}
    swapped |= {right: left for left, right in swapped.items()}
    colours = [tuple(colour) for colour in mesh.colours.tolist()]
    for colour in set(colours):
        one = mesh.vertices[[c == colour for c in colours]]
        other = mesh.vertices[[c == swapped.get(colour, colour) for c in colours]] * [-1.0, 1.0, 1.0]
        apart, _ = KDTree(one).query(other)
        assert len(one) == len(other) and apart.max() < SYMMETRIC * np.ptp(mesh.vertices, axis=0).max()


def bones_of(skeleton: Skeleton, positions: np.ndarray) -> np.ndarray:
    """Start and end [B, 2, 3] of the bones of a pose."""
    children = np.flatnonzero(skeleton.parents >= 0)
    return np.stack([positions[skeleton.parents[children]], positions[children]], axis=1)


def distances(points: np.ndarray, bones: np.ndarray) -> np.ndarray:
    """The distance [N] of points from the nearest bone."""
    start, along = bones[:, 0], bones[:, 1] - bones[:, 0]
    share = np.einsum("nbc,bc->nb", points[:, None] - start, along) / np.maximum(np.sum(along**2, axis=-1), 1e-12)
    nearest = start + np.clip(share, 0.0, 1.0)[..., None] * along
    return np.linalg.norm(points[:, None] - nearest, axis=-1).min(axis=1)


@pytest.mark.parametrize("seed", range(3))
def test_no_vertex_leaves_the_body_when_limbs_bend_by_a_right_angle(bodies, seed):
    skeleton, mesh = bodies["adult"]
    random = np.random.default_rng(seed)
    axes = random.normal(size=(skeleton.num_joints, 3))
    axes /= np.linalg.norm(axes, axis=-1, keepdims=True)
    bends = [j for j, name in enumerate(skeleton.names) if name[2:] in ("upperarm", "forearm", "thigh", "calf", "hand")]
    rotations = np.tile([1.0, 0.0, 0.0, 0.0], (skeleton.num_joints, 1))
    rotations[bends] = quat_from_axis_angle(axes[bends], np.full(len(bends), np.pi / 2))
    positions, world = forward_kinematics(skeleton, np.zeros((1, 3)), rotations[None])
    before = distances(mesh.vertices, bones_of(skeleton, mesh.bind_positions)).max()
    after = distances(mesh.pose(positions[0], world[0]), bones_of(skeleton, positions[0])).max()
    assert before < THICKEST and after < FOLDED * before


@pytest.mark.parametrize(("joint", "axis"), [("l_calf", 0), ("l_forearm", 1), ("l_forearm", 2)])
def test_limbs_keep_most_of_their_volume_when_they_bend(bodies, joint, axis):
    skeleton, mesh = bodies["adult"]
    rotations = np.tile([1.0, 0.0, 0.0, 0.0], (skeleton.num_joints, 1))
    rotations[skeleton.names.index(joint)] = quat_from_axis_angle(np.eye(3)[axis], np.array(np.pi / 2))
    positions, world = forward_kinematics(skeleton, np.zeros((1, 3)), rotations[None])
    before, after = volumes(mesh, mesh.vertices), volumes(mesh, mesh.pose(positions[0], world[0]))
    assert (after > 0.85 * before).all()


@pytest.mark.parametrize("style", ["neutral", "zombie"])
def test_soles_stand_on_the_floor(style):
    clip, _ = synthesise(style, np.zeros(120), np.full(120, 1.0))
    mesh = grow_body(clip.skeleton)
    positions, rotations = forward_kinematics(clip.skeleton, clip.root_positions[::6], clip.rotations[::6])
    lowest = np.array([mesh.pose(p, r)[:, 1].min() for p, r in zip(positions, rotations, strict=True)])
    assert abs(np.median(lowest)) < SOLE


def test_the_face_looks_ahead_and_sides_have_their_colours(bodies):
    skeleton, mesh = bodies["adult"]
    visor = mesh.vertices[(mesh.colours == rgb(INK)).all(axis=1)]
    head = mesh.bind_positions[skeleton.names.index("head")]
    assert visor[:, 2].mean() > head[2] + 0.05 and visor[:, 1].min() > head[1]
    for side, sign in (("left", 1.0), ("right", -1.0)):
        limb = mesh.vertices[(mesh.colours == rgb(BODY[f"{side} end"])).all(axis=1)]
        assert (sign * limb[:, 0]).mean() > 0.1


def test_bodies_scale_with_their_skeletons(bodies):
    adult, child, giant = (bodies[name][1].vertices for name in ("adult", "child", "giant"))
    np.testing.assert_allclose(child, 0.5 * adult, atol=EXACT)
    np.testing.assert_allclose(giant, 30.0 * adult, atol=30 * EXACT)


def test_skeletons_without_a_map_have_sticks_and_a_single_joint_is_a_ball():
    skeleton = dataclasses.replace(synthetic_skeleton(), humanoid=None, roles=None)
    mesh = grow_body(skeleton)
    assert (volumes(mesh, mesh.vertices) > 0).all() and (mesh.weights.max(axis=1) == 1.0).all()
    ball = grow_body(Skeleton(("It",), np.array([-1]), np.zeros((1, 3)), (), np.array([0])))
    radius = np.linalg.norm(ball.vertices, axis=-1)
    assert radius.min() == pytest.approx(radius.max()) and volumes(ball, ball.vertices) > 0
    nothing = dataclasses.replace(skeleton, offsets=0 * skeleton.offsets, end_sites=())
    assert np.isfinite(grow_body(nothing).vertices).all()


def posed(mesh: SkinnedMesh, clip: MotionClip, frames: list[int]) -> np.ndarray:
    """Vertices [F, V, 3] of a body, relative to the clip's root, by height."""
    positions, rotations = forward_kinematics(clip.skeleton, clip.root_positions[frames], clip.rotations[frames])
    vertices = mesh.pose(positions, rotations) - positions[:, :1]
    return np.sort(vertices, axis=1)


def test_the_mesh_of_a_file_follows_the_clip_that_was_read_from_it(tmp_path):
    clip, _ = synthesise("neutral", np.full(60, 0.3), np.full(60, 1.0))
    path = tmp_path / "walk.glb"
    mesh = grow_body(clip.skeleton)
    path.write_bytes(glb_bytes(clip.skeleton, mesh, {"walk": clip}, root_motion=True))
    (annotated,) = annotate_clips([path])
    own, frames = annotated.mesh, [0, 20, 59]
    assert own is not None and len(own.faces) == len(mesh.faces)
    np.testing.assert_allclose(posed(own, annotated.clip, frames), posed(mesh, clip, frames), atol=WRITTEN)
    doubled = own_mesh(path, read_clip(path, unit=2.0))
    assert doubled is not None
    np.testing.assert_allclose(np.ptp(doubled.vertices, axis=0), 2.0 * np.ptp(own.vertices, axis=0), rtol=WRITTEN)
    assert own_mesh(path, clip_with_other_joints(clip)) is None and own_mesh("walk.bvh", clip) is None


def clip_with_other_joints(clip: MotionClip) -> MotionClip:
    names = tuple(f"{name}2" for name in clip.skeleton.names)
    return dataclasses.replace(clip, skeleton=dataclasses.replace(clip.skeleton, names=names))


def test_a_head_whose_end_site_points_aside_looks_ahead():
    clip, _ = synthesise("neutral", np.zeros(60), np.ones(60))
    body = clip.skeleton.humanoid
    assert body is not None and body.head is not None
    aside = np.array([0.2, 0.0, 0.0])
    sites = [(joint, aside if joint == body.head else site) for joint, site in clip.skeleton.end_sites]
    skeleton = dataclasses.replace(clip.skeleton, end_sites=tuple(sites))
    right, found = (find_reference(each, clip.rotations, body)[body.head] for each in (clip.skeleton, skeleton))
    assert abs(right @ found) > np.cos(np.radians(TILTED) / 2)
