"""Tests of measurements as a DICOM structured report, and of the plan's PDF as a DICOM document."""

from __future__ import annotations

import datetime
import functools
import warnings

import numpy as np
import pydicom
import pytest
from dicom_writer import series
from nodules import ellipsoid

from carina.errors import DiskError, UsageError, VolumeImportError
from carina.export.plan_dicom_pdf import write_plan_pdf
from carina.export.plan_dicom_seg import inside_on_grid, write_target_seg
from carina.export.plan_dicom_sr import write_target_report
from carina.volume import Volume, open_volume

NOW = datetime.datetime(2026, 3, 4, 15, 30, 5, tzinfo=datetime.UTC)
PDF = b"%PDF-1.7\n1 0 obj\n<< /Type /Page >>\nendobj\ntrailer << /Root 1 0 R >>\n%%EOF\n"
CENTRE = (-1.7125, -3.0625, 22.8125)


@pytest.fixture(scope="module")
def ct(tmp_path_factory):
    return series(tmp_path_factory.mktemp("ct"))


@pytest.fixture(scope="module")
def volume(ct) -> Volume:
    return open_volume(ct)


@functools.cache
def nodule():
    return ellipsoid([6.0, 4.5, 5.0], CENTRE, step_mm=0.4)


def items(holder, meaning):
    return [one for one in holder.ContentSequence if concept(one) == meaning]


def concept(item):
    return item.ConceptNameCodeSequence[0].CodeMeaning if "ConceptNameCodeSequence" in item else None


def groups(data):
    (measurements,) = items(data, "Imaging Measurements")
    return items(measurements, "Measurement Group")


def test_dicom_report_contains_the_measurements_and_their_positions(ct, volume, tmp_path):
    data = pydicom.dcmread(write_target_report(tmp_path / "r.dcm", nodule(), volume, ct, now=NOW))
    assert (data.Modality, data.ContentTemplateSequence[0].TemplateIdentifier) == ("SR", "1500")
    assert (data.VerificationFlag, data.PreliminaryFlag) == ("UNVERIFIED", "PRELIMINARY")
    (group,) = groups(data)
    for meaning, value, unit in (
        ("Volume", nodule().volume_mm3, "mm3"),
        ("Long Axis", 12.0, "mm"),
        ("Short Axis", 9.0, "mm"),
    ):
        (found,) = items(group, meaning)
        measured = found.MeasuredValueSequence[0]
        assert float(measured.NumericValue) == pytest.approx(value, abs=1e-6)
        assert measured.FloatingPointValue == value
        assert measured.MeasurementUnitsCodeSequence[0].CodeValue == unit
    (centre,) = items(group, "Center")
    assert np.abs(np.subtract(centre.GraphicData, CENTRE)).max() < 0.01
    one = pydicom.dcmread(next(iter(ct.iterdir())))
    assert centre.ReferencedFrameOfReferenceUID == one.FrameOfReferenceUID
    assert data.StudyInstanceUID == one.StudyInstanceUID
    (comment,) = items(group, "Comment")
    assert "0.3 mm" in comment.TextValue
    assert "Not verified by a reader" in comment.TextValue


def test_image_library_and_evidence_of_a_dicom_report_list_the_slices_that_show_the_target(ct, volume, tmp_path):
    data = pydicom.dcmread(write_target_report(tmp_path / "r.dcm", nodule(), volume, ct))
    (library,) = items(data, "Image Library")
    (listed,) = items(library, "Image Library Group")
    uids = [one.ReferencedSOPSequence[0].ReferencedSOPInstanceUID for one in listed.ContentSequence]
    seen = np.flatnonzero(inside_on_grid(nodule(), volume).any(axis=(1, 2)))
    names = sorted(ct.iterdir())
    assert uids == [pydicom.dcmread(names[k]).SOPInstanceUID for k in seen]
    (study,) = data.CurrentRequestedProcedureEvidenceSequence
    assert [one.ReferencedSOPInstanceUID for one in study.ReferencedSeriesSequence[0].ReferencedSOPSequence] == uids


