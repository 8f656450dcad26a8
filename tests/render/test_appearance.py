"""Tests of the appearance of walls through a scope: exposure, light, cartilage, gloss, and its JSON file."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from carina.errors import RenderError
from carina.render import AirwayView, Appearance, Renderer, TransferFunction, transfer_preset
from carina.scopes import Pose
from carina.volume import Volume

ENDOSCOPIC = transfer_preset("endoscopic")
SIZE = {"width": 90, "height": 90}


def tube(radius_mm: float, wall_hu: float = 40.0, ring_hu: float = 40.0) -> Volume:
    """Return an airway along z whose wall contains rings of 4 mm every 8 mm."""
    spacing = 0.8
    z, y, x = np.indices((110, 44, 44)) * spacing
    off = np.hypot(y - 17.2, x - 17.2)
    wall = np.where(z % 8 < 4, ring_hu, wall_hu)
    tissue = np.clip((off - radius_mm) / 1.2 + 0.5, 0, 1)
    return Volume(np.rint(-1000 + (wall + 1000) * tissue).astype(np.int16), np.diag([spacing] * 3 + [1.0]))


def look(volume: Volume, *, off_mm: float = 0.0, direction=(0.0, 0.0, 1.0), **changes) -> np.ndarray:
    """Return a picture from inside the tube, with values 0 to 1."""
    appearance = dataclasses.replace(Appearance(), **changes)
    renderer = Renderer(volume, transfer=dataclasses.replace(ENDOSCOPIC, appearance=appearance))
    pose = Pose.looking((17.2 + off_mm, 17.2, 12.0), direction)
    return renderer.render(AirwayView(pose, fov_deg=100.0, **SIZE)).rgb / 255.0


@pytest.mark.parametrize("radius_mm", [1.6, 4.0, 9.0])
def test_near_wall_is_bright_and_the_distant_lumen_is_dark_at_any_airway_width(radius_mm):
    picture = look(tube(radius_mm))
    bright = picture.max(axis=2)
    edge = np.concatenate([bright[:8].ravel(), bright[-8:].ravel()])
    assert 0.35 < np.median(edge) < 0.97
    assert (picture.min(axis=2) > 0.98).mean() < 0.02, "the near wall is overexposed"
    assert bright[44:46, 44:46].max() < 0.2
    # Mucosa has more red than green, and more green than blue.
    lit = picture[bright > 0.4]
    assert (lit[:, 0] >= lit[:, 1]).all()
    assert np.mean(lit[:, 1] - lit[:, 2]) > 0


def test_near_wall_lowers_the_automatic_exposure_of_the_complete_picture():
    volume = tube(6.0)
    far, near = look(volume), look(volume, off_mm=4.6)
    assert np.percentile(near, 99) < 1.0
    # The left half of the picture is opposite the near wall.
    assert near[:, :30].mean() < 0.9 * far[:, :30].mean()
    fixed = look(volume, exposure=20.0), look(volume, exposure=40.0)
    assert fixed[1].mean() > fixed[0].mean()


def test_light_comes_from_the_light_guides_and_decreases_with_distance():
    volume = tube(6.0)
    side = {"texture": 0.0, "gloss": 0.0, "exposure": 10.0, "ambient": 0.0}
    right = look(volume, guides_mm=((3.0, 0.0, 0.0),), **side)
    assert right[40:50, -8:].mean() > 1.25 * right[40:50, :8].mean()
    middle = look(volume, guides_mm=((0.0, 0.0, 0.0),), **side)
    row = middle[45, 45:, 0]
    # Brightness increases from the dark centre to the edge of the picture; 0.02 allows for steps of the CT.
    assert (np.diff(row) > -0.02).all()


def test_mucosa_is_paler_over_cartilage_rings_only():
    rings = look(tube(6.0, ring_hu=250.0), texture=0.0, gloss=0.0)
    plain = look(tube(6.0), texture=0.0, gloss=0.0)
    bare = look(tube(6.0, ring_hu=250.0), texture=0.0, gloss=0.0, paleness=0.0)

    def redness(picture):
        return picture[45, 60:, 0] / picture[45, 60:, 1]

    for other in (redness(plain), redness(bare)):
        paler = other - redness(rings)
        assert paler.max() > 0.15, "over a ring"
        assert np.abs(paler).min() < 0.03, "between two"


def test_gloss_setting_adds_few_small_highlights_that_the_wall_relief_divides():
    volume = tube(6.0)
    direction = (1.0, 0.0, 0.6)
    dull = look(volume, direction=direction, gloss=0.0, texture=0.0, exposure=60.0, specks=0.0)
    glossy = look(volume, direction=direction, texture=0.0, exposure=60.0, specks=0.0)
    broken = look(volume, direction=direction, exposure=60.0, specks=0.0)
    highlight = (glossy - dull).max(axis=2) > 0.1
    assert 0.002 < highlight.mean() < 0.25
    assert (glossy >= dull - 1 / 255).all(), "gloss only adds light"

    def edges(mask):
        # Edges are counted along both axes, because the highlight of a smooth tube is a long column.
        return sum(np.abs(np.diff(mask.astype(int), axis=axis)).sum() for axis in (0, 1))

    matt = look(volume, direction=direction, gloss=0.0, exposure=60.0, specks=0.0)
    assert edges((broken - matt).max(axis=2) > 0.1) > 2.0 * edges(highlight)


# In a lumen narrower than the distance between the light guides (3.8 mm) the light comes from inside the wall.
@pytest.mark.parametrize("radius_mm", [4.0, 9.0])
def test_automatic_exposure_preserves_the_decrease_of_brightness_with_depth(radius_mm):
    picture = look(tube(radius_mm), specks=0.0, gloss=0.0, texture=0.0)
    bright = picture.max(axis=2)
    rows, columns = np.indices(bright.shape) - 44.5
    off_px = np.hypot(rows, columns)

    def ring(from_px, to_px):
        return np.median(bright[(off_px >= from_px) & (off_px < to_px)])

    near, half, far = ring(40, 45), ring(18, 22), ring(0, 4)
    assert near > 0.75, "the near rim is bright"
    assert half < 0.62 * near, "and at twice its depth the wall is much darker"
    assert far < 0.12


def test_droplets_on_the_wall_reflect_light_at_a_distance_where_a_smooth_film_does_not():
    volume = tube(7.0)
    appearance = {"texture": 1.0, "exposure": 300.0}
    size = {"width": 240, "height": 240}

    def render(z_mm, **changes):
        transfer = dataclasses.replace(
            ENDOSCOPIC, appearance=dataclasses.replace(Appearance(), **appearance, **changes)
        )
        view = AirwayView(Pose.looking((17.2, 17.2, z_mm), (0.0, 0.0, 1.0)), fov_deg=60.0, **size)
        renderer = Renderer(volume, transfer=transfer)
        return renderer.render(view).rgb / 255.0, renderer.surface(view).depth_mm

    plain, depth = render(12.0, specks=0.0)
    dull, _ = render(12.0, specks=0.0, gloss=0.0)
    wet, _ = render(12.0, specks=1.0)
    far = (depth > 20.0) & (depth < 40.0)
    glints = (wet - plain).max(axis=2) > 0.1
    assert (wet >= plain - 1 / 255).all(), "highlights only add light"
    assert ((plain - dull).max(axis=2)[far] > 0.1).mean() < 0.002, "the film alone is matt there"
    assert 0.002 < glints[far].mean() < 0.2, "broken specks"


def test_secretions_are_drawn_on_the_posterior_wall_only():
    volume = tube(7.0)
    picture = {amount: look(volume, specks=0.0, exposure=60.0, secretions=amount) for amount in (0.0, 0.5, 1.0)}
    view = AirwayView(Pose.looking((17.2, 17.2, 12.0), (0.0, 0.0, 1.0)), fov_deg=100.0, **SIZE)
    posterior = Renderer(volume, transfer=ENDOSCOPIC).surface(view).position_lps[..., 1] > 17.2
    changed = {amount: (np.abs(picture[amount] - picture[0.0]).max(axis=2) > 0.02) for amount in (0.5, 1.0)}
    assert not changed[1.0][~posterior].any()
    assert 0.0 < changed[0.5][posterior].mean() < changed[1.0][posterior].mean()


def test_fog_setting_hides_the_lumen_independently_of_the_scope_position():
    volume = tube(7.0)
    clear, thin, thick = (look(volume, exposure=60.0, fog=fog, specks=0.0) for fog in (0.0, 0.4, 1.0))
    assert thick.std() < thin.std() < clear.std()
    assert clear[44:46, 44:46].max() < 0.2 < thick[44:46, 44:46].min()
    # Fog is on the lens, so the position of the scope does not change it.
    moved = [look(volume, exposure=60.0, fog=fog, specks=0.0, off_mm=2.0) for fog in (0.0, 1.0)]
    share = [1.0 - (np.ptp(a) / np.ptp(b)) for a, b in ((thick, clear), (moved[1], moved[0]))]
    assert abs(share[0] - share[1]) < 0.1


def test_droplets_secretions_and_fog_are_listed_as_decorations_and_off_without_texture(airway):
    assert ENDOSCOPIC.appearance.specks == 1.0 and Appearance().specks == 0.0
    every = Appearance(texture=0.0, specks=1.0, secretions=0.3, fog=0.2)
    assert every.decorations == ("specks", "secretions", "fog")
    assert every.undecorated().decorations == ()
    view = AirwayView(airway.pose, texture=False, **SIZE)

    def render(appearance):
        transfer = dataclasses.replace(ENDOSCOPIC, appearance=appearance)
        return Renderer(airway.volume, transfer=transfer).render(view).rgb

    np.testing.assert_array_equal(render(every), render(Appearance().undecorated()))
    assert transfer_preset("ct-grey").appearance is None


def test_mucosal_vessels_are_few_and_faint_and_off_without_texture():
    assert ENDOSCOPIC.appearance.vessels == 0.5
    assert Appearance().vessels == 0.0
    assert Appearance.from_json({"texture": 1.0}).vessels == 0.0, "a file without the field ``vessels``"
    volume = tube(6.0)
    # Only the green channel without highlights is compared, because blood absorbs green.
    plain, red = (look(volume, gloss=0.0, texture=0.0, vessels=v, exposure=30.0) for v in (0.0, 1.0))
    assert (red <= plain).all()
    darker = (plain - red)[..., 1] > 0.02
    assert 0.005 < darker.mean() < 0.25, "few thin lines"
    renderer = Renderer(volume, transfer=dataclasses.replace(ENDOSCOPIC, appearance=Appearance(vessels=1.0)))
    view = AirwayView(Pose.looking((17.2, 17.2, 12.0), (0.0, 0.0, 1.0)), fov_deg=100.0, texture=False, **SIZE)
    np.testing.assert_array_equal(renderer.render(view).rgb / 255.0, look(volume, texture=0.0, specks=0.0))


def test_colours_without_shading_are_those_of_the_transfer_function(airway):
    view = AirwayView(airway.pose, shading=False, **SIZE)
    flat = Renderer(airway.volume).render(view).rgb
    plain = Renderer(airway.volume, transfer=dataclasses.replace(ENDOSCOPIC, appearance=None)).render(view).rgb
    np.testing.assert_array_equal(flat, plain)


def test_airway_picture_without_a_visible_wall_is_dark():
    volume = Volume(np.full((12, 12, 12), -1000, dtype=np.int16), np.eye(4))
    picture = Renderer(volume).render(AirwayView(Pose.looking((6, 6, 6), (0, 0, 1)), **SIZE)).rgb
    assert picture.max() == 0
    solid = Volume(np.full((12, 12, 12), 40, dtype=np.int16), np.eye(4))
    # In the middle of tissue the gradient is zero, so the light has no direction.
    picture = Renderer(solid).render(AirwayView(Pose.looking((6, 6, 6), (0, 0, 1)), **SIZE)).rgb
    assert 40 < picture[:, :, 0].mean() < 250


def test_appearance_is_read_from_a_transfer_function_file_and_none_if_the_file_has_none():
    changed = Appearance(guides_mm=((0.0, 1.5, 0.2),), exposure=3.0, texture=0.5, vessels=0.25, pale_hu=(-20.0, 180.0))
    transfer = dataclasses.replace(ENDOSCOPIC, appearance=changed)
    document = transfer.to_json()
    assert TransferFunction.from_json(document).appearance == changed
    assert TransferFunction.from_json({**document, "appearance": None}).appearance is None
    del document["appearance"]
    assert TransferFunction.from_json(document).appearance is None
    document["appearance"] = {"texture": 0.0, "some day": 1}
    assert TransferFunction.from_json(document).appearance == Appearance(texture=0.0)


@pytest.mark.parametrize(
    "broken",
    [
        {"guides_mm": []},
        {"guides_mm": [[0, 0]]},
        {"guides_mm": [[0, 0, 0]] * 3},
        {"guides_mm": [[0, 0, 1e9]]},
        {"guides_mm": "left"},
        {"exposure": -1},
        {"exposure": "bright"},
        {"texture": float("nan")},
        {"vessels": -1},
        {"gloss": -0.1},
        {"wrap": 1.5},
        {"shininess_log2": 3.5},
        {"shininess_log2": 11},
        {"pale_hu": [100, 100]},
        {"pale_hu": [1]},
        {"ambient": None},
        {"silhouettes": 1},
        {"specks": -0.5},
        {"secretions": 1.5},
        {"fog": float("nan")},
    ],
    ids=str,
)
def test_invalid_appearance_settings_are_refused_with_a_message(broken):
    document = {**ENDOSCOPIC.to_json(), "appearance": {**Appearance().to_json(), **broken}}
    with pytest.raises(RenderError) as refused:
        TransferFunction.from_json(document)
    assert refused.value.code.startswith("render")
