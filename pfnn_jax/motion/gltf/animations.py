"""Reads and samples the animations of a glTF file: the transforms of nodes at a uniform rate.

Source: glTF 2.0 specification, section 3.11 and appendix C (interpolation modes).
"""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from pfnn_jax.errors import InputError
from pfnn_jax.motion.gltf.accessors import read_accessor
from pfnn_jax.motion.gltf.container import Document, shown
from pfnn_jax.motion.gltf.nodes import LARGEST_PLACE, NodeTree
from pfnn_jax.motion.kinematics import quat_from_matrix, quat_normalise, quat_slerp, quat_to_matrix

PATHS = {"translation": "VEC3", "rotation": "VEC4", "scale": "VEC3"}
"""What of a node is animated, and the type of its values; weights of morph targets move no joint."""

INTERPOLATIONS = ("LINEAR", "STEP", "CUBICSPLINE")

RATES = (24.0, 25.0, 30.0, 48.0, 50.0, 60.0, 72.0, 90.0, 100.0, 120.0, 144.0, 240.0)
"""Frames per second at which motion is keyed; the least at whose frames all keys lie is taken."""

USUAL_RATE = 30.0
"""Frames per second of a clip with one key."""

OTHER_RATE = 60.0
"""Frames per second where keys lie at the frames of no rate."""

ON_FRAME = 0.03
"""Of a frame: keys this close to one lie on it; exporters write times with few digits."""

WHOLE_RATE = 1e-3
"""Relative difference up to which an even spacing of keys means a whole number of frames per second."""

MAX_SECONDS = 4 * 3600.0
"""Longest clip, far above any recording."""

MAX_POSES = 12_000_000
"""Most frames times joints of a clip: over an hour of 50 joints at 60 frames per second."""

CHUNK = 256
"""Frames whose matrices are held in memory at once."""

SKEWED = 1e-3
"""Cosine between the axes of a matrix below which it counts as free of shear."""

WALK = re.compile(r"(?<![a-z])walk(?:ing|s)?(?![a-z])", re.IGNORECASE)
OTHER_WALK = re.compile(
    r"back|strafe|left|right|gun|shoot|turn|start|stop|jump|sneak|crouch|carry|up|down", re.IGNORECASE
)
"""Words in the names of clips: a plain walk, and walks of other kinds."""


@dataclass(frozen=True, eq=False)
class Track:
    """The keys of a part of a node's transform.

    Attributes:
        node: its number.
        path: key of `PATHS`.
        interpolation: one of `INTERPOLATIONS`.
        times: [K] seconds, ascending.
        values: [K, 3] or, for rotations, [K, 4] wxyz.
        tangents: (into [K, ...], out of [K, ...]) each key, for cubic splines.
    """

    node: int
    path: str
    interpolation: str
    times: np.ndarray
    values: np.ndarray
    tangents: tuple[np.ndarray, np.ndarray] | None = None


@dataclass(frozen=True, eq=False)
class Sampled:
    """World transforms of some nodes at a uniform rate.

    Attributes:
        fps: frames per second.
        positions: [T, J, 3] in the space of the scene.
        rotations: [T, J, 4] wxyz; the nearest ones where transforms shear.
        scaled: whether scales of the nodes change by more than 1 %.
        note: what was assumed about the rate; empty if nothing was.
    """

    fps: float
    positions: np.ndarray
    rotations: np.ndarray
    scaled: bool
    note: str = ""


def clip_names(document: Document) -> list[str]:
    """Returns the names of a file's clips; those without a name, or with that of another, get a number of their own."""
    names: dict[str, None] = {}
    for number, animation in enumerate(document.items("animations")):
        name = animation.get("name")
        name = name if isinstance(name, str) and name else f"clip {number}"
        unique, copy = name, number
        while unique in names:
            unique, copy = f"{name} ({copy})", copy + 1
        names[unique] = None
    return list(names)


