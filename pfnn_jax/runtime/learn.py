"""A new style from one clip: features, the grid of settings, the choice, and the adapter in the run (Mason 2018 §7)."""

from __future__ import annotations

import time
from dataclasses import asdict
from pathlib import Path
from typing import Any

from pfnn_jax.errors import InputError
from pfnn_jax.models.adapters import AdapterConfig
from pfnn_jax.motion.clip import mirror_clip
from pfnn_jax.motion.features import Features, clip_features
from pfnn_jax.motion.labelled import LabelledClip, load_labelled
from pfnn_jax.motion.phase import mirror_phase
from pfnn_jax.motion.preparation import same_topology
from pfnn_jax.motion.sources import ClipFile, check_style_name
from pfnn_jax.runtime.turning import make_stability_check, mean_speed
from pfnn_jax.training.few_shot import FewShotConfig, choose, refit, train_grid
from pfnn_jax.training.run import Run, check_adapter, list_styles, save_style
from pfnn_jax.training.style_data import hold_out, to_batch


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
    parts = clip_parts(load_labelled(clip_file, run.layout.fps, roles_file), run, mirror)
    rows = parts[0]
    learn, held = hold_out(parts, config.held_out, str(clip_file.path))
    _check_length(learn, config, clip_file.path)
    candidates = train_grid(run.shared, to_batch(learn, run.normaliser), to_batch(held, run.normaliser), config)
    is_stable = make_stability_check(run.shared, run.normaliser, run.layout, rows.x, rows.y, rows.phase)
    chosen = choose(candidates, config.tolerance, is_stable)
    adapter = refit(run.shared, to_batch(parts, run.normaliser), chosen.choice, config)
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


def clip_parts(labelled: LabelledClip, run: Run, mirror: bool) -> list[Features]:
    """A clip's rows and, with `mirror`, those of its mirror image.

    Raises:
        InputError: if its skeleton is not the run's, or it has no usable frames.
    """
    clip, labels = labelled.clip, labelled.labels
    same_topology(run.skeleton, clip.skeleton, clip.source)
    parts = [clip_features(clip, run.layout, labels, labelled.gait)]
    if mirror:
        parts.append(clip_features(mirror_clip(clip), run.layout, mirror_phase(labels), labelled.gait))
    return parts


def _check_request(run: Run, style: str, config: FewShotConfig, overwrite: bool) -> None:
    check_style_name(style, run.path)
    if style in list_styles(run.path) and not overwrite:
        folder = run.path / "styles" / style
        raise InputError(folder, "output", "exists", "an existing style is replaced only with --overwrite")
    if config.method in ("fine_tune", "scratch"):
        rule = "a style in a run is an adapter: cp, full, diagonal or bias"
        raise InputError(run.path, "method", config.method, rule)
    check_adapter(run.config, AdapterConfig(config.method, config.rank), run.path)


def _check_length(parts: list[Features], config: FewShotConfig, source: Path) -> None:
    frames = sum(len(part.x) for part in parts)
    if frames < config.batch_size:
        rule = f"at least one minibatch of {config.batch_size} frames must remain to learn from"
        raise InputError(source, "frames", frames, rule)
