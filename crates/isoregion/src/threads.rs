//! Number of threads that build a map or label a volume.

/// Return the default number of threads that build a map: as many as the pool has.
///
/// The threads are separate from the pool (see `join` in [`crate::map`]).
pub(crate) fn num_threads() -> usize {
    rayon::current_num_threads()
}