def choose_clip(document: Document, name: str | None) -> tuple[int, str]:
    """Returns the number of the clip to read, and a note if the file has several.

    Args:
        document: the file.
        name: of the clip, in any case; None takes the only one that moves, or else the plain walk.

    Raises:
        InputError: if the file has no clip, none of this name, or several that move of which none is called a walk.
    """
    names, path = clip_names(document), document.path
    if not names:
        raise InputError(path, "animations", "none", "must have a clip: this file holds a character without motion")
    rule = f"pass `--clip-name` with one of {_listed(names)}"
    if name is not None:
        same = [number for number, each in enumerate(names) if each == name]
        same = same or [number for number, each in enumerate(names) if each.lower() == name.lower()]
        if not same:
            raise InputError(path, "clip name", shown(name), rule)
        return same[0], ""
    accessors = document.items("accessors")
    keys = [_num_keys(animation, accessors) for animation in document.items("animations")]
    moving = [number for number, most in enumerate(keys) if most > 2] or list(range(len(names)))
    if len(moving) == 1:
        return moving[0], ""
    walks = sorted(
        (bool(OTHER_WALK.search(names[n])), len(names[n]), n)
        for n in moving
        if WALK.search(re.sub(r"(?<=[a-z])(?=[A-Z])|_", " ", names[n]))
    )
    if not walks:
        raise InputError(path, "animations", f"{len(names)} clips", rule)
    chosen = walks[0][-1]
    return chosen, f"of {len(names)} clips {shown(names[chosen])} is read: pass `--clip-name` for another"


def read_tracks(document: Document, number: int) -> list[Track]:
    """Returns the tracks of an animation.

    Raises:
        InputError: for accessors out of range, keys that do not ascend, too many, or values that are not finite.
    """
    place = f"animations[{number}]"
    animation = document.item("animations", number, place)
    samplers, channels = (_objects(document, animation, name, place) for name in ("samplers", "channels"))
    found: dict[tuple[int, str], Track] = {}
    known: dict[tuple[Any, ...], Track] = {}  # many channels may name the same keys, which are read once
    for at, channel in enumerate(channels):
        target = channel.get("target")
        target = target if isinstance(target, dict) else {}
        node, path = target.get("node"), target.get("path")
        if node is None or not isinstance(path, str) or path not in PATHS:  # morph targets, and pointers of extensions
            continue
        document.item("nodes", node, f"{place}.channels[{at}].target.node")
        sampler = channel.get("sampler")
        if not isinstance(sampler, int) or isinstance(sampler, bool) or not 0 <= sampler < len(samplers):
            rule = f"must be one of {len(samplers)} samplers"
            raise InputError(document.path, f"{place}.channels[{at}].sampler", shown(sampler), rule)
        if (node, path) in found:
            continue
        keys = (*_sampler(document, samplers[sampler], f"{place}.samplers[{sampler}]"), path)
        if keys not in known:
            known[keys] = _track(document, keys, node, f"{place}.samplers[{sampler}]")
            if (total := sum(len(track.times) for track in known.values())) > MAX_POSES:
                raise InputError(document.path, place, f"{total} keys", f"must be at most {MAX_POSES}")
        found[node, path] = replace(known[keys], node=node)
    return list(found.values())


def sample_nodes(
    document: Document, tree: NodeTree, tracks: Sequence[Track], nodes: Sequence[int], place: str = "animation"
) -> Sampled:
    """Returns the world transforms of nodes at a uniform rate, which is that of the keys.

    Args:
        document: the file, for messages.
        tree: all its nodes.
        tracks: of one animation.
        nodes: J nodes.
        place: of the animation, for messages.

    Raises:
        InputError: if none of the nodes is animated, the clip is too long, or its transforms are too large.
    """
    used = {each for node in nodes for each in tree.above(int(node))}
    tracks = [track for track in tracks if track.node in used]
    if not tracks:
        raise InputError(document.path, place, "moves no joint", "must animate joints of the character")
    start, stop = min(track.times[0] for track in tracks), max(track.times[-1] for track in tracks)
    if stop - start > MAX_SECONDS:
        raise InputError(document.path, place, f"{stop - start:.4g} s", f"must last at most {MAX_SECONDS:g} s")
    fps, note = find_rate(tracks)
    count = int((stop - start) * fps + ON_FRAME) + 1
    if count * len(used) > MAX_POSES:
        found = f"{count} frames of {len(used)} nodes"
        raise InputError(document.path, place, found, f"must be at most {MAX_POSES} frames times nodes")
    times = start + np.arange(count) / fps
    with np.errstate(over="ignore", invalid="ignore"):  # what is not finite then is refused
        parts = [_world(tree, tracks, nodes, used, times[first : first + CHUNK]) for first in range(0, count, CHUNK)]
        positions, rotations = (np.concatenate([part[which] for part in parts]) for which in (0, 1))
        good = (np.abs(positions) <= LARGEST_PLACE).all() and np.isfinite(rotations).all()
    if not good:
        rule = f"scales and translations must leave joints within {LARGEST_PLACE:g}"
        raise InputError(document.path, place, "too large", rule)
    scaled = any(_changes(values) for values in _different(track.values for track in tracks if track.path == "scale"))
    return Sampled(fps, positions, rotations, scaled, note)


