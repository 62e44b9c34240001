"""What a run directory says without its arrays: configuration, names of styles, progress. Importing it loads no JAX."""

from __future__ import annotations

import importlib.metadata
import os
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from pfnn_jax.errors import InputError, check_positive
from pfnn_jax.io.files import locate, read_json, read_note, refuse_existing, saved_names, write_json
from pfnn_jax.io.locks import RULE as LOCK_RULE
from pfnn_jax.io.locks import writer_of
from pfnn_jax.models.config import CP_KINDS, AdapterConfig, GeneratorConfig, NetworkConfig
from pfnn_jax.motion.datasets.sources import check_style_name
from pfnn_jax.motion.features.layout import LAYOUTS

STATE_NOTE = "train_state.json"

CONTROLLER, TRANSFER = "controller", "transfer"
"""Kinds of run: of a controller, and of style transfer. A configuration that names no kind is a controller's."""

READERS = {
    CONTROLLER: "is the run of a controller, which `few-shot`, `generate` and `play` read",
    TRANSFER: "is a run of style transfer, which `transfer --run` reads",
}
"""What a run of each kind is, and which commands read it, for messages."""

RUN_RULE = "must be a run directory, as `pfnn-jax pretrain` or `pfnn-jax import-released` writes it"


def _versions() -> dict[str, str]:
    return {"pfnn_jax": importlib.metadata.version("pfnn-jax"), "jax": importlib.metadata.version("jax")}


@dataclass(frozen=True)
class RunConfig:
    """Everything needed to rebuild a run.

    Attributes:
        network: sizes of the shared network.
        adapter: form of the styles that pretraining learned. A later style may be an adapter of another kind, but
            FiLM styles and adapters cannot share a network: it is trained with layer norm or without it.
        layout: name of the frame layout.
        num_joints: J.
        styles: names of the pretraining styles, in the order of the adapter bank.
        skeleton: as `skeleton_to_json` returns it.
        pretrain: settings of pretraining, or where the parameters came from.
        generator: sizes of the FiLM generator in RUN/generator/, or None.
        command_gain: factor on commanded speeds before they reach the network.
        versions: of pfnn_jax and jax at the time of writing.
    """

    network: NetworkConfig
    adapter: AdapterConfig
    layout: str
    num_joints: int
    styles: tuple[str, ...]
    skeleton: Mapping[str, Any]
    pretrain: Mapping[str, Any] = field(default_factory=dict)
    generator: GeneratorConfig | None = None
    command_gain: float = 1.0
    versions: Mapping[str, str] = field(default_factory=_versions)

    def __post_init__(self):
        if self.layout not in LAYOUTS:
            raise ValueError(f"RunConfig.layout must be one of {', '.join(LAYOUTS)}, got {self.layout!r}.")
        layout = LAYOUTS[self.layout](self.num_joints)
        if self.network.phase_size != layout.phase_size:
            raise ValueError(
                f"RunConfig.network must have phase_size {layout.phase_size} for layout {self.layout}, "
                f"got {self.network.phase_size}."
            )
        check_positive(self, "command_gain")
        sizes = (self.network.input_size, self.network.output_size)
        if sizes != (layout.input_size, layout.output_size):
            raise ValueError(
                f"RunConfig.network must have {layout.input_size} inputs and {layout.output_size} outputs "
                f"for layout {self.layout} with {self.num_joints} joints, got {sizes[0]} and {sizes[1]}."
            )


def load_config(path: str | Path) -> RunConfig:
    """Reads RUN/config.json; the shared parameters need not exist yet.

    Raises:
        InputError: if it is absent or malformed, or a value breaks a rule.
    """
    file = (locate(Path(path)) or Path(path)) / "config.json"
    data = read_kind(file, CONTROLLER, RUN_RULE)
    data.pop("kind", None)
    try:
        network, adapter = NetworkConfig(**data.pop("network")), AdapterConfig(**data.pop("adapter"))
        sizes = data.pop("generator", None)
        generator = None if sizes is None else GeneratorConfig(**sizes)
        styles = tuple(data.pop("styles"))
        return RunConfig(network=network, adapter=adapter, styles=styles, generator=generator, **data)
    except KeyError as error:
        raise InputError(file, "entry", f"{error.args[0]} is absent", RUN_RULE) from error
    except (TypeError, ValueError) as error:
        raise InputError(file, "entries", str(error).removesuffix("."), RUN_RULE) from error


def read_kind(file: Path, kind: str, rule: str) -> dict[str, Any]:
    """Reads the configuration of a run of one kind.

    Args:
        file: config.json.
        kind: CONTROLLER or TRANSFER.
        rule: what the file should be, for messages.

    Raises:
        InputError: if it is absent or malformed, or belongs to a run of another kind, naming the commands that read it.
    """
    data = read_json(file, rule)
    found = data.get("kind", CONTROLLER)
    if found != kind:
        reader = READERS.get(str(found), f"is not of a kind that this version knows; {rule}")
        raise InputError(file, "kind", found, f"must be {kind}: this {reader}")
    return data


