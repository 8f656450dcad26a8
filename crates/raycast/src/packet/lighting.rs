//! Shading of the first walls of packets; the model is described in [`crate::appearance`].

use std::{array::from_fn, iter::once};

#[cfg(target_arch = "x86_64")]
use super::{avx2::Avx2, avx512::Avx512, pair::Pair};
use super::{
    film::film,
    lanes::{Array, Lanes, MAX_LANES},
    mist::{MIST_RGB, mist},
    portable::Portable,
    rings::{Wall, decorate},
    setup::{Directions, deltas_of},
    slopes::rise,
    texture::texture,
    vectors::{along, dot, scaled, smooth, splat, turn, unit},
    voxels::Voxels,
};
use crate::{
    Decoration, Field, Frame, InstructionSet, composite::Gathered, lighting::Lighting,
    shared_constants::shared_constants,
};

shared_constants! {
    /// Squared radius of the end of a light guide, mm2, which limits the inverse square for a wall that touches the guide.
    const GUIDE_MM2: f32 = 2.5;
    /// Depth beneath the wall's surface at which the tissue is sampled, mm; the cartilage of an airway is at this depth.
    const BENEATH_MM: f32 = 1.4;
    /// Display colour of mucosa over cartilage.
    const PALE_RGB: [f32; 3] = [0.98, 0.79, 0.72];
    /// Linear colour of light that has been reflected from one wall to another.
    const TINT_RGB: [f32; 3] = [1.0, 0.42, 0.32];
    /// Linear light that is displayed as white.
    const WHITE: f32 = 3.6;
    /// Strength of the darkening of dark tones, 0 to 1.
    const TOE: f32 = 0.65;
    /// Thickness of the film of mucus on a wall without texture, 0 to 1.
    const MEAN_FILM: f32 = 0.75;
    /// Length of a gradient, in HU over the distance of its samples, below which tissue is flat and has no normal.
    const FLAT_SLOPE: f32 = 1e-3;
    /// Weights of red, green and blue in the brightness from which the exposure is computed, close to the sensitivity
    /// of the eye.
    const LUMINANCE: [f32; 3] = [0.3, 0.6, 0.1];
}

/// Source of interpolated voxel values at positions in voxel coordinates.
pub(super) trait Values<L: Lanes>: Copy {
    fn at(self, l: L, p: [L::F; 3]) -> L::F;
}

impl<L: Lanes> Values<L> for Voxels<'_> {
    #[inline(always)]
    fn at(self, l: L, p: [L::F; 3]) -> L::F {
        self.value(l, &self.cells(l, p))
    }
}

/// Reader of voxel values, one lane after another, for volumes whose memory order packets cannot read.
impl<L: Lanes> Values<L> for &Field<'_> {
    fn at(self, l: L, p: [L::F; 3]) -> L::F {
        let p = p.map(|p| l.store(p));
        load(l, &from_fn(|n| self.value([p[0][n], p[1][n], p[2][n]])))
    }
}

#[inline(always)]
fn load<L: Lanes>(l: L, values: &Array<f32>) -> L::F {
    l.fill(l.splat(0.0), ((1u64 << L::N) - 1) as u32, values)
}

/// Return the gradient of the volume round positions `p`, in LPS, from the slopes in the bricks (docs/decisions/0132).
#[inline(always)]
fn inward<L: Lanes>(l: L, light: &Lighting, field: &Field<'_>, p: [L::F; 3]) -> [L::F; 3] {
    turn(l, &light.normals.rows, rise(l, &light.bricks, field, p))
}

