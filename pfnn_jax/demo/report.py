"""The demo's report: a table, loss curves, a filmstrip and playable motion."""

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
    """Writes `report.json` and `report.html`, and returns the path of the page.

    Args:
        out: folder.
        result: content of `report.json`.
        clip: the adaptation clip.
        walks: generated motion by name, `learned` among them.
        overwrite: whether to replace earlier reports.
    """
    methods, pretraining = result["methods"], result["pretraining"]
    style, learned = clip.clip.style, result["few_shot"]
    best = min(methods, key=lambda row: methods[row]["measures"]["turning"]["pose_velocity"])
    before, after = (methods[row]["measures"]["turning"]["pose_velocity"] for row in ("no adapter", DEFAULT_ROW))
    facts = {
        "of walking as the only example of the style": f"{learned['frames'] / 60:.1f} s",
        "error on unseen turns, without and with the adapter": f"{before:.3f} → {after:.3f}",
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
            "Methods of learning a style, on exact ground truth",
            "Mean squared normalised error of joint positions and velocities on takes that no method was trained on. "
            "Settings and numbers of epochs were chosen on the last fifth of the clip and by walks on circles, not on "
            f"the turns. Least error on unseen turns: {best}.\n\n"
            "This style raises the arms further than any of the eight pretraining styles. An adapter changes the "
            "network's middle layer and can only recombine poses that the last layer represents, so it cannot reach "
            "the full pose. Training the whole network can; judge it also by the quality of its walks: their distance "
            "to true turns and their errors of bone lengths.",
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
