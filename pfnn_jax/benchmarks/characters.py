"""Benchmark of characters: mapping and retargeting ten seconds of motion, and writing the file."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np

from pfnn_jax.benchmarks.timing import Figure, figure, interleave
from pfnn_jax.motion.gltf.character import read_character
from pfnn_jax.motion.gltf.write import character_bytes, glb_bytes
from pfnn_jax.motion.retargeting.retarget import retarget
from pfnn_jax.motion.synthetic.samples import SAMPLES, make_sample
from pfnn_jax.motion.synthetic.walks import synthesise
from pfnn_jax.viewer.body import grow_body

MAPPING_AIM, WRITING_AIM = 1.0, 0.5
"""Most seconds for mapping a character and retargeting ten seconds of motion onto it, and for writing its file."""

FPS, SECONDS = 60, 10


def rigged_figures(repetitions: int) -> list[Figure]:
    """Measures how long ten seconds of motion at 60 fps take onto a rigged character of another skeleton."""
    frames = np.zeros(FPS * SECONDS)
    clip = synthesise("neutral", frames + 0.3, frames + 1.2)[0]
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "character.glb"
        other = make_sample(SAMPLES["soldier"]).skeleton
        path.write_bytes(glb_bytes(other, grow_body(other), {}))
        character = read_character(path)
        moved = retarget(clip, character.skeleton).clip
        times = interleave(
            {
                "read, map and retarget": lambda: retarget(clip, read_character(path).skeleton).clip.rotations,
                "append the clip": lambda: np.frombuffer(character_bytes(character, {"walk": moved}), np.uint8),
            },
            repetitions,
        )
    aims = (MAPPING_AIM, WRITING_AIM)
    section = f"a character, {SECONDS} s at {FPS} fps"
    return [figure(section, name, times[name], "s", at_most=aim) for name, aim in zip(times, aims, strict=True)]
