//! Fast construction of radius maps: the radius of the largest cube of equal labels round each voxel or cell.

use carina_grid::InstructionSet;

use crate::{
    IsoRegionError,
    bytes::run,
    error::check_length,
    labels::run_labels,
    sweep::{Push, Sweep},
    threads::num_threads,
    uniform::{Source, Unit},
};

/// Minimum number of slices of a slab that is divided between two threads; with fewer slices the division takes more
/// time than it saves.
const MIN_SLAB_SLICES: usize = 8;

/// Maximum number of value intervals for which a map of cells is built directly from values, without labels.
///
/// With more intervals, a volume of labels is built first.
const MAX_RUNS: usize = 4;

/// Settings for the construction of a radius map; they affect its duration but not its result.
#[derive(Clone, Copy)]
pub struct MapBuilder<'a> {
    /// Instruction set of the processor with which the map is computed.
    pub simd: InstructionSet,
    /// Number of slabs (groups of slices), rounded up to a power of two; one thread computes each slab.
    pub num_slabs: usize,
    /// Function that any thread calls once per slice; `None` if the construction cannot be cancelled.
    ///
    /// If the function returns true, the construction ends with [`IsoRegionError::Cancelled`].
    pub cancelled: Option<&'a (dyn Fn() -> bool + Sync)>,
}

impl Default for MapBuilder<'_> {
    fn default() -> Self {
        Self {
            simd: InstructionSet::best(),
            num_slabs: num_threads(),
            cancelled: None,
        }
    }
}

/// Compute the radius of every voxel with the default [`MapBuilder`]: the same map as [`crate::paper_radius_map`].
///
/// # Errors
///
/// Returns an error if the number of labels does not match the shape.
pub fn radius_map(labels: &[u8], shape_zyx: [usize; 3]) -> Result<Vec<u8>, IsoRegionError> {
    let mut out = vec![0; labels.len()];
    MapBuilder::default().radius_map(labels, shape_zyx, &mut out)?;
    Ok(out)
}

/// Compute the radius of every *cell* (the eight voxels round a position between voxels), stored at its lower corner.
///
/// The radius is the largest `d` such that the `(2d)^3` voxels round the cell are in the volume, none of them at its
/// lower faces, and have one label. A sample between voxels uses the eight corners of its cell: if the radius is not 0,
/// these are equal, and so are those of all samples within `d - 1/2` voxels of the cell's centre along each axis. The
/// map of voxels (paper 4.2) shows this only for cells with a voxel whose neighbours are all equal. The result equals
/// that of [`crate::reference_cell_map`].
///
/// # Errors
///
/// Returns an error if the number of labels does not match the shape.
pub fn cell_map(labels: &[u8], shape_zyx: [usize; 3]) -> Result<Vec<u8>, IsoRegionError> {
    let mut out = vec![0; labels.len()];
    MapBuilder::default().cell_map(labels, shape_zyx, &mut out)?;
    Ok(out)
}

