//! Readable reference implementations of the radius maps: the paper's iteration, and the definition of the map of
//! cells.

use crate::{IsoRegionError, error::check_length};

/// Maximum radius that a map can contain, in voxels.
///
/// Larger cubes exist; to store them with a smaller radius costs speed, never correctness.
pub const MAX_RADIUS_VOX: u8 = 255;

/// Compute the radius of every voxel by the paper's iteration (4.2).
///
/// Departures from the paper: radii stop at 255, so that one byte can store them; a voxel with label 0 ("not one
/// colour") has radius 0.
///
/// # Errors
///
/// Returns an error if the number of labels does not match the shape.
pub fn paper_radius_map(labels: &[u8], shape_zyx: [usize; 3]) -> Result<Vec<u8>, IsoRegionError> {
    check_length(labels.len(), shape_zyx)?;
    let [nz, ny, nx] = shape_zyx.map(|n| n as isize);
    let at = |[z, y, x]: [isize; 3]| -> Option<usize> {
        let inside = (0..nz).contains(&z) && (0..ny).contains(&y) && (0..nx).contains(&x);
        inside.then_some(((z * ny + y) * nx + x) as usize)
    };
    let voxels =
        || (0..nz).flat_map(move |z| (0..ny).flat_map(move |y| (0..nx).map(move |x| [z, y, x])));
    let neighbours = |[z, y, x]: [isize; 3], steps: &'static [isize]| {
        steps.iter().flat_map(move |&dz| {
            steps
                .iter()
                .flat_map(move |&dy| steps.iter().map(move |&dx| [z + dz, y + dy, x + dx]))
        })
    };
    let mut radius = vec![0u8; labels.len()];
    // First iteration: the 26 neighbours have the label of the centre.
    for v in voxels() {
        let centre = labels[at(v).expect("inside")];
        let uniform =
            neighbours(v, &[-1, 0, 1]).all(|n| at(n).is_some_and(|i| labels[i] == centre));
        if centre != 0 && uniform {
            radius[at(v).expect("inside")] = 1;
        }
    }
    // Later iterations: the eight diagonal neighbours are all centres of regions found in the previous iteration.
    for d in 2..=MAX_RADIUS_VOX {
        let before = radius.clone();
        let mut found = false;
        for v in voxels() {
            let centre = at(v).expect("inside");
            let grows = before[centre] == d - 1
                && neighbours(v, &[-1, 1]).all(|n| at(n).is_some_and(|i| before[i] == d - 1));
            if grows {
                radius[centre] = d;
                found = true;
            }
        }
        if !found {
            break;
        }
    }
    Ok(radius)
}

/// Compute the radius of every cell by the definition in [`crate::cell_map`].
///
/// Departure from the paper, whose radii are those of voxels. As in [`paper_radius_map`], radii stop at 255, and label
/// 0 has radius 0.
///
/// # Errors
///
/// Returns an error if the number of labels does not match the shape.
pub fn reference_cell_map(labels: &[u8], shape_zyx: [usize; 3]) -> Result<Vec<u8>, IsoRegionError> {
    check_length(labels.len(), shape_zyx)?;
    let [nz, ny, nx] = shape_zyx;
    let mut radius = Vec::with_capacity(labels.len());
    for z in 0..nz {
        for y in 0..ny {
            for x in 0..nx {
                let label = labels[(z * ny + y) * nx + x];
                // No cube includes the first voxels of an axis, nor extends beyond the last.
                let largest = z
                    .min(y)
                    .min(x)
                    .min(nz - 1 - z)
                    .min(ny - 1 - y)
                    .min(nx - 1 - x);
                let alike = |d: usize| {
                    let [zs, ys, xs] = [z, y, x].map(|c| c + 1 - d..=c + d);
                    let mut rows = zs.flat_map(|z| ys.clone().map(move |y| (z * ny + y) * nx));
                    rows.all(|row| xs.clone().all(|x| labels[row + x] == label))
                };
                let most = largest.min(MAX_RADIUS_VOX.into());
                let d = (1..=most).take_while(|&d| label != 0 && alike(d)).count();
                radius.push(d as u8);
            }
        }
    }
    Ok(radius)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Compute the radii of voxels directly from their definition.
    fn by_definition(labels: &[u8], shape_zyx: [usize; 3]) -> Vec<u8> {
        let [nz, ny, nx] = shape_zyx.map(|n| n as isize);
        let label = |z: isize, y: isize, x: isize| {
            let inside = (0..nz).contains(&z) && (0..ny).contains(&y) && (0..nx).contains(&x);
            inside.then(|| labels[((z * ny + y) * nx + x) as usize])
        };
        let mut out = Vec::new();
        for z in 0..nz {
            for y in 0..ny {
                for x in 0..nx {
                    let centre = label(z, y, x).unwrap();
                    let uniform = |d: isize| {
                        (-d..=d).all(|a| {
                            (-d..=d).all(|b| {
                                (-d..=d).all(|c| label(z + a, y + b, x + c) == Some(centre))
                            })
                        })
                    };
                    let radius = (1..=255).take_while(|&d| centre != 0 && uniform(d)).count();
                    out.push(radius as u8);
                }
            }
        }
        out
    }

    proptest::proptest! {
        #[test]
        fn the_papers_iteration_equals_the_definition_of_the_radius(
            shape in proptest::array::uniform3(1usize..9),
            odd in proptest::collection::vec((0usize..512, 0u8..3), 0..6),
        ) {
            let mut labels = vec![7u8; shape.iter().product()];
            for (at, label) in odd {
                let n = labels.len();
                labels[at % n] = label;
            }
            proptest::prop_assert_eq!(paper_radius_map(&labels, shape).unwrap(), by_definition(&labels, shape));
        }
    }

    #[test]
    fn radii_in_a_uniform_cube_equal_the_distance_to_its_faces() {
        let radius = paper_radius_map(&[3; 125], [5, 5, 5]).unwrap();
        assert_eq!(radius[62], 2);
        assert_eq!(radius[0], 0);
        assert_eq!(radius[31], 1);
    }

    #[test]
    fn a_wrong_number_of_labels_is_rejected() {
        assert_eq!(
            paper_radius_map(&[1; 7], [2, 2, 2]).unwrap_err().code(),
            "geometry.length"
        );
    }
}
