//! Interface of the instruction sets: the operations that a packet kernel needs.
//!
//! The operations work on numbers, masks and loads for as many rays as fit a register.

use std::sync::atomic::AtomicI32;

/// Maximum number of lanes (rays) of a packet in any instruction set.
pub(super) const MAX_LANES: usize = 32;

/// Array with one value for each lane.
pub(crate) type Array<T> = [T; MAX_LANES];

/// Instruction set in which packets of rays are cast.
///
/// A value of the implementing type proves that the machine has the instruction set. Every operation is the IEEE or
/// integer operation of the scalar kernel; there are no approximations. `min(a, b)` is `if a < b { a } else { b }`,
/// `max(a, b)` is `if a > b { a } else { b }`.
pub(crate) trait Lanes: Copy {
    /// Number of lanes of a register, each with one ray.
    const N: usize;
    /// Register with one f32 for each lane.
    type F: Copy;
    /// Register with one i32 for each lane.
    type I: Copy;
    /// Mask with one boolean for each lane.
    type M: Copy;

    fn splat(self, v: f32) -> Self::F;
    fn splat_i(self, v: i32) -> Self::I;
    fn store(self, v: Self::F) -> Array<f32>;
    fn store_i(self, v: Self::I) -> Array<i32>;
    fn load_i(self, values: &Array<i32>) -> Self::I;
    /// Return `old` with its lanes in the mask replaced, in order, by consecutive items of `values`.
    ///
    /// There must be at least as many values as lanes.
    fn fill(self, old: Self::F, mask: u32, values: &[f32]) -> Self::F;
    /// Return `old` with its lanes in the mask replaced, in order, by consecutive integers of `values`.
    ///
    /// There must be at least as many values as lanes.
    fn fill_i(self, old: Self::I, mask: u32, values: &[i32]) -> Self::I;

    /// Write the numbers in the lanes of the mask consecutively to `out`.
    ///
    /// The following items of `out`, up to the number of lanes, become undefined.
    fn put(self, v: Self::F, mask: u32, out: &mut [f32]);
    /// Write the integers in the lanes of the mask consecutively to `out`.
    ///
    /// The following items of `out`, up to the number of lanes, become undefined.
    fn put_i(self, v: Self::I, mask: u32, out: &mut [i32]);

    fn add(self, a: Self::F, b: Self::F) -> Self::F;
    fn sub(self, a: Self::F, b: Self::F) -> Self::F;
    fn mul(self, a: Self::F, b: Self::F) -> Self::F;
    fn div(self, a: Self::F, b: Self::F) -> Self::F;
    /// Return `a b + c`, rounded once.
    fn fma(self, a: Self::F, b: Self::F, c: Self::F) -> Self::F;
    fn min(self, a: Self::F, b: Self::F) -> Self::F;
    fn max(self, a: Self::F, b: Self::F) -> Self::F;
    fn abs(self, a: Self::F) -> Self::F;
    fn sqrt(self, a: Self::F) -> Self::F;
    fn floor(self, a: Self::F) -> Self::F;
    fn less(self, a: Self::F, b: Self::F) -> Self::M;
    /// Return `yes` in the lanes of the mask and `no` in the other lanes.
    fn select(self, mask: Self::M, yes: Self::F, no: Self::F) -> Self::F;

    fn add_i(self, a: Self::I, b: Self::I) -> Self::I;
    fn sub_i(self, a: Self::I, b: Self::I) -> Self::I;
    fn mul_i(self, a: Self::I, b: Self::I) -> Self::I;
    fn min_i(self, a: Self::I, b: Self::I) -> Self::I;
    fn max_i(self, a: Self::I, b: Self::I) -> Self::I;
    fn less_i(self, a: Self::I, b: Self::I) -> Self::M;
    fn select_i(self, mask: Self::M, yes: Self::I, no: Self::I) -> Self::I;

