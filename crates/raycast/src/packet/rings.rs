//! Drawn features that depend on anatomy: cartilage rings, the membranous wall, colour by region, ridges at forks.
//!
//! These features are decoration: they change only the colour of a wall and the normal used for its shading. Each
//! effect is a strength times a change, so a pixel with strength 0 has the same bits, whichever pixels share its
//! register.

use super::{
    lanes::Lanes,
    texture::{Texture, noise, sharp},
    vectors::{along, dot, scaled, smooth, unit},
};
use crate::{appearance::Appearance, decoration::Decoration, shared_constants::shared_constants};

shared_constants! {
    /// Height of a cartilage ring above the gaps between rings, as a fraction of the distance between rings (5.6 mm).
    const HEIGHT: f32 = 0.050;
    /// Half of the width of a cartilage ring, as a fraction of the distance between rings.
    const HALF_WIDTH: f32 = 0.34;
    /// Width of a cartilage ring's soft edge, as a fraction of the distance between rings.
    const EDGE: f32 = 0.24;
    /// Maximum displacement of regular and of irregular cartilage rings, as a fraction of the distance between rings.
    const STRAY: [f32; 2] = [0.09, 0.30];
    /// Cosines of the angle from the middle of the airway's back at which the membranous wall begins and is complete.
    ///
    /// The membranous wall takes about a third of the circumference.
    const BACK: [f32; 2] = [0.28, 0.70];
    /// Number of folds of the membranous wall across one radius of the airway, and along one distance between cartilage
    /// rings.
    const FOLDS: [f32; 2] = [9.0, 0.26];
    /// Sideways displacement of the folds of the membranous wall, as a fraction of the distance between folds.
    const WINDING: f32 = 1.6;
    /// Slope of the sides of the folds of the membranous wall.
    const FOLD: f32 = 0.32;
    /// Strength, 0 to 1, with which the normal of the membranous wall is turned to that of a flat wall.
    const FLAT: f32 = 0.60;

    /// Changes of red, green and blue by region: first the change in the trachea, then the change in the periphery.
    ///
    /// The trachea is yellowish and pale; the mucosa far from it is redder.
    const HUE: [[f32; 2]; 3] = [[0.02, 0.0], [0.13, -0.06], [0.02, -0.05]];
    /// Changes of red, green and blue by visible blood: between rings, on the membranous wall, and on its folds.
    const BLOOD: [[f32; 3]; 3] = [
        [-0.02, 0.01, 0.04],
        [-0.15, -0.09, 0.17],
        [-0.11, -0.06, 0.13],
    ];
    /// Slope and offset of the opacity of all features drawn here, as a function of the wall's distance from the
    /// airway's axis in radii.
    const NEAR_AXIS: [f32; 2] = [-4.0, 6.2];
    /// Slope and offset of the opacity of rings, as a function of the wall's distance from the airway's axis in radii.
    const ON_TUBE: [f32; 2] = [6.0, -3.9];
    /// Slope and offset of the opacity of the membranous wall, as a function of the wall's distance from the airway's
    /// axis in radii.
    const ON_BACK: [f32; 2] = [6.0, -2.4];
    /// Decrease of the opacity of rings per unit of the strength of a fork.
    const AT_FORK: f32 = 1.3;
    /// Lower bound, in radii, of the distance from the axis, which is a divisor in the computation of the position on
    /// the airway's back.
    const LEAST_OFF: f32 = 0.05;
    /// Maximum displacement of the edges of the membranous wall by the mottling noise, in cosines of the angle from the
    /// back.
    const RAGGED: f32 = 0.06;
    /// Lower bound of the cosine between wall normal and viewing direction, which is a divisor in the computation of a
    /// pixel's width.
    const LEAST_FACING: f32 = 0.08;
    /// Slope and offset of the opacity of rings, as a function of a pixel's width divided by the distance between
    /// rings.
    const RINGS_SEEN: [f32; 2] = [-4.5, 2.0];
    /// Slope and offset of the opacity of cartilage plates round the circumference, as a function of the mottling
    /// noise.
    const PLATES: [f32; 2] = [1.6, 0.55];
    /// Paleness that cartilage rings add to the colour of the wall.
    const PALE_RING: f32 = 0.34;
    /// Paleness of the ridges at forks.
    const PALE_RIDGE: f32 = 0.65;
    /// Slope and offset of the redness between rings, as a function of the mottling noise.
    const RED: [f32; 2] = [0.7, 0.8];
    /// Number of folds of the membranous (posterior) wall along its depth, per radius of the airway.
    const FOLDS_BACK: f32 = 0.8;
    /// Number of folds per mm in the test whether a pixel is small enough to show folds.
    const FOLDS_PER_MM: f32 = 0.7;
    /// Seed of the noise that shapes the folds.
    const FOLD_SEED: i32 = 53;
}

