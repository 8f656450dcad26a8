//! Half-maximum edges of a blurred airway, computed from the point spread function.
//!
//! The model of an airway is a round tube of lumen with a wall of constant thickness; behind the wall is lung, or
//! tissue as dense as the wall. Along a tube the blur has no effect, so a section is a plane image: two discs blurred
//! by a Gaussian with one standard deviation within the slices and another one towards the slice normal. For each
//! radius, wall and ratio of both blurs, the profile from the centre gives the half-maximum edge and the rise from
//! lumen to wall, as measured in a CT.
//!
//! All lengths are in units of the blur within the slices.

use std::sync::LazyLock;

use rayon::prelude::*;

/// Number of tabulated directions, from within the slice (0 degrees) to across it (90 degrees).
const NUM_DIRECTIONS: usize = 5;
/// Number of lumen radii for which the table of blurred tubes has an entry.
const NUM_RADII: usize = 14;
/// Minimum tabulated lumen radius, in blurs within the slices.
const MIN_RADIUS: f64 = 0.7;
/// Maximum tabulated lumen radius, in blurs within the slices.
const MAX_RADIUS: f64 = 14.0;
/// Tabulated wall thicknesses, in blurs within the slices.
const WALLS: [f64; 8] = [0.25, 0.5, 0.8, 1.2, 1.7, 2.4, 3.4, 5.0];
/// Tabulated ratios of the blur across the slices to the blur within them.
const RATIOS: [f64; 6] = [0.6, 1.0, 1.4, 1.9, 2.8, 4.2];
/// Difference between lung and lumen, as a fraction of the difference between wall and lumen.
const LUNG: f64 = 0.14;

/// Edge and rise of a blurred tube in each tabulated direction, as a CT shows them.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
struct Shown {
    /// Distance of the lumen's half-maximum edge from the centre.
    edge: [f64; NUM_DIRECTIONS],
    /// Rise from the lowest value to the wall's peak, as a fraction of the rise of an unblurred wall.
    rise: [f64; NUM_DIRECTIONS],
}

impl Shown {
    fn add(&mut self, other: &Self, share: f64) {
        for n in 0..NUM_DIRECTIONS {
            self.edge[n] += share * other.edge[n];
            self.rise[n] += share * other.rise[n];
        }
    }
}

struct Tables {
    walled: Vec<Shown>,
    in_tissue: Vec<Shown>,
}

/// Measurements of all tabulated tubes, computed on first use.
static TABLES: LazyLock<Tables> = LazyLock::new(|| {
    let shown = |n: usize, wall: Option<f64>| {
        image(radius_at(n / RATIOS.len()), wall, RATIOS[n % RATIOS.len()])
    };
    let each = NUM_RADII * RATIOS.len();
    Tables {
        walled: (0..WALLS.len() * each)
            .into_par_iter()
            .map(|n| shown(n % each, Some(WALLS[n / each])))
            .collect(),
        in_tissue: (0..each).into_par_iter().map(|n| shown(n, None)).collect(),
    }
});

fn radius_at(n: usize) -> f64 {
    MIN_RADIUS * (MAX_RADIUS / MIN_RADIUS).powf(n as f64 / (NUM_RADII - 1) as f64)
}

/// Limit a lumen radius to the range of the tables.
#[must_use]
pub fn within_tables(radius: f64) -> f64 {
    radius.clamp(MIN_RADIUS, MAX_RADIUS)
}

/// Edges and rises of blurred tubes of one lumen radius, for each tabulated wall thickness.
#[derive(Debug, Clone, Copy)]
pub struct Tube {
    walled: [Shown; WALLS.len()],
    in_tissue: Shown,
}

impl Tube {
    /// Return the edges and rises for a lumen radius, interpolated linearly between tabulated radii and ratios.
    ///
    /// `ratio` is the blur across the slices divided by the blur within them.
    #[must_use]
    pub fn new(radius: f64, ratio: f64) -> Self {
        let at = (within_tables(radius) / MIN_RADIUS).ln() / (MAX_RADIUS / MIN_RADIUS).ln()
            * (NUM_RADII - 1) as f64;
        let r = (at as usize).min(NUM_RADII - 2);
        let mut tube = Self {
            walled: [Shown::default(); WALLS.len()],
            in_tissue: Shown::default(),
        };
        for (r, of_radius) in [(r, 1.0 - (at - r as f64)), (r + 1, at - r as f64)] {
            for (q, of_ratio) in between(&RATIOS, ratio) {
                let (place, share) = (r * RATIOS.len() + q, of_radius * of_ratio);
                tube.in_tissue.add(&TABLES.in_tissue[place], share);
                for (w, walled) in tube.walled.iter_mut().enumerate() {
                    walled.add(&TABLES.walled[w * NUM_RADII * RATIOS.len() + place], share);
                }
            }
        }
        tube
    }

    /// Return the half-maximum edge of the lumen in a direction (0 within the slice, 1 across it) if tissue follows the
    /// lumen.
    #[must_use]
    pub fn edge_in_tissue(&self, turn: f64) -> f64 {
        at_turn(&self.in_tissue.edge, turn)
    }

