//! Pairs of registers used as one register: twice as many rays per branch, and operations that the processor can run in
//! parallel.

use std::sync::atomic::AtomicI32;

use super::lanes::{Array, Lanes, MAX_LANES};

/// Instruction set whose registers are two registers of the instruction set `L`.
#[derive(Clone, Copy)]
pub(super) struct Pair<L>(pub L);

/// Macro that defines operations on a pair by the same operation on each of its two registers.
macro_rules! in_both {
    ($(fn $name:ident($($arg:ident: $kind:ident),*) -> $out:ident;)*) => {$(
        #[inline(always)]
        fn $name(self, $($arg: [L::$kind; 2]),*) -> [L::$out; 2] {
            [self.0.$name($($arg[0]),*), self.0.$name($($arg[1]),*)]
        }
    )*};
}

#[inline(always)]
fn join<T: Copy>(mut low: Array<T>, high: &Array<T>, at: usize) -> Array<T> {
    low[at..2 * at].copy_from_slice(&high[..at]);
    low
}

impl<L: Lanes> Pair<L> {
    /// Return the parts of a lane mask for the first and the second register, and the number of lanes that the first
    /// part selects.
    #[inline(always)]
    fn parts(mask: u32) -> (u32, u32, usize) {
        let (low, high) = (mask & (u32::MAX >> (32 - L::N)), mask >> L::N);
        (low, high, low.count_ones() as usize)
    }
}

impl<L: Lanes> Lanes for Pair<L> {
    /// Number of lanes of a register, each with one ray.
    const N: usize = 2 * L::N;
    type F = [L::F; 2];
    type I = [L::I; 2];
    type M = [L::M; 2];

    #[inline(always)]
    fn splat(self, v: f32) -> Self::F {
        [self.0.splat(v); 2]
    }
    #[inline(always)]
    fn splat_i(self, v: i32) -> Self::I {
        [self.0.splat_i(v); 2]
    }
    #[inline(always)]
    fn store(self, v: Self::F) -> Array<f32> {
        join(self.0.store(v[0]), &self.0.store(v[1]), L::N)
    }
    #[inline(always)]
    fn store_i(self, v: Self::I) -> Array<i32> {
        join(self.0.store_i(v[0]), &self.0.store_i(v[1]), L::N)
    }
    #[inline(always)]
    fn load_i(self, values: &Array<i32>) -> Self::I {
        let mut high = [0; MAX_LANES];
        high[..L::N].copy_from_slice(&values[L::N..2 * L::N]);
        [self.0.load_i(values), self.0.load_i(&high)]
    }
    #[inline(always)]
    fn fill(self, old: Self::F, mask: u32, values: &[f32]) -> Self::F {
        let (low, high, turn) = Self::parts(mask);
        [
            self.0.fill(old[0], low, values),
            self.0.fill(old[1], high, &values[turn..]),
        ]
    }
    #[inline(always)]
    fn fill_i(self, old: Self::I, mask: u32, values: &[i32]) -> Self::I {
        let (low, high, turn) = Self::parts(mask);
        [
            self.0.fill_i(old[0], low, values),
            self.0.fill_i(old[1], high, &values[turn..]),
        ]
    }
    #[inline(always)]
    fn put(self, v: Self::F, mask: u32, out: &mut [f32]) {
        let (low, high, turn) = Self::parts(mask);
        self.0.put(v[0], low, out);
        self.0.put(v[1], high, &mut out[turn..]);
    }
    #[inline(always)]
    fn put_i(self, v: Self::I, mask: u32, out: &mut [i32]) {
        let (low, high, turn) = Self::parts(mask);
        self.0.put_i(v[0], low, out);
        self.0.put_i(v[1], high, &mut out[turn..]);
    }

