"""The demo's report: a table, loss curves, a filmstrip and playable motion."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from pfnn_jax.control.generation import GeneratedWalk
from pfnn_jax.demo.judging import LEARNED, NO_ADAPTER
from pfnn_jax.evaluation.plots import error_bars, loss_curves
from pfnn_jax.evaluation.report import Section, Table, write_report
from pfnn_jax.motion.datasets.labelled import LabelledClip
from pfnn_jax.motion.kinematics import forward_kinematics
from pfnn_jax.motion.labels.contacts import foot_contacts
from pfnn_jax.motion.skeleton import need_roles
from pfnn_jax.viewer.draw.annotated_clip import AnnotatedClip
from pfnn_jax.viewer.draw.filmstrip import filmstrip

COLUMNS = {
    "turn rate": "of the turn rate asked",
    "flicker": "contact changes, of the data's",
    "sliding": "sliding feet, of the data's",
    "skating": "skating feet, of the data's",
    "distance": "from the true pose, cm",
    "arms": "arms, cm",
    "legs": "legs, cm",
    "precision": "to the nearest true pose, cm",
    "path": "off the path, cm",
}
"""Measures of the judge in the table, with their headings."""

BODY = ("trunk", "arms", "legs")


def write_demo_report(
    out: Path,
    result: Mapping[str, Any],
    clip: LabelledClip,
    walks: Mapping[str, GeneratedWalk],
    *,
    overwrite: bool = False,
) -> Path:
    """Writes `report.json` and `report.html`, and returns the path of the page.

    Args:
        out: folder.
        result: content of `report.json`.
        clip: the adaptation clip.
        walks: generated motion by name, `learned` among them.
        overwrite: whether to replace earlier reports.
    """
    judged, pretraining = result["judged"], result["pretraining"]
    style, learned = clip.clip.style, result["few_shot"]
    before, after = (judged[name]["distance"] for name in (NO_ADAPTER, LEARNED))
    facts = {
        "of walking as the only example of the style": f"{learned['frames'] / 60:.1f} s",
        "from the true pose in turns, without and with the adapter": f"{before:.1f} → {after:.1f} cm",
        "of the turn rate asked": f"{judged[LEARNED]['turn rate']:.2f}",
        "from synthesis to this page": f"{result['seconds']['in all']:.0f} s",
    }
    sections = [
        Section(
            f"{style.capitalize()} on a figure-eight, learned from a straight walk",
            "Left: the adaptation clip. Then the same network along the same path in the style learned from that clip, "
            "without a style, and in one of the pretraining styles. Drag to orbit.",
            clips=[_annotated("example", clip), *(_annotated_walk(name, walk) for name, walk in walks.items())],
        ),
        Section(
            "Generated motion",
            figures=[("The learned style on the figure-eight", filmstrip(walks["learned"].clip, moments=8))],
        ),
        Section(
            "Turns that the clip does not show",
            "Characters walk along exact turns of the style, at 30, 45 and 60 degrees per second to both sides. Every "
            "frame is compared with the true one at the same phase of the gait and the same place. Nothing was chosen "
            "on these turns. The last row is a style of pretraining on turns of its own: what a character can reach "
            "that need not learn.\n\n"
            "This style raises the arms further than any of the eight pretraining styles. By the paper's recipe an "
            "adapter changes the network's middle layer: it recombines poses that the last layer represents, and the "
            "arms do not reach the full pose. The default's adapter adds to the last layer.",
            table=_table(judged),
            figures=[
                ("Distance from the true pose in turns", error_bars(_distances(judged), "", "cm from the true pose"))
            ],
        ),
        Section(
            "Pretraining",
            figures=[("Loss", loss_curves({"8 styles": (pretraining["steps"], pretraining["loss"])}))],
        ),
    ]
    subtitle = "Procedural motion, a network pretrained on eight styles, and a ninth style from a short clip."
    headings = {"title": "pfnn_jax demo", "subtitle": subtitle, "facts": facts}
    return write_report(out, result, sections, overwrite=overwrite, **headings)


def _table(judged: Mapping[str, Mapping[str, float]]) -> Table:
    rows = [[name, *(measures[measure] for measure in COLUMNS)] for name, measures in judged.items()]
    note = "Contacts are found in the motion. Sliding is the speed of feet where the true ones stand, "
        "skating that of feet near their resting height."
    return Table(("style", *COLUMNS.values()), rows, note=note)


def _distances(judged: Mapping[str, Mapping[str, float]]) -> dict[str, dict[str, float]]:
    return {name: {part: measures[part] for part in BODY} for name, measures in judged.items()}


def _annotated(name: str, labelled: LabelledClip) -> AnnotatedClip:
    clip = labelled.clip
    positions, _ = forward_kinematics(clip.skeleton, clip.root_positions, clip.rotations)
    contacts = foot_contacts(positions, need_roles(clip.skeleton), clip.fps)
    return AnnotatedClip(name, clip, phase=labelled.labels.phase, contacts=contacts)


def _annotated_walk(name: str, walk: GeneratedWalk) -> AnnotatedClip:
    contacts = foot_contacts(walk.joints.astype(np.float64), need_roles(walk.clip.skeleton), walk.clip.fps)
    return AnnotatedClip(name, walk.clip, phase=walk.phase, contacts=contacts)
