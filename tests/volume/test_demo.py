"""Tests of the bundled CT of a patient and its citation."""

from __future__ import annotations

from carina.volume import demo_patient
from carina.volume.demo import CASE_PATH, CITATION


def test_bundled_patient_opens_with_its_citation():
    volume = demo_patient()
    assert volume.is_hu
    assert volume.shape_zyx == (97, 268, 432)
    assert volume.source.citation is not None
    for text in ("10.7937/K9/TCIA.2015.NPGZYZBZ", "CC BY 3.0", "cropped"):
        assert text in str(volume.source.citation)
    assert CASE_PATH.stat().st_size <= 15_000_000


def test_citation_as_text_is_one_line():
    assert str(CITATION) == (
        "Goldgof D, Hall L, Hawkins S, Schabath M, Stringfield O, Garcia A, et al. (2015). Data From QIN_LUNG_CT. The "
        "Cancer Imaging Archive. https://doi.org/10.7937/K9/TCIA.2015.NPGZYZBZ \u00b7 Licence: CC BY 3.0. Changed: "
        "cropped around the airways; voxel values unchanged."
    )


def test_bundled_patient_has_its_citation_as_a_file():
    text = (CASE_PATH.parent / "CITATION.txt").read_text(encoding="utf-8")
    for message in ("QIN_LUNG_CT", "10.7937/K9/TCIA.2015.NPGZYZBZ", "CC BY 3.0", "cropped"):
        assert message in text
