//! Smooth centrelines that stay inside the lumen.
//!
//! A chain of voxel centres has steps. The chain is resampled evenly and smoothed by penalised least squares (Whittaker
//! 1923, second differences; Eilers 2003): minimise `sum w |x - y|^2 + lambda sum |x[n-1] - 2 x[n] + x[n+1]|^2`. Points
//! that would leave the lumen are pulled back, first to just inside, then to the chain, which never leaves the lumen,
//! until all points are inside.

use carina_grid::length;

/// Point in LPS, mm.
pub type Point = [f64; 3];

/// Length of a bend, in a tube of [`REFERENCE_RADIUS_MM`], below which it counts as a voxel step and not as anatomy,
/// mm.
const SHORTEST_BEND_MM: f64 = 18.0;
/// Radius of the tube to which `SHORTEST_BEND_MM` applies, mm.
///
/// Wider tubes are smoothed more, because their middle is known less exactly and the chain may deviate more.
const REFERENCE_RADIUS_MM: f64 = 2.0;
/// Maximum number of rounds, after the gentle ones, in which points outside the lumen are pulled to the chain.
const MAX_ROUNDS: usize = 24;
/// Number of first rounds, in which a point outside the lumen is only pulled to just inside, so that the curve stays
/// smooth.
///
/// If the lumen is thinner than the slices, the chain has corners, and a curve that is pulled onto the chain would get
/// them.
const GENTLE_ROUNDS: usize = 16;
/// Step of the search for a position inside the lumen, as a fraction of the distance to the chain.
const GENTLE_SHARE: f64 = 0.125;
/// Minimum weight of a point after the smoothing has pulled it inside the lumen.
const GENTLE_PULL: f64 = 1.0;
/// Cosine of the largest turn between successive points that is not a sharp corner: 20 degrees.
const SHARP_COSINE: f64 = 0.94;
/// Maximum number of rounds in which sharp corners are spread over neighbouring points.
const RELAXING_ROUNDS: usize = 30;
/// Share of the way to the middle of its neighbours by which a corner moves in one round.
const RELAXING_SHARE: f64 = 0.5;
/// Weight of a point that the smoothing must not move.
pub const FIXED: f64 = 1e9;

/// Return the weight with which a point of the chain attracts the curve, for a tube of this radius.
#[must_use]
pub fn pull_of(radius_mm: f64) -> f64 {
    (REFERENCE_RADIUS_MM / radius_mm.max(0.1))
        .powi(2)
        .clamp(0.05, 4.0)
}

/// Return points at equal distances of at most `step_mm` along a chain, with both ends unchanged.
///
/// Also return the distance of each point along the chain, mm.
#[must_use]
pub fn resampled(chain: &[Point], step_mm: f64) -> (Vec<Point>, Vec<f64>) {
    let along = cumulative_mm(chain);
    let total = along.last().copied().unwrap_or(0.0);
    if chain.len() < 2 || total <= 0.0 {
        return (chain.to_vec(), along);
    }
    let num_steps = (total / step_mm).ceil().max(1.0) as usize;
    let at: Vec<f64> = (0..=num_steps)
        .map(|n| total * n as f64 / num_steps as f64)
        .collect();
    let mut points: Vec<Point> = at.iter().map(|&s| point_at(chain, &along, s)).collect();
    points[0] = chain[0];
    points[num_steps] = chain[chain.len() - 1];
    (points, at)
}

/// Return the length in mm along a chain from its start to each of its points.
#[must_use]
pub fn cumulative_mm(chain: &[Point]) -> Vec<f64> {
    let mut sum = 0.0;
    let mut along = Vec::with_capacity(chain.len());
    for n in 0..chain.len() {
        if n > 0 {
            sum += distance(chain[n - 1], chain[n]);
        }
        along.push(sum);
    }
    along
}

