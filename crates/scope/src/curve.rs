use carina_grid::{Affine, cross, dot, length, unit};

use crate::ScopeError;
use crate::frames::rotation_minimising_frames;
use crate::gaze::{gaze, smoothed};

/// Distance between the knots of the curve, mm.
///
/// The knots are much closer than voxels, so the straight lines between them look like a curve.
const STEP_MM: f64 = 0.25;
/// Sigma of the smoothing of positions, mm, which removes the steps of voxels but not the bends of an airway.
const POSITION_SIGMA_MM: f64 = 2.0;
/// Distance from a point to the centre of the Gaussian that weights the tangents ahead of the point for the gaze, mm.
const GAZE_AHEAD_MM: f64 = 3.0;
/// Sigma of the Gaussian that weights the tangents ahead of a point for the gaze, mm.
///
/// The Gaussian covers about the length of one subsegmental airway (7 to 10 mm).
const GAZE_SIGMA_MM: f64 = 4.0;
/// Sigma of the smoothing of tangents, mm, so that planes across the curve do not rock with the remaining voxel steps.
const TANGENT_SIGMA_MM: f64 = 2.0;
/// Maximum length of a path, mm, longer than any patient; a longer path is invalid and would need unlimited memory.
const MAX_LENGTH_MM: f64 = 20_000.0;

/// Point of a curve that is nearest to a given point.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Nearest {
    /// Position of the nearest point, in mm along the polyline of the curve.
    pub path_mm: f64,
    /// Distance in mm of the given point from the curve.
    pub distance_mm: f64,
}

/// Smooth curve with camera frames, computed from a polyline.
///
/// Positions on the curve are in millimetres *of the polyline*, so that forks and generations along the polyline
/// keep their positions; the curve itself is a little shorter. Every point of the curve is within `max_deviation_mm` of
/// the polyline.
#[derive(Debug, Clone, PartialEq)]
pub struct FlightCurve {
    step_mm: f64,
    length_mm: f64,
    frames: Vec<Affine>,
    up: [f64; 3],
}

impl FlightCurve {
    /// Create a curve along `points` (LPS mm, root to tip; repeated points are allowed).
    ///
    /// `up` is the direction that appears up at the start; `None` selects anterior, or superior if the start looks
    /// along the antero-posterior axis (head-end position of the operator).
    ///
    /// # Errors
    ///
    /// Returns an error if the points are not a path, if `up` has no length or is along the gaze, or if the deviation is
    /// out of range.
    pub fn new(
        points: &[[f64; 3]],
        up: Option<[f64; 3]>,
        max_deviation_mm: f64,
    ) -> Result<Self, ScopeError> {
        let refuse = |reason: String| Err(ScopeError::Path { reason });
        // The chords of the resampled line need half a step of the deviation, so the deviation has a lower limit.
        if !(0.2..=10.0).contains(&max_deviation_mm) {
            return Err(ScopeError::Deviation {
                found_mm: max_deviation_mm,
            });
        }
        if points.iter().flatten().any(|v| !v.is_finite()) {
            return refuse("it contains coordinates that are not finite".to_owned());
        }
        let mut line: Vec<[f64; 3]> = Vec::with_capacity(points.len());
        let mut cumulative: Vec<f64> = Vec::with_capacity(points.len());
        for &p in points {
            let Some(&before) = line.last() else {
                line.push(p);
                cumulative.push(0.0);
                continue;
            };
            let gap = length(std::array::from_fn(|a| p[a] - before[a]));
            if gap > 1e-9 {
                cumulative.push(cumulative[cumulative.len() - 1] + gap);
                line.push(p);
            }
        }
        if line.len() < 2 {
            return refuse(format!(
                "it needs at least two different points; found {}",
                line.len()
            ));
        }
        let length_mm = cumulative[cumulative.len() - 1];
        if length_mm > MAX_LENGTH_MM {
            return refuse(format!(
                "it is {length_mm:.0} mm long, and no airway is longer than {MAX_LENGTH_MM:.0} mm"
            ));
        }
        let num_steps = (length_mm / STEP_MM).ceil().max(1.0) as usize;
        let step_mm = length_mm / num_steps as f64;
        let even = resampled(&line, &cumulative, step_mm, num_steps);
        // A knot may deviate from its position on the polyline by `reach`; a chord between two positions one step apart
        // cuts a corner by at most half a step. The sum is within the given deviation.
        let reach = max_deviation_mm - STEP_MM / 2.0;
        let knots: Vec<[f64; 3]> = smoothed(&even, POSITION_SIGMA_MM, step_mm)
            .iter()
            .zip(&even)
            .map(|(s, e)| {
                let away: [f64; 3] = std::array::from_fn(|a| s[a] - e[a]);
                let far = length(away);
                // The hyperbolic tangent limits the deviation to `reach` without a kink where the limit takes effect.
                let shrink = if far > 1e-12 {
                    reach * libm::tanh(far / reach) / far
                } else {
                    1.0
                };
                std::array::from_fn(|a| e[a] + shrink * away[a])
            })
            .collect();
        let gazes = gaze(&knots, GAZE_AHEAD_MM, GAZE_SIGMA_MM, step_mm);
        let up = match up {
            Some(up) => unit(up).ok_or(ScopeError::Up {
                reason: "has zero length",
            })?,
            // A cosine of 0.99 is an angle of 8 degrees to the anterior axis, within which "anterior up" is undefined.
            None if gazes[0][1].abs() < 0.99 => [0.0, -1.0, 0.0],
            None => [0.0, 0.0, 1.0],
        };
        if length(cross(up, gazes[0])) < 1e-3 {
            return Err(ScopeError::Up {
                reason: "is parallel to the start of the path",
            });
        }
        let frames = frames_along(&knots, &gazes, up, step_mm).ok_or(ScopeError::Up {
            reason: "is parallel to the start of the path",
        })?;
        Ok(Self {
            step_mm,
            length_mm,
            frames,
            up,
        })
    }

