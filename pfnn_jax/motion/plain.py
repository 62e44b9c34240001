"""Values of all kinds in the types of JSON."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import asdict, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np


def json_text(value: Any) -> str:
    """What a JSON file holds of a value: `to_plain` of it, indented, and a last newline.

    Raises:
        TypeError: as `to_plain`.
    """
    return json.dumps(to_plain(value), indent=2, allow_nan=False) + "\n"


def to_plain(value: Any) -> Any:
    """What JSON can hold: NumPy and JAX arrays as lists, dataclasses as mappings, paths as text, NaN and ∞ as null.

    Raises:
        TypeError: for anything else, naming its type.
    """
    if value is None or isinstance(value, str | bool | int):
        return value
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, Mapping):
        return {str(key): to_plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [to_plain(item) for item in value]
    if is_dataclass(value) and not isinstance(value, type):
        return to_plain(asdict(value))
    if isinstance(value, Path):
        return str(value)
    if isinstance(value, np.generic) or hasattr(value, "__array__"):
        return to_plain(np.asarray(value).tolist())
    raise TypeError(f"JSON cannot hold a {type(value).__name__}.")
