//! Wet surface of the wall: droplets in the film of mucus, and pools and bubbles of secretions.
//!
//! Droplets, pools and bubbles are decoration (drawn, not measured by the CT), and are fixed to the tissue like the
//! texture.

use std::array::from_fn;

use super::{
    lanes::Lanes,
    texture::{ASKEW, WRINKLES_PER_MM, noise},
    vectors::{along, dot, scaled, smooth, turn, unit},
};
use crate::{appearance::Appearance, shared_constants::shared_constants};

shared_constants! {
    /// Number of cells per mm of the noise that places pools of secretions on the wall.
    const POOLS_PER_MM: f32 = 0.2;
    /// Number of cells per mm of the noise that places bubbles in secretions.
    const BUBBLES_PER_MM: f32 = 1.5;
    /// Logarithm to base 2 of the exponent of the highlight on a droplet.
    ///
    /// A droplet is rounder than the film, so its highlight has a visible size.
    const DROP_LOG2: u32 = 5;
    /// Strength of the highlight of a droplet, as a fraction of the light that a guide gives at normal incidence.
    const DROP_GLINT: f32 = 1.2;
    /// Amount by which a film of thickness 1 lowers the height above which a bump of the mucosa's relief is drawn as a
    /// droplet.
    ///
    /// Droplets therefore form groups where the film is thick, with dry wall between the groups.
    const GATHER: f32 = 1.0;
    /// Strength of the highlight of a bubble, as a fraction of the light that a guide gives at normal incidence.
    const BUBBLE_GLINT: f32 = 2.4;
    /// Slope of a droplet's side.
    ///
    /// Along an airway only a steep side faces the scope; therefore a smooth film has no highlight there.
    const DROP_SLOPE: f32 = 1.4;
    /// Display colour of secretions, pale and slightly yellow.
    const SECRETIONS_RGB: [f32; 3] = [0.90, 0.84, 0.66];
    /// Opacity of a pool of secretions over the mucosa beneath it, 0 to 1.
    const COVER: f32 = 0.55;
    /// Change of a droplet's opacity per unit of the bump's height above [`DROP_FROM`].
    const DROP_EDGE: f32 = 3.0;
    /// Height from which a bump carries a droplet on a wall without film, 0 to 1.
    const DROP_FROM: f32 = 0.3 + 0.75 * GATHER;
    /// Noise value from which a bubble is drawn in a pool of secretions.
    const BUBBLE_FROM: f32 = 0.25;
    /// Slope and offset of the opacity of droplets and bubbles as a function of the pixel's size in noise cells.
    const FADES: [f32; 2] = [-5.0, 1.5];
    /// Slope and offset of the opacity of pools as a function of the normal's component to the patient's back.
    const FLOOR: [f32; 2] = [-2.5, -0.6];
    /// Slope and offset of the level of the pools as a function of the strength of the secretions.
    const POOL_LEVEL: [f32; 2] = [1.2, -0.8];
    /// Change of a pool's opacity at its edge per unit of the noise that places the pool.
    const POOL_EDGE: f32 = 5.0;
    /// Strength with which the surface of a pool is turned to horizontal, 0 to 1.
    const POOL_FLAT: f32 = 0.7;
    /// Seeds of the noises that place pools and bubbles.
    const WET_SEEDS: [i32; 2] = [61, 67];
}

/// Wet surface at points of the wall.
#[derive(Clone, Copy)]
pub(super) struct Film<L: Lanes> {
    /// Coverage by droplets and bubbles times the strength of their highlight.
    pub glint: L::F,
    /// Normal of the surface of droplets and bubbles.
    pub drop: [L::F; 3],
    /// Coverage by a pool of secretions, 0 to 1.
    pub pool: L::F,
}

/// Return the height of a noise bump above `from`, scaled to 0 to 1, and the normal of the bump's sides.
///
/// The second argument is the noise's value and slope; `n` is the normal of the wall.
#[inline(always)]
fn bump<L: Lanes>(
    l: L,
    (height, slope): (L::F, [L::F; 3]),
    from: L::F,
    n: [L::F; 3],
) -> (L::F, [L::F; 3]) {
    let s = |v: f32| l.splat(v);
    let back = from_fn::<_, 3, _>(|x| from_fn(|a| ASKEW[a][x]));
    let tilted = along(l, n, s(-DROP_SLOPE), turn(l, &back, slope));
    let above = smooth(l, l.mul(l.sub(height, from), s(DROP_EDGE)));
    (above, unit(l, tilted).0)
}

