//! Label volumes; cubes of equal labels are the regions of an `IsoRegion` map (paper 4.1).

use crate::{IsoRegionError, threads::num_threads};

/// Width of a bin, HU: the paper labels voxels by bins of values; 256 bins cover the 4096 HU of a 12-bit CT.
pub const VALUE_BIN_HU: i32 = 16;

/// Colour (not premultiplied) and opacity per reference length, 0 to 1.
pub type Rgba = [f64; 4];

/// HU range of one label: a maximal run of HU whose transfer-table entries are one colour, or one bin.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Class {
    /// First HU of the class.
    pub lo_hu: i32,
    /// Last HU of the class.
    pub hi_hu: i32,
    /// Number of voxels of the volume that belong to the class.
    pub num_voxels: u64,
    /// Whether all HU of the class have opacity 0.
    pub transparent: bool,
}

/// Label volume, and the class of each label.
#[derive(Debug, Clone, PartialEq)]
pub struct ClassLabels {
    /// Label of each voxel, `[z, y, x]`; rays never skip voxels with label 0.
    pub labels: Vec<u8>,
    /// Class of each label, `classes[label - 1]`, most frequent class first.
    pub classes: Vec<Class>,
}

/// Return the bin, the range of 16 HU that the paper labels as one, of a value in HU.
#[must_use]
pub const fn value_bin(hu: i32) -> i32 {
    hu.div_euclid(VALUE_BIN_HU)
}

/// Label voxels by bins of values, as in the paper.
///
/// The 255 most frequent bins get labels 1 to 255, the others 0. `transparent(lo, hi)` returns whether a bin has no
/// opacity anywhere; this result is only stored in the class.
pub fn value_labels(hu: &[i16], transparent: impl Fn(i32, i32) -> bool) -> ClassLabels {
    let first = value_bin(i32::from(i16::MIN));
    let runs = (first..=value_bin(i32::from(i16::MAX))).map(|bin| {
        let lo = bin * VALUE_BIN_HU;
        (lo, lo + VALUE_BIN_HU - 1)
    });
    label_runs(
        hu,
        runs.map(|(lo, hi)| (lo, hi, transparent(lo, hi))).collect(),
    )
}

/// Label voxels by classes: maximal runs of HU whose transfer-table entries are one colour.
///
/// `table[n]` is the entry of `lo_hu + n`. Values below and above the table count as its first and last entry. All
/// entries of opacity 0 count as one colour. A class is one *contiguous* run, because interpolation between two
/// transparent runs passes through the values between them. With `transparent_only`, opaque runs get label 0, so that
/// the radius map is that of the shaded caster, which may leap over transparent runs only.
///
/// # Errors
///
/// Returns an error if the table is empty.
pub fn class_labels(
    hu: &[i16],
    lo_hu: i32,
    table: &[Rgba],
    transparent_only: bool,
) -> Result<ClassLabels, IsoRegionError> {
    let runs = runs_of_one_colour(lo_hu, table)?;
    let selected = runs.into_iter().filter(|run| run.2 || !transparent_only);
    Ok(label_runs(hu, selected.collect()))
}

/// Return the maximal runs of transparent entries of a table in ascending order, as the first and last HU of each.
///
/// A map of the transparent classes depends only on these runs and the volume.
///
/// # Errors
///
/// Returns an error if the table is empty.
pub fn transparent_runs(lo_hu: i32, table: &[Rgba]) -> Result<Vec<(i16, i16)>, IsoRegionError> {
    let runs = runs_of_one_colour(lo_hu, table)?;
    let value = |v: i32| v.clamp(i16::MIN.into(), i16::MAX.into()) as i16;
    let clear = runs.into_iter().filter(|run| run.2);
    Ok(clear.map(|(lo, hi, _)| (value(lo), value(hi))).collect())
}

/// Label voxels by the given runs of values (first, last); voxels in no run get label 0.
pub(crate) fn run_labels(hu: &[i16], runs: &[(i16, i16)]) -> ClassLabels {
    let runs = runs.iter().map(|&(lo, hi)| (lo.into(), hi.into(), true));
    label_runs(hu, runs.collect())
}

