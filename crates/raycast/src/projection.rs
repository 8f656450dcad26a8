//! Maximum intensity projections along the three grid axes in one pass (paper 3.1, X-ray views).

use carina_grid::VolumeView;
use rayon::prelude::*;

use crate::InstructionSet;

/// Maximum intensity projections of a volume along each grid axis, as three pictures.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Projections {
    /// Maximum along i of each line, `[k, j]`.
    pub along_i: Vec<i16>,
    /// Maximum along j of each line, `[k, i]`.
    pub along_j: Vec<i16>,
    /// Maximum along k of each line, `[j, i]`.
    pub along_k: Vec<i16>,
}

/// Compute the maximum projections of a volume along its three axes; each voxel is read once.
#[must_use]
pub fn maximum_projections(volume: VolumeView<'_, i16>) -> Projections {
    maximum_projections_by(volume, InstructionSet::best())
}

/// Compute the maximum projections with a given instruction set; the results are equal for all sets.
#[must_use]
pub fn maximum_projections_by(volume: VolumeView<'_, i16>, simd: InstructionSet) -> Projections {
    let [ni, nj, nk] = volume.grid().shape_ijk();
    let mut along_i = vec![i16::MIN; nk * nj];
    let mut along_j = vec![i16::MIN; nk * ni];
    // There is at most one slab per thread, because each slab has its own image along k.
    let slices = nk.div_ceil(rayon::current_num_threads());
    let along_k = volume
        .data()
        .par_chunks(nj * ni * slices)
        .zip(along_i.par_chunks_mut(nj * slices))
        .zip(along_j.par_chunks_mut(ni * slices))
        .map(|((data, along_i), along_j)| {
            let mut along_k = vec![i16::MIN; nj * ni];
            let slab = Slab {
                data,
                shape_ji: [nj, ni],
                along_i,
                along_j,
                along_k: &mut along_k,
            };
            slab.project(simd);
            along_k
        })
        .reduce_with(|mut a, b| {
            raise(&mut a, &b);
            a
        });
    Projections {
        along_i,
        along_j,
        along_k: along_k.unwrap_or_default(),
    }
}

/// Slab of successive slices, with its parts of the three images.
struct Slab<'a> {
    data: &'a [i16],
    shape_ji: [usize; 2],
    along_i: &'a mut [i16],
    along_j: &'a mut [i16],
    along_k: &'a mut [i16],
}

/// Vector registers of int16 values with the operations of the projections.
///
/// A value of the implementing type proves that the machine has these registers.
trait Values: Copy {
    /// Number of int16 values in a register.
    const N: usize;
    /// Whether two rows are processed together with explicit prefetches.
    ///
    /// Without them the processor's own prefetcher follows the rows. Explicit prefetches can disturb it: on Zen 4 with
    /// AVX2 they halve the speed.
    const PREFETCHES: bool;
    type V: Copy;
    fn least(self) -> Self::V;
    fn max(self, a: Self::V, b: Self::V) -> Self::V;
    /// Load a register of `N` values.
    ///
    /// # Safety
    ///
    /// `N` values from `at` must be readable.
    unsafe fn load(self, at: *const i16) -> Self::V;
    /// Prefetch the cache line at `at`; any address is allowed.
    fn fetch(self, at: *const i16);
    /// Store the `N` values of a register.
    ///
    /// # Safety
    ///
    /// `N` values from `at` must be writable.
    unsafe fn store(self, at: *mut i16, v: Self::V);
}

/// One value, for machines without any of the registers below.
#[derive(Clone, Copy)]
#[cfg_attr(
    target_arch = "x86_64",
    allow(dead_code, reason = "every x86_64 has SSE2")
)]
struct One;

