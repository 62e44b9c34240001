"""The sample clips of the package, from which a style can be learned without data of one's own."""

from __future__ import annotations

from pathlib import Path

from pfnn_jax.motion.bvh import write_bvh
from pfnn_jax.motion.synthetic.samples import SAMPLES, make_sample

FOLDER = Path(__file__).parents[1] / "samples"
"""Where the package keeps them."""


def sample_clips() -> dict[str, Path]:
    """Returns the BVH files of the sample clips by name: walks straight ahead of 4 s at 30 frames per second.

    Their styles are none of those that `synthetic_clips` makes for pretraining, and their skeletons, units and up axes
    differ, as those of clips from different software do. Copy a file before changing it.
    """
    return {name: FOLDER / f"{name}.bvh" for name in SAMPLES}


def write_samples(folder: Path = FOLDER) -> None:
    """Writes all sample clips into a folder, as the package contains them; files that exist are replaced."""
    for name, sample in SAMPLES.items():
        write_bvh(folder / f"{name}.bvh", make_sample(sample), unit=sample.unit, overwrite=True)
