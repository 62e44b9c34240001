"""Reflects rotations: of the world across a plane, and of each joint's own frame onto its partner's."""

from __future__ import annotations

import numpy as np

from pfnn_jax.motion.kinematics import quat_conjugate, quat_from_matrix, quat_multiply, quat_to_matrix
from pfnn_jax.motion.skeleton import Skeleton

ASYMMETRY = 0.1
"""Share of a joint's bone lengths by which left and right may differ in real skeletons."""

REFLECTIONS = np.array([[-1.0, 1.0, 1.0], [1.0, -1.0, 1.0], [1.0, 1.0, -1.0], [-1.0, -1.0, -1.0]])
"""Signs of the axes in the reflections that are tried first: across the planes of the axes, and through the origin."""

WORLD_REFLECTION = REFLECTIONS[0]
"""Across the plane x = 0."""

AXIS_TURNS = np.array([[0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0], [1.0, 0.0, 0.0, 0.0]])
"""Quaternions of the negatives of `REFLECTIONS`: half turns about an axis, and the identity."""

WORLD_TURN = AXIS_TURNS[0]

SAME_DIRECTION = 1e-5
"""Distance between unit vectors below which two bones have the same direction."""

DETERMINED = 1e-3
"""Strength, relative to all bones of a joint, from which they determine a direction."""

ALIGNED = 0.2
"""Difference, as of matrices, between a reflection and the nearest one along axes from which a frame is oblique."""


def frame_reflections(skeleton: Skeleton, rotations: np.ndarray) -> np.ndarray:
    """Returns the reflection of each joint's frame, which maps its bones to its partner's bones.

    The reflection C of a joint is the negative of a rotation, of which this returns the quaternion; C of the partner is
    the inverse. It is x to -x in skeletons whose zero pose is symmetric, and across other axes where bones lie along
    local X, as in the Bandai-Namco files. In general it is the orthogonal matrix of determinant -1 that fits the bones
    best. What the bones do not determine keeps the mirrored poses closest to the clip's own.

    Args:
        skeleton: J joints.
        rotations: [T, J, 4] of a clip on it, in the parents' frames.

    Returns:
        [J, 4] wxyz.
    """
    bones = _bones_of_frames(skeleton)
    axes = _axis_reflections(skeleton, rotations, bones)
    turns = AXIS_TURNS[axes].copy()
    matrices = REFLECTIONS[axes][:, :, None] * np.eye(3)
    oblique = _oblique_joints(skeleton, matrices, bones)
    if not oblique:
        return turns
    mean = _mean_rotations(rotations)
    for joint in oblique:
        partner = int(skeleton.mirror[joint])
        pairs = _bone_pairs(skeleton, joint, bones)
        likely = _likely_reflection(skeleton, joint, pairs, matrices, mean)
        matrices[joint] = _fit_reflection(pairs, likely, midline=partner == joint)
        matrices[partner] = matrices[joint].T
    turns[oblique] = quat_from_matrix(-matrices[oblique])
    partners = skeleton.mirror[oblique]
    paired = partners != oblique
    turns[partners[paired]] = quat_conjugate(turns[oblique][paired])
    return turns


def reflect_rotations(q: np.ndarray, outer: np.ndarray, inner: np.ndarray) -> np.ndarray:
    """Returns quaternions [T, J, 4] of the rotations O⁻¹ R I, for reflections O (outer) and I (inner).

    A reflection is the negative of a rotation, which is given as a quaternion: O⁻¹ R I = A⁻¹ R B for O = -A and I = -B.
    This is linear in the quaternion of R. Where A and B are half turns about axes, it permutes the components and
    changes their signs; applying it to the four unit quaternions shows how.

    Args:
        q: [T, J, 4] wxyz.
        outer: [J, 4] or [4] quaternions of A.
        inner: [J, 4] quaternions of B.
    """
    units = np.eye(4)[:, None]
    outer = np.broadcast_to(outer, inner.shape)
    # the inverse of a half turn is itself; its quaternion's sign is chosen so
    inverse = np.where(outer[:, :1] == 0, outer, quat_conjugate(outer))
    images = quat_multiply(quat_multiply(inverse, units), inner)  # [4, J, 4]
    source = np.argmax(np.abs(images), axis=0)  # [J, 4] part of q that each part of the result comes from
    sign = np.take_along_axis(images, source[None], axis=0)[0]
    oblique = np.flatnonzero((np.abs(sign) != 1).any(axis=1))
    if (source == np.arange(4)).all():  # where outer and inner are equal, as in symmetric zero poses
        reflected = q * sign
    else:
        reflected = np.take_along_axis(q, source[None], axis=-1) * sign
    if len(oblique):
        maps = images[:, oblique].swapaxes(0, 1)  # [K, 4, 4]
        reflected[:, oblique] = (q[:, oblique].swapaxes(0, 1) @ maps).swapaxes(0, 1)
    return reflected


