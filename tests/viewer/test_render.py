"""Videos and pictures show their clips in step, with different poses, and are written atomically."""

from __future__ import annotations

import builtins
import dataclasses
import itertools
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.text import Annotation
from PIL import Image

from pfnn_jax.cli import main
from pfnn_jax.motion.bvh import write_bvh
from pfnn_jax.motion.clip import MotionClip, cut, resample
from pfnn_jax.motion.labels.phase import label_phase, write_phase
from pfnn_jax.motion.synthetic.walks import synthesise
from pfnn_jax.viewer import rendering
from pfnn_jax.viewer.draw.annotated_clip import AnnotatedClip, annotate
from pfnn_jax.viewer.draw.body_picture import LARGEST, body_image
from pfnn_jax.viewer.draw.camera import Camera, SideView
from pfnn_jax.viewer.draw.filmstrip import NUMBER_SIZE, apart, even_moments, filmstrip
from pfnn_jax.viewer.draw.rasteriser import Surface, cover, draw_surface
from pfnn_jax.viewer.draw.scene import make_scene
from pfnn_jax.viewer.draw.video import Video
from pfnn_jax.viewer.player.player import player_html
from pfnn_jax.viewer.rendering import render
from tests.raising import assert_refused
from tests.viewer.pages import captions, check_page, make_annotated, payload

EXACT = 1e-9
DIFFERENT = 0.5  # of the distance of evenly spread poses
FPS = 10.0  # of the films made here: few frames


@pytest.fixture(autouse=True)
def start_ffmpeg_without_fork(monkeypatch):
    """A process group of its own needs a fork, and JAX warns about forks once it has computed."""
    monkeypatch.setenv("IMAGEIO_FFMPEG_NO_PREVENT_SIGINT", "1")


@pytest.fixture
def short() -> AnnotatedClip:
    return make_annotated(frames=40)


def square(depth: float, colour: tuple[float, float, float], left: float = 2.0) -> Surface:
    """A square of 4 pixels that faces the viewer."""
    corners = np.array([[0.0, 0.0], [0.0, 4.0], [4.0, 4.0], [4.0, 0.0]]) + [left, 3.0]
    faces = np.array([[0, 1, 2], [0, 2, 3]])
    return Surface(corners, np.full(4, depth), np.tile([0.0, 0.0, 1.0], (4, 1)), faces, np.tile(colour, (4, 1)))


def joined(*surfaces: Surface) -> Surface:
    faces = [surface.faces + 4 * number for number, surface in enumerate(surfaces)]
    parts = {
        name: np.concatenate([getattr(s, name) for s in surfaces]) for name in ("pixels", "depth", "normals", "colours")
    }
    return Surface(faces=np.concatenate(faces), **parts)


def test_surfaces_cover_exactly_their_pixels():
    picture = draw_surface(square(0.0, (1.0, 0.0, 0.0)), 10, 9, samples=3)
    opacity = np.zeros((9, 10))
    opacity[3:7, 2:6] = 1.0
    np.testing.assert_allclose(picture[..., 3], opacity, atol=EXACT)
    half = draw_surface(square(0.0, (1.0, 0.0, 0.0), left=2.5), 10, 9, samples=2)
    np.testing.assert_allclose(half[4, 2:7, 3], [0.5, 1.0, 1.0, 1.0, 0.5], atol=EXACT)
    np.testing.assert_array_equal(
        cover(square(0.0, (1, 0, 0)).pixels, np.array([[0, 1, 2], [0, 2, 3]]), 10, 9), opacity
    )


@pytest.mark.parametrize("order", [(0, 1), (1, 0)])
def test_nearer_surfaces_hide_farther_ones_in_any_order(order):
    surfaces = [square(1.0, (0.0, 0.0, 1.0)), square(0.0, (1.0, 0.0, 0.0), left=4.0)]
    picture = draw_surface(joined(*(surfaces[number] for number in order)), 10, 9)
    assert picture[4, 3, 2] > 0.3 > picture[4, 3, 0] and (picture[4, 4:8, 0] > 0.3).all()


