use carina_grid::unit;

/// Return the weights of a Gaussian round `centre`, and the offset of the first weight in steps.
///
/// The weights are `step` apart and end at three sigma.
fn gaussian(centre: f64, sigma: f64, step: f64) -> (isize, Vec<f64>) {
    let first = ((centre - 3.0 * sigma) / step).floor() as isize;
    let last = ((centre + 3.0 * sigma) / step).ceil() as isize;
    let weights: Vec<f64> = (first..=last)
        .map(|n| {
            let u = (n as f64 * step - centre) / sigma;
            libm::exp(-0.5 * u * u)
        })
        .collect();
    let sum: f64 = weights.iter().sum();
    (first, weights.into_iter().map(|w| w / sum).collect())
}

/// Return evenly spaced points with each point replaced by a Gaussian mean of its neighbours.
///
/// Both ends stay fixed: beyond them the line is continued by mirroring in the end point.
pub(crate) fn smoothed(points: &[[f64; 3]], sigma_mm: f64, step_mm: f64) -> Vec<[f64; 3]> {
    let (first, weights) = gaussian(0.0, sigma_mm, step_mm);
    let last = points.len() as isize - 1;
    let at = |n: isize| -> [f64; 3] {
        // A point beyond an end is the mirror image, in the end point, of the point at the same distance inside.
        let (end, inner) = if n < 0 {
            (0, (-n).min(last))
        } else if n > last {
            (last, (2 * last - n).max(0))
        } else {
            return points[n as usize];
        };
        let (e, p) = (points[end as usize], points[inner as usize]);
        std::array::from_fn(|a| 2.0 * e[a] - p[a])
    };
    (0..=last)
        .map(|i| {
            let mut sum = [0.0; 3];
            for (n, w) in weights.iter().enumerate() {
                let p = at(i + first + n as isize);
                for a in 0..3 {
                    sum[a] += w * p[a];
                }
            }
            sum
        })
        .collect()
}

/// Return the viewing direction at each point of a line: the mean tangent of the part ahead, weighted by a Gaussian.
///
/// A view along the tangent itself would wobble with every voxel step of a path, and would turn into a branch only when
/// the tip is already in the branch.
pub(crate) fn gaze(
    points: &[[f64; 3]],
    ahead_mm: f64,
    sigma_mm: f64,
    step_mm: f64,
) -> Vec<[f64; 3]> {
    let num = points.len();
    let last = num - 1;
    // Differences are one-sided at the ends and central between them.
    let mut before = [0.0, 0.0, 1.0];
    let tangents: Vec<[f64; 3]> = (0..num)
        .map(|i| {
            let (a, b) = (points[i.saturating_sub(1)], points[(i + 1).min(last)]);
            if let Some(t) = unit(std::array::from_fn(|k| b[k] - a[k])) {
                before = t;
            }
            before
        })
        .collect();
    let (first, weights) = gaussian(ahead_mm, sigma_mm, step_mm);
    let mut kept = tangents[0];
    (0..num)
        .map(|i| {
            let mut sum = [0.0; 3];
            for (n, w) in weights.iter().enumerate() {
                // Beyond an end the line continues straight.
                let t =
                    tangents[(i as isize + first + n as isize).clamp(0, last as isize) as usize];
                for a in 0..3 {
                    sum[a] += w * t[a];
                }
            }
            // Where a path reverses, the mean vanishes, so the last valid direction is used.
            if carina_grid::length(sum) > 1e-3
                && let Some(g) = unit(sum)
            {
                kept = g;
            }
            kept
        })
        .collect()
}