    /// Return the integer part of a number, which must be within the range of an i32.
    fn whole(self, a: Self::F) -> Self::I;
    fn to_f(self, a: Self::I) -> Self::F;

    fn mask(self, bits: u32) -> Self::M;
    fn bits(self, a: Self::M) -> u32;
    fn and(self, a: Self::M, b: Self::M) -> Self::M;
    fn or(self, a: Self::M, b: Self::M) -> Self::M;
    /// Return the mask of the lanes that are in `a` and not in `b`.
    fn without(self, a: Self::M, b: Self::M) -> Self::M;

    /// Return the integer quotient of a number by 4; the number must not be negative.
    fn quarters(self, a: Self::I) -> Self::I;
    /// Return the remainder of a number divided by 4; the number must not be negative.
    fn modulo_4(self, a: Self::I) -> Self::I;

    /// Return the lowest byte of each lane's i32, 0 to 255.
    fn low_byte(self, a: Self::I) -> Self::I;
    /// Return the second lowest byte of each lane's i32, 0 to 255.
    fn second_byte(self, a: Self::I) -> Self::I;

    /// Return the first of the two int16 in each lane, as an i32.
    fn first(self, pair: Self::I) -> Self::I;
    /// Return the second of the two int16 in each lane, as an i32.
    fn second(self, pair: Self::I) -> Self::I;
    /// Return the second int16 in each lane minus the first, as an i32.
    fn rise(self, pair: Self::I) -> Self::I;

    /// Load, for each offset, voxel `base + offset` into the low half and the next voxel along x into the high half.
    ///
    /// # Safety
    ///
    /// In every lane and for every offset both voxels must be in the data.
    unsafe fn pairs<const R: usize>(
        self,
        data: *const i16,
        base: Self::I,
        offsets: [i32; R],
    ) -> [Self::I; R];
    /// Load, for each offset, voxel `base + offset` and the next three voxels along x, as two pairs.
    ///
    /// # Safety
    ///
    /// In every lane and for every offset all four voxels must be in the data.
    unsafe fn quads<const R: usize>(
        self,
        data: *const i16,
        base: Self::I,
        offsets: [i32; R],
    ) -> [[Self::I; 2]; R];
    /// Load, for each offset, four int16 at `base + offset` and the next four, interleaved as four pairs.
    ///
    /// The first pair has the first numbers of both groups, the second pair the second numbers, and so on.
    ///
    /// # Safety
    ///
    /// In every lane and for every offset all eight numbers must be in the data.
    unsafe fn quadruples<const R: usize>(
        self,
        data: *const i16,
        base: Self::I,
        offsets: [i32; R],
    ) -> [[Self::I; 4]; R];
    /// Load the table's entries at `index` atomically.
    ///
    /// The load has acquire ordering, so memory that was written before the store of an entry is visible.
    ///
    /// # Safety
    ///
    /// In every lane `index` must be in the table.
    unsafe fn links(self, table: *const AtomicI32, index: Self::I) -> Self::I;
    /// Load for each lane the voxel at `index`.
    ///
    /// # Safety
    ///
    /// In every lane `index` must be in the data.
    unsafe fn voxels(self, data: *const i16, index: Self::I) -> Self::I;
    /// Load for each lane the byte at `index`, 0 to 255.
    ///
    /// # Safety
    ///
    /// In every lane `index` must be in the data.
    unsafe fn bytes(self, data: *const u8, index: Self::I) -> Self::I;
    /// Load the four numbers at `index`, as one register for each of the four.
    ///
    /// # Safety
    ///
    /// In every lane the entry must be in the table.
    unsafe fn entries(self, table: *const [f32; 4], index: Self::I) -> [Self::F; 4];
}

/// Call `take` with the number of each lane whose bit is set in `lanes`.
#[inline(always)]
pub(super) fn each_lane(mut lanes: u32, mut take: impl FnMut(usize)) {
    while lanes != 0 {
        take(lanes.trailing_zeros() as usize % MAX_LANES);
        lanes &= lanes - 1;
    }
}
