"""Tests of nodules inserted into a CT: volume, blending, refused positions, and the permanent note of all results."""

from __future__ import annotations

import html
import json
from dataclasses import replace

import numpy as np
import pytest

import carina
from carina.cli.insert import report
from carina.errors import CarinaError, UsageError
from carina.plan.cubic_box import smoothed
from carina.plan.reasons import reasons_against
from carina.plan.report import make_sheet, write_report
from carina.render import AirwayView, Renderer, read_png_badges
from carina.scopes import Pose
from carina.training import free_nodule_position, insert_nodule
from carina.training.ct_texture import CtTexture, _covariance, edge_shares, measured_texture
from carina.training.insert_nodule import voxel_shares
from carina.training.nodule_shape import NoduleShape
from carina.volume import Volume, badges_of, write_grid
from carina.volume.inserted_structures import INSERTED, file_mark, inserted_note, marked_structures, with_inserted

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def place(chest):
    return free_nodule_position(chest.volume, chest.airways, diameter_mm=10.0, seed=3)


@pytest.fixture(scope="module")
def made(chest, place):
    return insert_nodule(chest.volume, chest.airways, place, diameter_mm=10.0, seed=3)


def refusal(chest, centre, **options):
    with pytest.raises(CarinaError) as refused:
        insert_nodule(chest.volume, chest.airways, centre, **options)
    return refused.value


@pytest.mark.parametrize("spiculation", [0.0, 0.4, 1.0])
@pytest.mark.parametrize("diameter_mm", [4.0, 9.0, 20.0])
def test_shares_of_voxels_sum_to_the_volume_of_the_nodule(chest, made, diameter_mm, spiculation):
    shape = NoduleShape.of_volume(diameter_mm, spiculation, 5)
    _, share = voxel_shares(chest.volume, chest.volume.centre_lps, shape, made.texture)
    voxel_mm3 = abs(np.linalg.det(chest.volume.lps_from_ijk[:3, :3]))
    # The requirement is 5 %; cells of 0.3 mm cause an error of 1.5 % in a nodule of 4 mm.
    assert share.sum() * voxel_mm3 == pytest.approx(np.pi / 6.0 * diameter_mm**3, rel=0.03)
    assert share.min() > -0.2
    assert share.max() < 1.2


@pytest.mark.parametrize("kind", ["solid", "part-solid", "ground-glass"])
def test_inserted_density_has_the_wanted_volume(chest, place, kind):
    found = insert_nodule(chest.volume, chest.airways, place, kind=kind, diameter_mm=10.0, seed=3)
    change = found.volume.hu_zyx.astype(float) - chest.volume.hu_zyx
    total = change.sum() * abs(np.linalg.det(chest.volume.lps_from_ijk[:3, :3]))
    wanted = found.volume_mm3 * (found.density_hu - found.lung_hu)
    if kind == "part-solid":
        core_mm3 = np.pi / 6.0 * found.core_diameter_mm**3
        wanted = found.volume_mm3 * (-600.0 - found.lung_hu) + core_mm3 * (found.density_hu + 600.0)
    assert total == pytest.approx(wanted, rel=0.05)


def test_insertion_depends_on_its_arguments_alone_and_changes_only_the_surroundings(chest, place, made):
    before = chest.volume.hu_zyx.copy()
    again = insert_nodule(chest.volume, chest.airways, place, diameter_mm=10.0, seed=3)
    assert np.array_equal(again.volume.hu_zyx, made.volume.hu_zyx)
    assert np.array_equal(chest.volume.hu_zyx, before)
    other = insert_nodule(chest.volume, chest.airways, place, diameter_mm=10.0, seed=4)
    assert not np.array_equal(other.volume.hu_zyx, made.volume.hu_zyx)
    changed = np.argwhere(made.volume.hu_zyx != before)[:, ::-1]
    away_mm = np.linalg.norm(chest.volume.to_lps(changed.astype(float)) - place, axis=1)
    assert away_mm.max() < 5.0 * np.sqrt(3.0) + 6.0