def _bones_of_frames(skeleton: Skeleton) -> np.ndarray:
    """Returns whether the bone to each joint [J] counts for its parent's frame.

    Where bones lead to parts of the humanoid map, helper joints next to them do not count: exporters place them freely.
    """
    counts = np.ones(skeleton.num_joints, dtype=bool)
    counts[0] = False
    if skeleton.humanoid is None:
        return counts
    leads = np.zeros(skeleton.num_joints, dtype=bool)
    for joint in skeleton.humanoid.joints().values():
        for one in joint if isinstance(joint, tuple) else () if joint is None else (joint,):
            while one >= 0 and not leads[one]:
                leads[one] = True
                one = int(skeleton.parents[one])
    leads &= np.linalg.norm(skeleton.offsets, axis=1) > 0
    has_lead = np.zeros(skeleton.num_joints, dtype=bool)
    has_lead[skeleton.parents[1:][leads[1:]]] = True
    return counts & (leads | ~has_lead[skeleton.parents])


def _axis_reflections(skeleton: Skeleton, rotations: np.ndarray, bones: np.ndarray) -> np.ndarray:
    """Returns the index [J] in `REFLECTIONS` of the reflection along axes that fits each joint best."""
    misfit, length = _bone_misfit(skeleton, bones)
    fits = misfit <= misfit.min(axis=1, keepdims=True) + ASYMMETRY * length[:, None]
    chosen = np.zeros(skeleton.num_joints, dtype=int)
    if np.all(fits[:, 0]):
        return chosen  # the zero pose is symmetric, so every frame mirrors as the world does
    mean = _mean_rotations(rotations)
    for joint in range(skeleton.num_joints):
        partner, parent = skeleton.mirror[joint], skeleton.parents[joint]
        if partner < joint:
            chosen[joint] = chosen[partner]
        elif parent < 0:  # of the root's axes only the vertical one does not depend on the clip's heading
            chosen[joint] = _best(fits[joint], (mean[joint][1] ** 2 * REFLECTIONS).sum(axis=1))
        else:
            mirrored = REFLECTIONS[chosen[parent]][:, None] * mean[partner]
            closeness = [float(np.sum(mean[joint] * mirrored * signs)) for signs in REFLECTIONS]
            chosen[joint] = _best(fits[joint], np.array(closeness))
    return chosen


