use crate::anatomy::{Solid, Tissue, VERTEBRA_MM, solids, spine_y};
use crate::neck::Neck;
use crate::random::value_noise;
use crate::shapes::{Piece, cover, ellipsoid, mix, smooth_max, smooth_min};

/// Body of a phantom without the airways and without the vessels of the lungs.
#[derive(Debug)]
pub(crate) struct Body {
    seed: u64,
    pub(crate) solids: Vec<Solid>,
    pub(crate) neck: Option<Neck>,
}

/// Half width of the pleural cavity at its widest level, mm.
const CAVITY_X: f64 = 128.0;
/// Half depth of the pleural cavity at its widest level, mm.
const CAVITY_Y: f64 = 90.0;
/// y coordinate of the middle of the pleural cavity, LPS mm.
const CAVITY_MID_Y: f64 = -4.0;
/// Height z of the widest level of the pleural cavity, LPS mm.
const CAVITY_WIDE_Z: f64 = -70.0;
/// Height z of the apex of the pleural cavity, LPS mm.
const CAVITY_TOP_Z: f64 = 84.0;

/// Return |q| to the power of 5/2, which gives sections between an ellipse and a box, like those of a chest.
fn power(q: f64) -> f64 {
    q * q * q.sqrt()
}

/// Return the inverse of the function [`power`].
fn root(s: f64) -> f64 {
    libm::pow(s, 0.4)
}

/// Return [`root`] with an accuracy of 1 in 2,000, but faster.
///
/// The method is a guess from the exponent and one step of Halley's method.
fn root_about(s: f64) -> f64 {
    // The bits of a float are approximately proportional to its logarithm; for a power of 2/5, 3/5 of the bits of 1
    // must be added.
    let guess = f64::from_bits((s.to_bits() / 5) * 2 + (1.0f64.to_bits() / 5) * 3);
    let (fifth, target) = (guess * guess * guess * guess * guess, s * s);
    guess * (2.0 * fifth + 3.0 * target) / (3.0 * fifth + 2.0 * target)
}

/// Return the scale of the pleural cavity's sections at a height: 1 at its widest level, 0 at the apex.
fn cavity_shrink(z: f64) -> f64 {
    let u = ((z - CAVITY_WIDE_Z) / (CAVITY_TOP_Z - CAVITY_WIDE_Z)).max(0.0);
    root((1.0 - power(u)).max(0.0))
}

/// Return the point of the pleura in a direction (0 = posterior, pi = anterior) at height `z`, as `[x >= 0, y]`.
fn rib_cage(azimuth: f64, z: f64) -> [f64; 2] {
    let (s, c) = (libm::sin(azimuth), libm::cos(azimuth));
    // Above the apex the first rib still needs a ring, so the scale has a lower limit.
    let shrink = cavity_shrink(z).max(0.30);
    let (x, y) = (s.abs() / (CAVITY_X * shrink), c.abs() / (CAVITY_Y * shrink));
    let r = 1.0 / root(power(x) + power(y));
    [s.abs() * r, CAVITY_MID_Y + c * r]
}

/// Signed distances to the surfaces of the body at one point, mm.
pub(crate) struct Surfaces {
    pub(crate) skin: f64,
    cavity: f64,
    diaphragm: f64,
    heart: f64,
    spine: f64,
    pub(crate) lung: f64,
}

impl Surfaces {
    /// Return the distance in mm from this point to the nearest surface at which the tissue changes.
    pub(crate) fn nearest(&self) -> f64 {
        // The muscle of the chest wall has surfaces 18 mm and 22 mm outside the cavity; fat begins 2 mm and muscle 12
        // mm under the skin.
        [
            self.skin,
            self.skin + 2.0,
            self.skin + 12.0,
            self.cavity,
            self.cavity - 18.0,
            self.diaphragm,
            self.heart,
            self.spine,
            self.spine + 2.0,
            self.lung,
        ]
        .into_iter()
        .map(f64::abs)
        .fold(f64::INFINITY, f64::min)
    }
}