def test_measurement_group_and_its_dicom_segment_have_the_same_tracking_identifier(ct, volume, tmp_path):
    other = ellipsoid([3.0, 3.0, 4.0], (3.0, -3.0, 30.0), step_mm=0.4)
    targets = {"Nodule A": nodule(), "Nodule B": other}
    seg = write_target_seg(tmp_path / "s.dcm", targets, volume, ct)
    # The report contains only the second target.
    report = write_target_report(tmp_path / "r.dcm", {"Nodule B": other}, volume, ct, segmentation=seg)
    segments, (group,) = pydicom.dcmread(seg), groups(pydicom.dcmread(report))
    referred = items(group, "Referenced Segment")[0].ReferencedSOPSequence[0]
    assert referred.ReferencedSOPInstanceUID == segments.SOPInstanceUID
    assert referred.ReferencedSegmentNumber == 2
    assert segments.SegmentSequence[1].TrackingUID == items(group, "Tracking Unique Identifier")[0].UID
    assert items(group, "Tracking Identifier")[0].TextValue == "Nodule B"
    assert group.ContentTemplateSequence[0].TemplateIdentifier == "1411"


def test_highdicom_reads_the_dicom_report_and_finds_the_measurements(ct, volume, tmp_path):
    highdicom = pytest.importorskip("highdicom", reason="highdicom, the independent reader, is not installed")
    seg = write_target_seg(tmp_path / "s.dcm", nodule(), volume, ct)
    report = highdicom.sr.srread(write_target_report(tmp_path / "r.dcm", nodule(), volume, ct, segmentation=seg))
    (group,) = report.content.get_volumetric_roi_measurement_groups()
    assert group.tracking_identifier == "Target"
    assert group.finding_type.meaning == "Nodule"
    found = {one.name.meaning: (one.value, one.unit.value) for one in group.get_measurements()}
    assert found["Volume"] == (pytest.approx(nodule().volume_mm3), "mm3")
    assert found["Long Axis"] == (pytest.approx(12.0), "mm")
    assert found["Short Axis"] == (pytest.approx(9.0), "mm")
    assert group.referenced_segment.referenced_segment_numbers == [1]


def test_dicom_report_refuses_a_segmentation_of_another_ct_or_without_the_target(ct, volume, tmp_path):
    seg = write_target_seg(tmp_path / "s.dcm", nodule(), volume, ct)
    with pytest.raises(UsageError, match="no segment called 'Nodule B'"):
        write_target_report(tmp_path / "r.dcm", {"Nodule B": nodule()}, volume, ct, segmentation=seg)
    elsewhere = series(tmp_path / "elsewhere")
    other = write_target_seg(tmp_path / "o.dcm", nodule(), open_volume(elsewhere), elsewhere)
    with pytest.raises(UsageError, match="of another CT"):
        write_target_report(tmp_path / "r.dcm", nodule(), volume, ct, segmentation=other)
    with pytest.raises(UsageError, match="not a DICOM segmentation"):
        write_target_report(tmp_path / "r.dcm", nodule(), volume, ct, segmentation=ct / "IM000")
    with pytest.raises(VolumeImportError, match="gone"):
        write_target_report(tmp_path / "r.dcm", nodule(), volume, ct, segmentation=tmp_path / "gone.dcm")
    assert not (tmp_path / "r.dcm").exists()


def test_target_smaller_than_a_voxel_is_reported_on_the_nearest_slice(ct, volume, tmp_path):
    tiny = ellipsoid([0.3, 0.3, 0.3], (-1.7, -3.0, 24.9), step_mm=0.1)
    data = pydicom.dcmread(write_target_report(tmp_path / "r.dcm", tiny, volume, ct))
    listed = items(items(data, "Image Library")[0], "Image Library Group")[0]
    (only,) = listed.ContentSequence
    assert only.ReferencedSOPSequence[0].ReferencedSOPInstanceUID == pydicom.dcmread(ct / "IM010").SOPInstanceUID


def test_dicom_report_contains_no_patient_data_unless_requested(ct, volume, tmp_path):
    raw = write_target_report(tmp_path / "r.dcm", nodule(), volume, ct).read_bytes()
    assert not any(secret in raw for secret in (b"Secret", b"SECRET-1", b"19010101"))
    data = pydicom.dcmread(write_target_report(tmp_path / "q.dcm", nodule(), volume, ct, identity="from the CT"))
    assert (str(data.PatientName), data.PatientID) == ("Secret^One", "SECRET-1")


