"""The figure of local phases shows the computed values for any clip; the command that draws it refuses bad options."""

from __future__ import annotations

import json

import matplotlib
import numpy as np
import pytest
from matplotlib import _pylab_helpers
from matplotlib.collections import LineCollection
from matplotlib.text import Annotation

from pfnn_jax.cli import main
from pfnn_jax.evaluation.phase_plot import phase_plot
from pfnn_jax.motion.bvh import write_bvh
from pfnn_jax.motion.clip import MotionClip, cut
from pfnn_jax.motion.datasets.labelled import load_clip
from pfnn_jax.motion.datasets.sources import list_clips
from pfnn_jax.motion.labels.local_phase import clip_local_phases, toe_contacts
from pfnn_jax.motion.synthetic.walks import synthesise
from pfnn_jax.viewer.draw.drawing import png_bytes

PNG = b"\x89PNG"


@pytest.fixture(scope="module")
def walk() -> MotionClip:
    return synthesise("neutral", np.full(240, 0.3), np.full(240, 1.2), seed=1)[0]


def panels(figure) -> list:
    """Returns the panels of the four bones, without the twin axes of their phases."""
    return [axes for axes in figure.axes if axes.get_ylabel()]


def phase_lines(panel) -> LineCollection:
    return next(c for c in panel.collections if isinstance(c, LineCollection) and len(np.asarray(c.get_colors())) > 1)


def test_figure_has_a_panel_for_each_bone_and_axes_for_the_hands(walk):
    figure = phase_plot(walk, moments=5, title="a walk")
    assert [panel.get_ylabel() for panel in panels(figure)] == ["left hand", "right hand", "left toe", "right toe"]
    bodies = figure.axes[0]
    assert len(bodies.images) == 5
    assert len([text for text in bodies.texts if isinstance(text, Annotation)]) == 2 * 5
    assert figure.texts[0].get_text() == "a walk"
    assert png_bytes(figure, dpi=40).startswith(PNG)


def test_legend_explains_the_colours_and_overlaps_nothing(walk):
    figure = phase_plot(walk, title="a walk", moments=2)
    (legend,) = figure.legends
    words = [text.get_text() for text in legend.get_texts()]
    assert [word.split()[0] for word in words] == ["axis", "movement", "phase,", "toe"]
    figure.draw_without_rendering()
    box, title = legend.get_window_extent(), figure.texts[0].get_window_extent()
    bodies = [c.get_window_extent() for c in figure.axes[0].images]
    assert figure.bbox.x0 <= box.x0 and box.x1 <= figure.bbox.x1
    assert max(body.y1 for body in bodies) < box.y0 and box.y1 < title.y0


def test_phase_lines_show_the_angle_and_fade_with_the_vector_length(walk):
    span = (30, 200)
    figure, phases = phase_plot(walk, span=span), clip_local_phases(walk)
    for bone, panel in enumerate(panels(figure)):
        lines, vectors = phase_lines(panel), phases[span[0] : span[1] + 1, bone]
        top = panel.get_ylim()[1]
        starts = np.array([segment[0] for segment in lines.get_segments()])
        frames = np.round(starts[:, 0] * walk.fps).astype(int) - span[0]
        angle = (starts[:, 1] / top + 1) * np.pi
        length = np.linalg.norm(vectors[frames], axis=-1)
        np.testing.assert_allclose(length * np.sin(angle), vectors[frames, 0], atol=1e-9)
        np.testing.assert_allclose(length * np.cos(angle), vectors[frames, 1], atol=1e-9)
        longest = np.linalg.norm(phases[:, bone], axis=-1).max()
        np.testing.assert_allclose(np.asarray(lines.get_colors())[:, 3], length / longest, atol=1e-6)
        # The line breaks only at the end of a cycle.
        assert len(starts) >= span[1] - span[0] - 8


def test_bars_show_the_contacts_of_their_own_foot(walk):
    figure, contacts = phase_plot(walk), toe_contacts(walk)
    for panel, contact in zip(panels(figure)[2:], (contacts[:, 1], contacts[:, 0]), strict=True):
        bars = next(c for c in panel.collections if type(c).__name__ == "PolyCollection")
        spans = [np.ptp(path.vertices[:, 0]) for path in bars.get_paths()]
        assert sum(spans) == pytest.approx(contact.sum() / walk.fps)


def test_figure_leaves_matplotlib_state_unchanged(walk):
    before = dict(matplotlib.rcParams)
    phase_plot(walk, moments=2)
    assert dict(matplotlib.rcParams) == before
    assert not _pylab_helpers.Gcf.figs


@pytest.mark.parametrize("frames", [1, 2, 9])
def test_very_short_clips_can_be_drawn(walk, frames):
    assert png_bytes(phase_plot(cut(walk, 0, frames)), dpi=30).startswith(PNG)


def test_real_clips_have_a_picture(mocap):
    clip = load_clip(list_clips(mocap / "bandai-namco-2")[50])
    assert len(panels(phase_plot(clip, moments=3))) == 4


def command(*words) -> None:
    main([str(word) for word in words])


def test_command_writes_a_png(walk, tmp_path, capsys):
    write_bvh(tmp_path / "walk.bvh", walk)
    options = ("--start", 1, "--seconds", 2, "--majority-seconds", 0.08, "--json", tmp_path / "shown.json")
    command("plot-phase", tmp_path / "walk.bvh", "--out", tmp_path / "walk.png", *options)
    assert (tmp_path / "walk.png").read_bytes().startswith(PNG)
    assert json.loads((tmp_path / "shown.json").read_text()) == {"first_frame": 60, "last_frame": 180, "fps": 60.0}
    assert "2.0 seconds of walk.bvh" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("options", "what"),
    [
        (("--start", 9), "6 seconds from 9; must lie within the clip's 4.0 seconds"),
        (("--seconds", 0), "0 seconds from 0"),
        (("--max-speed", 0), "max_speed must be positive"),
    ],
)
def test_command_refuses_a_span_outside_the_clip_or_bad_thresholds(walk, tmp_path, capsys, options, what):
    write_bvh(tmp_path / "walk.bvh", walk)
    with pytest.raises(SystemExit) as stopped:
        command("plot-phase", tmp_path / "walk.bvh", "--out", tmp_path / "walk.png", *options)
    assert stopped.value.code == 2
    lines = capsys.readouterr().err.strip().splitlines()
    assert len(lines) == 1 and what in lines[0]
    assert not (tmp_path / "walk.png").exists()


def test_command_refuses_another_file_suffix(walk, tmp_path, capsys):
    write_bvh(tmp_path / "walk.bvh", walk)
    with pytest.raises(SystemExit):
        command("plot-phase", tmp_path / "walk.bvh", "--out", tmp_path / "walk.jpg")
    assert "walk.jpg: suffix: .jpg; must be .png" in capsys.readouterr().err
    assert not (tmp_path / "walk.jpg").exists()


def test_command_keeps_an_existing_file(walk, tmp_path, capsys):
    write_bvh(tmp_path / "walk.bvh", walk)
    (tmp_path / "walk.png").write_text("mine")
    with pytest.raises(SystemExit):
        command("plot-phase", tmp_path / "walk.bvh", "--out", tmp_path / "walk.png")
    assert (tmp_path / "walk.png").read_text() == "mine"
    assert "--overwrite" in capsys.readouterr().err