    /// Find the wall thickness at which a blurred tube shows the measured `rise` in the direction `turn` (0 within the
    /// slice, 1 across it); return the thickness and the lumen's half-maximum edge, both in blurs within the slices.
    #[must_use]
    pub fn wall_that_rises(&self, rise: f64, turn: f64) -> (f64, f64) {
        let of = |w: usize| {
            let walled = &self.walled[w];
            (at_turn(&walled.rise, turn), at_turn(&walled.edge, turn))
        };
        let mut before = of(0);
        if rise <= before.0 {
            return (WALLS[0], before.1);
        }
        for w in 1..WALLS.len() {
            let after = of(w);
            if rise <= after.0 {
                let share = (rise - before.0) / (after.0 - before.0);
                let wall = WALLS[w - 1] + share * (WALLS[w] - WALLS[w - 1]);
                return (wall, before.1 + share * (after.1 - before.1));
            }
            if after.0 > before.0 {
                before = after;
            }
        }
        (WALLS[WALLS.len() - 1], self.edge_in_tissue(turn))
    }
}

/// Interpolate tabulated values at a direction between within the slice (0) and across it (1).
fn at_turn(values: &[f64; NUM_DIRECTIONS], turn: f64) -> f64 {
    let at = turn * (NUM_DIRECTIONS - 1) as f64;
    let before = (at as usize).min(NUM_DIRECTIONS - 2);
    values[before] + (at - before as f64) * (values[before + 1] - values[before])
}

/// Return the indices of the two entries of an ascending list around `value`, with weights by the value's logarithm.
fn between(list: &[f64], value: f64) -> [(usize, f64); 2] {
    let value = value.clamp(list[0], list[list.len() - 1]);
    let after = list
        .partition_point(|v| *v < value)
        .clamp(1, list.len() - 1);
    let share = (value / list[after - 1]).ln() / (list[after] / list[after - 1]).ln();
    [(after - 1, 1.0 - share), (after, share)]
}

/// Compute the profiles of one blurred tube in all directions and measure their edges and rises.
///
/// `wall` is `None` for a lumen in thick tissue. `ratio` is the blur across the slices divided by the blur within them.
fn image(radius: f64, wall: Option<f64>, ratio: f64) -> Shown {
    let widest = ratio.max(1.0);
    let step = 0.1;
    let num = ((radius + wall.unwrap_or(0.0) + 3.5 * widest) / step) as usize;
    let inner = Disc::new(radius, ratio);
    let outer = wall.map(|wall| Disc::new(radius + wall, ratio));
    let mut found = Shown::default();
    for n in 0..NUM_DIRECTIONS {
        let turn = std::f64::consts::FRAC_PI_2 * n as f64 / (NUM_DIRECTIONS - 1) as f64;
        let (sin, cos) = turn.sin_cos();
        let values: Vec<f64> = (0..num)
            .map(|k| {
                let [x, y] = [k as f64 * step * cos, k as f64 * step * sin];
                let behind = outer.as_ref().map_or(0.0, |o| 1.0 - o.share(x, y));
                1.0 - inner.share(x, y) - (1.0 - LUNG) * behind
            })
            .collect();
        let peak_at = (0..num).max_by(|&a, &b| values[a].total_cmp(&values[b]));
        let peak_at = peak_at.unwrap_or(0);
        let low_at = (0..=peak_at).min_by(|&a, &b| values[a].total_cmp(&values[b]));
        let low_at = low_at.unwrap_or(0);
        let half = 0.5 * (values[low_at] + values[peak_at]);
        let before = (low_at..peak_at)
            .rev()
            .find(|&k| values[k] < half)
            .unwrap_or(low_at);
        let (a, b) = (values[before], values[(before + 1).min(num - 1)]);
        let share = if b > a { (half - a) / (b - a) } else { 0.0 };
        found.edge[n] = (before as f64 + share) * step;
        found.rise[n] = values[peak_at] - values[low_at];
    }
    found
}

/// Return the integral of the standard normal distribution up to `x` (Abramowitz and Stegun 7.1.26: accurate to
/// 1.5e-7).
pub(crate) fn normal_cdf(x: f64) -> f64 {
    let z = x.abs() / std::f64::consts::SQRT_2;
    let t = 1.0 / (1.0 + 0.327_591_1 * z);
    let series = t
        * (0.254_829_592
            + t * (-0.284_496_736
                + t * (1.421_413_741 + t * (-1.453_152_027 + t * 1.061_405_429))));
    let erf = 1.0 - series * (-z * z).exp();
    0.5 * (1.0 + if x < 0.0 { -erf } else { erf })
}

/// Disc of the model, to be blurred, divided into strips along the second axis.
struct Disc {
    /// Strips of the disc: position along the first axis, half of the height, and weight.
    strips: Vec<[f64; 3]>,
    ratio: f64,
}

impl Disc {
    fn new(radius: f64, ratio: f64) -> Self {
        // The strips are at midpoints of equal angles, so they become narrower towards the ends, where the height
        // changes most.
        let num = (6.0 * radius).ceil().clamp(20.0, 90.0) as usize;
        let each = std::f64::consts::PI / num as f64;
        let strips = (0..num)
            .map(|n| {
                let turn = -std::f64::consts::FRAC_PI_2 + (n as f64 + 0.5) * each;
                let (sin, cos) = turn.sin_cos();
                [
                    radius * sin,
                    radius * cos,
                    radius * cos * each / std::f64::consts::TAU.sqrt(),
                ]
            })
            .collect();
        Self { strips, ratio }
    }

    /// Return the fraction of the point spread function, centred at a position, that is inside the disc.
    fn share(&self, x: f64, y: f64) -> f64 {
        self.strips
            .iter()
            .filter(|[u, ..]| (x - u).abs() < 5.0)
            .map(|&[u, half, weight]| {
                let along =
                    normal_cdf((y + half) / self.ratio) - normal_cdf((y - half) / self.ratio);
                weight * (-0.5 * (x - u) * (x - u)).exp() * along
            })
            .sum()
    }
}
