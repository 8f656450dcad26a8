//! What is wet: droplets in the film of mucus, and secretions. All of it is decoration, fixed to the tissue like texture.

use std::array::from_fn;

use super::{
    lanes::Lanes,
    texture::{ASKEW, WRINKLES_PER_MM, noise},
    vectors::{along, dot, scaled, smooth, turn, unit},
};
use crate::appearance::Appearance;

/// Cells of the noise per mm: pools of secretions, bubbles.
const POOLS_PER_MM: f32 = 0.2;
const BUBBLES_PER_MM: f32 = 1.5;
/// The highlight's exponent on a droplet is 2 to this: it is rounder than the film, so that its glint has a size.
const DROP_LOG2: u32 = 5;
/// Glint of a droplet as part of what a guide gives head on.
const DROP_GLINT: f32 = 1.2;
/// How much lower a bump may be to carry a droplet where the film is 1 thicker: droplets gather, and leave walls dry between.
const GATHER: f32 = 1.0;
const BUBBLE_GLINT: f32 = 2.4;
/// Slope of a droplet's side. Along an airway only a steep side faces the scope, which is why a smooth film has no
/// highlight there.
const DROP_SLOPE: f32 = 1.4;
/// Display colour of secretions, pale and a little yellow.
const SECRETIONS_RGB: [f32; 3] = [0.90, 0.84, 0.66];
/// How much of it covers the mucosa beneath a pool.
const COVER: f32 = 0.55;

/// The wet surface at points of the wall.
#[derive(Clone, Copy)]
pub(super) struct Film<L: Lanes> {
    /// Droplets and bubbles: how much of one is there, times the strength of its glint.
    pub glint: L::F,
    /// Their surface's normal.
    pub drop: [L::F; 3],
    /// How much of a pool is there, 0..1.
    pub pool: L::F,
}

/// A bump of noise with this value and slope: how far it stands above `from`, 0..1, and the normal of its sides.
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
    let above = smooth(l, l.mul(l.sub(height, from), s(3.0)));
    (above, unit(l, tilted).0)
}

/// 1 while a cell of the noise has ten pixels or more, 0 when it has hardly three: farther away a droplet is a white dot.
#[inline(always)]
fn fades<L: Lanes>(l: L, footprint_mm: L::F, per_mm: f32) -> L::F {
    let cells = l.mul(footprint_mm, l.splat(per_mm));
    smooth(l, l.fma(cells, l.splat(-5.0), l.splat(1.5)))
}

/// The wet surface at patient points `lps` with normals `n` on the scope's side. Droplets finer than a few pixels,
/// whose width there is `footprint_mm`, fade out. They hang where the film is `thick` and the coarse relief, of which `bumps` are value
/// and slope, stands out: noise of their own would cost more than all else of them.
#[inline(always)]
pub(super) fn film<L: Lanes>(
    l: L,
    look: &Appearance,
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
    if look.specks > 0.0 && l.bits(l.less(s(0.0), near)) != 0 {
        let from = l.fma(thick, s(-GATHER), s(0.3 + 0.75 * GATHER));
        let (above, drop) = bump(l, bumps, from, n);
        film.drop = drop;
        film.glint = l.mul(l.mul(above, near), s(DROP_GLINT * look.specks));
    }
    if look.secretions > 0.0 {
        // The floor of an airway in a supine patient: the wall that looks to the front, LPS -y.
        let floor = smooth(l, l.fma(n[1], s(-2.5), s(-0.6)));
        let (level, _) = noise(l, scaled(l, s(POOLS_PER_MM), q), 61);
        let filled = l.add(level, s(look.secretions.mul_add(1.2, -0.8)));
        film.pool = l.mul(floor, smooth(l, l.mul(filled, s(5.0))));
        let bubbles = noise(l, scaled(l, s(BUBBLES_PER_MM), q), 67);
        let (above, bubble) = bump(l, bubbles, s(0.25), n);
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
    /// The colour of the mucosa (linear) seen through a pool, and the level surface of the pool in place of the film's.
    #[inline(always)]
    pub(super) fn fill(self, l: L, colour: &mut [L::F; 3], n_film: &mut [L::F; 3]) {
        let s = |v: f32| l.splat(v);
        let cover = l.mul(self.pool, s(COVER));
        for c in 0..3 {
            let pale = s(SECRETIONS_RGB[c] * SECRETIONS_RGB[c]);
            colour[c] = l.fma(cover, l.sub(pale, colour[c]), colour[c]);
        }
        // What flows lies level, which the front of a supine patient is.
        let level = [s(0.0), s(-1.0), s(0.0)];
        let mut mixed = *n_film;
        for a in 0..3 {
            mixed[a] = l.fma(
                l.mul(self.pool, s(0.7)),
                l.sub(level[a], n_film[a]),
                n_film[a],
            );
        }
        *n_film = unit(l, mixed).0;
    }

    /// The glint towards the scope, where `half` lies half-way between it and a light.
    #[inline(always)]
    pub(super) fn towards(self, l: L, half: [L::F; 3]) -> L::F {
        let mut highlight = l.max(dot(l, self.drop, half), l.splat(0.0));
        for _ in 0..DROP_LOG2 {
            highlight = l.mul(highlight, highlight);
        }
        l.mul(highlight, self.glint)
    }
}
