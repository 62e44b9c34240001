"""Puts a clip into another style: by optimisation between two clips, or by a network trained for one style."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

import jax
import numpy as np

from pfnn_jax.errors import InputError
from pfnn_jax.motion.blending import Parts, check_parts
from pfnn_jax.motion.clip import MotionClip, resample
from pfnn_jax.motion.clip_files import read_clip
from pfnn_jax.motion.length_unit import CENTIMETRE
from pfnn_jax.motion.reading import ReadOptions
from pfnn_jax.training.loop import no_progress
from pfnn_jax.transfer.clip_rows import encode_clip, prepare_clip
from pfnn_jax.transfer.config import OptimisationConfig, TransformationConfig
from pfnn_jax.transfer.finish import check_strength, finish_clip
from pfnn_jax.transfer.layout import LAYOUT_FPS
from pfnn_jax.transfer.optimisation import optimise
from pfnn_jax.transfer.pairing import ALL, GaitClip, pair_by_gait
from pfnn_jax.transfer.pieces import PIECE, in_pieces
from pfnn_jax.transfer.run import (
    BASE_AUTOENCODER,
    TransferRun,
    list_transformations,
    load_transfer_run,
    load_transformation,
    transformation_note,
)
from pfnn_jax.transfer.transformation import init_transformation
from pfnn_jax.transfer.transformation_training import apply_network

SAME = 1e-4
"""Metres and radians per frame by which the rows of one motion differ at the most, after it was written and read."""

Clip = MotionClip | str | Path
"""A clip, or the path of a BVH or glTF file."""

Method = Callable[[np.ndarray], np.ndarray]
"""From the rows of a content to those of the result, [T, D] in layout units."""

Progress = Callable[[float, str], Any]
"""Called with the share that is done, 0 to 1, and what is being done."""


@dataclass(frozen=True, eq=False)
class TransferResult:
    """A clip in another style.

    Attributes:
        clip: the result, on the content's skeleton and at its frame rate.
        content: the content as it was read.
        styles: the style clips as they were read; none where a network was trained for the style.
        notes: what was assumed about the files and done with the clips, one line each.
        seconds: that it took, with compilation.
    """

    clip: MotionClip
    content: MotionClip
    styles: tuple[MotionClip, ...]
    notes: tuple[str, ...]
    seconds: float

    @property
    def unit(self) -> float:
        """Metres per unit of the content's file, in which the result is written; centimetres without a file."""
        return CENTIMETRE if self.content.reading is None else self.content.reading.unit


def transfer_clip(
    content: Clip,
    style: Clip | Sequence[Clip] | None = None,
    *,
    run: TransferRun | str | Path | None = None,
    style_name: str | None = None,
    strength: float = 1.0,
    parts: Parts = "all",
    foot_ik: bool = True,
    config: OptimisationConfig | None = None,
    seed: int = 0,
    reading: ReadOptions | None = None,
    roles_file: str | Path | None = None,
    progress_callback: Progress = no_progress,
) -> TransferResult:
    """Returns a clip in another style, on its own skeleton and at its own frame rate.

    With `style`, the hidden units of the run's autoencoder are optimised (Holden et al. 2016): nothing is trained, and
    any two clips of any humanoid skeletons will do. Without it, the network that `train_transfer` has trained for one
    style is applied (Holden et al. 2017). Clips longer than `transfer.pieces.PIECE` frames are done in pieces.

    Args:
        content: the clip to transfer, or its file.
        style: the style clip, or several of one style.
        run: a run of style transfer, or its directory; by default the autoencoder of the package.
        style_name: one of the run's styles; may be left out if it has one only.
        strength: 0 is the content, 1 the result; up to 1.5, the difference is extrapolated.
        parts: of the body that take the style; the others keep the content's motion.
        foot_ik: hold feet in place while those of the content are in contact.
        config: settings of the optimisation.
        seed: of the noise from which the optimisation may start.
        reading: what is known about the files.
        roles_file: JSON naming the joints' roles.
        progress_callback: called with the share that is done, 0 to 1, and what is being done.

    Raises:
        InputError: for a bad clip, one of a skeleton that is not a humanoid, or shorter than a filter of the
            autoencoder; for a style clip that is the content itself; for a style that was not trained; for a strength
            or parts that do not exist.
    """
    started = time.perf_counter()
    check_strength(strength)
    check_parts(parts, "transfer")
    run = as_run(BASE_AUTOENCODER if run is None else run)
    given = _style_clips(style, style_name)
    method = _load_method(run, _chosen_style(run, style_name)) if style is None else None
    progress_callback(0.0, "reading")
    clip, *styles = [_read(each, reading, roles_file) for each in (content, *given)]
    notes = [f"{each.source or 'clip'}: {note}" for each in (clip, *styles) for note in each.notes]
    rows, *style_rows = [rows_for_run(each, run) for each in (clip, *styles)]
    _refuse_same(clip, rows, styles, style_rows)
    progress_callback(0.1, "transferring the style")
    if method is None:
        paired, more = _pair(clip, rows, styles, style_rows, run)
        notes += more
        method = partial(_optimised, run, paired, OptimisationConfig() if config is None else config, seed)
    transferred = in_pieces(rows, method)
    progress_callback(0.9, "finishing")
    result = finish_clip(transferred, clip, run.skeleton, run.layout, strength=strength, parts=parts, foot_ik=foot_ik)
    progress_callback(1.0, "done")
    return TransferResult(result, clip, tuple(styles), tuple(notes), time.perf_counter() - started)