impl Values for One {
    const N: usize = 1;
    const PREFETCHES: bool = false;
    type V = i16;
    #[inline(always)]
    fn least(self) -> i16 {
        i16::MIN
    }
    #[inline(always)]
    fn max(self, a: i16, b: i16) -> i16 {
        a.max(b)
    }
    #[inline(always)]
    unsafe fn load(self, at: *const i16) -> i16 {
        // SAFETY: the caller guarantees that `N` = 1 value is readable at `at`. Benchmark: `carina bench isoregion`.
        unsafe { *at }
    }
    #[inline(always)]
    fn fetch(self, _: *const i16) {}
    #[inline(always)]
    unsafe fn store(self, at: *mut i16, v: i16) {
        // SAFETY: the caller guarantees that `N` = 1 value is writable at `at`.
        unsafe { *at = v }
    }
}

#[cfg(target_arch = "x86_64")]
macro_rules! registers {
    ($name:ident, $what:literal, $v:ident, $n:literal, $prefetches:literal, $set1:ident, $max:ident, $load:ident, $store:ident) => {
        #[doc = $what]
        #[derive(Clone, Copy)]
        struct $name(());

        impl Values for $name {
            const N: usize = $n;
            const PREFETCHES: bool = $prefetches;
            type V = std::arch::x86_64::$v;
            #[inline(always)]
            fn least(self) -> Self::V {
                // SAFETY: `self` is created only if the CPU has these instructions. Benchmark:
                // `carina bench isoregion`, the projections.
                unsafe { std::arch::x86_64::$set1(i16::MIN) }
            }
            #[inline(always)]
            fn max(self, a: Self::V, b: Self::V) -> Self::V {
                // SAFETY: `self` is created only if the CPU has these instructions.
                unsafe { std::arch::x86_64::$max(a, b) }
            }
            #[inline(always)]
            unsafe fn load(self, at: *const i16) -> Self::V {
                // SAFETY: `self` is created only if the CPU has these instructions, and the caller guarantees
                // that `N` values from `at` are readable; the load needs no alignment.
                unsafe { std::arch::x86_64::$load(at.cast()) }
            }
            #[inline(always)]
            fn fetch(self, at: *const i16) {
                // SAFETY: a prefetch is a hint, which cannot fail for any address. Benchmark: `carina bench isoregion`,
                // the projections.
                unsafe {
                    std::arch::x86_64::_mm_prefetch::<{ std::arch::x86_64::_MM_HINT_T0 }>(at.cast())
                }
            }
            #[inline(always)]
            unsafe fn store(self, at: *mut i16, v: Self::V) {
                // SAFETY: `self` is created only if the CPU has these instructions, and the caller guarantees
                // that `N` values from `at` are writable; the store needs no alignment.
                unsafe { std::arch::x86_64::$store(at.cast(), v) }
            }
        }
    };
}
#[cfg(target_arch = "x86_64")]
registers!(
    Sse2,
    "SSE2, which every `x86_64` has.",
    __m128i,
    8,
    false,
    _mm_set1_epi16,
    _mm_max_epi16,
    _mm_loadu_si128,
    _mm_storeu_si128
);
#[cfg(target_arch = "x86_64")]
registers!(
    Avx2,
    "The machine has AVX2.",
    __m256i,
    16,
    false,
    _mm256_set1_epi16,
    _mm256_max_epi16,
    _mm256_loadu_si256,
    _mm256_storeu_si256
);
#[cfg(target_arch = "x86_64")]
registers!(
    Avx512,
    "The machine has AVX-512 F and BW.",
    __m512i,
    32,
    true,
    _mm512_set1_epi16,
    _mm512_max_epi16,
    _mm512_loadu_si512,
    _mm512_storeu_si512
);

