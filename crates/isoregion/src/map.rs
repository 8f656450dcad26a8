//! The fast construction of the radius map.

use rayon::prelude::*;

use crate::{IsoRegionError, error::check_length};

/// Radius of every voxel: the same map as [`crate::paper_radius_map`], in two sweeps.
///
/// A voxel is *heterogeneous* if it has label 0 or one of its 26 neighbours is missing or has another label. The radius
/// of a voxel is its chessboard distance to the nearest heterogeneous one: inside the largest uniform cube no voxel but
/// those of the outermost shell can be heterogeneous, and one of that shell is, or the cube would grow. Chessboard
/// distances are exact after a forward and a backward sweep of `d = 1 + min` over the 13 neighbours already visited.
pub fn radius_map(labels: &[u8], shape_zyx: [usize; 3]) -> Result<Vec<u8>, IsoRegionError> {
    check_length(labels, shape_zyx)?;
    if labels.is_empty() {
        return Ok(Vec::new());
    }
    let mut radius = homogeneous(labels, shape_zyx);
    sweep(&mut radius, shape_zyx);
    Ok(radius)
}

/// 255 where the 3x3x3 neighbourhood exists and holds one label other than 0, else 0.
fn homogeneous(labels: &[u8], [nz, ny, nx]: [usize; 3]) -> Vec<u8> {
    let plane = ny * nx;
    // Separable: first 3x3 within each slice, then three slices that are each uniform and agree in their centres.
    let mut flat = vec![0u8; labels.len()];
    flat.par_chunks_mut(plane)
        .zip(labels.par_chunks(plane))
        .for_each_init(
            || vec![0u8; plane],
            |along_x, (flat, labels)| {
                if ny < 3 || nx < 3 {
                    return;
                }
                for (out, row) in along_x.chunks_mut(nx).zip(labels.chunks(nx)) {
                    for ((out, w), centre) in
                        out[1..nx - 1].iter_mut().zip(row.windows(3)).zip(&row[1..])
                    {
                        *out = all(w[0] == *centre && w[2] == *centre && *centre != 0);
                    }
                }
                for y in 1..ny - 1 {
                    let (u, v, w) = three_rows(along_x, y, nx);
                    let (a, b, c) = three_rows(labels, y, nx);
                    let out = &mut flat[y * nx..][..nx];
                    for x in 1..nx - 1 {
                        out[x] = u[x] & v[x] & w[x] & all(a[x] == b[x]) & all(c[x] == b[x]);
                    }
                }
            },
        );
    let mut out = vec![0u8; labels.len()];
    if nz >= 3 {
        out[plane..(nz - 1) * plane]
            .par_chunks_mut(plane)
            .enumerate()
            .for_each(|(n, out)| {
                let (u, v, w) = three_rows(&flat, n + 1, plane);
                let (a, b, c) = three_rows(labels, n + 1, plane);
                for x in 0..plane {
                    out[x] = u[x] & v[x] & w[x] & all(a[x] == b[x]) & all(c[x] == b[x]);
                }
            });
    }
    out
}

const fn all(condition: bool) -> u8 {
    if condition { 255 } else { 0 }
}

/// Rows `n - 1`, `n` and `n + 1` of length `len`.
fn three_rows(data: &[u8], n: usize, len: usize) -> (&[u8], &[u8], &[u8]) {
    (
        &data[(n - 1) * len..][..len],
        &data[n * len..][..len],
        &data[(n + 1) * len..][..len],
    )
}

