"""Benchmark of preparation: from BVH files to features, and to a dataset on disk with its peak memory."""

from __future__ import annotations

import re
import sys
import tempfile
import time
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

from pfnn_jax.benchmarks.timing import Figure, figure, interleave
from pfnn_jax.motion.bvh import write_bvh
from pfnn_jax.motion.clip import mirror_clip
from pfnn_jax.motion.datasets.labelled import load_labelled
from pfnn_jax.motion.datasets.preparation import PrepareConfig, prepare
from pfnn_jax.motion.datasets.sources import ClipFile, list_clips
from pfnn_jax.motion.datasets.workers import default_workers, map_in_order
from pfnn_jax.motion.features.encode import clip_features
from pfnn_jax.motion.features.layout import LAYOUTS
from pfnn_jax.motion.labels.footsteps import NoGaitError
from pfnn_jax.motion.labels.phase import mirror_phase
from pfnn_jax.motion.synthetic.walks import PRETRAINING_STYLES, synthetic_clips

PREPARATION_AIM = 20_000.0
"""Required frames per second from BVH files to features."""

MAXRSS_BYTES = 1 if sys.platform == "darwin" else 1024
"""Bytes per unit of `ru_maxrss`."""


class Prepared(NamedTuple):
    """Rows written, seconds and peak memory of one preparation."""

    rows: int
    seconds: float
    peak_bytes: int


def measure_preparation(files: Sequence[ClipFile], layout: str) -> Prepared:
    """Prepares clips into a temporary folder, in a separate process so that its memory can be measured.

    Args:
        files: the clips.
        layout: name in `LAYOUTS`.

    Returns:
        Rows written, mirror images included; seconds; and the peak memory of the process and its workers, 0 on
        Windows.
    """
    (found,) = map_in_order(_prepare, [(tuple(files), layout)], 2)
    return found


def _prepare(task: tuple[tuple[ClipFile, ...], str]) -> Prepared:
    files, layout = task
    started = time.perf_counter()
    with tempfile.TemporaryDirectory() as folder:
        dataset = prepare(files, Path(folder) / "dataset", PrepareConfig(layout=layout))
        rows, seconds = sum(dataset.frames.values()), time.perf_counter() - started
    return Prepared(rows, seconds, _peak_bytes())


def _peak_bytes() -> int:
    """Returns the peak memory of this process and its workers; 0 on Windows, which does not tell."""
    if sys.platform == "win32":
        return 0
    import resource

    own, largest = (resource.getrusage(who).ru_maxrss for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return (_own_peak() or MAXRSS_BYTES * own) + default_workers() * MAXRSS_BYTES * largest


def _own_peak() -> int | None:
    """Returns the peak memory of this process, or None where /proc is not available.

    On Linux `ru_maxrss` includes the memory of the parent from before `exec`.
    """
    with suppress(OSError):
        found = re.search(r"^VmHWM:\s*(\d+) kB", Path("/proc/self/status").read_text(), re.MULTILINE)
        return None if found is None else 1024 * int(found[1])
    return None


def preparation_figures(mocap: Path | None, seconds_per_style: float, repetitions: int) -> list[Figure]:
    """Measures frames per second from BVH files to features: reading, resampling, phase labels, kinematics, windows.

    Frames are counted at 60 fps with mirror images.
    """
    figures = []
    with tempfile.TemporaryDirectory() as folder:
        figures.append(
            _prepare_figure("synthetic clips", write_synthetic(Path(folder), seconds_per_style), repetitions)
        )
    for name in ("bandai-namco-2", "pfnn") if mocap is not None else ():
        if mocap is not None and (mocap / name).is_dir():
            figures.append(_prepare_figure(name, list_clips(mocap / name)[:24], repetitions))
    return figures


def write_synthetic(folder: Path, seconds_per_style: float) -> list[ClipFile]:
    """Writes one procedural walk of each pretraining style as a BVH file, without phase labels."""
    files = []
    for style in PRETRAINING_STYLES:
        clip = synthetic_clips(style, seconds_per_style, clip_seconds=seconds_per_style)[0].clip
        write_bvh(folder / f"{style}.bvh", clip)
        files.append(ClipFile(folder / f"{style}.bvh", style))
    return files


def prepare_clips(files: list[ClipFile]) -> int:
    """Computes and discards the features of every clip and its mirror image; returns the number of rows."""
    rows = 0
    for file in files:
        try:
            labelled = load_labelled(file)
        except NoGaitError:
            continue
        clip = labelled.clip
        layout = LAYOUTS["mason2018"](clip.skeleton.num_joints)
        rows += len(clip_features(clip, layout, labelled.labels).frames)
        if labelled.symmetric:
            rows += len(clip_features(mirror_clip(clip), layout, mirror_phase(labelled.labels)).frames)
    return rows


def _prepare_figure(name: str, files: list[ClipFile], repetitions: int) -> Figure:
    rows = prepare_clips(files)
    seconds = interleave({name: lambda: prepare_clips(files)}, repetitions, warm_up=False)[name]
    section = "preparation, BVH to features"
    return figure(section, f"{name}: {len(files)} clips", rows / seconds, "frames/s", at_least=PREPARATION_AIM)
