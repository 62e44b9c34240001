"""Puts a motion onto a user's own character: a glTF or VRM file with one more clip, or a BVH file on their rig."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from pfnn_jax.errors import InputError
from pfnn_jax.motion.bvh import bvh_text
from pfnn_jax.motion.clip import MotionClip, cut
from pfnn_jax.motion.clip_files import read_any_skeleton, read_clip
from pfnn_jax.motion.cycles import cut_cycle, repeat_cycle
from pfnn_jax.motion.gltf.character import Character, read_character
from pfnn_jax.motion.gltf.write import character_bytes, new_character
from pfnn_jax.motion.retargeting.retarget import retarget
from pfnn_jax.motion.skeleton import Skeleton
