//! Eight lanes in plain arrays: loops that the compiler translates to the vector instructions of the target.
//!
//! This set is the packet kernel for NEON. On every machine, tests compare its results with the scalar casters.

use std::{
    array::from_fn,
    sync::atomic::{AtomicI32, Ordering},
};

use super::lanes::{Array, Lanes, MAX_LANES};

/// Number of lanes of a register, each with one ray.
const N: usize = 8;

/// Instruction set of plain loops, which needs only the instructions of the compiler's target.
#[derive(Clone, Copy)]
pub(crate) struct Portable;

/// Macro that defines operations as a loop over the lanes.
macro_rules! lane_by_lane {
    ($(fn $name:ident($($arg:ident: $type:ty),*) -> $out:ty { $body:expr })*) => {$(
        #[inline(always)]
        fn $name(self, $($arg: [$type; N]),*) -> [$out; N] {
            from_fn(
                #[inline(always)]
                |n| {
                    $(let $arg = $arg[n];)*
                    $body
                },
            )
        }
    )*};
}

#[inline(always)]
fn store<T: Copy + Default>(v: [T; N]) -> Array<T> {
    let mut out = [T::default(); MAX_LANES];
    out[..N].copy_from_slice(&v);
    out
}

#[inline(always)]
fn fill<T: Copy>(mut lanes: [T; N], mask: u32, values: &[T]) -> [T; N] {
    let values = &values[..N];
    let mut turn = 0;
    for n in 0..N {
        let taken = mask >> n & 1 == 1;
        lanes[n] = if taken { values[turn] } else { lanes[n] };
        turn += usize::from(taken);
    }
    lanes
}

#[inline(always)]
fn put<T: Copy>(v: [T; N], mask: u32, out: &mut [T]) {
    let out = &mut out[..N];
    let mut turn = 0;
    for n in 0..N {
        // If the register is full, all of its lanes have already been moved, so overwriting them changes nothing.
        out[turn % N] = v[n];
        turn += (mask >> n & 1) as usize;
    }
}

/// Return the lower and the upper half of an i32 that contains a pair of int16.
#[inline(always)]
const fn halves(pair: i32) -> (i32, i32) {
    (pair << 16 >> 16, pair >> 16)
}

impl Lanes for Portable {
    const N: usize = N;
    type F = [f32; N];
    type I = [i32; N];
    /// Mask of the lanes: an i32 for each lane, with all bits set or none.
    type M = [i32; N];

    #[inline(always)]
    fn splat(self, v: f32) -> [f32; N] {
        [v; N]
    }
    #[inline(always)]
    fn splat_i(self, v: i32) -> [i32; N] {
        [v; N]
    }
    #[inline(always)]
    fn store(self, v: [f32; N]) -> Array<f32> {
        store(v)
    }
    #[inline(always)]
    fn store_i(self, v: [i32; N]) -> Array<i32> {
        store(v)
    }
    #[inline(always)]
    fn load_i(self, values: &Array<i32>) -> [i32; N] {
        from_fn(|n| values[n])
    }
    #[inline(always)]
    fn fill(self, old: [f32; N], mask: u32, values: &[f32]) -> [f32; N] {
        fill(old, mask, values)
    }
    #[inline(always)]
    fn fill_i(self, old: [i32; N], mask: u32, values: &[i32]) -> [i32; N] {
        fill(old, mask, values)
    }
    #[inline(always)]
    fn put(self, v: [f32; N], mask: u32, out: &mut [f32]) {
        put(v, mask, out);
    }
    #[inline(always)]
    fn put_i(self, v: [i32; N], mask: u32, out: &mut [i32]) {
        put(v, mask, out);
    }

    lane_by_lane! {
        fn add(a: f32, b: f32) -> f32 { a + b }
        fn sub(a: f32, b: f32) -> f32 { a - b }
        fn mul(a: f32, b: f32) -> f32 { a * b }
        fn div(a: f32, b: f32) -> f32 { a / b }
        fn fma(a: f32, b: f32, c: f32) -> f32 { a.mul_add(b, c) }
        fn min(a: f32, b: f32) -> f32 { if a < b { a } else { b } }
        fn max(a: f32, b: f32) -> f32 { if a > b { a } else { b } }
        fn abs(a: f32) -> f32 { a.abs() }
        fn sqrt(a: f32) -> f32 { a.sqrt() }
        fn floor(a: f32) -> f32 { a.floor() }
        fn less(a: f32, b: f32) -> i32 { -i32::from(a < b) }
        fn select(mask: i32, yes: f32, no: f32) -> f32 {
            f32::from_bits(yes.to_bits() & mask as u32 | no.to_bits() & !mask as u32)
        }

        fn add_i(a: i32, b: i32) -> i32 { a.wrapping_add(b) }
        fn sub_i(a: i32, b: i32) -> i32 { a.wrapping_sub(b) }
        fn mul_i(a: i32, b: i32) -> i32 { a.wrapping_mul(b) }
        fn min_i(a: i32, b: i32) -> i32 { if a < b { a } else { b } }
        fn max_i(a: i32, b: i32) -> i32 { if a > b { a } else { b } }
        fn less_i(a: i32, b: i32) -> i32 { -i32::from(a < b) }
        fn select_i(mask: i32, yes: i32, no: i32) -> i32 { yes & mask | no & !mask }

        // `as i32` saturates; other instruction sets return another number for such values, which no active ray has.
        fn whole(a: f32) -> i32 { a as i32 }
        fn to_f(a: i32) -> f32 { a as f32 }

        fn and(a: i32, b: i32) -> i32 { a & b }
        fn or(a: i32, b: i32) -> i32 { a | b }
        fn without(a: i32, b: i32) -> i32 { a & !b }

        fn quarters(a: i32) -> i32 { a >> 2 }
        fn modulo_4(a: i32) -> i32 { a & 3 }

        fn low_byte(a: i32) -> i32 { a & 0xff }
        fn second_byte(a: i32) -> i32 { a >> 8 & 0xff }

        fn first(pair: i32) -> i32 { halves(pair).0 }
        fn second(pair: i32) -> i32 { halves(pair).1 }
        fn rise(pair: i32) -> i32 { halves(pair).1 - halves(pair).0 }
    }

