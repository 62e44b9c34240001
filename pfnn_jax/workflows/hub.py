"""Runs on the Hugging Face Hub, by addresses `hf://OWNER/NAME` or `hf://OWNER/NAME@REVISION`.

A run is downloaded into the cache of huggingface_hub and copied from there into the user's data folder, as the base
network is: the cache may be emptied at any time, and styles that are learned on the run must stay.
"""

from __future__ import annotations

import re
from pathlib import Path

from pfnn_jax.errors import InputError
from pfnn_jax.io.files import copy_once, failure
from pfnn_jax.run_config import check_finished, list_styles, load_config
from pfnn_jax.workflows.base import data_folder

SCHEME = "hf:"

ADDRESS = re.compile(r"(\w[\w.-]*)/(\w[\w.-]*)(?:@([\w./-]+))?")
"""What follows the slashes: owner, name and revision."""

PARTS = ("config.json", "*.md", "normaliser/*", "shared/*", "generator/*", "differences/*", "styles/*")
"""Files of a run that are downloaded; `*` stands for any characters, slashes included."""

DIGITS = 12
"""Of the commit, in the name of the copy."""


def is_hub_address(path: str | Path) -> bool:
    """Returns whether what is given as a run is an address on the Hub."""
    return Path(path).parts[:1] == (SCHEME,)


def hub_run(address: str | Path) -> Path:
    """Returns the user's copy of a run on the Hub, which is downloaded if this commit of it is not there yet.

    Without a network, the last commit that was downloaded is used. Several processes may call this at once.

    Raises:
        InputError: if the address is malformed, the extra `hub` is not installed, nothing can be downloaded, it is not
            a trained run with the styles that it was trained on, or the data folder cannot be written.
    """
    parts = "/".join(Path(address).parts[1:])  # a path object has merged the two slashes
    text, found = f"{SCHEME}//{parts}", ADDRESS.fullmatch(parts)
    if found is None:
        raise InputError(text, "address", text, "must be hf://OWNER/NAME or hf://OWNER/NAME@REVISION")
    owner, name, revision = found.groups()
    snapshot = _download(text, f"{owner}/{name}", revision)
    try:
        check_finished(snapshot)
        _check_complete(snapshot)
    except InputError as error:
        raise InputError(text, error.place, error.value, error.rule) from error
    target = data_folder() / "hub" / f"{owner}--{name}-{snapshot.name[:DIGITS]}"
    try:
        copy_once(snapshot, target)
    except OSError as error:
        rule = "must be writable: runs are copied there, and styles learned on them are saved in it"
        raise InputError(target, "data folder", failure(error), rule) from error
    return target


def _check_complete(snapshot: Path) -> None:
    """Refuses a run that lacks one of the styles that it was trained on: its copy, made once, would lack it for good.

    Where the Hub cannot be reached, huggingface_hub also returns the folder of a download that was interrupted.
    """
    found = list_styles(snapshot)
    if missing := [name for name in load_config(snapshot).styles if name not in found]:
        rule = "must be complete: download it again, or have it passed on by `pfnn-jax share`"
        raise InputError(snapshot, "styles", f"{ascii(missing[0])[:60]} is absent", rule)


def _download(address: str, repository: str, revision: str | None) -> Path:
    """Returns the folder of a commit in the cache of huggingface_hub, named after the commit."""
    try:
        from huggingface_hub import snapshot_download
    except ImportError as error:
        rule = "install the extra hub: `pip install '.[hub]'` in the project folder"
        raise InputError(address, "package", "huggingface_hub is not installed", rule) from error
    try:
        folder = snapshot_download(repository, revision=revision, allow_patterns=list(PARTS), library_name="pfnn_jax")
    except (OSError, ValueError) as error:  # no network, no such repository or revision, a name that the Hub refuses
        first = str(error).strip().partition("\n")[0][:200] or type(error).__name__
        raise InputError(
            address, "download", first, "must be a run on the Hugging Face Hub, and the Hub be reached"
        ) from error
    return Path(folder)
