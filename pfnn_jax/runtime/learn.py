"""A new style from one clip, in a run: by a grid of settings (Mason 2018 §7), or by the FiLM generator (2022 §4.5)."""

from __future__ import annotations

import time
from dataclasses import asdict
from pathlib import Path
from typing import Any

from pfnn_jax.errors import InputError
from pfnn_jax.models.adapters import AdapterConfig
from pfnn_jax.motion.clip_file import ClipFile
from pfnn_jax.motion.features import Features
from pfnn_jax.motion.labelled import LabelledClip
from pfnn_jax.motion.preparation import same_topology
from pfnn_jax.motion.sources import check_style_name
from pfnn_jax.motion.takes import fit_hands, load_take, take_features
from pfnn_jax.runtime.generate import controller_of
from pfnn_jax.runtime.mixture import load_choice
from pfnn_jax.runtime.turning import make_stability_check, mean_speed
from pfnn_jax.training.few_shot import FewShotConfig, choose, refit, train_grid
from pfnn_jax.training.generator_tuning import TuningConfig, tune_generator
from pfnn_jax.training.run import Run, check_adapter, list_styles, load_generator, save_style
from pfnn_jax.training.steps import Bones
from pfnn_jax.training.style_data import hold_out, style_data, to_batch


def learn_style(
    run: Run,
    clip_file: ClipFile,
    config: FewShotConfig,
    *,
    mirror: bool = True,
    roles_file: Path | None = None,
    overwrite: bool = False,
) -> dict[str, Any]:
    """Learns a style from a clip beside the frozen shared network, and saves it in the run.

    Args:
        run: a pretrained run.
        clip_file: the clip, its frames and the style's name.
        config: the grid of settings; a method that trains an adapter.
        mirror: also learn from the mirrored clip; off for a style whose left and right differ.
        roles_file: JSON naming the joints' roles.
        overwrite: replace a style of this name.

    Returns:
        What is saved as `info` in style.json: source, frames, speed, the choice and the ranking behind it, seconds.

    Raises:
        InputError: for a bad clip, a clip without steps or of another skeleton, a style that exists, a method that
            trains a whole network, or an adapter of another rank than the run's.
    """
    started = time.perf_counter()
    _check_request(run, clip_file.style, config, overwrite)
    parts = clip_parts(load_take(clip_file, run.layout, roles_file), run, mirror)
    rows = parts[0]
    learn, held = hold_out(parts, config.held_out, str(clip_file.path))
    _check_length(learn, config.batch_size, clip_file.path)
    # A Film that changes nothing is no motion of any style: the mean of the run's styles is the nearest that is known.
    options = {"start": load_choice(run, None) if config.method == "film" else None, "bones": _bones(run)}
    data, held_out = to_batch(learn, run.normaliser), to_batch(held, run.normaliser)
    candidates = train_grid(run.shared, data, held_out, config, **options)
    is_stable = make_stability_check(
        run.shared, run.normaliser, run.layout, rows.x, rows.y, rows.phase, controller_of(run)
    )
    chosen = choose(candidates, config.tolerance, is_stable)
    adapter = refit(run.shared, to_batch(parts, run.normaliser), chosen.choice, config, **options)
    info = {
        "source": clip_file.path.name,
        "frames": len(rows.x),
        "mirrored": mirror,
        "speed": mean_speed(rows.y, run.layout),
        "config": asdict(config),
        "choice": chosen.choice._asdict(),
        "stable_on_turns": is_stable(adapter),
        "ranking": [candidate.choice._asdict() for candidate in candidates],
        "seconds": time.perf_counter() - started,
    }
    save_style(run.path, clip_file.style, adapter, info, overwrite)
    return info


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
    parts = clip_parts(load_take(clip_file, run.layout, roles_file), run, mirror)
    _check_length(parts, config.batch_size, clip_file.path)
    data = style_data({clip_file.style: parts}, run.layout, run.normaliser, run.skeleton.parents)
    tuned = tune_generator(run.shared, sizes, parameters, data, config, style=clip_file.style)
    info = {
        "source": clip_file.path.name,
        "frames": len(parts[0].x),
        "mirrored": mirror,
        "speed": mean_speed(parts[0].y, run.layout),
        "config": asdict(config),
        "loss": float(tuned.losses[-1]),
        "seconds": time.perf_counter() - started,
    }
    save_style(run.path, clip_file.style, tuned.film, info, overwrite)
    return info


def clip_parts(labelled: LabelledClip, run: Run, mirror: bool) -> list[Features]:
    """A clip's rows and, with `mirror`, those of its mirror image.

    Raises:
        InputError: if its skeleton is not the run's, or it has no usable frames.
    """
    labelled = fit_hands(labelled, run.layout)
    same_topology(run.skeleton, labelled.clip.skeleton, labelled.clip.source)
    return take_features(labelled, run.layout, mirror)


def _bones(run: Run) -> Bones | None:
    """Of the rows, where the layout's paper trains with bone lengths."""
    if not run.layout.next_frame:
        return None
    outputs = run.normaliser.outputs
    return Bones(run.layout, run.skeleton.parents, outputs.std, outputs.mean)


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