impl Slab<'_> {
    fn project(self, simd: InstructionSet) {
        #[cfg(target_arch = "x86_64")]
        {
            #[target_feature(enable = "avx512f,avx512bw,avx2")]
            fn avx512(slab: Slab<'_>) {
                slab.run(Avx512(()));
            }
            #[target_feature(enable = "avx2")]
            fn avx2(slab: Slab<'_>) {
                slab.run(Avx2(()));
            }
            match simd {
                // SAFETY: an `InstructionSet` value exists only on a machine that has the instructions of that set.
                // Benchmark: `carina bench isoregion`.
                InstructionSet::Avx512 => unsafe { avx512(self) },
                // SAFETY: an `InstructionSet` value exists only on a machine that has the instructions of that set.
                InstructionSet::Avx2 => unsafe { avx2(self) },
                _ => self.run(Sse2(())),
            }
        }
        #[cfg(not(target_arch = "x86_64"))]
        {
            let _ = simd;
            self.run(One);
        }
    }

    /// Project the slices of the slab, four at a time.
    ///
    /// The image along k is in a slower cache than the rows, and is read once for all four slices.
    #[inline(always)]
    fn run<V: Values>(self, v: V) {
        /// Number of slices that are projected together, so that the image along k is read once for all of them.
        const AT_ONCE: usize = 4;
        let [nj, ni] = self.shape_ji;
        let num_slices = self.along_i.len() / nj;
        let mut k = 0;
        while k < num_slices {
            let count = AT_ONCE.min(num_slices - k);
            let data = &self.data[k * nj * ni..][..count * nj * ni];
            let along_i = &mut self.along_i[k * nj..][..count * nj];
            let along_j = &mut self.along_j[k * ni..][..count * ni];
            if count == AT_ONCE {
                project_slices::<V, AT_ONCE>(v, data, [nj, ni], along_i, along_j, self.along_k);
            } else {
                for n in 0..count {
                    project_slices::<V, 1>(
                        v,
                        &data[n * nj * ni..][..nj * ni],
                        [nj, ni],
                        &mut along_i[n * nj..][..nj],
                        &mut along_j[n * ni..][..ni],
                        self.along_k,
                    );
                }
            }
            k += count;
        }
    }
}

/// Distance in values (int16) by which a prefetch precedes the read: 2 KiB.
const AHEAD: usize = 1024;

/// Project `S` slices into their rows of the images along i and j, and into the image along k.
#[inline(always)]
fn project_slices<V: Values, const S: usize>(
    v: V,
    data: &[i16],
    [nj, ni]: [usize; 2],
    along_i: &mut [i16],
    along_j: &mut [i16],
    along_k: &mut [i16],
) {
    assert!(data.len() >= S * nj * ni && along_j.len() >= S * ni && along_k.len() >= nj * ni);
    let mut rows = Rows {
        data,
        shape_ji: [nj, ni],
        along_i,
        along_j,
        along_k,
    };
    // Two rows are processed at a time, so that the image along j is written once for both.
    let in_pairs = if V::PREFETCHES { nj - nj % 2 } else { 0 };
    for j in (0..in_pairs).step_by(2) {
        rows.project::<V, S, 2>(v, j);
    }
    for j in in_pairs..nj {
        rows.project::<V, S, 1>(v, j);
    }
}

/// Adjacent slices of the volume, and the rows of the three images that belong to them.
struct Rows<'a> {
    data: &'a [i16],
    shape_ji: [usize; 2],
    along_i: &'a mut [i16],
    along_j: &'a mut [i16],
    along_k: &'a mut [i16],
}

impl Rows<'_> {
    /// Project rows `j .. j + R` of `S` slices into the three images.
    #[inline(always)]
    fn project<V: Values, const S: usize, const R: usize>(&mut self, v: V, j: usize) {
        let [nj, ni] = self.shape_ji;
        let mut most = [[v.least(); S]; R];
        let mut i = 0;
        // SAFETY: i + N <= ni and j + R <= nj, and `project_slices` asserts the lengths of the rows, so all loads and
        // stores are inside them. Benchmark: `carina bench isoregion`.
        unsafe {
            while i + V::N <= ni {
                let mut down = [v.least(); S];
                for r in 0..R {
                    let across = self.along_k.as_mut_ptr().add((j + r) * ni + i);
                    let mut all = v.load(across);
                    for s in 0..S {
                        let at = self.data.as_ptr().add((s * nj + j + r) * ni + i);
                        let values = v.load(at);
                        if V::PREFETCHES {
                            v.fetch(at.wrapping_add(AHEAD));
                        }
                        most[r][s] = v.max(most[r][s], values);
                        all = v.max(all, values);
                        down[s] = if r == 0 {
                            values
                        } else {
                            v.max(down[s], values)
                        };
                    }
                    v.store(across, all);
                }
                for s in 0..S {
                    let at = self.along_j.as_mut_ptr().add(s * ni + i);
                    v.store(at, v.max(v.load(at), down[s]));
                }
                i += V::N;
            }
        }
        for r in 0..R {
            for s in 0..S {
                let mut lanes = [i16::MIN; 32];
                // SAFETY: `lanes` has 32 values and no register holds more.
                unsafe { v.store(lanes.as_mut_ptr(), most[r][s]) };
                let row = &self.data[(s * nj + j + r) * ni..][..ni];
                let mut value = i16::MIN;
                for lane in lanes {
                    value = value.max(lane);
                }
                for n in i..ni {
                    value = value.max(row[n]);
                    let across = &mut self.along_k[(j + r) * ni + n];
                    *across = (*across).max(row[n]);
                    self.along_j[s * ni + n] = self.along_j[s * ni + n].max(row[n]);
                }
                self.along_i[s * nj + j + r] = value;
            }
        }
    }
}

