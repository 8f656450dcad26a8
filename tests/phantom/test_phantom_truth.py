"""Tests that the ground truth of the phantom agrees with its voxels."""

import json
from pathlib import Path

import numpy as np
import pytest
import SimpleITK

from carina.errors import CancelledError, UsageError
from carina.phantom import Phantom, generate_phantom, write_phantom

SPACING = (0.8, 0.9, 1.1)
CENTRAL = ((-60.0, -45.0, -98.0), (70.0, 50.0, 40.0))


def some_of(num: int) -> list[object]:
    """Return the first ``num`` seeds as test parameters: ``make test`` uses three of them, ``make soak`` all."""
    return [*range(3), *(pytest.param(seed, marks=pytest.mark.soak) for seed in range(3, num))]


@pytest.fixture(scope="module")
def chest() -> Phantom:
    """Return a whole chest with coarse anisotropic voxels."""
    return generate_phantom(seed=3, spacing_mm=(1.6, 1.8, 2.0), nodule=True)


@pytest.fixture(scope="module")
def central() -> Phantom:
    """Return the central airways with fine voxels and wall distances, without noise."""
    return generate_phantom(seed=3, spacing_mm=SPACING, noise_hu=0.0, box_lps=CENTRAL, with_distance=True)


def branches_of(made: Phantom) -> dict[str, dict]:
    return {b["name"]: b for b in made.truth["branches"] if b["name"]}


def at(values: np.ndarray, made: Phantom, points_lps: np.ndarray) -> np.ndarray:
    """Return the values of the voxels nearest to points (LPS mm), without points outside the grid."""
    ijk = np.floor(made.volume.to_ijk(np.asarray(points_lps)) + 0.5).astype(int)
    shape = np.array(values.shape[::-1])
    inside = np.all((ijk >= 0) & (ijk < shape), axis=1)
    i, j, k = ijk[inside].T
    return values[k, j, i]


def section_radius(made: Phantom, branch: dict, n: int) -> float:
    """Return the radius (mm) of the circle with the area of the lumen's section at the nth point of a branch."""
    points = np.array(branch["points"])
    tangent = points[n + 1] - points[n - 1]
    tangent /= np.linalg.norm(tangent)
    across = np.cross(tangent, [0.3, 0.9, 0.1])
    across /= np.linalg.norm(across)
    up = np.cross(tangent, across)
    # Sample points in the plane of the section.
    step = 0.1
    reach = 1.8 * branch["radius"][n]
    s = np.arange(-reach, reach, step)
    plane = points[n] + s[:, None, None] * across + s[None, :, None] * up
    area = at(made.lumen_zyx, made, plane.reshape(-1, 3)).sum() * step * step
    return float(np.sqrt(area / np.pi))


# Tree of the ground truth


@pytest.mark.parametrize("seed", range(6))
def test_phantom_tree_has_all_segments_and_the_requested_generation(seed: int) -> None:
    made = generate_phantom(seed=seed, spacing_mm=8.0, generations=6)
    branches = made.truth["branches"]
    assert [b["id"] for b in branches] == list(range(len(branches)))
    names = branches_of(made)
    segments = {f"RB{n}" for n in range(1, 11)} | {"LB1+2", "LB3", "LB4", "LB5", "LB6", "LB8", "LB9", "LB10"}
    assert segments <= set(names)
    assert len([b for b in branches if b["generation"] >= 6]) >= 40
    for b in branches:
        assert len(b["points"]) == len(b["radius"]) >= 4
        assert min(b["radius"]) > 0.4
        for child in b["children"]:
            assert branches[child]["parent"] == b["id"]
            assert branches[child]["generation"] == b["generation"] + 1
            assert branches[child]["points"][0] == b["points"][-1], "a child starts where its parent ends, bit for bit"
            # Diameters vary by 5 %, and a common stem is hardly wider than the wider one of its branches.
            assert branches[child]["radius"][0] < 1.05 * b["radius"][0]
    assert sum(len(b["children"]) for b in branches) == len(branches) - 1


