//! Endoscopic wall: a copy of the volume with raised values round the lumen, so that the wall is opaque
//! (docs/decisions/0105).

use rayon::prelude::*;

use crate::{RaycastError, mask::FULL};

/// Tables of the values to write, indexed by the smoothed lumen mask at a voxel (0 ..= 1024).
///
/// There is a table for voxels in the lumen, one for the shell of one voxel round the lumen, and one for the voxels
/// behind that shell.
#[derive(Debug, Clone, Copy)]
pub struct WallHeights<'a> {
    /// Voxel values for the lumen, by the smoothed lumen from 0 to 1024.
    pub lumen: &'a [i16],
    /// Voxel values for the shell (the voxels next to the lumen), by the smoothed lumen from 0 to 1024.
    pub shell: &'a [i16],
    /// Voxel values for the backing (the voxels behind the shell), by the smoothed lumen from 0 to 1024.
    pub backing: &'a [i16],
}

/// Range of voxels `first .. end` along z, y and x.
pub type BoxZyx = [(usize, usize); 3];

/// Raise values round a lumen so that its wall is opaque.
///
/// `part` must contain the lumen and the four voxels round it, or reach the end of the volume. A voxel beside the lumen
/// with a value below `open_below` counts as lumen, because a lumen found with a low threshold ends inside its blurred
/// edge. The function works slice by slice and needs one extra byte for each voxel of the box.
///
/// # Errors
///
/// Returns an error if an array, a table or the box has the wrong size.
pub fn raise_wall(
    values: &mut [i16],
    lumen: &[u8],
    shape_zyx: [usize; 3],
    part: BoxZyx,
    open_below: i16,
    heights: WallHeights<'_>,
) -> Result<(), RaycastError> {
    let num_voxels = shape_zyx.iter().product::<usize>();
    let inside = (0..3).all(|a| part[a].0 < part[a].1 && part[a].1 <= shape_zyx[a]);
    let tables = [heights.lumen, heights.shell, heights.backing];
    let whole = tables.iter().all(|table| table.len() == FULL as usize + 1);
    if values.len() != num_voxels || lumen.len() != num_voxels || !inside || !whole {
        return Err(RaycastError::Setting {
            what: "wall",
            expected: format!(
                "a lumen and a box within shape {shape_zyx:?}, three tables of 1025 heights"
            ),
            found: format!("{} voxels of lumen, box {part:?}", lumen.len()),
        });
    }
    let [nz, ny, nx] = part.map(|(first, end)| end - first);
    let plane = shape_zyx[1] * shape_zyx[2];
    let row_of =
        |z: usize, y: usize| (part[0].0 + z) * plane + (part[1].0 + y) * shape_zyx[2] + part[2].0;

    // The mask of the lumen includes the voxels of its blurred edge.
    let mut open = vec![0u8; nz * ny * nx];
    open.par_chunks_mut(ny * nx)
        .enumerate()
        .for_each(|(z, open)| {
            let mut near = vec![0u8; ny * nx];
            for m in z.saturating_sub(1)..(z + 2).min(nz) {
                for (y, near) in near.chunks_mut(nx).enumerate() {
                    for (near, &v) in near.iter_mut().zip(&lumen[row_of(m, y)..][..nx]) {
                        *near |= u8::from(v != 0);
                    }
                }
            }
            grow(&mut near, nx, 1);
            for y in 0..ny {
                let at = row_of(z, y);
                for x in 0..nx {
                    let beside = near[y * nx + x] != 0 && values[at + x] < open_below;
                    open[y * nx + x] = u8::from(lumen[at + x] != 0 || beside);
                }
            }
        });

    let slices = &mut values[part[0].0 * plane..part[0].1 * plane];
    slices
        .par_chunks_mut(plane)
        .enumerate()
        .for_each(|(z, slice)| {
            let open_slice = |m: usize| &open[m * ny * nx..][..ny * nx];
            let any_within = |reach: usize| {
                let mut any = vec![0u8; ny * nx];
                for m in z.saturating_sub(reach)..(z + reach + 1).min(nz) {
                    any.iter_mut()
                        .zip(open_slice(m))
                        .for_each(|(a, &o)| *a |= o);
                }
                grow(&mut any, nx, reach);
                any
            };
            let backing = any_within(2);
            if backing.iter().all(|&b| b == 0) {
                return;
            }
            let (here, shell) = (open_slice(z), any_within(1));
            let smooth = smoothed_slice(
                [
                    open_slice(z.saturating_sub(1)),
                    here,
                    open_slice((z + 1).min(nz - 1)),
                ],
                nx,
            );
            for y in 0..ny {
                let row = &mut slice[(part[1].0 + y) * shape_zyx[2] + part[2].0..][..nx];
                for (x, value) in row.iter_mut().enumerate() {
                    let n = y * nx + x;
                    if backing[n] == 0 {
                        continue;
                    }
                    let table = match (here[n], shell[n]) {
                        (1.., _) => heights.lumen,
                        (0, 1..) => heights.shell,
                        (0, 0) => heights.backing,
                    };
                    *value = (*value).max(table[usize::from(smooth[n])]);
                }
            }
        });
    Ok(())
}