def test_faces_seen_from_behind_and_outside_of_the_picture_are_not_drawn():
    away = square(0.0, (1.0, 0.0, 0.0))
    assert not draw_surface(dataclasses.replace(away, faces=away.faces[:, ::-1]), 10, 9).any()
    assert not draw_surface(square(0.0, (1.0, 0.0, 0.0), left=50.0), 10, 9).any()
    assert draw_surface(square(0.0, (1.0, 0.0, 0.0), left=-2.0), 10, 9)[..., 3].sum() == 8


def test_a_body_from_the_side_does_not_depend_on_its_heading():
    points = np.random.default_rng(0).normal(size=(20, 3))
    turned = points[:, [2, 1, 0]] * [1, 1, -1]  # a quarter to the left
    for one, other in zip(
        SideView(0.0, 50.0, 1.0).project(points), SideView(np.pi / 2, 50.0, 1.0).project(turned), strict=True
    ):
        np.testing.assert_allclose(one, other, atol=EXACT)


def test_the_camera_is_ahead_of_the_body_for_every_facing():
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


def test_videos_are_in_step_and_as_long_as_the_longest_clip(short):
    slow = AnnotatedClip("slow", resample(make_annotated(frames=90).clip, 20.0))
    video = Video([short, slow], FPS, 60)
    assert video.num_frames == 15 and video.width % 2 == 0 and video.height % 2 == 0
    frames = list(video.frames())
    assert {frame.shape for frame in frames} == {(video.height, video.width, 3)}
    left = [frame[:, : video.width // 2].astype(int) for frame in frames]
    assert np.abs(left[3] - left[2]).max() > 100 and np.abs(left[-1][:200] - left[-2][:200]).max() < 100
    np.testing.assert_array_equal(video.frame_at(0.3), frames[3])  # a frame depends on its second alone


def test_ended_clips_turn_pale_at_the_same_time_as_in_players(short):
    long = make_annotated(frames=60, extras=False)
    over = payload(player_html([short, long], fps=15.0))["clips"][0]["end"]
    assert over == pytest.approx(39.5 / 60, abs=1e-4)
    video = Video([AnnotatedClip("", short.clip), long], FPS, 60)
    before, after = (video.frame_at(over + late)[:, : video.width // 2].astype(int) for late in (-0.002, 0.002))
    grey = (np.ptp(before, axis=-1).max(), np.ptp(after, axis=-1).max())
    assert grey[0] > 1.5 * grey[1]  # blue and orange fade


def test_long_videos_scroll_their_time_line(short):
    clip, _ = synthesise("neutral", np.zeros(720), np.full(720, 1.0))
    video = Video([annotate(clip, "long")], FPS, 60)
    strip = slice(video.height - 50, video.height - 12)
    early, late = video.frame_at(1.0)[strip].astype(int), video.frame_at(11.0)[strip].astype(int)
    assert np.abs(early - late).max() > 100
    with pytest.raises(ValueError, match="at least one clip"):
        Video([], FPS, 60)


def test_every_format(short, tmp_path: Path, monkeypatch):
    monkeypatch.setattr(rendering, "GIF_DPI", 40)
    monkeypatch.setattr(rendering, "MP4_DPI", 40)
    calls: list[tuple[int, int]] = []
    for suffix in (".html", ".png", ".gif", ".mp4"):
        path = tmp_path / f"walk{suffix}"
        written = render([short, short], path, fps=FPS, progress_callback=lambda done, of: calls.append((done, of)))
        assert written == path.stat().st_size > 0
    assert calls == [(k + 1, 7) for k in range(7)] * 2
    assert sorted(p.suffix for p in tmp_path.iterdir()) == [".gif", ".html", ".mp4", ".png"]  # and nothing else
    page = (tmp_path / "walk.html").read_text(encoding="utf-8")
    check_page(page.removeprefix("<!doctype html>"))
    assert payload(page)["clips"][0]["fps"] == FPS
    with Image.open(tmp_path / "walk.gif") as gif:
        assert (getattr(gif, "n_frames", 1), gif.info["duration"], gif.info["loop"]) == (7, 100, 0)
        colours = {colour for _, colour in gif.convert("RGB").getcolors(1 << 16) or []}
        assert {(255, 255, 255), (243, 245, 248)} <= colours  # the backgrounds keep their exact colours
    assert (tmp_path / "walk.mp4").read_bytes()[4:8] == b"ftyp"
    with Image.open(tmp_path / "walk.png") as png:
        assert png.width > png.height


def test_mp4_files_are_read_by_another_library(short, tmp_path: Path, monkeypatch):
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
    ("name", "settings", "place", "value"),
    [
        ("a.avi", {}, "suffix", ".avi"),
        ("a", {}, "suffix", "none"),
        ("no/a.png", {}, "output", "no such folder"),
        ("a.gif", {"fps": 0.0}, "fps", "0.0"),
        ("a.png", {"moments": 0}, "moments", "0"),
    ],
)
def test_bad_settings_write_nothing(short, tmp_path: Path, name, settings, place, value):
    assert_refused(lambda: render([short], tmp_path / name, **settings), file=name, place=place, value=value)
    assert list(tmp_path.iterdir()) == []


def test_existing_files_are_replaced_only_on_request(short, tmp_path: Path):
    path = tmp_path / "a.html"
    path.write_text("mine")
    assert_refused(lambda: render([short], path), file="a.html", place="output")
    assert path.read_text() == "mine"
    render([short], path, overwrite=True)
    assert "motion-player" in path.read_text(encoding="utf-8")


def test_gifs_have_a_limit_and_a_missing_mp4_writer_is_named(short, tmp_path: Path, monkeypatch):
    monkeypatch.setattr(rendering, "MOST_GIF", 5)
    assert_refused(lambda: render([short], tmp_path / "a.gif"), place="video", rule_mentions="5 frames")
    real = builtins.__import__

    def without(name, *args, **kwargs):
        if name == "imageio_ffmpeg":
            raise ImportError(name)
        return real(name, *args, **kwargs)

    monkeypatch.setattr(builtins, "__import__", without)
    assert_refused(lambda: render([short], tmp_path / "a.mp4"), place="suffix", rule_mentions="imageio-ffmpeg")
    assert list(tmp_path.iterdir()) == []


def test_filmstrips_have_a_row_for_each_clip(short):
    one, two = filmstrip(short.clip, moments=4), filmstrip(short, make_annotated("b", extras=False), moments=4)
    assert two.get_size_inches()[1] > 1.9 * one.get_size_inches()[1]
    alone = filmstrip(short.clip, span=(5, 5))
    assert alone.get_size_inches()[0] < one.get_size_inches()[0]
    with pytest.raises(ValueError, match="needs a clip and a moment"):
        filmstrip()


@pytest.mark.parametrize("moments", [1, 3])
def test_every_body_is_above_its_moment(short, moments):
    figure = filmstrip(short, moments=moments)
    bodies, line = figure.axes[0], figure.axes[-1]
    moment = line.transData.transform([(x, 0.0) for x in even_moments([short], moments)])[:, 0]
    numbers = [text for text in bodies.texts if isinstance(text, Annotation) and text.get_text().isdigit()]
    labels = [bodies.transData.transform(number.xy)[0] for number in numbers]
    np.testing.assert_allclose(moment, labels, atol=1e-6)
    assert line.get_xlim()[0] == 0.0  # names of rows end at second 0


def test_time_lines_are_as_long_as_their_clips(short):
    long = make_annotated(frames=120)
    figure = filmstrip(short, long, moments=3)
    lines = [axes for axes in figure.axes if any(text.get_text() == "phase" for text in axes.texts)]
    for axes, annotated in zip(lines, (short, long), strict=True):
        behind = axes.collections[0].get_paths()[0].get_extents()
        assert (behind.x0, behind.x1) == pytest.approx((0.0, annotated.clip.num_frames / 60))
        assert [text.get_text() for text in axes.texts] == ["left foot", "right foot", "phase", "2π", "0"]


def test_the_command_labels_and_draws_the_chosen_seconds(tmp_path: Path, capsys):
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
        (["--start", "9"], "a.bvh: start and seconds: from 9; must lie within the clip's 0.7 seconds"),
        (["--start", "nan"], "start and seconds: from nan"),
        (["--seconds", "inf"], "start and seconds: inf from 0"),
        (["--names", "x", "y"], "names: 2 for 1 clips"),
    ],
)
def test_the_command_names_bad_arguments(tmp_path: Path, capsys, args, message):
    clip, _ = synthesise("neutral", np.zeros(40), np.full(40, 1.2))
    write_bvh(tmp_path / "a.bvh", clip)
    with pytest.raises(SystemExit):
        main(["render", str(tmp_path / "a.bvh"), "--out", str(tmp_path / "a.png"), *args])
    assert message in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["a.bvh"]


def test_a_single_joint_is_visible_in_a_video():
    from tests.viewer.test_player import one_joint

    annotated = AnnotatedClip("dot", one_joint())
    scene = make_scene(annotated.clip)
    assert np.ptp(scene.mesh.vertices, axis=0).max() / 2 == pytest.approx(0.07 * scene.tall)
    grey = Video([annotated], FPS, 60).frame_at(0.5).astype(int)
    assert (np.abs(grey - [138, 148, 163]).max(axis=-1) < 60).sum() > 20


def test_scenes_stand_on_the_ground_and_pose_between_frames(short):
    clip = short.clip
    scene = make_scene(clip)
    low = dataclasses.replace(clip, root_positions=clip.root_positions - [0.0, 0.95, 0.0])
    sunk = make_scene(low)
    np.testing.assert_allclose(sunk.positions[:, 0, 1], scene.positions[:, 0, 1], atol=0.05)
    np.testing.assert_array_equal(scene.positions[:, 0], clip.root_positions)  # feet near 0: the ground is at 0
    for second, frame in ((0.0, 0), (10 / clip.fps, 10), (99.0, -1)):
        positions, rotations, focus = scene.pose_at(second)
        np.testing.assert_allclose(positions, scene.positions[frame], atol=EXACT)
        np.testing.assert_allclose(np.abs(np.sum(rotations * scene.rotations[frame], axis=-1)), 1.0, atol=EXACT)
        np.testing.assert_allclose(focus, scene.focus[frame], atol=EXACT)


def test_a_mesh_of_its_own_is_drawn_in_place_of_the_grown_body(short):
    grown = make_scene(short.clip).mesh
    red = dataclasses.replace(grown, colours=np.tile(np.array([250, 0, 0], np.uint8), (len(grown.vertices), 1)))
    frame = Video([dataclasses.replace(short, mesh=red)], FPS, 60).frame_at(0.0).astype(int)
    assert ((frame[..., 0] > 120) & (frame[..., 1] < 40)).sum() > 100
    assert filmstrip(dataclasses.replace(short, mesh=red), moments=1).axes


# Moments of a filmstrip


def poses_shown(clip: MotionClip, moments: int) -> np.ndarray:
    """[N, J, 4] local rotations of the bodies in a filmstrip, without the root's."""
    seconds = even_moments([AnnotatedClip("", clip)], moments)
    return clip.rotations[np.round(seconds * clip.fps).astype(int), 1:]


@pytest.mark.parametrize("moments", [2, 3, 6, 8, 12])
@pytest.mark.parametrize("cycles", [1, 2, 3.5])
def test_poses_of_a_periodic_walk_differ(moments, cycles):
    """The evenly spaced moments of the whole clip are a whole number of `cycles` apart, or half of one."""
    walk, labels = synthesise("zombie", np.zeros(4000), np.full(4000, 0.8))
    turns = np.unwrap(labels.phase) / (2 * np.pi)
    frames = int(np.searchsorted(turns - turns[0], cycles * (moments - 1)))
    walk = cut(walk, 0, frames + 1)
    shown = poses_shown(walk, moments)
    every = walk.rotations[:: max(1, frames // 200), 1:]

    def distances(poses: np.ndarray) -> np.ndarray:
        return np.linalg.norm((poses[:, None] - poses[None]).reshape(len(poses), len(poses), -1), axis=-1)

    apart_shown = distances(shown)[np.triu_indices(moments, 1)].min()
    assert apart_shown > DIFFERENT * distances(every).max() / moments


def test_moments_span_most_of_the_longest_clip_and_all_of_one_without_phase(short):
    long = make_annotated(frames=700)
    seconds = even_moments([short, long], 8)
    np.testing.assert_allclose(np.diff(seconds), seconds[1], atol=EXACT)
    assert seconds[0] == 0.0 and 0.75 * long.seconds <= seconds[-1] <= long.seconds
    bare = dataclasses.replace(long.clip, skeleton=dataclasses.replace(long.clip.skeleton, roles=None))
    assert even_moments([AnnotatedClip("", bare)], 8)[-1] == long.seconds


@given(st.lists(st.tuples(st.floats(0, 60), st.floats(0, 60)), min_size=1, max_size=30))
def test_numbers_along_a_path_do_not_overlap(centres):
    places = np.array(centres)
    kept = apart(places)
    assert kept[0] == 0
    for one, other in itertools.combinations(kept, 2):
        across, up = np.abs(places[one] - places[other])
        letters = (len(str(one + 1)) + len(str(other + 1))) / 2
        assert up > NUMBER_SIZE or across > 0.66 * letters * NUMBER_SIZE


def test_numbers_drawn_on_a_map_do_not_overlap():
    walk, _ = synthesise("neutral", np.full(900, 0.8), np.full(900, 1.2))  # twice around a circle
    figure = filmstrip(walk, moments=14)
    renderer = FigureCanvasAgg(figure).get_renderer()
    numbers = [text for text in figure.axes[-1].texts if text.get_text().isdigit()]
    boxes = [text.get_window_extent(renderer) for text in numbers]
    assert 2 <= len(boxes) <= 14
    assert not any(one.overlaps(other) for one, other in itertools.combinations(boxes, 2))


# What is imported

LIGHT = """
import sys
from pfnn_jax.motion.synthetic.walks import synthesise
import numpy as np
import pfnn_jax.viewer.draw.filmstrip, pfnn_jax.viewer.draw.video, pfnn_jax.viewer.player.notebook
from pfnn_jax.viewer.rendering import render
clip, _ = synthesise("neutral", np.zeros(40), np.full(40, 1.2))
render(clip, sys.argv[1])
print(*{name.partition(".")[0] for name in sys.modules} & {"jax", "flax", "optax", "matplotlib", "PIL", "viser"})
"""


def test_an_html_player_is_made_without_jax_and_matplotlib(tmp_path: Path):
    command = [sys.executable, "-c", LIGHT, str(tmp_path / "a.html")]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert done.stdout.strip() == ""
    assert "motion-player" in (tmp_path / "a.html").read_text(encoding="utf-8")


def test_a_mesh_with_a_part_far_away_makes_no_huge_picture(short):
    scene = make_scene(short.clip)
    vertices = scene.mesh.vertices.copy()
    vertices[0] += [0.0, 500.0, 0.0]
    scene = dataclasses.replace(scene, mesh=dataclasses.replace(scene.mesh, vertices=vertices))
    image = body_image(scene, 0, 1.0, 300.0)
    assert max(image.colours.shape) <= LARGEST + 2 and image.top > 400.0
