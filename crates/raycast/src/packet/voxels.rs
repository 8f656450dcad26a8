//! Reads of a volume by a packet of rays: the operations of [`crate::sampling`], lane by lane.

use super::{bricks::Reader, lanes::Lanes};
use crate::{Field, Frame, SampleBricks};

/// Maximum number of voxels on an axis for which the accuracy of positions and the margin of a leap are sufficient.
const LONGEST_AXIS: f32 = 65_535.0;

/// Volume whose voxels have 32-bit indices, prepared for reads by packets.
#[derive(Clone, Copy)]
pub(super) struct Voxels<'a> {
    data: &'a [i16],
    last: [f32; 3],
    last_cell: [i32; 3],
    stride: [i32; 3],
    /// Memory index of voxel (1, 1, 1); `None` if the cell at this voxel lacks neighbours on a side.
    inner: Option<i32>,
    samples: Option<Reader<'a, SampleBricks>>,
}

/// For each lane, a cell of eight voxels and a position in the cell.
///
/// The cell of every lane is in the volume, also in lanes that are not active.
#[derive(Clone, Copy)]
pub(super) struct Cells<L: Lanes> {
    ijk: [L::I; 3],
    base: L::I,
    t: [L::F; 3],
}

/// Voxels around each lane's position from which a value and its gradient are interpolated.
struct Rows<L: Lanes> {
    /// Four voxels on each of the four rows along x through the cell: the two of the cell, and one beyond it on each
    /// side.
    own: [[L::I; 4]; 4],
    /// Pairs of voxels on the rows beside the cell, before and after it along y and z.
    ///
    /// The rows along y are at the lower and the upper z, the rows along z at the lower and the upper y.
    beside: [L::I; 8],
}

#[inline(always)]
fn lerp<L: Lanes>(l: L, t: L::F, a: L::F, b: L::F) -> L::F {
    l.fma(t, l.sub(b, a), a)
}

/// Return the linear interpolation between the two voxels of each lane's pair.
#[inline(always)]
fn lerp_pair<L: Lanes>(l: L, t: L::F, pair: L::I) -> L::F {
    l.fma(t, l.to_f(l.rise(pair)), l.to_f(l.first(pair)))
}

/// Return the linear interpolation between two integers of each lane.
#[inline(always)]
fn lerp_ints<L: Lanes>(l: L, t: L::F, a: L::I, b: L::I) -> L::F {
    l.fma(t, l.to_f(l.sub_i(b, a)), l.to_f(a))
}

impl<'a> Voxels<'a> {
    /// Prepare a volume for packets.
    ///
    /// Return `None` for a volume too large for 32-bit indices, or with one voxel along x, which has no pairs.
    pub(super) fn of(field: &Field<'a>) -> Option<Self> {
        let [x, y, z, _] = field.last;
        let fits = field.data.len() >= 4
            && field.data.len() < i32::MAX as usize
            && x >= 1.0
            && x.max(y).max(z) <= LONGEST_AXIS;
        fits.then(|| {
            let stride = field.stride.map(|s| s as i32);
            Self {
                data: field.data,
                last: [x, y, z],
                last_cell: [0, 1, 2].map(|a| field.last_cell[a]),
                stride,
                inner: (x.min(y).min(z) >= 3.0).then(|| stride.iter().sum()),
                samples: None,
            }
        })
    }

    /// Return a copy that reads values and gradients from the bricks of the frame, or from the volume without bricks.
    pub(super) fn reading(self, frame: &'a Frame<'a>) -> Self {
        let bricks = frame.samples.as_deref();
        let samples = bricks.map(|bricks| Reader::of(&frame.field, bricks));
        Self { samples, ..self }
    }

    /// Clamp voxel coordinates to `0 ..= last`; NaN becomes 0.
    #[inline(always)]
    fn clamp<L: Lanes>(&self, l: L, p: [L::F; 3]) -> [L::F; 3] {
        let mut x = p;
        for a in 0..3 {
            x[a] = l.min(l.max(p[a], l.splat(0.0)), l.splat(self.last[a]));
        }
        x
    }