/// Turns 0/255 into chessboard distances to the nearest 0. The outermost voxels are 0 in any case.
fn sweep(d: &mut [u8], [nz, ny, nx]: [usize; 3]) {
    if nz < 3 || ny < 3 || nx < 3 {
        return;
    }
    let plane = ny * nx;
    let mut before = vec![0u8; nx];
    let mut scratch = vec![0u8; nx];
    for z in 1..nz - 1 {
        let (done, rest) = d.split_at_mut(z * plane);
        let (slice, last) = (&mut rest[..plane], &done[(z - 1) * plane..]);
        for y in 1..ny - 1 {
            let (above, here) = slice.split_at_mut(y * nx);
            let (a, b, c) = three_rows(last, y, nx);
            min4(&mut before, a, b, c, &above[(y - 1) * nx..]);
            relax(&mut here[..nx], &before, &mut scratch, false);
        }
    }
    for z in (1..nz - 1).rev() {
        let (rest, done) = d.split_at_mut((z + 1) * plane);
        let (slice, next) = (&mut rest[z * plane..], &done[..plane]);
        for y in (1..ny - 1).rev() {
            let (here, below) = slice.split_at_mut((y + 1) * nx);
            let (a, b, c) = three_rows(next, y, nx);
            min4(&mut before, a, b, c, &below[..nx]);
            relax(&mut here[y * nx..], &before, &mut scratch, true);
        }
    }
}

fn min4(out: &mut [u8], a: &[u8], b: &[u8], c: &[u8], e: &[u8]) {
    let n = out.len();
    let (a, b, c, e) = (&a[..n], &b[..n], &c[..n], &e[..n]);
    for x in 0..n {
        out[x] = a[x].min(b[x]).min(c[x].min(e[x]));
    }
}

/// `row = min(row, 1 + min of the three `before` beside it, 1 + the row's neighbour already visited)`.
fn relax(row: &mut [u8], before: &[u8], scratch: &mut [u8], backward: bool) {
    let n = row.len();
    for x in 1..n - 1 {
        let near = before[x - 1].min(before[x]).min(before[x + 1]);
        row[x] = row[x].min(near.saturating_add(1));
    }
    // The chain along the row is a prefix minimum of d[x - s] + s: log steps keep it free of a carried dependency.
    let mut s = 1;
    while s < n && s < 256 {
        let cost = s as u8;
        scratch.copy_from_slice(row);
        if backward {
            for (out, &v) in row[..n - s].iter_mut().zip(&scratch[s..]) {
                *out = (*out).min(v.saturating_add(cost));
            }
        } else {
            for (out, &v) in row[s..].iter_mut().zip(&scratch[..n - s]) {
                *out = (*out).min(v.saturating_add(cost));
            }
        }
        s *= 2;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::paper_radius_map;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn the_fast_map_equals_the_papers(
            shape in proptest::array::uniform3(1usize..24),
            seed in any::<u64>(),
            num_odd in 0usize..30,
            block in 1usize..9,
        ) {
            // Blocks of labels with odd voxels strewn in: large regions, thin ones, label 0, and faces.
            let mut state = seed;
            let mut next = || {
                state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
                (state >> 33) as usize
            };
            let [nz, ny, nx] = shape;
            let blocks: Vec<u8> = (0..27 * 27).map(|_| [1, 1, 1, 2, 0][next() % 5]).collect();
            let mut labels: Vec<u8> = (0..nz * ny * nx)
                .map(|i| {
                    let (z, y, x) = (i / nx / ny, i / nx % ny, i % nx);
                    blocks[((z / (2 * block)) * 9 + (y / block) * 3 + x / (3 * block)) % blocks.len()]
                })
                .collect();
            for _ in 0..num_odd {
                let at = next() % labels.len();
                labels[at] = (next() % 4) as u8;
            }
            prop_assert_eq!(radius_map(&labels, shape).unwrap(), paper_radius_map(&labels, shape).unwrap());
        }
    }

    #[test]
    fn radii_stop_at_255_and_never_wrap() {
        // A thin stack would never get there, so the cube is 515 voxels wide: its middle would have radius 257.
        let n = 515;
        let radius = radius_map(&vec![1; n * n * n], [n, n, n]).unwrap();
        let at = |z: usize, y: usize, x: usize| radius[(z * n + y) * n + x];
        assert_eq!(at(257, 257, 257), 255);
        assert_eq!(at(254, 257, 257), 254);
        assert_eq!(at(257, 257, 3), 3);
        assert_eq!(at(257, 514, 257), 0);
    }
}