impl Body {
    pub(crate) fn new(seed: u64) -> Self {
        let mut body = Self {
            seed,
            solids: solids(rib_cage),
            neck: None,
        };
        // The sternum is a row of flat tubes side by side.
        for x in [-11.0, -4.0, 4.0, 11.0] {
            let mut z = 48.0;
            while z > -66.0 {
                let at = |z: f64| [x, rib_cage(core::f64::consts::PI, z)[1] - 9.5, z];
                body.solids.push(Solid {
                    piece: Piece {
                        start: at(z),
                        end: at(z - 12.0),
                        start_radius: 5.5,
                        end_radius: 5.5,
                    },
                    tissue: Tissue::Bone,
                });
                z -= 12.0;
            }
        }
        body
    }

    /// Return the body with a neck.
    pub(crate) fn with_neck(mut self, neck: Neck) -> Self {
        // The vertebral arches of the chest end where those of the neck begin.
        self.solids.retain(|s| {
            s.tissue != Tissue::Bone || s.piece.start[1] < 30.0 || s.piece.start[2] < 92.0
        });
        self.solids.extend(neck.solids(spine_y));
        self.neck = Some(neck);
        self
    }

    /// Return the y coordinate of the middle of the vertebral bodies at a height.
    fn spine_y(&self, z: f64) -> f64 {
        self.neck
            .as_ref()
            .map_or_else(|| spine_y(z), |neck| neck.spine_y(z, spine_y(z)))
    }

    /// Return the distances from a point to the surfaces of the body; distances to surfaces that are far away are
    /// approximate.
    pub(crate) fn surfaces(&self, p: [f64; 3]) -> Surfaces {
        let mut s = surfaces_by(Superellipsoid::seen_distance, p);
        if self.neck.is_some() && p[2] > 60.0 {
            s.skin = self.skin(p);
            s.spine = self.spine(p);
        }
        s
    }

    /// Return the signed distance of a point from the skin.
    fn skin(&self, p: [f64; 3]) -> f64 {
        match &self.neck {
            Some(neck) if p[2] > 60.0 => {
                let [a, b, y] = neck.skin(p[2], chest_skin(p[2]));
                Neck::slope(p[2]) * Superellipsoid::at([(p[0], a), (p[1] - y, b)]).seen_distance()
            }
            _ => skin(p).seen_distance(),
        }
    }

    /// Return the signed distance of a point from the spine.
    fn spine(&self, p: [f64; 3]) -> f64 {
        if self.neck.is_none() || p[2] <= 60.0 {
            return spine(p);
        }
        let share = Neck::share(p[2]);
        let at = [0.0, self.spine_y(p[2]), p[2]];
        ellipsoid(p, at, [mix(18.0, 13.0, share), mix(15.0, 10.5, share), 1e6])
    }

    /// Return the HU of lung tissue without airways and vessels at a point.
    ///
    /// The tissue is denser at the back (supine patient) and has a fine texture.
    pub(crate) fn parenchyma_hu(&self, p: [f64; 3]) -> f64 {
        let gravity = 0.32 * (p[1] - CAVITY_MID_Y);
        let coarse = value_noise(self.seed ^ 0x11, p.map(|v| v / 9.0));
        let fine = value_noise(self.seed ^ 0x12, p.map(|v| v / 2.6));
        -862.0 + gravity + 14.0 * coarse + 24.0 * fine
    }

