"""The renderer of HTML players: three.js, taken out of the installed package trimesh."""

from __future__ import annotations

import base64
import gzip
import io
import re
import zipfile
from functools import cache
from importlib.util import find_spec
from pathlib import Path

from pfnn_jax.errors import InputError

ARCHIVE, TEMPLATE = "resources/templates/viewer.zip", "viewer.html.template"
REMEDY = "pip install 'trimesh>=5,<6', which carries three.js"
# a build for browsers: its licence, then one function that fills the object `exports`
_BUILD = re.compile(
    r"/\*\*\s*\*\s*@license\s.*?Three\.js Authors.*?\*/\s*!function.*?"
    r'Object\.defineProperty\(\w,"__esModule",\{value:!0\}\)\}\)\);',
    re.DOTALL,
)


@cache
def renderer_source() -> str:
    """Returns the script of three.js with its licence, from trimesh's own viewer.

    trimesh is searched for, not imported: an import takes longer than a player.

    Raises:
        InputError: if trimesh is not installed, or carries no three.js.
    """
    spec = find_spec("trimesh")
    folders = spec.submodule_search_locations if spec is not None else None
    if not folders:
        raise InputError("viewer", "trimesh", "not installed", f"HTML players need {REMEDY}")
    path = Path(folders[0]) / ARCHIVE
    try:
        with zipfile.ZipFile(io.BytesIO(path.read_bytes())) as archive:
            page = archive.read(TEMPLATE).decode("utf-8")
    except (OSError, KeyError, ValueError, zipfile.BadZipFile) as error:
        raise InputError(path, "three.js", type(error).__name__, f"HTML players need {REMEDY}") from None
    found = _BUILD.search(page)
    if found is None:
        raise InputError(path, "three.js", "not found", f"HTML players need {REMEDY}")
    return found[0]


@cache
def packed_renderer() -> str:
    """Returns `renderer_source` compressed by gzip, in base64: a third of its size, and safe inside any element."""
    return base64.b64encode(gzip.compress(renderer_source().encode("utf-8"), 9, mtime=0)).decode("ascii")


def renderer_licence() -> str:
    """Returns the text of the licence comment at the start of `renderer_source`."""
    comment = renderer_source().split("*/", 1)[0]
    return " ".join(line.strip(" /*") for line in comment.splitlines()).split("@license", 1)[1].strip()
