"""Browser journeys of the import: mixed folder, archive, CD, PACS and a tilted series."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
from dicom_writer import series
from orthanc_server import require_orthanc, running_orthanc
from pydicom import dcmread
from pydicom.fileset import FileSet

from cached_test_data import cached_phantom

pytestmark = pytest.mark.browser

SIZES = ((1440, 900), (1280, 720), (820, 1180))
SPACING_MM = 1.2
THIN, THICK, SCOUT = "1.2.3.77.1", "1.2.3.77.2", "1.2.3.77.3"


@pytest.fixture
def opens():
    """Return a workstation that shows its start page."""
    return {}


def chest_folder(folder: Path, *, every: int = 1, tilt: float = 0.0, only_thin: bool = False) -> Path:
    """Write the phantom's chest as a thin series, with a thick series and a scout beside it.

    Only one of ``every`` voxels along each axis is written, as of a smaller chest: the automatic search for airways
    then takes little time.
    """
    hu = cached_phantom(seed=4, spacing_mm=SPACING_MM, generations=5, nodule=True).volume.hu_zyx
    hu = np.ascontiguousarray(hu[::every, ::every, ::every])

    def writer(number: int, description: str, kernel: str, step: int):
        def edit(dataset, index):
            height = index * step * SPACING_MM
            dataset.PixelSpacing, dataset.SliceThickness = [SPACING_MM, SPACING_MM], step * SPACING_MM
            dataset.ImagePositionPatient = [0, round(tilt * height, 6), round(height, 6)]
            dataset.SeriesNumber, dataset.SeriesDescription, dataset.ConvolutionKernel = number, description, kernel
            dataset.StudyDate = dataset.AcquisitionDate = "20261103"
            dataset.InstanceNumber, dataset.PatientName = index + 1, "Muster^Erika"

        return edit

    values = hu
    if tilt:
        # Each slice of a tilted scan shows the chest shifted against its own rows; air surrounds the chest.
        shifts = np.rint(tilt * np.arange(len(hu))).astype(int)
        padded = np.pad(hu, ((0, 0), (int(shifts.max()), 0), (0, 0)), constant_values=-1000)
        values = np.stack([np.roll(one, -shift, axis=0) for one, shift in zip(padded, shifts, strict=True)])
    series(folder / "a", writer(2, "Thorax 1.2 lung", "B70f", 1), hu=values, uid=THIN)
    if not only_thin:
        series(folder / "b", writer(3, "Thorax 4.8 soft", "B31f", 4), hu=hu[::4], uid=THICK)

        def scout(dataset, index):
            writer(1, "Topogram", "T20f", 1)(dataset, index)
            dataset.ImageType = ["ORIGINAL", "PRIMARY", "LOCALIZER"]

        series(folder / "c", scout, hu=hu[40:41], uid=SCOUT)
    return folder


@pytest.fixture(scope="module")
def chest_files(tmp_path_factory):
    return chest_folder(tmp_path_factory.mktemp("mixed") / "chest", every=2)


def open_path(workstation, server, path):
    workstation.open(server)
    page = workstation.page
    page.get_by_label("or type the path").fill(str(path))
    page.get_by_role("button", name="Open", exact=True).click()
    workstation.wait_for("window.__carina.state.session?.case != null")


def check_ports(workstation, port):
    """Check that a text which is not a port is stated and not saved, and that a checked TLS box can be cleared."""
    page = workstation.page
    save, field = page.get_by_test_id("save-pacs"), page.get_by_test_id("pacs-port")
    assert save.is_enabled()
    for text in ("70000", "1o4", ""):
        field.fill(text)
        page.get_by_test_id("pacs-port-error").wait_for()
        assert field.input_value() == text
        assert save.is_disabled()
    field.fill(str(port))
    page.get_by_test_id("pacs-port-error").wait_for(state="detached")
    images, tls = page.get_by_test_id("pacs-listen-port"), page.get_by_role("checkbox", name="TLS")
    images.fill("70000")
    page.get_by_test_id("pacs-listen-port-error").wait_for()
    assert save.is_disabled()
    assert tls.is_disabled()
    workstation.pictures("pacs-invalid-port", SIZES)
    images.fill("")
    tls.check()
    images.fill("11112")
    tls.uncheck()
    assert tls.is_disabled()
    images.fill("")
    assert save.is_enabled()


def check_series_list(workstation):
    """Check the list of series: pictures, facts and the reason of the preselected one; open another one."""
    page = workstation.page
    if workstation.state("ui.step") != "check":
        page.get_by_role("button", name="Check", exact=True).first.click()
    rows = page.get_by_test_id("series-list").locator("li")
    rows.first.wait_for()
    workstation.wait_for("Object.keys(window.__carina.state.seriesPictures).length === 3")
    assert rows.count() == 3
    text = rows.first.inner_text()
    assert "Thorax 1.2 lung (open)" in text
    assert "1.20\u202fmm thick, kernel b70f" in text
    assert "Likeliest chest CT" in text or "The likeliest chest CT" in text
    assert page.get_by_test_id("series-list").locator("img").count() == 3


def test_mixed_folder_lists_its_series_with_pictures_and_opens_another_one(server, workstation, chest_files):
    open_path(workstation, server, chest_files)
    check_series_list(workstation)
    workstation.pictures("mixed-folder", SIZES)
    page = workstation.page
    page.get_by_test_id("open-series").filter(has_text="4.8 soft").click()
    workstation.wait_for("window.__carina.state.session.case.series?.description === 'Thorax 4.8 soft'")
    assert workstation.state("session.case.other_series.length") == 2
    assert workstation.faults == []


def test_dropped_zip_opens_and_a_zip_by_its_path_lists_its_series(server, workstation, chest_files, tmp_path):
    archive = Path(shutil.make_archive(str(tmp_path / "chest"), "zip", chest_files))
    workstation.open(server)
    page = workstation.page
    assert "archive (zip, tar, 7z)" in page.get_by_test_id("start").inner_text()
    with page.expect_file_chooser() as chooser:
        page.get_by_role("button", name="Choose file").click()
    chooser.value.set_files(str(archive))
    workstation.wait_for("window.__carina.state.session?.case != null")
    assert workstation.state("session.case.series.description") == "Thorax 1.2 lung"
    workstation.pictures("zip-dropped", SIZES)
    page.get_by_role("button", name="Open", exact=True).first.click()
    page.get_by_role("button", name="Start page").click()
    page.get_by_test_id("start").wait_for()
    page.get_by_label("or type the path").fill(str(archive))
    page.get_by_role("button", name="Open", exact=True).click()
    workstation.wait_for("window.__carina.state.session?.case != null")
    check_series_list(workstation)
    workstation.picture("zip-by-path")
    assert workstation.faults == []


def test_directory_file_of_a_cd_opens_the_scan(server, workstation, chest_files, tmp_path):
    disc = FileSet()
    for path in sorted(chest_files.rglob("IM*")):
        dataset = dcmread(path)
        dataset.StudyID, dataset.StudyTime = "1", "101500"
        disc.add(dataset)
    disc.write(tmp_path / "cd")
    disc._stage["t"].cleanup()  # pydicom leaves its temporary folder to the garbage collector
    open_path(workstation, server, tmp_path / "cd" / "DICOMDIR")
    check_series_list(workstation)
    workstation.picture("cd")
    assert workstation.faults == []


def test_tilted_series_opens_corrected_with_a_permanent_badge(server, workstation, tmp_path):
    folder = chest_folder(tmp_path / "tilted", every=2, tilt=float(np.tan(np.radians(12.0))), only_thin=True)
    open_path(workstation, server, folder)
    page = workstation.page
    assert workstation.state("session.case.tilt_deg") == pytest.approx(12.0, abs=0.1)
    badges = workstation.state("session.badges.map((badge) => badge.code)")
    assert "import.tilt-corrected" in badges
    # The progress is whole, also while the step is longer than its panel. A fast machine may have ended the job.
    assert page.evaluate(
        "() => [...document.querySelectorAll('.step-panel .jobs')]"
        ".every((one) => one.scrollHeight <= one.clientHeight + 1)"
    )
    workstation.pictures("tilted", SIZES)
    assert workstation.faults == []


def test_pacs_is_searched_and_a_series_is_retrieved_and_opened(server, workstation, tmp_path):
    pytest.importorskip("pynetdicom", reason="needs the extra dicom")
    require_orthanc()
    page = workstation.page
    with running_orthanc(tmp_path) as orthanc:
        orthanc.upload(chest_folder(tmp_path / "chest"))
        workstation.open(server)
        page.get_by_test_id("open-pacs").click()
        page.get_by_test_id("add-pacs").click()
        workstation.picture("pacs-add-empty")
        page.get_by_test_id("pacs-name").fill("hospital")
        page.get_by_test_id("pacs-host").fill("127.0.0.1")
        page.get_by_test_id("pacs-called-ae").fill("NOBODY")
        check_ports(workstation, orthanc.dicom_port)
        workstation.pictures("pacs-add", SIZES)
        page.get_by_test_id("save-pacs").click()

        # A wrong AE title is named by the test of the connection, and corrected by the keyboard alone.
        page.get_by_test_id("test-pacs").click()
        test = page.get_by_test_id("pacs-test")
        test.wait_for()
        assert "does not have the AE title NOBODY; ask its administrator" in test.inner_text()
        workstation.pictures("pacs-test-failed", SIZES)
        page.get_by_test_id("edit-pacs").focus()
        page.keyboard.press("Enter")
        page.get_by_test_id("pacs-called-ae").fill("ORTHANC")
        page.keyboard.press("Enter")
        page.get_by_test_id("test-pacs").click()
        workstation.wait_for("window.__carina.state.pacs.test?.passed === true")

        page.get_by_test_id("pacs-patient").fill("Muster")
        page.keyboard.press("Enter")
        studies = page.get_by_test_id("pacs-studies")
        studies.wait_for()
        assert "Muster, Erika" in studies.inner_text()
        workstation.pictures("pacs-studies", SIZES)
        # The names leave the page with the dialog.
        page.keyboard.press("Escape")
        page.get_by_test_id("pacs").wait_for(state="detached")
        assert page.evaluate("JSON.stringify(window.__carina.state.pacs)").count("Muster") == 0
        page.get_by_test_id("open-pacs").click()
        page.get_by_test_id("pacs-patient").fill("Muster")
        page.keyboard.press("Enter")
        studies.get_by_role("button").first.click()
        workstation.wait_for("Object.keys(window.__carina.state.pacs.previews).length === 3")
        rows = page.get_by_test_id("pacs-series").locator("li")
        first = rows.first.inner_text()
        assert "Thorax 1.2 lung" in first
        assert "1.20\u202fmm thick" in first
        assert "kernel b70f" in first
        assert "likeliest chest CT" in first
        workstation.pictures("pacs-series", SIZES)
        rows.first.get_by_role("button").click()
        workstation.wait_for("window.__carina.state.session?.case != null")
        assert page.get_by_test_id("pacs").count() == 0
        assert workstation.state("session.case.series.description") == "Thorax 1.2 lung"
        # The names of the search have left the page.
        assert page.evaluate("JSON.stringify(window.__carina.state.pacs)").count("Muster") == 0
        workstation.pictures("pacs-opened", SIZES)

        # The plan of a nodule is sent to the PACS where the window exports it.
        workstation.wait_ready()
        truth = cached_phantom(seed=4, spacing_mm=SPACING_MM, generations=5, nodule=True)
        place = truth.volume.to_ijk(np.array(truth.truth["nodule"]["centre_lps"])) * SPACING_MM
        page.get_by_role("button", name="Target", exact=True).first.click()
        field = page.locator("[data-testid=coordinates] input")
        field.fill(", ".join(f"{v:.3f}" for v in place))
        field.press("Enter")
        grow = page.get_by_role("button", name="Segment as nodule")
        lesion = page.get_by_test_id("lesion")
        grow.or_(lesion).first.wait_for()
        if grow.count():
            grow.click()
        lesion.wait_for()
        workstation.wait_while_working("window.__carina.state.plans?.targets?.some((plan) => plan.routes.length > 0)")
        page.get_by_test_id("take-route").first.click()
        page.get_by_role("button", name="Route", exact=True).first.click()
        page.get_by_test_id("archive").locator("summary").click()
        before = orthanc.num_instances()
        page.get_by_test_id("send-plan").click()
        workstation.wait_while_working("window.__carina.state.pacs.sent !== null")
        sent = page.get_by_test_id("sent-to-pacs")
        assert sent.inner_text() == "3 files stored in hospital."
        assert orthanc.num_instances() == before + 3
        sent.scroll_into_view_if_needed()
        workstation.pictures("pacs-sent", SIZES)
        assert workstation.faults == []


def test_page_on_another_machine_shows_no_control_of_the_pacs(server, workstation):
    page = workstation.page

    def as_other_machine(route):
        upstream = route.connect_to_server()
        upstream.on_message(
            lambda data: route.send(
                data.replace('"at_machine":true', '"at_machine":false') if isinstance(data, str) else data
            )
        )

    page.route_web_socket("**/ws*", as_other_machine)
    workstation.open(server)
    workstation.wait_for("window.__carina.state.start !== null")
    page.get_by_role("button", name="Choose folder").wait_for()
    assert workstation.state("atMachine") is False
    assert page.get_by_test_id("open-pacs").count() == 0
    workstation.pictures("pacs-other-machine", SIZES)
    assert workstation.faults == []
