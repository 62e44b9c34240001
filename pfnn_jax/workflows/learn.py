"""A new style from one clip, in a run: by a grid of settings (Mason 2018 §7), or by the FiLM generator (2022 §4.5)."""

from __future__ import annotations

import itertools
import time
import weakref
from collections.abc import Callable
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np

from pfnn_jax.control.run_settings import loop_config
from pfnn_jax.control.stability import make_stability_check
from pfnn_jax.errors import InputError
from pfnn_jax.inference.mixture import load_choice
from pfnn_jax.models.config import AdapterConfig
from pfnn_jax.motion.datasets.clip_rows import labelled_features, load_for_layout, match_hands
from pfnn_jax.motion.datasets.labelled import LabelledClip
from pfnn_jax.motion.datasets.sources import ClipFile, check_style_name
from pfnn_jax.motion.features.decode import median_speed
from pfnn_jax.motion.features.encode import Features
from pfnn_jax.motion.skeleton import check_same_topology
from pfnn_jax.run import Run, check_adapter, list_styles, load_generator, save_style
from pfnn_jax.training.data import hold_out, style_data, to_batch
from pfnn_jax.training.few_shot_learning import FewShotConfig, choose, refit, train_grid
from pfnn_jax.training.steps import Bones
from pfnn_jax.training.tuning import TuningConfig, tune_generator

Progress = Callable[[float, str], Any]
"""Told the share that is done, 0 to 1, and what is being done."""

_bones_of_runs: weakref.WeakKeyDictionary[Run, Bones] = weakref.WeakKeyDictionary()


def learn_style(
    run: Run,
    clip_file: ClipFile,
    config: FewShotConfig,
    *,
    mirror: bool = True,
    roles_file: Path | None = None,
    overwrite: bool = False,
    progress_callback: Progress = lambda share, what: None,
) -> dict[str, Any]:
    """Learns a style from a clip beside the frozen shared network, and saves it in the run.

    Args:
        run: a pretrained run.
        clip_file: the clip, its frames and the style's name.
        config: the grid of settings; a method that trains an adapter.
        mirror: also learn from the mirrored clip; off for a style whose left and right differ.
        roles_file: JSON naming the joints' roles.
        overwrite: replace a style of this name.
        progress_callback: called with the share that is done, 0 to 1, and what is being done.

    Returns:
        What is saved as `info` in style.json: source, frames, speed, the choice and the ranking behind it, seconds.

    Raises:
        InputError: for a bad clip, a clip without steps or of another skeleton, a style that exists, a method that
            trains a whole network, or an adapter of another rank than the run's.
    """
    started = time.perf_counter()
    _check_request(run, clip_file.style, config, overwrite)
    progress_callback(0.0, "labelling")
    parts = clip_parts(load_for_layout(clip_file, run.layout, roles_file), run, mirror)
    _check_length(hold_out(parts, config.held_out, str(clip_file.path))[0], config.batch_size, clip_file.path)
    adapter, found = learn_rows(run, parts, config, progress_callback)
    info = {
        **_about_clip(run, clip_file, parts, mirror),
        "config": asdict(config),
        **found,
        "seconds": time.perf_counter() - started,
    }
    progress_callback(0.98, "saving")
    save_style(run.path, clip_file.style, adapter, info, overwrite)
    return info


def learn_rows(
    run: Run, parts: list[Features], config: FewShotConfig, progress_callback: Progress = lambda share, what: None
) -> tuple[Any, dict[str, Any]]:
    """The parameters of a style from the rows of its clip, and what is to tell of them; nothing is saved.

    Args:
        run: a pretrained run.
        parts: rows of the clip, then of its mirror image where that belongs to the style.
        config: the grid of settings.
        progress_callback: called with the share that is done, 0 to 1, and what is being done.
    """
    rows, (learn, held) = parts[0], hold_out(parts, config.held_out)
    # A Film that changes nothing is no motion of any style: the mean of the run's styles is the nearest that is known.
    options = {"start": load_choice(run, None) if config.method == "film" else None, "bones": _bones(run)}
    data, held_out = to_batch(learn, run.normaliser), to_batch(held, run.normaliser)

    def told(begin: float, end: float, epochs: int, what: str) -> Callable[[int], Any]:
        return lambda done: progress_callback(begin + (end - begin) * done / epochs, what)

    trying = told(0.03, 0.5, config.eval_epochs[-1], "trying settings")
    candidates = train_grid(run.shared, data, held_out, config, progress_callback=trying, **options)
    is_stable = make_stability_check(
        run.shared, run.normaliser, run.layout, rows.x, rows.y, rows.phase, loop_config(run)
    )
    walked = itertools.count()

    def walks(trained: Any) -> bool:
        progress_callback(0.5 + 0.1 * min(next(walked) / len(candidates), 1.0), "walking in circles")
        return is_stable(trained)

    chosen = choose(candidates, config.tolerance, walks)
    learning = told(0.6, 0.95, chosen.choice.epochs, "learning")
    everything = to_batch(parts, run.normaliser)
    adapter = refit(run.shared, everything, chosen.choice, config, progress_callback=learning, **options)
    return adapter, {
        "choice": chosen.choice._asdict(),
        "stable_on_turns": is_stable(adapter),
        "ranking": [candidate.choice._asdict() for candidate in candidates],
    }


