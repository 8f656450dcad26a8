//! Lighting of the first walls: see `appearance`.

use std::array::from_fn;

#[cfg(target_arch = "x86_64")]
use super::{avx2::Avx2, avx512::Avx512};
use super::{
    lanes::{Array, Lanes, MAX_LANES},
    pair::Pair,
    portable::Portable,
    setup::rays_of,
    voxels::Voxels,
};
use crate::{
    Field, Frame, InstructionSet,
    appearance::{Appearance, Lighting},
    composite::Gathered,
    surface::{AXIS_AT, AXIS_WEIGHT, CORNER_AT, CORNER_WEIGHT},
};

/// Squared radius of a light guide's end, mm2: the inverse square does not run away where a wall touches it.
const GUIDE_MM2: f32 = 2.5;
/// Depth at which the tissue beneath the surface is looked at, mm: the cartilage of an airway lies there.
const BENEATH_MM: f32 = 1.4;
/// Display colour of mucosa over cartilage.
const PALE_RGB: [f32; 3] = [0.98, 0.79, 0.72];
/// Linear colour of light that has met a wall before.
const TINT_RGB: [f32; 3] = [1.0, 0.42, 0.32];
/// Cells of the texture's noise per mm: mottling, vessels, micro relief.
const MOTTLE_PER_MM: f32 = 0.23;
const VESSELS_PER_MM: f32 = 0.42;
const RELIEF_PER_MM: f32 = 1.9;
/// Half the width of a vessel, mm.
const VESSEL_MM: f32 = 0.13;
/// Slope of the micro relief.
const RELIEF: f32 = 0.11;
/// Linear light that is shown as white.
const WHITE: f32 = 3.0;
/// How far dark tones are pressed down, 0..1.
const TOE: f32 = 0.4;

/// Values of a volume at positions in voxels.
pub(super) trait Values<L: Lanes>: Copy {
    fn at(self, l: L, p: [L::F; 3]) -> L::F;
}

impl<L: Lanes> Values<L> for Voxels<'_> {
    #[inline(always)]
    fn at(self, l: L, p: [L::F; 3]) -> L::F {
        self.value(l, &self.cells(l, p))
    }
}

/// The same, one by one, for volumes that packets cannot read.
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

#[inline(always)]
fn dot<L: Lanes>(l: L, u: [L::F; 3], v: [L::F; 3]) -> L::F {
    l.fma(u[2], v[2], l.fma(u[1], v[1], l.mul(u[0], v[0])))
}

/// The same numbers in all lanes.
#[inline(always)]
fn splat<L: Lanes>(l: L, v: [f32; 3]) -> [L::F; 3] {
    [l.splat(v[0]), l.splat(v[1]), l.splat(v[2])]
}

/// `t v`.
#[inline(always)]
fn scaled<L: Lanes>(l: L, t: L::F, v: [L::F; 3]) -> [L::F; 3] {
    [l.mul(v[0], t), l.mul(v[1], t), l.mul(v[2], t)]
}

/// `rows . v`.
#[inline(always)]
fn turn<L: Lanes>(l: L, rows: &[[f32; 3]; 3], v: [L::F; 3]) -> [L::F; 3] {
    let mut out = v;
    for x in 0..3 {
        out[x] = dot(l, splat(l, rows[x]), v);
    }
    out
}

/// `p + t v`.
#[inline(always)]
fn along<L: Lanes>(l: L, p: [L::F; 3], t: L::F, v: [L::F; 3]) -> [L::F; 3] {
    let mut out = p;
    for a in 0..3 {
        out[a] = l.fma(t, v[a], p[a]);
    }
    out
}

/// The vector at unit length; anything where it has none.
#[inline(always)]
fn unit<L: Lanes>(l: L, v: [L::F; 3]) -> ([L::F; 3], L::F) {
    let length = l.sqrt(dot(l, v, v));
    let inverse = l.div(l.splat(1.0), l.max(length, l.splat(1e-12)));
    (scaled(l, inverse, v), length)
}

/// 0 below 0, 1 above 1, smooth between.
#[inline(always)]
fn smooth<L: Lanes>(l: L, t: L::F) -> L::F {
    let t = l.min(l.max(t, l.splat(0.0)), l.splat(1.0));
    l.mul(l.mul(t, t), l.fma(t, l.splat(-2.0), l.splat(3.0)))
}

