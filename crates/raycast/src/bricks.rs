//! Slopes of walls, kept in bricks: what lighting reads of a volume, worked out once for all pictures of it.
//!
//! A lit pixel needs the volume's slope round its wall. Taken anew for each pixel that is fourteen samples, most of which
//! its neighbours take as well. Here it is worked out at voxels, in bricks of 4 x 4 x 4 cells that are filled when a ray
//! first meets a wall in them, and read between voxels (docs/decisions/0080). Which bricks exist never shows in a picture.

use std::{
    cell::{RefCell, UnsafeCell},
    sync::{
        Arc,
        atomic::{AtomicU32, AtomicUsize, Ordering},
    },
};

use crate::{
    Field, Frame, RaycastError,
    normals::{AXIS_AT, AXIS_WEIGHT, CORNER_AT, CORNER_WEIGHT, Normals},
};

/// Cells of a brick along each axis.
pub(crate) const CELLS: usize = 4;
/// Voxels of a brick along each axis: both ends of its cells.
const VOXELS: usize = CELLS + 1;
/// Numbers in memory for each voxel: the slope along i, j and k, and one that is 0, so that a voxel is one 64-bit load.
pub(crate) const PER_VOXEL: usize = 4;
/// Numbers in memory for each brick, of which the last few are 0.
pub(crate) const PER_BRICK: usize = 512;
/// Memory steps of a brick from voxel to voxel along each axis.
pub(crate) const STRIDE: [usize; 3] = [PER_VOXEL, PER_VOXEL * VOXELS, PER_VOXEL * VOXELS * VOXELS];
/// At most so many bricks are kept: 64 MB, some fifty views of an airway.
const MOST_BRICKS: usize = 1 << 16;

/// In the table: not there, and being filled. Others are one more than the brick's number.
const ABSENT: u32 = 0;
const BUSY: u32 = u32::MAX;

/// Bricks of slopes of one volume, for one way of finding normals.
#[derive(Debug)]
pub struct NormalBricks {
    shape: [usize; 3],
    num_bricks: [usize; 3],
    reach: [f32; 3],
    held: [f32; 2],
    taps: [Taps; 3],
    /// Stored numbers are slopes times this.
    scale: f32,
    /// For each brick of the volume where it is kept.
    table: Box<[AtomicU32]>,
    kept: Kept,
}

/// Memory for bricks; each is written once, by the thread that has claimed it, before the table tells of it.
#[derive(Debug)]
struct Kept {
    numbers: UnsafeCell<Vec<i16>>,
    most: usize,
    len: AtomicUsize,
}

// SAFETY: a brick is written by the one thread that has claimed it, and read by others only after the table tells of it
// (release, then acquire); the vector itself never grows.
unsafe impl Sync for Kept {}

/// Samples before and after a voxel along one axis: `near` at the corners of the box, `far` on the axis.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Taps {
    near: Tap,
    far: Tap,
}

/// A distance in whole voxels and the rest.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Tap {
    whole: usize,
    rest: f32,
}

impl Tap {
    fn of(distance: f32) -> Self {
        Self {
            whole: distance as usize,
            rest: distance - (distance as usize) as f32,
        }
    }

    /// Values at this distance after and before `at`, in a line whose neighbours are `stride` apart.
    #[inline(always)]
    fn both(self, line: &[f32], at: usize, stride: usize) -> (f32, f32) {
        let (one, two) = (self.whole * stride, (self.whole + 1) * stride);
        let between = |a: f32, b: f32| a + self.rest * (b - a);
        (
            between(line[at + one], line[at + two]),
            between(line[at - one], line[at - two]),
        )
    }
}

impl Taps {
    /// Voxels that are needed beyond a brick's own.
    fn halo(&self) -> usize {
        self.far.whole + 1
    }
}

/// Where a lane finds its cell.
pub(crate) enum Place {
    /// Place in [`NormalBricks::numbers`].
    Kept(usize),
    /// No more bricks can be kept; these are the numbers.
    Lent(Box<[i16; PER_BRICK]>),
}

impl NormalBricks {
    /// No brick yet, for the volume and the transfer function of a frame.
    #[must_use]
    pub fn of(frame: &Frame<'_>) -> Self {
        Self::with_room(frame, MOST_BRICKS)
    }