    #[inline(always)]
    fn mask(self, bits: u32) -> [i32; N] {
        from_fn(|n| -((bits >> n & 1) as i32))
    }
    #[inline(always)]
    fn bits(self, a: [i32; N]) -> u32 {
        (0..N).fold(0, |bits, n| bits | (a[n] as u32 & 1) << n)
    }

    #[inline(always)]
    unsafe fn pairs<const R: usize>(
        self,
        data: *const i16,
        base: [i32; N],
        offsets: [i32; R],
    ) -> [[i32; N]; R] {
        offsets.map(
            #[inline(always)]
            |offset| {
                from_fn(
                    #[inline(always)]
                    |n| {
                        // SAFETY: the caller guarantees that both voxels are in the data. Checked loads cost a fifth
                        // of the brute-force caster (`sampling.rs`).
                        let [a, b] = unsafe {
                            let at = data.offset(base[n] as isize + offset as isize);
                            at.cast::<[i16; 2]>().read_unaligned()
                        };
                        i32::from(b) << 16 | i32::from(a) & 0xffff
                    },
                )
            },
        )
    }

    #[inline(always)]
    unsafe fn quads<const R: usize>(
        self,
        data: *const i16,
        base: [i32; N],
        offsets: [i32; R],
    ) -> [[[i32; N]; 2]; R] {
        offsets.map(
            #[inline(always)]
            |offset| {
                // SAFETY: the caller guarantees that all four voxels are in the data. Checked loads cost a fifth of the
                // brute-force caster (`sampling.rs`).
                unsafe { self.pairs(data, base, [offset, offset + 2]) }
            },
        )
    }

    #[inline(always)]
    unsafe fn quadruples<const R: usize>(
        self,
        data: *const i16,
        base: [i32; N],
        offsets: [i32; R],
    ) -> [[[i32; N]; 4]; R] {
        offsets.map(
            #[inline(always)]
            |offset| {
                let mut out = [[0; N]; 4];
                for n in 0..N {
                    // SAFETY: the caller guarantees that all eight numbers are in the data. Checked loads cost a fifth
                    // of the brute-force caster (`sampling.rs`).
                    let numbers = unsafe {
                        let at = data.offset(base[n] as isize + offset as isize);
                        at.cast::<[i16; 8]>().read_unaligned()
                    };
                    for c in 0..4 {
                        out[c][n] =
                            i32::from(numbers[c + 4]) << 16 | i32::from(numbers[c]) & 0xffff;
                    }
                }
                out
            },
        )
    }

    #[inline(always)]
    unsafe fn links(self, table: *const AtomicI32, index: [i32; N]) -> [i32; N] {
        // SAFETY: the caller guarantees that the link is in the table. Checked loads are slower (`sampling.rs`).
        index.map(|index| unsafe { &*table.add(index as usize) }.load(Ordering::Acquire))
    }

    #[inline(always)]
    unsafe fn voxels(self, data: *const i16, index: [i32; N]) -> [i32; N] {
        // SAFETY: the caller guarantees that the voxel is in the data. Checked loads are slower (`sampling.rs`).
        index.map(|index| i32::from(unsafe { *data.add(index as usize) }))
    }

    #[inline(always)]
    unsafe fn bytes(self, data: *const u8, index: [i32; N]) -> [i32; N] {
        // SAFETY: the caller guarantees that the byte is in the data. Checked loads are slower (`sampling.rs`).
        index.map(|index| i32::from(unsafe { *data.add(index as usize) }))
    }

    #[inline(always)]
    unsafe fn entries(self, table: *const [f32; 4], index: [i32; N]) -> [[f32; N]; 4] {
        // SAFETY: the caller guarantees that the entry is in the table. Checked loads are slower (`sampling.rs`).
        let entries = index.map(|index| unsafe { *table.add(index as usize) });
        from_fn(|c| from_fn(|n| entries[n][c]))
    }
}
