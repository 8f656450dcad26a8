//! Exact Euclidean distance transform on an anisotropic grid, which finds the nearest outside voxel of each voxel.
//!
//! Felzenszwalb and Huttenlocher, "Distance transforms of sampled functions" (2012): one lower envelope of parabolas
//! per line and axis. Each axis has its own spacing. The transform returns the nearest outside voxel itself, because
//! the wall is *between* voxels: callers search for the crossing of the threshold near that voxel to refine the
//! distance.

use rayon::prelude::*;

/// Box of voxels inside the volume; indices in the box run x fastest.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct VoxelBox {
    /// First voxel (i, j, k) of the box in the volume.
    pub first_ijk: [usize; 3],
    /// Number of voxels of the box along i, j, k.
    pub shape_ijk: [usize; 3],
}

impl VoxelBox {
    /// Return the number of voxels of the box.
    #[must_use]
    pub const fn num_voxels(&self) -> usize {
        self.shape_ijk[0] * self.shape_ijk[1] * self.shape_ijk[2]
    }

    /// Return the index in the box of a voxel of the volume; `None` outside the box.
    #[must_use]
    pub fn index_of(&self, ijk: [isize; 3]) -> Option<usize> {
        let mut local = [0usize; 3];
        for axis in 0..3 {
            let at = ijk[axis] - self.first_ijk[axis] as isize;
            if at < 0 || at >= self.shape_ijk[axis] as isize {
                return None;
            }
            local[axis] = at as usize;
        }
        Some((local[2] * self.shape_ijk[1] + local[1]) * self.shape_ijk[0] + local[0])
    }

    /// Return the voxel of the volume at an index in the box.
    #[must_use]
    pub const fn voxel(&self, index: usize) -> [usize; 3] {
        let [nx, ny, _] = self.shape_ijk;
        [
            self.first_ijk[0] + index % nx,
            self.first_ijk[1] + index / nx % ny,
            self.first_ijk[2] + index / nx / ny,
        ]
    }
}

/// Index that marks the absence of a voxel.
pub const NOWHERE: u32 = u32::MAX;

/// Return, for every voxel of a box, the index in the box of the nearest voxel for which `outside` is true.
///
/// The result is [`NOWHERE`] if there is none.
///
/// Distances are between voxel centres with `spacing_mm` along i, j, k.
pub fn nearest_outside(
    shape_ijk: [usize; 3],
    spacing_mm: [f64; 3],
    outside: impl Fn(usize) -> bool + Sync,
) -> Vec<u32> {
    let [nx, ny, nz] = shape_ijk;
    // A squared distance in f32 loses the sub-voxel part of long distances, so f64 is used within a line. Between the
    // axes f32 is exact enough, because the nearest voxels are compared again by their own coordinates.
    let mut nearest = vec![NOWHERE; nx * ny * nz];
    let mut squared = vec![f32::INFINITY; nx * ny * nz];

    // The lines along x and then along y, slice by slice.
    nearest
        .par_chunks_mut(nx * ny)
        .zip(squared.par_chunks_mut(nx * ny))
        .enumerate()
        .for_each(|(k, (nearest, squared))| {
            for at in 0..nx * ny {
                if outside(k * nx * ny + at) {
                    nearest[at] = (k * nx * ny + at) as u32;
                    squared[at] = 0.0;
                }
            }
            let mut line = Envelope::new(nx.max(ny));
            for j in 0..ny {
                line.run(nx, spacing_mm[0], |i| j * nx + i, nearest, squared);
            }
            for i in 0..nx {
                line.run(ny, spacing_mm[1], |j| j * nx + i, nearest, squared);
            }
        });

    // The lines along z: columns are gathered row by row, so that threads write disjoint slices.
    let columns: Vec<Vec<u32>> = (0..ny)
        .into_par_iter()
        .map(|j| {
            let mut line = Envelope::new(nz);
            let mut rows = vec![NOWHERE; nx * nz];
            let mut near = vec![NOWHERE; nz];
            let mut sq = vec![f32::INFINITY; nz];
            for i in 0..nx {
                for k in 0..nz {
                    let at = (k * ny + j) * nx + i;
                    near[k] = nearest[at];
                    sq[k] = squared[at];
                }
                line.run(nz, spacing_mm[2], |k| k, &mut near, &mut sq);
                for k in 0..nz {
                    rows[k * nx + i] = near[k];
                }
            }
            rows
        })
        .collect();
    for (j, rows) in columns.iter().enumerate() {
        for k in 0..nz {
            let at = (k * ny + j) * nx;
            nearest[at..at + nx].copy_from_slice(&rows[k * nx..(k + 1) * nx]);
        }
    }
    nearest
}

