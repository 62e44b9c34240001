"""The humanoid map that a VRM file holds.

Source: VRM 0.x (`extensions.VRM.humanoid.humanBones`, a list) and VRM 1.0 (`extensions.VRMC_vrm.humanoid.humanBones`,
an object); VRM animations (`VRMC_vrm_animation`) hold one of the same form as VRM 1.0.
"""

from __future__ import annotations

from pfnn_jax.errors import InputError
from pfnn_jax.motion.gltf.container import Document, shown


def humanoid_nodes(document: Document) -> dict[str, int]:
    """Returns bone -> node of the humanoid map of a VRM file, with the bones' names in VRM; empty for other files.

    Raises:
        InputError: for a map that is malformed, or a bone that is not a node.
    """
    extensions = document.json.get("extensions")
    for name in ("VRMC_vrm", "VRMC_vrm_animation", "VRM"):
        extension = extensions.get(name) if isinstance(extensions, dict) else None
        humanoid = extension.get("humanoid") if isinstance(extension, dict) else None
        bones = humanoid.get("humanBones") if isinstance(humanoid, dict) else None
        if isinstance(bones, list):  # VRM 0.x
            objects = [bone for bone in bones if isinstance(bone, dict)]
            bones = {bone["bone"]: bone for bone in objects if isinstance(bone.get("bone"), str)}
        if isinstance(bones, dict):
            return {
                bone: _node(document, entry, f"extensions.{name}.humanoid.humanBones[{shown(bone)}]")
                for bone, entry in bones.items()
            }
    return {}


def _node(document: Document, entry: object, place: str) -> int:
    node = entry.get("node") if isinstance(entry, dict) else entry
    document.item("nodes", node, place)
    if not isinstance(node, int):
        raise InputError(document.path, place, shown(node), "must be a node")
    return node
