//! Differences of slices from both neighbours, in excess of the difference of the neighbours.

use rayon::prelude::*;

/// Values outside these HU do not count as differences.
const LIMITS: (i16, i16) = (-1200, 1500);

/// Return, for each slice but the first and the last, its largest excess in HU over the tiles of the slice.
///
/// The excess is the mean difference from the nearer neighbour minus `allowed` times the mean difference of the
/// neighbours. With `tile`, the means are over square tiles of this side, and incomplete tiles are left out; without it,
/// they are over every `step`-th pixel of the whole slice along both axes.
pub fn excesses(
    values: &[i16],
    shape_zyx: [usize; 3],
    tile: Option<usize>,
    step: usize,
    allowed: f64,
) -> Vec<f64> {
    let [nz, ny, nx] = shape_zyx;
    let plane = ny * nx;
    (1..nz.saturating_sub(1))
        .into_par_iter()
        .map(|z| {
            let three = [z - 1, z, z + 1].map(|at| &values[at * plane..(at + 1) * plane]);
            match tile {
                None => excess_of(
                    &sums(three, nx, (0..ny).step_by(step), 0..nx, step),
                    allowed,
                ),
                Some(side) => tiled_excess(three, [ny, nx], side, allowed),
            }
        })
        .collect()
}

fn tiled_excess(three: [&[i16]; 3], shape_yx: [usize; 2], side: usize, allowed: f64) -> f64 {
    let [ny, nx] = shape_yx;
    let mut most = f64::NEG_INFINITY;
    for y in 0..ny / side {
        for x in 0..nx / side {
            let columns = x * side..(x + 1) * side;
            let found = sums(three, nx, y * side..(y + 1) * side, columns, 1);
            most = most.max(excess_of(&found, allowed));
        }
    }
    most
}

/// Sums of the absolute differences of the first and second, second and third, and first and third slice.
struct Sums {
    differences: [u64; 3],
    count: u64,
}

fn sums(
    three: [&[i16]; 3],
    nx: usize,
    rows: impl Iterator<Item = usize>,
    columns: std::ops::Range<usize>,
    step: usize,
) -> Sums {
    let mut differences = [0; 3];
    let mut count = 0;
    for y in rows {
        let [a, b, c] = three.map(|plane| &plane[y * nx + columns.start..y * nx + columns.end]);
        let mut row = [0u32; 3];
        let mut add = |a: i16, b: i16, c: i16| {
            let [a, b, c] = [a, b, c].map(|value| i32::from(value.clamp(LIMITS.0, LIMITS.1)));
            row[0] += a.abs_diff(b);
            row[1] += b.abs_diff(c);
            row[2] += a.abs_diff(c);
        };
        if step == 1 {
            for ((a, b), c) in a.iter().zip(b).zip(c) {
                add(*a, *b, *c);
            }
        } else {
            for at in (0..a.len()).step_by(step) {
                add(a[at], b[at], c[at]);
            }
        }
        for (sum, own) in differences.iter_mut().zip(row) {
            *sum += u64::from(own);
        }
        count += a.len().div_ceil(step) as u64;
    }
    Sums { differences, count }
}

fn excess_of(sums: &Sums, allowed: f64) -> f64 {
    let [below, above, apart] = sums.differences.map(|sum| sum as f64 / sums.count as f64);
    below.min(above) - allowed * apart
}
