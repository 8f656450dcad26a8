//! Texture of mucosa: mottling, vessels and fine relief, from noise that is fixed to the tissue.

use std::array::from_fn;

use super::{
    lanes::Lanes,
    vectors::{dot, scaled, smooth, turn},
};
use crate::{appearance::Appearance, shared_constants::shared_constants};

shared_constants! {
    /// Number of cells per mm of the noise that mottles the colour of the mucosa.
    const MOTTLE_PER_MM: f32 = 0.23;
    /// Number of cells per mm of the noise of the mucosa's coarse relief (wrinkles).
    pub(super) const WRINKLES_PER_MM: f32 = 0.45 * RELIEF_PER_MM;
    /// Number of cells per mm of the noise of the mucosa's fine relief.
    const RELIEF_PER_MM: f32 = 1.9;
    /// Half of the width of a vessel's stem, mm.
    const VESSEL_MM: f32 = 0.17;
    /// Half of the width of a vessel's branch where it leaves the stem, mm.
    const BRANCH_MM: f32 = 0.12;
    /// Slope of the fine relief at strength 1.
    const RELIEF: f32 = 0.11;
    /// Multipliers of the hash of a lattice point: odd numbers without a pattern in their bits.
    const PRIMES: [i32; 3] = [
        0x0019_660d_u32 as i32,
        0x9e37_79b1_u32 as i32,
        0x85eb_ca77_u32 as i32,
    ];
    /// Number that the hash of a lattice point adds between its two mixing steps.
    const STIR: i32 = 0x6d2b_79f5;
    /// Coefficients of the polynomial `x^3 (6 x^2 - 15 x + 10)`, which interpolates the noise.
    const BLEND: [f32; 3] = [6.0, -15.0, 10.0];
    /// Seeds of the noises of the mucosa: mottling, fine relief and wrinkles.
    const SKIN_SEEDS: [i32; 3] = [11, 37, 41];
    /// Changes of red, green and blue by the mottling and by vessels.
    const SKIN_TINT: [[f32; 2]; 3] = [[0.03, -0.08], [-0.11, -0.40], [-0.09, -0.30]];
    /// Thickness of the film of mucus: change per unit of fine relief, change per unit of mottling, and mean.
    const FILM_FROM: [f32; 3] = [1.2, 0.35, 0.75];
    /// Slope and offset of the opacity of a noise, as a function of the width of a pixel in cells of the noise.
    const SHARP: [f32; 2] = [-2.0, 2.0];
    /// Lower bound of a noise's gradient per mm in the computation of a vessel's distance, to avoid a division by 0.
    const LEAST_STEEP: f32 = 1e-3;
    /// Half-width in pixels to which a thinner vessel of the mucosa is widened, so that it stays visible.
    const LEAST_VESSEL_PX: f32 = 0.7;
    /// Slope and offset of the opacity of vessel stems, as a function of the length of the noise's gradient.
    const STEMS: [f32; 2] = [1.5, -0.5];
    /// Slope and offset of the opacity of vessel branches, as a function of the length of the noise's gradient.
    const BRANCHES: [f32; 2] = [1.5, -0.6];
    /// Slope, offset and minimum of the relative width of a vessel's branch, as a function of the mottling noise.
    const TAPER: [f32; 3] = [-1.8, 1.0, 0.1];
    /// Slope of the opacity of vessel branches, as a function of the distance from their stem.
    const BESIDE_STEM: f32 = 12.0;
    /// Slope and offset of the opacity of a vessel along its line, as a function of noise.
    const SHOWN: [f32; 2] = [1.4, 0.4];
    /// Rotation from the patient's axes to the noise lattice, chosen so that no row of the lattice runs along an airway.
    pub(super) const ASKEW: [[f32; 3]; 3] = [[0.36, 0.48, -0.8], [-0.8, 0.60, 0.0], [0.48, 0.64, 0.60]];
}

#[inline(always)]
fn lerp<L: Lanes>(l: L, t: L::F, a: L::F, b: L::F) -> L::F {
    l.fma(t, l.sub(b, a), a)
}

/// Return x (2 x + 1) in each lane, a permutation of the 32-bit numbers that mixes their bits.
#[inline(always)]
fn mix<L: Lanes>(l: L, x: L::I) -> L::I {
    l.mul_i(x, l.add_i(l.add_i(x, x), l.splat_i(1)))
}

/// Return a pseudo-random number from -1 to 1 for a corner of the noise lattice.
///
/// After two mixing steps the high bits show no visible pattern.
#[inline(always)]
fn corner<L: Lanes>(l: L, at: [[L::I; 2]; 3], [i, j, k]: [usize; 3]) -> L::F {
    let sum = l.add_i(l.add_i(at[0][i], at[1][j]), at[2][k]);
    let mixed = mix(l, l.add_i(mix(l, sum), l.splat_i(STIR)));
    l.mul(l.to_f(mixed), l.splat(1.0 / 2_147_483_648.0))
}

