"""Films and pictures show the clips they are given, in step, and appear whole or not at all."""

from __future__ import annotations

import builtins
import io
from pathlib import Path

import numpy as np
import pytest
from matplotlib.text import Annotation
from PIL import Image

from pfnn_jax.cli import main
from pfnn_jax.errors import InputError
from pfnn_jax.motion.bvh import write_bvh
from pfnn_jax.motion.clip import resample
from pfnn_jax.motion.labels.phase import label_phase, write_phase
from pfnn_jax.motion.synthetic.walks import synthesise
from pfnn_jax.viewer import render as rendering
from pfnn_jax.viewer.draw.annotated_clip import AnnotatedClip, annotate
from pfnn_jax.viewer.draw.camera import Camera
from pfnn_jax.viewer.draw.drawing import body_shapes, outlines
from pfnn_jax.viewer.draw.filmstrip import filmstrip
from pfnn_jax.viewer.draw.scene import make_scene
from pfnn_jax.viewer.draw.video import Video
from pfnn_jax.viewer.player.player import player_html
from pfnn_jax.viewer.rendering import render
from tests.viewer.pages import captions, check_page, make_annotated, payload

EXACT = 1e-9
FPS = 10.0  # of the films made here: few frames


@pytest.fixture(autouse=True)
def plain_start(monkeypatch):
    """Of ffmpeg: a process group of its own takes a fork, of which JAX warns once it has computed."""
    monkeypatch.setenv("IMAGEIO_FFMPEG_NO_PREVENT_SIGINT", "1")


@pytest.fixture
def short() -> AnnotatedClip:
    return make_annotated(frames=40)


def test_outlines_touch_both_circles_and_enclose_them():
    a, b = np.array([0.0, 0.0]), np.array([3.0, 1.0])
    points = outlines(a, b, np.array(1.0), np.array(0.4))
    distance = np.minimum(np.linalg.norm(points - a, axis=-1) - 1.0, np.linalg.norm(points - b, axis=-1) - 0.4)
    np.testing.assert_allclose(distance, 0.0, atol=EXACT)
    edges = np.roll(points, -1, axis=0) - points
    turns = edges[:, 0] * np.roll(edges[:, 1], -1) - edges[:, 1] * np.roll(edges[:, 0], -1)
    assert (turns > -EXACT).all()  # convex, counter-clockwise
    inside = outlines(a, a + 0.1, np.array(1.0), np.array(0.2))  # one circle holds the other
    assert (np.linalg.norm(inside - a, axis=-1) <= 1.0 + EXACT).all()


def test_nearer_limbs_are_drawn_over_farther_ones_and_shades_stay_inside():
    starts, ends = np.zeros((2, 2)), np.array([[1.0, 0.0], [0.0, 1.0]])
    tones = np.arange(2 * 3 * 3, dtype=float).reshape(2, 3, 3)
    tones = np.repeat(tones, 3, axis=1)
    shapes, colours = body_shapes(starts, ends, np.full((2, 2), 0.1), np.array([5.0, -5.0]), tones)
    np.testing.assert_array_equal(colours[:9], tones[1])
    rim, light = shapes[0], shapes[8]
    assert light.min(axis=0).min() >= rim.min(axis=0).min() - EXACT and (light.max(axis=0) <= rim.max(axis=0)).all()


def test_the_camera_looks_at_its_target_from_ahead_whatever_the_heading():
    target = np.array([3.0, 0.9, -2.0])
    for heading in (0.0, 1.0, -2.5):
        camera = Camera(target, heading, 1.0, 400, 300)
        middle, scale, near = camera.project(target)
        np.testing.assert_allclose(middle, [200, 150], atol=EXACT)
        assert scale > 0 and near == 0
        ahead = target + [np.sin(heading), 0.0, np.cos(heading)]
        (x, _), closer, nearer = camera.project(ahead)
        assert nearer > 0.5 and closer > scale and x < 200  # it comes towards the viewer, from right to left
        assert np.isnan(camera.project(ahead + 9 * (ahead - target))[1])