    /// Return the HU of the body at a point, without `solids`, airways and the vessels of the lungs.
    ///
    /// Surfaces that cannot affect the point are not computed.
    pub(crate) fn hu(&self, p: [f64; 3], sigma_mm: f64) -> f64 {
        let to_skin = self.skin(p);
        let mut hu = mix(-1000.0, 5.0, cover(to_skin, sigma_mm));
        if to_skin > 4.0 {
            return hu;
        }
        let to_cavity = cavity(p).seen_distance();
        let mottle = value_noise(self.seed ^ 0x13, p.map(|v| v / 7.0));
        let fat = -102.0 + 9.0 * mottle;
        hu = mix(hu, fat, cover(to_skin + 2.0, sigma_mm));
        // The chest wall and the shoulders are muscle round the cavity and the neck, below the fat.
        let neck = ellipsoid(p, [0.0, 6.0, 118.0], [122.0, 70.0, 66.0]);
        let back = ellipsoid(p, [0.0, 84.0, p[2]], [62.0, 26.0, 1e6]);
        let mut wall = (to_cavity - 18.0).min(neck).min(back);
        let mut fat_mm = 12.0;
        if self.neck.is_some() {
            wall = wall.min(106.0 - p[2]);
            fat_mm = mix(12.0, 6.0, Neck::share(p[2]));
        }
        let muscle = smooth_max(wall, to_skin + fat_mm, 4.0);
        let strands = value_noise(self.seed ^ 0x14, [p[0] / 14.0, p[1] / 5.0, p[2] / 14.0]);
        // Fat is between the muscles.
        let seams = ((strands.abs() - 0.05) * 14.0).clamp(0.0, 1.0);
        let muscle_hu = mix(-70.0, 52.0 + 6.0 * mottle, mix(1.0, seams, 0.75));
        hu = mix(hu, muscle_hu, cover(muscle, sigma_mm));
        // Mediastinal fat, the abdomen under the diaphragm and the heart are within the cavity.
        let inside = cover(to_cavity, sigma_mm);
        if inside > 0.0 {
            let (to_diaphragm, to_heart) = (diaphragm(p), heart(p));
            let mut inner = mix(-78.0 + 14.0 * mottle, 46.0, cover(to_heart, sigma_mm));
            // The liver is on the right, fat and spleen are on the left; above the diaphragm the distance is negative.
            let abdomen = if p[0] < 24.0 {
                58.0
            } else {
                40.0 + 20.0 * mottle
            };
            inner = mix(inner, abdomen, cover(-to_diaphragm, sigma_mm));
            hu = mix(hu, inner, inside);
            // The lungs are inside the cavity and above the diaphragm.
            if cover(to_diaphragm, sigma_mm) > 0.0 {
                let lung = lung_by(p, to_cavity, to_diaphragm, to_heart, spine(p));
                let lung = cover(lung, sigma_mm);
                if lung > 0.0 {
                    hu = mix(hu, self.parenchyma_hu(p), lung);
                }
            }
        }
        let share = self.neck.as_ref().map_or(0.0, |_| Neck::share(p[2]));
        with_spine(hu, p, self.spine(p), self.spine_y(p[2]), share, sigma_mm)
    }
}

fn with_spine(hu: f64, p: [f64; 3], spine: f64, spine_y: f64, neck: f64, sigma_mm: f64) -> f64 {
    if spine > 30.0 {
        return hu;
    }
    // Vertebral bodies have discs between them, and the canal behind them.
    let level = (p[2] / VERTEBRA_MM).fract();
    let level = if level < 0.0 { level + 1.0 } else { level };
    let disc = (0.5 - (level - 0.5).abs()) * VERTEBRA_MM - 2.5;
    let bone = mix(380.0, 165.0, cover(spine + 2.0, sigma_mm));
    let end_plate = mix(bone, 330.0, cover((disc - 0.8).abs() - 0.8, sigma_mm));
    let body = mix(end_plate, 85.0, cover(disc, sigma_mm));
    let hu = mix(hu, body, cover(spine, sigma_mm));
    let y = p[1] - spine_y - mix(21.0, 16.5, neck);
    let canal = (p[0] * p[0] + y * y).sqrt() - mix(8.5, 7.0, neck);
    mix(hu, 22.0, cover(canal, sigma_mm))
}

/// Return the signed distance in mm from a point to the surface of the lungs, negative inside; accurate to a few per
/// cent near the surface.
pub(crate) fn lung_distance(p: [f64; 3]) -> f64 {
    surfaces(p).lung
}

pub(crate) fn surfaces(p: [f64; 3]) -> Surfaces {
    surfaces_by(Superellipsoid::distance, p)
}