/// Return the maximal runs of HU with one colour as `(first HU, last HU, whether transparent)`.
///
/// The first and the last run are extended over all int16 values.
fn runs_of_one_colour(lo_hu: i32, table: &[Rgba]) -> Result<Vec<(i32, i32, bool)>, IsoRegionError> {
    // The comparison comes before premultiplication and is by bits, so every later table made from this one is constant
    // over the run too.
    let key = |rgba: &Rgba| (rgba[3] != 0.0).then(|| rgba.map(f64::to_bits));
    let mut runs: Vec<(i32, i32, bool)> = Vec::new();
    let mut previous = None;
    for (n, rgba) in table.iter().enumerate() {
        let (hu, key) = (lo_hu + n as i32, key(rgba));
        match runs.last_mut() {
            Some(run) if previous == Some(key) => run.1 = hu,
            _ => runs.push((hu, hu, key.is_none())),
        }
        previous = Some(key);
    }
    let (Some(first), Some(last)) = (runs.first().copied(), runs.last().copied()) else {
        return Err(IsoRegionError::EmptyTable);
    };
    let count = runs.len();
    runs[0].0 = first.0.min(i32::from(i16::MIN));
    runs[count - 1].1 = last.1.max(i32::from(i16::MAX));
    Ok(runs)
}

/// Number of different int16 values: the length of a table with one entry for each value.
const NUM_VALUES: usize = 1 << 16;

const fn position(hu: i16) -> usize {
    (hu as i32 - i16::MIN as i32) as usize
}

/// Apply `work` to parts of the values, each in its own thread, and return the results in order.
///
/// The threads are separate from the pool that casts pictures.
fn in_threads<T: Send>(hu: &[i16], work: impl Fn(&[i16]) -> T + Sync) -> Vec<T> {
    let part = hu.len().div_ceil(num_threads()).max(1 << 16);
    std::thread::scope(|scope| {
        let threads: Vec<_> = hu
            .chunks(part)
            .map(|chunk| scope.spawn(|| work(chunk)))
            .collect();
        // A panic in one thread becomes a panic of this function.
        let results = threads.into_iter().map(|t| t.join().expect("counting"));
        results.collect()
    })
}

/// Return the smallest and the largest of the values; `None` if there are no values.
#[must_use]
pub fn value_range(hu: &[i16]) -> Option<(i16, i16)> {
    let parts = in_threads(hu, |chunk| {
        // Blocks are short enough for the compiler to hold them in registers.
        let (mut lo, mut hi) = ([i16::MAX; 64], [i16::MIN; 64]);
        let (blocks, rest) = chunk.as_chunks::<64>();
        for block in blocks {
            for n in 0..64 {
                lo[n] = lo[n].min(block[n]);
                hi[n] = hi[n].max(block[n]);
            }
        }
        let least = lo.iter().chain(rest).min().copied();
        least.zip(hi.iter().chain(rest).max().copied())
    });
    let parts = parts.into_iter().flatten();
    parts.reduce(|a, b| (a.0.min(b.0), a.1.max(b.1)))
}

fn histogram(hu: &[i16]) -> Vec<u64> {
    // Equal values occur in succession. Neighbours are counted in separate tables, so that no addition waits for the
    // previous one.
    const LANES: usize = 4;
    let parts = in_threads(hu, |chunk| {
        let mut counts = vec![[0u32; LANES]; NUM_VALUES];
        let (fours, rest) = chunk.as_chunks::<LANES>();
        for four in fours {
            for lane in 0..LANES {
                counts[position(four[lane])][lane] += 1;
            }
        }
        for &v in rest {
            counts[position(v)][0] += 1;
        }
        counts
    });
    let mut sum = vec![0u64; NUM_VALUES];
    for counts in parts {
        for (sum, lanes) in sum.iter_mut().zip(counts) {
            *sum += lanes.map(u64::from).iter().sum::<u64>();
        }
    }
    sum
}

