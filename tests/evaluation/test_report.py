"""Reports are complete, self-contained and escaped; figures leave matplotlib's global state unchanged."""

from __future__ import annotations

import dataclasses
import json
from functools import partial
from pathlib import Path

import matplotlib
import numpy as np
import pytest
from matplotlib import _pylab_helpers

from pfnn_jax.evaluation import plots, report
from pfnn_jax.viewer.draw.drawing import save_figure
from pfnn_jax.viewer.draw.filmstrip import filmstrip
from tests.raising import assert_refused
from tests.viewer.pages import check_page, make_annotated


def every_figure():
    annotated = make_annotated()
    yield plots.loss_curves({"train": [1.0, 0.5, 0.2], "held out": ([0, 2], [1.0, 0.4])})
    yield plots.loss_curves({"only": [0.0, 1.0]}, logarithmic=False)
    yield plots.error_bars({"a": {"straight": [0.1, 0.2], "turning": 0.3}, "b": {"straight": 0.2}})
    yield filmstrip(annotated.clip, moments=4, title="walk")
    yield filmstrip(annotated.clip, moments=3, span=(10, 40))


def test_figures_are_saved_as_png_and_leave_matplotlib_state_unchanged(tmp_path: Path):
    before, managers = dict(matplotlib.rcParams), len(_pylab_helpers.Gcf.figs)
    for number, figure in enumerate(every_figure()):
        path = tmp_path / f"{number}.png"
        save_figure(figure, path, dpi=40)
        assert path.read_bytes().startswith(b"\x89PNG")
    assert dict(matplotlib.rcParams) == before
    assert len(_pylab_helpers.Gcf.figs) == managers
    assert sorted(p.suffix for p in tmp_path.iterdir()) == [".png"] * 5


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
        report.Section("Motion", clips=[make_annotated("a"), make_annotated("b")]),
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


def test_report_without_motion_contains_no_script():
    page = report.render_report([report.Section("Only words", "Hello.")], title="T")
    check_page(page)
    assert "<script" not in page


def test_existing_report_is_refused_and_replaced_with_overwrite(tmp_path: Path):
    sections = [report.Section("A")]
    report.write_report(tmp_path, {"a": 1}, sections, title="first")
    write_second = partial(report.write_report, tmp_path, {"a": 2}, sections, title="second")
    assert_refused(write_second, file="report.html", place="output", value="exists", rule_mentions="overwrite")
    assert json.loads((tmp_path / "report.json").read_text()) == {"a": 1}
    write_second(overwrite=True)
    assert "second" in (tmp_path / "report.html").read_text()


def test_nothing_is_written_for_a_result_that_json_cannot_hold(tmp_path: Path):
    with pytest.raises(TypeError, match="cannot hold a set"):
        report.write_report(tmp_path / "out", {"a": {1, 2}}, [], title="T")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("value", "text"),
    [(0.10612, "0.106"), (31352, "31,352"), (12.34, "12.3"), (2.0, "2"), (0.0000123, "1.23e-05"), (-0.5, "-0.500"),
     (1234.5, "1,234"), (2.5e9 + 0.5, "2.50e+09"), (0, "0")],
)  # fmt: skip
def test_numbers_have_three_significant_digits(value, text):
    assert report.format_number(value) == text


def test_table_refuses_rows_of_another_length():
    with pytest.raises(ValueError, match="needs 2 cells"):
        report.Table(["a", "b"], [[1]])