    /// Return the length of the polyline of the curve, mm.
    #[must_use]
    pub const fn length_mm(&self) -> f64 {
        self.length_mm
    }

    /// Return the number of knots of the curve's spline.
    #[must_use]
    pub const fn num_knots(&self) -> usize {
        self.frames.len()
    }

    /// Return the positions of the knots, evenly spaced in mm of the polyline.
    pub fn knots(&self) -> impl Iterator<Item = [f64; 3]> + '_ {
        self.frames.iter().map(|f| f.column(3))
    }

    /// Return the distance between the knots of the spline, in mm along the polyline.
    #[must_use]
    pub const fn step_mm(&self) -> f64 {
        self.step_mm
    }

    /// Return a frame at each knot whose +z axis is the tangent of the curve, not the direction of view.
    ///
    /// Right and down span the plane across the airway.
    ///
    /// The frames rotate about the direction as little as possible.
    #[must_use]
    pub fn tangent_frames(&self) -> Vec<Affine> {
        let knots: Vec<[f64; 3]> = self.knots().collect();
        let tangents = gaze(&knots, 0.0, TANGENT_SIGMA_MM, self.step_mm);
        // The gaze at the start is within a bend of the tangent. If `up` is along the tangent, the up direction of the
        // gaze's frame is used, which is not.
        frames_along(&knots, &tangents, self.up, self.step_mm)
            .or_else(|| {
                let up = self.frames[0].column(1).map(|v| -v);
                frames_along(&knots, &tangents, up, self.step_mm)
            })
            .unwrap_or_else(|| self.frames.clone())
    }

    /// Return the pose of the camera (`lps_from_camera`) at a position in mm along the polyline, clamped to the ends.
    #[must_use]
    pub fn pose_at(&self, path_mm: f64) -> Affine {
        let last = self.frames.len() - 1;
        // NaN becomes the start, because `max` returns the other operand.
        let at = (path_mm.max(0.0) / self.step_mm).min(last as f64);
        let i = (at as usize).min(last - 1);
        let t = at - i as f64;
        let (a, b) = (&self.frames[i], &self.frames[i + 1]);
        let mix = |c: usize| -> [f64; 3] {
            let (p, q) = (a.column(c), b.column(c));
            std::array::from_fn(|k| (1.0 - t) * p[k] + t * q[k])
        };
        // Neighbouring frames differ little, so mixing and orthonormalising their axes is a rotation between them.
        let forward = unit(mix(2)).unwrap_or_else(|| a.column(2));
        let down = mix(1);
        let slant = dot(down, forward);
        let down =
            unit(std::array::from_fn(|k| down[k] - slant * forward[k])).unwrap_or_else(|| {
                // Mixed axes have no direction only if a path reverses within one step; the previous frame is then
                // used.
                a.column(1)
            });
        Affine::from_columns(cross(down, forward), down, forward, mix(3))
    }

    /// Return the position on the curve that is nearest to a point (LPS mm).
    #[must_use]
    pub fn nearest(&self, point: [f64; 3]) -> Nearest {
        let mut best = Nearest {
            path_mm: 0.0,
            distance_mm: f64::INFINITY,
        };
        for (i, pair) in self.frames.windows(2).enumerate() {
            let (a, b) = (pair[0].column(3), pair[1].column(3));
            let ab: [f64; 3] = std::array::from_fn(|k| b[k] - a[k]);
            let ap: [f64; 3] = std::array::from_fn(|k| point[k] - a[k]);
            let t = (dot(ap, ab) / dot(ab, ab).max(1e-30)).clamp(0.0, 1.0);
            let distance_mm = length(std::array::from_fn(|k| ap[k] - t * ab[k]));
            if distance_mm < best.distance_mm {
                best = Nearest {
                    path_mm: (i as f64 + t) * self.step_mm,
                    distance_mm,
                };
            }
        }
        best.path_mm = best.path_mm.min(self.length_mm);
        best
    }
}