fn surfaces_by(distance: impl Fn(&Superellipsoid) -> f64, p: [f64; 3]) -> Surfaces {
    let cavity = distance(&cavity(p));
    let diaphragm = diaphragm(p);
    let heart = heart(p);
    let spine = spine(p);
    Surfaces {
        skin: distance(&skin(p)),
        cavity,
        diaphragm,
        heart,
        spine,
        lung: lung_by(p, cavity, diaphragm, heart, spine),
    }
}

/// Return the signed distance of a point to the lungs, from its distances to the surfaces round the lungs, mm.
fn lung_by(p: [f64; 3], cavity: f64, diaphragm: f64, heart: f64, spine: f64) -> f64 {
    let mut centre = smooth_min(mediastinum(p), heart, 12.0);
    for side in [-1.0, 1.0] {
        // The hilum is where bronchi and vessels enter the lung.
        let hilum = ellipsoid(p, [side * 30.0, 4.0, -30.0], [15.0, 14.0, 24.0]);
        centre = smooth_min(centre, hilum, 8.0);
    }
    centre = smooth_min(centre, spine - 5.0, 10.0);
    smooth_max(smooth_max(cavity, diaphragm, 6.0), -centre, 5.0)
}

/// Return the HU of a point with a solid, given the HU without it.
pub(crate) fn with_solid(hu: f64, solid: &Solid, p: [f64; 3], sigma_mm: f64) -> f64 {
    let (d, _) = solid.piece.distance(p);
    let share = cover(d, sigma_mm);
    if share <= 0.0 {
        return hu;
    }
    let own = match solid.tissue {
        Tissue::Soft(own) => own,
        Tissue::Bone => mix(560.0, 190.0, cover(d + 1.5, sigma_mm)),
    };
    // Of overlapping bones the denser one counts; otherwise each joint would show a ring.
    if solid.tissue == Tissue::Bone && hu > own && hu > 150.0 {
        return hu;
    }
    mix(hu, own, share)
}

fn skin(p: [f64; 3]) -> Superellipsoid {
    // Shoulders narrow towards the neck; the arms are raised.
    let [a, b, y] = chest_skin(p[2]);
    Superellipsoid::at([(p[0], a), (p[1] - y, b)])
}

/// Return half width, half depth and middle (y) of the chest's skin at a height, mm.
pub(crate) fn chest_skin(z: f64) -> [f64; 3] {
    let up = ((z - 30.0) / 90.0).clamp(0.0, 1.2);
    [168.0 - 26.0 * up * up, 121.0 - 34.0 * up * up, -2.0]
}

fn cavity(p: [f64; 3]) -> Superellipsoid {
    let up = (p[2] - CAVITY_WIDE_Z).max(0.0);
    Superellipsoid::at([
        (p[0], CAVITY_X),
        (p[1] - CAVITY_MID_Y, CAVITY_Y),
        (up, CAVITY_TOP_Z - CAVITY_WIDE_Z),
    ])
}

/// Superellipsoid, evaluated at a point that is given as (coordinate, half axis) pairs.
struct Superellipsoid {
    sum: f64,
    slope: f64,
    widest: f64,
}

impl Superellipsoid {
    fn at<const N: usize>(axes: [(f64, f64); N]) -> Self {
        let (mut sum, mut slope2, mut widest) = (0.0, 0.0, 0.0f64);
        for (at, half) in axes {
            let q = at.abs() / half;
            sum += power(q);
            let slope = q * q.sqrt() / half;
            slope2 += slope * slope;
            widest = widest.max(half);
        }
        Self {
            sum,
            slope: slope2.sqrt(),
            widest,
        }
    }

    /// Return the signed distance of the point from the surface in mm, accurate to first order near the surface.
    fn distance(&self) -> f64 {
        self.distance_by(root)
    }

    /// Return the signed distance of the point, exact within [`SEEN_MM`] of the surface and accurate to 0.5 % farther
    /// away.
    ///
    /// No tissue changes farther away. The exact root takes a third of the time of most voxels.
    fn seen_distance(&self) -> f64 {
        let about = self.distance_by(root_about);
        if about.abs() > SEEN_MM {
            about
        } else {
            self.distance()
        }
    }