/// The value on one side of `p` less that on the other, both held in a range.
#[inline(always)]
fn across<L: Lanes>(
    l: L,
    values: impl Values<L>,
    (p, off, reach): ([L::F; 3], [f32; 3], [L::F; 3]),
    (low, high): (L::F, L::F),
) -> L::F {
    let (mut before, mut after) = (p, p);
    for a in 0..3 {
        if off[a] != 0.0 {
            before[a] = l.fma(l.splat(-off[a]), reach[a], p[a]);
            after[a] = l.fma(l.splat(off[a]), reach[a], p[a]);
        }
    }
    let before = l.min(l.max(values.at(l, before), low), high);
    l.sub(l.min(l.max(values.at(l, after), low), high), before)
}

/// Gradient of the volume round `p` in LPS, as in `Normals::at`.
#[inline(always)]
fn inward<L: Lanes>(l: L, light: &Lighting, values: impl Values<L>, p: [L::F; 3]) -> [L::F; 3] {
    let [low, high] = light.normals.held;
    let (low, high) = (l.splat(low), l.splat(high));
    let reach = splat(l, light.normals.reach);
    let mut rise = p;
    for a in 0..3 {
        let mut off = [0.0; 3];
        off[a] = AXIS_AT;
        rise[a] = l.mul(
            l.splat(AXIS_WEIGHT),
            across(l, values, (p, off, reach), (low, high)),
        );
    }
    for corner in 0..4 {
        let side = [1.0, [1.0f32, -1.0][corner & 1], [1.0f32, -1.0][corner >> 1]];
        let off = [
            side[0] * CORNER_AT,
            side[1] * CORNER_AT,
            side[2] * CORNER_AT,
        ];
        let step = l.mul(
            l.splat(CORNER_WEIGHT),
            across(l, values, (p, off, reach), (low, high)),
        );
        for a in 0..3 {
            rise[a] = l.fma(l.splat(side[a]), step, rise[a]);
        }
    }
    turn(l, &light.normals.rows, rise)
}

#[inline(always)]
fn lerp<L: Lanes>(l: L, t: L::F, a: L::F, b: L::F) -> L::F {
    l.fma(t, l.sub(b, a), a)
}

/// x (2 x + 1), which permutes 32-bit numbers.
#[inline(always)]
fn mix<L: Lanes>(l: L, x: L::I) -> L::I {
    l.mul_i(x, l.add_i(l.add_i(x, x), l.splat_i(1)))
}

/// A number -1..1 for a corner of the lattice. Mixed twice, the high bits have no pattern that an eye finds.
#[inline(always)]
fn corner<L: Lanes>(l: L, at: [[L::I; 2]; 3], [i, j, k]: [usize; 3]) -> L::F {
    let sum = l.add_i(l.add_i(at[0][i], at[1][j]), at[2][k]);
    let mixed = mix(l, l.add_i(mix(l, sum), l.splat_i(0x6d2b_79f5)));
    l.mul(l.to_f(mixed), l.splat(1.0 / 2_147_483_648.0))
}

/// Noise of the integer lattice, -1..1, and its slope; smooth to the second derivative.
#[inline(always)]
fn noise<L: Lanes>(l: L, q: [L::F; 3], seed: i32) -> (L::F, [L::F; 3]) {
    // Odd numbers without a pattern.
    const PRIMES: [i32; 3] = [
        0x0019_660d_u32 as i32,
        0x9e37_79b1_u32 as i32,
        0x85eb_ca77_u32 as i32,
    ];
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
        let inner = l.fma(x, l.fma(x, s(6.0), s(-15.0)), s(10.0));
        t[a] = l.mul(l.mul(l.mul(x, x), x), inner);
        let y = l.mul(x, l.sub(x, one));
        slope[a] = l.mul(s(30.0), l.mul(y, y));
    }
    // Rows along x, then their slopes along x, y, z.
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

/// The texture of a wall at a point of the patient.
#[derive(Clone, Copy)]
pub(super) struct Texture<L: Lanes> {
    /// Factors of the colour's channels, linear.
    pub tint: [L::F; 3],
    /// Slope of the micro relief, LPS.
    pub relief: [L::F; 3],
    /// How thick the film of mucus is, 0..1.
    pub film: L::F,
}

