//! Small random chests for tests.
//!
//! The chests contain forked tubes of air with a wall, lung, vessels, and correlated noise like a scanner's, on
//! oblique, anisotropic and sometimes mirrored grids. Cameras are in the lumen, anywhere inside, and outside.

use crate::reference::{Matrix, Shares, View};

/// Random number generator that gives the same sequence on every machine.
pub(crate) struct Dice(u64);

impl Dice {
    pub(crate) const fn new(seed: u64) -> Self {
        Self(seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) | 1)
    }

    /// Return a random number from 0 to 1.
    pub(crate) fn roll(&mut self) -> f64 {
        self.0 = self
            .0
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 33) as f64 / f64::from(1u32 << 31)
    }

    pub(crate) fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.roll()
    }

    fn unit(&mut self) -> [f64; 3] {
        loop {
            let v: [f64; 3] = std::array::from_fn(|_| self.between(-1.0, 1.0));
            let square: f64 = v.iter().map(|c| c * c).sum();
            if (0.01..=1.0).contains(&square) {
                return v.map(|c| c / square.sqrt());
            }
        }
    }
}

/// Volume of a small chest with its transform, and points in its airways.
pub(crate) struct Chest {
    pub(crate) shape: [usize; 3],
    pub(crate) hu: Vec<i16>,
    pub(crate) lps_from_ijk: Matrix,
    pub(crate) spacing: [f64; 3],
    /// Ends of the tubes of air, LPS mm.
    pub(crate) lumen: Vec<([f64; 3], [f64; 3])>,
}

/// Return three perpendicular unit vectors, right-handed.
fn frame(dice: &mut Dice) -> [[f64; 3]; 3] {
    let z = dice.unit();
    loop {
        let aside = dice.unit();
        let along: f64 = (0..3).map(|a| aside[a] * z[a]).sum();
        let x: [f64; 3] = std::array::from_fn(|a| aside[a] - along * z[a]);
        let length = x.iter().map(|c| c * c).sum::<f64>().sqrt();
        if length > 0.1 {
            let x = x.map(|c| c / length);
            let y = [
                z[1] * x[2] - z[2] * x[1],
                z[2] * x[0] - z[0] * x[2],
                z[0] * x[1] - z[1] * x[0],
            ];
            return [x, y, z];
        }
    }
}

fn distance_to_segment(p: [f64; 3], (a, b): ([f64; 3], [f64; 3])) -> f64 {
    let along: [f64; 3] = std::array::from_fn(|n| b[n] - a[n]);
    let from: [f64; 3] = std::array::from_fn(|n| p[n] - a[n]);
    let square: f64 = along.iter().map(|c| c * c).sum();
    let t = ((0..3).map(|n| along[n] * from[n]).sum::<f64>() / square).clamp(0.0, 1.0);
    (0..3)
        .map(|n| (from[n] - t * along[n]).powi(2))
        .sum::<f64>()
        .sqrt()
}

impl Chest {
    pub(crate) fn random(dice: &mut Dice) -> Self {
        let noise = dice.between(5.0, 30.0);
        Self::with_noise(dice, noise)
    }

    /// Create a chest with noise of the given amplitude, HU.
    ///
    /// With an amplitude near 0, neighbours have equal or nearly equal values.
    pub(crate) fn with_noise(dice: &mut Dice, noise: f64) -> Self {
        let mut shape: [usize; 3] = std::array::from_fn(|_| dice.between(24.0, 60.0) as usize);
        if dice.roll() < 0.2 {
            // One axis is long, because rounding errors grow with the coordinate.
            shape[(dice.roll() * 3.0) as usize] = dice.between(300.0, 500.0) as usize;
        }
        let spacing: [f64; 3] = std::array::from_fn(|_| dice.between(0.5, 1.6));
        let mut axes = frame(dice);
        if dice.roll() < 0.3 {
            // Slices are in reverse order.
            axes[2] = axes[2].map(|v| -v);
        }
        let offset: [f64; 3] = std::array::from_fn(|_| dice.between(-200.0, 200.0));
        let lps_from_ijk: Matrix = std::array::from_fn(|r| {
            [
                axes[0][r] * spacing[0],
                axes[1][r] * spacing[1],
                axes[2][r] * spacing[2],
                offset[r],
            ]
        });
        // The positions are in mm along the grid's own axes.
        let size: [f64; 3] = std::array::from_fn(|a| shape[a] as f64 * spacing[a]);
        let inside = |dice: &mut Dice| -> [f64; 3] {
            std::array::from_fn(|a| dice.between(0.1, 0.9) * size[a])
        };
        let fork = inside(dice);
        let airways: Vec<_> = (0..4)
            .map(|n| ((fork, inside(dice)), [4.5, 3.5, 2.5, 1.6][n]))
            .collect();
        let vessels: Vec<_> = (0..4)
            .map(|_| ((inside(dice), inside(dice)), dice.between(1.0, 3.0)))
            .collect();
        let mut hu = Vec::with_capacity(shape.iter().product());
        for k in 0..shape[2] {
            for j in 0..shape[1] {
                for i in 0..shape[0] {
                    let p = [
                        i as f64 * spacing[0],
                        j as f64 * spacing[1],
                        k as f64 * spacing[2],
                    ];
                    // Edges are blurred over about 1.5 mm, as by a scanner.
                    let edge = |distance: f64| 1.0 / (1.0 + (distance / 0.35).exp());
                    let mut value = -860.0;
                    for (segment, radius) in &vessels {
                        value += edge(distance_to_segment(p, *segment) - radius) * (40.0 - value);
                    }
                    let airway = |grow: f64| {
                        airways
                            .iter()
                            .map(|(segment, radius)| {
                                edge(distance_to_segment(p, *segment) - radius - grow)
                            })
                            .fold(0.0f64, f64::max)
                    };
                    value += airway(1.6) * (30.0 - value);
                    value += airway(0.0) * (-1000.0 - value);
                    hu.push(value);
                }
            }
        }
        // The noise is correlated along a row like a scan's: each value is the mean of three random numbers.
        let rolls: Vec<f64> = (0..hu.len() + 2).map(|_| dice.between(-1.0, 1.0)).collect();
        let hu = (0..hu.len())
            .map(|n| {
                (hu[n] + noise * (rolls[n] + rolls[n + 1] + rolls[n + 2])).clamp(-1024.0, 3071.0)
                    as i16
            })
            .collect();
        let to_lps = |p: [f64; 3]| -> [f64; 3] {
            std::array::from_fn(|r| offset[r] + (0..3).map(|a| axes[a][r] * p[a]).sum::<f64>())
        };
        let lumen = airways
            .iter()
            .map(|((a, b), _)| (to_lps(*a), to_lps(*b)))
            .collect();
        Self {
            shape,
            hu,
            lps_from_ijk,
            spacing,
            lumen,
        }
    }

