"""The renderer of HTML players is taken whole, with its licence, out of an installed package."""

from __future__ import annotations

import base64
import gzip
import importlib.util
import zipfile
from pathlib import Path
from types import SimpleNamespace

import pytest

from pfnn_jax.viewer.player import renderer
from pfnn_jax.viewer.player.player import player_assets
from tests.raising import assert_refused

USED = ("WebGLRenderer", "SkinnedMesh", "Skeleton", "DirectionalLight", "ShadowMaterial", "PerspectiveCamera")


def test_the_renderer_is_three_js_with_its_licence():
    source = renderer.renderer_source()
    assert all(f"t.{name}=" in source for name in USED)
    assert "Three.js Authors" in source[:200] and source.count("@license") == 1
    assert "TrackballControls" not in source  # nothing else of trimesh's page
    assert renderer.renderer_licence().startswith("Copyright 2010-") and "MIT" in renderer.renderer_licence()


def test_assets_hold_the_packed_renderer_and_name_its_licence():
    packed = renderer.packed_renderer()
    assert gzip.decompress(base64.b64decode(packed)).decode() == renderer.renderer_source()
    assets = player_assets()
    assert assets.count(packed) == 1 and f"three.js: {renderer.renderer_licence()}" in assets


@pytest.mark.parametrize(
    ("content", "value"),
    [(None, "FileNotFoundError"), ({}, "KeyError"), ({"viewer.html.template": "<html></html>"}, "not found")],
)
def test_a_package_without_the_renderer_is_refused(monkeypatch, tmp_path: Path, content, value):
    path = tmp_path / renderer.ARCHIVE
    path.parent.mkdir(parents=True)
    if content is not None:
        with zipfile.ZipFile(path, "w") as archive:
            for name, text in content.items():
                archive.writestr(name, text)
    spec = SimpleNamespace(submodule_search_locations=[str(tmp_path)])
    monkeypatch.setattr(renderer, "find_spec", lambda _: spec)
    refused = renderer.renderer_source.__wrapped__
    assert_refused(refused, file=str(path), place="three.js", value=value, rule_mentions="pip install 'trimesh")


def test_a_missing_package_is_named_with_what_to_install(monkeypatch):
    monkeypatch.setattr(renderer, "find_spec", lambda _: None)
    refused = renderer.renderer_source.__wrapped__
    assert_refused(refused, place="trimesh", value="not installed", rule_mentions="pip install 'trimesh>=5,<6'")
    assert importlib.util.find_spec("trimesh") is not None
