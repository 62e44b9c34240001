"""What a page writes into a run: a style that is learned, renamed, deleted and restored. `experiments.kills` kills it.

It is done with the functions that the page's buttons call, without the page's server: that writes nothing.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from pfnn_jax.io.checkpoint import fingerprint
from pfnn_jax.run import load_run, load_style
from pfnn_jax.run_config import list_styles
from pfnn_jax.training.config import FewShotConfig

LEARNED, RENAMED, OTHER = "walk", "kept", "between"
"""Names that the style has, one after another."""

RENAMES = 20
"""Times that it is renamed there and back, because a rename takes milliseconds and learning seconds."""


def use_page(folder: Path, config: FewShotConfig) -> None:
    """Learns a style, renames it often, deletes it and restores it, from wherever a killed page has left the run.

    Args:
        folder: holds `run` and `clips/old/walk.bvh`.
        config: of learning, smaller than the page's own.
    """
    from pfnn_jax.viewer.page import uploads
    from pfnn_jax.viewer.page.run_library import RunLibrary

    uploads.page_config = lambda run: config
    library = RunLibrary([folder / "run"])
    name = library.runs[0]
    present = next((style for style in (RENAMED, OTHER, LEARNED) if style in library.get(name).styles), None)
    if present is None:
        data = (folder / "clips" / "old" / "walk.bvh").read_bytes()
        present = uploads.learn_upload(library, name, f"{LEARNED}.bvh", data).style
    for new in (*(OTHER, RENAMED) * RENAMES,):
        if new != present:
            library.rename_style(name, present, new)
            present = new
    for _ in range(RENAMES):
        library.delete_style(name, present)
        library.restore_style(name)
    library.empty_trash()


def check_styles(run: Path) -> None:
    """Raises unless every style of the run can be loaded, and has the name of its folder."""
    loaded = load_run(run)
    for name in list_styles(run):
        load_style(loaded, name)


def contents(run: Path) -> list[Any]:
    """Returns what the run holds: its styles with their parameters, its uploads, and what else lies in its folder."""
    loaded = load_run(run)
    styles = {name: fingerprint(load_style(loaded, name)) for name in list_styles(run)}
    uploads = {path.name: path.read_bytes() for path in sorted((run / "uploads").glob("*"))}
    return [styles, uploads, sorted(path.name for path in run.iterdir())]
