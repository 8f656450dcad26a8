//! Picture of three orthogonal planes in occlusion order (paper 3.1, tri-plane view: z-sorted surface ray casting).

use std::ops::Range;

use carina_grid::{Camera, VolumeView};
use rayon::prelude::*;

use crate::{Field, Window};

/// Three planes through a point: sagittal (x), coronal (y) and axial (z) of patient space.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TriPlane {
    /// Point where the planes intersect, LPS mm.
    pub centre_lps: [f64; 3],
    /// Window that maps values to grey levels.
    pub window: Window,
    /// Value below which a plane is transparent; `None` for planes that are opaque everywhere.
    pub clear_below: Option<f32>,
    /// Colour of pixels whose ray meets no plane.
    pub background: [u8; 3],
    /// Brightness of the sagittal, coronal and axial plane; different values make the edges of the planes visible.
    pub brightness: [f32; 3],
}

/// Cast rows of a picture of three planes, `[row, column, channel]`.
///
/// Each ray shows the nearest plane that is inside the volume and not transparent at the point where the ray meets it.
#[must_use]
pub fn cast_tri_plane(
    volume: VolumeView<'_, i16>,
    planes: &TriPlane,
    camera: &Camera,
    rows: Range<usize>,
) -> Vec<u8> {
    let grid = volume.grid();
    let field = Field::new(volume);
    let ijk_from_lps = grid.ijk_from_lps();
    let origin = camera.origin_lps();
    let width = camera.width();
    let mut rgb = vec![0u8; width * rows.len() * 3];
    rgb.par_chunks_mut(width * 3)
        .enumerate()
        .for_each(|(n, out)| {
            let row = rows.start + n;
            for (column, pixel) in out.chunks_exact_mut(3).enumerate() {
                let dir = camera.ray(column, row).dir_lps;
                let mut hits: [(f64, usize); 3] = std::array::from_fn(|axis| {
                    // A ray parallel to a plane never meets it; a plane behind the camera is not visible.
                    let t = (planes.centre_lps[axis] - origin[axis]) / dir[axis];
                    (if t > 0.0 { t } else { f64::INFINITY }, axis)
                });
                hits.sort_by(|a, b| a.0.total_cmp(&b.0));
                pixel.copy_from_slice(&planes.background);
                for (t, axis) in hits {
                    if !t.is_finite() {
                        break;
                    }
                    let lps = std::array::from_fn(|a| origin[a] + t * dir[a]);
                    let p = ijk_from_lps.point(lps).map(|v| v as f32);
                    if !field.contains(p) {
                        continue;
                    }
                    let value = field.value(p);
                    if planes.clear_below.is_some_and(|limit| value < limit) {
                        continue;
                    }
                    let grey = f32::from(planes.window.grey(value)) * planes.brightness[axis];
                    pixel.fill((grey + 0.5) as u8);
                    break;
                }
            }
        });
    rgb
}

#[cfg(test)]
mod tests {
    use super::*;
    use carina_grid::{Affine, Grid};

    #[test]
    fn the_nearest_plane_hides_those_behind_it_and_clear_values_do_not() {
        // The values are 10 i: the plane x = 2 shows 20 everywhere, the planes y and z show all values.
        let grid = Grid::new([9, 9, 9], Affine::IDENTITY).unwrap();
        let data: Vec<i16> = (0..729).map(|n| (n % 9 * 10) as i16).collect();
        let volume = VolumeView::new(&data, &grid).unwrap();
        // The camera is far away at -x and looks along +x with +y down, so rays meet the sagittal plane first.
        let pose = Affine::from_columns(
            [0.0, 0.0, -1.0],
            [0.0, 1.0, 0.0],
            [1.0, 0.0, 0.0],
            [-60.0, 3.3, 4.2],
        );
        let camera = Camera::new(pose, 0.2, 65, 65).unwrap();
        let mut planes = TriPlane {
            centre_lps: [2.0, 4.0, 4.0],
            window: Window::new(255.0, 127.5).unwrap(),
            clear_below: None,
            background: [9, 8, 7],
            brightness: [1.0; 3],
        };
        let rgb = cast_tri_plane(volume, &planes, &camera, 0..65);
        let centre = (32 * 65 + 32) * 3;
        assert_eq!(&rgb[centre..centre + 3], &[20, 20, 20]);
        assert_eq!(&rgb[..3], &[9, 8, 7], "the corner misses the box");
        planes.clear_below = Some(21.0);
        let through = cast_tri_plane(volume, &planes, &camera, 0..65);
        let strip = cast_tri_plane(volume, &planes, &camera, 20..31);
        assert_eq!(strip, through[20 * 65 * 3..31 * 65 * 3]);
        // Row 32 looks horizontally along y = 3.3, so it meets neither the plane y nor the plane z inside the box; a
        // lower row meets y = 4.
        assert_eq!(&through[centre..centre + 3], &[9, 8, 7]);
        assert!(
            through.chunks(3).any(|p| p[0] > 21),
            "the planes behind show through"
        );
    }
}
