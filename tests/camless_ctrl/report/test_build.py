import json
import re
from dataclasses import dataclass
from html.parser import HTMLParser

import matplotlib.pyplot as plt
import pytest

from camless_ctrl.output import OutputError
from camless_ctrl.report import (
    ChapterResult,
    Column,
    Context,
    Figure,
    Heading,
    Link,
    Number,
    Table,
    Text,
    build_report,
)
from camless_ctrl.report.chapters.reproducibility import ReproducibilityChapter
from camless_ctrl.report.chapters.requirements import RequirementsChapter
from camless_ctrl.report.chapters.summary import SummaryChapter
from camless_ctrl.requirements import REQUIREMENTS, Requirement, RequirementResult
from plant import Engine, ParameterError

SCRIPT = "<script>alert('x')</script>"
VOID = {"meta", "link", "br", "img", "hr", "input"}


class Page(HTMLParser):
    """Element tree facts: nesting is checked, ids, references and texts are gathered."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.ids: list[str] = []
        self.references: list[tuple[str, str, str]] = []
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.words = ""
        self.feed(text)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag, attrs):
        given = dict(attrs)
        self.tags.append((tag, given))
        if tag not in VOID:
            self.open.append(tag)
        if given.get("id"):
            self.ids.append(given["id"])
        for name in ("href", "src", "xlink:href", "action", "data", "srcset"):
            if name in given:
                self.references.append((tag, name, given[name]))

    def handle_startendtag(self, tag, attrs):
        self.handle_starttag(tag, attrs)
        if tag not in VOID:
            self.open.pop()

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.words += data


@dataclass
class Fake:
    id: str = "fake"
    title: str = "A chapter"
    concludes: bool = False
    passed: bool = True
    error: BaseException | None = None
    order: list | None = None

    def compute(self, context: Context) -> ChapterResult:
        if self.order is not None:
            self.order.append(self.id)
        if self.error is not None:
            raise self.error
        figures = []
        for k in range(2):
            figure, ax = plt.subplots()
            ax.plot([0, 1], [0, k])
            ax.set_title("clip & glyph")
            figures.append(
                Figure(
                    f"lines{k}",
                    Text("The line ends at {end:.0f}.", end=Number(3, "mm")),
                    f'A line {SCRIPT} "quoted"',
                    context.draw(figure),
                )
            )
        table = Table(
            "cells",
            Text("A caption {what}", what=SCRIPT),
            [Column(f"name {SCRIPT}"), Column("value", "mg", ".1f"), Column("verdict")],
            [[SCRIPT, 1.25, True], [Link(SCRIPT, self.id), None, False]],
        )
        return ChapterResult(
            finding=Text("It is {x:.1f} {what}.", x=Number(2.0, "kPa"), what=SCRIPT),
            blocks=[Heading(SCRIPT), Text("{what}", what=SCRIPT), table, *figures],
            numbers={"extra": Number(7.0, "J")},
            requirements=[
                RequirementResult(
                    Requirement(f"{self.id}-limit", 2.0, "%", "at most", "a test", f"Of {SCRIPT}"),
                    1.0 if self.passed else 3.0,
                )
            ],
        )


def chapters(*inner):
    return [SummaryChapter(), *inner, RequirementsChapter(), ReproducibilityChapter()]


@pytest.fixture
def built(tmp_path):
    report = build_report(
        tmp_path / "report",
        chapters=chapters(Fake("one", f"One {SCRIPT}"), Fake("two", passed=False)),
        context=Context(seed=11, command=f"camless report --out {SCRIPT}"),
        title=f"Title {SCRIPT}",
    )
    return report, Page(report.page.read_text(encoding="utf-8"))


def test_page_refers_to_nothing_outside_and_every_anchor_resolves(built):
    report, page = built
    assert len(page.ids) == len(set(page.ids))
    inside = {f"#{name}" for name in page.ids}
    for tag, name, target in page.references:
        allowed = target in inside or (tag == "link" and target == "data:,")
        assert allowed, f"<{tag} {name}={target}>"
    text = report.page.read_text(encoding="utf-8")
    assert "@import" not in text
    assert all(f"url({ref}" not in text for ref in ("http", "'", '"', "/"))
    assert [t for t in page.references if t[0] == "a"], "a table of contents is expected"
    assert {tag for tag, _ in page.tags}.isdisjoint({"script", "img", "iframe", "object"})


def test_contents_list_every_chapter_in_the_order_of_the_page(built):
    report, page = built
    ids = [chapter.id for chapter in report.chapters]
    assert ids == ["summary", "one", "two", "requirements", "reproducibility"]
    start = page.tags.index(next(t for t in page.tags if t[0] == "nav"))
    listed = [given["href"] for tag, given in page.tags[start:] if tag == "a"][: len(ids)]
    assert listed == [f"#{name}" for name in ids]


def test_every_figure_has_alternative_text_and_a_caption(built):
    _, page = built
    figures = [k for k, (tag, _) in enumerate(page.tags) if tag == "figure"]
    assert len(figures) == 4
    for k in figures:
        tag, card = page.tags[k + 1]
        assert (tag, card["role"]) == ("div", "img")
        assert card["aria-label"].strip()
        assert page.tags[k + 2][0] == "svg"
    assert sum(tag == "figcaption" for tag, _ in page.tags) == len(figures)


def test_text_of_users_is_escaped_everywhere(built):
    report, page = built
    raw = report.page.read_text(encoding="utf-8")
    assert "<script" not in raw
    # Shown as it was given: title (twice), contents, heading, cells, captions, ...
    assert page.words.count(SCRIPT) >= 12
    label = next(given["aria-label"] for tag, given in page.tags if given.get("role") == "img")
    assert label == f'A line {SCRIPT} "quoted"'


def test_json_has_every_number_requirement_and_unit(built):
    report, _ = built
    document = json.loads((report.folder / "report.json").read_text(encoding="utf-8"))
    assert document["passed"] is False
    assert document["seed"] == 11
    assert document["engine"]["temperature"] == 290.0
    assert [r["name"] for r in document["requirements"]] == ["one-limit", "two-limit"]
    assert [(r["value"], r["unit"], r["met"]) for r in document["requirements"]] == [
        (1.0, "%", True),
        (3.0, "%", False),
    ]
    one = document["chapters"][1]
    assert one["id"] == "one"
    assert one["numbers"] == {
        "x": {"value": 2.0, "unit": "kPa"},
        "end": {"value": 3, "unit": "mm"},
        "extra": {"value": 7.0, "unit": "J"},
    }
    (table,) = one["tables"]
    assert table["columns"][1] == {"name": "value", "unit": "mg"}
    assert table["rows"] == [[SCRIPT, 1.25, True], [SCRIPT, None, False]]


def test_verdict_names_what_is_not_met(built):
    report, page = built
    assert not report.passed
    assert "not met: two-limit is 3 %, but must be at most 2 %" in str(report)
    assert "1 of 2 do. To look at: two-limit is 3 %, but must be at most 2 %." in page.words
    assert "Not all requirements hold" in page.words


def test_all_met(tmp_path):
    report = build_report(tmp_path / "r", chapters=chapters(Fake("one"), Fake("two")))
    assert report.passed
    assert "Verdict: all 2 requirements hold." in report.page.read_text(encoding="utf-8")


def test_concluding_chapters_are_computed_last_and_progress_is_told(tmp_path):
    order, told = [], []
    build_report(
        tmp_path / "r",
        chapters=[Fake("end", "E", True, order=order), Fake("begin", "B", order=order)],
        progress=lambda *news: told.append(news),
    )
    assert order == ["begin", "end"]
    assert told == [("B", 0, 2), ("E", 1, 2), ("", 2, 2)]


def test_failed_chapter_is_shown_and_the_others_are_kept(tmp_path):
    failing = Fake("bad", error=ParameterError(f"{SCRIPT} is 3, but must be 2"))
    report = build_report(tmp_path / "r", chapters=chapters(failing, Fake("good")))
    assert not report.passed
    page = Page(report.page.read_text(encoding="utf-8"))
    assert f"could not be computed. ParameterError: {SCRIPT} is 3, but must be 2" in page.words
    assert "good-cells" in page.ids
    assert json.loads((report.folder / "report.json").read_text())["chapters"][1]["error"]


@pytest.mark.parametrize("error", [KeyboardInterrupt(), KeyError("a defect")])
def test_interrupted_build_leaves_nothing(tmp_path, error):
    with pytest.raises(type(error)):
        build_report(tmp_path / "r", chapters=[Fake("one"), Fake("two", error=error)])
    assert list(tmp_path.iterdir()) == []


def test_unwritable_folder_is_told_before_any_work(tmp_path):
    order = []
    (tmp_path / "r").write_text("a file")
    with pytest.raises(OutputError, match=r"/r is a file, but must be a folder: name another"):
        build_report(tmp_path / "r", chapters=[Fake(order=order)])
    assert order == []
    assert [p.name for p in tmp_path.iterdir()] == ["r"]


def test_same_ids_are_refused(tmp_path):
    with pytest.raises(ParameterError, match="chapter ids must differ"):
        build_report(tmp_path / "r", chapters=[Fake(), Fake()])


def test_same_numbers_give_the_same_figures(tmp_path):
    pages = [
        build_report(tmp_path / name, chapters=[Fake()]).page.read_text(encoding="utf-8")
        for name in ("a", "b")
    ]
    assert pages[0] == pages[1]


def test_every_engine_value_has_a_provenance():
    from camless_ctrl.report.chapters.engine import PROVENANCE, leaves

    assert set(leaves(Engine.paper())) == set(PROVENANCE)
    assert {status for _, _, status, _ in PROVENANCE.values()} == {
        "published",
        "identified",
        "assumed",
        "corrected",
    }


@pytest.mark.slow
def test_whole_report_on_the_paper_engine(tmp_path):
    report = build_report(tmp_path / "report")
    assert [chapter.error for chapter in report.chapters] == [""] * len(report.chapters)
    text = report.page.read_text(encoding="utf-8")
    page = Page(text)
    assert len(text) < 5e6
    inside = {f"#{name}" for name in page.ids}
    assert all(target in inside or target == "data:," for _, _, target in page.references)
    assert len(page.ids) == len(inside)
    # Names such as that of the fault maf-nan are no values.
    assert re.search(r"(?<![\w-])(nan|inf|None|True|False)\b", page.words) is None
    figures = sum(tag == "figure" for tag, _ in page.tags)
    assert figures >= 8
    document = json.loads((report.folder / "report.json").read_text(encoding="utf-8"))
    # Every stated requirement is decided, and the verdict is theirs.
    assert {row["name"] for row in document["requirements"]} == set(REQUIREMENTS)
    assert all(row["value"] is not None for row in document["requirements"])
    assert document["passed"] == all(row["met"] for row in document["requirements"])
    numbers = {
        name: number["value"]
        for chapter in document["chapters"]
        for name, number in chapter["numbers"].items()
    }
    # Section 3.2 of Part I: 74 % printed, about 77 % at equal charge.
    assert numbers["saving"] == pytest.approx(77.0, abs=1.0)
    assert numbers["throttle"] == pytest.approx(22.8, abs=0.2)
