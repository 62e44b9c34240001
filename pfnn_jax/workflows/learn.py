"""A new style from one clip, in a run: by a grid of settings (Mason 2018 §7), or by the FiLM generator (2022 §4.5)."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import jax
import numpy as np

from pfnn_jax.control.forms import zeros_of
from pfnn_jax.control.run_settings import loop_config
from pfnn_jax.control.stability import make_stability_check
from pfnn_jax.errors import InputError
from pfnn_jax.inference.mixture import load_choice
from pfnn_jax.models.config import CP_KINDS, AdapterConfig
from pfnn_jax.motion.datasets.clip_rows import (
    labelled_features,
    load_for_skeleton,
)
from pfnn_jax.motion.datasets.labelled import LabelledClip
from pfnn_jax.motion.datasets.sources import ClipFile
from pfnn_jax.motion.features.decode import median_speed
from pfnn_jax.motion.features.encode import Features
from pfnn_jax.run import Run, load_generator, load_run, save_style, writing_run
from pfnn_jax.run_config import check_adapter, check_new_style
from pfnn_jax.training.config import (
    FILM_FEW_SHOT,
    MASON2018_FEW_SHOT,
    RESTYLED_FEW_SHOT,
    FewShotConfig,
    TuningConfig,
)
from pfnn_jax.training.data import Rows, hold_out
from pfnn_jax.training.few_shot_learning import FewShotResult, fit_style, initial_parameters, row_errors
from pfnn_jax.training.hosts import is_first, wait_for_all
from pfnn_jax.training.loop import Progress as TrainingProgress
from pfnn_jax.training.loop import no_progress
from pfnn_jax.training.restyling import has_differences, load_differences
from pfnn_jax.training.tuning import Tuned, tune_generator
from pfnn_jax.workflows.clip_report import (
    ClipReport,
    RunError,
    StyleResult,
    clip_warnings,
    inspect_clip,
    result_warnings,
    run_error,
)

HELD_OUT = FewShotConfig().held_out
"""Share of the clip, at its end, on which a tuned generator's error is measured."""

Progress = Callable[[float, str], Any]
"""Called with the share that is done, 0 to 1, and what is being done."""


def learn_style(
    run: Run | str | Path,
    clip_file: ClipFile | str | Path,
    config: FewShotConfig | None = None,
    *,
    mirror: bool | None = None,
    roles_file: Path | None = None,
    overwrite: bool = False,
    progress_callback: Progress = no_progress,
) -> dict[str, Any]:
    """Learns a style from a clip for the frozen shared network, and saves it in the run.

    Args:
        run: a pretrained run, or its directory.
        clip_file: the clip, its frames and the style's name; or a BVH or glTF file, after which the style is named.
        config: how to learn, by a method that trains an adapter; `default_config` of the run by default.
        mirror: also learn from the mirrored clip; by default unless its left and right differ, see `inspect_clip`.
        roles_file: JSON naming the joints' roles.
        overwrite: replace a style of this name.
        progress_callback: called with the share that is done, 0 to 1, and what is being done.

    Returns:
        What is saved as `info` in style.json: source, frames, speed, held-out error, the choice and the ranking behind
        it, seconds; `notes` lists what was done to read the clip, `warnings` what may be wrong with the clip or the
        style, one line each.

    Raises:
        InputError: for a bad clip, a clip without steps or of a skeleton that is not a humanoid, a style that exists,
            a method that trains a whole network, an adapter of another rank than the run's, or a run that another
            process is writing or whose network has been trained again since it was loaded. Nothing is trained before.
    """
    started = time.perf_counter()
    clip_file = _as_clip_file(clip_file)
    with writing_run(run) as run:
        config = default_config(run) if config is None else config
        check_new_style(run.path, clip_file.style, overwrite)
        _check_method(run, config)
        labelled, report, parts = _read_clip(run, clip_file, mirror, roles_file, progress_callback)
        learn = hold_out(parts, config.held_out, str(clip_file.path))[0]
        if not config.restyled:  # restyled rows fill the minibatches of the shortest clip
            _check_length(learn, config.batch_size, clip_file.path)
        reference = run_error(run)
        found = _fit(run, parts, config, progress_callback)
        result = StyleResult(found.choice.held_out_error, found.error_without_style, bool(found.stable_on_turns))
        info = {
            **_about_clip(run, labelled, parts, report),
            **_about_result(result, report, reference),
            "config": asdict(config),
            "choice": found.choice._asdict(),
            "ranking": [choice._asdict() for choice in found.ranking],
            "seconds": time.perf_counter() - started,
        }
        progress_callback(0.98, "saving")
        save_style(run.path, clip_file.style, found.style, info, overwrite)
        return info


