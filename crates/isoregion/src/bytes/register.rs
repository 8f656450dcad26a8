//! Interface of an instruction set for the map's kernels.

/// Instruction set.
///
/// A value of the implementing type proves that the machine has the set.
///
/// A register holds `N` voxels that are neighbours along x. All numbers are distances; 255 means 255 or more.
pub(crate) trait Bytes: Copy {
    /// Number of voxels in a register; divides 64.
    const N: usize;
    /// Register of `N` bytes.
    type V: Copy;

    fn splat(self, v: u8) -> Self::V;
    fn min(self, a: Self::V, b: Self::V) -> Self::V;
    /// Add; the result saturates at 255.
    fn add(self, a: Self::V, b: Self::V) -> Self::V;
    fn is_zero(self, v: Self::V) -> bool;
    fn same(self, a: Self::V, b: Self::V) -> bool;
    /// Return for each voxel the previous one; `before` contains the voxels before the first.
    fn previous(self, before: Self::V, v: Self::V) -> Self::V;
    /// Return for each voxel the next one; `after` contains the voxels after the last.
    fn next(self, v: Self::V, after: Self::V) -> Self::V;
    /// Return 255 where the bit is set, else 0.
    fn expand(self, bits: u64) -> Self::V;
    /// Return for each voxel the least sum of any voxel's value in the register and its distance.
    fn spread(self, v: Self::V) -> Self::V;
    /// Return `1, 2 ..= N`.
    fn rising(self) -> Self::V;
    /// Return `N ..= 2, 1`.
    fn falling(self) -> Self::V;

    /// Load `N` bytes.
    ///
    /// # Safety
    ///
    /// `N` bytes from `at` must be readable.
    unsafe fn load(self, at: *const u8) -> Self::V;
    /// Store `N` bytes.
    ///
    /// # Safety
    ///
    /// `N` bytes from `at` must be writable.
    unsafe fn store(self, at: *mut u8, v: Self::V);
    /// Return a mask whose bit n is set if the bytes n are equal.
    ///
    /// # Safety
    ///
    /// 64 bytes from `a` and from `b` must be readable.
    unsafe fn equal64(self, a: *const u8, b: *const u8) -> u64;
    /// Return a mask whose bit n is set if value n is in `lo ..= lo + width`.
    ///
    /// # Safety
    ///
    /// 64 values from `at` must be readable.
    unsafe fn within64(self, at: *const i16, lo: i16, width: u16) -> u64;
}
