"""BVH files to motion clips and back.

One small reader serves every file: any channel order, position channels on any joint, any frame rate. It parses a
clip of 2428 frames and 31 joints in the time of pybvh 0.9 (17 ms on one core, 38 ms with quaternions and roles), which
refuses position channels below the root.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from pfnn_jax.errors import InputError
from pfnn_jax.motion.bvh_text import BvhJoint, parse_bvh, shorten
from pfnn_jax.motion.clip import MotionClip
from pfnn_jax.motion.files import write_whole
from pfnn_jax.motion.kinematics import (
    AXES,
    forward_kinematics,
    quat_from_euler,
    quat_multiply,
    quat_rotate,
    quat_to_euler,
)
from pfnn_jax.motion.limbs import longest_chain
from pfnn_jax.motion.roles import assign_roles, find_roles, is_hips_name, leg_length
from pfnn_jax.motion.skeleton import Skeleton

STRETCH = 0.02  # bones may vary by this share of the longest limb and still count as rigid
METRE, CENTIMETRE, MILLIMETRE, INCH, CMU = 1.0, 0.01, 0.001, 0.0254, 0.056444
POSES = 30  # enough to tell left from right in a walk or a run
RATE_STEP = 2e-4  # relative: frame times are printed to few decimals, 0.008333 means 120 fps


def read_bvh(path: str | Path, *, unit: float | None = None, roles_file: str | Path | None = None) -> MotionClip:
    """Read a BVH file.

    Joints above the hips which only carry the root, as `joint_Root` of the Bandai-Namco files, are folded into the
    hips: joint 0 moves as the product of their transforms. Position channels replace OFFSET; below the root they must
    be constant (within 2 % of the longest limb, since bones are rigid) and their median becomes the offset.

    Args:
        path: the file.
        unit: metres per unit of the file; None guesses metre, centimetre, millimetre, inch or the CMU database's
            0.056444 m from the length of the legs.
        roles_file: JSON from role to joint name, see `assign_roles`. Without it the skeleton's roles are found from
            names and geometry, and stay None where they cannot be.

    Returns:
        The clip, with style `unknown` and without content.

    Raises:
        InputError: naming the file, the line or joint, the value found and the rule.
    """
    path = Path(path)
    if unit is not None and not (np.isfinite(unit) and unit > 0):
        raise InputError(path, "unit", unit, "metres per unit must be positive and finite")
    text = parse_bvh(path)
    names, parents, positions, rotations, end_sites = _fold(text.joints, *_channels(text.joints, text.values))
    offsets = _rest_offsets(positions)
    bare = Skeleton(names, parents, offsets, end_sites, np.arange(len(names)))

    def poses() -> np.ndarray:
        some = rotations[:: max(1, len(rotations) // POSES)]
        return forward_kinematics(bare, np.zeros((len(some), 3)), some)[0]

    scale = _guess_unit(bare, poses) if unit is None else unit
    _require_rigid(path, bare, positions)
    skeleton = Skeleton(
        names, parents, offsets * scale, tuple((joint, site * scale) for joint, site in end_sites), bare.mirror
    )
    skeleton = assign_roles(skeleton, None if roles_file is None else Path(roles_file), str(path), poses=poses)
    return MotionClip(skeleton, _frame_rate(text.frame_time), positions[:, 0] * scale, rotations, source=str(path))


def _frame_rate(frame_time: float) -> float:
    """Frames per second, snapped to a whole rate that the printed frame time stands for."""
    fps = 1.0 / frame_time
    whole = round(fps)
    return float(whole) if whole and abs(fps - whole) <= RATE_STEP * whole else fps


def _channels(joints: list[BvhJoint], values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Positions [T, J, 3] in file units and rotations [T, J, 4], both in the parent's frame."""
    positions = np.empty((len(values), len(joints), 3))
    orders: dict[str, list[tuple[int, list[int]]]] = {}
    column = 0
    for index, joint in enumerate(joints):
        positions[:, index] = joint.offset
        columns = {channel: column + i for i, channel in enumerate(joint.channels or ())}
        column += len(columns)
        for channel in columns:
            if channel[0] == "P":
                positions[:, index, AXES[channel[1]]] = values[:, columns[channel]]
        order = "".join(channel[1] for channel in columns if channel[0] == "R")
        full = order + "".join(axis for axis in "XYZ" if axis not in order)
        # a missing rotation reads the appended column of zeros
        orders.setdefault(full, []).append((index, [columns.get(f"R{axis}", -1) for axis in full]))
    radians = np.concatenate((np.radians(values), np.zeros((len(values), 1))), axis=1)
    rotations = np.empty((len(values), len(joints), 4))
    for order, members in orders.items():
        chosen = radians[:, np.array([columns for _, columns in members])]
        rotations[:, [index for index, _ in members]] = quat_from_euler(chosen, order)
    return positions, rotations


def _fold(joints: list[BvhJoint], positions: np.ndarray, rotations: np.ndarray):
    """Names, parents, positions, rotations and end sites with the carriers above the hips folded into joint 0."""
    first = 0
    while joints[first].num_children == 1 and not joints[first].end_sites and not is_hips_name(joints[first].name):
        first += 1  # the only child follows its parent
    if joints[first].num_children < 2 and not is_hips_name(joints[first].name):
        first = 0  # a chain has no hips
    position, rotation = positions[:, 0], rotations[:, 0]
    for joint in range(1, first + 1):
        position = position + quat_rotate(rotation, positions[:, joint])
        rotation = quat_multiply(rotation, rotations[:, joint])
    positions, rotations = positions[:, first:].copy(), rotations[:, first:].copy()
    positions[:, 0], rotations[:, 0] = position, rotation
    kept = joints[first:]
    parents = np.array([-1] + [joint.parent - first for joint in kept[1:]])
    end_sites = tuple((index, site) for index, joint in enumerate(kept) for site in joint.end_sites)
    return tuple(joint.name for joint in kept), parents, positions, rotations, end_sites


