"""A clip to show, and checks of the HTML that shows it."""

from __future__ import annotations

import base64
import html
import json
import re
from html.parser import HTMLParser

import numpy as np

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
    found = re.search(r'<script type="application/json">(.*?)</script>', page, re.DOTALL)
    assert found is not None
    return json.loads(found[1])


def captions(page: str) -> list[str]:
    """Returns the captions of a page."""
    return [html.unescape(name) for name in re.findall(r"<figcaption>([^<]*)<", page)]


def decoded(annotated: dict, of: str = "points") -> np.ndarray:
    """Returns the points [T, P, 3] of a clip in metres, or the camera's target [T, 1, 3]."""
    values = np.frombuffer(base64.b64decode(annotated[of]), "<i2").astype(float) * annotated["unit"]
    return values.reshape(-1, annotated["count"] if of == "points" else 1, 3)
