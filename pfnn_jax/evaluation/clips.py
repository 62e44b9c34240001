"""Evaluation of a run on clips that it was not trained on, by one-step errors."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from pfnn_jax.errors import InputError
from pfnn_jax.evaluation.style_test import join_takes, one_step_test
from pfnn_jax.inference.predictor import Predictor, make_predictor
from pfnn_jax.motion.datasets.clip_rows import labelled_features
from pfnn_jax.motion.datasets.sources import ClipFile
from pfnn_jax.motion.labels.footsteps import NoGaitError
from pfnn_jax.run import Run
from pfnn_jax.run_config import list_styles
from pfnn_jax.workflows.learn import load_for_run


def evaluate_clips(
    run: Run, clip_files: Sequence[ClipFile], style: str | None = None, roles_file: Path | None = None
) -> dict[str, dict[str, Any]]:
    """Returns one-step errors in the run's normalised units for every style of the clips.

    Args:
        run: a loaded run.
        clip_files: clips of any skeleton, put onto the run's; those without steps are skipped and reported.
        style: the run's style that predicts all clips; None predicts each clip in the run's style of the same name.
        roles_file: JSON naming the joints' roles.

    Returns:
        For every style of the clips, what `one_step_test` returns; the same under `without_style` for the network
        without a style, or on a FiLM run in the mean of its styles; `left_out`: skipped file -> reason; and
        `notes`: file -> what was assumed about it and may be wrong.

    Raises:
        InputError: for a bad clip, an unknown style, or a style whose clips were all skipped.
    """
    by_style: dict[str, list[ClipFile]] = {}
    for clip_file in clip_files:
        by_style.setdefault(clip_file.style, []).append(clip_file)
    std, result = np.asarray(run.normaliser.outputs.std), {}
    # Clips are read before the style is looked up: what is wrong with a file is the more informative error.
    for own, files in sorted(by_style.items()):
        parts, names, left_out, notes = [], [], {}, {}
        for clip_file in files:
            try:
                labelled = load_for_run(clip_file, run, roles_file)
                parts += labelled_features(labelled, run.layout)
                notes |= {clip_file.path.name: labelled.note} if labelled.note else {}
                names.append(clip_file.path.stem)
            except NoGaitError as error:
                left_out[clip_file.path.name] = str(error)
        if not parts:
            raise InputError(files[0].path.parent, "style", own, "must have at least one clip with steps")
        takes = join_takes(parts, names)
        errors = one_step_test(_predictor(run, style, files[0]), takes, run.layout, std)
        without = one_step_test(make_predictor(run, None), takes, run.layout, std)
        result[own] = {**errors, "without_style": without, "left_out": left_out, "notes": notes}
    return result


def _predictor(run: Run, style: str | None, clip_file: ClipFile) -> Predictor:
    """Returns the predictor of the given style, or of the style that the clip is labelled with."""
    styles = list_styles(run.path)
    if style is None and clip_file.style not in styles:
        rule = f"must be a style of {run.path} ({', '.join(styles)}), or pass --style"
        raise InputError(clip_file.path, "style by its name and folder", clip_file.style, rule)
    return make_predictor(run, style or clip_file.style)