/// Return camera frames at `knots` that look along the directions `looks`; `None` if `up` is along the first of them.
///
/// Double reflection needs a curve and its tangents. The looks are not the tangents of the curve through the knots, so
/// the frames are computed along a curve with these tangents, and then moved to the knots.
fn frames_along(
    knots: &[[f64; 3]],
    looks: &[[f64; 3]],
    up: [f64; 3],
    step_mm: f64,
) -> Option<Vec<Affine>> {
    let mut along = vec![[0.0; 3]; looks.len()];
    for i in 1..looks.len() {
        along[i] = std::array::from_fn(|a| {
            along[i - 1][a] + 0.5 * step_mm * (looks[i - 1][a] + looks[i][a])
        });
    }
    let frames = rotation_minimising_frames(&along, looks, up)?;
    Some(
        frames
            .iter()
            .zip(knots)
            .map(|(f, &knot)| Affine::from_columns(f.column(0), f.column(1), f.column(2), knot))
            .collect(),
    )
}

/// Return `num_steps + 1` points every `step_mm` along a polyline, including both ends.
fn resampled(
    line: &[[f64; 3]],
    cumulative: &[f64],
    step_mm: f64,
    num_steps: usize,
) -> Vec<[f64; 3]> {
    let mut segment = 0;
    (0..=num_steps)
        .map(|n| {
            if n == num_steps {
                return line[line.len() - 1];
            }
            let at = n as f64 * step_mm;
            while segment + 2 < line.len() && cumulative[segment + 1] <= at {
                segment += 1;
            }
            let (s0, s1) = (cumulative[segment], cumulative[segment + 1]);
            let t = ((at - s0) / (s1 - s0)).clamp(0.0, 1.0);
            let (a, b) = (line[segment], line[segment + 1]);
            std::array::from_fn(|k| a[k] + t * (b[k] - a[k]))
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn distance_to_line(p: [f64; 3], line: &[[f64; 3]]) -> f64 {
        line.windows(2)
            .map(|w| {
                let ab: [f64; 3] = std::array::from_fn(|k| w[1][k] - w[0][k]);
                let ap: [f64; 3] = std::array::from_fn(|k| p[k] - w[0][k]);
                let t = (dot(ap, ab) / dot(ab, ab).max(1e-30)).clamp(0.0, 1.0);
                length(std::array::from_fn(|k| ap[k] - t * ab[k]))
            })
            .fold(f64::INFINITY, f64::min)
    }

    /// Return a polyline with the steps of anisotropic voxels along a slanted line, as a voxel tracker returns it.
    fn staircase() -> Vec<[f64; 3]> {
        let spacing = [0.7, 0.8, 1.25];
        (0..150)
            .map(|i| {
                let f = f64::from(i);
                let wanted = [0.25 * f, 5.0 * libm::sin(f * 0.02), -0.6 * f];
                std::array::from_fn(|a| (wanted[a] / spacing[a]).round() * spacing[a])
            })
            .collect()
    }

    proptest! {
        #[test]
        fn the_curve_stays_within_the_stated_distance_and_its_frames_are_rigid(
            turns in prop::collection::vec(prop::array::uniform3(-1.0f64..1.0), 2..40),
            step in 0.3f64..6.0,
            deviation in 0.2f64..2.0,
        ) {
            let mut line = vec![[3.0, -7.0, 90.0]];
            for t in &turns {
                let last = line[line.len() - 1];
                line.push(std::array::from_fn(|a| last[a] + step * t[a]));
            }
            let Ok(curve) = FlightCurve::new(&line, None, deviation) else { return Ok(()) };
            for n in 0..=200 {
                let pose = curve.pose_at(curve.length_mm() * f64::from(n) / 200.0);
                // The tolerance of 1e-9 allows for the rounding of coordinates of some hundred mm.
                prop_assert!(distance_to_line(pose.column(3), &line) <= deviation + 1e-9);
                prop_assert!(pose.is_rigid(1e-12));
            }
        }

        #[test]
        fn the_nearest_position_of_a_point_on_the_curve_is_its_own_position(at in 0.0f64..1.0) {
            let curve = FlightCurve::new(&staircase(), None, 0.5).unwrap();
            let there = at * curve.length_mm();
            let found = curve.nearest(curve.pose_at(there).column(3));
            prop_assert!(found.distance_mm < 1e-9);
            // Across a voxel step, two positions are near each other in space but one step apart along the polyline.
            prop_assert!((found.path_mm - there).abs() < 1.0);
        }
    }

    #[test]
    fn the_gaze_on_a_staircase_of_voxels_turns_slowly() {
        let curve = FlightCurve::new(&staircase(), None, 0.5).unwrap();
        // The slanted line itself turns by less than 0.5 degrees per mm; its voxel steps differ from it by up to 50
        // degrees.
        let mut last = curve.pose_at(0.0);
        let mut worst: f64 = 0.0;
        let num = curve.length_mm() as usize;
        for mm in 1..=num {
            let pose = curve.pose_at(mm as f64);
            worst = worst.max(libm::acos(dot(pose.column(2), last.column(2)).min(1.0)));
            last = pose;
        }
        assert!(
            worst.to_degrees() < 2.0,
            "{} degrees per mm",
            worst.to_degrees()
        );
    }

    #[test]
    fn the_start_has_anterior_up_and_the_patients_right_on_the_right() {
        // The camera looks caudally from the head end (docs/conventions.md, left and right): -y is anterior, -x is the
        // patient's right.
        let curve = FlightCurve::new(&[[5.0, 6.0, 100.0], [5.0, 6.0, 0.0]], None, 0.5).unwrap();
        let near = |found: [f64; 3], wanted: [f64; 3]| {
            // The tolerance of 1e-12 allows for the rounding of the weighted means.
            assert!(
                length(std::array::from_fn(|a| found[a] - wanted[a])) < 1e-12,
                "{found:?}"
            );
        };
        let pose = curve.pose_at(50.0);
        near(pose.column(0), [-1.0, 0.0, 0.0]);
        near(pose.column(1), [0.0, 1.0, 0.0]);
        near(pose.column(2), [0.0, 0.0, -1.0]);
        near(curve.pose_at(0.0).column(3), [5.0, 6.0, 100.0]);
        near(curve.pose_at(1e9).column(3), [5.0, 6.0, 0.0]);
    }

    #[test]
    fn invalid_paths_are_rejected_and_a_very_short_path_is_accepted() {
        let p = [1.0, 2.0, 3.0];
        assert!(FlightCurve::new(&[], None, 0.5).is_err());
        assert!(FlightCurve::new(&[p, p, p], None, 0.5).is_err());
        assert!(FlightCurve::new(&[p, [f64::NAN, 0.0, 0.0]], None, 0.5).is_err());
        assert!(FlightCurve::new(&[p, [1e9, 0.0, 0.0]], None, 0.5).is_err());
        assert!(FlightCurve::new(&[p, [1.0, 2.0, 9.0]], Some([0.0, 0.0, 2.0]), 0.5).is_err());
        assert!(FlightCurve::new(&[p, [1.0, 2.0, 9.0]], None, f64::NAN).is_err());
        let short = FlightCurve::new(&[p, [1.0, 2.0, 3.01]], None, 0.5).unwrap();
        assert!(short.pose_at(0.005).is_rigid(1e-12));
    }

    #[test]
    fn tangent_frames_are_perpendicular_to_the_curve_and_do_not_twist() {
        // The path is a quarter circle of radius 40 mm in the coronal plane, with straight ends.
        let points: Vec<[f64; 3]> = (0..=200)
            .map(|i| {
                let s = f64::from(i) * 0.5;
                if s < 20.0 {
                    return [0.0, 0.0, -s];
                }
                let angle = ((s - 20.0) / 40.0).min(std::f64::consts::FRAC_PI_2);
                let rest = (s - 20.0 - 40.0 * std::f64::consts::FRAC_PI_2).max(0.0);
                [
                    40.0 * (1.0 - libm::cos(angle)) + rest,
                    0.0,
                    -20.0 - 40.0 * libm::sin(angle),
                ]
            })
            .collect();
        let curve = FlightCurve::new(&points, None, 0.5).unwrap();
        let frames = curve.tangent_frames();
        let knots: Vec<[f64; 3]> = curve.knots().collect();
        assert_eq!(frames.len(), knots.len());
        for i in 1..frames.len() - 1 {
            assert!(frames[i].is_rigid(1e-9));
            assert_eq!(frames[i].column(3), knots[i]);
            // The down direction stays posterior, because the curve is in the coronal plane.
            assert!((frames[i].column(1)[1] - 1.0).abs() < 1e-6, "{i}");
            let chord = unit(std::array::from_fn(|a| knots[i + 1][a] - knots[i - 1][a])).unwrap();
            // The tolerance of 2 degrees is the effect of the smoothing over 2 mm at the beginning of a bend of radius
            // 40 mm.
            assert!(dot(chord, frames[i].column(2)) > 0.9994, "{i}");
        }
    }
}