    /// The same with room for so many bricks.
    #[must_use]
    pub fn with_room(frame: &Frame<'_>, most: usize) -> Self {
        let normals = Normals::of(frame);
        let shape = frame.grid.shape_ijk();
        let num_bricks = shape.map(|n| n.saturating_sub(1).div_ceil(CELLS).max(1));
        let num = num_bricks.iter().product();
        let most = most.min(num);
        let [low, high] = normals.held;
        // What both parts of a slope are at most.
        let steepest = (AXIS_WEIGHT + 4.0 * CORNER_WEIGHT) * (high - low);
        Self {
            shape,
            num_bricks,
            reach: normals.reach,
            held: normals.held,
            taps: normals.reach.map(|reach| Taps {
                near: Tap::of(CORNER_AT * reach),
                far: Tap::of(AXIS_AT * reach),
            }),
            scale: 32_767.0 / steepest,
            table: absent(num),
            kept: Kept {
                // Lanes that have no brick read the first.
                numbers: UnsafeCell::new(vec![0; most.max(1) * PER_BRICK]),
                most,
                len: AtomicUsize::new(0),
            },
        }
    }

    /// Whether a frame's slopes are these. That it shows the same values is the caller's word.
    #[must_use]
    pub fn fit(&self, frame: &Frame<'_>) -> bool {
        let normals = Normals::of(frame);
        self.shape == frame.grid.shape_ijk()
            && self.reach == normals.reach
            && self.held == normals.held
    }

    /// Bricks kept.
    #[must_use]
    pub fn len(&self) -> usize {
        self.kept.len.load(Ordering::Relaxed).min(self.kept.most)
    }

    /// Whether no brick is kept.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Whether no further brick can be kept: pictures stay right and become slow.
    #[must_use]
    pub fn is_full(&self) -> bool {
        self.len() == self.kept.most && self.kept.most < self.table.len()
    }

    /// Slopes are stored numbers times this.
    pub(crate) fn unit(&self) -> f32 {
        1.0 / self.scale
    }

    /// The numbers of all bricks.
    pub(crate) fn numbers(&self) -> *const i16 {
        // SAFETY: the vector never changes, only what it holds; no reference to that is made here.
        unsafe { (*self.kept.numbers.get()).as_ptr() }
    }

    /// Where the lower corner of a cell lies; its brick is filled if this is the first to ask.
    ///
    /// `cell` must be within the volume's cells.
    #[inline(always)]
    pub(crate) fn place(&self, field: &Field<'_>, cell: [usize; 3]) -> (Place, usize) {
        let brick = cell.map(|c| c / CELLS);
        let number = brick[0] + self.num_bricks[0] * (brick[1] + self.num_bricks[1] * brick[2]);
        let within: usize = (0..3).map(|a| cell[a] % CELLS * STRIDE[a]).sum();
        let kept = self.table[number].load(Ordering::Acquire);
        if kept != ABSENT && kept != BUSY {
            return (Place::Kept((kept as usize - 1) * PER_BRICK), within);
        }
        (self.fill(field, number, brick), within)
    }

    #[cold]
    fn fill(&self, field: &Field<'_>, number: usize, brick: [usize; 3]) -> Place {
        let entry = &self.table[number];
        let (ok, mine) = (Ordering::Acquire, Ordering::Acquire);
        match entry.compare_exchange(ABSENT, BUSY, ok, mine) {
            Ok(_) => {}
            Err(mut kept) => {
                while kept == BUSY {
                    std::thread::yield_now();
                    kept = entry.load(Ordering::Acquire);
                }
                if kept != ABSENT {
                    return Place::Kept((kept as usize - 1) * PER_BRICK);
                }
                return Place::Lent(self.filled(field, brick));
            }
        }
        let slot = self.kept.len.fetch_add(1, Ordering::Relaxed);
        if slot >= self.kept.most {
            self.kept.len.store(self.kept.most, Ordering::Relaxed);
            entry.store(ABSENT, Ordering::Release);
            return Place::Lent(self.filled(field, brick));
        }
        let numbers = self.filled(field, brick);
        // SAFETY: slot < most, and no other thread has or will have this slot; see `Kept`.
        unsafe {
            let to = (*self.kept.numbers.get())
                .as_mut_ptr()
                .add(slot * PER_BRICK);
            to.copy_from_nonoverlapping(numbers.as_ptr(), PER_BRICK);
        }
        entry.store(slot as u32 + 1, Ordering::Release);
        Place::Kept(slot * PER_BRICK)
    }