/// Return lattice noise at positions `q`, from -1 to 1, and its gradient; the noise is smooth to the second derivative.
#[inline(always)]
pub(super) fn noise<L: Lanes>(l: L, q: [L::F; 3], seed: i32) -> (L::F, [L::F; 3]) {
    let one = l.splat(1.0);
    let (mut t, mut slope) = (q, q);
    let mut at = [[l.splat_i(seed); 2]; 3];
    for a in 0..3 {
        let floor = l.floor(q[a]);
        let x = l.sub(q[a], floor);
        let low = l.mul_i(
            l.add_i(l.whole(floor), l.splat_i(seed)),
            l.splat_i(PRIMES[a]),
        );
        at[a] = [low, l.add_i(low, l.splat_i(PRIMES[a]))];
        // x^3 (6 x^2 - 15 x + 10) and its derivative 30 x^2 (x - 1)^2.
        let s = |v: f32| l.splat(v);
        let inner = l.fma(x, l.fma(x, s(BLEND[0]), s(BLEND[1])), s(BLEND[2]));
        t[a] = l.mul(l.mul(l.mul(x, x), x), inner);
        let y = l.mul(x, l.sub(x, one));
        slope[a] = l.mul(s(30.0), l.mul(y, y));
    }
    // The rows along x, then their slopes along x, y, z.
    let mut value = [[q[0]; 2]; 2];
    let mut rise = value;
    for k in 0..2 {
        for j in 0..2 {
            let (low, high) = (corner(l, at, [0, j, k]), corner(l, at, [1, j, k]));
            rise[k][j] = l.sub(high, low);
            value[k][j] = l.fma(t[0], rise[k][j], low);
        }
    }
    let (near, far) = (
        lerp(l, t[1], value[0][0], value[0][1]),
        lerp(l, t[1], value[1][0], value[1][1]),
    );
    let dx = lerp(
        l,
        t[2],
        lerp(l, t[1], rise[0][0], rise[0][1]),
        lerp(l, t[1], rise[1][0], rise[1][1]),
    );
    let dy = lerp(
        l,
        t[2],
        l.sub(value[0][1], value[0][0]),
        l.sub(value[1][1], value[1][0]),
    );
    let slopes = [
        l.mul(slope[0], dx),
        l.mul(slope[1], dy),
        l.mul(slope[2], l.sub(far, near)),
    ];
    (lerp(l, t[2], near, far), slopes)
}

/// Texture of the wall at points of the patient.
#[derive(Clone, Copy)]
pub(super) struct Texture<L: Lanes> {
    /// Linear factors of the colour channels.
    pub tint: [L::F; 3],
    /// Slope of the fine relief, LPS.
    pub relief: [L::F; 3],
    /// Thickness of the film of mucus, 0 to 1.
    pub film: L::F,
    /// Noise of the mottling, -1 to 1, independent of the mottling's strength.
    pub mottle: L::F,
    /// Noise of the coarse relief, -1 to 1, and its gradient per cell of its lattice, independent of the relief's
    /// strength.
    pub bumps: (L::F, [L::F; 3]),
}

/// Return the opacity of noise: 1 if a cell of its lattice covers 2 pixels or more, 0 if it covers less than one.
#[inline(always)]
pub(super) fn sharp<L: Lanes>(l: L, footprint_mm: L::F, per_mm: f32) -> L::F {
    let cells = l.mul(footprint_mm, l.splat(per_mm));
    smooth(l, l.fma(cells, l.splat(SHARP[0]), l.splat(SHARP[1])))
}

/// Return the opacity, 0 to 1, of a line of half-width `half_mm` along the zeros of a noise.
///
/// `web` is the value of the noise and `steep_per_mm` the length of its gradient.
#[inline(always)]
fn line<L: Lanes>(
    l: L,
    (web, steep_per_mm): (L::F, L::F),
    half_mm: L::F,
    footprint_mm: L::F,
) -> L::F {
    let s = |v: f32| l.splat(v);
    let off_mm = l.div(l.abs(web), l.max(steep_per_mm, s(LEAST_STEEP)));
    let width = l.max(half_mm, l.mul(footprint_mm, s(LEAST_VESSEL_PX)));
    let per_width = l.div(s(1.0), width);
    let near = smooth(l, l.sub(s(1.0), l.mul(off_mm, per_width)));
    // Thin vessels at a distance become paler, not wider.
    l.mul(near, l.mul(half_mm, per_width))
}