def tune_style(
    run: Run | str | Path,
    clip_file: ClipFile | str | Path,
    config: TuningConfig | None = None,
    *,
    mirror: bool | None = None,
    roles_file: Path | None = None,
    overwrite: bool = False,
    progress_callback: Progress = no_progress,
) -> dict[str, Any]:
    """Learns a style by tuning the run's FiLM generator to its clip, and saves the FiLM style that it then predicts.

    The generator is tuned twice: to the first part of the clip, to measure the error on its last part, and to all of
    it. The tuned generators are not kept: the run's own stays as it was trained. Where `jax.distributed` has connected
    several processes, all of them must call this with equal arguments; the first one saves the style.

    Args:
        run: a run pretrained with FiLM, or its directory.
        clip_file, mirror, roles_file, overwrite, progress_callback: as in `learn_style`.
        config: how to tune; `TuningConfig()` by default.

    Returns:
        What is saved as `info` in style.json: source, frames, speed, held-out error, settings, seconds, the last loss;
        `notes` and `warnings` as in `learn_style`.

    Raises:
        InputError: for a bad clip or one whose skeleton is not a humanoid, a style that exists, a run without a
            generator, or one that another process is writing or whose network has been trained again since it was
            loaded.
        TrainingError: when a loss is not finite.
        LostProcessError: if another process has ended.
    """
    started = time.perf_counter()
    clip_file = _as_clip_file(clip_file)
    with _saving_run(run) as run:
        config = TuningConfig() if config is None else config
        check_new_style(run.path, clip_file.style, overwrite)
        generator = load_generator(run)
        labelled, report, parts = _read_clip(run, clip_file, mirror, roles_file, progress_callback)
        learn, held = hold_out(parts, HELD_OUT, str(clip_file.path))
        _check_length(learn, config.batch_size, clip_file.path)
        reference = run_error(run)

        def tune(rows: Rows, begin: float, what: str) -> Tuned:
            def show(progress: TrainingProgress) -> None:
                progress_callback(begin + 0.45 * progress.step / progress.steps, what)

            return tune_generator(run.shared, generator, rows, config, progress_callback=show)

        tried, tuned = tune(_rows(run, learn), 0.0, "trying"), tune(_rows(run, parts), 0.45, "tuning")
        progress_callback(0.9, "walking in circles")
        error, without = _held_out_errors(run, [tried.style, load_choice(run, None)], held)
        result = StyleResult(error, without, _stability_check(run, parts)(tuned.style))
        info = {
            **_about_clip(run, labelled, parts, report),
            **_about_result(result, report, reference),
            "config": asdict(config),
            "loss": float(tuned.losses[-1]),
            "seconds": time.perf_counter() - started,
        }
        progress_callback(0.98, "saving")
        if is_first():
            save_style(run.path, clip_file.style, tuned.style, info, overwrite)
    if jax.process_count() > 1:
        wait_for_all("saved")
    return info


def _saving_run(run: Run | str | Path) -> AbstractContextManager[Run]:
    """Returns `writing_run` for the process that saves, and for others of several the run alone."""
    if is_first():
        return writing_run(run)
    return nullcontext(run if isinstance(run, Run) else load_run(run))


def default_config(run: Run) -> FewShotConfig:
    """Returns the few-shot settings that fit a run: FiLM for FiLM runs, else CP adapters of the run's rank.

    A style is learned from the clip and restyled rows where the run keeps differences of its styles, and else by the
    paper's recipe.
    """
    adapter = run.config.adapter
    if adapter.kind == "film":
        return FILM_FEW_SHOT
    config = RESTYLED_FEW_SHOT if has_differences(run.path) else MASON2018_FEW_SHOT
    return replace(config, rank=adapter.rank) if adapter.kind in CP_KINDS else config


def precompile(run: Run, config: FewShotConfig, num_frames: int = 180) -> None:
    """Compiles everything that `learn_style` needs for a run and a grid, so that a later style is learned at once.

    Args:
        run: a pretrained run.
        config: the grid.
        num_frames: of a clip of a symmetric style; clips of other lengths need no further compilation.
    """
    rows = _mean_rows(run, num_frames)
    _fit(run, [rows, rows], replace(config, eval_epochs=(1,)))


def precompile_rollouts(run: Run, config: FewShotConfig) -> None:
    """Compiles the rollouts on circles by which `learn_style` judges a style; `precompile` does it after training."""
    style = zeros_of(lambda key: initial_parameters(config, run.shared, key=key), jax.random.key(0))
    _stability_check(run, [_mean_rows(run, 1)])(style)