/// Position of wall points along and around their airway, with the strengths of the drawn features there.
struct Place<L: Lanes> {
    phase: L::F,
    /// Gradient of the rings' phase per mm, LPS.
    growth: [L::F; 3],
    across: [L::F; 2],
    rings: L::F,
    proximal: L::F,
    spur: L::F,
    membrane: L::F,
    regular: L::F,
}

#[inline(always)]
fn lerp<L: Lanes>(l: L, t: L::F, a: L::F, b: L::F) -> L::F {
    l.fma(t, l.sub(b, a), a)
}

/// Interpolate the grid of anatomical data at patient points `lps`; strengths are 0 outside the grid.
///
/// Return `None` if the strengths of all lanes are 0.
#[inline(always)]
fn place<L: Lanes>(l: L, field: &Decoration<'_>, lps: [L::F; 3]) -> Option<Place<L>> {
    let s = |v: f32| l.splat(v);
    let [nx, ny, _] = field.shape_ijk;
    let (mut t, mut cell) = (lps, [l.splat_i(0); 3]);
    let mut inside = l.less(s(0.0), s(1.0));
    for a in 0..3 {
        let last = field.shape_ijk[a] - 1;
        let q = l.mul(l.sub(lps[a], s(field.origin_lps[a])), s(field.cells_per_mm));
        inside = l.and(inside, l.and(l.less(s(0.0), q), l.less(q, s(last as f32))));
        let q = l.min(l.max(q, s(0.0)), s(last as f32));
        cell[a] = l.min_i(l.whole(l.floor(q)), l.splat_i(last - 1));
        t[a] = l.sub(q, l.to_f(cell[a]));
    }
    if l.bits(inside) == 0 {
        return None;
    }
    let row = l.add_i(l.mul_i(cell[2], l.splat_i(ny)), cell[1]);
    let base = l.add_i(l.mul_i(row, l.splat_i(nx)), cell[0]);
    let base = l.add_i(base, base);
    let step = [2, 2 * nx, 2 * nx * ny].map(|n| l.splat_i(n));
    // A cell is divided into six tetrahedra. The path through a tetrahedron starts at the cell's first corner and
    // follows the axis with the largest fraction, then the next, then the last. Four corners are read instead of eight,
    // and slopes are differences along that path.
    let [x, y, z] = t;
    let (x_y, x_z, y_z) = (l.less(x, y), l.less(x, z), l.less(y, z));
    let (y_first, z_first) = (l.without(x_y, y_z), l.and(x_z, y_z));
    let (x_last, y_last) = (l.and(x_y, x_z), l.without(y_z, x_y));
    let first = l.select_i(z_first, step[2], l.select_i(y_first, step[1], step[0]));
    let last = l.select_i(x_last, step[0], l.select_i(y_last, step[1], step[2]));
    let all = l.add_i(l.add_i(step[0], step[1]), step[2]);
    let corners = [
        base,
        l.add_i(base, first),
        l.add_i(base, l.sub_i(all, last)),
        l.add_i(base, all),
    ];
    let (low, high) = (l.min(x, y), l.max(x, y));
    let (most, least) = (l.max(high, z), l.min(low, z));
    let middle = l.max(low, l.min(high, z));
    let weights = [
        l.sub(s(1.0), most),
        l.sub(most, middle),
        l.sub(middle, least),
        least,
    ];
    let mut read = [[s(0.0); 4]; 2];
    let mut way = [s(0.0); 3];
    for half in 0..2 {
        let mut before = s(0.0);
        for n in 0..4 {
            // SAFETY: a cell's index is at most two below the shape along each axis, so its other corners are in the
            // grid; `Decoration::new` has checked that the length matches the shape. Benchmark:
            // benchmarks/measurements/rendering.md.
            let entry = unsafe { l.entries(field.cells.as_ptr().add(half), corners[n]) };
            for c in 0..4 {
                read[half][c] = l.fma(weights[n], entry[c], read[half][c]);
            }
            if half == 0 && n > 0 {
                way[n - 1] = l.sub(entry[0], before);
            }
            before = entry[0];
        }
    }
    let not_x = l.or(y_first, z_first);
    let not_z = l.or(x_last, y_last);
    let slope = [
        l.select(x_last, way[2], l.select(not_x, way[1], way[0])),
        l.select(y_first, way[0], l.select(y_last, way[2], way[1])),
        l.select(z_first, way[0], l.select(not_z, way[1], way[2])),
    ];
    let [
        [phase, left, back, rings],
        [proximal, spur, membrane, regular],
    ] = read;
    let none = s(0.0);
    Some(Place {
        phase,
        growth: scaled(l, s(field.cells_per_mm), slope),
        across: [left, back],
        rings: l.select(inside, rings, none),
        proximal: l.select(inside, proximal, none),
        spur: l.select(inside, spur, none),
        membrane: l.select(inside, membrane, none),
        regular: l.select(inside, regular, none),
    })
}

