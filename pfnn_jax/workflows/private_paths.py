"""Takes the folders of the writer's machine out of what is passed on to others."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

PATH = re.compile(
    r"(?:file://|(?<![\w:/\\.~])//|(?<![\w/\\.~])(?:[A-Za-z]:[\\/]|~\w*(?=[\\/])|/(?!/)|\\|\.\.?[\\/])).*[\\/]",
    re.DOTALL,
)
"""From the beginning of a path that is absolute, or relative to a home or the working directory, to its last separator.
Names of folders may hold spaces, so that the last separator of the whole text counts. Addresses of the web are left
alone: their `//` follows a colon."""

NAMED = ("dataset", "source")
"""Entries that name a file or folder, perhaps by a path relative to any folder; other texts may hold a slash, as in
60 and/or 30."""


def without_folders(value: Any) -> Any:
    """Returns JSON data in which texts name files and folders by their last part alone.

    Args:
        value: what JSON can hold.
    """
    if isinstance(value, str):
        return PATH.sub("", value.rstrip("/\\") if PATH.match(value) else value)
    if isinstance(value, Mapping):
        plain = {key: without_folders(item) for key, item in value.items()}
        return {key: _last_part(item) if key in NAMED else item for key, item in plain.items()}
    if isinstance(value, list | tuple):
        return [without_folders(item) for item in value]
    return value


def _last_part(value: Any) -> Any:
    """Returns the file or folder that a path ends with; what is not a path, or an address of the web, as it is."""
    if not isinstance(value, str) or "://" in value:
        return value
    return re.split(r"[\\/]", value.rstrip("\\/"))[-1]
