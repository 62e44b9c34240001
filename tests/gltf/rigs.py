"""A small rigged character in memory, whose JSON tests change before they write it to a file."""

from __future__ import annotations

import copy
import json
import struct
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from pfnn_jax.motion.kinematics import quat_to_matrix

JOINTS = {
    "Root": (None, (0, 0, 0)),
    "Hips": ("Root", (0, 0.9, 0)),
    "Spine": ("Hips", (0, 0.2, 0)),
    "Head": ("Spine", (0, 0.5, 0)),
    **{
        f"{side}{part}": (above if above in ("Hips", "Spine") else f"{side}{above}", (sign * x, y, z))
        for side, sign in (("Left", 1), ("Right", -1))
        for part, above, x, y, z in (
            ("UpLeg", "Hips", 0.1, -0.05, 0),
            ("Leg", "UpLeg", 0, -0.4, 0),
            ("Foot", "Leg", 0, -0.4, 0),
            ("ToeBase", "Foot", 0, -0.05, 0.12),
            ("Arm", "Spine", 0.18, 0.4, 0),
            ("ForeArm", "Arm", 0.28, 0, 0),
            ("Hand", "ForeArm", 0.25, 0, 0),
        )
    },
}
"""Joint -> parent and offset in metres: a person in a T-pose with the toes on the ground, facing +Z, under a root."""

NAMES = tuple(JOINTS)

DOT = "iVBORw0KGgoAAAANSUhEUgAAAAEAAAABCAYAAAAfFcSJAAAADUlEQVR42mNkYPhfDwAChwGA60e6kgAAAABJRU5ErkJggg=="
"""A PNG of one pixel, in base64."""


@dataclass
class Rig:
    """A file that is being made."""

    json: dict[str, Any]
    binary: bytearray = field(default_factory=bytearray)

    def add(self, values: np.ndarray, kind: str) -> int:
        """Adds an accessor with its buffer view, and returns its number."""
        codes = {"float32": 5126, "uint8": 5121, "uint16": 5123, "uint32": 5125}
        self.binary.extend(b"\0" * (-len(self.binary) % 4))
        view = {"buffer": 0, "byteOffset": len(self.binary), "byteLength": values.nbytes}
        self.json["bufferViews"].append(view)
        self.binary.extend(np.ascontiguousarray(values).tobytes())
        accessor = {"bufferView": len(self.json["bufferViews"]) - 1, "componentType": codes[str(values.dtype)]}
        self.json["accessors"].append({**accessor, "count": len(values), "type": kind})
        return len(self.json["accessors"]) - 1

    def animate(
        self, tracks: dict[tuple[int, str], tuple[Any, Any]], name: str | None = "walk", interpolation: str = "LINEAR"
    ) -> None:
        """Adds an animation: (node, path) -> times and values; rotations are xyzw, as in the file."""
        samplers, channels = [], []
        for (node, path), (times, values) in tracks.items():
            data = np.asarray(values, np.float32)
            sampler = {"input": self.add(np.asarray(times, np.float32), "SCALAR")}
            sampler["output"] = self.add(data.reshape(-1, data.shape[-1]), "VEC4" if path == "rotation" else "VEC3")
            samplers.append({**sampler, "interpolation": interpolation})
            channels.append({"sampler": len(samplers) - 1, "target": {"node": node, "path": path}})
        clip: dict[str, Any] = {"samplers": samplers, "channels": channels}
        self.json.setdefault("animations", []).append(clip if name is None else {**clip, "name": name})

    def bytes(self) -> bytes:
        """Returns the GLB file."""
        data = copy.deepcopy(self.json)
        data["buffers"] = [{"byteLength": len(self.binary)}, *data.get("buffers", [])[1:]]
        return glb(json.dumps(data).encode(), bytes(self.binary))

    def write(self, path: Path) -> Path:
        """Writes the file, and returns its path."""
        path.write_bytes(self.bytes())
        return path


def glb(text: bytes, binary: bytes) -> bytes:
    """Returns a GLB file of its two chunks."""
    text += b" " * (-len(text) % 4)
    binary += b"\0" * (-len(binary) % 4)
    chunks = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(binary), b"BIN\0") + binary
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks


def places() -> np.ndarray:
    """Returns the joints [J, 3] of `JOINTS` in the world."""
    found: dict[str, np.ndarray] = {}
    for name, (parent, offset) in JOINTS.items():
        found[name] = np.array(offset, float) + (0.0 if parent is None else found[parent])
    return np.array([found[name] for name in NAMES])


def make_rig(change: Callable[[dict[str, Any]], None] | None = None) -> Rig:
    """Returns the character with a triangle on each joint.

    Args:
        change: changes the JSON.
    """
    nodes: list[dict[str, Any]] = [
        {
            "name": name,
            "translation": list(offset),
            "children": [k for k, n in enumerate(NAMES) if JOINTS[n][0] == name],
        }
        for name, (_, offset) in JOINTS.items()
    ]
    nodes = [{k: v for k, v in node.items() if v != []} for node in nodes]
    nodes.append({"name": "body", "mesh": 0, "skin": 0})
    rig = Rig({"asset": {"version": "2.0"}, "nodes": nodes, "bufferViews": [], "accessors": []})
    bind = np.tile(np.eye(4, dtype=np.float32), (len(NAMES), 1, 1))
    bind[:, 3, :3] = -places()
    corners = (places()[:, None] + np.array([[0, 0, 0], [0.02, 0, 0], [0, 0.02, 0]])).reshape(-1, 3)
    joints = np.zeros((len(corners), 4), np.uint8)
    joints[:, 0] = np.repeat(np.arange(len(NAMES)), 3)
    weights = np.tile(np.array([1, 0, 0, 0], np.float32), (len(corners), 1))
    rig.json["skins"] = [
        {"joints": list(range(len(NAMES))), "inverseBindMatrices": rig.add(bind.reshape(-1, 16), "MAT4")}
    ]
    attributes = {
        "POSITION": rig.add(corners.astype(np.float32), "VEC3"),
        "JOINTS_0": rig.add(joints, "VEC4"),
        "WEIGHTS_0": rig.add(weights, "VEC4"),
    }
    rig.json["meshes"] = [{"primitives": [{"attributes": attributes}]}]
    rig.json["scenes"] = [{"nodes": [0, len(nodes) - 1]}]
    if change is not None:
        change(rig.json)
    return rig


def as_matrix(rotation: np.ndarray, translation: np.ndarray, scale: float) -> list[float]:
    """Returns a node's `matrix`, by columns."""
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = scale * quat_to_matrix(rotation), translation
    return matrix.T.ravel().tolist()