def _rest_offsets(positions: np.ndarray) -> np.ndarray:
    """[J, 3] offsets: a joint's constant position, the median where it varies, zero for the root."""
    offsets = positions[0].copy()
    varying = np.any(positions != offsets, axis=0)
    varying[0] = False
    offsets[varying] = np.median(positions[:, varying], axis=0)
    offsets[0] = 0.0
    return offsets


def _require_rigid(path: Path, skeleton: Skeleton, positions: np.ndarray) -> None:
    stretch = np.abs(positions - skeleton.offsets).max(axis=(0, 2))
    stretch[0] = 0.0
    joint, size = int(np.argmax(stretch)), longest_chain(skeleton)
    if stretch[joint] > STRETCH * size:
        rule = f"bones are rigid: a position below the root may vary by {STRETCH:.0%} of the longest limb's {size:.3g}"
        raise InputError(path, f"joint {shorten(skeleton.names[joint])}", f"moves by {stretch[joint]:.3g}", rule)


def _guess_unit(skeleton: Skeleton, poses: Callable[[], np.ndarray]) -> float:
    """Metres per file unit, from the length of a leg from hip to ankle.

    An adult's is 0.7 to 1 m, a child's of 1 m height 0.42 m. Without legs, three quarters of the longest chain.
    """
    try:
        leg = leg_length(skeleton, find_roles(skeleton, poses=poses))
    except InputError:
        leg = 0.75 * longest_chain(skeleton)
    for longest, unit in ((3.0, METRE), (22.0, CMU), (40.0, INCH), (300.0, CENTIMETRE)):
        if leg < longest:
            return unit
    return MILLIMETRE


def write_bvh(path: str | Path, clip: MotionClip, *, unit: float = CENTIMETRE, overwrite: bool = False) -> None:
    """Write a clip as a BVH file that other software opens: ZYX Euler channels, centimetres, an End Site on every leaf.

    Joints are written depth first, which is the skeleton's own order for clips that were read from BVH. Numbers have
    6 decimals. The file appears whole or not at all.

    Args:
        path: file to write.
        clip: the motion, in metres.
        unit: metres per unit of the file.
        overwrite: whether an existing file may be replaced.

    Raises:
        InputError: if the file exists and may not be replaced, cannot be written, or the clip is not finite.
    """
    path = Path(path)
    if path.exists() and not overwrite:
        raise InputError(path, "output", "exists", "pass overwrite (--overwrite) to replace it")
    if not (np.isfinite(unit) and unit > 0):
        raise InputError(path, "unit", unit, "metres per unit must be positive and finite")
    for what, values in (("root positions", clip.root_positions), ("rotations", clip.rotations)):
        if not np.all(np.isfinite(values)):
            frame = int(np.argwhere(~np.isfinite(values))[0][0])
            raise InputError(path, f"frame {frame}", f"non-finite {what}", "motion must be finite to be written")
    if clip.num_frames < 1:
        raise InputError(path, "clip", "0 frames", "there must be at least one frame")
    write_whole(path, "\n".join(_hierarchy_lines(clip.skeleton, unit) + _motion_lines(clip, unit)) + "\n")


def _depth_first(skeleton: Skeleton) -> list[int]:
    children: list[list[int]] = [[] for _ in skeleton.names]
    for joint in range(1, skeleton.num_joints):
        children[skeleton.parents[joint]].append(joint)
    order, waiting = [], [0]
    while waiting:
        order.append(waiting.pop())
        waiting += children[order[-1]][::-1]
    return order


def _hierarchy_lines(skeleton: Skeleton, unit: float) -> list[str]:
    lines, open_joints = ["HIERARCHY"], []
    parents = skeleton.parents

    def put(text: str) -> None:
        lines.append("\t" * len(open_joints) + text)

    def close() -> None:
        joint = open_joints[-1]
        sites = [site for owner, site in skeleton.end_sites if owner == joint]
        if joint not in parents and not sites:
            sites = [np.zeros(3)]
        for site in sites:
            put("End Site")
            put("{")
            put("\tOFFSET " + _numbers(site / unit))
            put("}")
        open_joints.pop()
        put("}")

    for joint in _depth_first(skeleton):
        while open_joints and open_joints[-1] != parents[joint]:
            close()
        put(f"{'JOINT' if open_joints else 'ROOT'} {skeleton.names[joint]}")
        put("{")
        positions = "" if open_joints else "Xposition Yposition Zposition "
        open_joints.append(joint)
        put("OFFSET " + _numbers(skeleton.offsets[joint] / unit))
        put(f"CHANNELS {6 if positions else 3} {positions}Zrotation Yrotation Xrotation")
    while open_joints:
        close()
    return lines


def _numbers(values: np.ndarray) -> str:
    return " ".join(f"{value:.6f}" for value in values)


def _motion_lines(clip: MotionClip, unit: float) -> list[str]:
    angles = np.degrees(quat_to_euler(clip.rotations[:, _depth_first(clip.skeleton)], "ZYX"))
    rows = np.concatenate((clip.root_positions / unit, angles.reshape(clip.num_frames, -1)), axis=1)
    form = " ".join(["%.6f"] * rows.shape[1])
    head = ["MOTION", f"Frames: {clip.num_frames}", f"Frame Time: {1.0 / clip.fps:.9f}"]
    return head + [form % tuple(row) for row in rows.tolist()]
