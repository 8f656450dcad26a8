//! Connected parts of a mask, numbered in the order of their first voxels.
//!
//! Each row of the mask is divided into runs of voxels. A run is joined with the runs of the previous rows that it
//! touches, in a union-find forest whose roots are the earliest runs (Rosenfeld and Pfaltz, J. ACM 13, 1966).

use std::ops::Range;

/// Voxels that count as neighbours of a voxel.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Neighbours {
    /// The 6 voxels that share a face.
    Faces,
    /// The 26 voxels that share a face, an edge or a corner.
    All,
}

/// Consecutive voxels of one row of a mask.
struct Run {
    first: u32,
    end: u32,
}

/// Return the number, from 1, of the connected part of each voxel, 0 outside the mask, and the number of parts.
///
/// The parts are numbered in the order of their first voxels. Indices run x fastest.
///
/// # Panics
///
/// Panics if `mask` does not have one value per voxel of `shape_ijk`.
#[must_use]
pub fn numbered_parts(
    mask: &[bool],
    shape_ijk: [usize; 3],
    neighbours: Neighbours,
) -> (Vec<u32>, usize) {
    let [nx, ny, nz] = shape_ijk;
    assert_eq!(mask.len(), nx * ny * nz, "one value per voxel");
    let mut numbers = vec![0_u32; mask.len()];
    if mask.is_empty() {
        return (numbers, 0);
    }
    let mut runs: Vec<Run> = Vec::new();
    let mut rows: Vec<Range<usize>> = Vec::with_capacity(ny * nz);
    let mut parents: Vec<u32> = Vec::new();
    let reach = u32::from(neighbours == Neighbours::All);
    for k in 0..nz {
        for j in 0..ny {
            let row = k * ny + j;
            let start = runs.len();
            append_runs(&mask[row * nx..(row + 1) * nx], &mut runs);
            parents.extend(start as u32..runs.len() as u32);
            rows.push(start..runs.len());
            if start == runs.len() {
                continue;
            }
            if j > 0 {
                join(&runs, &rows[row - 1], &rows[row], reach, &mut parents);
            }
            if k > 0 {
                let lowest = j.saturating_sub(reach as usize);
                let highest = (j + reach as usize).min(ny - 1);
                for below in lowest..=highest {
                    let other = (k - 1) * ny + below;
                    join(&runs, &rows[other], &rows[row], reach, &mut parents);
                }
            }
        }
    }
    // A parent is an earlier run, so its number is known.
    let mut number_of = vec![0_u32; runs.len()];
    let mut num_parts = 0;
    for run in 0..runs.len() {
        let parent = parents[run] as usize;
        number_of[run] = if parent == run {
            num_parts += 1;
            num_parts
        } else {
            number_of[parent]
        };
    }
    for (row, of_row) in rows.iter().enumerate() {
        for run in of_row.clone() {
            let Run { first, end } = runs[run];
            numbers[row * nx + first as usize..row * nx + end as usize].fill(number_of[run]);
        }
    }
    (numbers, num_parts as usize)
}

/// Append the runs (maximal rows of consecutive mask voxels) of one row to `runs`.
fn append_runs(row: &[bool], runs: &mut Vec<Run>) {
    let mut at = 0;
    while let Some(skipped) = row[at..].iter().position(|&is_inside| is_inside) {
        let first = at + skipped;
        let length = row[first..].iter().position(|&is_inside| !is_inside);
        let end = length.map_or(row.len(), |length| first + length);
        runs.push(Run {
            first: first as u32,
            end: end as u32,
        });
        at = end;
    }
}

/// Join the runs of one row with those of an earlier row that they touch; `reach` is 1 if corners count.
fn join(
    runs: &[Run],
    earlier: &Range<usize>,
    later: &Range<usize>,
    reach: u32,
    parents: &mut [u32],
) {
    let mut one = earlier.start;
    let mut other = later.start;
    while one < earlier.end && other < later.end {
        if runs[one].first < runs[other].end + reach && runs[other].first < runs[one].end + reach {
            let (a, b) = (root(parents, one as u32), root(parents, other as u32));
            parents[a.max(b) as usize] = a.min(b);
        }
        if runs[one].end < runs[other].end {
            one += 1;
        } else {
            other += 1;
        }
    }
}

/// Return the run that represents the connected component of a run, and halve the path to it.
fn root(parents: &mut [u32], mut run: u32) -> u32 {
    while parents[run as usize] != run {
        let above = parents[run as usize];
        parents[run as usize] = parents[above as usize];
        run = above;
    }
    run
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    /// Number the parts by a search from each voxel in turn.
    fn searched(mask: &[bool], shape: [usize; 3], neighbours: Neighbours) -> (Vec<u32>, usize) {
        let [nx, ny, nz] = shape;
        let mut numbers = vec![0_u32; mask.len()];
        let mut num = 0;
        for start in 0..mask.len() {
            if !mask[start] || numbers[start] != 0 {
                continue;
            }
            num += 1;
            numbers[start] = num;
            let mut waiting = vec![start];
            while let Some(at) = waiting.pop() {
                let (i, j, k) = (at % nx, at / nx % ny, at / nx / ny);
                for z in k.saturating_sub(1)..(k + 2).min(nz) {
                    for y in j.saturating_sub(1)..(j + 2).min(ny) {
                        for x in i.saturating_sub(1)..(i + 2).min(nx) {
                            let steps = x.abs_diff(i) + y.abs_diff(j) + z.abs_diff(k);
                            let other = (z * ny + y) * nx + x;
                            if (steps == 1 || neighbours == Neighbours::All)
                                && mask[other]
                                && numbers[other] == 0
                            {
                                numbers[other] = num;
                                waiting.push(other);
                            }
                        }
                    }
                }
            }
        }
        (numbers, num as usize)
    }

    proptest! {
        #[test]
        fn parts_equal_those_of_a_search(
            (shape, mask) in (1_usize..7, 1_usize..6, 1_usize..5).prop_flat_map(|(nx, ny, nz)| {
                (Just([nx, ny, nz]), prop::collection::vec(prop::bool::weighted(0.4), nx * ny * nz))
            }),
            faces in any::<bool>(),
        ) {
            let neighbours = if faces { Neighbours::Faces } else { Neighbours::All };
            prop_assert_eq!(numbered_parts(&mask, shape, neighbours), searched(&mask, shape, neighbours));
        }
    }

    #[test]
    fn parts_are_numbered_by_their_first_voxels() {
        // A U whose second arm begins later but joins the first; then a separate voxel.
        let mask = [
            true, false, true, false, true, //
            true, true, true, false, false,
        ];
        let (numbers, num) = numbered_parts(&mask, [5, 2, 1], Neighbours::Faces);
        assert_eq!(num, 2);
        assert_eq!(numbers, [1, 0, 1, 0, 2, 1, 1, 1, 0, 0]);
    }

    #[test]
    fn voxels_that_share_a_corner_are_one_part_only_if_corners_count() {
        let mask = [true, false, false, true];
        assert_eq!(numbered_parts(&mask, [2, 2, 1], Neighbours::Faces).1, 2);
        assert_eq!(numbered_parts(&mask, [2, 1, 2], Neighbours::All).1, 1);
    }
}
