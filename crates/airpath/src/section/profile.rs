//! Profile of CT values along a ray, and the edges of lumen and wall in a profile.

use carina_grid::VolumeView;

/// Minimum fall of the values behind a wall's peak that shows the wall's far side, as a fraction of the rise to the
/// peak.
const FALL: f32 = 0.3;
/// Length of a ray behind the lumen's edge in which the wall's far side is searched, mm.
///
/// Walls are 1 to 3 mm thick.
pub(crate) const WALL_REACH_MM: f64 = 5.0;

/// Levels that distinguish lumen, wall and noise, in the units of the CT values.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SectionLevels {
    /// Rise of the values from the lumen below which a maximum is not a wall.
    pub min_contrast: f32,
    /// Value to which the values of a wall are limited, because of calcified cartilage and vessels with contrast
    /// medium.
    pub brightest_wall: f32,
    /// Rise of a wall of soft tissue above air.
    pub wall_rise: f32,
    /// Standard deviation of the CT's noise.
    pub noise: f32,
}

/// CT values at constant intervals along a ray.
#[derive(Debug, Clone, Default)]
pub struct Profile {
    /// Distance in mm between successive values of the profile.
    pub step_mm: f64,
    /// CT values along the ray; the first is at the ray's origin.
    pub values: Vec<f32>,
    /// Whether the ray left the volume before it had its full length.
    pub left_volume: bool,
}

impl Profile {
    /// Read the values of a CT along a ray of at most `length_mm` into this profile.
    ///
    /// `dir_ijk` is a step of 1 mm along the ray, in voxels.
    pub fn read(
        &mut self,
        values: VolumeView<'_, i16>,
        from_ijk: [f64; 3],
        dir_ijk: [f64; 3],
        step_mm: f64,
        length_mm: f64,
    ) {
        self.step_mm = step_mm;
        self.values.clear();
        self.left_volume = false;
        let shape = values.grid().shape_ijk();
        let num_steps = (length_mm / step_mm).ceil() as usize;
        for n in 0..=num_steps {
            let s = n as f64 * step_mm;
            let ijk: [f64; 3] = std::array::from_fn(|a| from_ijk[a] + s * dir_ijk[a]);
            // A voxel extends by half a step to both sides of its centre.
            if (0..3).any(|a| !(-0.5..shape[a] as f64 - 0.5).contains(&ijk[a])) {
                self.left_volume = true;
                return;
            }
            self.values.push(value_at(values, ijk));
        }
    }

    /// Return the distance in mm from the ray's origin at which the values after index `before` cross a level.
    ///
    /// The values are interpolated linearly between `before` and its successor.
    fn crossing_mm(&self, before: usize, level: f32) -> f64 {
        let (low, high) = (self.values[before], self.values[before + 1]);
        let share = if low == high {
            0.5
        } else {
            f64::from((level - low) / (high - low))
        };
        (before as f64 + share) * self.step_mm
    }
}

/// Edges of lumen and wall along one ray.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Edges {
    /// Distance of the lumen's edge from the ray's origin, mm; `None` if the ray met no wall.
    pub inner_mm: Option<f64>,
    /// Distance of the wall's far side from the ray's origin, mm; `None` if the wall has none.
    pub outer_mm: Option<f64>,
    /// Length along the ray in mm over which the lumen's edge rises from a quarter to three quarters; NaN if not
    /// visible.
    pub flank_mm: f64,
    /// Rise from the lumen's lowest value to the wall's peak.
    pub rise: f64,
    /// Whether the ray left the volume before it met a wall.
    pub left_volume: bool,
}

impl Edges {
    /// Return the mean slope of the lumen's edge between a quarter and three quarters of its rise, per mm.
    #[must_use]
    pub fn slope_per_mm(&self) -> f64 {
        0.5 * self.rise / self.flank_mm.max(1e-3)
    }

    /// Return the blur that an edge against thick tissue shows, as a standard deviation in mm; `None` for any other
    /// edge.
    #[must_use]
    pub fn sigma_mm(&self) -> Option<f64> {
        // The integral of a Gaussian takes 1.349 standard deviations from a quarter to three quarters.
        (self.inner_mm.is_some() && self.outer_mm.is_none() && self.flank_mm > 0.0)
            .then(|| self.flank_mm / 1.349)
    }
}

