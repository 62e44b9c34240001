"""A style of a run as one file, and into another run of the same shared network."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import jax
import numpy as np

from pfnn_jax.errors import InputError
from pfnn_jax.io.checkpoint import fingerprint
from pfnn_jax.io.files import refuse_existing, require_suffix
from pfnn_jax.io.tensors import SUFFIX, read_tensors, shown, write_tensors
from pfnn_jax.models.style import Style
from pfnn_jax.motion.features.normaliser import Normaliser
from pfnn_jax.motion.skeleton import Skeleton
from pfnn_jax.run import Run, abstract_style, load_style, save_style, writing_run
from pfnn_jax.run_config import check_adapter, check_new_style, style_note
from pfnn_jax.workflows.private_paths import without_folders
from pfnn_jax.workflows.runs import as_run
from pfnn_jax.workflows.style_card import MAX_LETTERS, SKELETON, StyleCard, card_from_metadata


def export_style(
    run: Run | str | Path, name: str, out: str | Path, *, licence: str | None = None, overwrite: bool = False
) -> StyleCard:
    """Writes a style of a run as one file, with a card that says what it is and which network it fits.

    Args:
        run: a run, or its directory.
        name: of one of its styles.
        out: the file, `.safetensors`.
        licence: under which the style may be used, instead of what the run says of it.
        overwrite: replace an existing file.

    Returns:
        The card, as the file states it. Folders of this machine are left out of it.

    Raises:
        InputError: for an unknown style or one that does not fit its run, another suffix, a licence that is more than
            one line of 200 characters, or a file that exists or cannot be written.
    """
    run, out = as_run(run), Path(out)
    require_suffix(out, (SUFFIX,))
    refuse_existing(out, overwrite)
    style = load_style(run, name)
    card = _card(run, name, style)
    card = card if licence is None else replace(card, licence=licence)
    card_from_metadata(card.to_metadata(), out)  # what is written can be read
    write_tensors(out, {key: np.asarray(leaf) for key, leaf in _named_leaves(style).items()}, card.to_metadata())
    return card


def import_style(
    run: Run | str | Path, file: str | Path, name: str | None = None, *, overwrite: bool = False
) -> StyleCard:
    """Saves the style of a file in a run, if it was learned for that run's network.

    Args:
        run: a run, or its directory.
        file: as `export_style` writes it.
        name: of the style in the run; by default as in the file.
        overwrite: replace a style of this name.

    Returns:
        The file's card, with the name that the style has in the run.

    Raises:
        InputError: if the file is damaged or too large; if the style is for another shared network, layout or skeleton,
            is of an unknown kind, has a parameter that is missing, unknown, of another shape or not finite; if the name
            is taken or cannot be a folder's; if another process is writing the run, or its network has been trained
            again since it was loaded. The run is as before then.
    """
    file = Path(file)
    arrays, metadata = read_tensors(file)
    card = card_from_metadata(metadata, file)
    card = card if name is None else replace(card, name=name)
    with writing_run(run) as run:
        check_new_style(run.path, card.name, overwrite)
        check_fits(card, run, file)
        save_style(run.path, card.name, _to_style(arrays, card, run, file), card.style_info(), overwrite)
    return card


def check_fits(card: StyleCard, run: Run, file: Path) -> None:
    """Refuses the style of a file that was learned for another network than a run's.

    Raises:
        InputError: naming what differs: layout, skeleton, shared network, statistics, or the kind or rank of adapters.
    """
    if card.layout != run.config.layout:
        raise InputError(file, "layout", card.layout, f"must be {run.config.layout}, the layout of {run.path}")
    if differing := _differing(card.skeleton, _skeleton_entries(run.skeleton)):
        raise InputError(file, "skeleton", differing, f"must be as in the skeleton of {run.path}")
    for place, found, wanted in (
        ("shared network", card.network, run.fingerprint),
        ("normaliser", card.normaliser, normaliser_fingerprint(run.normaliser)),
    ):
        if found != wanted:
            rule = f"must be {wanted}: the style was learned for another network than that of {run.path}"
            raise InputError(file, place, found, rule)
    check_adapter(run.config, card.adapter, file)


def normaliser_fingerprint(normaliser: Normaliser) -> str:
    """Returns the fingerprint of a run's statistics: of inputs, outputs and, where it is a vector, gating input."""
    sides = {name: getattr(normaliser, name) for name in ("inputs", "outputs", "phases")}
    return fingerprint({name: vars(side) for name, side in sides.items() if side is not None})


def _card(run: Run, name: str, style: Style) -> StyleCard:
    info = without_folders(style_note(run.path, name).get("info", {}))
    source = info.pop("source", None)
    return StyleCard(
        name=name,
        layout=run.config.layout,
        adapter=style.config,
        network=run.fingerprint,
        normaliser=normaliser_fingerprint(run.normaliser),
        skeleton=_skeleton_entries(run.skeleton),
        source=shown(source, MAX_LETTERS) if isinstance(source, str) else None,  # file names may hold anything
        licence=info.pop("licence", None),
        info=info,
    )


def _skeleton_entries(skeleton: Skeleton) -> dict[str, Any]:
    return {key: np.asarray(getattr(skeleton, key)).tolist() for key in SKELETON}


def _differing(found: Mapping[str, Any], wanted: Mapping[str, Any]) -> str:
    """Returns what the first difference between two skeletons is, or nothing."""
    for key in SKELETON:
        if len(found[key]) != len(wanted["names"]):
            return f"{key} of {len(found[key])} joints"
    for key in SKELETON:
        for joint, one, other in zip(wanted["names"], found[key], wanted[key], strict=True):
            if one != other:
                return f"{key} of joint {joint}: {ascii(one)[:60]}"
    return ""


def _to_style(arrays: Mapping[str, np.ndarray], card: StyleCard, run: Run, file: Path) -> Style:
    """Returns the style with a file's arrays, each of which must have the shape that the run's network asks for."""
    abstract = abstract_style(run.config, card.adapter)
    expected = _named_leaves(abstract)
    for name in (*expected, *arrays):
        found, wanted = (list(side[name].shape) if name in side else "absent" for side in (arrays, expected))
        if found != wanted:
            raise InputError(file, f"parameter {shown(name)}", found, f"must be {wanted}")
        if not np.isfinite(arrays[name]).all():
            raise InputError(file, f"parameter {shown(name)}", "nan or infinity", "all numbers must be finite")
    return jax.tree.unflatten(jax.tree.structure(abstract), [arrays[name] for name in expected])


def _named_leaves(style: Style) -> dict[str, Any]:
    """Returns a style's arrays by their dotted names, in the order of its tree."""
    leaves, _ = jax.tree_util.tree_flatten_with_path(style)
    return {".".join(key.name for key in path): leaf for path, leaf in leaves}
