"""The page of a study: complete in itself, a row for each run, plots that show what was varied."""

from __future__ import annotations

from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import imageio.v3 as imageio
import numpy as np
import pytest

from femdeform.errors import InputError
from femdeform.post.batch_page import BatchPage, page_text
from femdeform.post.batch_plots import study_figure
from femdeform.run.batch_index import Row, StudyTable, to_csv
from femdeform.run.batch_record import Ending, RunFiles

DONE = Ending("done", "", 0, 1.5)


def table(out: Path, keys: dict[str, list[Any]], scalars: dict[str, list[Any]], **more: Any) -> StudyTable:
    """A study whose runs have these values, all done unless `endings` says otherwise."""
    n_runs = max(map(len, [*keys.values(), *scalars.values()]))
    endings = more.get("endings") or [DONE] * n_runs
    rows = tuple(
        Row(
            i + 1,
            f"{i:012x}",
            {key: values[i] for key, values in keys.items() if values[i] is not None},
            endings[i],
            {name: values[i] for name, values in scalars.items() if values[i] is not None},
            RunFiles.of(out, f"{i:012x}"),
        )
        for i in range(n_runs)
    )
    return StudyTable(more.get("title", "A study"), out, tuple(keys), tuple(scalars), rows)


class _Page(HTMLParser):
    """Cells of the table of runs, and every address that the page refers to."""

    def __init__(self) -> None:
        super().__init__()
        self.rows: list[list[str]] = []
        self.addresses: list[str] = []
        self.open_tags: list[str] = []
        self._in_cell = False

    def handle_starttag(self, tag: str, attributes: list[tuple[str, str | None]]) -> None:
        self.addresses += [value or "" for name, value in attributes if name in ("src", "href")]
        if tag not in ("meta", "img", "br", "wbr"):
            self.open_tags.append(tag)
        if tag == "tr":
            self.rows.append([])
        elif tag in ("td", "th"):
            self.rows[-1].append("")
            self._in_cell = True

    def handle_endtag(self, tag: str) -> None:
        assert self.open_tags.pop() == tag
        if tag in ("td", "th"):
            self._in_cell = False

    def handle_data(self, data: str) -> None:
        if self._in_cell:
            self.rows[-1][-1] += data


def parse(text: str) -> _Page:
    page = _Page()
    page.feed(text)
    page.close()
    assert page.open_tags == []
    return page


# ------------------------------------------------------------------------------------------------- page


def test_a_row_for_each_run(tmp_path: Path) -> None:
    endings = [DONE, Ending("not_converged", "step 3 <failed>", 3, 20.0), Ending("waiting")]
    study = table(
        tmp_path,
        {"bodies.b.material.density": [1e3, 2e3, 5e3], "title": ["<b>x</b>", "a & b", None]},
        {"measure.tip": [0.12345678, None, None], "steps": [10, 2, None]},
        endings=endings,
        title="Study <1>",
    )
    for row in study.rows[:2]:
        row.files.folder.mkdir(parents=True)
        row.files.log.touch()
    (study.rows[0].files.folder / "report.html").touch()
    text = page_text(study)
    page = parse(text)
    assert page.rows == [
        ["run", "picture", "density", "title", "status", "seconds", "measure.tip", "steps", "files"],
        ["1", "", "1000", "<b>x</b>", "done", "1.5", "0.123457", "10", "folder report log"],
        ["2", "", "2000", "a & b", "not convergedstep 3 <failed>", "20.0", "", "2", "folder log"],
        ["3", "", "5000", "", "waiting", "", "", "", ""],
    ]
    assert "<h1>Study &lt;1&gt;</h1>" in text
    assert "2 of 3 runs are over" in text
    # Sorting takes the numbers, not their short forms.
    assert 'data-value="0.12345678"' in text
    assert [address for address in page.addresses if not address.startswith("data:")] == [
        *("runs/000000000000/", "runs/000000000000/report.html", "runs/000000000000.log"),
        *("runs/000000000001/", "runs/000000000001.log"),
    ]