    /// The slopes at the voxels of a brick: differences across it, on each axis by itself and between the corners of a box,
    /// of values held near the wall's own. The corners' part is a product of three sums along the axes.
    fn filled(&self, field: &Field<'_>, brick: [usize; 3]) -> Box<[i16; PER_BRICK]> {
        thread_local! {
            static WORK: RefCell<Work> = RefCell::default();
        }
        WORK.with_borrow_mut(|work| {
            work.read(self, field, brick);
            work.sum_along_k(&self.taps);
            work.sum_along_j(&self.taps);
            work.slopes(&self.taps, self.scale)
        })
    }
}

/// A table without bricks: memory that is zero and touched only where a ray comes.
fn absent(num: usize) -> Box<[AtomicU32]> {
    let zeros = vec![ABSENT; num].into_boxed_slice();
    // SAFETY: an AtomicU32 has the size, the alignment and the bits of a u32. Benchmark: one by one they would be written,
    // 10 MB for a chest, of which a view touches a hundredth.
    unsafe { Box::from_raw(Box::into_raw(zeros) as *mut [AtomicU32]) }
}

/// The parts of a brick on the way to its slopes.
#[derive(Default)]
struct Work {
    halo: [usize; 3],
    /// Voxels read, `[k, j, i]`, and how many along each axis.
    read: Vec<f32>,
    n: [usize; 3],
    /// Sums and differences along k, `[voxel of the brick, j, i]`.
    sum_k: Vec<f32>,
    rise_k: Vec<f32>,
    /// Along k and j, `[voxel, voxel, i]`: both sums; rise along j; rise along k.
    sums: Vec<f32>,
    rise_j: Vec<f32>,
    rise_k_sum_j: Vec<f32>,
}

impl Work {
    fn read(&mut self, bricks: &NormalBricks, field: &Field<'_>, brick: [usize; 3]) {
        self.halo = bricks.taps.map(|taps| taps.halo());
        self.n = self.halo.map(|halo| VOXELS + 2 * halo);
        let [low, high] = bricks.held;
        let last = bricks.shape.map(|n| n as isize - 1);
        let at = |a: usize, n: usize| {
            let voxel = (brick[a] * CELLS + n) as isize - self.halo[a] as isize;
            voxel.clamp(0, last[a]) as usize * field.stride[a]
        };
        self.read.clear();
        for k in 0..self.n[2] {
            for j in 0..self.n[1] {
                let row = at(2, k) + at(1, j);
                for i in 0..self.n[0] {
                    let value = f32::from(field.data[row + at(0, i)]);
                    self.read.push(value.max(low).min(high));
                }
            }
        }
    }

    fn sum_along_k(&mut self, taps: &[Taps; 3]) {
        let plane = self.n[0] * self.n[1];
        self.sum_k.clear();
        self.rise_k.clear();
        for k in 0..VOXELS {
            let first = (k + self.halo[2]) * plane;
            for n in first..first + plane {
                let (after, before) = taps[2].near.both(&self.read, n, plane);
                self.sum_k.push(after + before);
                self.rise_k.push(after - before);
            }
        }
    }

    fn sum_along_j(&mut self, taps: &[Taps; 3]) {
        let [row, rows, _] = self.n;
        for out in [&mut self.sums, &mut self.rise_j, &mut self.rise_k_sum_j] {
            out.clear();
        }
        for k in 0..VOXELS {
            for j in 0..VOXELS {
                let first = (k * rows + j + self.halo[1]) * row;
                for n in first..first + row {
                    let (after, before) = taps[1].near.both(&self.sum_k, n, row);
                    self.sums.push(after + before);
                    self.rise_j.push(after - before);
                    let (after, before) = taps[1].near.both(&self.rise_k, n, row);
                    self.rise_k_sum_j.push(after + before);
                }
            }
        }
    }

