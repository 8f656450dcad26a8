//! Rows of a picture: validation of a range of rows, and distribution to threads.

use std::{
    ops::Range,
    sync::atomic::{AtomicBool, Ordering},
};

use rayon::prelude::*;

use crate::{CastStats, Frame, InstructionSet, Interpolation, Method, RaycastError};

/// Fill rows of a picture in parallel, `num_rows` at a time, and return the items and the sum of the statistics.
///
/// Each row has `per_row` items, which are `blank` at first. After `stop` is set, the remaining rows stay blank.
pub(crate) fn share<T: Copy + Send>(
    rows: &Range<usize>,
    (blank, per_row): (T, usize),
    num_rows: usize,
    stop: Option<&AtomicBool>,
    cast: impl Fn(usize, &mut [T]) -> CastStats + Sync,
) -> (Vec<T>, CastStats) {
    let mut items = vec![blank; rows.len() * per_row];
    let stats = items
        .par_chunks_mut(per_row * num_rows)
        .enumerate()
        // Rows differ greatly in cost (dark lumen, near wall); with small jobs, a thread that has finished can take
        // over more of them.
        .with_max_len(4 / num_rows)
        .map(|(n, out)| {
            if stop.is_some_and(|stop| stop.load(Ordering::Relaxed)) {
                return CastStats::default();
            }
            cast(rows.start + n * num_rows, out)
        })
        .reduce(CastStats::default, CastStats::plus);
    (items, stats)
}

pub(crate) fn check(
    frame: &Frame<'_>,
    method: Method<'_>,
    rows: &Range<usize>,
    simd: InstructionSet,
) -> Result<(), RaycastError> {
    let height = frame.camera().height();
    if rows.start > rows.end || rows.end > height {
        return Err(RaycastError::Setting {
            what: "rows",
            expected: format!("a range within 0 to {height}"),
            found: format!("{} to {}", rows.start, rows.end),
        });
    }
    if !simd.is_available() {
        return Err(RaycastError::Setting {
            what: "instruction set",
            expected: "one that this machine has".to_owned(),
            found: simd.name().to_owned(),
        });
    }
    check_maps(frame, method)
}

fn check_maps(frame: &Frame<'_>, method: Method<'_>) -> Result<(), RaycastError> {
    let expected = frame.grid.num_voxels();
    let check = |what: &'static str, found: usize| {
        if found == expected {
            return Ok(());
        }
        Err(RaycastError::Setting {
            what,
            expected: format!("{expected} voxels, as in the volume"),
            found: format!("{found}"),
        })
    };
    match method {
        Method::Brute => Ok(()),
        Method::LeapTransparent(radius) => check("radius map", radius.len()),
        Method::LeapClasses(map) => {
            check("radius map", map.radius.len())?;
            check("label volume", map.labels.len())?;
            if frame.options.light.is_some() {
                return Err(RaycastError::Setting {
                    what: "leaps over all classes",
                    expected: "shading off, since shading varies inside a class".to_owned(),
                    found: "shading on".to_owned(),
                });
            }
            if frame.options.interpolation == Interpolation::Nearest {
                return Err(RaycastError::Setting {
                    what: "leaps over all classes",
                    expected: "samples between voxels".to_owned(),
                    found: "samples of the nearest voxel, whose leaps are over values".to_owned(),
                });
            }
            Ok(())
        }
        Method::LeapValues(map) => {
            check("map of values", map.words.len())?;
            if map.segments.num_labels() < usize::from(u8::MAX) {
                return Err(RaycastError::Setting {
                    what: "step table of a map of values",
                    expected: "an entry for each of 255 labels".to_owned(),
                    found: map.segments.num_labels().to_string(),
                });
            }
            if frame.options.interpolation == Interpolation::Trilinear {
                return Err(RaycastError::Setting {
                    what: "leaps over values",
                    expected: "samples of the nearest voxel".to_owned(),
                    found: "samples between voxels".to_owned(),
                });
            }
            Ok(())
        }
    }
}