def test_verdicts_over_all_runs(tmp_path: Path) -> None:
    study = table(tmp_path, {"a.b": [1, 2]}, {"s": [1.0, 3.0]})
    assert "Expected of all runs" not in page_text(study)
    near = {"quantity": "mean over 2 runs of s", "computed": 2.0, "expected": 2.5, "rtol": 0.1, "atol": 0.5}
    bounds = {"quantity": "largest <s>", "computed": 3.0, "at_least": 1.0, "at_most": 2.5}
    judged = replace(study, verdicts=({**near, "passed": True}, {**bounds, "passed": False}))
    text = page_text(judged)
    assert parse(text).rows[:3] == [
        ["quantity", "computed", "allowed", "verdict"],
        ["mean over 2 runs of s", "2", "2.5 ± 0.75", "passed"],
        ["largest <s>", "3", "at least 1, at most 2.5", "FAILED"],
    ]
    assert '<span class="badge bad">2 runs, all done, 1 of 2 expectations failed</span>' in text
    passed = page_text(replace(study, verdicts=({**near, "passed": True},)))
    assert '<span class="badge good">2 runs, all done</span>' in passed
    waiting = table(tmp_path, {"a.b": [1, 2]}, {"s": [1.0, None]}, endings=[DONE, Ending("waiting")])
    text = page_text(replace(waiting, verdicts=({**bounds, "computed": None, "passed": None},)))
    assert parse(text).rows[1] == ["largest <s>", "-", "at least 1, at most 2.5", "not yet"]
    assert "failed" not in text.partition("</style>")[2].partition("<script>")[0]


def test_the_page_needs_nothing_else(tmp_path: Path) -> None:
    study = table(tmp_path, {"a.b": [1, 2, 3]}, {"s": [1.0, 4.0, 9.0]})
    study.rows[1].files.picture.parent.mkdir()
    picture = np.zeros((200, 320, 3), dtype=np.uint8)
    imageio.imwrite(study.rows[1].files.picture, picture)
    path = BatchPage().write(study)
    assert path == tmp_path / "index.html"
    page = parse(path.read_text(encoding="utf-8"))
    assert [address.partition(";")[0] for address in page.addresses] == ["data:image/svg+xml", "data:image/png"]
    text = path.read_text(encoding="utf-8")
    assert "default-src &#x27;none&#x27;" in text
    assert "3 runs, all done" in text