    /// Return the LPS point at given fractions of the volume's box along its axes.
    fn at(&self, share: [f64; 3]) -> [f64; 3] {
        std::array::from_fn(|r| {
            let row = self.lps_from_ijk[r];
            row[3]
                + (0..3)
                    .map(|a| row[a] * (share[a] * self.shape[a] as f64 - 0.5))
                    .sum::<f64>()
        })
    }

    /// Return a camera with a random pose and field of view.
    ///
    /// A third of the cameras are in the lumen, a third anywhere in the volume, and a third outside and looking at the
    /// volume. The field of view is 60 to 170 degrees.
    pub(crate) fn view(&self, dice: &mut Dice, width: usize, height: usize) -> View {
        let mut axes = frame(dice);
        let position = match (dice.roll() * 3.0) as u32 {
            0 => {
                let (a, b) = self.lumen[(dice.roll() * self.lumen.len() as f64) as usize];
                let t = dice.roll();
                std::array::from_fn(|n| a[n] + t * (b[n] - a[n]))
            }
            1 => {
                let share = std::array::from_fn(|_| dice.roll());
                self.at(share)
            }
            _ => {
                let share = std::array::from_fn(|_| dice.roll());
                let (target, back) = (self.at(share), dice.between(60.0, 200.0));
                std::array::from_fn(|n| target[n] - back * axes[2][n])
            }
        };
        if dice.roll() < 0.5 {
            axes = [axes[1], axes[0].map(|v| -v), axes[2]];
        }
        View {
            lps_from_camera: std::array::from_fn(|r| {
                [axes[0][r], axes[1][r], axes[2][r], position[r]]
            }),
            fov_rad: dice.between(60.0, 170.0).to_radians(),
            width,
            height,
        }
    }
}

/// Return the transfer functions of the product, each with its name, its points `[hu, r, g, b, alpha]` and its light.
pub(crate) fn transfer_functions() -> Vec<(&'static str, Vec<[f64; 5]>, Shares)> {
    vec![
        (
            "endoscopic",
            vec![
                [-700.0, 0.88, 0.42, 0.38, 0.0],
                [-400.0, 0.95, 0.58, 0.52, 0.97],
                [-100.0, 0.97, 0.68, 0.61, 0.99],
                [200.0, 1.0, 0.80, 0.73, 0.995],
            ],
            [0.26, 0.98, 0.35, 5.0, 26.0],
        ),
        (
            "grey",
            vec![
                [-700.0, 0.35, 0.35, 0.35, 0.0],
                [-400.0, 0.55, 0.55, 0.55, 0.8],
                [50.0, 0.78, 0.78, 0.78, 0.95],
                [400.0, 1.0, 1.0, 1.0, 0.99],
            ],
            [0.15, 0.85, 0.0, 4.0, f64::INFINITY],
        ),
        (
            "see-through",
            vec![
                [-700.0, 0.80, 0.45, 0.40, 0.0],
                [-550.0, 0.85, 0.50, 0.45, 0.10],
                [-300.0, 0.85, 0.50, 0.45, 0.04],
                [-20.0, 0.75, 0.35, 0.30, 0.03],
                [60.0, 0.80, 0.30, 0.25, 0.10],
                [200.0, 0.95, 0.85, 0.70, 0.35],
                [400.0, 1.0, 0.98, 0.92, 0.8],
            ],
            [0.3, 0.7, 0.0, 4.0, f64::INFINITY],
        ),
    ]
}
