"""The demo's report: what was learned from three seconds, in a table, curves, a filmstrip and motion that plays."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from pfnn_jax.control.generation import GeneratedWalk
from pfnn_jax.evaluation.plots import error_bars, loss_curves
from pfnn_jax.evaluation.report import Section, Table, write_report
from pfnn_jax.evaluation.style_methods import DEFAULT_ROW
from pfnn_jax.motion.datasets.labelled import LabelledClip
from pfnn_jax.motion.kinematics import forward_kinematics
from pfnn_jax.motion.labels.contacts import foot_contacts
from pfnn_jax.motion.skeleton import need_roles
from pfnn_jax.viewer.draw.annotated_clip import AnnotatedClip
from pfnn_jax.viewer.draw.filmstrip import filmstrip

COLUMNS = (
    "method",
    "error, straight",
    "error, unseen turns",
    "error, locked rollout",
    "turn rate reached",
    "to nearest true turn (cm)",
    "skating (cm/s)",
    "bones (mm)",
)


def write_demo_report(
    out: Path,
    result: Mapping[str, Any],
    clip: LabelledClip,
    walks: Mapping[str, GeneratedWalk],
    *,
    overwrite: bool = False,
) -> Path:
    """Writes `report.json` and `report.html`; returns the page's path.

    Args:
        out: folder.
        result: what `report.json` holds, as `demo` makes it.
        clip: the adaptation clip.
        walks: generated motion, `learned` and others.
        overwrite: replace earlier reports.
    """
    methods, pretraining = result["methods"], result["pretraining"]
    style, learned = clip.clip.style, result["few_shot"]
    best = min(methods, key=lambda row: methods[row]["measures"]["turning"]["pose_velocity"])
    before, after = (methods[row]["measures"]["turning"]["pose_velocity"] for row in ("no adapter", DEFAULT_ROW))
    facts = {
        "of walking, all that was shown of the style": f"{learned['frames'] / 60:.1f} s",
        "error on turns it never saw, without and with the adapter": f"{before:.3f} → {after:.3f}",
        "from nothing to this page": f"{result['seconds']['in all']:.0f} s",
    }
    sections = [
        Section(
            f"{style.capitalize()} on a figure-eight, learned from a straight walk",
            "Left: the whole of what was shown. Then the same network in the style it learned from it, in no style, "
            "and in one of the styles it was pretrained on, sent along the same path. Drag to look around.",
            clips=[_annotated("shown", clip), *(_annotated_walk(name, walk) for name, walk in walks.items())],
        ),
        Section(
            "What the character does",
            figures=[("The learned style on the figure-eight", filmstrip(walks["learned"].clip, moments=8))],
        ),
        Section(
            "Ways to learn a style, on exact ground truth",
            "Mean squared normalised error of joint positions and velocities on takes that no method has seen. "
            "Settings and stopping points were chosen on the last fifth of the clip and by walks on circles, never on "
            f"the turns. Least error on unseen turns here: {best}.\n\n"
            "This style raises its arms further than any of the eight that the shared network knows. An adapter bends "
            "the network's middle layer and can only recombine poses that the last layer already makes, so part of the "
            "pose stays out of its reach. Training the whole network reaches the pose; read with its error how its "
            "walks fare: how close they stay to true turns, and what becomes of the bones.",
            table=_table(methods),
            figures=[("Error by method", error_bars(_errors(methods), x_label="normalised squared error"))],
        ),
        Section(
            "Pretraining",
            figures=[("Loss", loss_curves({"8 styles": (pretraining["steps"], pretraining["loss"])}))],
        ),
    ]
    subtitle = "Procedural motion, a network pretrained on eight styles, and a ninth style from a short clip."
    headings = {"title": "pfnn_jax demo", "subtitle": subtitle, "facts": facts}
    return write_report(out, result, sections, overwrite=overwrite, **headings)


def _table(methods: Mapping[str, Any]) -> Table:
    rows = []
    for name, row in methods.items():
        m = row["measures"]
        rows.append(
            [
                name,
                m["straight"]["pose_velocity"],
                m["turning"]["pose_velocity"],
                m["locked"],
                m["turn_rate"],
                100 * m["nearest_turning_pose"],
                100 * m["skating"],
                1000 * m["bone_error"],
            ]
        )
    return Table(COLUMNS, rows, best=COLUMNS[1:4])


def _errors(methods: Mapping[str, Any]) -> dict[str, dict[str, float]]:
    return {
        name: {kind: row["measures"][kind]["pose_velocity"] for kind in ("straight", "turning")}
        for name, row in methods.items()
    }


def _annotated(name: str, labelled: LabelledClip) -> AnnotatedClip:
    clip = labelled.clip
    positions, _ = forward_kinematics(clip.skeleton, clip.root_positions, clip.rotations)
    contacts = foot_contacts(positions, need_roles(clip.skeleton), clip.fps)
    return AnnotatedClip(name, clip, phase=labelled.labels.phase, contacts=contacts)


def _annotated_walk(name: str, walk: GeneratedWalk) -> AnnotatedClip:
    contacts = foot_contacts(walk.joints.astype(np.float64), need_roles(walk.clip.skeleton), walk.clip.fps)
    return AnnotatedClip(name, walk.clip, phase=walk.phase, contacts=contacts)
