//! Number of threads that process a volume.

/// Return the default number of threads of a map: as many as the pool has, but separate from the pool (see `join`).
pub(crate) fn num_threads() -> usize {
    rayon::current_num_threads()
}
