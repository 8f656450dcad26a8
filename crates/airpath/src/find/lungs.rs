//! Area of lung beside a carina, which distinguishes a trachea from bowel.

use carina_grid::{Ijk, VolumeView, length};

use crate::find::spots::{AirLevels, transverse_axis};

/// Minimum area of lung on each side of the carina in one slice, mm2; beside bowel there is less than half of it.
pub(crate) const MIN_LUNG_MM2: f64 = 800.0;
/// Maximum distances from the carina at which lung is searched, mm: sideways, to front and back, and down.
const LUNG_REACH_MM: [f64; 3] = [130.0, 80.0, 45.0];

/// Return the areas of lung on the right and on the left of the carina, at its height or below, mm2.
///
/// Each area is the largest in one slice. A voxel is lung if it and its four neighbours in the slice have values of
/// lung, and if tissue follows farther out. The blurred edges of bowel gas and skin pass through the values of lung
/// within one voxel. Both areas are infinite if `levels` has no values of lung.
pub(crate) fn lungs_beside(
    values: VolumeView<'_, i16>,
    levels: AirLevels,
    carina_lps: [f64; 3],
) -> [f64; 2] {
    let Some((low, high)) = levels.lung else {
        return [f64::INFINITY; 2];
    };
    let grid = values.grid();
    let axis = transverse_axis(grid);
    let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
    let shape = grid.shape_ijk();
    let columns = [0, 1, 2].map(|a| grid.lps_from_ijk().column(a));
    let cell_mm2 = length(carina_grid::cross(columns[u], columns[v]));
    let down = columns[axis][2] < 0.0;
    let first = grid.to_ijk(carina_grid::Lps(carina_lps)).0[axis]
        .round()
        .max(0.0) as usize;
    let num_slices = (LUNG_REACH_MM[2] / length(columns[axis])).ceil() as usize;
    let is_lung = |ijk: [usize; 3]| (low..=high).contains(&values.at(ijk));
    let (mut most_right, mut most_left) = (0usize, 0usize);
    for n in 0..=num_slices {
        let slice = if down {
            first.checked_add(n)
        } else {
            first.checked_sub(n)
        };
        let Some(slice) = slice.filter(|s| *s < shape[axis]) else {
            break;
        };
        // The first and the last tissue of every line of the slice distinguish lung from the air outside the body.
        let voxel = |p: usize, q: usize| {
            let mut ijk = [0; 3];
            (ijk[axis], ijk[u], ijk[v]) = (slice, p, q);
            ijk
        };
        let mut along_u = vec![(usize::MAX, 0); shape[v]];
        let mut along_v = vec![(usize::MAX, 0); shape[u]];
        for q in 0..shape[v] {
            for p in 0..shape[u] {
                if values.at(voxel(p, q)) >= levels.tissue {
                    along_u[q] = (p.min(along_u[q].0), p.max(along_u[q].1));
                    along_v[p] = (q.min(along_v[p].0), q.max(along_v[p].1));
                }
            }
        }
        let (mut right, mut left) = (0, 0);
        for q in 1..shape[v].max(2) - 1 {
            for p in 1..shape[u].max(2) - 1 {
                let ijk = voxel(p, q);
                let sides = [
                    along_u[q].0 < p,
                    p < along_u[q].1,
                    along_v[p].0 < q,
                    q < along_v[p].1,
                ];
                // Three of four sides suffice, because cropping may have removed the chest wall on one side.
                if !is_lung(ijk) || sides.iter().filter(|s| **s).count() < 3 {
                    continue;
                }
                let neighbours = [(u, p - 1), (u, p + 1), (v, q - 1), (v, q + 1)];
                if !neighbours.iter().all(|(a, at)| {
                    let mut near = ijk;
                    near[*a] = *at;
                    is_lung(near)
                }) {
                    continue;
                }
                let place = grid.to_lps(Ijk(ijk.map(|x| x as f64))).0;
                let off = [0, 1].map(|a| place[a] - carina_lps[a]);
                if off[0].abs() <= LUNG_REACH_MM[0] && off[1].abs() <= LUNG_REACH_MM[1] {
                    // +x is the patient's left.
                    if off[0] < 0.0 { right += 1 } else { left += 1 }
                }
            }
        }
        most_right = most_right.max(right);
        most_left = most_left.max(left);
    }
    [most_right, most_left].map(|n| n as f64 * cell_mm2)
}