    #[inline(always)]
    fn index<L: Lanes>(&self, l: L, [i, j, k]: [L::I; 3]) -> L::I {
        let row = l.mul_i(j, l.splat_i(self.stride[1]));
        let slice = l.mul_i(k, l.splat_i(self.stride[2]));
        l.add_i(i, l.add_i(row, slice))
    }

    /// Return the cells that contain points, clamped to the volume.
    #[inline(always)]
    pub(super) fn cells<L: Lanes>(&self, l: L, p: [L::F; 3]) -> Cells<L> {
        let mut t = self.clamp(l, p);
        let mut ijk = [l.splat_i(0); 3];
        for a in 0..3 {
            ijk[a] = l.min_i(l.whole(t[a]), l.splat_i(self.last_cell[a]));
            t[a] = l.sub(t[a], l.to_f(ijk[a]));
        }
        Cells {
            ijk,
            base: self.index(l, ijk),
            t,
        }
    }

    /// Return the cells that contain points which need no clamping.
    ///
    /// # Safety
    ///
    /// In every lane a coordinate must be 0 or more and less than `last` on every axis.
    #[inline(always)]
    pub(super) unsafe fn cells_between<L: Lanes>(&self, l: L, mut t: [L::F; 3]) -> Cells<L> {
        let mut ijk = [l.splat_i(0); 3];
        for a in 0..3 {
            ijk[a] = l.whole(t[a]);
            t[a] = l.sub(t[a], l.to_f(ijk[a]));
        }
        Cells {
            ijk,
            base: self.index(l, ijk),
            t,
        }
    }

    /// Prefetch two of the four rows of the cells that contain points `p`.
    ///
    /// The prefetches for neighbouring pixels cover the other rows.
    #[inline(always)]
    pub(super) fn prefetch_cells<L: Lanes>(&self, l: L, p: [L::F; 3]) {
        let base = l.store_i(self.cells(l, p).base);
        let across = (self.stride[1] + self.stride[2]) as isize;
        for n in 0..L::N {
            let first = self.data.as_ptr().wrapping_offset(base[n] as isize);
            prefetch_line(first);
            prefetch_line(first.wrapping_offset(across));
        }
    }

    /// Return the voxels nearest to points, clamped to the volume: their indices in memory and their coordinates.
    #[inline(always)]
    pub(super) fn nearest<L: Lanes>(&self, l: L, p: [L::F; 3]) -> (L::I, [L::F; 3]) {
        let mut v = self.clamp(l, p);
        let mut ijk = [l.splat_i(0); 3];
        for a in 0..3 {
            ijk[a] = l.whole(l.add(v[a], l.splat(0.5)));
            v[a] = l.to_f(ijk[a]);
        }
        (self.index(l, ijk), v)
    }

    /// Return the cells that contain points, clamped to the volume; the operations equal `Field::cell_of`.
    #[inline(always)]
    pub(super) fn cell_of<L: Lanes>(&self, l: L, p: [L::F; 3]) -> (L::I, [L::F; 3]) {
        let mut v = self.clamp(l, p);
        let mut ijk = [l.splat_i(0); 3];
        for a in 0..3 {
            ijk[a] = l.whole(v[a]);
            v[a] = l.add(l.to_f(ijk[a]), l.splat(0.5));
        }
        (self.index(l, ijk), v)
    }

    /// Return the value of each lane's voxel, given its index in memory.
    #[inline(always)]
    pub(super) fn at<L: Lanes>(&self, l: L, index: L::I) -> L::I {
        // SAFETY: the index comes from `nearest`, which clamps to the volume in all lanes. Benchmark:
        // benchmarks/measurements/rendering.md.
        unsafe { l.voxels(self.data.as_ptr(), index) }
    }

    /// Return the memory offsets from a cell's lower corner to its four rows along x.
    #[inline(always)]
    fn rows(&self) -> [i32; 4] {
        let [_, sy, sz] = self.stride;
        [0, sy, sz, sy + sz]
    }

