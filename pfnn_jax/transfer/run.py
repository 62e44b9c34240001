"""The run directory of style transfer: an autoencoder, and a transformation network for each style.

RUN/config.json      kind `transfer`, layout, skeleton, sizes, training, versions: enough to rebuild the run
RUN/normaliser/      mean and standard deviation of every column of the layout
RUN/autoencoder/     parameters of the motion autoencoder, with autoencoder.json (their fingerprint)
RUN/styles/NAME/     one style's transformation network and what else it stores, with style.json (fingerprint of the
                     autoencoder that it was trained with, source clips, settings, metrics)
"""

from __future__ import annotations

import importlib.metadata
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, TypeVar

import jax
import numpy as np

from pfnn_jax.errors import InputError
from pfnn_jax.io.checkpoint import fingerprint, load_record, save_record
from pfnn_jax.io.files import locate, replacing, write_json
from pfnn_jax.motion.features.normaliser import Statistics, load_statistics, save_statistics
from pfnn_jax.motion.skeleton import Skeleton, skeleton_from_json, skeleton_to_json
from pfnn_jax.run_config import TRANSFER, check_new_run, check_new_style, list_styles, read_kind, style_note
from pfnn_jax.transfer.autoencoder import MotionAutoencoder, config_of, init_autoencoder
from pfnn_jax.transfer.config import AutoencoderConfig
from pfnn_jax.transfer.layout import CLIP_LAYOUTS, ClipLayout

Tree = TypeVar("Tree")

RUN_RULE = "must be a run of style transfer, as `pfnn-jax train-transfer` or `import-released autoencoder` writes it"

BASE_AUTOENCODER = Path(__file__).resolve().parents[1] / "base_autoencoder"
"""The run in the package, which is never written to."""

NOTE, STYLE_NOTE = "autoencoder.json", "style.json"


def _versions() -> dict[str, str]:
    return {"pfnn_jax": importlib.metadata.version("pfnn-jax"), "jax": importlib.metadata.version("jax")}


@dataclass(frozen=True)
class TransferRunConfig:
    """Everything needed to rebuild a run of style transfer.

    Attributes:
        layout: name of the clip layout.
        autoencoder: sizes of the motion autoencoder.
        skeleton: as `skeleton_to_json` returns it.
        training: settings and results of the autoencoder's training, or where its parameters came from.
        versions: of pfnn_jax and jax at the time of writing.
        kind: of the run, see `run_config.read_kind`.
    """

    layout: str
    autoencoder: AutoencoderConfig
    skeleton: Mapping[str, Any]
    training: Mapping[str, Any] = field(default_factory=dict)
    versions: Mapping[str, str] = field(default_factory=_versions)
    kind: str = TRANSFER

    def __post_init__(self):
        if self.layout not in CLIP_LAYOUTS:
            allowed = ", ".join(CLIP_LAYOUTS)
            raise ValueError(f"TransferRunConfig.layout must be one of {allowed}, got {self.layout!r}.")


@dataclass(frozen=True, eq=False)
class TransferRun:
    """A loaded run of style transfer.

    Attributes:
        path: its directory.
        config: as stored.
        layout: of the rows that the networks read and write.
        skeleton: of the training data; clips are put onto it.
        statistics: by which rows are normalised.
        autoencoder: the motion autoencoder.
        fingerprint: of `autoencoder`, see `fingerprint`.
    """

    path: Path
    config: TransferRunConfig
    layout: ClipLayout
    skeleton: Skeleton
    statistics: Statistics
    autoencoder: MotionAutoencoder
    fingerprint: str


def create_transfer_run(
    path: str | Path,
    layout: ClipLayout,
    skeleton: Skeleton,
    statistics: Statistics,
    autoencoder: MotionAutoencoder,
    training: Mapping[str, Any],
    *,
    overwrite: bool = False,
) -> TransferRun:
    """Writes a run directory with an autoencoder and no styles, complete or not at all.

    Args:
        path: the run directory.
        layout: of the rows.
        skeleton: of the training data.
        statistics: by which rows were normalised.
        autoencoder: trained on them.
        training: settings and results of training: whatever config.json should record.
        overwrite: replace an existing run of style transfer, with every style in it.

    Raises:
        InputError: if the path exists and `overwrite` is not set; if it is not a run of style transfer (which is never
            replaced); if the disk is full.
    """
    path = check_new_run(path, overwrite, kind=TRANSFER)
    config = TransferRunConfig(layout.name, config_of(autoencoder), skeleton_to_json(skeleton), training)
    digest = fingerprint(autoencoder)
    with replacing(path) as new:
        new.mkdir()
        write_json(new / "config.json", asdict(config))
        save_statistics(new / "normaliser", statistics, "x")
        save_record(new / "autoencoder", autoencoder, NOTE, {"fingerprint": digest})
    return TransferRun(path, config, layout, skeleton, statistics, autoencoder, digest)


