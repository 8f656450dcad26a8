//! What a packet kernel needs of an instruction set: numbers, masks and gathers for as many rays as fit a register.

use std::sync::atomic::AtomicI32;

/// The most lanes of any instruction set.
pub(super) const MAX_LANES: usize = 32;

/// One value for each lane, in memory.
pub(crate) type Array<T> = [T; MAX_LANES];

/// An instruction set. A value of the type is the proof that the machine has it.
///
/// Every operation is the IEEE one, or the integer one, that the scalar kernel uses; there are no estimates.
/// `min(a, b)` is `if a < b { a } else { b }`, `max(a, b)` is `if a > b { a } else { b }`.
pub(crate) trait Lanes: Copy {
    /// Number of lanes.
    const N: usize;
    /// f32 for each lane.
    type F: Copy;
    /// i32 for each lane.
    type I: Copy;
    /// Yes or no for each lane.
    type M: Copy;

    fn splat(self, v: f32) -> Self::F;
    fn splat_i(self, v: i32) -> Self::I;
    fn store(self, v: Self::F) -> Array<f32>;
    fn store_i(self, v: Self::I) -> Array<i32>;
    fn load_i(self, values: &Array<i32>) -> Self::I;
    /// Lanes of the mask take the values in turn, the others stay. There must be at least as many values as lanes.
    fn fill(self, old: Self::F, mask: u32, values: &[f32]) -> Self::F;
    /// The same for integers.
    fn fill_i(self, old: Self::I, mask: u32, values: &[i32]) -> Self::I;

    /// Writes the lanes of the mask one after the other; what follows them, up to the number of lanes, may become
    /// anything.
    fn put(self, v: Self::F, mask: u32, out: &mut [f32]);
    /// The same for integers.
    fn put_i(self, v: Self::I, mask: u32, out: &mut [i32]);

    fn add(self, a: Self::F, b: Self::F) -> Self::F;
    fn sub(self, a: Self::F, b: Self::F) -> Self::F;
    fn mul(self, a: Self::F, b: Self::F) -> Self::F;
    fn div(self, a: Self::F, b: Self::F) -> Self::F;
    /// `a b + c`, rounded once.
    fn fma(self, a: Self::F, b: Self::F, c: Self::F) -> Self::F;
    fn min(self, a: Self::F, b: Self::F) -> Self::F;
    fn max(self, a: Self::F, b: Self::F) -> Self::F;
    fn abs(self, a: Self::F) -> Self::F;
    fn sqrt(self, a: Self::F) -> Self::F;
    fn floor(self, a: Self::F) -> Self::F;
    fn less(self, a: Self::F, b: Self::F) -> Self::M;
    /// `yes` in the lanes of the mask, else `no`.
    fn select(self, mask: Self::M, yes: Self::F, no: Self::F) -> Self::F;

    fn add_i(self, a: Self::I, b: Self::I) -> Self::I;
    fn sub_i(self, a: Self::I, b: Self::I) -> Self::I;
    fn mul_i(self, a: Self::I, b: Self::I) -> Self::I;
    fn min_i(self, a: Self::I, b: Self::I) -> Self::I;
    fn max_i(self, a: Self::I, b: Self::I) -> Self::I;
    fn less_i(self, a: Self::I, b: Self::I) -> Self::M;
    fn select_i(self, mask: Self::M, yes: Self::I, no: Self::I) -> Self::I;

    /// The whole part; the value must be within i32.
    fn whole(self, a: Self::F) -> Self::I;
    fn to_f(self, a: Self::I) -> Self::F;

    fn mask(self, bits: u32) -> Self::M;
    fn bits(self, a: Self::M) -> u32;
    fn and(self, a: Self::M, b: Self::M) -> Self::M;
    fn or(self, a: Self::M, b: Self::M) -> Self::M;
    /// `a` without `b`.
    fn without(self, a: Self::M, b: Self::M) -> Self::M;

    /// The quotient by 4 of a number that is not negative.
    fn quarters(self, a: Self::I) -> Self::I;
    /// Its rest.
    fn modulo_4(self, a: Self::I) -> Self::I;

    /// First of two int16 in each lane.
    fn first(self, pair: Self::I) -> Self::I;
    /// Second of two int16 in each lane.
    fn second(self, pair: Self::I) -> Self::I;
    /// Second less first.
    fn rise(self, pair: Self::I) -> Self::I;

    /// Voxels `base + offset` and the next ones along x, the first one in the low half, for each offset.
    ///
    /// # Safety
    /// In every lane and for every offset both must lie in the data.
    unsafe fn pairs<const R: usize>(
        self,
        data: *const i16,
        base: Self::I,
        offsets: [i32; R],
    ) -> [Self::I; R];
    /// Voxels `base + offset` and the next three along x, as two pairs, for each offset.
    ///
    /// # Safety
    /// In every lane and for every offset all four must lie in the data.
    unsafe fn quads<const R: usize>(
        self,
        data: *const i16,
        base: Self::I,
        offsets: [i32; R],
    ) -> [[Self::I; 2]; R];
    /// Four int16 at `base + offset` and the next four, as pairs: both first ones, both second ones and so on, for each
    /// offset.
    ///
    /// # Safety
    /// In every lane and for every offset all eight must lie in the data.
    unsafe fn quadruples<const R: usize>(
        self,
        data: *const i16,
        base: Self::I,
        offsets: [i32; R],
    ) -> [[Self::I; 4]; R];
    /// What the table tells at `index` at this moment; what was written before that was told is seen.
    ///
    /// # Safety
    /// In every lane it must lie in the table.
    unsafe fn links(self, table: *const AtomicI32, index: Self::I) -> Self::I;
    /// The voxel at `index`.
    ///
    /// # Safety
    /// In every lane it must lie in the data.
    unsafe fn voxels(self, data: *const i16, index: Self::I) -> Self::I;
    /// The byte at `index`, 0..255.
    ///
    /// # Safety
    /// In every lane it must lie in the data.
    unsafe fn bytes(self, data: *const u8, index: Self::I) -> Self::I;
    /// Four numbers at `index`, as one register for each of the four.
    ///
    /// # Safety
    /// In every lane the entry must lie in the table.
    unsafe fn entries(self, table: *const [f32; 4], index: Self::I) -> [Self::F; 4];
}

/// The numbers of the lanes in a mask.
#[inline(always)]
pub(super) fn each_lane(mut lanes: u32, mut take: impl FnMut(usize)) {
    while lanes != 0 {
        take(lanes.trailing_zeros() as usize % MAX_LANES);
        lanes &= lanes - 1;
    }
}
