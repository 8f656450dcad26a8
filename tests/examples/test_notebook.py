"""Tests of the notebook of the examples: it runs from a CT to a named tree, a picture and a video, and shows each."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import carina
from carina.export import Film
from carina.render import Picture
from run_notebook import Shown, as_html, run_notebook

NOTEBOOK = Path(__file__).resolve().parents[2] / "examples" / "04_notebook" / "from_ct_to_film.ipynb"


@pytest.fixture(scope="module")
def ran(tmp_path_factory: pytest.TempPathFactory):
    pytest.importorskip("av")
    folder = tmp_path_factory.mktemp("notebook")
    return (*run_notebook(NOTEBOOK, folder), folder)


@pytest.mark.slow
def test_notebook_example_shows_a_volume_a_named_tree_pictures_and_a_video(ran) -> None:
    cells, names, folder = ran
    values = [cell.value for cell in cells if cell.value is not None]
    assert [type(value).__name__ for value in values] == [
        "Volume", "Airways", "tuple", "Picture", "Picture", "Film", "str",
    ]  # fmt: skip
    airways: carina.Airways = names["airways"]
    assert sum(branch.name is not None for branch in airways.tree.branches) > 10
    assert airways.tree.root.name == "Trachea"
    inside = values[3]
    assert isinstance(inside, Picture)
    red, blue = (inside.rgb[..., n].astype(float) for n in (0, 2))
    assert red.mean() > blue.mean() + 10, "mucosa is warm"
    assert np.ptp(red) > 100, "a bright wall and a dark lumen ahead"
    film = values[5]
    assert isinstance(film, Film)
    assert film.num_frames > 20
    assert film.path.name == "flight.mp4"
    assert (folder / "flight.mp4").stat().st_size > 10_000
    assert len(carina.read_tree(folder / "airways.json")) == len(airways.tree)


@pytest.mark.slow
def test_notebook_page_contains_its_output_and_no_local_path(ran) -> None:
    cells, _, folder = ran
    page = as_html(cells, "notebook")
    assert page.count("<img ") == 3 + 2, "three slices of the volume, two pictures"
    assert page.count("<svg ") == 1
    assert page.count("<video ") == 1
    assert "<h1>From a CT to a named tree, a picture and a film</h1>" in page
    assert str(folder) not in page
    assert str(Path.home()) not in page


def test_notebook_page_escapes_printed_text_and_uses_the_notebook_representation_of_values() -> None:
    class Drawn:
        def _repr_png_(self) -> bytes:
            return b"png"

        def __repr__(self) -> str:
            return "Drawn()"

    cells = [Shown("markdown", "## A\n\nb `c`"), Shown("code", "x < 1", 3, "<&>"), Shown("code", "d", Drawn())]
    page = as_html(cells, "t")
    assert "<h2>A</h2><p>b <code>c</code></p>" in page
    assert "<pre>x &lt; 1</pre><samp>&lt;&amp;&gt;</samp><p><samp>3</samp></p>" in page
    assert '<img alt="Drawn()" src="data:image/png;base64,cG5n">' in page
