"""The card of a shared style: what is said about it in the metadata of its file. Importing it loads no JAX."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from pfnn_jax.errors import InputError
from pfnn_jax.io.files import to_plain
from pfnn_jax.io.tensors import read_metadata
from pfnn_jax.models.config import AdapterConfig

FORMAT = "pfnn_jax style"
VERSION = 1
"""Of what a file says about its style; a later version is refused by name."""

RULE = "must be a style as `pfnn-jax style export` writes it"

SKELETON = ("names", "parents", "offsets")
"""Entries of a run's skeleton on which its network depends."""

TEXTS = ("name", "layout", "network", "normaliser")
"""Entries that messages show as they are: one line each."""

STATED = ("source", "licence")
"""Entries that are one line too, where they are there. `style.json` of a run has them in its `info`, a file has not."""

MAX_LETTERS = 200
"""Of the texts, of `source` and of `licence`."""

MAX_NUMBER = 1e12
"""What no number in `info` reaches; JSON can hold integers that no float can."""

NUMBERS = ("frames", "speed", "steps", "error", "held_out_error", "error_without_style", "loss", "seconds")
"""Entries of `info` that other functions calculate with."""

LINES = ("notes", "warnings")
"""Entries of `info` that are lists of lines."""


@dataclass(frozen=True)
class StyleCard:
    """What the file of a style says about it.

    Attributes:
        name: of the style.
        layout: name of the frame layout.
        adapter: kind and rank.
        network: fingerprint (SHA-256) of the shared network that it was learned for.
        normaliser: fingerprint of that run's statistics.
        skeleton: that run's joint `names`, `parents` and `offsets` [J, 3] in metres.
        source: file name of the clip that it was learned from, if known.
        licence: under which it may be used, if stated.
        info: all else that the run keeps of the style: its speed in metres per second, held-out error, settings, notes.
    """

    name: str
    layout: str
    adapter: AdapterConfig
    network: str
    normaliser: str
    skeleton: Mapping[str, Any]
    source: str | None
    licence: str | None
    info: Mapping[str, Any]

    def to_metadata(self) -> dict[str, str]:
        """Returns the card as the metadata of a file: text by name, JSON where it is more than one word."""
        entries = {
            "format": FORMAT,
            "format_version": str(VERSION),
            "name": self.name,
            "source": self.source,
            "licence": self.licence,
            "layout": self.layout,
            "adapter": _json(asdict(self.adapter)),
            "network": self.network,
            "normaliser": self.normaliser,
            "info": _json(self.info),
            "skeleton": _json(self.skeleton),
        }
        return {key: value for key, value in entries.items() if value is not None}

    def style_info(self) -> dict[str, Any]:
        """Returns what `style.json` of a run is to record as `info`."""
        stated = {"source": self.source, "licence": self.licence}
        return {**{key: value for key, value in stated.items() if value is not None}, **self.info}


def is_number(value: Any) -> bool:
    """Returns whether a value of JSON is a number to calculate with: not true, false, NaN or an immense one."""
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < MAX_NUMBER


def read_style_card(file: str | Path) -> StyleCard:
    """Reads what the file of a style says about it, without its parameters.

    Raises:
        InputError: if it is not such a file, is damaged, or was written by a later version.
    """
    file = Path(file)
    return card_from_metadata(read_metadata(file), file)


def card_from_metadata(metadata: Mapping[str, str], file: Path) -> StyleCard:
    """Returns the card that `StyleCard.to_metadata` wrote.

    Raises:
        InputError: if an entry is absent or malformed, or was written by a later version.
    """
    if metadata.get("format") != FORMAT:
        raise InputError(file, "format", ascii(metadata.get("format", "absent"))[:60], RULE)
    if metadata.get("format_version") != str(VERSION):
        found = ascii(metadata.get("format_version", "absent"))[:60]
        raise InputError(file, "format version", found, f"must be {VERSION}: it needs another version of pfnn_jax")
    texts = {key: _entry(metadata, key, file) for key in TEXTS}
    stated = {key: metadata.get(key) for key in STATED}
    for key, text in {**texts, **stated}.items():
        if text is not None and not (isinstance(text, str) and text.isprintable() and len(text) <= MAX_LETTERS):
            raise InputError(file, key, ascii(text)[:60], f"must be a line of at most {MAX_LETTERS} characters")
    info = _object(metadata, "info", file)
    _check_info(info, file)
    return StyleCard(
        **texts,
        adapter=_adapter(_object(metadata, "adapter", file), file),
        skeleton=_skeleton(_object(metadata, "skeleton", file), file),
        source=metadata.get("source"),
        licence=metadata.get("licence"),
        info=info,
    )


def _adapter(entries: Mapping[str, Any], file: Path) -> AdapterConfig:
    """Returns the kind and rank of a style; its rank becomes a size of arrays, and is an integer therefore."""
    if entries.keys() != {"kind", "rank"}:
        raise InputError(file, "adapter", ascii(list(entries))[:60], "must have a kind and a rank alone")
    if type(entries["rank"]) is not int:
        raise InputError(file, "adapter", f"rank {ascii(entries['rank'])[:60]}", "must be an integer")
    try:
        return AdapterConfig(**entries)
    except (TypeError, ValueError) as error:
        raise InputError(file, "adapter", str(error).removesuffix(".")[:200], RULE) from error


def _skeleton(entries: Mapping[str, Any], file: Path) -> dict[str, Any]:
    if missing := [key for key in SKELETON if not isinstance(entries.get(key), list)]:
        raise InputError(file, "skeleton", f"{missing[0]} is absent", RULE)
    return {key: entries[key] for key in SKELETON}


def _check_info(info: Mapping[str, Any], file: Path) -> None:
    """Refuses entries that are not what those who read `style.json` take for granted, or that the card hides."""
    for key in STATED:
        if key in info:
            raise InputError(file, f"info: {key}", ascii(info[key])[:60], "must be an entry next to `info`, not in it")
    for key in NUMBERS:
        value = info.get(key)
        if value is not None and not is_number(value):
            raise InputError(file, f"info: {key}", ascii(value)[:60], f"must be a number below {MAX_NUMBER:g}")
    for key in LINES:
        value = info.get(key, [])
        if not isinstance(value, list) or not all(isinstance(line, str) for line in value):
            raise InputError(file, f"info: {key}", ascii(value)[:60], "must be a list of lines")


def _entry(metadata: Mapping[str, str], key: str, file: Path) -> str:
    if key not in metadata:
        raise InputError(file, key, "absent", RULE)
    return metadata[key]


def _object(metadata: Mapping[str, str], key: str, file: Path) -> dict[str, Any]:
    """Returns an entry that is a JSON object; Python's parser ends too deep a nesting with a RecursionError."""
    try:
        value = json.loads(_entry(metadata, key, file))
    except (json.JSONDecodeError, ValueError, RecursionError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(file, key, "is not JSON", RULE) from error
    if not isinstance(value, dict):
        raise InputError(file, key, type(value).__name__, f"must be a JSON object; {RULE}")
    return value


def _json(value: Mapping[str, Any]) -> str:
    return json.dumps(to_plain(value), ensure_ascii=False, allow_nan=False)