def test_many_pictures_become_links(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("femdeform.post.batch_page._MAX_PICTURES", 1)
    study = table(tmp_path, {"a.b": [1, 2]}, {"s": [1.0, 1.0]})
    (tmp_path / "runs").mkdir()
    for row in study.rows:
        imageio.imwrite(row.files.picture, np.zeros((200, 320, 3), dtype=np.uint8))
    addresses = parse(page_text(study)).addresses
    assert addresses[0].startswith("data:image/png")
    assert addresses[1:] == ["runs/000000000001.png"]


def test_a_picture_of_a_result(beam: Path, tmp_path: Path) -> None:
    path = tmp_path / "p.png"
    BatchPage().draw(beam, path)
    picture = imageio.imread(path)
    assert picture.shape == (200, 320, 3)
    body = picture.min(axis=2) < 200
    # The body fills the picture one way or the other, and stands in its middle: there is no legend beside it.
    filled = [np.flatnonzero(body.any(axis=axis)) for axis in (0, 1)]
    assert max(np.ptp(filled[0]) / 320, np.ptp(filled[1]) / 200) > 0.6
    assert np.mean(filled[0][[0, -1]]) == pytest.approx(160, abs=25)


def test_no_picture_without_a_result(tmp_path: Path) -> None:
    with pytest.raises(InputError):
        BatchPage().draw(tmp_path, tmp_path / "p.png")
    assert not (tmp_path / "p.png").exists()


# ------------------------------------------------------------------------------------------------- plots


def visible(figure: Any) -> list[Any]:
    return [ax for ax in figure.axes if ax.get_visible()]


def test_nothing_to_compare(tmp_path: Path) -> None:
    waiting = [Ending("waiting")] * 2
    assert study_figure(table(tmp_path, {"a.b": [1, 2]}, {"s": [None, None]}, endings=waiting)) is None
    assert study_figure(table(tmp_path, {"a.b": [1, 2]}, {"s": [3.0, 3.0]})) is None
    assert study_figure(table(tmp_path, {"a.b": [1, 1]}, {"s": [3.0, 4.0]})) is None


def test_one_key_is_the_axis(tmp_path: Path) -> None:
    endings = [DONE, DONE, Ending("crashed"), DONE, Ending("expectation_failed")]
    keys = {"x.rate": [30.0, 10.0, 5.0, 20.0, 40.0], "x.same": [1] * 5}
    scalars = {"wall_seconds": [1.0, 2.0, 1.0, 3.0, 1.0], "s": [9.0, 1.0, 7.0, 4.0, 16.0], "constant": [2.0] * 5}
    first, second = visible(study_figure(table(tmp_path, keys, scalars, endings=endings)))
    (line,) = first.lines
    np.testing.assert_array_equal(line.get_xydata(), [[10, 1], [20, 4], [30, 9], [40, 16]])
    assert (first.get_xlabel(), first.get_ylabel()) == ("rate", "s")
    assert first.get_xscale() == "linear"
    assert second.get_ylabel() == "wall_seconds"


def test_a_key_spread_by_ratios_has_a_logarithmic_axis(tmp_path: Path) -> None:
    spread = [1e3, 1e4, 1e5, 1e6]
    (ax,) = visible(study_figure(table(tmp_path, {"a.E": spread}, {"s": [1e-3, 1.0, 10.0, 1e3]})))
    assert (ax.get_xscale(), ax.get_yscale()) == ("log", "log")
    even = [0.01, 0.15, 0.3, 0.45]
    (ax,) = visible(study_figure(table(tmp_path, {"a.nu": even}, {"s": [1.0, 2.0, 3.0, -1.0]})))
    assert (ax.get_xscale(), ax.get_yscale()) == ("linear", "linear")


def test_two_keys_are_axis_and_curves(tmp_path: Path) -> None:
    keys = {"solver.method": ["a", "b"] * 3, "x.dt": [1, 1, 2, 2, 3, 3]}
    (ax,) = visible(study_figure(table(tmp_path, keys, {"s": [1.0, 2.0, 3.0, 4.0, 5.0, 6.0]})))
    assert ax.get_xlabel() == "dt"
    assert {line.get_label(): line.get_ydata().tolist() for line in ax.lines} == {"a": [1, 3, 5], "b": [2, 4, 6]}
    assert ax.get_legend().get_title().get_text() == "method"


def test_words_alone_are_points_over_words(tmp_path: Path) -> None:
    (ax,) = visible(study_figure(table(tmp_path, {"a.law": ["x", [1, 2], None]}, {"s": [1.0, 2.0, 3.0]})))
    assert [label.get_text() for label in ax.get_xticklabels()] == ["x", "[1, 2]", "(as it is)"]
    assert ax.lines[0].get_linestyle() == "None"


def test_a_random_sample_of_two_keys_is_a_map(tmp_path: Path) -> None:
    random = np.random.default_rng(0)
    keys = {"a.x": random.random(20).tolist(), "a.y": random.random(20).tolist()}
    axes = visible(
        study_figure(table(tmp_path, keys, {"s": random.random(20).tolist(), "t": random.random(20).tolist()}))
    )
    maps = [ax for ax in axes if ax.get_xlabel()]
    assert [ax.get_title() for ax in maps] == ["s", "t"]
    np.testing.assert_allclose(maps[0].collections[0].get_offsets(), np.column_stack(list(keys.values())))


def test_many_keys_are_small_multiples(tmp_path: Path) -> None:
    random = np.random.default_rng(0)
    keys = {f"a.{name}": random.random(20).tolist() for name in "xyz"}
    keys["a.word"] = ["p", "q"] * 10
    scalars = {f"s{i}": random.random(20).tolist() for i in range(5)}
    axes = visible(study_figure(table(tmp_path, keys, scalars)))
    assert [(ax.get_xlabel(), ax.get_ylabel()) for ax in axes] == [(x, f"s{i}") for i in range(3) for x in "xyz"]


def test_the_table_as_text(tmp_path: Path) -> None:
    endings = [DONE, Ending("crashed", 'ended by "SIGSEGV", perhaps', -11, 0.25), Ending("waiting")]
    study = table(tmp_path, {"a.b": [True, [1, 2.5], "two\nlines"]}, {"s": [0.1, None, None]}, endings=endings)
    assert to_csv(study).split("\n") == [
        "number,run,a.b,status,reason,exit_code,seconds,s",
        "1,000000000000,true,done,,0,1.500,0.1",
        '2,000000000001,"[1, 2.5]",crashed,"ended by ""SIGSEGV"", perhaps",-11,0.250,',
        "3,000000000002,two lines,waiting,,,,",
        "",
    ]