def test_noise_inside_a_solid_nodule_is_that_of_the_soft_tissue(chest, place):
    found = insert_nodule(chest.volume, chest.airways, place, diameter_mm=10.0, seed=3)
    shape = NoduleShape.of_volume(10.0, 0.0, 3)
    part, share = voxel_shares(chest.volume, place, shape, found.texture)
    inside = share > 0.98
    noise = found.volume.hu_zyx[part][inside].astype(float)
    # The phantom has noise of 25 HU. About 100 voxels, correlated in the slice, determine it within a fifth.
    assert noise.std() == pytest.approx(25.0, rel=0.25)
    assert found.texture.noise_hu == pytest.approx(25.0, rel=0.15)


def test_measured_blur_is_that_of_a_blurred_edge():
    rng = np.random.default_rng(7)
    z, y, x = np.indices((60, 60, 60)).astype(float)
    block = np.full((60, 60, 60), -850.0)
    for at, sigma, spacing in ((x, 0.9, 0.7), (y, 0.9, 0.7), (z, 1.3, 1.25)):
        block = np.maximum(block, -850.0 + 890.0 * edge_shares(np.abs(at - 29.5) * spacing - 12.0, sigma, 0.0))
    block += rng.normal(0.0, 15.0, block.shape)
    texture = measured_texture(block.astype(np.int16), (0.7, 0.7, 1.25))
    assert texture.sigma_mm == pytest.approx((0.9, 0.9, 1.3), abs=0.12)
    assert texture.gain == 0.0
    assert texture.noise_hu == pytest.approx(15.0, rel=0.1)
    # White noise has no covariance between voxels.
    middle = [n // 2 for n in texture.covariance_zyx.shape]
    rest = texture.covariance_zyx.copy()
    rest[tuple(middle)] = 0.0
    assert np.abs(rest).max() < 0.05 * texture.noise_hu**2


def test_axis_with_edges_widened_by_motion_does_not_widen_the_blur_in_the_slice():
    rng = np.random.default_rng(7)
    z, y, x = np.indices((48, 60, 60)).astype(float)
    block = np.full((48, 60, 60), -850.0)
    for at, middle, sigma, spacing in ((x, 29.5, 0.7, 0.7), (y, 29.5, 1.3, 0.7), (z, 23.5, 1.3, 1.25)):
        block = np.maximum(block, -850.0 + 890.0 * edge_shares(np.abs(at - middle) * spacing - 12.0, sigma, 0.0))
    block += rng.normal(0.0, 15.0, block.shape)
    texture = measured_texture(block.astype(np.int16), (0.7, 0.7, 1.25))
    assert texture.sigma_mm[:2] == pytest.approx((0.7, 0.7), abs=0.08)


def ball_of_lung(sigma_mm, spacing_mm, noise):
    """Return a ball of lung in soft tissue, blurred along the axes of the voxels, with noise (nz, ny, nx)."""
    offsets = np.indices(noise.shape, dtype=float)[::-1].T.swapaxes(0, 2) - (np.array(noise.shape[::-1]) - 1) / 2
    offsets = offsets * spacing_mm
    away = np.linalg.norm(offsets, axis=-1)
    normal = offsets / np.maximum(away, 1e-9)[..., None]
    across = np.sqrt(np.square(normal * sigma_mm).sum(axis=-1))
    return (-850.0 + 890.0 * edge_shares((away - 30.0) / across, 1.0, 0.0) + noise).astype(np.int16)


def test_oblique_edges_in_thick_slices_do_not_widen_the_blur_in_the_slice():
    noise = np.random.default_rng(3).normal(0.0, 12.0, (32, 140, 140))
    texture = measured_texture(ball_of_lung((0.65, 0.65, 1.6), (0.65, 0.65, 3.0), noise), (0.65, 0.65, 3.0))
    assert texture.sigma_mm[:2] == pytest.approx((0.65, 0.65), abs=0.05)
    assert texture.sigma_mm[2] == pytest.approx(1.6, abs=0.25)


# The first blur is much narrower than a voxel, so that the position of an edge between voxels is inexact.
@pytest.mark.parametrize(
    ("sigma_mm", "spacing_mm", "num"), [(0.3, 0.9, 90), (1.0, 1.2, 76), (1.2, 2.0, 48), (1.3, 2.5, 44)]
)
def test_blur_of_large_voxels_is_measured_at_curved_boundaries(sigma_mm, spacing_mm, num):
    noise = np.random.default_rng(3).normal(0.0, 12.0, (num, num, num))
    texture = measured_texture(ball_of_lung((sigma_mm,) * 3, (spacing_mm,) * 3, noise), (spacing_mm,) * 3)
    assert texture.sigma_mm == pytest.approx((sigma_mm,) * 3, rel=0.07)
    assert min(texture.num_edges) > 0


def correlated_noise(shape, seed):
    """Return noise of 20 HU with a fine and a coarse part, other along x than along y, weakly correlated along z."""
    rng = np.random.default_rng(seed)
    parts = []
    for sigmas in ((0.4, 0.7, 1.1), (0.6, 2.2, 2.2)):
        part = smoothed(rng.standard_normal(shape).astype(np.float32), sigmas)
        parts.append(part / part.std())
    return 20.0 * (0.8 * parts[0] + 0.6 * parts[1])


def covariances(noise, lags):
    """Return the covariances of noise (nz, ny, nx) at lags (z, y, x)."""
    nz, ny, nx = noise.shape
    return [float((noise[: nz - k, : ny - j, : nx - i] * noise[k:, j:, i:]).mean()) for k, j, i in lags]


@pytest.mark.parametrize("num_slices", [3, 24])
def test_covariance_is_measured_for_every_number_of_slices(num_slices):
    """A CT may have fewer slices than the largest distance between two voxels, 5 slices here."""
    noise = np.random.default_rng(6).normal(0.0, 20.0, (num_slices, 60, 60))
    # Soft tissue with a strip of lung, near which the noise is measured.
    values = (40.0 + noise).astype(np.float32)
    values[:, :, :6] = -850.0
    covariance, num = _covariance(values, (1.1, 1.1, 1.1))
    assert covariance.shape == (11, 11, 11)
    assert num > 1500
    assert np.sqrt(covariance.max()) == pytest.approx(20.0, rel=0.1)
    assert covariance.max() == covariance[5, 5, 5]


def test_strands_in_soft_tissue_do_not_make_the_noise_much_stronger_and_finer():
    noise = np.random.default_rng(9).normal(0.0, 15.0, (24, 60, 80))
    values = (40.0 + noise).astype(np.float32)
    # Strands one voxel thick alone would give the differences of second order 38 % more.
    values[:, :, 10::20] -= 90.0
    values[:, :, :6] = -850.0
    covariance, _ = _covariance(values, (1.1, 1.1, 1.1))
    z, y, x = (n // 2 for n in covariance.shape)
    bends = sum(6.0 * covariance[z, y, x] - 8.0 * covariance[one] + 2.0 * covariance[two] for one, two in
                (((z, y, x + 1), (z, y, x + 2)), ((z, y + 1, x), (z, y + 2, x))))  # fmt: skip
    assert np.sqrt(bends / 12.0) == pytest.approx(15.0, rel=0.2)


def test_seams_of_fat_do_not_correlate_the_noise_of_neighbouring_slices():
    noise = np.random.default_rng(9).normal(0.0, 15.0, (24, 60, 80))
    values = (40.0 + noise).astype(np.float32)
    # By products of all pairs, seams one voxel thick along x and z would correlate neighbouring slices by .3.
    values[:, 10::25] -= 60.0
    values[:, :, :6] = -850.0
    covariance, _ = _covariance(values, (1.1, 1.1, 1.1))
    z, y, x = (n // 2 for n in covariance.shape)
    assert abs(covariance[z + 1, y, x]) < 0.12 * covariance[z, y, x]
    assert np.sqrt(covariance[z, y, x]) == pytest.approx(15.0, rel=0.2)


def test_negative_power_of_an_estimated_covariance_does_not_make_the_noise_finer():
    rng = np.random.default_rng(4)
    z, y, x = np.indices((7, 15, 15)) - np.array([3, 7, 7])[:, None, None, None]
    exact = 400.0 * np.exp(-0.5 * (z**2 / 0.6**2 + (y**2 + x**2) / 1.5**2))
    errors = rng.normal(0.0, 2.0, exact.shape)
    covariance = exact + 0.5 * (errors + errors[::-1, ::-1, ::-1]) * (exact < 399.0)
    texture = CtTexture((0.6, 0.6, 0.9), 0.0, 20.0, covariance, (99, 99, 99), 9999)
    noise = texture.noise((24, 64, 64), 1)
    assert noise.std() == pytest.approx(20.0, rel=0.05)
    bends = noise[:, :, 2:] - 2.0 * noise[:, :, 1:-1] + noise[:, :, :-2]
    # Without the negative power, the other power scaled to the variance gives 26 % more.
    assert bends.std() < 1.2 * np.sqrt(6.0 * 400.0 - 8.0 * exact[3, 7, 8] + 2.0 * exact[3, 7, 9])


LAGS = ((0, 0, 0), (0, 0, 1), (0, 0, 2), (0, 0, 4), (0, 1, 0), (0, 2, 0), (0, 4, 0), (1, 0, 0), (1, 1, 1))


def test_measured_noise_has_the_covariance_of_the_ct_at_all_distances():
    noise = correlated_noise((32, 140, 140), 4)
    texture = measured_texture(ball_of_lung((0.65, 0.65, 1.6), (0.65, 0.65, 3.0), noise), (0.65, 0.65, 3.0))
    z, y, x = (n // 2 for n in texture.covariance_zyx.shape)
    found = [texture.covariance_zyx[z + k, y + j, x + i] for k, j, i in LAGS]
    assert found == pytest.approx(covariances(noise, LAGS), abs=0.06 * 400.0)


def test_synthetic_noise_has_the_measured_covariance_at_all_distances():
    noise = correlated_noise((32, 140, 140), 5)
    texture = measured_texture(ball_of_lung((0.65, 0.65, 1.6), (0.65, 0.65, 3.0), noise), (0.65, 0.65, 3.0))
    again = texture.noise((32, 140, 140), 1)
    assert covariances(again, LAGS) == pytest.approx(covariances(noise, LAGS), abs=0.06 * 400.0)
    # The low frequencies, which differences of neighbours do not show, are those of blocks of 4 x 4 voxels.
    blocks = [one.reshape(32, 35, 4, 35, 4).mean(axis=(2, 4)).std() for one in (noise, again)]
    assert blocks[1] == pytest.approx(blocks[0], rel=0.06)


def test_positions_outside_the_free_lung_are_refused_with_a_reason(chest):
    tree = chest.tree
    trachea = tree.root.points[len(tree.root.points) // 2]
    segment = tree.named("RB3")
    beside = segment.points[len(segment.points) // 2]
    across = np.cross(segment.points[-1] - segment.points[0], (0.0, 0.0, 1.0))
    across /= np.linalg.norm(across)
    radius = float(np.median(segment.radius))
    found = {
        "in-airway": refusal(chest, trachea),
        "airway-wall": refusal(chest, beside + (2.0 + radius + 0.5) * across, diameter_mm=4.0),
        "outside-ct": refusal(chest, chest.volume.to_lps(np.array([3.0, 3.0, 3.0]))),
        "outside-lung": refusal(chest, trachea + np.array([0.0, 60.0, 0.0])),
    }
    assert {name: error.code for name, error in found.items()} == {name: f"insert.{name}" for name in found}
    assert all("choose another position" in str(error) for error in found.values())


def test_position_at_the_chest_wall_is_refused(chest, place):
    way = np.array([np.sign(place[0]), 0.0, 0.0])
    codes = [
        refused.code
        for step in np.arange(0.0, 120.0, 2.0)
        if (refused := _refusal_or_none(chest, place + step * way)) is not None
    ]
    assert "insert.wall" in codes
    assert codes[-1] in {"insert.outside-lung", "insert.outside-ct"}


def _refusal_or_none(chest, centre):
    from carina.training.insert_nodule import _check_place

    try:
        _check_place(chest.volume, chest.airways, centre, NoduleShape.of_volume(8.0, 0.0, 0), through_vessels=True)
    except UsageError as error:
        return error
    return None


def test_vessel_is_replaced_only_on_request(chest):
    rng = np.random.default_rng(2)
    bright = np.argwhere(chest.volume.hu_zyx > -100)
    for number in rng.permutation(len(bright))[:20_000]:
        k, j, i = bright[int(number)]
        block = chest.volume.hu_zyx[max(k - 6, 0) : k + 7, max(j - 6, 0) : j + 7, max(i - 6, 0) : i + 7]
        # A thin bright line in lung is a vessel.
        if float((block > -500).mean()) > 0.12:
            continue
        centre = chest.volume.to_lps(np.array([i, j, k], dtype=float))
        try:
            found = insert_nodule(chest.volume, chest.airways, centre, diameter_mm=8.0, through_vessels=True)
        except UsageError:
            continue
        assert found.replaces_vessels
        error = refusal(chest, centre, diameter_mm=8.0)
        assert error.code == "insert.vessel"
        assert "through_vessels" in str(error)
        return
    pytest.fail("no thin vessel in the lung")


def test_inserted_nodule_is_refused_in_a_volume_without_hu_and_with_an_invalid_core_diameter(chest, place):
    volume = Volume(chest.volume.hu_zyx, chest.volume.lps_from_ijk, is_hu=False, not_hu_reason="test")
    with pytest.raises(UsageError) as refused:
        insert_nodule(volume, chest.airways, place)
    assert refused.value.code == "insert.not-hu"
    assert refusal(chest, place, core_diameter_mm=4.0).code == "insert.core"
    assert refusal(chest, place, kind="part-solid", core_diameter_mm=10.0).code == "insert.core"


def test_two_insertions_have_one_note_that_names_both(chest, made):
    other = free_nodule_position(made.volume, chest.airways, diameter_mm=6.0, seed=8)
    both = insert_nodule(made.volume, chest.airways, other, kind="ground-glass", diameter_mm=6.0)
    (note,) = [one for one in badges_of(both.volume) if one.code == INSERTED]
    assert note.words.startswith("inserted: 2 nodules were inserted")
    assert "solid nodule, 10.0 mm" in note.words
    assert "ground-glass nodule, 6.0 mm" in note.words
    assert both.volume.source.title.count("Inserted nodule") == 1


@pytest.mark.parametrize("suffix", [".nii.gz", ".nii", ".nrrd", ".mha"])
def test_saved_ct_opens_with_the_note_and_the_title(tmp_path, made, suffix):
    path = tmp_path / f"ct{suffix}"
    small = made.volume.hu_zyx[::4, ::4, ::4].copy()
    matrix = made.volume.lps_from_ijk @ np.diag([4.0, 4.0, 4.0, 1.0])
    write_grid(path, small, matrix, what="the CT", note=file_mark(made.volume.source))
    opened = carina.open_volume(path, progress=False)
    assert opened.source.inserted == made.volume.source.inserted
    assert opened.source.title.startswith("Inserted nodule: ct")
    assert [note.code for note in badges_of(opened) if note.code == INSERTED] == [INSERTED]


def test_truncated_mark_of_inserted_nodules_still_gives_their_number(chest):
    texts = [f"solid nodule, {n}.0 mm, at -41.0 12.0 -180.{n}" for n in range(5, 9)]
    mark = file_mark(with_inserted(replace(chest.volume.source), texts))
    found = marked_structures(mark.encode()[:79] + b"\0")
    assert len(found) == 4
    assert found[0] == texts[0]
    assert inserted_note(found).words.startswith("inserted: 4 nodules were")
    assert marked_structures(b"an ordinary header") == ()


def test_mark_of_more_nodules_than_the_limit_is_read_up_to_the_limit(chest):
    texts = ["solid nodule, 8.0 mm, at -41.0 12.0 -180.0"] * 1500
    mark = file_mark(with_inserted(chest.volume.source, texts))
    assert len(marked_structures(mark.encode())) == 999


def test_picture_of_the_ct_shows_and_contains_that_a_nodule_was_inserted(tmp_path, chest, made):
    root = chest.tree.root.points
    view = AirwayView(Pose.looking(root[5], root[9] - root[5]), width=320, height=320)
    picture = Renderer(made.volume).render(view)
    picture.save(tmp_path / "marked.png", badges=badges_of(made.volume))
    picture.save(tmp_path / "plain.png")
    assert read_png_badges(tmp_path / "marked.png")[0].code == INSERTED
    assert len((tmp_path / "marked.png").read_bytes()) != len((tmp_path / "plain.png").read_bytes())


def beyond_a_tip(chest):
    """Return a CT with a nodule near the end of an airway."""
    for tip in chest.tree.tips():
        way = tip.points[-1] - tip.points[-3]
        try:
            return insert_nodule(
                chest.volume,
                chest.airways,
                tip.points[-1] + 8.0 * way / np.linalg.norm(way),
                diameter_mm=10.0,
                through_vessels=True,
            )
        except UsageError:
            continue
    pytest.fail("no free place beyond the tips")


def test_plan_report_and_sheet_state_that_the_nodule_was_inserted(tmp_path, chest):
    made = beyond_a_tip(chest)
    plan = carina.plan_route(
        made.volume, chest.airways, np.array(made.centre_lps), wall=chest.wall, drives=0, confirmed=True, progress=False
    )
    assert any(note.startswith("inserted:") for note in plan.notes)
    (reason,) = [one for one in reasons_against(plan) if one.words.startswith("Inserted:")]
    assert reason.severity == "stop"
    sheet = make_sheet(made.volume, chest.airways, plan, progress=False)
    for kind in ("report", "tracing"):
        page = html.unescape(write_report(tmp_path / f"{kind}.html", sheet, kind=kind).read_text())
        assert "Inserted: a nodule was inserted" in page
    stored = json.loads(write_report(tmp_path / "plan.json", sheet).read_text())
    assert "inserted: a nodule was inserted" in json.dumps(stored).lower()


def test_insert_nodule_command_writes_the_marked_ct_and_the_ground_truth(tmp_path, chest, capsys):
    scan, output, truth = (tmp_path / name for name in ("ct.nii", "training.nii.gz", "truth.json"))
    write_grid(scan, chest.volume.hu_zyx, chest.volume.lps_from_ijk, what="the CT")
    code = report(
        scan, output=output, at_lps=None, kind="part-solid", diameter_mm=12.0, core_mm=None, density_hu=None,
        spiculation=0.5, seed=1, through_vessels=False, truth=truth, series=None, strict=False, ct=None, as_json=True,
    )  # fmt: skip
    assert code == 0
    printed = json.loads(capsys.readouterr().out)
    assert printed["badges"][0]["code"] == INSERTED
    stored = json.loads(truth.read_text())
    assert (stored["kind"], stored["core_diameter_mm"]) == ("part-solid", 6.0)
    opened = carina.open_volume(output, progress=False)
    assert opened.source.inserted == tuple(stored["inserted"])
    with pytest.raises(UsageError, match="the scan itself"):
        report(
            scan, output=scan, at_lps=None, kind="solid", diameter_mm=12.0, core_mm=None, density_hu=None,
            spiculation=0.0, seed=1, through_vessels=False, truth=None, series=None, strict=False, ct=None,
            as_json=True,
        )  # fmt: skip