def test_dicom_report_copies_no_scanner_or_institution_data_from_the_ct(tmp_path):
    def described(dataset, index):
        dataset.Manufacturer = dataset.InstitutionName = dataset.StationName = dataset.PatientComments = "Confidential"
        dataset.PatientAge, dataset.AcquisitionDateTime = "077Y", "20250102101500"

    folder = series(tmp_path / "ct", described)
    for identity in ("none", "from the CT"):
        path = write_target_report(tmp_path / "r.dcm", nodule(), open_volume(folder), folder, identity=identity)
        assert not any(text in path.read_bytes() for text in (b"Confidential", b"077Y", b"20250102"))


def test_dicom_report_of_a_ct_with_a_private_sop_class_and_unusual_identity_is_written(tmp_path):
    def unusual(dataset, index):
        dataset.SOPClassUID = "1.2.3.4.99"
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # pydicom warns about the invalid date
            dataset.PatientSex, dataset.PatientBirthDate = "U", "1901"

    folder = series(tmp_path / "ct", unusual)
    volume = open_volume(folder)
    seg = write_target_seg(tmp_path / "s.dcm", nodule(), volume, folder)
    path = write_target_report(tmp_path / "r.dcm", nodule(), volume, folder, segmentation=seg, identity="from the CT")
    data = pydicom.dcmread(path)
    assert (data.PatientSex, data.PatientBirthDate) == ("U", "1901")
    (study,) = data.CurrentRequestedProcedureEvidenceSequence
    classes = [one.ReferencedSOPSequence[0].ReferencedSOPClassUID for one in study.ReferencedSeriesSequence]
    assert classes == ["1.2.3.4.99", pydicom.uid.SegmentationStorage]


def test_pdf_inside_a_dicom_document_is_read_back_byte_for_byte(tmp_path):
    for pdf in (PDF, PDF + b"\n"):
        data = pydicom.dcmread(write_plan_pdf(tmp_path / "p.dcm", pdf, names_patient=False, now=NOW))
        assert data.EncapsulatedDocument[: data.EncapsulatedDocumentLength] == pdf
        assert len(data.EncapsulatedDocument) % 2 == 0
        assert (data.MIMETypeOfEncapsulatedDocument, data.Modality) == ("application/pdf", "DOC")
        assert data.file_meta.MediaStorageSOPClassUID == "1.2.840.10008.5.1.4.1.1.104.1"
        assert (data.BurnedInAnnotation, data.PatientIdentityRemoved) == ("NO", "YES")
        assert (data.DocumentTitle, data.ContentDate) == ("Bronchoscopy plan", "20260304")


def test_dicom_pdf_without_patient_identity_has_a_new_study_uid(ct, volume, tmp_path):
    one = pydicom.dcmread(next(iter(ct.iterdir())))
    data = pydicom.dcmread(write_plan_pdf(tmp_path / "p.dcm", PDF, names_patient=False))
    assert data.StudyInstanceUID != one.StudyInstanceUID
    filed = write_plan_pdf(
        tmp_path / "q.dcm", PDF, names_patient=True, identity="from the CT", volume=volume, ct=ct, title="Plan ÄÖ"
    )
    found = pydicom.dcmread(filed)
    assert found.StudyInstanceUID == one.StudyInstanceUID
    assert (found.PatientID, found.BurnedInAnnotation, found.DocumentTitle) == ("SECRET-1", "YES", "Plan ÄÖ")


def test_invalid_pdf_and_pdf_with_the_patient_name_are_refused(ct, volume, tmp_path):
    for pdf in (b"", b"<html>", PDF[:-8], PDF[1:]):
        with pytest.raises(UsageError, match="expected a whole PDF"):
            write_plan_pdf(tmp_path / "p.dcm", pdf, names_patient=False)
    with pytest.raises(UsageError, match="no identity was requested"):
        write_plan_pdf(tmp_path / "p.dcm", PDF, names_patient=True)
    with pytest.raises(UsageError, match="name both"):
        write_plan_pdf(tmp_path / "p.dcm", PDF, names_patient=True, identity="from the CT", volume=volume)
    with pytest.raises(UsageError, match="title"):
        write_plan_pdf(tmp_path / "p.dcm", PDF, names_patient=False, title="a\\b")
    with pytest.raises(UsageError, match=r"\.dcm"):
        write_plan_pdf(tmp_path / "p.pdf", PDF, names_patient=False)
    assert not list(tmp_path.iterdir())
    with pytest.raises(DiskError):
        write_plan_pdf(tmp_path / "missing" / "p.dcm", PDF, names_patient=False)