/// Change of the shading of wall points by rings, membranous wall, colour by region and ridges.
#[derive(Clone, Copy)]
pub(super) struct Decorated<L: Lanes> {
    /// Gradient of the height of rings and folds, LPS, which tilts the normal for diffuse light and highlights.
    pub form: [L::F; 3],
    /// Paleness of the mucosa, 0 to 1.
    pub pale: L::F,
    /// Linear factors of the colour channels.
    pub tint: [L::F; 3],
}

/// Points of walls on which rings, folds and ridges are drawn.
///
/// The fields are the position in the patient, the normal towards the camera, the cosine between normal and viewing
/// direction (0 to 1), and the width of a pixel.
pub(super) struct Wall<L: Lanes> {
    pub lps: [L::F; 3],
    pub normal: [L::F; 3],
    pub facing: L::F,
    pub footprint_mm: L::F,
}

/// Return the linear colour factors of the mucosa by region.
///
/// Away from the trachea, and where the region is unknown, the mucosa is redder.
#[inline(always)]
fn hue<L: Lanes>(l: L, appearance: &Appearance, proximal: L::F) -> [L::F; 3] {
    let mut factors = [proximal; 3];
    for c in 0..3 {
        let [trachea, beyond] = HUE[c];
        let region = l.fma(proximal, l.splat(trachea - beyond), l.splat(beyond));
        factors[c] = l.fma(l.splat(appearance.hue), region, l.splat(1.0));
    }
    factors
}