def test_right_bronchi_of_the_phantom_are_on_the_right_and_upper_lobes_above_lower_lobes(chest: Phantom) -> None:
    names = branches_of(chest)
    for name, branch in names.items():
        x = np.array(branch["points"])[-1, 0]
        if name.startswith("R"):
            assert x < 0, f"{name}: the patient's right is -x in LPS"
        elif name.startswith("L"):
            assert x > 0, name
    tip = {name: np.array(b["points"][-1]) for name, b in names.items()}
    assert tip["RB1"][2] > tip["RB4"][2] > tip["RB10"][2]
    assert tip["RB2"][1] > tip["RB3"][1], "posterior is +y"
    assert tip["RB6"][1] > tip["RB8"][1]
    assert tip["LB6"][1] > tip["LB8"][1]
    assert tip["LB1+2"][2] > tip["LB10"][2]


def test_phantom_with_more_generations_contains_the_branches_of_one_with_fewer() -> None:
    few = generate_phantom(seed=1, spacing_mm=8.0, generations=4).truth["branches"]
    more = generate_phantom(seed=1, spacing_mm=8.0, generations=8).truth["branches"]
    assert max(b["generation"] for b in more) == 8
    by_name = {b["name"]: b for b in more if b["name"]}
    assert all(by_name[b["name"]]["points"] == b["points"] for b in few if b["name"])


@pytest.mark.parametrize("seed", some_of(6))
def test_phantom_branches_that_share_no_fork_do_not_touch(seed: int) -> None:
    branches = generate_phantom(seed=seed, spacing_mm=8.0, generations=7).truth["branches"]
    kin = {(b["id"], other) for b in branches for other in [b["parent"], *b["children"]] if other is not None}
    points = [np.array(b["points"]) for b in branches]
    for a in branches:
        for b in branches[a["id"] + 1 :]:
            # Branches of one fork, or of two forks that a short stem joins, are close to each other.
            near = {a["parent"], *a["children"], *(c for x in a["children"] for c in branches[x]["children"])}
            sibling = a["parent"] is not None and (
                a["parent"] == b["parent"] or branches[a["parent"]]["parent"] in {b["parent"], b["id"]}
            )
            uncle = b["parent"] is not None and branches[b["parent"]]["parent"] in {a["parent"], a["id"]}
            if (a["id"], b["id"]) in kin or b["id"] in near or sibling or uncle:
                continue
            apart = np.linalg.norm(points[a["id"]][:, None] - points[b["id"]][None], axis=2)
            gap = apart - np.array(a["radius"])[:, None] - np.array(b["radius"])[None]
            assert gap.min() > 0.0, f"{a['name'] or a['id']} runs into {b['name'] or b['id']} (seed {seed})"


# Voxels of the phantom


def test_every_centreline_point_of_the_phantom_is_in_the_lumen(central: Phantom, chest: Phantom) -> None:
    for made, least_radius in ((central, 1.2), (chest, 2.2)):
        # In a lumen thinner than half of a voxel's diagonal the nearest voxel centre may be outside; such points are
        # omitted.
        for b in made.truth["branches"]:
            wide = np.array(b["radius"]) > least_radius
            values = at(made.lumen_zyx, made, np.array(b["points"])[wide])
            assert values.all(), b["name"] or b["id"]


def test_lumen_of_the_phantom_trachea_is_in_the_top_slice(chest: Phantom) -> None:
    top = np.array(chest.truth["branches"][0]["points"][0])
    assert chest.volume.to_ijk(top)[2] == pytest.approx(chest.volume.shape_zyx[0] - 1, abs=1e-9)
    assert at(chest.lumen_zyx, chest, top[None]).tolist() == [1]


