"""The kinds of style, one file each: a layer that serves as an adapter, a one-hot input, or FiLM parameters.

A file here is named after the kind that its class declares, so that the kinds can be listed without importing JAX. To
add a kind, add one file with one subclass of `pfnn_jax.models.style.Style`: configurations, the command line, run
directories, mixing and exports find it here. A subclass defined elsewhere is registered when its module is imported.
"""

from __future__ import annotations

import importlib
import pkgutil
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pfnn_jax.models.style import Style

_CLASSES: dict[str, type[Style]] = {}


def register_style(cls: type[Style]) -> None:
    """Registers a class under its kind; subclasses of `Style` that declare a `kind` do this by themselves."""
    _CLASSES[cls.kind] = cls


def style_kinds() -> tuple[str, ...]:
    """Returns the names of all kinds of style, sorted."""
    return tuple(sorted({module.name for module in pkgutil.iter_modules(__path__)} | _CLASSES.keys()))


def style_class(kind: str) -> type[Style]:
    """Returns the class of a kind of style.

    Raises:
        KeyError: for an unknown kind.
    """
    if kind not in _CLASSES and kind in style_kinds():
        importlib.import_module(f"{__name__}.{kind}")
    return _CLASSES[kind]