fn raise(to: &mut [i16], by: &[i16]) {
    for (a, &b) in to.iter_mut().zip(by) {
        *a = (*a).max(b);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use carina_grid::{Affine, Grid};

    // SSE2, which every x86-64 processor has, with prefetching, so that each machine can test the prefetching code.
    #[cfg(target_arch = "x86_64")]
    registers!(
        Prefetching,
        "SSE2, asking ahead.",
        __m128i,
        8,
        true,
        _mm_set1_epi16,
        _mm_max_epi16,
        _mm_loadu_si128,
        _mm_storeu_si128
    );

    #[cfg(target_arch = "x86_64")]
    #[test]
    fn prefetches_do_not_change_projections() {
        for shape in [[4, 2, 32], [9, 3, 71], [6, 5, 64]] {
            let grid = Grid::new(shape, Affine::IDENTITY).unwrap();
            let [nk, nj, ni] = shape;
            let data: Vec<i16> = (0..nk * nj * ni)
                .map(|n| (n.wrapping_mul(2_654_435_761) >> 7) as i16)
                .collect();
            let expected = maximum_projections(VolumeView::new(&data, &grid).unwrap());
            let [mut along_i, mut along_j, mut along_k] =
                [nk * nj, nk * ni, nj * ni].map(|count| vec![i16::MIN; count]);
            let slab = Slab {
                data: &data,
                shape_ji: [nj, ni],
                along_i: &mut along_i,
                along_j: &mut along_j,
                along_k: &mut along_k,
            };
            slab.run(Prefetching(()));
            let found = Projections {
                along_i,
                along_j,
                along_k,
            };
            assert!(found == expected);
        }
    }

    #[test]
    fn each_projection_is_the_largest_value_along_its_axis() {
        // The shapes have rows shorter than a register, rows of several registers, and rows with a remainder; the
        // slices are in groups of four, and with a remainder.
        for shape in [[3, 4, 5], [4, 2, 32], [9, 3, 71], [1, 1, 1], [6, 5, 64]] {
            let grid = Grid::new(shape, Affine::IDENTITY).unwrap();
            let [nk, nj, ni] = shape;
            let data: Vec<i16> = (0..nk * nj * ni)
                .map(|n| (n.wrapping_mul(2_654_435_761) >> 7) as i16)
                .collect();
            let volume = VolumeView::new(&data, &grid).unwrap();
            let most = |f: &dyn Fn(usize) -> [usize; 3], n: usize| {
                (0..n).map(|m| volume.at(f(m))).max().unwrap()
            };
            for simd in InstructionSet::available() {
                let found = maximum_projections_by(volume, simd);
                for k in 0..nk {
                    for j in 0..nj {
                        assert_eq!(found.along_i[k * nj + j], most(&|i| [i, j, k], ni));
                    }
                    for i in 0..ni {
                        assert_eq!(found.along_j[k * ni + i], most(&|j| [i, j, k], nj));
                    }
                }
                for j in 0..nj {
                    for i in 0..ni {
                        assert_eq!(found.along_k[j * ni + i], most(&|k| [i, j, k], nk));
                    }
                }
            }
        }
    }
}