/// Return the linear colour of shaded walls, before the tone curve.
///
/// `walls.hit` must be 0 or more in all lanes.
#[inline(always)]
fn lit<L: Lanes>(
    l: L,
    light: &Lighting,
    decoration: Option<&Decoration<'_>>,
    (values, field): (impl Values<L>, &Field<'_>),
    walls: &Walls<L>,
) -> [L::F; 3] {
    let s = |v: f32| l.splat(v);
    let (delta, hit, albedo) = (walls.delta, walls.hit, walls.albedo);
    let appearance = &light.appearance;
    let p = along(l, splat(l, light.origin_ijk), hit, delta);
    let step = turn(l, &light.lps_from_ijk, delta);
    // The vector in mm from the camera's centre to the wall.
    let offset = scaled(l, hit, step);
    let back = scaled(l, s(-1.0 / light.step_mm), step);
    let depth = l.mul(hit, s(light.step_mm));

    // The normal is on the camera's side; flat tissue faces the camera.
    let gradient = inward(l, light, field, p);
    let (n, steep) = unit(l, gradient);
    let away = l.less(s(0.0), dot(l, n, back));
    let side = l.select(away, s(1.0), s(-1.0));
    let flat = l.less(steep, s(FLAT_SLOPE));
    let mut normal = n;
    for a in 0..3 {
        normal[a] = l.select(flat, back[a], l.mul(side, n[a]));
    }
    let n = normal;

    // Mucosa is paler where it covers cartilage, that is, where the CT is dense beneath it.
    let into = turn(l, &light.ijk_from_lps, n);
    let dense = values.at(l, along(l, p, s(-BENEATH_MM), into));
    let [from, to] = appearance.pale_hu;
    let pale = l.mul(l.sub(dense, s(from)), s(1.0 / (to - from)));
    let mut pale = l.mul(smooth(l, pale), s(appearance.paleness));

    let mut n = n;
    let mut n_film = n;
    let mut thick = s(MEAN_FILM);
    let mut tint = [s(1.0); 3];
    let mut bumps = (s(0.0), [s(0.0); 3]);
    let mut lps = along(l, splat(l, light.camera_lps), s(1.0), offset);
    if let Some((matrix, origin)) = &light.rest_from_lps {
        // Texture, decoration and film are fixed to the tissue, so they are looked up at its place at rest.
        lps = along(l, splat(l, *origin), s(1.0), turn(l, matrix, lps));
    }
    let footprint = l.mul(depth, s(light.pixel_mm));
    let decoration = decoration.filter(|_| appearance.knows_anatomy());
    let textured = appearance.texture > 0.0 || appearance.vessels > 0.0 || appearance.specks > 0.0;
    if textured || decoration.is_some() {
        let skin = texture(l, appearance, lps, footprint);
        (thick, tint, bumps) = (skin.film, skin.tint, skin.bumps);
        if let Some(field) = decoration {
            let wall = Wall {
                lps,
                normal: n,
                facing: l.abs(dot(l, n, back)),
                footprint_mm: footprint,
            };
            let laid = decorate(l, appearance, field, &wall, &skin);
            n = unit(l, along(l, n, s(-1.0), laid.form)).0;
            pale = l.fma(l.sub(s(1.0), pale), laid.pale, pale);
            for c in 0..3 {
                tint[c] = l.mul(tint[c], laid.tint[c]);
            }
        }
        n_film = unit(l, along(l, n, s(-1.0), skin.relief)).0;
    }
    let mut colour = albedo;
    for c in 0..3 {
        let shown = l.fma(pale, l.sub(s(PALE_RGB[c]), albedo[c]), albedo[c]);
        colour[c] = l.mul(l.mul(shown, shown), tint[c]);
    }
    // Half of the relief also affects the diffuse light.
    let n_matt = unit(l, along(l, n, s(1.0), n_film)).0;
    // This is not a closure, because a closure would be compiled without the instruction set, with a call for each
    // operation.
    let wet = if appearance.specks > 0.0 || appearance.secretions > 0.0 {
        Some(film(l, appearance, lps, n, footprint, thick, bumps))
    } else {
        None
    };
    if let Some(wet) = wet
        && appearance.secretions > 0.0
    {
        wet.fill(l, &mut colour, &mut n_film);
    }

    let (mut direct, mut round, mut gloss, mut glints) = (s(0.0), s(0.0), s(0.0), s(0.0));
    for guide in light.guides {
        let mut to_guide = offset;
        for a in 0..3 {
            to_guide[a] = l.sub(s(guide[a]), offset[a]);
        }
        let (dir, _) = unit(l, to_guide);
        let square = l.add(dot(l, to_guide, to_guide), s(GUIDE_MM2));
        let strength = l.div(s(0.5 * light.exposure), square);
        let facing = dot(l, n_matt, dir);
        let facing = l.mul(
            l.add(facing, s(appearance.wrap)),
            s(1.0 / (1.0 + appearance.wrap)),
        );
        direct = l.fma(strength, l.max(facing, s(0.0)), direct);
        round = l.add(round, strength);
        let (half, _) = unit(l, along(l, back, s(1.0), dir));
        let mut highlight = l.max(dot(l, n_film, half), s(0.0));
        for _ in 0..appearance.shininess_log2 {
            highlight = l.mul(highlight, highlight);
        }
        gloss = l.fma(strength, highlight, gloss);
        if let Some(wet) = wet {
            glints = l.fma(strength, wet.towards(l, half), glints);
        }
    }
    let gloss = l.fma(l.mul(gloss, thick), s(appearance.gloss), glints);
    let round = l.mul(round, s(appearance.ambient));
    let mut out = colour;
    for c in 0..3 {
        let received = l.fma(round, s(TINT_RGB[c]), direct);
        out[c] = l.fma(colour[c], received, gloss);
    }
    out
}

/// Shade rows of gathered pixels, from `first_row` on, as 8-bit colours.
///
/// The result is equal on every instruction set, bit for bit.
pub(crate) fn light_rows(
    frame: &Frame<'_>,
    light: &Lighting,
    simd: InstructionSet,
    first_row: usize,
    gathered: &[Gathered],
    rgb: &mut [u8],
) {
    let width = frame.camera().width();
    let voxels = Voxels::of(&frame.field);
    let rows = gathered.chunks(width).zip(rgb.chunks_mut(3 * width));
    for (row, (gathered, rgb)) in rows.enumerate() {
        let row = first_row + row;
        match (simd, voxels) {
            #[cfg(target_arch = "x86_64")]
            // SAFETY: an `InstructionSet` value exists only on a machine that has the instructions of that set.
            // Benchmark: benchmarks/measurements/rendering.md.
            (InstructionSet::Avx512, Some(voxels)) => unsafe {
                light_row_avx512(frame, light, voxels, row, gathered, rgb);
            },
            #[cfg(target_arch = "x86_64")]
            // SAFETY: an `InstructionSet` value exists only on a machine that has the instructions of that set.
            (InstructionSet::Avx2, Some(voxels)) => unsafe {
                light_row_avx2(frame, light, voxels, row, gathered, rgb);
            },
            (_, Some(voxels)) => light_row(Portable, frame, light, voxels, row, gathered, rgb),
            (_, None) => light_row(Portable, frame, light, &frame.field, row, gathered, rgb),
        }
    }
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx512f,avx512bw,avx512dq,avx512vl,avx2,fma,bmi1,bmi2,lzcnt,popcnt")]
fn light_row_avx512(
    frame: &Frame<'_>,
    light: &Lighting,
    voxels: Voxels<'_>,
    row: usize,
    gathered: &[Gathered],
    rgb: &mut [u8],
) {
    // SAFETY: this function runs only on a machine with the instructions of its target features.
    let l = Pair(unsafe { Avx512::new(false) });
    light_row(l, frame, light, voxels, row, gathered, rgb);
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2,fma,bmi1,bmi2,lzcnt,popcnt")]
fn light_row_avx2(
    frame: &Frame<'_>,
    light: &Lighting,
    voxels: Voxels<'_>,
    row: usize,
    gathered: &[Gathered],
    rgb: &mut [u8],
) {
    // SAFETY: this function runs only on a machine with the instructions of its target features.
    let l = Pair(unsafe { Avx2::new(false) });
    light_row(l, frame, light, voxels, row, gathered, rgb);
}

#[inline(always)]
fn light_row<L: Lanes>(
    l: L,
    frame: &Frame<'_>,
    light: &Lighting,
    values: impl Values<L>,
    row: usize,
    gathered: &[Gathered],
    rgb: &mut [u8],
) {
    let s = |v: f32| l.splat(v);
    let (rgb, _) = rgb.as_chunks_mut::<3>();
    for (block, (pixels, out)) in gathered.chunks(L::N).zip(rgb.chunks_mut(L::N)).enumerate() {
        let misty = light.appearance.fog > 0.0;
        if !misty && pixels.iter().all(|pixel| pixel.hit < 0.0) {
            for (pixel, out) in pixels.iter().zip(out) {
                *out = unlit(pixel).to_rgb8(light.background);
            }
            continue;
        }
        let columns = block * L::N..block * L::N + pixels.len();
        let directions = Directions::of(frame, once((columns, row..row + 1)));
        let walls = gather(l, &deltas_of(frame, &directions), pixels);
        let decoration = frame.decoration.as_ref();
        let colour = lit(l, light, decoration, (values, &frame.field), &walls);
        let veil = if misty {
            let met = pixels.iter().enumerate().fold(0, |bits, (n, pixel)| {
                bits | u32::from(pixel.hit >= 0.0) << n
            });
            Some((mist(l, light, walls.delta), l.mask(met)))
        } else {
            None
        };
        let mut shown = [[0; MAX_LANES]; 3];
        for c in 0..3 {
            // Bright light is compressed as in a camera: x (1 + x / white^2) / (1 + x).
            let x = colour[c];
            let tone = l.div(
                l.mul(x, l.fma(x, s(1.0 / (WHITE * WHITE)), s(1.0))),
                l.add(x, s(1.0)),
            );
            let v = l.sqrt(l.max(tone, s(0.0)));
            // The toe of the tone curve darkens dark tones further.
            let v = l.mul(v, l.fma(v, s(TOE), s(1.0 - TOE)));
            let behind = s(light.background[c]);
            let mut v = l.fma(walls.transparency, l.sub(behind, v), v);
            if let Some((veil, met)) = veil {
                // A ray without a wall ends in the dark; the mist on the lens is visible there, too.
                let dark = l.mul(walls.transparency, behind);
                v = l.select(met, v, dark);
                v = l.fma(veil, l.sub(s(MIST_RGB[c]), v), v);
            }
            let v = l.fma(v, s(255.0), s(0.5));
            shown[c] = l.store_i(l.whole(l.min(l.max(v, s(0.0)), s(255.0))));
        }
        for (n, (pixel, out)) in pixels.iter().zip(out).enumerate() {
            *out = if pixel.hit < 0.0 && !misty {
                unlit(pixel).to_rgb8(light.background)
            } else {
                [shown[0][n] as u8, shown[1][n] as u8, shown[2][n] as u8]
            };
        }
    }
}

/// Return a pixel without colour for a lane without a wall; its wall is set far away, so it gets no light.
fn unlit(pixel: &Gathered) -> Gathered {
    Gathered {
        rgb: [0.0; 3],
        ..*pixel
    }
}

/// First walls of gathered rays, one per lane, whose shading is to be computed.
struct Walls<L: Lanes> {
    delta: [L::F; 3],
    /// Distance from the camera to the wall in steps; 0 in lanes without a wall.
    hit: L::F,
    transparency: L::F,
    /// Colour of the wall before shading, not multiplied by its opacity.
    albedo: [L::F; 3],
}

#[inline(always)]
fn gather<L: Lanes>(l: L, delta: &[Array<f32>; 3], pixels: &[Gathered]) -> Walls<L> {
    let (mut rgb, mut transparency, mut hit) =
        ([[0.0; MAX_LANES]; 3], [0.0; MAX_LANES], [0.0; MAX_LANES]);
    for (n, pixel) in pixels.iter().enumerate() {
        for c in 0..3 {
            rgb[c][n] = pixel.rgb[c];
        }
        transparency[n] = pixel.transparency;
        hit[n] = pixel.hit.max(0.0);
    }
    let transparency = load(l, &transparency);
    let opacity = l.max(l.sub(l.splat(1.0), transparency), l.splat(1e-6));
    let mut step = [transparency; 3];
    let mut albedo = step;
    for a in 0..3 {
        step[a] = load(l, &delta[a]);
        albedo[a] = l.div(load(l, &rgb[a]), opacity);
    }
    Walls {
        delta: step,
        hit: load(l, &hit),
        transparency,
        albedo,
    }
}

/// Return the reflected light of pixels (column, row, gathered ray), from which the automatic exposure is computed.
///
/// The light is computed with an exposure of 1 and without decoration.
pub(crate) fn brightness(
    frame: &Frame<'_>,
    light: &Lighting,
    pixels: &[(usize, usize, Gathered)],
) -> Vec<f32> {
    let l = Portable;
    let mut plain = light.clone();
    plain.appearance = plain.appearance.undecorated();
    (plain.appearance.gloss, plain.exposure) = (0.0, 1.0);
    let mut out = Vec::with_capacity(pixels.len());
    for pixels in pixels.chunks(Portable::N) {
        let places = pixels
            .iter()
            .map(|&(column, row, _)| (column..column + 1, row..row + 1));
        let directions = Directions::of(frame, places);
        let gathered: Vec<Gathered> = pixels.iter().map(|pixel| pixel.2).collect();
        let walls = gather(l, &deltas_of(frame, &directions), &gathered);
        let [r, g, b] = lit(l, &plain, None, (&frame.field, &frame.field), &walls);
        let weights = splat(l, LUMINANCE);
        out.extend_from_slice(&l.store(dot(l, [r, g, b], weights))[..pixels.len()]);
    }
    out
}