    fn distance_by(&self, root: impl Fn(f64) -> f64) -> f64 {
        let g = root(self.sum).max(0.05);
        // d(g)/d(x) = (q / g)^1.5 / half. Far inside it approaches 0, and the distance is then only a lower bound.
        let slope = self.slope / (g * g.sqrt());
        (g - 1.0) / slope.max(0.5 / self.widest)
    }
}

/// Distance in mm from the surface within which exact distances are needed.
///
/// Tissue changes up to 22 mm from these surfaces, and rounded edges and blur extend 6 mm farther.
const SEEN_MM: f64 = 30.0;

/// Return the signed distance to the diaphragm in mm, negative above it: two domes, of which the right one is higher.
fn diaphragm(p: [f64; 3]) -> f64 {
    let dome = |x: f64, y: f64, top: f64| {
        let (u, v) = ((p[0] - x) / 74.0, (p[1] - y) / 86.0);
        let surface = top - 66.0 * (u * u + v * v);
        let slope = 132.0 * ((u / 74.0) * (u / 74.0) + (v / 86.0) * (v / 86.0)).sqrt();
        (surface - p[2]) / (1.0 + slope * slope).sqrt()
    };
    // The region below either dome is solid, so the higher surface counts.
    smooth_max(dome(-62.0, -12.0, -119.0), dome(62.0, -8.0, -131.0), 14.0)
}

fn heart(p: [f64; 3]) -> f64 {
    let ventricles = ellipsoid(p, [18.0, -46.0, -88.0], [50.0, 38.0, 42.0]);
    let right_atrium = ellipsoid(p, [-14.0, -36.0, -78.0], [25.0, 29.0, 34.0]);
    let left_atrium = ellipsoid(p, [4.0, 2.0, -66.0], [28.0, 16.0, 21.0]);
    smooth_min(smooth_min(ventricles, right_atrium, 10.0), left_atrium, 6.0)
}

/// Return the signed distance to the mediastinum in mm, a sheet of varying thickness.
///
/// The sheet is broad round the trachea and the great vessels, and thin in front.
fn mediastinum(p: [f64; 3]) -> f64 {
    // Higher up the great vessels are further forward, and the inlet is wider.
    let up = (p[2] / 90.0).clamp(0.0, 1.0);
    let v = (p[1] - mix(2.0, -12.0, up)) / mix(36.0, 34.0, up);
    let v4 = v * v * v * v;
    let half = 3.5 + mix(18.0, 30.0, up * up) / (1.0 + v4);
    // The factor of 0.85 accounts for the slope of the sheet's sides, up to 30 degrees.
    0.85 * ((p[0] - 1.0).abs() - half)
}

fn spine(p: [f64; 3]) -> f64 {
    ellipsoid(p, [0.0, spine_y(p[2]), p[2]], [18.0, 15.0, 1e6])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_fast_root_is_accurate_to_1_in_2000() {
        for n in 0..2000 {
            let s = libm::exp(-12.0 + 0.012 * f64::from(n));
            let (about, exact) = (root_about(s), root(s));
            assert!((about / exact - 1.0).abs() < 5e-4, "{s}: {about}, {exact}");
        }
    }

    #[test]
    fn surface_distances_are_exact_near_tissue_changes_and_have_the_right_sign_elsewhere() {
        let (mut near, mut far) = (0, 0);
        for n in 0..40_000 {
            let p = [
                f64::from(n % 40) * 10.0 - 195.0,
                f64::from(n / 40 % 40) * 8.0 - 160.0,
                f64::from(n / 1600) * 10.0 - 130.0,
            ];
            for shape in [skin(p), cavity(p)] {
                let (seen, exact) = (shape.seen_distance(), shape.distance());
                if exact.abs() < SEEN_MM - 0.2 {
                    near += 1;
                    assert_eq!(seen.to_bits(), exact.to_bits());
                } else {
                    far += 1;
                    let allowed = 5e-3 * exact.abs();
                    assert!((seen - exact).abs() < allowed, "{p:?}: {seen}, {exact}");
                }
            }
        }
        assert!(near > 10_000 && far > 10_000, "{near}, {far}");
    }
}
