"""The report: one page that loads nothing, shows what is there, and says what is not."""

from __future__ import annotations

import base64
import json
import re
import shutil
import sys
from functools import partial
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from made_results import N_FRAMES, block, record

from femdeform.errors import InputError, MissingDependencyError, OutputError
from femdeform.post import backend, report, scene3d
from femdeform.post.render import draw_frames
from femdeform.post.report import write_report
from femdeform.post.scene3d import interactive_data
from femdeform.run.result import Result
from femdeform.run.vtu import FrameMesh

VOID = {"meta", "img", "input", "br", "link", "hr", "wbr"}


class Page(HTMLParser):
    """What a page says and what it loads; complains about tags that do not match."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.open: list[str] = []
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.texts: dict[str, list[str]] = {}
        self.source = path.read_text(encoding="utf-8")
        self.feed(self.source)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if self.open:
            self.texts.setdefault(self.open[-1], []).append(data)

    def text(self, tag: str) -> str:
        return "".join(self.texts.get(tag, []))

    def images(self) -> list[str]:
        return [str(attributes["src"]) for tag, attributes in self.tags if tag == "img"]

    def data(self) -> dict[str, Any]:
        found = re.search(r'<script type="application/json" id="view3d-data">(.*?)</script>', self.source)
        assert found is not None
        result: dict[str, Any] = json.loads(found.group(1))
        return result


@pytest.fixture(autouse=True)
def small_pictures(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(report, "draw_frames", partial(draw_frames, size=(320, 208)))


@pytest.fixture
def copied(beam: Path, tmp_path: Path) -> Path:
    return shutil.copytree(beam, tmp_path / "copy")


def unpack(text: str, dtype: str) -> np.ndarray:
    return np.frombuffer(base64.b64decode(text), dtype=dtype)


# -------------------------------------------------------------------------------------------------- whole pages


def test_a_whole_run(copied: Path) -> None:
    path = write_report(copied)
    assert path == copied / "report.html"
    page = Page(path)
    assert page.text("h1") == "A beam"
    assert page.texts["h2"] == [
        "Pictures",
        "Interactive view",
        "Run",
        "Settings",
        "Expectations",
        "Energy",
        "Residual",
        "Convergence within steps",
        "Scene",
    ]
    cells = page.text("td")
    for expected in ("12,345", "12.5", "newton-mumps", "volume_ratio", "1.01", "passed", "backward_euler"):
        assert expected in cells
    assert "preset: newton-mumps" in page.text("pre")
    kinds = [source.split(";")[0] for source in page.images()]
    assert kinds.count("data:image/svg+xml") == 3
    if backend._can_draw():
        assert kinds.count("data:image/png") == 3
    assert path.stat().st_size < 15e6


def test_nothing_is_loaded_from_elsewhere(copied: Path) -> None:
    page = Page(write_report(copied))
    for tag, attributes in page.tags:
        assert tag not in ("link", "iframe", "object", "embed", "base")
        for name in ("src", "href", "srcset", "data", "action", "poster"):
            assert str(attributes.get(name, "data:")).startswith("data:"), (tag, name)
    assert "@import" not in page.text("style")
    assert "url(" not in page.text("style")
    policy = next(a["content"] for t, a in page.tags if t == "meta" and "http-equiv" in a)
    assert policy is not None
    assert policy.startswith("default-src 'none'")
    assert "http" not in policy
    # The library's own button for uploading plots stays out.
    viewer = page.text("script").split("view3d-data")[-1]
    assert 'plotlyServerURL: ""' in viewer
    assert "showSendToCloud: false" in viewer


def test_text_of_the_user_is_escaped(tmp_path: Path) -> None:
    points, cells = block((1, 1, 1), (1.0, 1.0, 1.0))
    evil = "</script><script>alert('1')</script> & <b>\"bold\"</b>"
    folder = record(
        tmp_path / "r",
        FrameMesh(points, [("tetra", cells)], {}),
        lambda time: time * points,
        title=evil,
        status="not_converged",
        reason=f"reason {evil}",
        facts={"odd <i>": evil, "bodies": [evil]},
    )
    page = Page(write_report(folder))
    assert page.text("h1") == evil
    assert page.text("title") == f"{evil} - femdeform"
    assert f"reason {evil}" in page.text("p")
    assert not {"b", "i"} & {tag for tag, _ in page.tags}
    assert sum(tag == "script" for tag, _ in page.tags) == 4
    assert any(a.get("class") == "badge bad" for _, a in page.tags)


def test_a_report_made_twice_is_the_same(copied: Path, tmp_path: Path) -> None:
    first, second = write_report(copied, tmp_path / "new" / "a.html"), write_report(copied, tmp_path / "b.html")
    assert first == tmp_path / "new" / "a.html"
    assert first.read_bytes() == second.read_bytes()


# ------------------------------------------------------------------------------------------------ missing parts


@pytest.mark.parametrize(
    ("missing", "message"),
    [
        ("history.csv", "history.csv: no such file"),
        ("iterations.csv", None),
        ("frames.pvd", "No frames were written"),
        ("frames/frame_00002.vtu", "frames/frame_00002.vtu is missing"),
        ("resolved.yaml", "the resolved scene cannot be read"),
        ("final.vtu", None),
    ],
)
def test_a_file_that_is_missing(copied: Path, missing: str, message: str | None) -> None:
    (copied / missing).unlink()
    page = Page(write_report(copied))
    assert page.text("h1") == "A beam"
    assert "12,345" in page.text("td")
    if message is None:
        assert "no such file" not in page.text("p")
    else:
        assert message in page.text("p")
    assert ("Convergence within steps" in page.texts["h2"]) == (missing != "iterations.csv")


@pytest.mark.parametrize(
    "name", ["history.csv", "iterations.csv", "frames.pvd", "frames/frame_00004.vtu", "resolved.yaml"]
)
def test_a_file_that_is_corrupt(copied: Path, name: str) -> None:
    (copied / name).write_bytes(b"step,[\n\xff,\x00\n")
    page = Page(write_report(copied))
    assert name.rsplit("/", 1)[-1] in page.text("p")
    assert "12,345" in page.text("td")


def test_a_run_that_failed_before_its_first_step(copied: Path) -> None:
    for path in (*copied.glob("frames/*"), *copied.glob("*.csv"), copied / "frames.pvd", copied / "resolved.yaml"):
        path.unlink()
    facts = {"status": "not_converged", "reason": "step 1: the residual is not finite", "steps": 0}
    (copied / "result.json").write_text(json.dumps(facts))
    page = Page(write_report(copied))
    assert page.text("h1") == "copy"
    assert page.text("span") == "not converged"
    assert "step 1: the residual is not finite" in page.text("p")


def test_expectations_that_failed_stand_out(copied: Path) -> None:
    facts = json.loads((copied / "result.json").read_text())
    facts["expect"][0]["passed"] = False
    (copied / "result.json").write_text(json.dumps(facts))
    page = Page(write_report(copied))
    assert "FAILED" in page.texts["td"]
    assert ("td", {"class": "fail"}) in page.tags
    facts["expect"] = []
    (copied / "result.json").write_text(json.dumps(facts))
    assert "Expectations" not in Page(write_report(copied)).texts["h2"]


def test_a_machine_that_cannot_draw_still_reports(copied: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse() -> None:
        raise MissingDependencyError("pictures need OpenGL")

    monkeypatch.setattr("femdeform.post.render.load_pyvista", refuse)
    page = Page(write_report(copied))
    assert "pictures need OpenGL" in page.text("p")
    assert len(page.data()["frames"]) == N_FRAMES


def test_without_plotly_the_rest_is_there(copied: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "plotly.offline", None)
    page = Page(write_report(copied))
    assert "the interactive view needs plotly" in page.text("p")
    assert "view3d-data" not in page.source


def test_what_is_no_result_or_cannot_be_written(copied: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such result folder"):
        write_report(tmp_path / "missing")
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputError, match="cannot write"):
        write_report(copied, tmp_path / "file" / "report.html")


# --------------------------------------------------------------------------------------------- interactive view


def test_the_view_shows_every_frame_of_the_surface(beam: Path) -> None:
    result = Result.open(beam)
    data = json.loads(interactive_data(result))
    assert [frame["time"] for frame in data["frames"]] == [entry.time for entry in result.frames]
    assert (data["dim"], data["up"], data["label"]) == (3, [0, 1, 0], "displacement [m]")
    low, high = np.array(data["low"]), np.array(data["high"])
    np.testing.assert_allclose([low, high], [[0, 0, 0], [1, 0.6, 0.2]], atol=1e-12)
    assert data["largest"] == pytest.approx(0.4)
    triangles = unpack(data["triangles"], "<u4").reshape(-1, 3)
    assert triangles.max() == data["n_nodes"] - 1
    assert len(triangles) == 2 * (4 * 6 * 2 + 2 * 2 * 2)
    for number, packed in enumerate(data["frames"]):
        frame = result.read_frame(number)
        positions = low + unpack(packed["positions"], "<u2").reshape(-1, 3) / 65535 * (high - low)
        values = unpack(packed["values"], "<u2") / 65535 * data["largest"]
        # Each node shown is a point of the frame, to within the rounding, with that point's displacement.
        distance = np.linalg.norm(positions[:, None] - frame.positions, axis=2)
        assert distance.min(axis=1).max() < 1e-4
        norm = np.linalg.norm(frame.displacement, axis=1)
        np.testing.assert_allclose(values, norm[distance.argmin(axis=1)], atol=1e-4)


def test_rods_and_quadratic_bodies_are_in_the_view(assembly: Path) -> None:
    data = json.loads(interactive_data(Result.open(assembly)))
    lines = unpack(data["lines"], "<u4").reshape(-1, 2)
    triangles = unpack(data["triangles"], "<u4").reshape(-1, 3)
    assert len(lines) == 5
    assert lines.min() > triangles.max()
    assert lines.max() == data["n_nodes"] - 1
    assert len(triangles) == 4 * 48 + 2


def test_2d_scenes_are_seen_from_above(plane: Path) -> None:
    data = json.loads(interactive_data(Result.open(plane)))
    assert (data["dim"], data["eye"], data["up"]) == (2, [0, 0, 1], [0, 1, 0])
    assert unpack(data["outline"], "<f4").size == 4 * 6


def test_large_results_stay_small(beam: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(scene3d, "MAX_TRIANGLES", 50)
    data = json.loads(interactive_data(Result.open(beam)))
    assert data["thinned"]
    assert 10 < unpack(data["triangles"], "<u4").size / 3 <= 50
    monkeypatch.setattr(scene3d, "MAX_FRAMES", 3)
    data = json.loads(interactive_data(Result.open(beam)))
    assert [frame["time"] for frame in data["frames"]] == [0.0, 0.5, 1.0]
    monkeypatch.setattr(scene3d, "BUDGET", 1)
    data = json.loads(interactive_data(Result.open(beam)))
    assert [frame["time"] for frame in data["frames"]] == [1.0]