@pytest.mark.parametrize("name", ["Trachea", "LMB", "BI", "RB1", "LB10"])
def test_true_radius_equals_the_radius_of_the_lumen_cross_section(central: Phantom, name: str) -> None:
    branch = branches_of(central)[name]
    points = np.array(branch["points"])
    inside = [n for n, p in enumerate(points) if central.volume.contains_lps(p)]
    # The middle of the branch is away from the rounded edges of its forks.
    n = inside[len(inside) // 2]
    # The tolerance is 6 % or 0.15 mm, because voxels are 0.8 to 1.1 mm and the rounded corners of the trachea reduce
    # its area by 1 %.
    assert section_radius(central, branch, n) == pytest.approx(branch["radius"][n], rel=0.06, abs=0.15)


def test_distance_to_the_phantom_wall_is_negative_exactly_in_the_lumen_and_fits_the_radius(central: Phantom) -> None:
    distance = central.lumen_distance_mm
    assert distance is not None
    np.testing.assert_array_equal(distance < 0, central.lumen_zyx == 1)
    branch = branches_of(central)["LMB"]
    n = len(branch["points"]) // 2
    value = at(distance, central, np.array([branch["points"][n]]))[0]
    # The tolerance is half of a voxel's diagonal, because the distance is that of the nearest voxel centre.
    assert value == pytest.approx(-branch["radius"][n], abs=0.82)


def test_posterior_wall_of_the_phantom_trachea_is_flat(central: Phantom) -> None:
    points = np.array(branches_of(central)["Trachea"]["points"])
    p = points[np.argmin(abs(points[:, 2] - 25.0))]
    k = round(float(central.volume.to_ijk(p)[2]))
    rows = np.flatnonzero(central.lumen_zyx[k].any(axis=1))
    own = np.zeros_like(rows)
    i = round(float(central.volume.to_ijk(p)[0]))
    for n, j in enumerate(rows):
        row = central.lumen_zyx[k, j]
        left = i - np.argmax(row[i::-1] == 0) if row[i] else i
        right = i + np.argmax(row[i:] == 0) if row[i] else i
        own[n] = right - left
    own = own[own > 0]
    # The section is wide at the back (+y, the last rows) and narrow at the front.
    assert own[-1] > 1.5 * own[0] or own[-2] > 1.5 * own[1]


def test_tissues_of_the_phantom_have_their_hounsfield_values(central: Phantom, chest: Phantom) -> None:
    hu = central.volume.hu_zyx
    trachea = np.array(branches_of(central)["Trachea"]["points"])
    assert at(hu, central, trachea).max() <= -990
    deep = chest.volume.hu_zyx[at_index(chest, (-85.0, -20.0, -60.0))]
    # Parenchyma is -862 HU with texture and 20 HU of noise; the limits are 5 standard deviations away.
    assert -1010 < deep < -690
    assert at(hu, central, np.array([[0.0, 53.0 - 0.00085 * 80**2, 14.0]]))[0] > 100  # The point is in a vertebra.
    assert chest.volume.hu_zyx.min() >= -1024
    corner = chest.volume.hu_zyx[:4, :4, :4]
    assert abs(float(corner.mean()) + 1000) < 10


def at_index(made: Phantom, point: tuple[float, float, float]) -> tuple[int, ...]:
    i, j, k = np.floor(made.volume.to_ijk(np.array(point)) + 0.5).astype(int)
    return int(k), int(j), int(i)


def test_lungs_of_the_phantom_are_denser_posteriorly_than_anteriorly(chest: Phantom) -> None:
    # The density of a patient who lies on the back rises by 0.32 HU per mm towards the back. Medians exclude the
    # vessels.
    def median(y: float) -> float:
        k, j, i = at_index(chest, (-80.0, y, -60.0))
        return float(np.median(chest.volume.hu_zyx[k - 6 : k + 6, j - 4 : j + 4, i - 12 : i + 12]))

    assert median(40.0) - median(-50.0) == pytest.approx(0.32 * 90, abs=10)


def test_wall_of_a_segmental_bronchus_is_brighter_than_lumen_and_lung(central: Phantom) -> None:
    # The wall of a segmental bronchus in the lung is visible on all sides, with lower HU because of partial volumes.
    branch = branches_of(central)["RB10"]
    points, radius = np.array(branch["points"]), np.array(branch["radius"])
    n = len(points) // 2
    tangent = points[n + 1] - points[n - 1]
    tangent /= np.linalg.norm(tangent)
    across = np.cross(tangent, [0.0, 1.0, 0.2])
    across /= np.linalg.norm(across)
    up = np.cross(tangent, across)
    for angle in np.linspace(0, 2 * np.pi, 12, endpoint=False):
        ray = np.cos(angle) * across + np.sin(angle) * up
        rim = points[n] + np.arange(radius[n] - 0.5, radius[n] + 2.5, 0.2)[:, None] * ray
        assert at(central.volume.hu_zyx, central, rim).max() > -450


def test_thick_phantom_slice_is_the_average_over_its_thickness() -> None:
    fine = generate_phantom(seed=2, spacing_mm=(1.0, 1.0, 0.6), noise_hu=0.0, box_lps=CENTRAL)
    thick = generate_phantom(seed=2, spacing_mm=(1.0, 1.0, 3.0), noise_hu=0.0, box_lps=CENTRAL)
    # Thick slice n from the top is at fine slice 5 n; its expected values are the mean of the five slices around that
    # slice.
    top = fine.volume.hu_zyx[::-1].astype(float)
    names = branches_of(fine)
    band = thick.volume.hu_zyx[::-1]
    tips = np.array([names[n]["points"][len(names[n]["points"]) // 2] for n in ("RB2", "RB3", "LB3", "LB6")])
    checked = 0
    for tip in tips:
        i, j, k = np.floor(thick.volume.to_ijk(tip) + 0.5).astype(int)
        n = band.shape[0] - 1 - k
        if not 1 <= n < band.shape[0] - 1:
            continue
        window = np.s_[j - 6 : j + 7, i - 6 : i + 7]
        mean = top[5 * n - 2 : 5 * n + 3][(slice(None), *window)].mean(axis=0)
        # The tolerance is 60 HU in the mean, because the texture is sampled in the middle of a slice and not averaged.
        assert np.abs(mean - band[n][window]).mean() < 60
        checked += 1
    assert checked >= 3


# Stenosis and nodule


@pytest.mark.parametrize("seed", [0, 1, 2, 5])
def test_stenosis_of_the_phantom_narrows_one_bronchus_in_ground_truth_and_voxels(seed: int) -> None:
    options = {"seed": seed, "spacing_mm": 0.9, "noise_hu": 0.0, "box_lps": ((-40, -20, -60), (60, 30, 5))}
    healthy, ill = generate_phantom(**options), generate_phantom(**options, stenosis=True)
    stenosis = ill.truth["stenosis"]
    assert healthy.truth["stenosis"] is None
    assert stenosis["min_radius_mm"] < 0.5 * stenosis["reference_radius_mm"]
    branch = ill.truth["branches"][stenosis["branch_id"]]
    assert branch["name"] in {"LMB", "BI"}
    n = int(np.argmin(branch["radius"]))
    assert branch["radius"][n] == stenosis["min_radius_mm"]
    assert branch["points"][n] == list(stenosis["centre_lps"])
    before = healthy.truth["branches"][stenosis["branch_id"]]
    assert before["points"] == branch["points"]
    assert before["radius"][n] == stenosis["reference_radius_mm"]
    centre = np.array(stenosis["centre_lps"])
    # The tolerance is 8 % or 0.2 mm, because voxels are 0.9 mm and the lumen widens on both sides of the plane.
    assert section_radius(ill, branch, n) == pytest.approx(stenosis["min_radius_mm"], rel=0.08, abs=0.2)
    assert section_radius(healthy, before, n) == pytest.approx(stenosis["reference_radius_mm"], rel=0.08, abs=0.2)
    assert at(ill.lumen_zyx, ill, centre[None]).tolist() == [1], "narrow, not closed"


@pytest.mark.parametrize("seed", some_of(8))
def test_nodule_of_the_phantom_is_in_the_lung_and_does_not_touch_the_airways(seed: int) -> None:
    made = generate_phantom(seed=seed, spacing_mm=3.0, nodule=True, noise_hu=0.0)
    nodule = made.truth["nodule"]
    centre = np.array(nodule["centre_lps"])
    assert 5.0 <= nodule["radius_mm"] <= 10.0
    points = np.concatenate([b["points"] for b in made.truth["branches"]])
    nearest = float(np.linalg.norm(points - centre, axis=1).min())
    assert nearest == pytest.approx(nodule["distance_mm"], abs=1e-9)
    assert nearest > nodule["radius_mm"]
    assert made.volume.hu_zyx[at_index(made, tuple(centre))] == pytest.approx(34, abs=25)
    plain = generate_phantom(seed=seed, spacing_mm=8.0).truth
    assert plain["branches"] == made.truth["branches"], "a nodule does not change the airways"


# Repeatability, refused options, cancellation and files


def test_equal_seeds_give_equal_phantoms_and_different_seeds_different_ones() -> None:
    options = {"spacing_mm": 4.0, "generations": 5, "stenosis": True, "nodule": True}
    first, again = generate_phantom(seed=9, **options), generate_phantom(seed=9, **options)
    other = generate_phantom(seed=10, **options)
    np.testing.assert_array_equal(first.volume.hu_zyx, again.volume.hu_zyx)
    np.testing.assert_array_equal(first.lumen_zyx, again.lumen_zyx)
    assert first.truth == again.truth
    assert first.truth["branches"] != other.truth["branches"]
    assert (first.volume.hu_zyx != other.volume.hu_zyx).mean() > 0.5


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"spacing_mm": 0.1}, "spacing"),
        ({"spacing_mm": (1.0, 1.0)}, "spacing"),
        ({"spacing_mm": float("nan")}, "spacing"),
        ({"generations": 2}, "generations"),
        ({"generations": 10}, "generations"),
        ({"generations": -1}, "generations"),
        ({"noise_hu": -1.0}, "noise"),
        ({"seed": -1}, "seed"),
        ({"box_lps": ((0, 0, 0), (0, 5, 5))}, "box"),
        ({"box_lps": ((0, 0), (5, 5))}, "box"),
    ],
)
def test_phantom_options_out_of_range_are_refused_by_name(options: dict, says: str) -> None:
    with pytest.raises(UsageError, match=says):
        generate_phantom(**options)