/// Return the point `s` mm along a chain whose cumulative lengths are `along`.
#[must_use]
pub fn point_at(chain: &[Point], along: &[f64], s: f64) -> Point {
    let after = along.partition_point(|&a| a < s).clamp(1, chain.len() - 1);
    let (from, to) = (along[after - 1], along[after]);
    let share = if to > from {
        ((s - from) / (to - from)).clamp(0.0, 1.0)
    } else {
        1.0
    };
    std::array::from_fn(|a| chain[after - 1][a] + share * (chain[after][a] - chain[after - 1][a]))
}

fn between(a: Point, b: Point, share: f64) -> Point {
    std::array::from_fn(|x| a[x] + share * (b[x] - a[x]))
}

fn distance(a: Point, b: Point) -> f64 {
    length([a[0] - b[0], a[1] - b[1], a[2] - b[2]])
}

/// Smooth evenly spaced points of a tube and keep them inside the lumen.
///
/// The first point stays fixed, and the last one too if `keep_end` is true; otherwise it may move a little. `radius_mm`
/// is the tube's radius at each point. `inside` must be true for every given point; it is true for every returned
/// point, because a point for which the strongest weight is not enough is returned unchanged.
#[must_use]
pub fn smoothed(
    points: &[Point],
    radius_mm: &[f64],
    keep_end: bool,
    inside: impl Fn(Point) -> bool,
) -> Vec<Point> {
    let mut pull: Vec<f64> = radius_mm.iter().map(|r| pull_of(*r)).collect();
    if let Some(first) = pull.first_mut() {
        *first = FIXED;
    }
    if let (true, Some(last)) = (keep_end, pull.last_mut()) {
        *last = FIXED;
    }
    smoothed_by(points, &pull, inside)
}

/// Smooth evenly spaced points with a given weight each, and keep them inside the lumen.
///
/// Points with the weight [`FIXED`] do not move. Otherwise the function works as [`smoothed`].
#[must_use]
pub fn smoothed_by(points: &[Point], pull: &[f64], inside: impl Fn(Point) -> bool) -> Vec<Point> {
    let n = points.len();
    if n < 4 {
        return points.to_vec();
    }
    let step_mm = (cumulative_mm(points)[n - 1] / (n - 1) as f64).max(1e-6);
    // The filter's gain is 1/2 where lambda (2 pi step / wavelength)^4 = 1.
    let lambda = (SHORTEST_BEND_MM / (std::f64::consts::TAU * step_mm)).powi(4);
    let given = pull;
    let mut pull = pull.to_vec();
    let fixed: Vec<usize> = (0..n).filter(|&m| pull[m] >= FIXED).collect();
    let mut towards = points.to_vec();
    let mut smooth = points.to_vec();
    for round in 0..GENTLE_ROUNDS + MAX_ROUNDS {
        let is_gentle = round < GENTLE_ROUNDS;
        if round == GENTLE_ROUNDS {
            towards.copy_from_slice(points);
            pull.copy_from_slice(given);
        }
        smooth = solve(&towards, &pull, lambda);
        for &m in &fixed {
            smooth[m] = points[m];
        }
        // The middle between neighbours should be inside as well, because a flight interpolates between points. The
        // given chain may cut a voxel's corner there, so in the last rounds only the points must be inside.
        let halves = round < GENTLE_ROUNDS + MAX_ROUNDS / 2;
        let bad: Vec<usize> = (0..n)
            .filter(|&m| {
                !inside(smooth[m])
                    || (halves && m + 1 < n && !inside(between(smooth[m], smooth[m + 1], 0.5)))
            })
            .collect();
        if bad.is_empty() {
            return relaxed(smooth, given, inside);
        }
        for m in bad {
            if !is_gentle {
                for near in &mut pull[m.saturating_sub(1)..(m + 2).min(n)] {
                    *near = (*near * 2.0).min(FIXED);
                }
                continue;
            }
            // If the point itself is inside, the middle between it and the next point is outside, and both points are
            // pulled back.
            let both = if inside(smooth[m]) { m + 2 } else { m + 1 };
            for near in m..both.min(n) {
                if pull[near] >= FIXED {
                    continue;
                }
                let mut share = GENTLE_SHARE;
                while share < 1.0 && !inside(between(smooth[near], points[near], share)) {
                    share += GENTLE_SHARE;
                }
                towards[near] =
                    between(smooth[near], points[near], (share + GENTLE_SHARE).min(1.0));
                pull[near] = (pull[near] * 3.0).clamp(GENTLE_PULL, 0.1 * FIXED);
            }
        }
    }
    // Points that are still outside return to their given positions.
    for (found, given) in smooth.iter_mut().zip(points) {
        if !inside(*found) {
            *found = *given;
        }
    }
    relaxed(smooth, given, inside)
}

