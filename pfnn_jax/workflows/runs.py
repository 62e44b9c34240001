"""Runs on disk, as the public API offers them: loading, styles, import of released weights and export."""

from __future__ import annotations

from pathlib import Path
from typing import Literal, get_args, overload

from pfnn_jax.errors import InputError
from pfnn_jax.interop.export.run import export_run
from pfnn_jax.interop.released.files import DESCRIPTION
from pfnn_jax.interop.released.holden2016 import import_released_autoencoder
from pfnn_jax.interop.released.holden2017 import import_released_pfnn
from pfnn_jax.interop.released.mason2018 import import_released_cp
from pfnn_jax.interop.released.mason2022 import import_released_lpn
from pfnn_jax.io.files import failure
from pfnn_jax.io.locks import writing
from pfnn_jax.run import Run, load_style, save_style
from pfnn_jax.run import load_run as load_local_run
from pfnn_jax.run_config import list_styles
from pfnn_jax.transfer.run import TransferRun
from pfnn_jax.workflows.hub import hub_run, is_hub_address

__all__ = ["Run", "export_run", "import_released", "list_styles", "load_run", "load_style", "save_style"]

ReleasedKind = Literal["pfnn", "cp", "lpn", "autoencoder"]


def load_run(path: str | Path, layout: str | None = None) -> Run:
    """Loads a run as it was after its last complete save.

    Args:
        path: the run directory; or `hf://OWNER/NAME`, optionally with `@REVISION`, for a run on the Hugging Face Hub,
            which is copied to the user's data folder first.
        layout: name of the layout that it must have, or None for any.

    Raises:
        InputError: if it is not a run, is damaged, has another layout, or has no shared parameters yet; if it cannot be
            downloaded, or the extra `hub` is not installed.
    """
    return load_local_run(hub_run(path) if is_hub_address(path) else path, layout)


def as_run(run: Run | str | Path) -> Run:
    """Returns a run, which is loaded if its directory or address is given.

    Raises:
        InputError: as `load_run`.
    """
    return run if isinstance(run, Run) else load_run(run)


@overload
def import_released(
    kind: Literal["pfnn", "cp", "lpn"], directory: str | Path, out: str | Path, *, overwrite: bool = False
) -> Run: ...
@overload
def import_released(
    kind: Literal["autoencoder"], directory: str | Path, out: str | Path, *, overwrite: bool = False
) -> TransferRun: ...
def import_released(
    kind: ReleasedKind, directory: str | Path, out: str | Path, *, overwrite: bool = False
) -> Run | TransferRun:
    """Makes a run from the authors' released weights, or from files that `export_run` wrote in the format `bins`.

    Args:
        kind: `pfnn` (Holden 2017), `cp` (the files of Mason 2018's demo, with their description), `lpn` (Mason 2022,
            with its 100 styles) or `autoencoder` (Holden 2016), which makes a run of style transfer.
        directory: folder of `.bin` files; for `autoencoder` of the two `.npz` files.
        out: the run's folder.
        overwrite: replace an existing run.

    Raises:
        InputError: for an unknown kind, a file that is absent or has the wrong size, or an existing run or one
            that another process is writing.
    """
    importers = {
        "pfnn": import_released_pfnn,
        "cp": import_released_cp,
        "lpn": import_released_lpn,
        "autoencoder": import_released_autoencoder,
    }
    if kind not in importers:
        raise InputError("import_released", "kind", kind, f"must be one of {', '.join(get_args(ReleasedKind))}")
    try:
        with writing(out):
            return importers[kind](directory, out, overwrite)
    except InputError:
        raise
    except (KeyError, TypeError, ValueError, AttributeError, IndexError, OverflowError) as error:
        file = Path(directory) / DESCRIPTION
        if not file.exists():
            raise
        rule = "must be as `pfnn-jax export --format bins` writes it"
        raise InputError(file, "entries", failure(error)[:80], rule) from error
