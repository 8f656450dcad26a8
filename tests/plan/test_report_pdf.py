"""Tests of the PDF report; they need the extra `report`, and pypdf to read the PDF."""

from __future__ import annotations

import dataclasses
import io
import re
from functools import cache
from pathlib import Path

import pytest
from phantom_plan import plan, sheet
from test_report import SAFETY, everything

from carina.errors import UsageError
from carina.plan.report import write_report
from carina.plan.report.blocks import Figure, Section, Words
from carina.plan.report.drawing import Drawing
from carina.plan.report.write import pdf_pages

pytest.importorskip("reportlab", reason="needs the extra `report`")
pypdf = pytest.importorskip("pypdf", reason="needs pypdf")


@cache
def content(paper: str = "A4", kind: str = "report") -> bytes:
    import tempfile

    with tempfile.TemporaryDirectory() as folder:
        return write_report(Path(folder) / "plan.pdf", sheet(), paper=paper, kind=kind).read_bytes()


def pages(paper: str = "A4", kind: str = "report") -> list:
    return list(pypdf.PdfReader(io.BytesIO(content(paper, kind))).pages)


def plain(text: str) -> str:
    """Return a text without white space, because page and PDF break lines at different positions."""
    return re.sub(r"\s+", "", text)


def test_pdf_report_contains_every_word_of_the_html_report() -> None:
    found = plain("".join(page.extract_text() for page in pages()))
    assert [text for text in everything() if plain(text) not in found] == []


@pytest.mark.parametrize(("paper", "size"), [("A4", (595.3, 841.9)), ("Letter", (612.0, 792.0))])
def test_every_pdf_page_has_the_disclaimer_and_the_name_of_the_target(paper, size) -> None:
    read = pages(paper)
    for number, page in enumerate(read, 1):
        assert [float(v) for v in page.mediabox[2:]] == pytest.approx(size, abs=0.1)
        text = page.extract_text()
        assert all(message in text for message in SAFETY)
        assert plan().nodule.words in text and f"{number} / {len(read)}" in text


@pytest.mark.parametrize("paper", ["A4", "Letter"])
def test_text_of_the_pdf_report_has_at_least_8_points(paper) -> None:
    sizes: list[tuple[float, str]] = []

    def visit(text: str, page: list[float], line: list[float], _font: object, size: float) -> None:
        if text.strip():
            sizes.append((size * abs(page[3] * line[3]), text))

    for page in pages(paper):
        page.extract_text(visitor_text=visit)
    assert len(sizes) > 100
    assert [one for one in sizes if one[0] < 7.99] == []


def test_pdf_of_one_plan_written_twice_has_identical_bytes(tmp_path) -> None:
    assert write_report(tmp_path / "plan.pdf", sheet()).read_bytes() == content()


def test_pdf_report_embeds_its_fonts_and_draws_outlines_as_vectors_over_the_slices() -> None:
    fonts = {}
    for page in pages():
        for font in page["/Resources"]["/Font"].values():
            fonts[font.get_object()["/BaseFont"]] = font.get_object()
    used = [font for name, font in fonts.items() if "+" in name]
    assert used and all("/FontFile2" in font["/FontDescriptor"] for font in used)
    first = pages()[0]
    assert len(first.images) == 3
    assert first.get_contents().get_data().count(b" l ") + first.get_contents().get_data().count(b" l\n") > 100


def test_tracing_sheet_of_the_pdf_report_is_one_page() -> None:
    (only,) = pages("Letter", "tracing")
    text = plain(only.extract_text())
    assert all(plain(fork.to_name) in text for fork in sheet().forks)


def test_tracing_sheet_of_two_pages_begins_on_the_first_page(tmp_path) -> None:
    fork = sheet().forks[0]
    many = tuple(dataclasses.replace(fork, number=n, to_name=f"branch {n:03}") for n in range(1, 41))
    long = dataclasses.replace(sheet(), forks=many)
    for paper in ("A4", "Letter"):
        path = write_report(tmp_path / f"{paper}.pdf", long, kind="tracing", paper=paper)
        first, *_ = pypdf.PdfReader(path).pages
        assert "branch001" in plain(first.extract_text())


@pytest.mark.parametrize("starts_page", [True, False])
def test_section_that_fills_its_page_is_followed_by_no_empty_page(starts_page) -> None:
    page = Figure(Drawing(500.0, 610.0, (), "a drawing as tall as a page"))
    end = Section("end", "End", (Words("the last words"), page), starts_page=starts_page)
    for height in range(560, 640, 8):
        tall = Figure(Drawing(500.0, float(height), (), "a tall drawing"))
        content = pdf_pages(sheet(), (Section("tall", "Tall", (Words("first words"), tall)), end), paper="Letter")
        texts = [page.extract_text() for page in pypdf.PdfReader(io.BytesIO(content)).pages]
        assert [n for n, text in enumerate(texts) if "words" not in text.lower()] == []


@pytest.mark.parametrize("paper", ["A4", "Letter"])
def test_text_of_the_pdf_tracing_sheet_has_at_least_8_points(paper) -> None:
    sizes: list[float] = []

    def note(text: str, cm: list[float], tm: list[float], _font: object, size: float) -> None:
        if text.strip():
            sizes.append(abs(size * tm[3] * cm[3]))

    for page in pages(kind="tracing", paper=paper):
        page.extract_text(visitor_text=note)
    assert sizes and min(sizes) >= 8.0


def test_letters_missing_in_the_pdf_font_are_refused_with_their_unicode_numbers(tmp_path) -> None:
    with pytest.raises(UsageError, match=r"'\\u60a3' \(U\+60A3\)|'\u60a3' \(U\+60A3\)"):
        write_report(tmp_path / "plan.pdf", sheet(patient="\u60a3\u8005"))
    assert "\u60a3\u8005" in write_report(tmp_path / "plan.html", sheet(patient="\u60a3\u8005")).read_text()
    assert write_report(tmp_path / "named.pdf", sheet(patient="J\u00f6rg M\u00fcller")).stat().st_size > 1000


def test_note_longer_than_a_page_and_a_long_name_are_printed_completely(tmp_path) -> None:
    note = " ".join(f"word{n:04}" for n in range(1500))
    name = "Wolfeschlegelsteinhausenbergerdorff Hubert Blaine " * 2
    written = write_report(tmp_path / "long.pdf", sheet(notes=(note,), patient=name.strip()))
    read = pypdf.PdfReader(written).pages
    text = plain("".join(page.extract_text() for page in read))
    assert all(f"word{n:04}" in text for n in range(1500))
    assert all(plain(name) in plain(page.extract_text()) for page in read)


def test_target_in_the_tree_drawing_of_the_pdf_is_transparent() -> None:
    states = [
        state
        for page in pages()
        if "/ExtGState" in page["/Resources"]
        for state in page["/Resources"]["/ExtGState"].values()
    ]
    assert any(state.get_object().get("/ca") == pytest.approx(0.55) for state in states)
