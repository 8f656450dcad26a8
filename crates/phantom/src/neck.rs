//! Neck above the chest: larynx, throat and surrounding tissue.
//!
//! The origin of heights is the lower border of the cricoid, where the trachea begins.
//!
//! Heights and widths are those of adults: the cords 18 to 25 mm above the cricoid's lower border, a rima of 18 to 24
//! mm from front to back, trachea 104 to 126 mm from the carina to the cricoid. The sinuses beside the larynx end
//! blindly at the height of the cords; the throat behind and above it is wider than deep.

use crate::anatomy::{Solid, Tissue};
use crate::random::{Random, value_noise};
use crate::shapes::{Piece, cover, ellipsoid, mix, smooth_max, smooth_min};

/// Height of the upper face of the box of a chest with a neck, mm above the carina.
pub(crate) const NECK_TOP_Z: f64 = 195.0;
/// Height above the carina at which spine, muscles and skin begin to change from the chest's shape to the neck's, mm.
const INLET_Z: f64 = 85.0;
/// Height above the carina at which spine, muscles and skin have the neck's shape completely, mm.
const NECK_Z: f64 = 130.0;

/// Dimensions of the neck of one person.
#[derive(Debug, Clone)]
pub(crate) struct Neck {
    seed: u64,
    /// Middle of the airway at the lower border of the cricoid, LPS mm, where the trachea of the ground truth begins.
    pub(crate) cricoid_lps: [f64; 3],
    /// Radius of the trachea at the cricoid, mm.
    radius: f64,
    /// Height of the vocal cords above the cricoid's lower border, mm.
    cords: f64,
    /// Half of the width of the rima between the vocal cords, mm.
    gap: f64,
    /// Half of the depth of the glottis (rima) from front to back, mm.
    rima: f64,
    /// Fraction by which the rima is wider at the back, and narrower in front, than in the middle.
    wedge: f64,
    /// Half of the width and half of the depth of the throat, mm.
    throat: [f64; 2],
    /// Share of the cartilage that is calcified, 0 to 1.
    calcified: f64,
}

fn smoothstep(lo: f64, hi: f64, at: f64) -> f64 {
    let t = ((at - lo) / (hi - lo)).clamp(0.0, 1.0);
    t * t * (3.0 - 2.0 * t)
}

/// Return the values of a table `(height, [..])` at a height, interpolated smoothly between its rows.
fn row<const N: usize>(table: &[(f64, [f64; N])], h: f64) -> [f64; N] {
    let last = table.len() - 1;
    let next = table.iter().position(|(at, _)| *at > h).unwrap_or(last);
    if next == 0 {
        return table[0].1;
    }
    let (from, to) = (&table[next - 1], &table[next]);
    let t = smoothstep(from.0, to.0, h);
    std::array::from_fn(|a| mix(from.1[a], to.1[a], t))
}

/// Return the signed distance to an ellipse with half axes `a` and `b` in the plane, to first order near its edge.
fn ellipse(x: f64, y: f64, a: f64, b: f64) -> f64 {
    let (u, v) = (x / a, y / b);
    let (k0, k1) = (u.hypot(v), (u / a).hypot(v / b));
    if k1 < 1e-9 {
        return -a.min(b);
    }
    // Beside the tip of a narrow ellipse the first-order value is much too small.
    (k0 * (k0 - 1.0) / k1).max(x.abs() - a).max(y.abs() - b)
}

impl Neck {
    /// Return the height at which the trachea of a seed begins, mm above the carina.
    pub(crate) fn trachea_top_z(seed: u64) -> f64 {
        Random::new(seed, 7).range(104.0, 126.0)
    }

    pub(crate) fn new(seed: u64, cricoid_lps: [f64; 3], radius: f64) -> Self {
        let mut random = Random::new(seed, 8);
        let size = radius / 9.2;
        Self {
            seed,
            cricoid_lps,
            radius,
            cords: random.range(18.0, 25.0),
            // Some people close the cords when they hold their breath; quiet breathing leaves the cords open.
            gap: if random.unit() < 0.25 {
                0.15
            } else {
                random.range(0.9, 2.6)
            },
            rima: random.range(8.5, 11.5) * size,
            wedge: random.range(0.3, 0.8),
            throat: [random.range(14.0, 19.0), random.range(6.0, 9.0)],
            calcified: random.range(0.1, 0.8),
        }
    }

