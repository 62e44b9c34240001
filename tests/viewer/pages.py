"""A clip to show, and checks of the HTML that shows it."""

from __future__ import annotations

import base64
import gzip
import html
import json
import re
from dataclasses import dataclass
from html.parser import HTMLParser

import numpy as np

from pfnn_jax.motion.kinematics import forward_kinematics, quat_normalise
from pfnn_jax.motion.skeleton import Skeleton
from pfnn_jax.motion.skinned_mesh import SkinnedMesh
from pfnn_jax.motion.synthetic.walks import STYLES, stance_contacts, synthesise
from pfnn_jax.viewer.draw.annotated_clip import AnnotatedClip

VOID = {"meta", "input", "img"}


def make_annotated(name: str = "zombie", frames: int = 120, extras: bool = True) -> AnnotatedClip:
    style = STYLES["zombie"]
    clip, labels = synthesise(style, np.full(frames, 0.5), np.full(frames, 0.8))
    return (
        AnnotatedClip(name, clip, labels.phase, stance_contacts(style, labels.phase))
        if extras
        else AnnotatedClip(name, clip)
    )


class Balanced(HTMLParser):
    """Checks that every tag is closed, and collects the resources that the page would load."""

    def __init__(self):
        super().__init__()
        self.open: list[str] = []
        self.sources: list[str] = []

    def handle_starttag(self, tag, attrs):
        self.sources += [value for key, value in attrs if key in ("src", "href") and value is not None]
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag


def check_page(page: str) -> None:
    parser = Balanced()
    parser.feed(page)
    assert parser.open == []
    assert all(source.startswith("data:") for source in parser.sources)
    assert "http://" not in page and "https://" not in page and "@import" not in page


def payload(page: str) -> dict:
    """Returns the data of a page's first player."""
    found = re.search(r'<script type="application/json">(.*?)</script>', page, re.DOTALL)
    assert found is not None
    return json.loads(found[1])


def captions(page: str) -> list[str]:
    """Returns the captions of a page."""
    return [html.unescape(name) for name in re.findall(r"<figcaption>([^<]*)<", page)]


@dataclass(frozen=True)
class Played:
    """What a page shows of a clip: world positions [T, J, 3] and rotations [T, J, 4] of its joints, and its mesh."""

    positions: np.ndarray
    rotations: np.ndarray
    focus: np.ndarray
    mesh: SkinnedMesh


def played(player: dict, number: int = 0) -> Played:
    """Reads a clip of a player as the page does."""
    clip = player["clips"][number]
    parents, unit = clip["parents"], clip["unit"]
    offsets, root, focus = (unit * unpack(clip[name], 3) for name in ("offsets", "root", "focus"))
    local = quat_normalise(unpack(clip["rotations"], 4 * len(parents)).reshape(len(root), -1, 4))
    skeleton = Skeleton(tuple(map(str, range(len(parents)))), np.array(parents), offsets, (), np.arange(len(parents)))
    positions, rotations = forward_kinematics(skeleton, root, local)
    return Played(positions, rotations, focus, _mesh(player["meshes"][clip["mesh"]]))


def _mesh(data: dict) -> SkinnedMesh:
    bind, unit = unpack(data["bind"], 7), data["unit"]
    return SkinnedMesh(
        vertices=unit * unpack(data["vertices"], 3),
        normals=unpack(data["normals"], 3) / 127,
        faces=unpack(data["faces"], 3),
        joints=unpack(data["bones"], 4),
        weights=unpack(data["weights"], 4) / 255,
        colours=unpack(data["colours"], 3).astype(np.uint8),
        bind_positions=unit * bind[:, :3],
        bind_rotations=quat_normalise(bind[:, 3:]),
    )


def unpack(text: str, columns: int) -> np.ndarray:
    """Returns the whole numbers [N, columns] that `pack` wrote."""
    planes = np.frombuffer(gzip.decompress(base64.b64decode(text)), np.uint8).reshape(4, -1)
    coded = np.ascontiguousarray(planes.T).view("<u4").ravel().astype(np.int64)
    return np.cumsum(np.where(coded % 2, -(coded + 1) // 2, coded // 2).reshape(columns, -1), axis=1).T