/// The lattice lies askew in the patient, so that no row of it runs along an airway.
const ASKEW: [[f32; 3]; 3] = [[0.36, 0.48, -0.8], [-0.8, 0.60, 0.0], [0.48, 0.64, 0.60]];

/// 1 while a cell of the lattice has 2 pixels or more, 0 when it has less than one.
#[inline(always)]
fn sharp<L: Lanes>(l: L, footprint_mm: L::F, per_mm: f32) -> L::F {
    let cells = l.mul(footprint_mm, l.splat(per_mm));
    smooth(l, l.fma(cells, l.splat(-2.0), l.splat(2.0)))
}

/// How much of a vessel, 0..1, is at points `q` of the lattice (mm), whose mottling there has the slope `bend`.
#[inline(always)]
fn vessel<L: Lanes>(l: L, q: [L::F; 3], bend: [L::F; 3], footprint_mm: L::F) -> L::F {
    let s = |v: f32| l.splat(v);
    // Vessels follow the zero lines of noise whose lattice the mottling bends.
    let mut bent = scaled(l, s(VESSELS_PER_MM), q);
    for a in 0..3 {
        bent[a] = l.fma(bend[a], s(0.35), bent[a]);
    }
    let (web, across) = noise(l, bent, 23);
    // Distance to the line, mm; where the noise is flat there is a patch in place of a line, which is left out.
    let steep = l.sqrt(dot(l, across, across));
    let off_mm = l.div(l.abs(web), l.mul(l.max(steep, s(0.2)), s(VESSELS_PER_MM)));
    let width = l.max(s(VESSEL_MM), l.mul(footprint_mm, s(0.7)));
    let vessel = smooth(l, l.sub(s(1.0), l.div(off_mm, width)));
    let vessel = l.mul(vessel, smooth(l, l.fma(steep, s(1.5), s(-0.6))));
    // Thin vessels seen from afar are paler, not wider; and they come and go.
    let vessel = l.mul(vessel, l.div(s(VESSEL_MM), width));
    l.mul(vessel, smooth(l, l.fma(bend[0], s(0.7), s(0.35))))
}

/// Reads the texture at patient points `lps` (mm). It depends on the point alone, so it stays on the tissue when the scope
/// moves; detail finer than `footprint_mm`, the width of a pixel there, fades out.
#[inline(always)]
pub(super) fn texture<L: Lanes>(
    l: L,
    look: &Appearance,
    lps: [L::F; 3],
    footprint_mm: L::F,
) -> Texture<L> {
    let s = |v: f32| l.splat(v);
    let q = turn(l, &ASKEW, lps);
    let (mottle, bend) = noise(l, scaled(l, s(MOTTLE_PER_MM), q), 11);
    let mottle = l.mul(mottle, s(look.texture));
    let mut vessels = s(0.0);
    if look.vessels > 0.0 {
        vessels = l.mul(vessel(l, q, bend, footprint_mm), s(look.vessels));
    }
    let tint = [
        l.fma(mottle, s(0.03), l.fma(vessels, s(-0.08), s(1.0))),
        l.fma(mottle, s(-0.11), l.fma(vessels, s(-0.40), s(1.0))),
        l.fma(mottle, s(-0.09), l.fma(vessels, s(-0.30), s(1.0))),
    ];
    let (grain, slope) = noise(l, scaled(l, s(RELIEF_PER_MM), q), 37);
    let (_, coarse) = noise(l, scaled(l, s(0.45 * RELIEF_PER_MM), q), 41);
    let slope_of = s(RELIEF * look.texture);
    let fine = l.mul(sharp(l, footprint_mm, RELIEF_PER_MM), slope_of);
    let wide = l.mul(sharp(l, footprint_mm, 0.45 * RELIEF_PER_MM), slope_of);
    let mut relief = slope;
    for a in 0..3 {
        relief[a] = l.fma(slope[a], fine, l.mul(coarse[a], wide));
    }
    // Back from the lattice: its turn is its inverse's transpose.
    let back = from_fn::<_, 3, _>(|x| from_fn(|a| ASKEW[a][x]));
    let film = l.fma(l.mul(grain, fine), s(1.2), l.fma(mottle, s(0.35), s(0.75)));
    Texture {
        tint,
        relief: turn(l, &back, relief),
        film: l.min(l.max(film, s(0.0)), s(1.0)),
    }
}