def _mean_rows(run: Run, num_frames: int) -> Features:
    """Returns rows of the mean pose."""
    x, y = (np.asarray(part.mean, np.float32) for part in (run.normaliser.inputs, run.normaliser.outputs))
    phase = run.normaliser.initial_phase()
    return Features(
        np.broadcast_to(x, (num_frames, *x.shape)),
        np.broadcast_to(y, (num_frames, *y.shape)),
        np.broadcast_to(phase, (num_frames, *phase.shape)),
        np.arange(num_frames),
    )


def load_for_run(clip_file: ClipFile, run: Run, roles_file: str | Path | None = None) -> LabelledClip:
    """Reads and labels a clip of any skeleton, and puts it onto the run's; its `note` says what was done.

    Raises:
        InputError: as `load_for_skeleton`.
    """
    return load_for_skeleton(clip_file, run.layout, run.skeleton, roles_file)


def _read_clip(
    run: Run, clip_file: ClipFile, mirror: bool | None, roles_file: Path | None, progress_callback: Progress
) -> tuple[LabelledClip, ClipReport, list[Features]]:
    """Returns the clip on the run's skeleton, what was found in it, and its rows, with those of its mirror image."""
    progress_callback(0.0, "labelling")
    labelled = load_for_run(clip_file, run, roles_file)
    report = inspect_clip(labelled, mirror)
    return labelled, report, labelled_features(labelled, run.layout, report.mirrored)


def _fit(
    run: Run, parts: list[Features], config: FewShotConfig, progress_callback: Progress = no_progress
) -> FewShotResult:
    """Learns a style from the rows of its clip and its mirror image; nothing is saved."""
    differences = load_differences(run.path, run.layout) if config.restyled else None
    # FiLM starts from the mean of the run's styles: the identity FiLM is far from every style.
    start = load_choice(run, None) if config.method == "film" else None
    options: Any = {"start": start, "is_stable": _stability_check(run, parts), "progress_callback": progress_callback}
    return fit_style(run.shared, _rows(run, parts), config, differences=differences, **options)


def _stability_check(run: Run, parts: list[Features]) -> Callable[[Any], bool]:
    """Returns a function that says whether a style walks circles without diverging, from the clip's first row."""
    first = parts[0]
    return make_stability_check(run.shared, run.normaliser, run.layout, first.x, first.y, first.phase, loop_config(run))


def _held_out_errors(run: Run, styles: list[Any], held: list[Features]) -> list[float]:
    """Returns the error of each style, of one kind, on rows that it was not learned from."""
    bank = jax.tree.map(lambda *leaves: np.stack(leaves), *styles)
    return row_errors(bank, run.shared, _rows(run, held).parts[0]).mean(axis=1).tolist()


def _rows(run: Run, parts: list[Features]) -> Rows:
    return Rows.from_features({"style": parts}, run.layout, run.normaliser, run.skeleton.parents)


def _as_clip_file(clip_file: ClipFile | str | Path) -> ClipFile:
    if isinstance(clip_file, ClipFile):
        return clip_file
    if not isinstance(clip_file, str | Path):
        raise InputError(
            "clip", "argument", type(clip_file).__name__, "must be a ClipFile or the path of a BVH or glTF file"
        )
    return ClipFile(Path(clip_file), Path(clip_file).stem)


def _about_clip(run: Run, labelled: LabelledClip, parts: list[Features], report: ClipReport) -> dict[str, Any]:
    """Returns the entries of a style's `style.json` that describe its clip, however it was learned."""
    return {
        "source": Path(labelled.clip.source).name,
        "notes": [labelled.note] if labelled.note else [],
        "frames": len(parts[0].x),
        "mirrored": report.mirrored,
        "asymmetry": report.asymmetry,
        "speed": median_speed(run.layout, parts[0].y),
    }


def _about_result(result: StyleResult, report: ClipReport, reference: RunError | None) -> dict[str, Any]:
    """Returns the entries of a style's `style.json` that judge it, however it was learned."""
    return {**result._asdict(), "warnings": [*clip_warnings(report), *result_warnings(result, reference)]}


def _check_method(run: Run, config: FewShotConfig) -> None:
    if config.method in ("fine_tune", "scratch"):
        rule = "must be an adapter, a one-hot shift or FiLM parameters: a run has one whole network"
        raise InputError(run.path, "method", config.method, rule)
    if config.restyled and not has_differences(run.path):
        rule = "must be a run that keeps differences of its styles: pretrain it again, or use --recipe mason2018"
        raise InputError(run.path, "differences", "absent", rule)
    check_adapter(run.config, AdapterConfig(config.method, config.rank), run.path)


def _check_length(parts: list[Features], batch_size: int, source: Path) -> None:
    frames = sum(len(part.x) for part in parts)
    if frames < batch_size:
        rule = f"at least one minibatch of {batch_size} frames must remain to learn from"
        raise InputError(source, "frames", frames, rule)