    /// Return the trilinearly interpolated value of the volume for each ray, at its position in its cell of 8 voxels.
    #[inline(always)]
    pub(super) fn value<L: Lanes>(&self, l: L, cells: &Cells<L>) -> L::F {
        // SAFETY: `cells` clamps the lower corner to last_cell in all lanes, so that one step more on each axis is a
        // voxel; an axis of one voxel has stride 0, and x has two or more. Benchmark:
        // benchmarks/measurements/rendering.md.
        let pairs = unsafe { l.pairs(self.data.as_ptr(), cells.base, self.rows()) };
        let [tx, ty, tz] = cells.t;
        let mut r = [tx; 4];
        for n in 0..4 {
            r[n] = lerp_pair(l, tx, pairs[n]);
        }
        lerp(l, tz, lerp(l, ty, r[0], r[1]), lerp(l, ty, r[2], r[3]))
    }

    /// Return the interpolated values in cells and the interpolated central differences per voxel, for the wanted
    /// lanes.
    ///
    /// The four rows of the cell are read once, with one more voxel on each side.
    #[inline(always)]
    pub(super) fn value_and_gradient<L: Lanes>(
        &self,
        l: L,
        cells: &Cells<L>,
        wanted: L::M,
    ) -> (L::F, [L::F; 3]) {
        if let Some(bricks) = self.samples
            && let Some([value, x, y, z]) = bricks.between_voxels(l, &cells.ijk, &cells.t, wanted)
        {
            let half = l.splat(0.5);
            return (value, [l.mul(x, half), l.mul(y, half), l.mul(z, half)]);
        }
        // The test uses only the position, so the reads need not wait for the result of the previous sample.
        let mut inside = l.less_i(l.splat_i(0), cells.ijk[0]);
        for a in 0..3 {
            inside = l.and(inside, l.less_i(l.splat_i(0), cells.ijk[a]));
            inside = l.and(inside, l.less_i(cells.ijk[a], l.splat_i(self.last_cell[a])));
        }
        let read = match self.inner {
            Some(inner) if l.bits(l.without(wanted, inside)) == 0 => {
                self.read_inside(l, l.select_i(inside, cells.base, l.splat_i(inner)))
            }
            _ => self.read_at_edge(l, cells),
        };
        interpolate(l, cells.t, &read)
    }

    /// Read the rows of cells that have neighbours on all sides.
    #[inline(always)]
    fn read_inside<L: Lanes>(&self, l: L, base: L::I) -> Rows<L> {
        let [_, sy, sz] = self.stride;
        // SAFETY: the neighbours before and after the cell exist in all lanes, because the caller has replaced cells
        // without them by an inner cell. Benchmark: benchmarks/measurements/rendering.md.
        let [_, r10, r01, r11] = self.rows();
        let (quads, pairs) = unsafe {
            (
                l.quads(self.data.as_ptr(), base, [-1, r10 - 1, r01 - 1, r11 - 1]),
                l.pairs(
                    self.data.as_ptr(),
                    base,
                    [
                        -sy,
                        2 * sy,
                        sz - sy,
                        sz + 2 * sy,
                        -sz,
                        2 * sz,
                        sy - sz,
                        sy + 2 * sz,
                    ],
                ),
            )
        };
        let mut own = [[base; 4]; 4];
        for n in 0..4 {
            let [first, second] = quads[n];
            own[n] = [
                l.first(first),
                l.second(first),
                l.first(second),
                l.second(second),
            ];
        }
        Rows { own, beside: pairs }
    }