/// Linear colour of lit walls, before the tone curve. `hit` is 0 or more in all lanes.
#[inline(always)]
fn lit<L: Lanes>(l: L, light: &Lighting, values: impl Values<L>, walls: &Walls<L>) -> [L::F; 3] {
    let s = |v: f32| l.splat(v);
    let (delta, hit, albedo) = (walls.delta, walls.hit, walls.albedo);
    let look = &light.look;
    let p = along(l, splat(l, light.origin_ijk), hit, delta);
    let step = turn(l, &light.lps_from_ijk, delta);
    // From the camera's centre.
    let offset = scaled(l, hit, step);
    let back = scaled(l, s(-1.0 / light.step_mm), step);
    let depth = l.mul(hit, s(light.step_mm));

    // The normal, on the camera's side; flat tissue faces the camera.
    let gradient = inward(l, light, values, p);
    let (n, steep) = unit(l, gradient);
    let away = l.less(s(0.0), dot(l, n, back));
    let side = l.select(away, s(1.0), s(-1.0));
    let flat = l.less(steep, s(1e-3));
    let mut normal = n;
    for a in 0..3 {
        normal[a] = l.select(flat, back[a], l.mul(side, n[a]));
    }
    let n = normal;

    // Mucosa is paler where it covers cartilage: where the CT is dense beneath it.
    let into = turn(l, &light.ijk_from_lps, n);
    let dense = values.at(l, along(l, p, s(-BENEATH_MM), into));
    let [from, to] = look.pale_hu;
    let pale = l.mul(l.sub(dense, s(from)), s(1.0 / (to - from)));
    let pale = l.mul(smooth(l, pale), s(look.paleness));

    let mut n_film = n;
    let mut film = s(0.75);
    let mut tint = [s(1.0); 3];
    if look.texture > 0.0 || look.vessels > 0.0 {
        let lps = along(l, splat(l, light.camera_lps), s(1.0), offset);
        let footprint = l.mul(depth, s(light.pixel_mm));
        let skin = texture(l, look, lps, footprint);
        (film, tint) = (skin.film, skin.tint);
        n_film = unit(l, along(l, n, s(-1.0), skin.relief)).0;
    }
    let mut colour = albedo;
    for c in 0..3 {
        let shown = l.fma(pale, l.sub(s(PALE_RGB[c]), albedo[c]), albedo[c]);
        colour[c] = l.mul(l.mul(shown, shown), tint[c]);
    }

    let (mut direct, mut round, mut gloss) = (s(0.0), s(0.0), s(0.0));
    // Half of the relief also shows in the matt part.
    let n_matt = unit(l, along(l, n, s(1.0), n_film)).0;
    for guide in light.guides {
        let mut to_guide = offset;
        for a in 0..3 {
            to_guide[a] = l.sub(s(guide[a]), offset[a]);
        }
        let (dir, _) = unit(l, to_guide);
        let square = l.add(dot(l, to_guide, to_guide), s(GUIDE_MM2));
        let strength = l.div(s(0.5 * light.exposure), square);
        let facing = dot(l, n_matt, dir);
        let facing = l.mul(l.add(facing, s(look.wrap)), s(1.0 / (1.0 + look.wrap)));
        direct = l.fma(strength, l.max(facing, s(0.0)), direct);
        round = l.add(round, strength);
        let (half, _) = unit(l, along(l, back, s(1.0), dir));
        let mut highlight = l.max(dot(l, n_film, half), s(0.0));
        for _ in 0..look.shininess_log2 {
            highlight = l.mul(highlight, highlight);
        }
        gloss = l.fma(strength, highlight, gloss);
    }
    let gloss = l.mul(l.mul(gloss, film), s(look.gloss));
    let round = l.mul(round, s(look.ambient));
    let mut out = colour;
    for c in 0..3 {
        let received = l.fma(round, s(TINT_RGB[c]), direct);
        out[c] = l.fma(colour[c], received, gloss);
    }
    out
}