    /// Return the height of a point above the cricoid's lower border, mm.
    fn height(&self, p: [f64; 3]) -> f64 {
        p[2] - self.cricoid_lps[2]
    }

    /// Return the y coordinate of the middle of the larynx, which continues in the trachea's direction, at height `h`.
    fn larynx_y(&self, h: f64) -> f64 {
        self.cricoid_lps[1] - 0.1 * h
    }

    /// Return the y coordinate of the middle of the vertebral bodies at a height; `chest_y` is that of a chest without
    /// a neck.
    pub(crate) fn spine_y(&self, z: f64, chest_y: f64) -> f64 {
        let own = self.cricoid_lps[1] + 31.0 - 0.05 * (z - self.cricoid_lps[2]);
        mix(chest_y, own, smoothstep(INLET_Z, NECK_Z, z))
    }

    /// Return the factor of a distance to the skin at a height that accounts for the slope of shoulders and collar.
    ///
    /// [`Self::skin`] does not include the slope.
    pub(crate) fn slope(z: f64) -> f64 {
        mix(
            1.0,
            0.6,
            smoothstep(60.0, 72.0, z) * (1.0 - smoothstep(135.0, 160.0, z)),
        )
    }

    /// Return the weight of the neck's shape at a height: 0 in the chest, 1 above the thoracic inlet.
    pub(crate) fn share(z: f64) -> f64 {
        smoothstep(INLET_Z, NECK_Z, z)
    }

    /// Return half width, half depth and middle (y) of the skin at a height: shoulders below, the neck above.
    ///
    /// `chest` has the same numbers for the chest alone.
    pub(crate) fn skin(&self, z: f64, chest: [f64; 3]) -> [f64; 3] {
        // The shoulders of raised arms reach up to the larynx.
        let share = smoothstep(105.0, 150.0, z);
        let width = mix(chest[0], 60.0, share);
        let back = mix(chest[2] + chest[1], self.cricoid_lps[1] + 88.0, share);
        // In front the chest ends at the clavicles.
        let front = smoothstep(62.0, 112.0, z);
        let front = mix(chest[2] - chest[1], self.cricoid_lps[1] - 30.0, front);
        [width, 0.5 * (back - front), 0.5 * (back + front)]
    }

    fn throat_back_y(&self, z: f64) -> f64 {
        self.spine_y(z, 0.0) - 10.5 - 4.5
    }

    /// Return the signed distance to the air of larynx and throat, from just under the cricoid's lower border upwards,
    /// mm.
    pub(crate) fn upper_airway(&self, p: [f64; 3]) -> f64 {
        let h = self.height(p);
        let x = p[0] - self.cricoid_lps[0];
        if h < -9.0 || x.abs() > 45.0 || (p[1] - self.cricoid_lps[1]).abs() > 55.0 {
            return f64::INFINITY;
        }
        let (r, g, gap, b) = (self.radius, self.cords, self.gap, self.rima);
        // The rows have half width, half depth, and the fraction by which the back is wider and the front is narrower,
        // for: trachea, cricoid, cone, cords, ventricle, false cords, vestibule.
        let larynx = row(
            &[
                (-6.0, [r, r, 0.0]),
                (0.0, [r, r, 0.0]),
                (g - 11.0, [0.94 * r, 1.05 * r, 0.0]),
                (g - 5.0, [0.66 * r, 1.08 * b, 0.2]),
                (g - 1.5, [gap, b, self.wedge]),
                (g + 1.0, [gap, b, self.wedge]),
                (g + 3.5, [0.72 * r, 0.85 * b, 0.1]),
                (g + 5.5, [0.70 * r, 0.85 * b, 0.1]),
                (g + 8.5, [gap.max(0.22 * r), 0.95 * b, 0.4]),
                (g + 16.0, [0.66 * r, b, 0.3]),
                (g + 27.0, [0.95 * r, 1.05 * b, 0.1]),
            ],
            h,
        );
        let y = p[1] - self.larynx_y(h);
        let wider = 1.0 + larynx[2] * (y / larynx[1]).clamp(-1.0, 1.0);
        let mut d = 0.85 * ellipse(x / wider, y, larynx[0], larynx[1]);
        d = d.max(-4.0 - h).max(h - (g + 30.0));
        if h > g - 4.0 {
            d = smooth_min(d, self.throat(p, h, x), 4.0);
            for side in [-1.0, 1.0] {
                let at = |x: f64, y: f64, h: f64| {
                    [self.cricoid_lps[0] + side * x, y, self.cricoid_lps[2] + h]
                };
                let back = self.throat_back_y(self.cricoid_lps[2] + g + 27.0);
                let top = 0.5 * (self.larynx_y(g + 27.0) + back) + 1.0;
                let sinus = Piece {
                    start: at(12.0, self.larynx_y(g) + 0.6 * b, g + 1.0),
                    end: at(15.0, top, g + 28.0),
                    start_radius: 1.2,
                    end_radius: 5.0,
                };
                d = smooth_min(d, sinus.distance(p).0, 2.0);
            }
            d = smooth_max(d, -self.epiglottis(h, x, p[1]), 1.0);
        }
        d
    }