/// Spread sharp corners of a smoothed line over the neighbouring points as far as the lumen allows.
///
/// Where the lumen is one voxel wide, points that were pulled inside leave a corner between two smooth parts.
fn relaxed(mut points: Vec<Point>, pull: &[f64], inside: impl Fn(Point) -> bool) -> Vec<Point> {
    let last = points.len() - 1;
    // The smallest cosine of the turns at a point and at its two neighbours.
    let sharpest = |points: &[Point], m: usize| {
        (m.saturating_sub(1).max(1)..(m + 2).min(last))
            .map(|n| cosine(points[n - 1], points[n], points[n + 1]))
            .fold(1.0, f64::min)
    };
    for _ in 0..RELAXING_ROUNDS {
        let sharp: Vec<usize> = (1..last)
            .filter(|&m| cosine(points[m - 1], points[m], points[m + 1]) < SHARP_COSINE)
            .collect();
        if sharp.is_empty() {
            break;
        }
        for m in sharp {
            for near in m.saturating_sub(2).max(1)..(m + 3).min(last) {
                let flat = between(points[near - 1], points[near + 1], 0.5);
                let moved = between(points[near], flat, RELAXING_SHARE);
                let holds = pull[near] < FIXED
                    && inside(moved)
                    && inside(between(points[near - 1], moved, 0.5))
                    && inside(between(moved, points[near + 1], 0.5));
                if holds {
                    let (before, old) = (sharpest(&points, near), points[near]);
                    points[near] = moved;
                    if sharpest(&points, near) < before {
                        points[near] = old;
                    }
                }
            }
        }
    }
    points
}

/// Return the cosine of the turn at a point of a line; 1 if the line continues straight.
fn cosine(before: Point, here: Point, after: Point) -> f64 {
    let [one, two] = [(before, here), (here, after)]
        .map(|(a, b)| -> Point { std::array::from_fn(|x| b[x] - a[x]) });
    let both = length(one) * length(two);
    if both > 0.0 {
        (0..3).map(|x| one[x] * two[x]).sum::<f64>() / both
    } else {
        1.0
    }
}

