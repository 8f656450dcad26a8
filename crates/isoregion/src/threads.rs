//! Number of threads that compute a radius map or label a volume.

/// Return the default number of threads for radius maps and labels: the size of the thread pool.
///
/// The threads are separate from the pool (see `join` in [`crate::map`]).
pub(crate) fn num_threads() -> usize {
    rayon::current_num_threads()
}
