"""Two procedural styles, as BVH files in one folder for each, and as a dataset."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from pfnn_jax.motion.bvh import write_bvh
from pfnn_jax.motion.datasets.dataset import Dataset
from pfnn_jax.motion.datasets.preparation import PrepareConfig, prepare
from pfnn_jax.motion.synthetic.walks import synthesise, synthetic_clips

STYLES = ("neutral", "old")


def write_two_styles(folder: Path, frames: int) -> Path:
    """Writes a straight walk of each style as STYLE/walk.bvh into a folder, and returns it."""
    for style in STYLES:
        (folder / style).mkdir()
        write_bvh(folder / style / "walk.bvh", synthesise(style, np.zeros(frames), np.full(frames, 1.0), seed=1)[0])
    return folder


def prepare_two_styles(out: Path) -> Dataset:
    """Writes two seconds of both styles as a dataset."""
    return prepare([clip for style in STYLES for clip in synthetic_clips(style, 2.0)], out, PrepareConfig())