    /// Return the signed distance to hypopharynx and oropharynx, mm.
    ///
    /// Both extend from the spine's front to the epiglottis, and higher up to the tongue.
    fn throat(&self, p: [f64; 3], h: f64, x: f64) -> f64 {
        let g = self.cords;
        let [half_width, half_depth] = self.throat;
        let back = self.throat_back_y(p[2]);
        let table = [
            (g + 20.0, [0.7 * half_width, back - 7.0]),
            (g + 29.0, [half_width, self.larynx_y(h) - 0.3 * self.rima]),
            (g + 40.0, [half_width, self.larynx_y(h) - self.rima]),
            (g + 52.0, [0.85 * half_width, back - 2.0 * half_depth]),
            (g + 80.0, [0.8 * half_width, back - 2.3 * half_depth]),
        ];
        let [a, front] = row(&table, h);
        let b = (0.5 * (back - front)).max(2.5);
        let d = 0.85 * ellipse(x, p[1] - (back - b), a, b);
        smooth_max(d, g + 20.0 - h, 3.0)
    }

    /// Return the signed distance to the epiglottis in mm: a leaf from the front of the vestibule up into the throat.
    fn epiglottis(&self, h: f64, x: f64, y: f64) -> f64 {
        let up = h - (self.cords + 12.0);
        let at = self.larynx_y(h) - self.rima + 1.0 + 0.3 * up + x * x / 45.0;
        let leaf = 0.9 * ((y - at).abs() - 1.4);
        leaf.max(x.abs() - (4.0 + 0.28 * up).min(11.0))
            .max(-up)
            .max(up - 30.0)
    }

    /// Return a value with cricoid, thyroid cartilage and the surrounding muscle.
    ///
    /// `hu` is the value without them; `to_air` is the distance to the airway in mm.
    pub(crate) fn with_cartilage(&self, hu: f64, p: [f64; 3], to_air: f64, sigma_mm: f64) -> f64 {
        let h = self.height(p);
        let x = p[0] - self.cricoid_lps[0];
        let y = p[1] - self.larynx_y(h);
        if !(-4.0..=self.cords + 32.0).contains(&h) || x.abs() > 34.0 || y.abs() > 34.0 {
            return hu;
        }
        let far = ellipsoid([x, y, 0.0], [0.0, 2.0, 0.0], [19.0, 17.0, 1e6]);
        let muscle = smooth_max(far, -3.0 - h, 3.0).max(h - (self.cords + 30.0));
        let mut hu = mix(hu, 52.0, cover(muscle, sigma_mm));
        let spots = value_noise(self.seed ^ 0x21, p.map(|v| v / 5.0));
        let own = mix(
            118.0,
            360.0,
            smoothstep(-0.2, 0.2, spots + 2.0 * self.calcified - 1.2),
        );
        // The cricoid is an arch 6 mm high in front and a plate 20 mm high behind.
        let back = smoothstep(-0.6, 0.9, y / (self.radius + 4.0));
        let ring = (ellipse(x, y, self.radius + 4.2, self.radius + 4.6).abs() - 1.7)
            .max(-h)
            .max(h - mix(6.0, 20.0, back));
        // The airway itself is excluded.
        let ring = ring.max(1.2 - to_air);
        hu = mix(hu, own, cover(ring, sigma_mm));
        // The thyroid cartilage is two plates that meet in front.
        let front = -self.rima - 5.5;
        let plate = 0.8 * ((y - front - 0.95 * x.abs()).abs() - 1.9);
        let plate = plate
            .max(x.abs() - 21.0)
            .max(9.0 + 0.12 * (y - front) - h)
            .max(h - (self.cords + 15.0) - 0.25 * (y - front))
            .max(1.2 - to_air);
        mix(hu, own, cover(plate, sigma_mm))
    }