def find_rate(tracks: Sequence[Track]) -> tuple[float, str]:
    """Returns the frames per second at which tracks are keyed, and a note if their keys lie at no common rate."""
    times = np.unique(np.concatenate(_different(track.times for track in tracks)))
    times = times - times[0]
    if len(times) < 2:
        return USUAL_RATE, ""
    most = max((track.times for track in tracks), key=len)
    for rate in RATES:
        if np.abs(times * rate - np.rint(times * rate)).max() < ON_FRAME:
            return rate, ""
    spacing = float(np.median(np.diff(most)))
    if spacing > 0 and 1.0 / spacing >= RATES[0] / 2 and _on_frames(times, spacing):
        rate, whole = 1.0 / spacing, round(1.0 / spacing)
        return (float(whole) if abs(rate - whole) <= WHOLE_RATE * whole else rate), ""
    return OTHER_RATE, f"keys lie at no common frame rate: read at {OTHER_RATE:g} frames per second"


def sample(track: Track, times: np.ndarray) -> np.ndarray:
    """Returns the values [T, ...] of a track; those of its first and last key before and after them.

    Args:
        track: the keys.
        times: [T] seconds.
    """
    before = np.clip(np.searchsorted(track.times, times + 1e-6, side="right") - 1, 0, len(track.times) - 1)
    after = np.minimum(before + 1, len(track.times) - 1)
    if track.interpolation == "STEP":
        return track.values[before]
    gap = track.times[after] - track.times[before]
    share = np.clip((times - track.times[before]) / np.where(gap > 0, gap, 1.0), 0.0, 1.0)[:, None]
    if track.tangents is not None:
        return _cubic(track, before, after, gap[:, None], share)
    first, second = track.values[before], track.values[after]
    if track.path == "rotation":
        return quat_slerp(first, second, share[:, 0])
    return first + share * (second - first)


def _cubic(track: Track, before: np.ndarray, after: np.ndarray, gap: np.ndarray, share: np.ndarray) -> np.ndarray:
    """Returns values [T, ...] of a Hermite spline."""
    assert track.tangents is not None
    into, out = track.tangents
    squared, cubed = share**2, share**3
    values = (
        (2 * cubed - 3 * squared + 1) * track.values[before]
        + gap * (cubed - 2 * squared + share) * out[before]
        + (3 * squared - 2 * cubed) * track.values[after]
        + gap * (cubed - squared) * into[after]
    )
    return quat_normalise(values) if track.path == "rotation" else values