/// Label voxels by disjoint runs of HU, the most frequent run first; voxels in no run get label 0.
fn label_runs(hu: &[i16], runs: Vec<(i32, i32, bool)>) -> ClassLabels {
    let counts = histogram(hu);
    let clamp = |v: i32| position(v.clamp(i16::MIN.into(), i16::MAX.into()) as i16);
    let mut classes: Vec<Class> = runs
        .into_iter()
        .map(|(lo_hu, hi_hu, transparent)| Class {
            lo_hu,
            hi_hu,
            num_voxels: counts[clamp(lo_hu)..=clamp(hi_hu)].iter().sum(),
            transparent,
        })
        .filter(|class| class.num_voxels > 0)
        .collect();
    // The sort is stable, so equal counts keep the order of HU and the labels do not depend on the sort algorithm.
    classes.sort_by_key(|class| std::cmp::Reverse(class.num_voxels));
    classes.truncate(usize::from(u8::MAX));
    let mut label_of = vec![0u8; NUM_VALUES];
    for (n, class) in classes.iter().enumerate() {
        label_of[clamp(class.lo_hu)..=clamp(class.hi_hu)].fill(n as u8 + 1);
    }
    let mut labels = vec![0u8; hu.len()];
    let part = hu.len().div_ceil(num_threads()).max(1 << 16);
    std::thread::scope(|scope| {
        for (labels, hu) in labels.chunks_mut(part).zip(hu.chunks(part)) {
            let label_of = &label_of;
            scope.spawn(move || {
                for (label, &v) in labels.iter_mut().zip(hu) {
                    *label = label_of[position(v)];
                }
            });
        }
    });
    ClassLabels { labels, classes }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Colour of a class without opacity; its colour channels must not matter.
    const CLEAR: Rgba = [0.2, 0.3, 0.4, 0.0];
    /// Red with an opacity of one half.
    const RED: Rgba = [1.0, 0.0, 0.0, 0.5];

    #[test]
    fn transparent_entries_of_any_colour_are_one_run_but_two_runs_are_two_classes() {
        let other_clear = [0.9, 0.9, 0.9, 0.0];
        let table = [CLEAR, other_clear, RED, RED, CLEAR];
        let hu = [10, 11, 12, 13, 14, 14, 9, 200];
        let out = class_labels(&hu, 10, &table, false).unwrap();
        let label = |v: i16| out.labels[hu.iter().position(|&h| h == v).unwrap()];
        assert_eq!(label(10), label(11));
        assert_eq!(
            label(10),
            label(9),
            "values below the table are its first entry"
        );
        assert_eq!(label(12), label(13));
        assert_ne!(label(10), label(12));
        assert_ne!(label(10), label(14), "an opaque run lies between them");
        assert_eq!(
            label(14),
            label(200),
            "values above the table are its last entry"
        );
        assert!(out.classes[usize::from(label(14)) - 1].transparent);
        assert!(!out.classes[usize::from(label(12)) - 1].transparent);
    }

    #[test]
    fn opaque_runs_get_label_0_with_transparent_only() {
        let out = class_labels(&[10, 12, 14], 10, &[CLEAR, CLEAR, RED, RED, CLEAR], true).unwrap();
        assert_eq!(out.labels[1], 0);
        assert!(out.labels[0] != 0 && out.labels[2] != 0 && out.labels[0] != out.labels[2]);
    }

    #[test]
    fn the_255_most_frequent_bins_get_labels_and_the_others_label_0() {
        // There are 300 bins; bin n has n + 1 voxels, so bins 0 to 44 are the rarest.
        let hu: Vec<i16> = (0..300i16)
            .flat_map(|n| std::iter::repeat_n(n * 16 + 5, n as usize + 1))
            .collect();
        let out = value_labels(&hu, |_, _| false);
        assert_eq!(out.classes.len(), 255);
        for (&v, &label) in hu.iter().zip(&out.labels) {
            assert_eq!(label == 0, v / 16 < 45, "value {v}");
        }
        assert_eq!(out.classes[0].lo_hu, 299 * 16);
        assert_eq!(value_bin(-1), -1);
    }

    #[test]
    fn the_value_range_equals_that_of_a_plain_search() {
        assert_eq!(value_range(&[]), None);
        assert_eq!(value_range(&[7]), Some((7, 7)));
        for n in [63, 64, 65, 200_000] {
            for at in [0, n / 2, n - 1] {
                let mut hu = vec![5i16; n];
                hu[at] = i16::MIN;
                hu[(at + 1) % n] = i16::MAX;
                assert_eq!(value_range(&hu), Some((i16::MIN, i16::MAX)), "{n} {at}");
            }
        }
    }

    #[test]
    fn an_empty_colour_table_is_rejected() {
        assert_eq!(
            class_labels(&[1], 0, &[], false),
            Err(IsoRegionError::EmptyTable)
        );
    }
}