    /// Return the structures that continue from the chest into the neck.
    ///
    /// The structures are the vessels, the oesophagus, the hyoid and the arches of the vertebrae.
    pub(crate) fn solids(&self, chest_spine_y: impl Fn(f64) -> f64) -> Vec<Solid> {
        let mut out = Vec::new();
        let [cx, cy, cz] = self.cricoid_lps;
        let mut chain = |tissue: Tissue, points: &[([f64; 3], f64)]| {
            out.extend(points.windows(2).map(|w| Solid {
                piece: Piece {
                    start: w[0].0,
                    end: w[1].0,
                    start_radius: w[0].1,
                    end_radius: w[1].1,
                },
                tissue,
            }));
        };
        for side in [-1.0, 1.0] {
            let at = |x: f64, y: f64, z: f64| [cx + side * x, y, z];
            let blood = Tissue::Soft(46.0);
            chain(
                blood,
                &[
                    (at(24.0, -24.0, 108.0), 4.2),
                    (at(25.0, cy + 14.0, 140.0), 3.8),
                    (at(27.0, cy + 16.0, 215.0), 3.4),
                ],
            );
            chain(
                blood,
                &[
                    (at(40.0, -26.0, 108.0), 6.0),
                    (at(34.0, cy + 14.0, 140.0), 6.5),
                    (at(34.0, cy + 19.0, 215.0), 5.5),
                ],
            );
            // The thyroid gland is beside the trachea's upper rings.
            chain(
                Tissue::Soft(112.0),
                &[
                    (at(15.0, cy + 4.0, cz - 22.0), 6.0),
                    (at(17.0, cy + 5.0, cz - 4.0), 7.5),
                    (at(19.0, cy + 4.0, cz + 12.0), 4.0),
                ],
            );
            let hyoid = cz + self.cords + 25.0;
            let y = self.larynx_y(self.cords + 25.0);
            chain(
                Tissue::Bone,
                &[
                    (at(0.0, y - 19.0, hyoid), 4.0),
                    (at(11.0, y - 16.0, hyoid), 3.2),
                    (at(21.0, y + 6.0, hyoid + 5.0), 2.4),
                ],
            );
        }
        let gullet_y = |z: f64| self.throat_back_y(z) - 4.5;
        chain(
            Tissue::Soft(36.0),
            &[
                ([3.0, 0.0, 108.0f64.min(cz - 2.0)], 5.5),
                ([cx + 1.0, gullet_y(cz + 4.0), cz + 4.0], 5.0),
                ([cx, gullet_y(cz + 20.0), cz + 20.0], 5.0),
            ],
        );
        let mut level = 98.0;
        while level < 220.0 {
            let y = self.spine_y(level, chest_spine_y(level));
            for side in [-1.0, 1.0] {
                chain(
                    Tissue::Bone,
                    &[
                        ([side * 10.0, y + 8.0, level], 3.5),
                        ([side * 12.0, y + 18.0, level - 2.0], 4.0),
                        ([0.0, y + 27.0, level - 5.0], 3.0),
                    ],
                );
            }
            chain(
                Tissue::Bone,
                &[
                    ([0.0, y + 27.0, level - 5.0], 3.0),
                    ([0.0, y + 38.0, level - 12.0], 3.0),
                ],
            );
            level += 20.0;
        }
        out
    }

    /// Return the points of the path of a tube through the larynx, from the beginning of the trachea to above the box.
    pub(crate) fn way_up(&self) -> Vec<[f64; 3]> {
        let [cx, _, cz] = self.cricoid_lps;
        let top = NECK_TOP_Z + 30.0 - cz;
        (1..=(top / 2.0) as usize)
            .map(|n| {
                let h = 2.0 * n as f64;
                let z = cz + h;
                // The tube is in the back of the rima and then bends back into the throat.
                let larynx = self.larynx_y(h) + 0.25 * self.rima;
                let throat = self.throat_back_y(z) - self.throat[1];
                let share = smoothstep(self.cords + 8.0, self.cords + 45.0, h);
                [cx, mix(larynx, throat, share), z]
            })
            .collect()
    }

    /// Return the y coordinate of the front of the skin at a height; `chest` is as for [`Self::skin`].
    pub(crate) fn front_y(&self, z: f64, chest: [f64; 3]) -> f64 {
        let [_, depth, middle] = self.skin(z, chest);
        middle - depth
    }
}