/// Compute the change of wall points by rings, membranous wall, colour by region and ridges.
///
/// The result depends only on the wall points themselves.
#[inline(always)]
pub(super) fn decorate<L: Lanes>(
    l: L,
    appearance: &Appearance,
    field: &Decoration<'_>,
    wall: &Wall<L>,
    skin: &Texture<L>,
) -> Decorated<L> {
    let s = |v: f32| l.splat(v);
    let one = s(1.0);
    let (mut pale, mut form) = (s(0.0), [s(0.0); 3]);
    let Some(place) = place(l, field, wall.lps) else {
        let tint = hue(l, appearance, s(0.0));
        return Decorated { form, pale, tint };
    };
    let [left, back] = place.across;
    let off = l.sqrt(l.fma(left, left, l.mul(back, back)));
    // Only a wall close to the ideal tube has rings; a flat back wall is nearer to the axis than a tube's wall.
    let beyond = smooth(l, l.fma(off, s(NEAR_AXIS[0]), s(NEAR_AXIS[1])));
    let proximal = l.mul(place.proximal, beyond);
    let mut tint = hue(l, appearance, proximal);
    // The ridge between two daughter branches is cartilage under thin mucosa.
    let ridge = l.mul(l.mul(place.spur, s(appearance.spurs)), beyond);
    // Most walls beyond the lobar bronchi have neither rings nor a membranous wall, so the function returns early for
    // them.
    let either = l.max(
        l.mul(place.rings, s(appearance.rings)),
        l.mul(place.membrane, s(appearance.membrane)),
    );
    if l.bits(l.less(s(0.0), either)) == 0 {
        pale = l.min(l.mul(ridge, s(PALE_RIDGE)), one);
        return Decorated { form, pale, tint };
    }
    let on_tube = l.mul(smooth(l, l.fma(off, s(ON_TUBE[0]), s(ON_TUBE[1]))), beyond);
    let on_back = l.mul(smooth(l, l.fma(off, s(ON_BACK[0]), s(ON_BACK[1]))), beyond);
    let between = l.sub(one, smooth(l, l.mul(place.spur, s(AT_FORK))));
    let cos_back = l.div(back, l.max(off, s(LEAST_OFF)));
    let cos_back = l.fma(skin.mottle, s(RAGGED), cos_back);
    let at_back = smooth(
        l,
        l.mul(l.sub(cos_back, s(BACK[0])), s(1.0 / (BACK[1] - BACK[0]))),
    );

    // The direction of the airway, and the width of a pixel along it in distances between rings.
    let (axis, per_mm) = unit(l, place.growth);
    let width = l.div(
        l.mul(wall.footprint_mm, per_mm),
        l.max(wall.facing, s(LEAST_FACING)),
    );
    let seen = smooth(l, l.fma(width, s(RINGS_SEEN[0]), s(RINGS_SEEN[1])));
    let stray = lerp(l, place.regular, s(STRAY[1]), s(STRAY[0]));
    let phase = l.fma(skin.mottle, stray, place.phase);
    let t = l.sub(l.sub(phase, l.floor(phase)), s(0.5));
    let edge = l.max(s(EDGE), width);
    let per_edge = l.div(one, edge);
    let inwards = l.sub(l.fma(edge, s(0.5), s(HALF_WIDTH)), l.abs(t));
    let inwards = l.min(l.max(l.mul(inwards, per_edge), s(0.0)), one);
    let ring = smooth(l, inwards);
    let steep = l.mul(l.mul(inwards, l.sub(one, inwards)), l.mul(s(6.0), per_edge));
    let steep = l.select(l.less(t, s(0.0)), steep, l.sub(s(0.0), steep));
    // Smaller airways have plates instead of rings: parts of the circumference have no cartilage.
    let plates = lerp(
        l,
        place.regular,
        smooth(l, l.fma(skin.mottle, s(PLATES[0]), s(PLATES[1]))),
        one,
    );
    let no_back = l.fma(l.mul(at_back, place.membrane), s(-1.0), one);
    let strength = l.mul(
        l.mul(place.rings, s(appearance.rings)),
        l.mul(plates, no_back),
    );
    let strength = l.mul(strength, l.mul(on_tube, between));
    let rise = l.mul(l.mul(strength, seen), l.mul(steep, s(HEIGHT)));
    form = along(l, form, rise, axis);
    // At a distance where single rings are not visible, rings and gaps have one mean colour.
    let ring = lerp(l, seen, s(2.0 * HALF_WIDTH), ring);
    pale = l.fma(l.mul(strength, ring), s(PALE_RING), pale);
    // The redness varies between gaps and round the circumference.
    let red = l.fma(skin.mottle, s(RED[0]), s(RED[1]));
    let interval = l.mul(l.mul(strength, red), l.sub(one, ring));

    // Folds run along the membranous wall. The wall is flat, so its normal turns less across the wall than on a round
    // tube.
    let membrane = l.mul(
        l.mul(place.membrane, s(appearance.membrane)),
        l.mul(at_back, l.mul(on_back, between)),
    );
    let mut fold = s(0.0);
    if l.bits(l.less(s(0.0), membrane)) != 0 {
        let (side, _) = unit(l, [l.sub(s(0.0), axis[2]), s(0.0), axis[0]]);
        // The folds wind and merge; their displacement is the mottling noise, which all walls have.
        let q = [
            l.fma(left, s(FOLDS[0]), l.mul(skin.mottle, s(WINDING))),
            l.mul(place.phase, s(FOLDS[1])),
            l.mul(back, s(FOLDS_BACK)),
        ];
        let (value, slope) = noise(l, q, FOLD_SEED);
        let near = sharp(l, wall.footprint_mm, FOLDS_PER_MM);
        fold = l.mul(l.mul(value, near), membrane);
        let sideways = dot(l, wall.normal, side);
        let turned = l.mul(l.mul(sideways, s(FLAT)), membrane);
        // Folds tilt the normal across the wall, not into it; otherwise a wall seen from the side would turn away from
        // the light.
        let across = l.fma(l.sub(s(0.0), sideways), sideways, one);
        let lean = l.mul(l.mul(l.mul(slope[0], near), membrane), across);
        let lean = l.fma(lean, s(FOLD), turned);
        form = along(l, form, lean, side);
    }

    pale = l.fma(l.mul(ridge, l.sub(one, pale)), s(PALE_RIDGE), pale);
    // More blood is visible between rings and on the membranous wall.
    for c in 0..3 {
        let [of_interval, of_membrane, of_fold] = BLOOD[c];
        let blood = l.fma(
            interval,
            s(of_interval),
            l.fma(membrane, s(of_membrane), l.mul(fold, s(of_fold))),
        );
        tint[c] = l.fma(tint[c], blood, tint[c]);
    }
    Decorated {
        form,
        pale: l.min(pale, one),
        tint,
    }
}