def _mean_rotations(rotations: np.ndarray) -> np.ndarray:
    """Returns the mean [J, 3, 3] of the rotation matrices of some frames."""
    return quat_to_matrix(rotations[:: max(1, len(rotations) // 100)]).mean(axis=0)


def _best(fits: np.ndarray, closeness: np.ndarray) -> int:
    return int(np.argmax(np.where(fits, closeness, -np.inf)))


def _bone_misfit(skeleton: Skeleton, bones: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Returns how far each reflection misses the partner's bones [J, 4], and the length of each joint's bones [J]."""
    both, parents = skeleton.mirror, skeleton.parents[bones]
    offsets, other = skeleton.offsets[bones], skeleton.offsets[both[bones]]
    missed = np.linalg.norm(REFLECTIONS * offsets[:, None] - other[:, None], axis=2)
    misfit, length = np.zeros((skeleton.num_joints, len(REFLECTIONS))), np.zeros(skeleton.num_joints)
    np.add.at(misfit, parents, missed)
    np.add.at(length, parents, np.linalg.norm(offsets, axis=1))
    return misfit + misfit[both], length + length[both]


def _oblique_joints(skeleton: Skeleton, matrices: np.ndarray, bones: np.ndarray) -> list[int]:
    """Returns the joints, one of each pair, whose bones no reflection along axes maps to their partner's.

    A joint without bones is one of them if a joint above it is: its frame is oblique too.
    """
    children, parents = np.flatnonzero(bones), skeleton.parents[bones]
    partners = skeleton.mirror[children]
    consistent = skeleton.parents[partners] == skeleton.mirror[parents]
    lengths = np.linalg.norm(skeleton.offsets, axis=1)
    least = 1e-9 * lengths.max()
    whole = consistent & (lengths[children] > least) & (lengths[partners] > least)
    unit = skeleton.offsets / np.maximum(lengths, 1e-300)[:, None]
    mapped = np.einsum("nij,nj->ni", matrices[parents], unit[children])
    wrong = whole & (np.linalg.norm(mapped - unit[partners], axis=1) > SAME_DIRECTION)
    if not wrong.any():
        return []
    oblique, bony = set(parents[wrong].tolist()), set(parents[whole].tolist())
    far = set(parents[wrong & (np.linalg.norm(mapped - unit[partners], axis=1) > ASYMMETRY)].tolist())
    for joint in range(1, skeleton.num_joints):
        if joint not in bony and int(skeleton.parents[joint]) in far:
            oblique.add(joint)
            far.add(joint)
    return sorted({min(joint, int(skeleton.mirror[joint])) for joint in oblique})


def _bone_pairs(skeleton: Skeleton, joint: int, bones: np.ndarray) -> np.ndarray:
    """Returns the sum [3, 3] of outer products of the partner's bones and a joint's bones, and of the reverse."""
    total = np.zeros((3, 3))
    partner = int(skeleton.mirror[joint])
    for child in np.flatnonzero((skeleton.parents == joint) & bones):
        other = int(skeleton.mirror[child])
        if skeleton.parents[other] == partner:
            total += np.outer(skeleton.offsets[other], skeleton.offsets[child])
    return total


def _likely_reflection(
    skeleton: Skeleton, joint: int, pairs: np.ndarray, matrices: np.ndarray, mean: np.ndarray
) -> np.ndarray:
    """Returns the reflection [3, 3] of a frame that keeps the mirrored poses closest to the clip's own.

    It is the one along axes where that is near the one that fits the joint's bones, given as `_bone_pairs`.
    """
    partner, parent = int(skeleton.mirror[joint]), int(skeleton.parents[joint])
    fitted = _fit_reflection(pairs, matrices[joint], midline=partner == joint)
    if parent < 0 or (pairs.any() and np.abs(fitted - matrices[joint]).max() <= ALIGNED):
        return matrices[joint]
    # mirrored: C_parent⁻¹ R_partner C, on average equal to R
    return mean[partner].T @ matrices[parent] @ mean[joint]


def _fit_reflection(bones: np.ndarray, likely: np.ndarray, *, midline: bool) -> np.ndarray:
    """Returns the orthogonal matrix of determinant -1 that maps bones best, and is `likely` where they leave it open.

    Args:
        bones: [3, 3] sum of outer products of wanted and given vectors.
        likely: [3, 3].
        midline: whether the matrix must be its own inverse, as the joint is its own partner.
    """
    size = np.linalg.norm(bones)
    bones = bones / size if size > 0 else bones
    return _fit_plane(bones, likely) if midline else _fit_orthogonal(bones, likely)


def _fit_orthogonal(bones: np.ndarray, likely: np.ndarray) -> np.ndarray:
    """Returns the orthogonal matrix of determinant -1 nearest to the bones; one bone leaves a turn about it open."""
    left, strength, right = np.linalg.svd(bones)
    if strength[1] <= DETERMINED:
        known = 1 if strength[0] > DETERMINED else 0
        inner = np.linalg.svd(left[:, known:].T @ likely @ right[known:].T)
        left = np.hstack((left[:, :known], left[:, known:] @ inner[0]))
        right = np.vstack((right[:known], inner[2] @ right[known:]))
    left[:, 2] *= -np.sign(np.linalg.det(left @ right))
    return left @ right


def _fit_plane(bones: np.ndarray, likely: np.ndarray) -> np.ndarray:
    """Returns the reflection across a plane that maps the bones best.

    Its normal is the direction that the bones reverse or, of those that they leave open, that `likely` reverses.
    """
    strength, axes = np.linalg.eigh(bones + bones.T)
    normal = axes[:, 0]
    open_axes = axes[:, np.abs(strength) <= DETERMINED]
    if strength[0] >= -DETERMINED and open_axes.shape[1]:
        normal = open_axes @ np.linalg.eigh(open_axes.T @ (likely + likely.T) @ open_axes)[1][:, 0]
    return np.eye(3) - 2 * np.outer(normal, normal)