    fn slopes(&self, taps: &[Taps; 3], scale: f32) -> Box<[i16; PER_BRICK]> {
        let [row, rows, _] = self.n;
        let stride = [1, row, row * rows];
        let mut out = Box::new([0; PER_BRICK]);
        for k in 0..VOXELS {
            for j in 0..VOXELS {
                for i in 0..VOXELS {
                    let line = (k * VOXELS + j) * row + i + self.halo[0];
                    let near = taps[0].near;
                    let (after, before) = near.both(&self.sums, line, 1);
                    let along_i = after - before;
                    let (after, before) = near.both(&self.rise_j, line, 1);
                    let along_j = after + before;
                    let (after, before) = near.both(&self.rise_k_sum_j, line, 1);
                    let along_k = after + before;
                    let voxel = (k + self.halo[2]) * stride[2]
                        + (j + self.halo[1]) * stride[1]
                        + i
                        + self.halo[0];
                    let to = ((k * VOXELS + j) * VOXELS + i) * PER_VOXEL;
                    for (a, corners) in [along_i, along_j, along_k].into_iter().enumerate() {
                        let (after, before) = taps[a].far.both(&self.read, voxel, stride[a]);
                        let slope = AXIS_WEIGHT * (after - before) + CORNER_WEIGHT * corners;
                        out[to + a] = (slope * scale).round() as i16;
                    }
                }
            }
        }
        out
    }
}