def _world(
    tree: NodeTree, tracks: Sequence[Track], nodes: Sequence[int], used: Collection[int], times: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Returns world positions [T, J, 3] and rotations [T, J, 4] of nodes."""
    sampled: dict[int, dict[str, np.ndarray]] = {}
    for track in tracks:
        sampled.setdefault(track.node, {})[track.path] = sample(track, times)
    world: dict[int, np.ndarray] = {}
    for node in (int(each) for each in tree.order if int(each) in used):
        local = _local(tree, node, sampled.get(node), len(times))
        parent = int(tree.parents[node])
        world[node] = local if parent < 0 else world[parent] @ local
    matrices = np.stack([np.broadcast_to(world[int(node)], (len(times), 4, 4)) for node in nodes], axis=1)
    return matrices[..., :3, 3].copy(), rotations_of(matrices[..., :3, :3])


def _local(tree: NodeTree, node: int, keys: dict[str, np.ndarray] | None, count: int) -> np.ndarray:
    """Returns the local matrices [T, 4, 4] of a node, or [1, 4, 4] if it is not animated."""
    if keys is None:
        return tree.matrices[node][None]
    still = {"translation": tree.translations[node], "rotation": tree.rotations[node], "scale": tree.scales[node]}
    pose = {**still, **keys}
    local = np.zeros((count, 4, 4))
    local[:, :3, :3] = quat_to_matrix(pose["rotation"]) * pose["scale"][..., None, :]
    local[:, :3, 3] = pose["translation"]
    local[:, 3, 3] = 1.0
    return local


def rotations_of(matrices: np.ndarray) -> np.ndarray:
    """Returns the rotations [..., 4] nearest to matrices [..., 3, 3] without their scales; reflections are undone.

    A matrix that flattens space, as those of joints that are scaled to nothing, gives some rotation.
    """
    lengths = np.linalg.norm(matrices, axis=-2, keepdims=True)
    axes = matrices / np.where(lengths > 1e-12, lengths, 1.0)
    axes = np.where((np.linalg.det(axes) < 0)[..., None, None], -axes, axes)
    skew = np.abs(np.swapaxes(axes, -1, -2) @ axes - np.eye(3)).max(axis=(-1, -2)) > SKEWED
    if skew.any():
        left, _, right = np.linalg.svd(axes[skew])
        turned = left @ right
        turned[np.linalg.det(turned) < 0] *= -1.0
        axes[skew] = turned
    return quat_normalise(quat_from_matrix(axes))


def _sampler(document: Document, sampler: dict[str, Any], place: str) -> tuple[int, int, str]:
    """Returns a sampler's accessors of times and of values, and its interpolation."""
    interpolation = sampler.get("interpolation", "LINEAR")
    if interpolation not in INTERPOLATIONS:
        rule = f"must be {', '.join(INTERPOLATIONS)}"
        raise InputError(document.path, f"{place}.interpolation", shown(interpolation), rule)
    for name in ("input", "output"):
        document.item("accessors", sampler.get(name), f"{place}.{name}")
    return sampler["input"], sampler["output"], interpolation


def _track(document: Document, keys: tuple[int, int, str, str], node: int, place: str) -> Track:
    """Returns the track of a sampler: its accessors of times and of values, its interpolation, and a key of `PATHS`."""
    first, second, interpolation, path = keys
    times = read_accessor(document, first, "SCALAR", f"{place}.input").astype(float)
    values = read_accessor(document, second, PATHS[path], f"{place}.output").astype(float)
    if not len(times) or (np.diff(times) < 0).any():
        raise InputError(document.path, f"{place}.input", f"{len(times)} keys", "must be keys with ascending times")
    per_key = 3 if interpolation == "CUBICSPLINE" else 1
    if len(values) != per_key * len(times):
        rule = f"must be {per_key * len(times)}, for {len(times)} keys"
        raise InputError(document.path, f"{place}.output", f"{len(values)} values", rule)
    if path == "rotation":
        values = values[:, [3, 0, 1, 2]]
    tangents = (values[0::3], values[2::3]) if per_key == 3 else None
    values = values[1::3] if per_key == 3 else values
    if path == "rotation":
        if (np.linalg.norm(values, axis=1) < 1e-6).any():
            raise InputError(document.path, f"{place}.output", "zero", "must be unit quaternions")
        values = quat_normalise(values)
    elif np.abs(values).max() > 1e9:
        raise InputError(document.path, f"{place}.output", f"{np.abs(values).max():.3g}", "must be below 1e9")
    return Track(node, path, interpolation, times, values, tangents)


def _objects(document: Document, animation: dict[str, Any], name: str, place: str) -> list[dict[str, Any]]:
    found = animation.get(name)
    if not isinstance(found, list) or not all(isinstance(each, dict) for each in found):
        raise InputError(document.path, f"{place}.{name}", type(found).__name__, "must be a list of objects")
    return found


def _num_keys(animation: dict[str, Any], accessors: list[dict[str, Any]]) -> int:
    """Returns the most keys of an animation's samplers, as the file states them."""
    samplers, most = animation.get("samplers"), 0
    for sampler in samplers if isinstance(samplers, list) else ():
        index = sampler.get("input") if isinstance(sampler, dict) else None
        if isinstance(index, int) and 0 <= index < len(accessors):
            count = accessors[index].get("count")
            most = max(most, count if isinstance(count, int) else 0)
    return most


def _different(arrays: Iterable[np.ndarray]) -> list[np.ndarray]:
    """Returns arrays of which tracks may share some, each once."""
    return list({id(array): array for array in arrays}.values())


def _on_frames(times: np.ndarray, spacing: float) -> bool:
    return bool(np.abs(times / spacing - np.rint(times / spacing)).max() < 2 * ON_FRAME)


def _changes(scales: np.ndarray) -> bool:
    return bool(np.ptp(scales, axis=0).max() > 0.01 * max(float(np.abs(scales).max()), math.ulp(1.0)))


def _listed(names: Sequence[str]) -> str:
    """Returns names as one line of at most a few hundred characters."""
    listed = [shown(name) for name in names[:20]]
    return ", ".join(listed) + (f" and {len(names) - 20} more" if len(names) > 20 else "")