impl MapBuilder<'_> {
    /// Write the radius of every voxel to `out`, whose previous contents do not matter.
    ///
    /// A voxel is *heterogeneous* if it has label 0 or if one of its 26 neighbours is missing or has another label. The
    /// radius of a voxel is its chessboard distance to the nearest heterogeneous voxel: inside the largest uniform cube
    /// only voxels of the outermost shell can be heterogeneous, and one of that shell is, or the cube would be larger.
    ///
    /// # Errors
    ///
    /// Returns an error if a length does not match the shape or the construction is cancelled.
    pub fn radius_map(
        &self,
        labels: &[u8],
        shape_zyx: [usize; 3],
        out: &mut [u8],
    ) -> Result<(), IsoRegionError> {
        self.build(Source::Labels(labels, Unit::Voxel), shape_zyx, out)
    }

    /// Write the radius of every *cell* to `out`; see [`cell_map`] for the definition.
    ///
    /// # Errors
    ///
    /// Returns an error if a length does not match the shape or the construction is cancelled.
    pub fn cell_map(
        &self,
        labels: &[u8],
        shape_zyx: [usize; 3],
        out: &mut [u8],
    ) -> Result<(), IsoRegionError> {
        self.build(Source::Labels(labels, Unit::Cell), shape_zyx, out)
    }

    /// Write to `out` the radius map of cells (of eight voxels each) for classes that are given as intervals of values.
    ///
    /// `runs` has the first and last value of each interval; the intervals are disjoint. With few intervals no label
    /// volume is created. Cells with a value in no interval have radius 0.
    ///
    /// # Errors
    ///
    /// Returns an error if a length does not match the shape or the construction is cancelled.
    pub fn run_cell_map(
        &self,
        hu: &[i16],
        shape_zyx: [usize; 3],
        runs: &[(i16, i16)],
        out: &mut [u8],
    ) -> Result<(), IsoRegionError> {
        if runs.len() > MAX_RUNS {
            return self.cell_map(&run_labels(hu, runs).labels, shape_zyx, out);
        }
        let runs: Vec<_> = runs.iter().map(|&(lo, hi)| (lo, lo.abs_diff(hi))).collect();
        self.build(Source::Runs(hu, &runs), shape_zyx, out)
    }

    fn build(
        &self,
        source: Source<'_>,
        shape_zyx: [usize; 3],
        out: &mut [u8],
    ) -> Result<(), IsoRegionError> {
        let num_voxels = match source {
            Source::Labels(labels, _) => labels.len(),
            Source::Runs(hu, _) => hu.len(),
        };
        check_length(num_voxels, shape_zyx)?;
        check_length(out.len(), shape_zyx)?;
        if num_voxels > 0 {
            self.slab(source, shape_zyx, 0, self.num_slabs, out);
        }
        if self.stopped() {
            return Err(IsoRegionError::Cancelled);
        }
        Ok(())
    }

    fn stopped(&self) -> bool {
        self.cancelled.is_some_and(|cancelled| cancelled())
    }

    /// Compute the radii within slices `first_z ..` of a volume, exact as if the volume ended at the slab's borders.
    ///
    /// The slices are one slab, or two halves that are computed by two threads and whose borders are then exchanged.
    fn slab(
        &self,
        source: Source<'_>,
        shape_zyx: [usize; 3],
        first_z: usize,
        num_slabs: usize,
        out: &mut [u8],
    ) {
        let [_, ny, nx] = shape_zyx;
        let plane = ny * nx;
        let num_slices = out.len() / plane;
        if num_slabs <= 1 || num_slices < 2 * MIN_SLAB_SLICES {
            self.sweep(source, shape_zyx, first_z, out);
            return;
        }
        let half = num_slices / 2;
        let (low, high) = out.split_at_mut(half * plane);
        let num_slabs = num_slabs.div_ceil(2);
        // The threads are separate from the pool, which casts pictures, because a picture must not wait for a map.
        join(
            || self.slab(source, shape_zyx, first_z, num_slabs, low),
            || self.slab(source, shape_zyx, first_z + half, num_slabs, high),
        );
        if self.stopped() {
            return;
        }
        // Both borders are copied before either half changes: a half's own distances at its border are exact, and a
        // shortest path never returns to a half that it has left.
        let (below, above) = (low[(half - 1) * plane..].to_vec(), high[..plane].to_vec());
        join(
            || self.push(&above, low, [ny, nx], false),
            || self.push(&below, high, [ny, nx], true),
        );
    }

    fn sweep(&self, source: Source<'_>, shape_zyx: [usize; 3], first_z: usize, out: &mut [u8]) {
        let stopped = || self.stopped();
        let sweep = Sweep {
            source,
            shape_zyx,
            first_z,
            out,
            stopped: &stopped,
        };
        run(self.simd, shape_zyx[2], sweep);
    }

    fn push(&self, edge: &[u8], slab: &mut [u8], [ny, nx]: [usize; 2], forward: bool) {
        if ny < 3 || nx < 3 {
            return;
        }
        let push = Push {
            edge,
            slab,
            shape_yx: [ny, nx],
            forward,
        };
        run(self.simd, nx, push);
    }
}

