"""The run directory: everything that training writes and that generation needs.

RUN/config.json     sizes, adapter, layout, skeleton, styles, settings, versions: enough to rebuild the run
RUN/normaliser/     statistics of the pretraining data, reused by every later style
RUN/shared/         style-agnostic parameters, with shared.json (their fingerprint)
RUN/differences/    what the styles of pretraining do but walk straight, with differences.json (number of rows), from
                    which later styles learn to turn; see `pfnn_jax.training.restyling`
RUN/generator/      the FiLM generator, where styles come from one, with generator.json
RUN/styles/NAME/    one style's parameters, with style.json (fingerprint of the shared parameters it was trained for,
                    form of the style, source clip, settings, metrics)
RUN/train_state/    optimiser state and step, with train_state.json, to resume exactly
RUN/metrics.jsonl   one line for each interval of training
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, TypeVar, overload

import jax
import numpy as np

from pfnn_jax.errors import InputError
from pfnn_jax.io.checkpoint import fingerprint, load_record, save_record
from pfnn_jax.io.files import locate, read_note, replacing, write_json
from pfnn_jax.io.locks import writing
from pfnn_jax.models.config import AdapterConfig
from pfnn_jax.models.film_generator import FiLMGenerator
from pfnn_jax.models.network import Network, init_network, num_parameters
from pfnn_jax.models.style import Style, init_style
from pfnn_jax.motion.datasets.sources import check_style_name
from pfnn_jax.motion.features.layout import FrameLayout, layout_for
from pfnn_jax.motion.features.normaliser import Normaliser, load_normaliser, save_normaliser
from pfnn_jax.motion.skeleton import Skeleton, skeleton_from_json
from pfnn_jax.run_config import (
    RUN_RULE,
    STATE_NOTE,
    RunConfig,
    check_adapter,
    check_new_run,
    check_new_style,
    check_present,
    load_config,
    style_note,
)

State = TypeVar("State")


@dataclass(frozen=True, eq=False)
class Run:
    """A loaded run.

    Attributes:
        path: its directory.
        config: as stored.
        layout: what the network reads and writes.
        skeleton: of the pretraining data.
        normaliser: statistics of the pretraining data.
        shared: style-agnostic parameters.
        fingerprint: of `shared`, see `fingerprint`.
    """

    path: Path
    config: RunConfig
    layout: FrameLayout
    skeleton: Skeleton
    normaliser: Normaliser
    shared: Network
    fingerprint: str


def create_run(path: str | Path, config: RunConfig, normaliser: Normaliser, overwrite: bool = False) -> Path:
    """Makes a run directory with the configuration and the normaliser, complete or not at all.

    Args:
        path: the directory.
        config: what to rebuild the run from.
        normaliser: statistics of the pretraining data.
        overwrite: replace an existing run, with everything in it.

    Raises:
        InputError: if the path exists and `overwrite` is not set; if it is not a run directory (which is never
            replaced); if a style's name cannot be a folder's; if the disk is full.
    """
    path = check_new_run(path, overwrite)
    for name in config.styles:
        check_style_name(name, path)
    with replacing(path) as new:
        save_normaliser(new / "normaliser", normaliser)
        write_json(new / "config.json", asdict(config))
    return path


def load_run(path: str | Path, layout: str | None = None) -> Run:
    """Loads a run as it was after its last complete save.

    Args:
        path: the run directory.
        layout: name of the layout that it must have, or None for any.

    Raises:
        InputError: if it is not a run, is damaged, has another layout, or has no shared parameters yet.
    """
    config = load_config(path)
    path = locate(Path(path)) or Path(path)
    if layout is not None and layout != config.layout:
        raise InputError(path, "layout", config.layout, f"must be {layout}: layouts cannot be mixed")
    normaliser = load_normaliser(path / "normaliser")
    widths = (len(normaliser.phases.mean) if normaliser.phases else 0), config.network.phase_size
    if widths[0] != widths[1]:
        rule = f"must equal phase_size {widths[1]} of config.json"
        raise InputError(path / "normaliser", "phase columns", widths[0], rule)
    for statistics, size in ((normaliser.inputs, "input_size"), (normaliser.outputs, "output_size")):
        if len(statistics.mean) != getattr(config.network, size):
            rule = f"must equal {size} {getattr(config.network, size)} of config.json"
            raise InputError(path / "normaliser", "columns", len(statistics.mean), rule)
    if locate(path / "shared") is None:
        raise InputError(path, "shared", "absent", "no shared parameters yet: run or resume pretraining first")
    shared = load_record(path / "shared", _abstract(lambda: init_network(config.network, key=jax.random.key(0))))
    skeleton = skeleton_from_json(config.skeleton, path / "config.json")
    return Run(
        path=path,
        config=config,
        layout=layout_for(config.layout, skeleton),
        skeleton=skeleton,
        normaliser=normaliser,
        shared=shared,
        fingerprint=fingerprint(shared),
    )


@contextmanager
def writing_run(run: Run | str | Path) -> Iterator[Run]:
    """Keeps other processes from writing a run during the block, and makes sure that it is the one on disk.

    Args:
        run: a run, or its directory, which is loaded under the lock.

    Yields:
        The run.

    Raises:
        InputError: if the path is not a run, or cannot be loaded; if another process is writing it; if its network has
            been trained again since the run was loaded.
    """
    if isinstance(run, Run):
        with writing(run.path):
            if (found := shared_fingerprint(run.path)) != run.fingerprint:
                rule = f"must be {_short(run.fingerprint)}, as when the run was loaded: load it again"
                raise InputError(run.path, "shared network", _short(found), rule)
            yield run
    else:
        load_config(run)  # what is not a run gets no lock file
        with writing(run):
            yield load_run(run)


def save_shared(path: str | Path, shared: Network) -> None:
    """Saves the style-agnostic parameters; styles that were trained for other ones are refused from then on.

    Raises:
        InputError: if the disk is full or cannot be written, or the run has been removed.
    """
    check_present(path)
    note = {"fingerprint": fingerprint(shared), "parameters": num_parameters(shared)}
    save_record(Path(path) / "shared", shared, "shared.json", note)


def save_generator(path: str | Path, parameters: Any) -> None:
    """Saves the FiLM generator of a run whose configuration has one."""
    note = {"shared": shared_fingerprint(path), "parameters": num_parameters(parameters)}
    save_record(Path(path) / "generator", parameters, "generator.json", note)


def load_generator(run: Run) -> FiLMGenerator:
    """Loads the parameters of the run's FiLM generator.

    Raises:
        InputError: if the run has none, it is damaged, or was trained with another shared network.
    """
    folder, sizes = run.path / "generator", run.config.generator
    if sizes is None or locate(folder) is None:
        raise InputError(run.path, "generator", "absent", "must be a run pretrained with `--adapter.kind film`")
    note = read_note(folder, "generator.json", RUN_RULE)
    if note.get("shared") != run.fingerprint:
        rule = f"must be {_short(run.fingerprint)}: the generator was trained with another shared network"
        raise InputError(folder, "shared network", _short(note.get("shared")), rule)
    return load_record(folder, _abstract(lambda: FiLMGenerator.init(sizes, key=jax.random.key(0))))


def save_style(path: str | Path, name: str, adapter: Style, info: Mapping[str, Any], overwrite: bool = False) -> Path:
    """Saves one style, tied to the run's shared parameters as they are on disk.

    Args:
        path: the run directory.
        name: of the style and of its folder.
        adapter: its parameters, of any kind; a CP adapter has the run's rank.
        info: source clip, settings, metrics: whatever style.json should record.
        overwrite: replace a style of this name.

    Returns:
        The style's folder.

    Raises:
        InputError: if the name cannot be a folder's, the style exists, the adapter does not fit the run, or the disk
            is full.
    """
    path = Path(path)
    folder = check_new_style(path, name, overwrite)
    config, form = load_config(path), adapter.config
    check_adapter(config, form, folder)
    shapes = [leaf.shape for leaf in jax.tree.leaves(abstract_style(config, form))]
    if [leaf.shape for leaf in jax.tree.leaves(adapter)] != shapes:
        raise InputError(folder, "adapter", num_parameters(adapter), f"must fit {config.network.hidden} hidden units")
    note = {"name": name, "shared": shared_fingerprint(path), "adapter": asdict(form), "info": info}
    save_record(folder, adapter, "style.json", note)
    return folder


@overload
def load_style(run: Run, name: str) -> Style: ...
@overload
def load_style(run: Run, name: None) -> None: ...
def load_style(run: Run, name: str | None) -> Style | None:
    """Loads one style's parameters, or None for style-agnostic motion where `name` is None.

    Raises:
        InputError: for an unknown style (listing the known ones), and for one that was trained for another shared
            network or is a CP adapter of another rank.
    """
    if name is None:
        return None
    note, folder = style_note(run.path, name), run.path / "styles" / name
    if note.get("shared") != run.fingerprint:
        rule = f"must be {_short(run.fingerprint)}: style {name} was trained for another shared network"
        raise InputError(folder, "shared network", _short(note.get("shared")), rule)
    try:
        form = AdapterConfig(**note["adapter"])
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(folder / "style.json", "adapter", error, "must be a kind and a rank") from error
    check_adapter(run.config, form, folder)
    return load_record(folder, abstract_style(run.config, form))


STATE_FORMAT = 2
"""Of train_state/: the names of the saved arrays; states of format 1 came without a number."""


def save_train_state(path: str | Path, state: Any, step: int, steps: int | None = None) -> None:
    """Saves the state of training after `step` of `steps`; the last good one is replaced when this one is complete.

    Raises:
        InputError: if the disk is full or cannot be written, or the run has been removed.
    """
    check_present(path)
    note = {"step": int(step), "steps": steps, "format": STATE_FORMAT}
    save_record(Path(path) / "train_state", state, STATE_NOTE, note)


def load_train_state(path: str | Path, abstract_state: State) -> State | None:
    """Loads the last completely saved state as the types of `abstract_state`, or None where there is none.

    Raises:
        InputError: if it is damaged, of other shapes, or was written by another version.
    """
    folder = Path(path) / "train_state"
    if locate(folder) is None:
        return None
    found = read_note(folder, STATE_NOTE, RUN_RULE).get("format", 1)
    if found != STATE_FORMAT:
        rule = f"must be {STATE_FORMAT}: resume with the version that wrote it, or pass overwrite=True to start again"
        raise InputError(folder, "format", found, rule)
    return load_record(folder, abstract_state)


def shared_fingerprint(path: str | Path) -> str:
    """Returns the fingerprint of the shared parameters on disk, read from their note."""
    return read_note(Path(path) / "shared", "shared.json", "the shared parameters must be saved first")["fingerprint"]


def _abstract(make: Callable[[], State]) -> State:
    """Returns the shapes of what `make` makes; parameters are float32 on disk even if the program uses float64."""
    return jax.tree.map(lambda a: jax.ShapeDtypeStruct(a.shape, np.float32), jax.eval_shape(make))


def abstract_style(config: RunConfig, form: AdapterConfig) -> Style:
    """Returns the shapes of a style of a form for the run's network, as they are on disk."""
    return _abstract(lambda: init_style(form, config.network, key=jax.random.key(0)))


def _short(digest: object) -> str:
    return str(digest)[:12]