/// Buffers for the lower envelope of the parabolas of one line.
struct Envelope {
    /// Positions whose parabola is part of the envelope, each with the start of the interval in which it is the lowest.
    roots: Vec<(usize, f64)>,
    source: Vec<(u32, f32)>,
}

impl Envelope {
    fn new(longest: usize) -> Self {
        Self {
            roots: Vec::with_capacity(longest),
            source: Vec::with_capacity(longest),
        }
    }

    fn run(
        &mut self,
        n: usize,
        spacing_mm: f64,
        at: impl Fn(usize) -> usize,
        nearest: &mut [u32],
        squared: &mut [f32],
    ) {
        self.source.clear();
        self.source
            .extend((0..n).map(|p| (nearest[at(p)], squared[at(p)])));
        self.roots.clear();
        let height = |p: usize| f64::from(self.source[p].1);
        for q in 0..n {
            if !self.source[q].1.is_finite() {
                continue;
            }
            let x_q = q as f64 * spacing_mm;
            let mut begins = f64::NEG_INFINITY;
            while let Some(&(p, p_begins)) = self.roots.last() {
                let x_p = p as f64 * spacing_mm;
                // The intersection of the two parabolas.
                begins = ((height(q) + x_q * x_q) - (height(p) + x_p * x_p)) / (2.0 * (x_q - x_p));
                if begins > p_begins {
                    break;
                }
                self.roots.pop();
                begins = f64::NEG_INFINITY;
            }
            self.roots.push((q, begins));
        }
        if self.roots.is_empty() {
            return;
        }
        let mut lowest = 0;
        for p in 0..n {
            let x = p as f64 * spacing_mm;
            while lowest + 1 < self.roots.len() && self.roots[lowest + 1].1 <= x {
                lowest += 1;
            }
            let root = self.roots[lowest].0;
            let along = x - root as f64 * spacing_mm;
            nearest[at(p)] = self.source[root].0;
            squared[at(p)] = (f64::from(self.source[root].1) + along * along) as f32;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn the_distance_to_the_nearest_outside_voxel_equals_an_exhaustive_search(
            bits in prop::collection::vec(prop::bool::weighted(0.1), 5 * 6 * 7),
            spacing in prop::array::uniform3(0.3f64..3.0),
        ) {
            let shape = [5, 6, 7];
            let found = nearest_outside(shape, spacing, |at| bits[at]);
            let place = |at: usize| [at % 5, at / 5 % 6, at / 30].map(|v| v as f64);
            let distance = |a: usize, b: usize| {
                let (p, q) = (place(a), place(b));
                (0..3).map(|d| ((p[d] - q[d]) * spacing[d]).powi(2)).sum::<f64>().sqrt()
            };
            for at in 0..bits.len() {
                let best = (0..bits.len()).filter(|&b| bits[b]).map(|b| distance(at, b)).reduce(f64::min);
                match best {
                    None => prop_assert_eq!(found[at], NOWHERE),
                    // The tolerance of 1e-4 mm allows for squared distances that are passed between the axes as f32.
                    Some(best) => prop_assert!((distance(at, found[at] as usize) - best).abs() < 1e-4),
                }
            }
        }
    }
}
