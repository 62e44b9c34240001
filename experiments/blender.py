"""Does Blender put the joints of written characters where our kinematics put them, and make an FBX file of them?

Question  are files of `put_onto` right in another importer than three.js, and does the documented way to FBX work?
Data      rigged characters, each with a synthetic walk in place; Blender as the package bpy, in its own environment.
Expect    docs/results_appendix.md, "Motion onto rigged characters".
Run       python -m experiments.blender CHARACTER.glb ... --blender-python PYTHON
"""

from __future__ import annotations

import json
import subprocess
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import tyro
from tyro.conf import Positional

from experiments.common.markdown import markdown_table
from pfnn_jax.motion.clip import MotionClip
from pfnn_jax.motion.gltf.character import Character, read_character
from pfnn_jax.motion.gltf.write import character_bytes
from pfnn_jax.motion.humanoid.find import need_humanoid
from pfnn_jax.motion.kinematics import forward_kinematics, quat_conjugate, quat_rotate
from pfnn_jax.motion.retargeting.body import parts_of
from pfnn_jax.motion.retargeting.retarget import retarget
from pfnn_jax.motion.root_motion import in_place
from pfnn_jax.motion.synthetic.walks import synthesise

CLIP = "pfnn_jax walk"
FRAMES = (0, 20, 45, 80)

IN_BLENDER = """
import bpy, contextlib, io, json, os, sys

clip, frames, files = json.loads(sys.argv[1])
for file in files:
    with contextlib.redirect_stdout(io.StringIO()):
        bpy.ops.wm.read_factory_settings(use_empty=True)
        bpy.context.scene.render.fps = 60
        bpy.ops.import_scene.gltf(filepath=file)
    found = [{}, {}]
    for rig in (each for each in bpy.data.objects if each.type == "ARMATURE" and each.animation_data):
        rig.animation_data.action = None
        for track in rig.animation_data.nla_tracks:
            track.mute = track.name != clip
        for cleared, bones in enumerate(found):
            for bone in rig.pose.bones if cleared else ():
                bone.matrix_basis.identity()
            for frame in frames:
                bpy.context.scene.frame_set(frame + 1)
                for bone in rig.pose.bones:
                    x, y, z = rig.matrix_world @ bone.head
                    bones.setdefault(bone.name, []).append((x, z, -y))
    with contextlib.redirect_stdout(io.StringIO()):
        bpy.ops.export_scene.fbx(filepath=file + ".fbx", add_leaf_bones=False, bake_anim=True)
    print("RESULT", json.dumps([found, os.path.getsize(file + ".fbx"), bpy.app.version_string]), flush=True)
"""
"""Prints for each file the positions of bones by name, one for each frame, with Y up in the file's units: as imported,
where properties without keys keep what another clip of the file has left there, and after the pose was cleared."""


@dataclass(frozen=True)
class Config:
    """Settings.

    Attributes:
        characters: GLB files.
        blender_python: a Python interpreter that imports bpy.
    """

    characters: Positional[tuple[Path, ...]]
    blender_python: Path


def scene_positions(character: Character, clip: MotionClip) -> np.ndarray:
    """Returns the joints [F, J, 3] at `FRAMES` in the scene of the file, in its units."""
    positions = forward_kinematics(clip.skeleton, clip.root_positions, clip.rotations)[0][list(FRAMES)]
    placement = character.placement
    return quat_rotate(quat_conjugate(placement.rotation), (positions - placement.translation) / placement.scale)


def largest_error(character: Character, clip: MotionClip, found: dict[str, list]) -> tuple[int, float]:
    """Returns the number of joints of the body that Blender names, and their largest error relative to the body."""
    ours, names = scene_positions(character, clip), character.skeleton.names
    parts = {part.joint for part in parts_of(need_humanoid(character.skeleton))}
    named = [joint for joint in parts if names[joint] in found]
    errors = [np.abs(np.array(found[names[joint]]) - ours[:, joint]).max() for joint in named]
    return len(named), float(max(errors, default=np.nan)) / float(np.ptp(ours[..., 1]))


def main(config: Config) -> None:
    still = np.zeros(90)
    walk = synthesise("neutral", still, still + 1.2)[0]
    head, rows = ["character", "joints compared", "largest error, mm of 1.7 m", "pose cleared", "FBX, kB"], []
    with tempfile.TemporaryDirectory() as folder:
        written, moved = [], []
        for path in config.characters:
            character = read_character(path)
            clip = retarget(walk, character.skeleton).clip
            moved.append((character, in_place(clip)))
            written.append(Path(folder) / path.name)
            written[-1].write_bytes(character_bytes(character, {CLIP: clip}))
        words = json.dumps([CLIP, FRAMES, [str(path) for path in written]])
        done = subprocess.run(
            [config.blender_python, "-c", IN_BLENDER, words], capture_output=True, text=True, check=True
        )
    results = [json.loads(line[7:]) for line in done.stdout.splitlines() if line.startswith("RESULT ")]
    for path, (character, clip), (found, size, _) in zip(config.characters, moved, results, strict=True):
        joints, errors = zip(*(largest_error(character, clip, bones) for bones in found), strict=True)
        rows.append([path.stem, str(joints[0]), *(f"{1700 * error:.2f}" for error in errors), f"{size / 1e3:.0f}"])
    print(markdown_table(head, rows), f"\nBlender {results[0][2]}")


if __name__ == "__main__":
    main(tyro.cli(Config))
