"""The styles of an export: their names, their parameters, and their files."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax
import numpy as np

from pfnn_jax.control.run_settings import style_label
from pfnn_jax.inference.mixture import load_choice, need_style
from pfnn_jax.inference.style_choice import StyleChoice, file_stem
from pfnn_jax.models.style import Style, StyleSum
from pfnn_jax.run import Run
from pfnn_jax.run_config import list_styles, style_note


@dataclass(frozen=True, eq=False)
class ExportStyle:
    """One exported style or mixture.

    Attributes:
        name: label of the style or mixture, as returned by `style_label`.
        stem: the name as part of a file name.
        parameters: parameters of the style, as NumPy arrays.
    """

    name: str
    stem: str
    parameters: Style

    @property
    def kind(self) -> str:
        """Kind of the style, as in `AdapterConfig`; for a mixture of several kinds all of them, e.g. cp+cp_output."""
        parts = self.parameters.parts if isinstance(self.parameters, StyleSum) else (self.parameters,)
        return "+".join(part.kind for part in parts)


def choose_styles(run: Run, choice: StyleChoice, kind: str | None = None) -> tuple[ExportStyle, ...]:
    """Returns the chosen style, or by default all styles of the run, those of pretraining first.

    Args:
        run: a loaded run.
        choice: a name, a mixture, or None for all.
        kind: without a choice, only styles of this kind are returned.

    Raises:
        InputError: for an unknown style, a mixture of kinds that cannot be added, or a FiLM run without styles.
    """
    if choice is not None:
        return (_style(run, choice),)
    saved = list_styles(run.path)
    names = [name for name in run.config.styles if name in saved]
    names += [name for name in saved if name not in names]
    wanted = [name for name in names if kind in (None, style_note(run.path, name)["adapter"]["kind"])]
    need_style(run, wanted)
    return tuple(_style(run, name) for name in wanted)


def write_style(folder: Path, style: ExportStyle) -> dict[str, Any]:
    """Writes a style's parameters as float32 into `styles/NAME.bin` of a folder.

    Returns:
        The entry of the description: name, kind, file, and the arrays in the order of the file. FiLM parameters are
        one array: scale 1, shift 1, scale 2, shift 2.
    """
    file = Path("styles") / f"{style.stem}.bin"
    (folder / file).parent.mkdir(exist_ok=True)
    arrays = {name: np.asarray(array) for name, array in style.parameters.named_arrays().items()}
    (folder / file).write_bytes(b"".join(np.ascontiguousarray(array, "<f4").tobytes() for array in arrays.values()))
    shapes = [{"name": name, "shape": list(array.shape)} for name, array in arrays.items()]
    return {"name": style.name, "kind": style.kind, "file": file.as_posix(), "arrays": shapes}


def _style(run: Run, choice: str | Mapping[str, float]) -> ExportStyle:
    parameters, name = load_choice(run, choice), style_label(choice)
    assert parameters is not None
    return ExportStyle(name, file_stem(name), jax.tree.map(np.asarray, parameters))