impl Frame<'_> {
    /// The same with bricks of slopes that earlier pictures of this volume have filled.
    ///
    /// `bricks` must have been filled from the same values, which is the caller's word.
    pub fn with_normals(mut self, bricks: Arc<NormalBricks>) -> Result<Self, RaycastError> {
        if !bricks.fit(&self) {
            return Err(RaycastError::Setting {
                what: "bricks of normals",
                expected: "those of this volume's shape and this transfer function".to_owned(),
                found: "others".to_owned(),
            });
        }
        self.bricks = Some(bricks);
        Ok(self)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        Appearance, FrameOptions, InstructionSet, Interpolation, Method, Transfer, TransferTable,
        cast_rows,
        packet::{TestLanes as _, TestSet, test_rise},
    };
    use carina_grid::{Affine, Camera, Grid, VolumeView};
    use proptest::prelude::*;

    const LOOK: Appearance = Appearance {
        guides_mm: [[-1.9, -0.5, 0.0], [1.9, -0.5, 0.3]],
        exposure: Some(9.0),
        ambient: 0.2,
        wrap: 0.25,
        gloss: 0.5,
        shininess_log2: 6,
        paleness: 0.5,
        pale_hu: [0.0, 300.0],
        texture: 1.0,
        vessels: 0.0,
        silhouettes: true,
        specks: 1.0,
        secretions: 0.5,
        fog: 0.0,
        rings: 0.0,
        membrane: 0.0,
        hue: 0.0,
        spurs: 0.0,
    };

    struct Case {
        grid: Grid,
        hu: Vec<i16>,
        table: TransferTable,
    }

    impl Case {
        fn new(shape: [usize; 3], spacing: [f64; 3], hu: impl Fn([f64; 3]) -> f64) -> Self {
            let column = |a: usize| std::array::from_fn(|b| if a == b { spacing[a] } else { 0.0 });
            let place = Affine::from_columns(column(0), column(1), column(2), [0.0; 3]);
            let [nx, ny, nz] = shape;
            let grid = Grid::new([nz, ny, nx], place).unwrap();
            let hu = (0..grid.num_voxels())
                .map(|n| hu(grid.voxel(n).map(|v| v as f64)) as i16)
                .collect();
            let wall = vec![[-650.0, 0.9, 0.5, 0.5, 0.0], [-450.0, 0.9, 0.5, 0.5, 0.9]];
            let transfer = Transfer::new(wall, 1.0, 1).unwrap();
            let table = TransferTable::new(&transfer, 0.3, -1024, 3071).unwrap();
            Self { grid, hu, table }
        }

        fn random(shape: [usize; 3], spacing: [f64; 3], seed: u64) -> Self {
            let mut state = seed | 1;
            let noise: Vec<f64> = (0..shape.iter().product())
                .map(|_| {
                    state = state
                        .wrapping_mul(6_364_136_223_846_793_005)
                        .wrapping_add(1);
                    ((state >> 40) % 2200) as f64 - 1100.0
                })
                .collect();
            let [nx, ny, _] = shape;
            Self::new(shape, spacing, |[x, y, z]| {
                noise[(z as usize * ny + y as usize) * nx + x as usize]
            })
        }

        fn frame(&self) -> Frame<'_> {
            let volume = VolumeView::new(&self.hu, &self.grid).unwrap();
            let middle = self.grid.shape_ijk().map(|n| 0.5 * (n as f64 - 1.0));
            let mut pose = *Affine::IDENTITY.rows();
            let at = self.grid.lps_from_ijk().point(middle);
            for a in 0..3 {
                pose[a][3] = at[a];
            }
            let camera = Camera::new(Affine::from_rows(pose), 1.6, 48, 40).unwrap();
            let options = FrameOptions {
                interpolation: Interpolation::Trilinear,
                light: None,
                appearance: Some(LOOK),
                background: [0.0; 3],
            };
            Frame::new(volume, &self.table, camera, options).unwrap()
        }
    }

    /// The slope at a voxel by its definition: fourteen samples of held values, in f64.
    fn slope_at(frame: &Frame<'_>, voxel: [usize; 3]) -> [f64; 3] {
        let Normals { reach, held, .. } = Normals::of(frame);
        let last = frame.grid.shape_ijk().map(|n| n as isize - 1);
        let held_at = |ijk: [isize; 3]| {
            let at = |a: usize| ijk[a].clamp(0, last[a]) as usize * frame.field.stride[a];
            f64::from(frame.field.data[at(0) + at(1) + at(2)])
                .clamp(f64::from(held[0]), f64::from(held[1]))
        };
        let sample = |off: [f64; 3]| {
            let p: [f64; 3] =
                std::array::from_fn(|a| voxel[a] as f64 + off[a] * f64::from(reach[a]));
            let mut sum = 0.0;
            for corner in 0..8 {
                let high = |a: usize| corner >> a & 1;
                let weight: f64 = (0..3)
                    .map(|a| p[a] - p[a].floor())
                    .enumerate()
                    .map(|(a, t)| if high(a) == 1 { t } else { 1.0 - t })
                    .product();
                let ijk = std::array::from_fn(|a| p[a].floor() as isize + high(a) as isize);
                sum += weight * held_at(ijk);
            }
            sum
        };
        std::array::from_fn(|a| {
            let axis = |side: f64| {
                let mut off = [0.0; 3];
                off[a] = side * f64::from(AXIS_AT);
                sample(off)
            };
            let corners: f64 = (0..8)
                .map(|n| [0, 1, 2].map(|b| if n >> b & 1 == 1 { 1.0 } else { -1.0 }))
                .map(|side| side[a] * sample(side.map(|s| s * f64::from(CORNER_AT))))
                .sum();
            f64::from(AXIS_WEIGHT) * (axis(1.0) - axis(-1.0)) + f64::from(CORNER_WEIGHT) * corners
        })
    }

    /// As packets read it, in one lane.
    fn rise_at(frame: &Frame<'_>, bricks: &NormalBricks, p: [f32; 3]) -> [f32; 3] {
        let l = TestSet;
        let p = [l.splat(p[0]), l.splat(p[1]), l.splat(p[2])];
        let rise = test_rise(l, bricks, &frame.field, p);
        [0, 1, 2].map(|a| l.store(rise[a])[0])
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(48))]

        #[test]
        fn slopes_at_voxels_are_their_definition_and_between_them_interpolated(
            shape in prop::array::uniform3(1usize..14), spacing in prop::array::uniform3(0.25f64..2.5),
            at in prop::array::uniform3(0.0f32..1.0), seed in any::<u64>(),
        ) {
            let case = Case::random(shape, spacing, seed);
            let frame = case.frame();
            let bricks = NormalBricks::of(&frame);
            let last = shape.map(|n| n as f32 - 1.0);
            let p: [f32; 3] = std::array::from_fn(|a| at[a] * last[a]);
            let found = rise_at(&frame, &bricks, p);
            let mut expected = [0.0; 3];
            for corner in 0..8 {
                let high = |a: usize| corner >> a & 1;
                let lower = |a: usize| (p[a] as usize).min(shape[a].saturating_sub(2));
                let weight: f64 = (0..3)
                    .map(|a| f64::from(p[a]) - lower(a) as f64)
                    .enumerate()
                    .map(|(a, t)| if high(a) == 1 { t } else { 1.0 - t })
                    .product();
                let voxel = std::array::from_fn(|a| (lower(a) + high(a)).min(shape[a] - 1));
                let slope = slope_at(&frame, voxel);
                for a in 0..3 {
                    expected[a] += weight * slope[a];
                }
            }
            for a in 0..3 {
                // Stored to half a unit.
                let off = (f64::from(found[a]) - expected[a]).abs();
                prop_assert!(off < 0.51 * f64::from(bricks.unit()) + 0.02, "{found:?} {expected:?}");
            }
        }
    }

    #[test]
    fn a_picture_is_the_same_whatever_bricks_there_are_and_however_many_can_be_kept() {
        let case = Case::new([30, 26, 22], [0.7, 0.8, 1.1], |[x, y, z]| {
            let off = [(x - 14.5) * 0.7, (y - 12.5) * 0.8, (z - 10.5) * 1.1];
            let tissue = (carina_grid::length(off) - 6.0 + (x * y).sin()).clamp(0.0, 1.0);
            -1000.0 + 1040.0 * tissue
        });
        let shown =
            |frame: &Frame<'_>, simd| cast_rows(frame, Method::Brute, 0..40, simd).unwrap().0;
        let truth = shown(&case.frame(), InstructionSet::Portable);
        for simd in InstructionSet::available() {
            for room in [0, 1, 2, 1000] {
                let bricks = Arc::new(NormalBricks::with_room(&case.frame(), room));
                let frame = case.frame().with_normals(Arc::clone(&bricks)).unwrap();
                for _ in 0..2 {
                    assert!(shown(&frame, simd) == truth, "{simd:?}, room for {room}");
                }
                assert_eq!(bricks.is_full(), room <= 2);
                assert!(bricks.len() <= room && bricks.is_empty() == (room == 0));
            }
        }
    }

    #[test]
    fn bricks_of_another_transfer_function_are_refused() {
        let case = Case::random([12, 12, 12], [1.0; 3], 7);
        let steep = vec![[-150.0, 0.9, 0.5, 0.5, 0.0], [200.0, 0.9, 0.5, 0.5, 0.9]];
        let other = Case {
            table: TransferTable::new(&Transfer::new(steep, 1.0, 1).unwrap(), 0.3, -1024, 3071)
                .unwrap(),
            grid: case.grid.clone(),
            hu: case.hu.clone(),
        };
        let bricks = Arc::new(NormalBricks::of(&other.frame()));
        let error = case.frame().with_normals(bricks).unwrap_err();
        assert!(error.to_string().contains("bricks of normals"), "{error}");
    }

    #[test]
    fn slopes_of_a_blurred_plane_point_across_it_no_less_than_samples_at_the_point_do() {
        let (mut worst, mut sum, mut sum_of_samples) = (0.0f64, 0.0, 0.0);
        for n in 0..40 {
            let turn = f64::from(n);
            let across = carina_grid::unit([turn.sin(), (1.7 * turn).cos(), (0.6 * turn).sin()])
                .expect("a direction");
            let spacing = [0.7, 0.7, 0.9];
            let case = Case::new([25, 25, 21], spacing, |ijk| {
                let from_middle: [f64; 3] =
                    std::array::from_fn(|a| (ijk[a] - [12.0, 12.0, 10.0][a]) * spacing[a]);
                let edge = carina_grid::dot(from_middle, across) / 0.6;
                // A smooth step, about as a scanner draws it.
                -1000.0 + 1040.0 / (1.0 + (-2.4 * edge).exp())
            });
            let frame = case.frame();
            let p = [12.0 + 0.3 * turn.sin() as f32, 12.2, 9.7];
            let off = |normal: [f32; 3]| {
                let normal = carina_grid::unit(normal.map(f64::from)).expect("a slope");
                let cosine = carina_grid::dot(normal, across).abs();
                cosine.min(1.0).acos().to_degrees()
            };
            let normals = Normals::of(&frame);
            let rise = rise_at(&frame, &NormalBricks::of(&frame), p);
            let from_bricks = off(normals.rows.map(|row| crate::normals::dot(rise, row)));
            let ray = crate::frame::Ray {
                origin: [p[0], p[1], p[2], 0.0],
                delta: [0.1, 0.2, 0.3, 0.0],
                first: 0,
                end: 1,
            };
            sum_of_samples += off(normals.at(&frame, &ray, 0.0));
            sum += from_bricks;
            worst = worst.max(from_bricks);
        }
        assert!(worst < 2.0, "{worst} degrees");
        assert!(sum <= sum_of_samples, "{sum} {sum_of_samples}");
    }
}