/// Lights rows of pixels that have been gathered, from `first_row` on, as 8-bit colours; the same bits on every instruction
/// set.
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
            // SAFETY: the instruction set is only handed out where the machine has it. Benchmark:
            // docs/decisions/0008-appearance.md.
            (InstructionSet::Avx512, Some(voxels)) => unsafe {
                light_row_avx512(frame, light, voxels, row, gathered, rgb);
            },
            #[cfg(target_arch = "x86_64")]
            // SAFETY: as above.
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
    // SAFETY: this function runs only where the machine has the instructions.
    let l = Pair(unsafe { Avx512::new() });
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
    // SAFETY: this function runs only where the machine has the instructions.
    let l = Pair(unsafe { Avx2::new() });
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
    for (block, (pixels, out)) in gathered
        .chunks(L::N)
        .zip(rgb.chunks_mut(3 * L::N))
        .enumerate()
    {
        if pixels.iter().all(|pixel| pixel.hit < 0.0) {
            for (pixel, out) in pixels.iter().zip(out.chunks_mut(3)) {
                out.copy_from_slice(&unlit(pixel).to_rgb8(light.background));
            }
            continue;
        }
        let last = frame.camera().width() - 1;
        let columns = from_fn(|n| (block * L::N + n).min(last) as i32);
        let rays = rays_of(frame, &columns, &[row as i32; MAX_LANES]);
        let walls = gather(l, &rays.delta, pixels);
        let colour = lit(l, light, values, &walls);
        let mut shown = [[0; MAX_LANES]; 3];
        for c in 0..3 {
            // Bright light is compressed as a camera does it: x (1 + x / white^2) / (1 + x).
            let x = colour[c];
            let tone = l.div(
                l.mul(x, l.fma(x, s(1.0 / (WHITE * WHITE)), s(1.0))),
                l.add(x, s(1.0)),
            );
            let v = l.sqrt(l.max(tone, s(0.0)));
            // And its dark parts are pressed down.
            let v = l.mul(v, l.fma(v, s(TOE), s(1.0 - TOE)));
            let behind = s(light.background[c]);
            let v = l.fma(walls.transparency, l.sub(behind, v), v);
            let v = l.fma(v, s(255.0), s(0.5));
            shown[c] = l.store_i(l.whole(l.min(l.max(v, s(0.0)), s(255.0))));
        }
        for (n, (pixel, out)) in pixels.iter().zip(out.chunks_mut(3)).enumerate() {
            if pixel.hit < 0.0 {
                out.copy_from_slice(&unlit(pixel).to_rgb8(light.background));
            } else {
                out.copy_from_slice(&[shown[0][n] as u8, shown[1][n] as u8, shown[2][n] as u8]);
            }
        }
    }
}

/// A ray without a wall ends far away, where no light comes back from.
fn unlit(pixel: &Gathered) -> Gathered {
    Gathered {
        rgb: [0.0; 3],
        ..*pixel
    }
}

/// What rays have gathered, in lanes.
struct Walls<L: Lanes> {
    delta: [L::F; 3],
    /// 0 in lanes without a wall.
    hit: L::F,
    transparency: L::F,
    /// The flat colour, not multiplied by its opacity.
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

/// Light that comes back from pixels (column, row, what was gathered) at an exposure of 1 and without texture and
/// vessels, for the automatic exposure.
pub(crate) fn brightness(
    frame: &Frame<'_>,
    light: &Lighting,
    pixels: &[(usize, usize, Gathered)],
) -> Vec<f32> {
    let l = Portable;
    let mut plain = *light;
    (plain.look.texture, plain.look.vessels) = (0.0, 0.0);
    (plain.look.gloss, plain.exposure) = (0.0, 1.0);
    let mut out = Vec::with_capacity(pixels.len());
    for pixels in pixels.chunks(Portable::N) {
        let place = |n: usize| pixels[n.min(pixels.len() - 1)];
        let (column, row) = (
            from_fn(|n| place(n).0 as i32),
            from_fn(|n| place(n).1 as i32),
        );
        let rays = rays_of(frame, &column, &row);
        let gathered: Vec<Gathered> = pixels.iter().map(|pixel| pixel.2).collect();
        let walls = gather(l, &rays.delta, &gathered);
        let [r, g, b] = lit(l, &plain, &frame.field, &walls);
        // About the eye's weights.
        let weights = [l.splat(0.3), l.splat(0.6), l.splat(0.1)];
        out.extend_from_slice(&l.store(dot(l, [r, g, b], weights))[..pixels.len()]);
    }
    out
}
