//! What a kernel may ask of an instruction set.

/// An instruction set. A value of the type is the proof that the machine has it.
///
/// A register holds `N` voxels beside each other along x. All numbers are distances; 255 stands for 255 and more.
pub(crate) trait Bytes: Copy {
    /// Voxels in a register; divides 64.
    const N: usize;
    /// A register.
    type V: Copy;

    fn splat(self, v: u8) -> Self::V;
    fn min(self, a: Self::V, b: Self::V) -> Self::V;
    /// Saturates at 255.
    fn add(self, a: Self::V, b: Self::V) -> Self::V;
    fn is_zero(self, v: Self::V) -> bool;
    fn same(self, a: Self::V, b: Self::V) -> bool;
    /// For each voxel the one before it; `before` holds those before the first.
    fn previous(self, before: Self::V, v: Self::V) -> Self::V;
    /// For each voxel the one after it; `after` holds those after the last.
    fn next(self, v: Self::V, after: Self::V) -> Self::V;
    /// 255 where the bit is set, else 0.
    fn expand(self, bits: u64) -> Self::V;
    /// For each voxel the least of all in the register, each with its distance added.
    fn spread(self, v: Self::V) -> Self::V;
    /// `1, 2 ..= N`.
    fn rising(self) -> Self::V;
    /// `N ..= 2, 1`.
    fn falling(self) -> Self::V;

    /// # Safety
    /// `N` bytes from `at` must be readable.
    unsafe fn load(self, at: *const u8) -> Self::V;
    /// # Safety
    /// `N` bytes from `at` must be writable.
    unsafe fn store(self, at: *mut u8, v: Self::V);
    /// Bit n is set where bytes n are equal.
    ///
    /// # Safety
    /// 64 bytes from `a` and from `b` must be readable.
    unsafe fn equal64(self, a: *const u8, b: *const u8) -> u64;
    /// Bit n is set where value n lies in `lo ..= lo + width`.
    ///
    /// # Safety
    /// 64 values from `at` must be readable.
    unsafe fn within64(self, at: *const i16, lo: i16, width: u16) -> u64;
}
