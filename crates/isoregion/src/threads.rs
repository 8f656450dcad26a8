//! How many threads work on a volume.

/// Threads that a map is built in unless told: as many as the pool has, but not its own (see `join`).
pub(crate) fn num_threads() -> usize {
    rayon::current_num_threads()
}