def test_films_are_in_step_and_as_long_as_their_longest_clip(short):
    slow = AnnotatedClip("slow", resample(make_annotated(frames=90).clip, 20.0))
    video = Video([short, slow], FPS, 60)
    assert video.num_frames == 15 and video.width % 2 == 0 and video.height % 2 == 0
    frames = list(video.frames())
    assert {frame.shape for frame in frames} == {(video.height, video.width, 3)}
    left = [frame[:, : video.width // 2].astype(int) for frame in frames]
    assert np.abs(left[3] - left[2]).max() > 100 and np.abs(left[-1][:200] - left[-2][:200]).max() < 100
    np.testing.assert_array_equal(video.frame_at(0.3), frames[3])  # a frame depends on its second alone


def test_a_clip_that_has_ended_turns_pale_when_it_does_in_players(short):
    long = make_annotated(frames=60, extras=False)
    over = payload(player_html([short, long], fps=15.0))["clips"][0]["over"]
    assert over == pytest.approx(39.5 / 60, abs=1e-4)
    video = Video([AnnotatedClip("", short.clip), long], FPS, 60)
    before, after = (video.frame_at(over + late)[:, : video.width // 2].astype(int) for late in (-0.002, 0.002))
    grey = (np.ptp(before, axis=-1).max(), np.ptp(after, axis=-1).max())
    assert grey[0] > 1.5 * grey[1]  # blue and orange fade


def test_long_films_move_their_time_line(short):
    clip, _ = synthesise("neutral", np.zeros(720), np.full(720, 1.0))
    video = Video([annotate(clip, "long")], FPS, 60)
    strip = slice(video.height - 50, video.height - 12)
    early, late = video.frame_at(1.0)[strip].astype(int), video.frame_at(11.0)[strip].astype(int)
    assert np.abs(early - late).max() > 100
    with pytest.raises(ValueError, match="at least one annotated"):
        Video([], FPS, 60)


def test_every_format(short, tmp_path: Path, monkeypatch):
    monkeypatch.setattr(rendering, "GIF_DPI", 40)
    monkeypatch.setattr(rendering, "MP4_DPI", 40)
    told: list[tuple[int, int]] = []
    for suffix in (".html", ".png", ".gif", ".mp4"):
        path = tmp_path / f"walk{suffix}"
        written = render([short, short], path, fps=FPS, progress=lambda done, of: told.append((done, of)))
        assert written == path.stat().st_size > 0
    assert told == [(k + 1, 7) for k in range(7)] * 2
    assert sorted(p.suffix for p in tmp_path.iterdir()) == [".gif", ".html", ".mp4", ".png"]  # and nothing else
    page = (tmp_path / "walk.html").read_text(encoding="utf-8")
    check_page(page.removeprefix("<!doctype html>"))
    assert payload(page)["clips"][0]["fps"] == FPS
    with Image.open(tmp_path / "walk.gif") as gif:
        assert (getattr(gif, "n_frames", 1), gif.info["duration"], gif.info["loop"]) == (7, 100, 0)
        colours = {colour for _, colour in gif.convert("RGB").getcolors(1 << 16) or []}
        assert {(255, 255, 255), (243, 245, 248)} <= colours  # what lies behind keeps its colours
    assert (tmp_path / "walk.mp4").read_bytes()[4:8] == b"ftyp"
    with Image.open(tmp_path / "walk.png") as png:
        assert png.width > png.height


def test_films_can_be_read_by_others(short, tmp_path: Path, monkeypatch):
    import imageio_ffmpeg

    monkeypatch.setattr(rendering, "MP4_DPI", 40)
    render([short], tmp_path / "a.mp4", fps=20.0)
    reader = imageio_ffmpeg.read_frames(str(tmp_path / "a.mp4"))
    about = next(reader)
    video = Video([short], 20.0, 40)
    assert about["fps"] == 20.0 and about["size"] == (video.width, video.height)
    first = np.frombuffer(next(reader), np.uint8).reshape(video.height, video.width, 3)
    assert np.abs(first.astype(int) - video.frame_at(0.0)).mean() < 3  # of 255: compression


@pytest.mark.parametrize(
    ("name", "settings", "message"),
    [
        ("a.avi", {}, r"a.avi: suffix: .avi; must be one of .html, .gif, .mp4, .png"),
        ("a", {}, "suffix: none; must be one of"),
        ("no/a.png", {}, "output: no such folder"),
        ("a.gif", {"fps": 0.0}, "fps: 0.0; must be positive and at most 240"),
        ("a.png", {"moments": 0}, "moments: 0; must be 1 to 40"),
    ],
)
def test_bad_settings_write_nothing(short, tmp_path: Path, name, settings, message):
    with pytest.raises(InputError, match=message):
        render([short], tmp_path / name, **settings)
    assert list(tmp_path.iterdir()) == []


def test_existing_files_stay_unless_asked(short, tmp_path: Path):
    path = tmp_path / "a.html"
    path.write_text("mine")
    with pytest.raises(InputError, match="a.html: output: exists; .*--overwrite"):
        render([short], path)
    assert path.read_text() == "mine"
    render([short], path, overwrite=True)
    assert "motion-player" in path.read_text(encoding="utf-8")


def test_gifs_have_a_limit_and_films_name_their_extra(short, tmp_path: Path, monkeypatch):
    monkeypatch.setattr(rendering, "MOST_GIF", 5)
    with pytest.raises(InputError, match="video: 1 s at 20 frames per second; a GIF holds 5 frames"):
        render([short], tmp_path / "a.gif")
    real = builtins.__import__

    def without(name, *args, **kwargs):
        if name == "imageio_ffmpeg":
            raise ImportError(name)
        return real(name, *args, **kwargs)

    monkeypatch.setattr(builtins, "__import__", without)
    with pytest.raises(InputError, match=r"suffix: .mp4; MP4 needs imageio-ffmpeg: pip install pfnn-jax\[viewer\]"):
        render([short], tmp_path / "a.mp4")
    assert list(tmp_path.iterdir()) == []


def test_filmstrips_have_a_row_for_each_clip(short):
    one, two = filmstrip(short.clip, moments=4), filmstrip(short, make_annotated("b", extras=False), moments=4)
    assert two.get_size_inches()[1] > 1.9 * one.get_size_inches()[1]
    alone = filmstrip(short.clip, span=(5, 5))
    assert alone.get_size_inches()[0] < one.get_size_inches()[0]
    with pytest.raises(ValueError, match="needs a clip and a moment"):
        filmstrip()


@pytest.mark.parametrize("moments", [1, 3])
def test_every_figure_stands_above_its_moment(short, moments):
    figure = filmstrip(short, moments=moments)
    bodies, line = figure.axes[0], figure.axes[-1]
    moment = line.transData.transform([(x, 0.0) for x in np.linspace(0, short.seconds, moments)])[:, 0]
    numbers = [text for text in bodies.texts if isinstance(text, Annotation) and text.get_text().isdigit()]
    labels = [bodies.transData.transform(number.xy)[0] for number in numbers]
    np.testing.assert_allclose(moment, labels, atol=1e-6)
    assert line.get_xlim()[0] == 0.0  # names of rows stand beside their first second


def test_time_lines_end_with_their_clips(short):
    long = make_annotated(frames=120)
    figure = filmstrip(short, long, moments=3)
    lines = [axes for axes in figure.axes if any(text.get_text() == "phase" for text in axes.texts)]
    for axes, annotated in zip(lines, (short, long), strict=True):
        behind = axes.collections[0].get_paths()[0].get_extents()
        assert (behind.x0, behind.x1) == pytest.approx((0.0, annotated.clip.num_frames / 60))
        assert [text.get_text() for text in axes.texts] == ["left foot", "right foot", "phase", "2π", "0"]


def test_the_command_labels_draws_and_tells(tmp_path: Path, capsys):
    clip, _ = synthesise("neutral", np.zeros(180), np.full(180, 1.2))
    write_bvh(tmp_path / "a.bvh", clip)
    labels = label_phase(clip)
    write_phase(tmp_path / "a.phase", labels)
    still = resample(clip, 60.0)
    write_bvh(tmp_path / "b.bvh", still)
    out = tmp_path / "both.html"
    command = ["render", str(tmp_path / "a.bvh"), str(tmp_path / "b.bvh"), "--out", str(out), "--names", "one", "two"]
    main([*command, "--start", "0.5", "--seconds", "2", "--fps", "20"])
    page = out.read_text(encoding="utf-8")
    first, _ = payload(page)["clips"]
    assert captions(page) == ["one", "two"] and first["fps"] == 20.0
    shown = np.array([np.nan if value is None else value for value in first["phases"][0]["angle"]])
    want = np.where(labels.labelled, labels.phase, np.nan)[30:151:3]
    np.testing.assert_allclose(shown, want, atol=0.0051)  # two decimals
    assert "both.html: 2.0 s" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("args", "message"),
    [
        (["--start", "9"], "a.bvh: start and seconds: from 9; what is shown lies in the clip's 0.7 seconds"),
        (["--start", "nan"], "a.bvh: start and seconds: from nan; what is shown lies in the clip's 0.7 seconds"),
        (["--seconds", "inf"], "a.bvh: start and seconds: inf from 0; what is shown lies in the clip's 0.7 seconds"),
        (["--names", "x", "y"], "names: 2 for 1 clips; one a clip"),
    ],
)
def test_the_command_says_what_is_wrong(tmp_path: Path, capsys, args, message):
    clip, _ = synthesise("neutral", np.zeros(40), np.full(40, 1.2))
    write_bvh(tmp_path / "a.bvh", clip)
    with pytest.raises(SystemExit):
        main(["render", str(tmp_path / "a.bvh"), "--out", str(tmp_path / "a.png"), *args])
    assert message in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["a.bvh"]


def test_a_film_of_a_bouncing_dot_shows_it():
    from tests.viewer.test_player import one_joint

    annotated = AnnotatedClip("dot", one_joint())
    scene = make_scene(annotated.clip)
    assert scene.capsules[0].start_radius == pytest.approx(0.07 * scene.tall)
    grey = Video([annotated], FPS, 60).frame_at(0.5).astype(int)
    assert (np.abs(grey - [138, 148, 163]).max(axis=-1) < 60).sum() > 20


def test_pictures_are_whole_files(short):
    from pfnn_jax.viewer.draw.drawing import png_bytes

    with Image.open(io.BytesIO(png_bytes(filmstrip(short, moments=3), dpi=40))) as picture:
        picture.load()
