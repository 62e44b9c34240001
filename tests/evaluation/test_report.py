"""Reports are whole, self-contained and safe; pictures leave matplotlib alone; players carry the motion exactly."""

from __future__ import annotations

import base64
import dataclasses
import json
import re
from html.parser import HTMLParser
from pathlib import Path

import matplotlib
import numpy as np
import pytest
from matplotlib import _pylab_helpers

from pfnn_jax.errors import InputError
from pfnn_jax.evaluation import plots, report
from pfnn_jax.motion.synthetic import STYLES, stance_contacts, synthesise, synthetic_skeleton
from pfnn_jax.viewer.body import body_capsules, body_points, capsule_ends
from pfnn_jax.viewer.player import Track, player_html

QUANTUM = 0.00051  # metres: half a millimetre of rounding
MEGABYTE = 1_000_000
VOID = {"meta", "input", "img"}


def make_track(name="zombie", frames=120, extras=True):
    style = STYLES["zombie"]
    clip, labels = synthesise(style, np.full(frames, 0.5), np.full(frames, 0.8))
    return Track(name, clip, labels.phase, stance_contacts(style, labels.phase)) if extras else Track(name, clip)


def payload(page: str) -> dict:
    found = re.search(r'<script type="application/json">(.*?)</script>', page, re.DOTALL)
    assert found is not None
    return json.loads(found[1])


def decoded(track: dict) -> np.ndarray:
    values = np.frombuffer(base64.b64decode(track["points"]), "<i2").astype(float) * track["unit"]
    return values.reshape(-1, track["count"], 3)


class Balanced(HTMLParser):
    """Checks that every tag closes, and collects what the page would load."""

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


def test_player_carries_the_capsules_of_the_motion():
    track = make_track()
    data = payload(player_html([track], fps=30.0))["tracks"][0]
    points, capsules = body_points(track.clip)[::2], body_capsules(track.clip.skeleton)
    shown = decoded(data)
    assert data["fps"] == 30.0 and len(shown) == len(points) == len(data["phase"])
    assert len(data["capsules"]) == len(capsules)
    for capsule, (start, end, first, second, side, *_) in zip(capsules, data["capsules"], strict=True):
        np.testing.assert_allclose(shown[:, start], points[:, capsule.start], atol=QUANTUM)
        np.testing.assert_allclose(shown[:, end], points[:, capsule.end], atol=QUANTUM)
        assert (first, second) == pytest.approx((capsule.start_radius, capsule.end_radius), abs=1e-4)
        assert side == capsule.side


def test_player_shows_contacts_as_runs():
    track = make_track()
    data = payload(player_html([track], fps=60.0))["tracks"][0]
    assert track.contacts is not None
    for foot, runs in enumerate(data["contacts"]):
        stands = np.zeros(track.clip.num_frames, bool)
        for first, past in runs:
            stands[first:past] = True
        np.testing.assert_array_equal(stands, track.contacts[:, 2 * foot : 2 * foot + 2].any(axis=1))


def test_twenty_seconds_stay_below_a_megabyte_and_scenes_of_a_kilometre_still_fit():
    track = make_track(frames=1200)
    assert len(player_html([track], fps=30.0)) < MEGABYTE / 4
    far = synthesise("neutral", np.zeros(600), np.full(600, 100.0))[0]
    shown = decoded(payload(player_html([Track("fast", far)]))["tracks"][0])
    np.testing.assert_allclose(shown[:, 0], body_points(far)[::2, 0], atol=1000 / 32767)


def test_players_are_balanced_and_names_cannot_break_out():
    name = "</script><script>alert(1)</script>"
    page = player_html([make_track(name), make_track("plain", extras=False)])
    check_page(page)
    assert name not in page
    assert [track["name"] for track in payload(page)["tracks"]] == [name, "plain"]
    assert page.count('class="scene"') == 2 and page.count('class="contacts"') == 1


def test_players_refuse_nothing_and_mismatched_lengths():
    with pytest.raises(ValueError, match="at least one"):
        player_html([])
    track = make_track()
    with pytest.raises(ValueError, match="phase of track 'x' has 3 frames, its clip 120"):
        player_html([Track("x", track.clip, phase=np.zeros(3))])


def test_body_of_the_walker_is_symmetric_and_bodies_without_roles_are_thin():
    skeleton = synthetic_skeleton()
    capsules = {(c.start, c.end): c for c in body_capsules(skeleton)}
    mirrored = [c for c in capsules.values() if c.end < skeleton.num_joints and c.side == "left"]
    assert mirrored
    for capsule in mirrored:
        other = capsules[(int(skeleton.mirror[capsule.start]), int(skeleton.mirror[capsule.end]))]
        assert (other.start_radius, other.side) == (capsule.start_radius, "right")
    bare = dataclasses.replace(skeleton, roles=None)
    assert {c.start_radius for c in body_capsules(bare)} == {0.03}


def test_capsule_ends_lie_on_the_bone():
    track = make_track()
    head = next(c for c in body_capsules(track.clip.skeleton) if c.span != (0.0, 1.0))
    points = body_points(track.clip)
    a, b = capsule_ends(points, head)
    bone = points[:, head.end] - points[:, head.start]
    np.testing.assert_allclose(b - a, (head.span[1] - head.span[0]) * bone, atol=1e-12)