def test_phantom_generation_reports_progress_and_can_be_cancelled() -> None:
    seen: list[float] = []
    generate_phantom(spacing_mm=4.0, progress=lambda _, fraction: seen.append(fraction or 0.0))
    assert seen == sorted(seen)
    assert seen[-1] == 1.0
    with pytest.raises(CancelledError):
        generate_phantom(spacing_mm=2.0, cancel=lambda: True)


def test_written_phantom_files_have_equal_voxels_at_equal_positions(tmp_path: Path) -> None:
    made = generate_phantom(seed=4, spacing_mm=(3.0, 3.5, 4.0), generations=4, nodule=True)
    files = write_phantom(made, tmp_path / "case")
    assert [f.name for f in files] == ["ct.nii.gz", "lumen.nii.gz", "truth.json"]
    assert sorted(f.name for f in (tmp_path / "case").iterdir()) == sorted(f.name for f in files)
    ct = SimpleITK.ReadImage(str(files[0]))
    np.testing.assert_array_equal(SimpleITK.GetArrayFromImage(ct), made.volume.hu_zyx)
    np.testing.assert_array_equal(SimpleITK.GetArrayFromImage(SimpleITK.ReadImage(str(files[1]))), made.lumen_zyx)
    shape = made.volume.shape_zyx
    for ijk in ((0, 0, 0), (5, 7, 9), (shape[2] - 1, shape[1] - 1, shape[0] - 1)):
        # The tolerance is 1e-4 mm, because NIfTI stores its matrix in float32.
        np.testing.assert_allclose(
            ct.TransformContinuousIndexToPhysicalPoint([float(v) for v in ijk]),
            made.volume.to_lps(np.array(ijk, dtype=float)),
            atol=1e-4,
        )
    truth = json.loads(files[2].read_text(encoding="utf-8"))
    assert truth["format"] == "carina-tree"
    for branch in truth["branches"]:
        for child in branch["children"]:
            assert truth["branches"][child]["points"][0] == branch["points"][-1]