def check_finished(path: str | Path) -> None:
    """Checks that a run can be loaded, without reading its parameters.

    Raises:
        InputError: if it is not a run directory, or its pretraining has not finished.
    """
    load_config(path)
    if locate(Path(path) / "shared") is None:
        raise InputError(path, "shared", "absent", "no shared parameters yet: run or resume pretraining first")


def has_shared(path: str | Path) -> bool:
    """Returns whether the run's pretraining has come to an end."""
    return locate(Path(path) / "shared") is not None


def check_present(path: str | Path) -> None:
    """Checks that a run is still there, before something is saved in it: a folder that was removed is not made again.

    Raises:
        InputError: if its configuration is gone.
    """
    if not (Path(path) / "config.json").is_file():
        raise InputError(path, "run", "is no longer there", "must stay where it is while it is being written")


def save_config(path: str | Path, config: RunConfig) -> None:
    """Replaces the configuration of an existing run."""
    check_present(path)
    write_json(Path(path) / "config.json", asdict(config))


def check_new_run(path: str | Path, overwrite: bool = False, kind: str = CONTROLLER) -> Path:
    """Returns the directory of a run to be written; to be called before long work.

    Raises:
        InputError: if the path exists and `overwrite` is not set; if it is not a run directory of this kind, which is
            never replaced.
    """
    path = Path(path)
    if not path.exists() or (path.is_dir() and not any(path.iterdir())):
        return path
    is_run = (path / "config.json").is_file()
    if is_run and (found := kind_at(path, kind)) != kind:
        raise InputError(path, "output", f"exists and is a {found} run", "choose another path")
    if kind == CONTROLLER and is_run and not overwrite and not has_shared(path):
        step, steps = train_progress(path) or (0, None)
        value = f"unfinished at step {step}" + (f" of {steps}" if steps else "")
        if writer := writer_of(path):
            raise InputError(path, "run", f"{value}, being written by {writer}", LOCK_RULE)
        raise InputError(path, "run", value, "pass resume=True to continue, or overwrite=True to start again")
    refuse_existing(path, overwrite)
    if not is_run:
        raise InputError(path, "output", "exists but is not a run directory", "choose another path")
    return path


def kind_at(path: Path, otherwise: str = CONTROLLER) -> str:
    """Returns the kind of the run in a folder (`CONTROLLER` or `TRANSFER`), or `otherwise` if it cannot be read."""
    try:
        return str(read_json((locate(path) or path) / "config.json", RUN_RULE).get("kind", CONTROLLER))
    except InputError:
        return otherwise


def check_new_style(path: str | Path, name: str, overwrite: bool = False) -> Path:
    """Returns the folder of a style to be saved; to be called before long work.

    Raises:
        InputError: if the name cannot be a folder's, the style exists and `overwrite` is not set, or the run cannot be
            written.
    """
    folder = Path(path) / "styles" / check_style_name(name, Path(path))
    refuse_existing(folder, overwrite)
    parent = folder.parent if folder.parent.exists() else Path(path)
    if parent.exists() and not os.access(parent, os.W_OK):
        raise InputError(parent, "folder", "read-only", "must be writable: styles are saved in it")
    return folder


def list_styles(path: str | Path) -> tuple[str, ...]:
    """Returns the names of the run's styles, sorted."""
    return saved_names(Path(path) / "styles")


def style_note(path: str | Path, name: str, command: str = "few-shot") -> dict[str, Any]:
    """Reads style.json; of a controller's style `name`, `shared` (fingerprint), `adapter` (kind and rank) and `info`.

    Args:
        path: the run directory.
        name: of the style.
        command: that saves such styles, for messages.

    Raises:
        InputError: for an unknown style, listing the known ones.
    """
    names = list_styles(path)
    if name not in names:
        raise InputError(path, "style", name, f"must be one of {', '.join(names) or '(this run has no styles yet)'}")
    return read_note(Path(path) / "styles" / name, "style.json", f"must be a style saved by `pfnn-jax {command}`")


def check_adapter(config: RunConfig, form: AdapterConfig, source: str | Path) -> None:
    """Refuses a style that does not fit the run's network; to be called before training.

    Raises:
        InputError: for a CP adapter of another rank than the run's, where that has CP adapters, and for a FiLM style
            of a network trained with adapters or the reverse: with FiLM the hidden layers are normalised.
    """
    own = config.adapter
    if {form.kind, own.kind} <= set(CP_KINDS) and form.rank != own.rank:
        raise InputError(source, "adapter rank", form.rank, f"must be {own.rank}, the rank of the run's adapters")
    if (form.kind == "film") != (own.kind == "film"):
        needed = "must be film (few-shot: --method film or --recipe generator)"
        rule = needed if own.kind == "film" else "must not be film"
        raise InputError(source, "adapter kind", form.kind, f"{rule}, as the run's styles are {own.kind}")


def train_step(path: str | Path) -> int | None:
    """Returns the step of the last completely saved state, or None where there is none."""
    found = train_progress(path)
    return None if found is None else found[0]


def train_progress(path: str | Path) -> tuple[int, int | None] | None:
    """Returns (step, steps in all) of the last completely saved state, or None where there is none."""
    folder = Path(path) / "train_state"
    if locate(folder) is None:
        return None
    note = read_note(folder, STATE_NOTE, RUN_RULE)
    return int(note["step"]), note.get("steps")