def precompile(run: Run, config: FewShotConfig, num_frames: int = 180) -> None:
    """Compiles all that `learn_rows` needs of a run and a grid, so that a style is learned without waiting for it.

    Args:
        run: a pretrained run.
        config: the grid.
        num_frames: of a clip of which a symmetric style is learned; other lengths need no more.
    """
    x, y = (np.asarray(part.mean, np.float32) for part in (run.normaliser.inputs, run.normaliser.outputs))
    phase = run.normaliser.initial_phase()
    rows = Features(
        np.broadcast_to(x, (num_frames, *x.shape)),
        np.broadcast_to(y, (num_frames, *y.shape)),
        np.broadcast_to(phase, (num_frames, *phase.shape)),
        np.arange(num_frames),
    )
    learn_rows(run, [rows, rows], replace(config, eval_epochs=(1,)))


def tune_style(
    run: Run,
    clip_file: ClipFile,
    config: TuningConfig,
    *,
    mirror: bool = True,
    roles_file: Path | None = None,
    overwrite: bool = False,
) -> dict[str, Any]:
    """Learns a style by tuning the run's FiLM generator to its clip, and saves the Film that it then makes.

    The tuned generator is not kept: the run's own stays as it was trained.

    Args:
        run: a run pretrained with FiLM.
        clip_file, mirror, roles_file, overwrite: as in `learn_style`.
        config: how.

    Returns:
        What is saved as `info` in style.json: source, frames, speed, settings, seconds, the last loss.

    Raises:
        InputError: for a bad clip or one of another skeleton, a style that exists, or a run without a generator.
        TrainingError: when a loss is not finite.
    """
    started = time.perf_counter()
    _check_new(run, clip_file.style, overwrite)
    parameters, sizes = load_generator(run), run.config.generator
    assert sizes is not None  # `load_generator` refuses such a run
    parts = clip_parts(load_for_layout(clip_file, run.layout, roles_file), run, mirror)
    _check_length(parts, config.batch_size, clip_file.path)
    data = style_data({clip_file.style: parts}, run.layout, run.normaliser, run.skeleton.parents)
    tuned = tune_generator(run.shared, sizes, parameters, data, config, style=clip_file.style)
    info = {
        **_about_clip(run, clip_file, parts, mirror),
        "config": asdict(config),
        "loss": float(tuned.losses[-1]),
        "seconds": time.perf_counter() - started,
    }
    save_style(run.path, clip_file.style, tuned.film, info, overwrite)
    return info


def _about_clip(run: Run, clip_file: ClipFile, parts: list[Features], mirror: bool) -> dict[str, Any]:
    """What a style's `style.json` tells of its clip, whichever way it was learned."""
    return {
        "source": clip_file.path.name,
        "frames": len(parts[0].x),
        "mirrored": mirror,
        "speed": median_speed(run.layout, parts[0].y),
    }


def clip_parts(labelled: LabelledClip, run: Run, mirror: bool) -> list[Features]:
    """A clip's rows and, with `mirror`, those of its mirror image.

    Raises:
        InputError: if its skeleton is not the run's, or it has no usable frames.
    """
    labelled = match_hands(labelled, run.layout)
    check_same_topology(run.skeleton, labelled.clip.skeleton, labelled.clip.source)
    return labelled_features(labelled, run.layout, mirror)


def _bones(run: Run) -> Bones | None:
    """Of the rows, where the layout's paper trains with bone lengths."""
    if not run.layout.next_frame:
        return None
    if run not in _bones_of_runs:  # the same object every time: it is part of what training is compiled for
        outputs = run.normaliser.outputs
        _bones_of_runs[run] = Bones(run.layout, run.skeleton.parents, outputs.std, outputs.mean)
    return _bones_of_runs[run]


def _check_request(run: Run, style: str, config: FewShotConfig, overwrite: bool) -> None:
    _check_new(run, style, overwrite)
    if config.method in ("fine_tune", "scratch"):
        rule = "a style in a run is an adapter, a one-hot shift or a Film, not a whole network"
        raise InputError(run.path, "method", config.method, rule)
    check_adapter(run.config, AdapterConfig(config.method, config.rank), run.path)


def _check_new(run: Run, style: str, overwrite: bool) -> None:
    check_style_name(style, run.path)
    if style in list_styles(run.path) and not overwrite:
        folder = run.path / "styles" / style
        raise InputError(folder, "output", "exists", "an existing style is replaced only with --overwrite")


def _check_length(parts: list[Features], batch_size: int, source: Path) -> None:
    frames = sum(len(part.x) for part in parts)
    if frames < batch_size:
        rule = f"at least one minibatch of {batch_size} frames must remain to learn from"
        raise InputError(source, "frames", frames, rule)