/// Return the opacity of vessels, 0 to 1, from the values and gradients of the mottling and wrinkle noises.
///
/// Stems follow the zeros of the mottling; branches follow the zeros of the wrinkles, leave a stem to one side and
/// taper. A separate noise for vessels would take longer than the remaining function.
#[inline(always)]
fn vessel<L: Lanes>(
    l: L,
    (mottle, bend): (L::F, [L::F; 3]),
    (wrinkle, fold): (L::F, [L::F; 3]),
    footprint_mm: L::F,
) -> L::F {
    let s = |v: f32| l.splat(v);
    let (bend_steep, fold_steep) = (l.sqrt(dot(l, bend, bend)), l.sqrt(dot(l, fold, fold)));
    // Where the noise is flat, its zeros form a patch instead of a line; such patches are left out.
    let stem = line(
        l,
        (mottle, l.mul(bend_steep, s(MOTTLE_PER_MM))),
        s(VESSEL_MM),
        footprint_mm,
    );
    let stem = l.mul(stem, smooth(l, l.fma(bend_steep, s(STEMS[0]), s(STEMS[1]))));
    let taper = l.fma(mottle, s(TAPER[0]), s(TAPER[1]));
    let half = l.mul(l.max(taper, s(TAPER[2])), s(BRANCH_MM));
    let branch = line(
        l,
        (wrinkle, l.mul(fold_steep, s(WRINKLES_PER_MM))),
        half,
        footprint_mm,
    );
    let branch = l.mul(
        branch,
        smooth(l, l.fma(fold_steep, s(BRANCHES[0]), s(BRANCHES[1]))),
    );
    let beside = l.mul(
        smooth(l, l.mul(mottle, s(BESIDE_STEM))),
        smooth(l, l.add(taper, taper)),
    );
    // Vessels appear and disappear along a line, so that no line is a closed ring.
    let shown = smooth(l, l.fma(bend[0], s(SHOWN[0]), s(SHOWN[1])));
    l.mul(l.max(stem, l.mul(branch, beside)), shown)
}

/// Compute the texture of the wall at patient points `lps` (mm).
///
/// The texture depends on the point alone, so it stays on the tissue when the scope moves. Detail finer than
/// `footprint_mm`, the width of a pixel at the point, fades out.
#[inline(always)]
pub(super) fn texture<L: Lanes>(
    l: L,
    appearance: &Appearance,
    lps: [L::F; 3],
    footprint_mm: L::F,
) -> Texture<L> {
    let s = |v: f32| l.splat(v);
    let q = turn(l, &ASKEW, lps);
    let (mottled, bend) = noise(l, scaled(l, s(MOTTLE_PER_MM), q), SKIN_SEEDS[0]);
    let mottle = l.mul(mottled, s(appearance.texture));
    let (grain, slope) = noise(l, scaled(l, s(RELIEF_PER_MM), q), SKIN_SEEDS[1]);
    let (wrinkle, coarse) = noise(l, scaled(l, s(WRINKLES_PER_MM), q), SKIN_SEEDS[2]);
    let mut vessels = s(0.0);
    if appearance.vessels > 0.0 {
        vessels = vessel(l, (mottled, bend), (wrinkle, coarse), footprint_mm);
        vessels = l.mul(vessels, s(appearance.vessels));
    }
    let mut tint = [vessels; 3];
    for c in 0..3 {
        let [of_mottle, of_vessel] = SKIN_TINT[c];
        let without_mottle = l.fma(vessels, s(of_vessel), s(1.0));
        tint[c] = l.fma(mottle, s(of_mottle), without_mottle);
    }
    let slope_of = s(RELIEF * appearance.texture);
    let fine = l.mul(sharp(l, footprint_mm, RELIEF_PER_MM), slope_of);
    let wide = l.mul(sharp(l, footprint_mm, WRINKLES_PER_MM), slope_of);
    let mut relief = slope;
    for a in 0..3 {
        relief[a] = l.fma(slope[a], fine, l.mul(coarse[a], wide));
    }
    // The rotation from the lattice to the patient is the transpose of the rotation to the lattice.
    let back = from_fn::<_, 3, _>(|x| from_fn(|a| ASKEW[a][x]));
    let [of_grain, of_mottle, mean] = FILM_FROM;
    let film = l.fma(mottle, s(of_mottle), s(mean));
    let film = l.fma(l.mul(grain, fine), s(of_grain), film);
    Texture {
        tint,
        relief: turn(l, &back, relief),
        film: l.min(l.max(film, s(0.0)), s(1.0)),
        mottle: mottled,
        bumps: (wrinkle, coarse),
    }
}
