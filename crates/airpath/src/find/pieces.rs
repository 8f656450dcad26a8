//! Connected pieces of air that share no face with the lumen.

use rayon::prelude::*;

/// Region, air value and sizes for a search for pieces of air.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct PieceLimits {
    /// Largest voxel value that counts as air.
    pub darkest: i16,
    /// First voxel (i, j, k) of the box to search, and the first voxel beyond the box.
    ///
    /// Voxels outside the box do not count as air.
    pub box_ijk: ([usize; 3], [usize; 3]),
    /// Minimum number of a voxel's face neighbours, in the lumen or not, that are as dark as air; a voxel with fewer is
    /// noise.
    pub least_neighbours: usize,
    /// Smallest and largest number of voxels of a listed piece of air.
    pub voxels: (usize, usize),
    /// Maximum number of air voxels in the box; with more, the search returns no pieces, because they have no meaning.
    pub most_air: usize,
}

/// State of an air voxel of the box that does not touch the lumen.
const AIR: u8 = 1;
/// State of an air voxel of the box that touches the lumen.
const TOUCHES: u8 = 2;

/// Find the face-connected pieces of air that share no face with the lumen (voxels of `lumen` that are not 0).
///
/// Return the voxels of each piece in ascending order, the largest piece first.
pub fn pieces_of_air(
    values: &[i16],
    lumen: &[u8],
    shape_ijk: [usize; 3],
    limits: &PieceLimits,
) -> Vec<Vec<usize>> {
    let (low, high) = limits.box_ijk;
    let strides = [1, shape_ijk[0], shape_ijk[0] * shape_ijk[1]];
    let size: [usize; 3] = std::array::from_fn(|a| high[a].saturating_sub(low[a]));
    let steps = [1, size[0], size[0] * size[1]];
    let slice = steps[2];
    if slice == 0 || size[2] == 0 {
        return Vec::new();
    }
    let index = |at: [usize; 3]| -> usize { (0..3).map(|a| (low[a] + at[a]) * strides[a]).sum() };
    let mut marks = vec![0u8; slice * size[2]];
    let num_air: usize = marks
        .par_chunks_mut(slice)
        .enumerate()
        .map(|(k, marks)| {
            let mut num = 0;
            for j in 0..size[1] {
                for i in 0..size[0] {
                    let at = [i, j, k];
                    let here = index(at);
                    if values[here] > limits.darkest || lumen[here] != 0 {
                        continue;
                    }
                    let (mut dark, mut touches) = (0, false);
                    for a in 0..3 {
                        let mut look = |there: usize| {
                            dark += usize::from(values[there] <= limits.darkest);
                            touches |= lumen[there] != 0;
                        };
                        if at[a] > 0 {
                            look(here - strides[a]);
                        }
                        if at[a] + 1 < size[a] {
                            look(here + strides[a]);
                        }
                    }
                    if dark >= limits.least_neighbours {
                        marks[i + size[0] * j] = AIR | if touches { TOUCHES } else { 0 };
                        num += 1;
                    }
                }
            }
            num
        })
        .sum();
    if num_air > limits.most_air {
        return Vec::new();
    }
    let mut pieces: Vec<Vec<usize>> = Vec::new();
    let mut open = Vec::new();
    for start in 0..marks.len() {
        if marks[start] == 0 {
            continue;
        }
        let (mut piece, mut num, mut touches) = (Vec::new(), 0, false);
        open.push((start, marks[start]));
        marks[start] = 0;
        while let Some((at, mark)) = open.pop() {
            num += 1;
            touches |= mark & TOUCHES != 0;
            let place: [usize; 3] = std::array::from_fn(|a| at / steps[a] % size[a]);
            if num <= limits.voxels.1 && !touches {
                piece.push(index(place));
            }
            let mut take = |next: usize| {
                if marks[next] != 0 {
                    open.push((next, marks[next]));
                    marks[next] = 0;
                }
            };
            for a in 0..3 {
                if place[a] > 0 {
                    take(at - steps[a]);
                }
                if place[a] + 1 < size[a] {
                    take(at + steps[a]);
                }
            }
        }
        if !touches && (limits.voxels.0..=limits.voxels.1).contains(&num) {
            piece.sort_unstable();
            pieces.push(piece);
        }
    }
    // The scan finds pieces by their first voxel, and the sort is stable, so pieces of equal size stay in that order.
    pieces.sort_by_key(|piece| std::cmp::Reverse(piece.len()));
    pieces
}