/// Set every voxel of a slice that is within `reach` voxels of a set voxel, along both axes.
fn grow(slice: &mut [u8], nx: usize, reach: usize) {
    for _ in 0..reach {
        for row in slice.chunks_mut(nx) {
            let mut before = 0;
            for x in 0..nx {
                let here = row[x];
                let after = if x + 1 < nx { row[x + 1] } else { 0 };
                row[x] = before | here | after;
                before = here;
            }
        }
        let ny = slice.len() / nx;
        let mut before = vec![0u8; nx];
        for y in 0..ny {
            for x in 0..nx {
                let here = slice[y * nx + x];
                let after = if y + 1 < ny {
                    slice[(y + 1) * nx + x]
                } else {
                    0
                };
                slice[y * nx + x] = before[x] | here | after;
                before[x] = here;
            }
        }
    }
}

/// Compute one slice of [`crate::smoothed_mask`] from a mask of 0 and 1 in this slice and its two neighbours.
fn smoothed_slice([before, here, after]: [&[u8]; 3], nx: usize) -> Vec<u16> {
    let unit = FULL as u16 / 64;
    let mut out: Vec<u16> = (0..here.len())
        .map(|n| unit * u16::from(before[n] + 2 * here[n] + after[n]))
        .collect();
    let ny = out.len() / nx;
    for row in out.chunks_mut(nx) {
        let mut last = row[0];
        for x in 0..nx {
            let v = row[x];
            row[x] = last + 2 * v + row[(x + 1).min(nx - 1)];
            last = v;
        }
    }
    let mut last = out[..nx].to_vec();
    for y in 0..ny {
        let next = (y + 1).min(ny - 1);
        for x in 0..nx {
            let v = out[y * nx + x];
            out[y * nx + x] = last[x] + 2 * v + out[next * nx + x];
            last[x] = v;
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::smoothed_mask;

    #[test]
    fn a_smoothed_slice_equals_that_of_the_smoothed_mask() {
        let [nz, ny, nx] = [5usize, 6, 7];
        let mask: Vec<u8> = (0..nz * ny * nx)
            .map(|n| u8::from(n * 2_654_435_761 % 97 < 40))
            .collect();
        let whole = smoothed_mask(&mask, [nz, ny, nx]);
        let slice = |z: usize| &mask[z * ny * nx..][..ny * nx];
        for z in 0..nz {
            let near = [z.saturating_sub(1), z, (z + 1).min(nz - 1)].map(slice);
            let found = smoothed_slice(near, nx);
            let expected = whole[z * ny * nx..][..ny * nx].iter().map(|&v| v as u16);
            assert!(found.into_iter().eq(expected), "slice {z}");
        }
    }

    #[test]
    fn growing_reaches_diagonal_neighbours_and_stops_at_the_edge() {
        let mut slice = [0u8; 20];
        slice[6] = 1; // Row 1, column 1 of 4 x 5.
        grow(&mut slice, 5, 1);
        assert_eq!(
            slice,
            [1, 1, 1, 0, 0, 1, 1, 1, 0, 0, 1, 1, 1, 0, 0, 0, 0, 0, 0, 0]
        );
        grow(&mut slice, 5, 2);
        assert_eq!(slice, [1; 20]);
    }

    #[test]
    fn a_box_or_a_table_of_the_wrong_size_is_rejected() {
        let table = [0i16; 1025];
        let heights = WallHeights {
            lumen: &table,
            shell: &table,
            backing: &table[1..],
        };
        let full = [(0, 2), (0, 3), (0, 4)];
        let mut values = [0i16; 24];
        assert!(raise_wall(&mut values, &[0; 24], [2, 3, 4], full, 0, heights).is_err());
        let heights = WallHeights {
            backing: &table,
            ..heights
        };
        assert!(raise_wall(&mut values, &[0; 24], [2, 3, 4], full, 0, heights).is_ok());
        assert!(
            raise_wall(
                &mut values,
                &[0; 24],
                [2, 3, 4],
                [(0, 3), (0, 3), (0, 4)],
                0,
                heights
            )
            .is_err()
        );
        assert!(raise_wall(&mut values, &[0; 23], [2, 3, 4], full, 0, heights).is_err());
    }
}