/// Find the half-maximum edges of lumen and wall in a profile.
///
/// The lumen's edge is at most `reach_mm` from the ray's origin.
#[must_use]
pub fn edges_of(profile: &Profile, reach_mm: f64, levels: SectionLevels) -> Edges {
    let values = &profile.values;
    let none = Edges {
        left_volume: profile.left_volume,
        ..Edges::default()
    };
    let least_rise = levels.min_contrast.max(4.0 * levels.noise);
    // The wall begins where the values have risen enough above the lowest value so far.
    let mut low = f32::INFINITY;
    let mut rise_at = None;
    for (n, &value) in values.iter().enumerate() {
        low = low.min(value);
        if value - low >= least_rise {
            rise_at = Some(n);
            break;
        }
        if n as f64 * profile.step_mm > reach_mm {
            return Edges {
                left_volume: false,
                ..none
            };
        }
    }
    let Some(rise_at) = rise_at else { return none };

    // The wall's peak is the highest value before the values fall again, or within the largest thickness of a wall.
    let wall_steps = (WALL_REACH_MM / profile.step_mm).ceil() as usize;
    let (mut peak, mut peak_at) = (f32::NEG_INFINITY, rise_at);
    for (n, &value) in values.iter().enumerate().skip(rise_at).take(wall_steps) {
        let value = value.min(levels.brightest_wall);
        if value > peak {
            (peak, peak_at) = (value, n);
        } else if peak - value >= FALL * (peak - low) {
            break;
        }
    }
    let half = 0.5 * (low + peak);
    let Some(before) = (0..peak_at).rev().find(|&n| values[n] < half) else {
        return none;
    };
    let inner_mm = profile.crossing_mm(before, half);
    if inner_mm > reach_mm {
        return Edges {
            left_volume: false,
            ..none
        };
    }
    // Positions of a quarter and of three quarters of the rise on the flank that contains the lumen's edge.
    let level = |share: f32| low + share * (peak - low);
    let quarter = (0..=before).rev().find(|&n| values[n] < level(0.25));
    let three = (before..peak_at).find(|&n| values[n + 1] >= level(0.75));
    let flank_mm = match (quarter, three) {
        (Some(q), Some(t)) => {
            profile.crossing_mm(t, level(0.75)) - profile.crossing_mm(q, level(0.25))
        }
        _ => f64::NAN,
    };
    Edges {
        inner_mm: Some(inner_mm),
        outer_mm: outer_mm(profile, peak_at, peak, low, wall_steps),
        flank_mm,
        rise: f64::from(peak - low),
        left_volume: false,
    }
}

/// Return the distance of the wall's far side from the ray's origin, mm; `None` if the values do not fall behind the
/// wall.
///
/// The far side is half-way between the wall's peak and the lowest value behind the peak.
fn outer_mm(
    profile: &Profile,
    peak_at: usize,
    peak: f32,
    low: f32,
    wall_steps: usize,
) -> Option<f64> {
    let (mut behind, fall) = (f32::INFINITY, FALL * (peak - low));
    let window = profile.values.iter().skip(peak_at).take(wall_steps);
    for &value in window.clone() {
        behind = behind.min(value);
        // A further rise is another structure.
        if peak - behind >= fall && value - behind >= fall {
            break;
        }
    }
    if peak - behind < fall {
        return None;
    }
    let half = 0.5 * (peak + behind);
    let after = window.clone().position(|&value| value < half)?;
    (after > 0).then(|| profile.crossing_mm(peak_at + after - 1, half))
}

/// Interpolate the value of a volume at a point between voxels: Catmull-Rom along each axis.
///
/// Beyond the last voxel, the value of that voxel is used. Unlike linear interpolation, this method hardly blurs: a
/// lumen of three voxels keeps its width.
#[must_use]
pub fn value_at(values: VolumeView<'_, i16>, ijk: [f64; 3]) -> f32 {
    let base = ijk.map(|v| v.floor() as isize);
    let weights: [[f32; 4]; 3] =
        std::array::from_fn(|a| catmull_rom((ijk[a] - base[a] as f64) as f32));
    let shape = values.grid().shape_ijk();
    let is_inner = (0..3).all(|a| base[a] >= 1 && base[a] + 2 < shape[a] as isize);
    let mut sum = 0.0;
    for (dk, wk) in weights[2].iter().enumerate() {
        let mut plane = 0.0;
        for (dj, wj) in weights[1].iter().enumerate() {
            let (j, k) = (base[1] + dj as isize - 1, base[2] + dk as isize - 1);
            let mut row = 0.0;
            if is_inner {
                let at = (k as usize * shape[1] + j as usize) * shape[0] + base[0] as usize - 1;
                for (value, wi) in values.data()[at..at + 4].iter().zip(&weights[0]) {
                    row += wi * f32::from(*value);
                }
            } else {
                for (di, wi) in weights[0].iter().enumerate() {
                    row += wi * f32::from(values.at_clamped([base[0] + di as isize - 1, j, k]));
                }
            }
            plane += wj * row;
        }
        sum += wk * plane;
    }
    sum
}

/// Return the Catmull-Rom weights of the values at -1, 0, 1 and 2 for a point at `t` between 0 and 1.
fn catmull_rom(t: f32) -> [f32; 4] {
    let (t2, t3) = (t * t, t * t * t);
    [
        0.5 * (2.0 * t2 - t - t3),
        0.5 * (3.0 * t3 - 5.0 * t2 + 2.0),
        0.5 * (4.0 * t2 - 3.0 * t3 + t),
        0.5 * (t3 - t2),
    ]
}
