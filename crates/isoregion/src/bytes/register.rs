//! Interface of the vector operations with which radius maps are computed.

/// Vector operations of one instruction set, with which radius maps are computed.
///
/// A value of the implementing type proves that the machine has the instruction set. A register has `N` voxels that are
/// neighbours along x, one byte each. The bytes are distances; 255 means 255 or more.
pub(crate) trait Bytes: Copy {
    /// Number of voxels in a register, a divisor of 64.
    const N: usize;
    /// Register of `N` bytes.
    type V: Copy;

    fn splat(self, v: u8) -> Self::V;
    fn min(self, a: Self::V, b: Self::V) -> Self::V;
    /// Return the sum of two registers; each byte saturates at 255.
    fn add(self, a: Self::V, b: Self::V) -> Self::V;
    fn is_zero(self, v: Self::V) -> bool;
    fn same(self, a: Self::V, b: Self::V) -> bool;
    /// Return for each voxel the byte of the voxel before it; the first byte is the last one of register `before`.
    fn previous(self, before: Self::V, v: Self::V) -> Self::V;
    /// Return for each voxel the byte of the voxel after it; the last byte is the first one of register `after`.
    fn next(self, v: Self::V, after: Self::V) -> Self::V;
    /// Return for each voxel 255 if its bit is set, otherwise 0.
    fn expand(self, bits: u64) -> Self::V;
    /// Return for each voxel the minimum, over all voxels of the register, of a voxel's byte plus its distance in
    /// voxels.
    fn spread(self, v: Self::V) -> Self::V;
    /// Return a register with the bytes `1, 2 ..= N`.
    fn rising(self) -> Self::V;
    /// Return a register with the bytes `N ..= 2, 1`.
    fn falling(self) -> Self::V;

    /// Load a register of `N` bytes.
    ///
    /// # Safety
    ///
    /// `N` bytes from `at` must be readable.
    unsafe fn load(self, at: *const u8) -> Self::V;
    /// Store the `N` bytes of a register.
    ///
    /// # Safety
    ///
    /// `N` bytes from `at` must be writable.
    unsafe fn store(self, at: *mut u8, v: Self::V);
    /// Return a mask whose bit n is set if the bytes n of `a` and `b` are equal.
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
