"""Reads the colour of each vertex of a glTF mesh: material, texture and vertex colours, without light.

Source: glTF 2.0 specification, section 3.9 (materials); KHR_texture_transform.
"""

from __future__ import annotations

import io
from contextlib import suppress
from typing import Any

import numpy as np
from PIL import Image

from pfnn_jax.errors import InputError
from pfnn_jax.motion.gltf.accessors import read_accessor
from pfnn_jax.motion.gltf.container import Document, is_index, read_uri
from pfnn_jax.motion.gltf.nodes import LARGEST
from pfnn_jax.motion.gltf.srgb import to_linear, to_srgb

MAX_PIXELS = 128 * 2**20
"""Most pixels of all textures that are decoded, of which one may have half: eight of 4096 × 4096. Parts whose textures
are beyond that have their material's own colour."""

SEEN = 0.3
"""Opacity below which a face of a transparent material is left out."""

PLAIN = (0.8, 0.8, 0.8, 1.0)
"""Linear colour of a mesh without a material, and of one whose texture cannot be decoded."""


class Palette:
    """Colours of the materials of one file; each texture is decoded once."""

    def __init__(self, document: Document) -> None:
        self._document = document
        self._images: dict[int, np.ndarray | None] = {}
        self._pixels_left = MAX_PIXELS

    def vertex_colours(self, primitive: dict[str, Any], count: int, place: str) -> tuple[np.ndarray, np.ndarray | None]:
        """Returns sRGB colours [V, 3] uint8 and, for a transparent material, opacities [V].

        A texture that is absent or cannot be decoded leaves the material's own colour.

        Args:
            primitive: its JSON.
            count: V vertices.
            place: where it stands, for messages.
        """
        material = self._entry("materials", primitive.get("material"))
        shading = material.get("pbrMetallicRoughness")
        shading = shading if isinstance(shading, dict) else {}
        linear = np.tile(_factor(shading.get("baseColorFactor"), bool(shading)), (count, 1))
        attributes = primitive["attributes"]
        texels = self._texels(shading.get("baseColorTexture"), attributes, count, place)
        if texels is not None:
            linear[:, :3] *= to_linear(texels[:, :3] / 255.0)
            linear[:, 3] *= texels[:, 3] / 255.0
        painted = self._painted(attributes, count, place)
        if painted is not None:
            linear[:, : painted.shape[1]] *= painted
        colours = np.rint(255.0 * to_srgb(np.clip(linear[:, :3], 0.0, 1.0))).astype(np.uint8)
        return colours, None if material.get("alphaMode", "OPAQUE") == "OPAQUE" else linear[:, 3]

    def _entry(self, name: str, index: Any) -> dict[str, Any]:
        """Returns an entry of a top-level list, or an empty one: colours are no reason to refuse a character."""
        with suppress(InputError):
            return self._document.item(name, index, name)
        return {}

    def _painted(self, attributes: dict[str, Any], count: int, place: str) -> np.ndarray | None:
        """Returns linear vertex colours [V, 3 or 4], or None."""
        for kind in ("VEC4", "VEC3") if "COLOR_0" in attributes else ():
            with suppress(InputError):
                values = read_accessor(self._document, attributes["COLOR_0"], kind, f"{place}.COLOR_0").astype(float)
                return values if len(values) == count else None
        return None

    def _texels(self, texture: Any, attributes: dict[str, Any], count: int, place: str) -> np.ndarray | None:
        """Returns the texel [V, 4] that lies under each vertex, or None."""
        if not isinstance(texture, dict):
            return None
        image, transform = self._image(texture.get("index")), _transform(texture)
        name = f"TEXCOORD_{transform.get('texCoord', texture.get('texCoord', 0))}"
        if image is None or name not in attributes:
            return None
        with suppress(InputError):
            uv = read_accessor(self._document, attributes[name], "VEC2", f"{place}.{name}").astype(float)
            if len(uv) != count:
                return None
            uv = _transformed(uv, transform)
            height, width = image.shape[:2]
            column, row = (np.floor(uv % 1.0 * (width, height)).astype(int) % (width, height)).T
            return image[row, column]
        return None

    def _image(self, texture: Any) -> np.ndarray | None:
        """Returns the image [height, width, 4] uint8 of a texture, or None."""
        entry = self._entry("textures", texture)
        extensions = entry.get("extensions")
        webp = extensions.get("EXT_texture_webp") if isinstance(extensions, dict) else None
        source = entry.get("source", webp.get("source") if isinstance(webp, dict) else None)
        if not is_index(source, MAX_PIXELS):
            return None
        if source not in self._images:
            most = min(MAX_PIXELS // 2, self._pixels_left)
            image = _decode(self._data(self._entry("images", source)), most)
            self._pixels_left -= 0 if image is None else image.shape[0] * image.shape[1]
            self._images[source] = image
        return self._images[source]

    def _data(self, image: dict[str, Any]) -> bytes:
        with suppress(InputError, OSError):
            if image.get("uri") is not None:
                return read_uri(self._document, image["uri"], "images")
            view = self._document.item("bufferViews", image.get("bufferView"), "images")
            start, length = view.get("byteOffset", 0), view.get("byteLength")
            number = view.get("buffer")
            if is_index(number, len(self._document.buffers)) and is_index(start, 2**31) and is_index(length, 2**31):
                return self._document.buffers[number][start : start + length]
        return b""


def _decode(data: bytes, most: int) -> np.ndarray | None:
    """Returns a picture [height, width, 4] uint8; None if it cannot be decoded, or has more than `most` pixels."""
    if not data:
        return None
    try:
        with Image.open(io.BytesIO(data), formats=("PNG", "JPEG", "WEBP")) as image:
            if image.width * image.height > most:
                return None
            return np.asarray(image.convert("RGBA"))
    except Exception:  # Pillow raises many kinds for broken pictures; a character is read without them
        return None


def _factor(value: Any, shaded: bool) -> np.ndarray:
    found = _numbers(value, 4)
    return np.array((1.0, 1.0, 1.0, 1.0) if shaded else PLAIN) if found is None else found


def _numbers(value: Any, size: int) -> np.ndarray | None:
    """Returns a list of numbers of the JSON [size]; None if it is none of sensible size."""
    good = isinstance(value, list) and len(value) == size
    good = good and all(type(v) in (int, float) and abs(v) <= LARGEST for v in value)
    return np.array(value, float) if good else None


def _transform(texture: dict[str, Any]) -> dict[str, Any]:
    extensions = texture.get("extensions")
    found = extensions.get("KHR_texture_transform") if isinstance(extensions, dict) else None
    return found if isinstance(found, dict) else {}


def _transformed(uv: np.ndarray, transform: dict[str, Any]) -> np.ndarray:
    """Returns texture coordinates [V, 2] scaled, turned and moved; values that are not numbers are ignored."""
    angle, scale, offset = (
        _numbers(value, size)
        for value, size in (([transform.get("rotation")], 1), (transform.get("scale"), 2), (transform.get("offset"), 2))
    )
    angle = 0.0 if angle is None else float(angle[0])
    turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    scaled = uv * (1.0 if scale is None else scale)
    return scaled @ turn.T + (0.0 if offset is None else offset)
