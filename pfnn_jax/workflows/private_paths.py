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


def without_folders(value: Any) -> Any:
    """Returns JSON data in which texts name files and folders by their last part alone.

    Args:
        value: what JSON can hold.
    """
    if isinstance(value, str):
        return PATH.sub("", value.rstrip("/\\") if PATH.match(value) else value)
    if isinstance(value, Mapping):
        return {key: without_folders(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [without_folders(item) for item in value]
    return value