def rows_for_run(clip: MotionClip, run: TransferRun) -> np.ndarray:
    """Returns the rows [T, D] of a clip of any humanoid skeleton, put onto the run's, at the layout's frame rate.

    Raises:
        InputError: for a clip that is not finite, is shorter than the autoencoder's filters, or whose skeleton is not
            a humanoid.
    """
    _check_finite(clip)
    frames, width = num_frames(clip), run.config.autoencoder.width
    if frames < width:
        value = f"{frames} frames at {LAYOUT_FPS:g} per second"
        rule = f"must be at least {width} frames ({width / LAYOUT_FPS:.2f} s), the width of the autoencoder's filters"
        raise InputError(clip.source or "clip", "length", value, rule)
    return encode_clip(prepare_clip(clip, run.skeleton), run.layout)


def num_frames(clip: MotionClip) -> int:
    """Returns the number of a clip's frames at the layout's frame rate."""
    return resample(clip, LAYOUT_FPS).num_frames


def _check_finite(clip: MotionClip) -> None:
    for what, values in (("root positions", clip.root_positions), ("rotations", clip.rotations)):
        bad = ~np.isfinite(values)
        if bad.any():
            frame = int(np.argwhere(bad)[0][0])
            raise InputError(clip.source or "clip", f"frame {frame}", f"{what} not finite", "must be finite numbers")


def _optimised(
    run: TransferRun, style_rows: list[np.ndarray], config: OptimisationConfig, seed: int, rows: np.ndarray
) -> np.ndarray:
    return optimise(run, rows, style_rows, config, key=jax.random.key(seed))


def _pair(
    clip: MotionClip, rows: np.ndarray, styles: Sequence[MotionClip], style_rows: Sequence[np.ndarray], run: TransferRun
) -> tuple[list[np.ndarray], list[str]]:
    """Returns the rows of the style's clips of the content's gait, long ones in pieces, and notes on the choice.

    There is no note for a single style clip of the same gait, as there was no choice.
    """
    content, *others = (
        GaitClip(each, of.content, of.source or "clip")
        for of, each in zip((clip, *styles), (rows, *style_rows), strict=True)
    )
    pairing = pair_by_gait([content], others, run.layout)
    obvious = len(styles) == 1 and pairing.groups[0] != ALL
    members = [style_rows[index] for index in pairing.members[0]]
    pieces = [piece for each in members for piece in np.array_split(each, -(-len(each) // PIECE))]
    return pieces, [] if obvious else list(pairing.notes)


def _load_method(run: TransferRun, style: str) -> Method:
    """Loads the network of one of a run's styles, as the function that it was trained to be.

    Raises:
        InputError: as `load_transformation`, and for a note without the network's settings.
    """
    note = transformation_note(run.path, style)
    try:
        config = note["info"]["config"]
        sizes, keep_detail = TransformationConfig(**config["network"]), bool(config["keep_detail"])
    except (KeyError, TypeError, ValueError) as error:
        file = run.path / "styles" / style / "style.json"
        raise InputError(
            file, "config", error, "must hold `network` and `keep_detail`: train the style again"
        ) from error
    abstract = jax.eval_shape(lambda: init_transformation(sizes, run.layout.size, key=jax.random.key(0)))
    network = load_transformation(run, style, abstract)
    return lambda rows: apply_network(run, network, rows, keep_detail=keep_detail)


def as_run(run: TransferRun | str | Path) -> TransferRun:
    """Returns a run of style transfer, loaded where its directory is given.

    Raises:
        InputError: as `load_transfer_run`.
    """
    return run if isinstance(run, TransferRun) else load_transfer_run(run)


def _style_clips(style: Clip | Sequence[Clip] | None, style_name: str | None) -> list[Clip]:
    """Returns the style clips; none where the style is one of the run's.

    Raises:
        InputError: for clips together with the name of a style, and for an empty sequence of clips.
    """
    if style is None:
        return []
    if style_name is not None:
        raise InputError("transfer_clip", "style_name", style_name, "pass either style clips or the name of a style")
    clips = [style] if isinstance(style, MotionClip | str | Path) else list(style)
    if not clips:
        raise InputError("transfer_clip", "style", "no clips", "pass at least one, or the name of a style of the run")
    return clips


def _read(clip: Clip, reading: ReadOptions | None, roles_file: str | Path | None) -> MotionClip:
    if isinstance(clip, MotionClip):
        return clip
    return read_clip(clip, **asdict(reading or ReadOptions()), roles_file=roles_file)


def _chosen_style(run: TransferRun, name: str | None) -> str:
    """Returns the style of a run that is meant: the one that is named, or the only one.

    Raises:
        InputError: for a run of several styles if none is named, and of none.
    """
    names = list_transformations(run.path)
    if name is None and len(names) != 1:
        known = ", ".join(names) or "(this run has no styles yet: train one, or pass a style clip)"
        raise InputError(run.path, "style", "none", f"must be one of {known}" if names else f"must be trained {known}")
    return names[0] if name is None else name


def _refuse_same(content: MotionClip, rows: np.ndarray, styles: Sequence[MotionClip], others: Sequence[np.ndarray]):
    """Refuses a style clip that is the content itself, whatever its file is called."""
    for style, other in zip(styles, others, strict=True):
        if rows.shape == other.shape and np.allclose(rows, other, atol=SAME):
            rule = "must be another clip: content and style are the same motion"
            raise InputError(content.source or "content", "style", style.source or "clip", rule)
