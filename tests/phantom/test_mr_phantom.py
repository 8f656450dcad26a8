"""The MR picture of the phantom: signal by tissue, bias field, noise, ground truth, and tracking in it."""

import json

import numpy as np
import pytest
from click.testing import Result
from typer.testing import CliRunner

import carina
from carina.errors import CancelledError, UsageError
from carina.phantom import generate_phantom
from carina.phantom.mr_picture import SOFT_VALUE, _signal, generate_mr_phantom
from carina.track.targets.paper_tracker import track_on_graph


@pytest.fixture(scope="module")
def picture():
    return generate_mr_phantom(seed=2, spacing_mm=2.0, generations=5, progress=False)


@pytest.fixture(scope="module")
def clean():
    return generate_mr_phantom(seed=2, spacing_mm=3.0, generations=3, bias=0.0, snr=1000.0, progress=False)


def chest(picture, **options):
    """Return the CT of a picture's chest on the grid of the picture."""
    return generate_phantom(noise_hu=0.0, spacing_mm=[float(v) for v in picture.volume.spacing_mm], **options)


def test_signal_of_soft_tissue_air_lung_and_fat_follows_their_protons(clean):
    ct = chest(clean, seed=2, generations=3)
    shape = np.minimum(ct.volume.shape_zyx, clean.volume.shape_zyx)
    assert np.abs(np.array(ct.volume.shape_zyx) - clean.volume.shape_zyx).max() <= 1
    # Equal indices are at nearly equal positions in both volumes, because their grids differ by less than a voxel.
    assert np.allclose(ct.volume.lps_from_ijk[:3, 3], clean.volume.lps_from_ijk[:3, 3], atol=3.0)
    hu = ct.volume.hu_zyx[: shape[0], : shape[1], : shape[2]]
    value = clean.volume.hu_zyx[: shape[0], : shape[1], : shape[2]]
    soft = np.median(value[(hu > 30) & (hu < 60)])
    assert soft == pytest.approx(SOFT_VALUE, rel=0.06)
    assert np.median(value[hu < -990]) <= 2
    lung = np.median(value[(hu > -880) & (hu < -820)])
    # Water of lung at -850 HU is 15 % of that of tissue, and its signal decays faster and recovers more slowly.
    assert 0.08 * SOFT_VALUE < lung < 0.15 * SOFT_VALUE
    assert np.median(value[(hu > -110) & (hu < -90)]) > 1.4 * soft


def test_edge_between_tissue_and_lung_has_no_bright_rim_of_fat():
    edge = np.repeat(np.array([40, 40, -100, -500, -850, -850], dtype=np.int16), 2)
    profile = _signal(np.broadcast_to(edge, (12, 12, len(edge))))[6, 6]
    assert (np.diff(profile) <= 1e-6).all()
    fat = _signal(np.full((5, 5, 5), -100, dtype=np.int16))
    assert fat[2, 2, 2] > 1.4


def test_lumen_of_the_picture_lies_where_that_of_the_ct_lies(picture):
    fine = chest(picture, seed=2, generations=5)

    def middle(made) -> np.ndarray:
        """Return the centroid, LPS mm, of the lumen below the carina."""
        k, j, i = np.nonzero(made.lumen_zyx)
        points = made.volume.to_lps(np.stack([i, j, k], axis=1).astype(float))
        return points[points[:, 2] < -10.0].mean(axis=0)

    assert np.abs(middle(picture) - middle(fine)).max() < 0.3


def test_bias_field_changes_the_sensitivity_within_its_limit(clean):
    biased = generate_mr_phantom(seed=2, spacing_mm=3.0, generations=3, bias=0.4, snr=1000.0, progress=False)
    inside = clean.volume.hu_zyx > SOFT_VALUE / 2
    ratio = biased.volume.hu_zyx[inside] / clean.volume.hu_zyx[inside]
    assert 0.59 < ratio.min() < 0.85
    assert 1.15 < ratio.max() < 1.41