/// Run two functions at the same time, one of them on a new thread.
fn join(one: impl FnOnce() + Send, other: impl FnOnce()) {
    std::thread::scope(|scope| {
        scope.spawn(one);
        other();
    });
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{paper_radius_map, reference_cell_map};
    use proptest::prelude::*;

    /// Return a test volume of label blocks with scattered voxels of other labels: large and thin regions, and label 0.
    fn random_labels(
        [nz, ny, nx]: [usize; 3],
        num_labels: usize,
        num_odd: usize,
        block: usize,
        seed: u64,
    ) -> Vec<u8> {
        let mut state = seed;
        let mut next = || {
            state = state
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1_442_695_040_888_963_407);
            (state >> 33) as usize
        };
        let blocks: Vec<u8> = (0..27 * 27)
            .map(|_| {
                if next() % 3 > 0 {
                    1
                } else {
                    (next() % num_labels) as u8
                }
            })
            .collect();
        let mut labels: Vec<u8> = (0..nz * ny * nx)
            .map(|i| {
                let (z, y, x) = (i / nx / ny, i / nx % ny, i % nx);
                blocks[((z / (2 * block)) * 9 + (y / block) * 3 + x / (3 * block)) % blocks.len()]
            })
            .collect();
        for _ in 0..num_odd {
            let at = next() % labels.len();
            labels[at] = (next() % num_labels) as u8;
        }
        labels
    }

    /// Return builders for every instruction set of this machine, with one slab and with several slabs.
    fn builders() -> Vec<MapBuilder<'static>> {
        InstructionSet::available()
            .into_iter()
            .flat_map(|simd| {
                [1, 2, 4].map(|num_slabs| MapBuilder {
                    simd,
                    num_slabs,
                    cancelled: None,
                })
            })
            .collect()
    }

    fn every_builder_gives(
        expected: &[u8],
        build: impl Fn(MapBuilder<'_>, &mut [u8]) -> Result<(), IsoRegionError>,
    ) {
        for builder in builders() {
            // The previous contents of `out` must not matter.
            let mut out = vec![77; expected.len()];
            build(builder, &mut out).unwrap();
            assert!(
                out == expected,
                "{:?}, {} slabs",
                builder.simd,
                builder.num_slabs
            );
        }
    }

    proptest! {
        #[test]
        fn the_fast_map_equals_the_map_of_the_papers_iteration(
            // The rows are shorter than any register, longer than every register, and not a whole number of registers.
            shape in (1usize..40, 1usize..20, prop_oneof![1usize..24, 30usize..36, 60usize..70, 90usize..140]),
            seed in any::<u64>(),
            num_labels in prop_oneof![1usize..5, 5usize..256],
            num_odd in 0usize..30,
            block in 1usize..30,
        ) {
            let shape = [shape.0, shape.1, shape.2];
            let labels = random_labels(shape, num_labels, num_odd, block, seed);
            let expected = paper_radius_map(&labels, shape).unwrap();
            every_builder_gives(&expected, |builder, out| builder.radius_map(&labels, shape, out));
        }

        #[test]
        fn the_fast_cell_map_equals_its_definition(
            shape in (1usize..24, 1usize..14, prop_oneof![1usize..24, 30usize..36, 60usize..70, 90usize..140]),
            seed in any::<u64>(),
            num_labels in prop_oneof![1usize..5, 5usize..256],
            num_odd in 0usize..30,
            block in 1usize..30,
        ) {
            let shape = [shape.0, shape.1, shape.2];
            let labels = random_labels(shape, num_labels, num_odd, block, seed);
            let expected = reference_cell_map(&labels, shape).unwrap();
            every_builder_gives(&expected, |builder, out| builder.cell_map(&labels, shape, out));
        }

        #[test]
        fn a_map_of_runs_equals_the_map_of_their_labels(
            shape in (1usize..24, 1usize..12, 1usize..90),
            seed in any::<u64>(),
            num_runs in 0usize..8,
            num_odd in 0usize..30,
        ) {
            let shape = [shape.0, shape.1, shape.2];
            let ends = |n: usize| [i16::MIN, -700, -650, -20, 0, 9, 10, 400, 1000, 1001, 1002, 1003, 2000, 2500, 3000, i16::MAX][n];
            let runs: Vec<(i16, i16)> = (0..num_runs).map(|n| (ends(2 * n), ends(2 * n + 1))).collect();
            // The values are at the ends of runs, within them and between them.
            let hu: Vec<i16> = random_labels(shape, 200, num_odd, 9, seed)
                .into_iter()
                .map(|v| ends(usize::from(v) % 16).saturating_add((i16::from(v) / 16 - 5).signum()))
                .collect();
            let labels: Vec<u8> = hu
                .iter()
                .map(|v| runs.iter().position(|(lo, hi)| (lo..=hi).contains(&v)).map_or(0, |n| n as u8 + 1))
                .collect();
            let expected = reference_cell_map(&labels, shape).unwrap();
            every_builder_gives(&expected, |builder, out| builder.run_cell_map(&hu, shape, &runs, out));
        }
    }

    #[test]
    fn distances_in_long_uniform_rows_stop_at_255() {
        // In a long thin box the faces are always near, so the paper's iteration is fast.
        let shape = [7, 9, 700];
        for at in [0, 64, 300, 699] {
            let mut labels = vec![1u8; 7 * 9 * 700];
            labels[3 * 9 * 700 + 4 * 700 + at] = 2;
            let expected = paper_radius_map(&labels, shape).unwrap();
            for builder in builders() {
                let mut out = vec![0; labels.len()];
                builder.radius_map(&labels, shape, &mut out).unwrap();
                assert!(out == expected);
            }
        }
    }

    #[test]
    fn a_cancelled_construction_returns_an_error() {
        let labels = vec![1; 64 * 64 * 64];
        let mut out = vec![0; labels.len()];
        for num_slabs in [1, 4] {
            let builder = MapBuilder {
                num_slabs,
                cancelled: Some(&|| true),
                ..MapBuilder::default()
            };
            let stopped = builder.radius_map(&labels, [64; 3], &mut out);
            assert_eq!(stopped, Err(IsoRegionError::Cancelled));
        }
    }

    #[test]
    fn an_array_with_the_wrong_length_is_rejected() {
        let map = MapBuilder::default().radius_map(&[1; 8], [2; 3], &mut [0; 7]);
        assert_eq!(map.unwrap_err().code(), "geometry.length");
    }

    #[test]
    fn radii_stop_at_255_without_wrapping() {
        // A thin stack would never reach a radius of 255, so the cube is 515 voxels wide: its centre would have radius
        // 257.
        let n = 515;
        let labels = vec![1; n * n * n];
        for num_slabs in [1, 2] {
            let builder = MapBuilder {
                num_slabs,
                ..MapBuilder::default()
            };
            let mut radius = vec![0; n * n * n];
            builder.radius_map(&labels, [n; 3], &mut radius).unwrap();
            let at = |z: usize, y: usize, x: usize| radius[(z * n + y) * n + x];
            assert_eq!(at(257, 257, 257), 255);
            assert_eq!(at(254, 257, 257), 254);
            assert_eq!(at(257, 257, 3), 3);
            assert_eq!(at(257, 514, 257), 0);
        }
    }
}