def load_transfer_config(path: str | Path) -> TransferRunConfig:
    """Reads RUN/config.json of a run of style transfer.

    Raises:
        InputError: if it is absent, malformed or of another kind of run, or a value breaks a rule.
    """
    file = (locate(Path(path)) or Path(path)) / "config.json"
    data = read_kind(file, TRANSFER, RUN_RULE)
    try:
        return TransferRunConfig(autoencoder=AutoencoderConfig(**data.pop("autoencoder")), **data)
    except KeyError as error:
        raise InputError(file, "entry", f"{error.args[0]} is absent", RUN_RULE) from error
    except (TypeError, ValueError) as error:
        raise InputError(file, "entries", str(error).removesuffix("."), RUN_RULE) from error


def load_transfer_run(path: str | Path, layout: str | None = None) -> TransferRun:
    """Loads a run of style transfer.

    Args:
        path: the run directory.
        layout: name of the layout that it must have, or None for any.

    Raises:
        InputError: if it is not such a run, is damaged, or has another layout.
    """
    config = load_transfer_config(path)
    path = locate(Path(path)) or Path(path)
    if layout is not None and layout != config.layout:
        raise InputError(path, "layout", config.layout, f"must be {layout}: layouts cannot be mixed")
    own = CLIP_LAYOUTS[config.layout]
    statistics = load_statistics(path / "normaliser", "x")
    if len(statistics.mean) != own.size:
        rule = f"must be {own.size}, the columns of layout {own.name}"
        raise InputError(path / "normaliser", "columns", len(statistics.mean), rule)
    autoencoder = load_record(
        path / "autoencoder",
        _float32(jax.eval_shape(lambda: init_autoencoder(config.autoencoder, own.size, key=jax.random.key(0)))),
    )
    skeleton = skeleton_from_json(config.skeleton, path / "config.json")
    return TransferRun(path, config, own, skeleton, statistics, autoencoder, fingerprint(autoencoder))


def save_transformation(
    run: TransferRun, name: str, parameters: Any, info: Mapping[str, Any], *, overwrite: bool = False
) -> Path:
    """Saves what one style has learned, tied to the run's autoencoder.

    Args:
        run: a loaded run, whose directory is written.
        name: of the style and of its folder.
        parameters: a tree of arrays: the transformation network, and what else the style needs.
        info: source clips, settings, metrics: whatever style.json should record.
        overwrite: replace a style of this name.

    Returns:
        The style's folder.

    Raises:
        InputError: if the name cannot be a folder's, the style exists, the run cannot be written or is that of the
            package, or the disk is full.
    """
    if run.path.resolve() == BASE_AUTOENCODER:
        rule = "must be a run of your own: updates of the package would remove the style"
        raise InputError(run.path, "run", "is part of the package", rule)
    folder = check_new_style(run.path, name, overwrite)
    note = {"name": name, "autoencoder": run.fingerprint, "info": info}
    save_record(folder, parameters, STYLE_NOTE, note)
    return folder


def load_transformation(run: TransferRun, name: str, abstract: Tree) -> Tree:
    """Loads what `save_transformation` saved, as the types of `abstract`.

    Args:
        run: a loaded run.
        name: of the style.
        abstract: a tree of the same structure, with arrays or what `jax.eval_shape` returns as leaves.

    Raises:
        InputError: for an unknown style (listing the known ones), for one that was trained with another autoencoder,
            and for damaged files or other shapes.
    """
    note, folder = transformation_note(run.path, name), run.path / "styles" / name
    if note.get("autoencoder") != run.fingerprint:
        rule = f"must be {run.fingerprint[:12]}: style {name} was trained with another autoencoder"
        raise InputError(folder, "autoencoder", str(note.get("autoencoder"))[:12], rule)
    return load_record(folder, _float32(abstract))


def list_transformations(path: str | Path) -> tuple[str, ...]:
    """Returns the names of the run's styles, sorted."""
    return list_styles(path)


def transformation_note(path: str | Path, name: str) -> dict[str, Any]:
    """Reads style.json of a style: `name`, `autoencoder` (fingerprint) and `info`.

    Raises:
        InputError: for an unknown style, listing the known ones.
    """
    return style_note(path, name, "train-transfer")


def _float32(tree: Tree) -> Tree:
    """Returns the shapes of a tree; parameters are float32 on disk even if the program uses float64."""
    return jax.tree.map(lambda leaf: jax.ShapeDtypeStruct(leaf.shape, np.float32), tree)