    /// Read the rows of cells of which some are at the edge of the volume; the edge voxel replaces its missing
    /// neighbour.
    #[inline(always)]
    fn read_at_edge<L: Lanes>(&self, l: L, cells: &Cells<L>) -> Rows<L> {
        let zero = l.splat_i(0);
        let (mut before, mut after) = ([zero; 3], [zero; 3]);
        let (mut has_before, mut has_after) = ([l.mask(0); 3], [l.mask(0); 3]);
        for a in 0..3 {
            let s = self.stride[a];
            has_before[a] = l.less_i(zero, cells.ijk[a]);
            has_after[a] = l.less_i(cells.ijk[a], l.splat_i(self.last_cell[a]));
            before[a] = l.select_i(has_before[a], l.splat_i(s), zero);
            after[a] = l.select_i(has_after[a], l.splat_i(2 * s), l.splat_i(s));
        }
        // SAFETY: the index is a sum over the axes of (0 ..= n - 1) * stride with at most n - 2 along x, in all lanes:
        // `cells` clamps the lower corner to last_cell, and further steps are taken only where the neighbour exists.
        // Benchmark: benchmarks/measurements/rendering.md.
        let pair = |index: L::I| unsafe { l.pairs(self.data.as_ptr(), index, [0])[0] };
        let mut corners = [cells.base; 4];
        for n in 0..4 {
            corners[n] = l.add_i(cells.base, l.splat_i(self.rows()[n]));
        }
        let mut own = [[zero; 4]; 4];
        for n in 0..4 {
            let first = pair(l.sub_i(corners[n], before[0]));
            let second = pair(l.add_i(corners[n], l.sub_i(after[0], l.splat_i(1))));
            own[n] = [
                l.first(first),
                l.select_i(has_before[0], l.second(first), l.first(first)),
                l.select_i(has_after[0], l.first(second), l.second(second)),
                l.second(second),
            ];
        }
        let [b00, b10, b01, _] = corners;
        let mut beside = [
            l.sub_i(b00, before[1]),
            l.add_i(b00, after[1]),
            l.sub_i(b01, before[1]),
            l.add_i(b01, after[1]),
            l.sub_i(b00, before[2]),
            l.add_i(b00, after[2]),
            l.sub_i(b10, before[2]),
            l.add_i(b10, after[2]),
        ];
        for n in 0..8 {
            beside[n] = pair(beside[n]);
        }
        Rows { own, beside }
    }
}

/// Prefetch the cache line at an address; any address is allowed.
#[inline(always)]
fn prefetch_line(at: *const i16) {
    #[cfg(target_arch = "x86_64")]
    {
        use std::arch::x86_64::{_MM_HINT_T0, _mm_prefetch};
        // SAFETY: every x86_64 processor has SSE, and a prefetch has no effect on memory and faults at no address.
        // Benchmark: benchmarks/measurements/rendering.md.
        unsafe { _mm_prefetch::<_MM_HINT_T0>(at.cast()) };
    }
    #[cfg(not(target_arch = "x86_64"))]
    let _ = at;
}

/// Interpolate value and gradient from the rows of a cell; see `Field::value_in` and `Field::gradient_in`.
#[inline(always)]
fn interpolate<L: Lanes>(l: L, t: [L::F; 3], read: &Rows<L>) -> (L::F, [L::F; 3]) {
    let beside = |n: usize| (l.first(read.beside[n]), l.second(read.beside[n]));
    let less = |a: (L::I, L::I), b: (L::I, L::I)| (l.sub_i(a.0, b.0), l.sub_i(a.1, b.1));
    let mut rows = [[t[0]; 4]; 4];
    for n in 0..4 {
        let own = |n: usize| (read.own[n][1], read.own[n][2]);
        let [v0, v1, v2, v3] = read.own[n];
        // The rows before and after along y and z: on one side, a corner's neighbour is the other corner of the cell.
        let (y, z) = (n & 1, n >> 1);
        let along_y = if y == 0 {
            less(own(n + 1), beside(2 * z))
        } else {
            less(beside(2 * z + 1), own(n - 1))
        };
        let along_z = if z == 0 {
            less(own(n + 2), beside(4 + 2 * y))
        } else {
            less(beside(4 + 2 * y + 1), own(n - 2))
        };
        let along_x = (l.sub_i(v2, v0), l.sub_i(v3, v1));
        for (c, (a, b)) in [own(n), along_x, along_y, along_z].into_iter().enumerate() {
            rows[n][c] = lerp_ints(l, t[0], a, b);
        }
    }
    between_rows(l, t, &rows)
}

/// Interpolate value and gradient from the values and differences on the four rows of a cell.
#[inline(always)]
fn between_rows<L: Lanes>(l: L, [_, ty, tz]: [L::F; 3], r: &[[L::F; 4]; 4]) -> (L::F, [L::F; 3]) {
    let mut sum = r[0];
    for c in 0..4 {
        let low = lerp(l, ty, r[0][c], r[1][c]);
        let high = lerp(l, ty, r[2][c], r[3][c]);
        sum[c] = lerp(l, tz, low, high);
    }
    let half = l.splat(0.5);
    let [value, dx, dy, dz] = sum;
    (value, [l.mul(dx, half), l.mul(dy, half), l.mul(dz, half)])
}