def every_figure():
    track = make_track()
    yield plots.loss_curves({"train": [1.0, 0.5, 0.2], "held out": ([0, 2], [1.0, 0.4])})
    yield plots.loss_curves({"only": [0.0, 1.0]}, logarithmic=False)
    yield plots.error_bars({"a": {"straight": [0.1, 0.2], "turning": 0.3}, "b": {"straight": 0.2}})
    yield plots.filmstrip(track.clip, moments=4, title="walk")
    yield plots.filmstrip(track.clip, moments=3, span=(10, 40))


def test_pictures_are_png_and_leave_matplotlib_alone(tmp_path: Path):
    before, managers = dict(matplotlib.rcParams), len(_pylab_helpers.Gcf.figs)
    for number, figure in enumerate(every_figure()):
        path = tmp_path / f"{number}.png"
        plots.save_figure(figure, path, dpi=40)
        assert path.read_bytes().startswith(b"\x89PNG")
    assert dict(matplotlib.rcParams) == before
    assert len(_pylab_helpers.Gcf.figs) == managers
    assert sorted(p.suffix for p in tmp_path.iterdir()) == [".png"] * 5


def test_filmstrip_turns_every_figure_to_its_own_heading():
    """A body turning on the spot looks the same at every moment: only its place on the page differs."""
    clip, _ = synthesise("neutral", np.zeros(60), np.ones(60))
    points = body_points(clip)[7]
    turned = points[:, [2, 1, 0]] * [1, 1, -1]  # a quarter to the left
    np.testing.assert_allclose(plots._to_view(turned, np.pi / 2), plots._to_view(points, 0.0), atol=1e-12)


@dataclasses.dataclass(frozen=True)
class Score:
    mean: float
    per_clip: np.ndarray


def make_sections() -> list[report.Section]:
    table = report.Table(
        ["method", "numbers", "error <m>"],
        [["none & all", 0, 0.198], ["CP", 31352, 0.10612], ["broken", None, float("nan")]],
        best=["error <m>"],
        note="3 seeds",
    )
    figure = plots.loss_curves({"train": [1.0, 0.5]})
    return [
        report.Section("Errors <1>", "One.\n\nTwo & three.", table, figures=[("A caption", figure)]),
        report.Section("Motion", tracks=[make_track("a"), make_track("b")]),
    ]


def test_report_is_one_page_and_one_json(tmp_path: Path):
    result = {"error": Score(0.1, np.array([0.1, np.nan])), "count": np.int64(3), "where": Path("a/b"), 5: (True, None)}
    page = report.write_report(
        tmp_path / "out", result, make_sections(), title="T & t", subtitle="s", facts={"time": "3 min"}
    )
    assert sorted(p.name for p in page.parent.iterdir()) == ["report.html", "report.json"]
    data = json.loads((page.parent / "report.json").read_text())
    assert data == {
        "error": {"mean": 0.1, "per_clip": [0.1, None]}, "count": 3, "where": "a/b", "5": [True, None],
    }  # fmt: skip
    text = page.read_text()
    check_page(text)
    assert text.count("<script>") == 1 and text.count('class="motion-player"') == 1
    for expected in ("T &amp; t", "Errors &lt;1&gt;", "<p>Two &amp; three.</p>", "3 min", "A caption", "3 seeds"):
        assert expected in text
    assert text.count('<td class="best">') == 1 and '<td class="best">0.106</td>' in text
    assert "<td>31,352</td>" in text and text.count("<td>–</td>") == 2


def test_report_without_motion_carries_no_script():
    page = report.render_report([report.Section("Only words", "Hello.")], title="T")
    check_page(page)
    assert "<script" not in page


def test_reports_are_not_overwritten_unasked(tmp_path: Path):
    sections = [report.Section("A")]
    report.write_report(tmp_path, {"a": 1}, sections, title="first")
    with pytest.raises(InputError, match="report.html: output: exists; .*--overwrite"):
        report.write_report(tmp_path, {"a": 2}, sections, title="second")
    assert json.loads((tmp_path / "report.json").read_text()) == {"a": 1}
    report.write_report(tmp_path, {"a": 2}, sections, title="second", overwrite=True)
    assert "second" in (tmp_path / "report.html").read_text()


def test_nothing_is_written_when_the_result_cannot_be(tmp_path: Path):
    with pytest.raises(TypeError, match="cannot hold a set"):
        report.write_report(tmp_path / "out", {"a": {1, 2}}, [], title="T")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("value", "text"),
    [(0.10612, "0.106"), (31352, "31,352"), (12.34, "12.3"), (2.0, "2"), (0.0000123, "1.23e-05"), (-0.5, "-0.500"),
     (1234.5, "1,234"), (2.5e9 + 0.5, "2.50e+09"), (0, "0")],
)  # fmt: skip
def test_numbers_show_three_digits(value, text):
    assert report.format_number(value) == text


def test_tables_refuse_uneven_rows():
    with pytest.raises(ValueError, match="needs 2 cells"):
        report.Table(["a", "b"], [[1]])


def test_a_head_without_a_crown_sits_in_line_with_the_neck():
    skeleton = synthetic_skeleton()
    assert skeleton.roles is not None
    head = skeleton.roles.head
    bald = dataclasses.replace(skeleton, end_sites=tuple(site for site in skeleton.end_sites if site[0] != head))
    capsule = body_capsules(bald)[-1]
    assert (capsule.end, capsule.side) == (head, "middle")
    assert capsule.span[1] > capsule.span[0] > 1.0  # beyond the head joint