    in_both! {
        fn add(a: F, b: F) -> F;
        fn sub(a: F, b: F) -> F;
        fn mul(a: F, b: F) -> F;
        fn div(a: F, b: F) -> F;
        fn fma(a: F, b: F, c: F) -> F;
        fn min(a: F, b: F) -> F;
        fn max(a: F, b: F) -> F;
        fn abs(a: F) -> F;
        fn sqrt(a: F) -> F;
        fn floor(a: F) -> F;
        fn less(a: F, b: F) -> M;
        fn select(mask: M, yes: F, no: F) -> F;
        fn add_i(a: I, b: I) -> I;
        fn sub_i(a: I, b: I) -> I;
        fn mul_i(a: I, b: I) -> I;
        fn min_i(a: I, b: I) -> I;
        fn max_i(a: I, b: I) -> I;
        fn less_i(a: I, b: I) -> M;
        fn select_i(mask: M, yes: I, no: I) -> I;
        fn whole(a: F) -> I;
        fn to_f(a: I) -> F;
        fn and(a: M, b: M) -> M;
        fn or(a: M, b: M) -> M;
        fn without(a: M, b: M) -> M;
        fn quarters(a: I) -> I;
        fn modulo_4(a: I) -> I;
        fn low_byte(a: I) -> I;
        fn second_byte(a: I) -> I;
        fn first(pair: I) -> I;
        fn second(pair: I) -> I;
        fn rise(pair: I) -> I;
    }

    #[inline(always)]
    fn mask(self, bits: u32) -> Self::M {
        let (low, high, _) = Self::parts(bits);
        [self.0.mask(low), self.0.mask(high)]
    }
    #[inline(always)]
    fn bits(self, a: Self::M) -> u32 {
        self.0.bits(a[0]) | self.0.bits(a[1]) << L::N
    }

    #[inline(always)]
    unsafe fn pairs<const R: usize>(
        self,
        data: *const i16,
        base: Self::I,
        offsets: [i32; R],
    ) -> [Self::I; R] {
        // SAFETY: the caller guarantees for all lanes, and so for each half, that the voxels are in the data.
        let (low, high) = unsafe {
            (
                self.0.pairs(data, base[0], offsets),
                self.0.pairs(data, base[1], offsets),
            )
        };
        let mut out = [base; R];
        for n in 0..R {
            out[n] = [low[n], high[n]];
        }
        out
    }

    #[inline(always)]
    unsafe fn quads<const R: usize>(
        self,
        data: *const i16,
        base: Self::I,
        offsets: [i32; R],
    ) -> [[Self::I; 2]; R] {
        // SAFETY: the caller guarantees for all lanes, and so for each half, that the voxels are in the data.
        let (low, high) = unsafe {
            (
                self.0.quads(data, base[0], offsets),
                self.0.quads(data, base[1], offsets),
            )
        };
        let mut out = [[base; 2]; R];
        for n in 0..R {
            out[n] = [[low[n][0], high[n][0]], [low[n][1], high[n][1]]];
        }
        out
    }

    #[inline(always)]
    unsafe fn quadruples<const R: usize>(
        self,
        data: *const i16,
        base: Self::I,
        offsets: [i32; R],
    ) -> [[Self::I; 4]; R] {
        // SAFETY: the caller guarantees for every lane that the eight numbers of each offset are in the data; each half contains a part of the
        // lanes.
        let (low, high) = unsafe {
            (
                self.0.quadruples(data, base[0], offsets),
                self.0.quadruples(data, base[1], offsets),
            )
        };
        let mut out = [[base; 4]; R];
        for n in 0..R {
            for c in 0..4 {
                out[n][c] = [low[n][c], high[n][c]];
            }
        }
        out
    }

    #[inline(always)]
    unsafe fn links(self, table: *const AtomicI32, index: Self::I) -> Self::I {
        // SAFETY: the caller guarantees for all lanes, and so for each half, that the indices are in the table.
        unsafe { [self.0.links(table, index[0]), self.0.links(table, index[1])] }
    }

    #[inline(always)]
    unsafe fn voxels(self, data: *const i16, index: Self::I) -> Self::I {
        // SAFETY: the caller guarantees for all lanes, and so for each half, that the voxels are in the data.
        unsafe { [self.0.voxels(data, index[0]), self.0.voxels(data, index[1])] }
    }

    #[inline(always)]
    unsafe fn bytes(self, data: *const u8, index: Self::I) -> Self::I {
        // SAFETY: the caller guarantees for all lanes, and so for each half, that the bytes are in the data.
        unsafe { [self.0.bytes(data, index[0]), self.0.bytes(data, index[1])] }
    }

    #[inline(always)]
    unsafe fn entries(self, table: *const [f32; 4], index: Self::I) -> [Self::F; 4] {
        // SAFETY: the caller guarantees for all lanes, and so for each half, that the entries are in the table.
        let (low, high) = unsafe {
            (
                self.0.entries(table, index[0]),
                self.0.entries(table, index[1]),
            )
        };
        let mut out = [[low[0], high[0]]; 4];
        for n in 0..4 {
            out[n] = [low[n], high[n]];
        }
        out
    }
}