/// Return the opacity of droplets and bubbles, 0 to 1, from the size of a pixel in noise cells.
///
/// The visibility is 1 if a noise cell covers ten pixels or more. Below about three pixels the visibility is 0, because
/// a droplet would then be only a white dot.
#[inline(always)]
fn fades<L: Lanes>(l: L, footprint_mm: L::F, per_mm: f32) -> L::F {
    let cells = l.mul(footprint_mm, l.splat(per_mm));
    smooth(l, l.fma(cells, l.splat(FADES[0]), l.splat(FADES[1])))
}

/// Compute droplets, pools and bubbles at patient points `lps` with wall normals `n` on the scope's side.
///
/// Droplets finer than a few pixels fade out; `footprint_mm` is the width of a pixel at the wall. Droplets form where
/// the film is `thick` and the coarse relief is high; `bumps` are value and slope of that relief. A separate noise for
/// droplets would take longer than the remaining function.
#[inline(always)]
pub(super) fn film<L: Lanes>(
    l: L,
    appearance: &Appearance,
    lps: [L::F; 3],
    n: [L::F; 3],
    footprint_mm: L::F,
    thick: L::F,
    bumps: (L::F, [L::F; 3]),
) -> Film<L> {
    let s = |v: f32| l.splat(v);
    let q = turn(l, &ASKEW, lps);
    let mut film = Film {
        glint: s(0.0),
        drop: n,
        pool: s(0.0),
    };
    let near = fades(l, footprint_mm, WRINKLES_PER_MM);
    if appearance.specks > 0.0 && l.bits(l.less(s(0.0), near)) != 0 {
        let from = l.fma(thick, s(-GATHER), s(DROP_FROM));
        let (above, drop) = bump(l, bumps, from, n);
        film.drop = drop;
        film.glint = l.mul(l.mul(above, near), s(DROP_GLINT * appearance.specks));
    }
    if appearance.secretions > 0.0 {
        // The lowest wall in a supine patient is the one whose normal points to the front, LPS -y.
        let floor = smooth(l, l.fma(n[1], s(FLOOR[0]), s(FLOOR[1])));
        let (level, _) = noise(l, scaled(l, s(POOLS_PER_MM), q), WET_SEEDS[0]);
        let filled = l.add(
            level,
            s(appearance.secretions.mul_add(POOL_LEVEL[0], POOL_LEVEL[1])),
        );
        film.pool = l.mul(floor, smooth(l, l.mul(filled, s(POOL_EDGE))));
        let bubbles = noise(l, scaled(l, s(BUBBLES_PER_MM), q), WET_SEEDS[1]);
        let (above, bubble) = bump(l, bubbles, s(BUBBLE_FROM), n);
        let here = l.mul(
            l.mul(above, fades(l, footprint_mm, BUBBLES_PER_MM)),
            film.pool,
        );
        let inside = l.less(s(0.0), here);
        film.glint = l.select(inside, l.mul(here, s(BUBBLE_GLINT)), film.glint);
        for a in 0..3 {
            film.drop[a] = l.select(inside, bubble[a], film.drop[a]);
        }
    }
    film
}

impl<L: Lanes> Film<L> {
    /// Blend the mucosa's linear colour with the colour of a pool, and the film's normal with the pool's horizontal
    /// surface.
    #[inline(always)]
    pub(super) fn fill(self, l: L, colour: &mut [L::F; 3], n_film: &mut [L::F; 3]) {
        let s = |v: f32| l.splat(v);
        let cover = l.mul(self.pool, s(COVER));
        for c in 0..3 {
            let pale = s(SECRETIONS_RGB[c] * SECRETIONS_RGB[c]);
            colour[c] = l.fma(cover, l.sub(pale, colour[c]), colour[c]);
        }
        // The surface of a fluid is horizontal; in a supine patient its normal points to the front.
        let level = [s(0.0), s(-1.0), s(0.0)];
        let mut mixed = *n_film;
        for a in 0..3 {
            mixed[a] = l.fma(
                l.mul(self.pool, s(POOL_FLAT)),
                l.sub(level[a], n_film[a]),
                n_film[a],
            );
        }
        *n_film = unit(l, mixed).0;
    }

    /// Return the strength of the highlight of droplets and bubbles towards the scope.
    ///
    /// `half` is the half-way vector between the directions to the scope and to a light.
    #[inline(always)]
    pub(super) fn towards(self, l: L, half: [L::F; 3]) -> L::F {
        let mut highlight = l.max(dot(l, self.drop, half), l.splat(0.0));
        for _ in 0..DROP_LOG2 {
            highlight = l.mul(highlight, highlight);
        }
        l.mul(highlight, self.glint)
    }
}
