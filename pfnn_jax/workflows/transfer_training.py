"""Trains a network that puts any clip into one style, from a folder of clips, into a run of style transfer."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from pfnn_jax.errors import InputError
from pfnn_jax.io.locks import writing
from pfnn_jax.motion.datasets.labelled import read_cut_clip
from pfnn_jax.motion.datasets.sources import ClipFile, list_clips, select_styles
from pfnn_jax.run_config import check_new_style
from pfnn_jax.training.loop import Progress as TrainingProgress
from pfnn_jax.training.loop import no_progress
from pfnn_jax.transfer.config import TransformationTrainingConfig
from pfnn_jax.transfer.pairing import GaitClip, pair_by_gait
from pfnn_jax.transfer.run import (
    BASE_AUTOENCODER,
    TransferRun,
    create_transfer_run,
    load_transfer_run,
    save_transformation,
)
from pfnn_jax.transfer.transformation_training import train_transformation
from pfnn_jax.workflows.transfer import Progress, as_run, num_frames, rows_for_run


def train_transfer(
    data: str | Path | Sequence[ClipFile],
    style: str,
    out: str | Path,
    config: TransformationTrainingConfig | None = None,
    *,
    autoencoder: TransferRun | str | Path | None = None,
    roles_file: str | Path | None = None,
    overwrite: bool = False,
    progress_callback: Progress = no_progress,
) -> dict[str, Any]:
    """Trains a network that puts any clip into one style, and saves it in a run of style transfer.

    The contents to train on are the clips of all other styles; each is paired with the style's clips of the same gait.
    A run that exists gets the style as one more.

    Args:
        data: folder of clips as `motion.list_clips` lists them, or such a list.
        style: one of the styles of the data.
        out: the run's folder.
        config: how to train.
        autoencoder: run whose autoencoder a new run takes; by default the package's.
        roles_file: JSON naming the joints' roles.
        overwrite: replace a style of this name.
        progress_callback: called with the share that is done, 0 to 1, and what is being done.

    Returns:
        What is saved as `info` in the style's `style.json`: source clips, settings, metrics, notes, seconds.

    Raises:
        InputError: for a style that the data do not have, data of one style only, bad clips, a style that exists, or an
            `out` that is not a run of style transfer or is being written by another process. Nothing is trained before.
        TrainingError: when a loss is not finite.
    """
    started = time.perf_counter()
    others, targets, source = _split_by_style(data, style)
    config = TransformationTrainingConfig() if config is None else config
    with writing(out):
        run, is_new = _run_to_train(Path(out), style, autoencoder, overwrite)
        rows, notes = _read_all(
            [*others, *targets], run, roles_file, lambda share: progress_callback(0.1 * share, "reading")
        )
        contents, styles = ([rows[file] for file in files if file in rows] for files in (others, targets))
        _require_clips(contents, styles, source, style)
        pairing = pair_by_gait(contents, styles, run.layout)

        def report(now: TrainingProgress) -> None:
            progress_callback(0.1 + 0.9 * now.step / now.steps, f"loss {now.loss:.4f}")

        network, metrics = train_transformation(run, contents, styles, pairing, config, progress_callback=report)
        info = {
            "sources": [Path(clip.name).name for clip in styles],
            "contents": len(contents),
            "gaits": dict(zip(pairing.groups, map(len, pairing.members), strict=True)),
            "config": asdict(config),
            "metrics": metrics,
            "notes": [*notes, *_grouped(pairing.notes)],
            "seconds": time.perf_counter() - started,
        }
        if is_new:
            run = create_transfer_run(
                out, run.layout, run.skeleton, run.statistics, run.autoencoder, run.config.training
            )
        save_transformation(run, style, network, info, overwrite=overwrite)
        return info


def _split_by_style(
    data: str | Path | Sequence[ClipFile], style: str
) -> tuple[list[ClipFile], list[ClipFile], str | Path]:
    """Returns the clips of all other styles, those of the style, and the folder to name in messages.

    Raises:
        InputError: for a style that the data do not have, for data of one style only, and for none.
    """
    clips = list_clips(data) if isinstance(data, str | Path) else list(data)
    if not clips:
        raise InputError("train_transfer", "data", "no clips", "must be a folder or a list of clips")
    source = data if isinstance(data, str | Path) else clips[0].path.parent
    targets = select_styles(clips, [style], source)
    others = [clip for clip in clips if clip.style != style]
    if not others:
        rule = "must have clips of another style as well: they are the contents to train on"
        raise InputError(source, "style", style, rule)
    return others, targets, source


def _run_to_train(
    out: Path, style: str, autoencoder: TransferRun | str | Path | None, overwrite: bool
) -> tuple[TransferRun, bool]:
    """Returns the run to train a style for: the one at `out`, or that whose autoencoder a new one takes, and which.

    Raises:
        InputError: for an `out` that is not a run of style transfer or has another autoencoder than the one wanted, and
            for a style that exists.
    """
    given = None if autoencoder is None else as_run(autoencoder)
    if not out.exists() or (out.is_dir() and not any(out.iterdir())):
        check_new_style(out, style)
        return given or as_run(BASE_AUTOENCODER), True
    run = load_transfer_run(out)
    if given is not None and given.fingerprint != run.fingerprint:
        rule = f"must be {run.fingerprint[:12]}, that of {out}, or choose another folder for the run"
        raise InputError(given.path, "autoencoder", given.fingerprint[:12], rule)
    check_new_style(out, style, overwrite)
    return run, False


def _read_all(
    files: Sequence[ClipFile], run: TransferRun, roles_file: str | Path | None, progress: Callable[[float], Any]
) -> tuple[dict[ClipFile, GaitClip], list[str]]:
    """Returns clips as rows, and what was noted; clips shorter than a filter are left out, which is noted.

    Raises:
        InputError: for a bad clip.
    """
    rows, notes, short = {}, [], []
    for number, file in enumerate(files):
        progress(number / len(files))
        cut_clip = read_cut_clip(file, roles_file)
        if num_frames(cut_clip.clip) < run.config.autoencoder.width:
            short.append(file.path)
            continue
        notes += [f"{file.path}: {cut_clip.note}"] if cut_clip.note else []
        rows[file] = GaitClip(rows_for_run(cut_clip.clip, run), file.content, str(file.path))
    notes += [f"{path}: shorter than a filter of the autoencoder, left out" for path in short]
    return rows, _grouped(notes)


def _grouped(notes: Iterable[str]) -> list[str]:
    """Returns notes "FILE: NOTE", those that many files share once."""
    files: dict[str, list[str]] = {}
    for note in notes:
        file, _, text = note.partition(": ")
        files.setdefault(text, []).append(file)
    others = {text: f" (and {len(names) - 1} more)" if len(names) > 1 else "" for text, names in files.items()}
    return [f"{names[0]}{others[text]}: {text}" for text, names in files.items()]


def _require_clips(contents: Sequence[GaitClip], styles: Sequence[GaitClip], source: str | Path, style: str) -> None:
    for what, clips in (("clips of other styles", contents), (f"clips of {style}", styles)):
        if not clips:
            raise InputError(source, what, "all are shorter than a filter", "must have at least one long enough")
