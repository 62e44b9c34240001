"""A run as a folder to pass on: what others need, and nothing of the machine that it was trained on.

The folder is not a copy. All but `CARD.md` is written from what is loaded, so that a run's private files (state of
training, metrics, uploads, temporary files) cannot get into it, and folders of this machine are taken out of its texts.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from pfnn_jax.errors import InputError
from pfnn_jax.io.files import replacing
from pfnn_jax.io.locks import writing
from pfnn_jax.run import Run, create_run, load_generator, load_style, save_generator, save_shared, save_style
from pfnn_jax.run_config import RunConfig, check_new_run, list_styles, style_note
from pfnn_jax.training.restyling import load_differences, save_differences
from pfnn_jax.workflows.model_card import model_card
from pfnn_jax.workflows.private_paths import without_folders
from pfnn_jax.workflows.runs import as_run

CARD = "CARD.md"
"""What a run's own makers say about its data and licence, if they do; the base network has one."""


def share_run(
    run: Run | str | Path,
    out: str | Path,
    *,
    styles: Sequence[str] | None = None,
    licence: str | None = None,
    differences: bool = False,
    overwrite: bool = False,
) -> Path:
    """Writes a run as a folder to pass on, with a model card: `hf upload OWNER/NAME FOLDER` puts it on the Hub.

    Args:
        run: a run, or its directory.
        out: the folder, which is a run itself.
        styles: names of the styles to pass on; by default all.
        licence: of the whole, for the card.
        differences: also pass on RUN/differences/, with which later styles learn to turn. They are excerpts of the data
            that the run was trained on: pass them on only if that may be passed on.
        overwrite: replace an earlier folder.

    Returns:
        The folder.

    Raises:
        InputError: for an unknown style or one that does not fit its run, or a folder that exists, is not a run,
            cannot be written or that another process is writing.
        OSError: if `CARD.md` of the run cannot be read.
    """
    run, out = as_run(run), Path(out)
    check_share(run.path, out, overwrite)
    names = list_styles(run.path) if styles is None else tuple(styles)
    infos = {name: without_folders(style_note(run.path, name).get("info", {})) for name in names}
    card = (run.path / CARD).read_bytes() if (run.path / CARD).is_file() else None
    with writing(out), replacing(out) as new:
        create_run(new, _config(run.config, names), run.normaliser)
        save_shared(new, run.shared)
        if run.config.generator is not None:
            save_generator(new, load_generator(run))
        if differences and (found := load_differences(run.path, run.layout)) is not None:
            save_differences(new, found)
        for name, info in infos.items():
            save_style(new, name, load_style(run, name), info)
        if card is not None:
            (new / CARD).write_bytes(card)
        text = model_card(run, out.name, infos, licence, card is not None)
        (new / "README.md").write_text(text, encoding="utf-8")
    return out


def check_share(run: Path, out: Path, overwrite: bool) -> None:
    """Refuses a folder that a run cannot be written to; to be called before loading it.

    Raises:
        InputError: if it is the run itself or lies in it, or as `check_new_run`.
    """
    if run.resolve() in (out.resolve(), *out.resolve().parents):
        raise InputError(out, "output", "is in the run itself", "choose another path")
    check_new_run(out, overwrite)


def _config(config: RunConfig, names: Sequence[str]) -> RunConfig:
    """Returns a run's configuration for others: without names of styles that stay behind, and of folders."""
    pretrain = without_folders(config.pretrain)
    if isinstance(frames := pretrain.get("frames"), Mapping):
        pretrain["frames"] = {name: count for name, count in frames.items() if name in names}
    return replace(config, pretrain=pretrain, styles=tuple(name for name in config.styles if name in names))