def test_air_has_the_noise_of_a_magnitude_picture(picture):
    values = picture.volume.hu_zyx.astype(float)
    corner = values[2:-2, 2:12, 2:12]
    sigma = SOFT_VALUE / 20.0
    # Rayleigh's distribution: mean 1.253 sigma, standard deviation .655 sigma.
    assert corner.mean() == pytest.approx(1.253 * sigma, rel=0.05)
    assert corner.std() == pytest.approx(0.655 * sigma, rel=0.08)


def test_ground_truth_is_that_of_the_ct_and_agrees_with_the_mr_picture(picture):
    ct = generate_phantom(seed=2, spacing_mm=4.0, generations=5, noise_hu=0.0)
    assert picture.truth["branches"] == ct.truth["branches"]
    trachea = np.array(picture.truth["branches"][0]["points"])
    ijk = np.rint(picture.volume.to_ijk(trachea[1:])).astype(int)
    assert picture.lumen_zyx[ijk[:, 2], ijk[:, 1], ijk[:, 0]].all()
    assert picture.volume.hu_zyx[picture.lumen_zyx > 0].mean() < 0.25 * SOFT_VALUE
    assert not picture.volume.is_hu
    assert "synthetic" in picture.volume.source.title


def test_same_seed_gives_the_same_picture():
    again = [generate_mr_phantom(seed=5, spacing_mm=5.0, generations=3, progress=False) for _ in range(2)]
    assert np.array_equal(again[0].volume.hu_zyx, again[1].volume.hu_zyx)
    other = generate_mr_phantom(seed=6, spacing_mm=5.0, generations=3, progress=False)
    assert not np.array_equal(again[0].volume.hu_zyx, other.volume.hu_zyx)


def test_path_of_the_paper_stays_in_the_true_lumen(picture):
    branches = {b["name"]: np.array(b["points"]) for b in picture.truth["branches"] if b["name"]}
    trachea = branches["Trachea"]
    targets = [branches[name][3] for name in ("RB6", "LB8")]
    found = track_on_graph(
        picture.volume, None, targets, cost="walls", graph="voxel", root_lps=trachea[len(trachea) // 2]
    )
    for one in found.targets:
        assert one.path is not None
        i, j, k = np.rint(picture.volume.to_ijk(one.path.points_lps)).astype(int).T
        assert picture.lumen_zyx[k, j, i].mean() > 0.97


def test_airways_are_found_and_named_in_the_picture(picture):
    found = carina.find_airways(picture.volume, progress=False)
    names = {branch.name for branch in found.tree.branches}
    assert {"Trachea", "RMB", "LMB", "RUL", "LUL", "LLL", "RB6", "LB6"} <= names


def test_invalid_options_and_a_cancelled_generation_raise_an_error():
    with pytest.raises(UsageError, match="spacing_mm"):
        generate_mr_phantom(spacing_mm=0.1)
    with pytest.raises(UsageError, match="snr"):
        generate_mr_phantom(snr=0.0)
    with pytest.raises(CancelledError):
        generate_mr_phantom(spacing_mm=5.0, generations=3, cancel=lambda: True)


def test_command_writes_the_picture(tmp_path):
    from carina.cli.app import app

    def run(*options: str) -> Result:
        return CliRunner().invoke(app, ["phantom", "-o", str(tmp_path / "mr"), "--mr", *options])

    done = run("--spacing-mm", "4", "--generations", "3", "--json")
    assert done.exit_code == 0
    assert json.loads(done.stdout)["spacing_mm"] == [4.0, 4.0, 4.0]
    opened = carina.open_volume(tmp_path / "mr" / "mr.nii.gz", progress=False)
    assert not opened.is_hu
    refused = run("--nodule")
    assert refused.exit_code == 2
    assert "--mr: expected a chest without --nodule" in refused.stderr