/// Solve (W + lambda D'D) x = W y for the three coordinates; D takes second differences.
///
/// The matrix is symmetric and positive definite with five diagonals: L D L' without pivoting.
fn solve(points: &[Point], pull: &[f64], lambda: f64) -> Vec<Point> {
    let n = points.len();
    let (mut diagonal, mut first, mut second) = (pull.to_vec(), vec![0.0; n], vec![0.0; n]);
    for m in 1..n - 1 {
        let row = [(m - 1, 1.0), (m, -2.0), (m + 1, 1.0)];
        for (a, u) in row {
            for (b, v) in row {
                match b as isize - a as isize {
                    0 => diagonal[a] += lambda * u * v,
                    1 => first[a] += lambda * u * v,
                    2 => second[a] += lambda * u * v,
                    _ => {}
                }
            }
        }
    }
    // Factor in place: first and second become the sub-diagonals of L.
    for m in 0..n {
        if m >= 1 {
            let above = diagonal[m - 1];
            diagonal[m] -= first[m - 1] * first[m - 1] * above;
            if m >= 2 {
                diagonal[m] -= second[m - 2] * second[m - 2] * diagonal[m - 2];
            }
            if m + 1 < n {
                first[m] -= first[m - 1] * above * second[m - 1];
            }
        }
        if m + 1 < n {
            first[m] /= diagonal[m];
        }
        if m + 2 < n {
            second[m] /= diagonal[m];
        }
    }
    let mut x: Vec<Point> = (0..n).map(|m| points[m].map(|v| v * pull[m])).collect();
    let less = |p: Point, factor: f64, q: Point| [0, 1, 2].map(|a| p[a] - factor * q[a]);
    for m in 1..n {
        x[m] = less(x[m], first[m - 1], x[m - 1]);
        if m >= 2 {
            x[m] = less(x[m], second[m - 2], x[m - 2]);
        }
    }
    for m in (0..n).rev() {
        x[m] = x[m].map(|v| v / diagonal[m]);
        if m + 1 < n {
            x[m] = less(x[m], first[m], x[m + 1]);
        }
        if m + 2 < n {
            x[m] = less(x[m], second[m], x[m + 2]);
        }
    }
    x
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_sharp_corner_is_spread_within_the_lumen_and_no_new_corner_arises() {
        let line: Vec<Point> = (0..20)
            .map(|n| {
                let n = f64::from(n);
                if n < 10.0 {
                    [n, 0.0, 0.0]
                } else {
                    [9.0 + 0.7 * (n - 9.0), 0.7 * (n - 9.0), 0.0]
                }
            })
            .collect();
        let turns = |points: &[Point]| {
            points
                .windows(3)
                .map(|p| {
                    cosine(p[0], p[1], p[2])
                        .clamp(-1.0, 1.0)
                        .acos()
                        .to_degrees()
                })
                .fold(0.0, f64::max)
        };
        assert!(turns(&line) > 44.0);
        let free = relaxed(line.clone(), &[1.0; 20], |_| true);
        assert!(turns(&free) < 21.0, "{}", turns(&free));
        assert_eq!((free[0], free[19]), (line[0], line[19]));
        let narrow = relaxed(line.clone(), &[1.0; 20], |p| {
            p[1] < 0.05 || p[0] - p[1] > 8.95
        });
        assert!(turns(&narrow) <= turns(&line) + 1e-9);
        assert_eq!(relaxed(line.clone(), &[FIXED; 20], |_| true), line);
    }

    fn staircase() -> Vec<Point> {
        // A line with steps of one unit, like a voxel path.
        (0..60)
            .map(|n| [f64::from(n), f64::from(n / 3), f64::from(n / 5) * 1.3])
            .collect()
    }

    #[test]
    fn the_solution_satisfies_the_normal_equations() {
        let points = staircase();
        let pull: Vec<f64> = (0..60).map(|n| 0.3 + f64::from(n % 7)).collect();
        let lambda = 12.5;
        let x = solve(&points, &pull, lambda);
        for a in 0..3 {
            let bend = |m: usize| x[m - 1][a] - 2.0 * x[m][a] + x[m + 1][a];
            for m in 0..60usize {
                let mut gradient = pull[m] * (x[m][a] - points[m][a]);
                for (at, factor) in [(m.wrapping_sub(1), 1.0), (m, -2.0), (m + 1, 1.0)] {
                    if (1..59).contains(&at) {
                        gradient += lambda * factor * bend(at);
                    }
                }
                // The tolerance of 1e-8 allows for rounding in sums of some 60 mm times 12.5 in f64.
                assert!(gradient.abs() < 1e-8, "{a} {m} {gradient}");
            }
        }
    }

    #[test]
    fn a_straight_line_is_unchanged_and_a_staircase_becomes_straight() {
        let line: Vec<Point> = (0..40)
            .map(|n| [0.3 * f64::from(n), 5.0 - 0.1 * f64::from(n), f64::from(n)])
            .collect();
        let smooth = smoothed(&line, &[2.0; 40], true, |_| true);
        for (p, q) in smooth.iter().zip(&line) {
            assert!(distance(*p, *q) < 1e-6);
        }
        let (points, _) = resampled(&staircase(), 0.5);
        let smooth = smoothed(&points, &vec![2.0; points.len()], true, |_| true);
        let turn = |p: &[Point], m: usize| {
            let u: Point = std::array::from_fn(|a| p[m][a] - p[m - 1][a]);
            let v: Point = std::array::from_fn(|a| p[m + 1][a] - p[m][a]);
            (carina_grid::dot(u, v) / length(u) / length(v))
                .clamp(-1.0, 1.0)
                .acos()
        };
        let worst = |p: &[Point]| (1..p.len() - 1).map(|m| turn(p, m)).fold(0.0, f64::max);
        assert!(worst(&points) > 0.6);
        assert!(worst(&smooth) < 0.08, "{}", worst(&smooth));
    }

    #[test]
    fn smoothed_points_stay_inside_and_the_ends_do_not_move() {
        // A right-angled corridor one unit wide; smoothing without the lumen would cut its corner.
        let mut chain: Vec<Point> = (0..20).map(|n| [f64::from(n), 0.0, 0.0]).collect();
        chain.extend((1..20).map(|n| [19.0, f64::from(n), 0.0]));
        let inside = |p: Point| {
            p[2].abs() <= 0.5
                && ((p[1].abs() <= 0.5 && p[0] <= 19.5)
                    || ((p[0] - 19.0).abs() <= 0.5 && p[1] >= -0.5))
        };
        let (points, _) = resampled(&chain, 0.5);
        let radius = vec![2.0; points.len()];
        let free = smoothed(&points, &radius, true, |_| true);
        assert!(
            free.iter().any(|p| !inside(*p)),
            "the test must be able to fail"
        );
        let kept = smoothed(&points, &radius, true, inside);
        assert!(kept.iter().all(|p| inside(*p)));
        assert_ne!(kept, points);
        assert_eq!(kept[0], chain[0]);
        assert_eq!(kept[kept.len() - 1], chain[chain.len() - 1]);
    }

    #[test]
    fn a_line_across_thick_slices_is_smoothed_without_corners() {
        // A slanting lumen one voxel of 0.66 mm wide, in slices of 3 mm: in each slice it is a corridor along x.
        let starts = [0.0, 2.64, 4.62, 8.58, 10.56, 13.2, 17.16];
        let slice = |z: f64| (z / 3.0).round().clamp(0.0, 5.0) as usize;
        let inside = |p: Point| {
            let k = slice(p[2]);
            p[1].abs() <= 0.33 && p[0] >= starts[k] - 0.33 && p[0] <= starts[k + 1] + 0.33
        };
        let chain: Vec<Point> = (0..6)
            .flat_map(|k| {
                let z = 3.0 * f64::from(k as u8);
                [[starts[k], 0.0, z], [starts[k + 1], 0.0, z]]
            })
            .collect();
        let (points, _) = resampled(&chain, 1.0);
        let smooth = smoothed(&points, &vec![1.2; points.len()], true, inside);
        assert!(smooth.iter().all(|p| inside(*p)));
        let turn = |p: &[Point], m: usize| {
            let u: Point = std::array::from_fn(|a| p[m][a] - p[m - 1][a]);
            let v: Point = std::array::from_fn(|a| p[m + 1][a] - p[m][a]);
            (carina_grid::dot(u, v) / length(u) / length(v))
                .clamp(-1.0, 1.0)
                .acos()
                .to_degrees()
        };
        let worst = |p: &[Point]| (1..p.len() - 1).map(|m| turn(p, m)).fold(0.0, f64::max);
        assert!(worst(&points) > 40.0, "{}", worst(&points));
        assert!(worst(&smooth) < 30.0, "{}", worst(&smooth));
    }
}
