use std::sync::Arc;

use crate::{Affine, Grid, GridError, LensRays, MAX_FOV_RAD, MIN_FOV_RAD};

/// Camera with pose, lens and viewport; a pinhole camera if it has no lens.
///
/// Camera axes: +x right, +y down, +z forward. Pixel (0, 0) is the corner of the top-left pixel; its centre is (0.5,
/// 0.5).
#[derive(Debug, Clone, PartialEq)]
pub struct Camera {
    lps_from_camera: Affine,
    focal_px: f64,
    width: usize,
    height: usize,
    lens_rays: Option<Arc<LensRays>>,
}

/// Ray through the centre of one pixel, in patient space.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PixelRay {
    /// Position of the camera's centre, LPS mm.
    pub origin_lps: [f64; 3],
    /// Direction from the camera, a unit vector, LPS.
    pub dir_lps: [f64; 3],
}

impl Camera {
    /// Create a pinhole camera at a rigid pose.
    ///
    /// `fov_rad` is the full angle across the shorter side of the viewport.
    ///
    /// # Errors
    ///
    /// Returns an error if the pose is not rigid, or if field of view or viewport are out of range.
    pub fn new(
        lps_from_camera: Affine,
        fov_rad: f64,
        width: usize,
        height: usize,
    ) -> Result<Self, GridError> {
        check_pose(&lps_from_camera)?;
        if !(MIN_FOV_RAD - 1e-12..=MAX_FOV_RAD + 1e-12).contains(&fov_rad) {
            return Err(GridError::Camera {
                what: "field of view",
                expected: "1 to 170 degrees".to_owned(),
                found: format!("{:.2} degrees", fov_rad.to_degrees()),
            });
        }
        if !(1..=8192).contains(&width) || !(1..=8192).contains(&height) {
            return Err(GridError::Camera {
                what: "viewport",
                expected: "1 to 8192 pixels on each side".to_owned(),
                found: format!("{width} x {height}"),
            });
        }
        Ok(Self {
            lps_from_camera,
            // The tangent is from libm, not std, so that all platforms give the same bits.
            focal_px: width.min(height) as f64 / 2.0 / libm::tan(fov_rad / 2.0),
            width,
            height,
            lens_rays: None,
        })
    }

    /// Create a camera at a rigid pose with rays that were built for a lens and a viewport.
    ///
    /// # Errors
    ///
    /// Returns an error if the pose is not rigid.
    pub fn with_lens(lps_from_camera: Affine, rays: Arc<LensRays>) -> Result<Self, GridError> {
        check_pose(&lps_from_camera)?;
        let [across, down] = rays.optics().focal_px();
        Ok(Self {
            lps_from_camera,
            focal_px: across.min(down),
            width: rays.width(),
            height: rays.height(),
            lens_rays: Some(rays),
        })
    }

    /// Return the same camera with one row of rays in the given directions of camera space.
    ///
    /// A direction of length 0 is not a ray.
    #[must_use]
    pub fn listing(&self, directions: &[[f32; 3]]) -> Self {
        Self {
            width: directions.len(),
            height: 1,
            lens_rays: Some(Arc::new(LensRays::listed(directions))),
            ..self.clone()
        }
    }

    /// Return the direction in camera space of a ray that is displaced from a pixel's centre by fractions of a pixel.
    ///
    /// Within a pixel, the direction is interpolated between the neighbours on either side. The result is all 0 for a
    /// pixel without a ray.
    #[must_use]
    pub fn direction_beside(&self, column: usize, row: usize, [dx, dy]: [f64; 2]) -> [f64; 3] {
        let Some(rays) = self.lens_rays() else {
            let x = (column as f64 + 0.5) - self.width as f64 / 2.0 + dx;
            let y = (row as f64 + 0.5) - self.height as f64 / 2.0 + dy;
            let len = (x * x + y * y + self.focal_px * self.focal_px).sqrt();
            return [x / len, y / len, self.focal_px / len];
        };
        let here = rays.direction(column, row);
        if here == [0.0; 3] {
            return [0.0; 3];
        }
        // A neighbour outside the picture or the outline is replaced by the mirror image of the neighbour on the other
        // side.
        let at = |column: Option<usize>, row: Option<usize>| {
            let (column, row) = (
                column.filter(|&c| c < self.width)?,
                row.filter(|&r| r < self.height)?,
            );
            Some(rays.direction(column, row)).filter(|d| *d != [0.0; 3])
        };
        let rise = |before: Option<[f32; 3]>, after: Option<[f32; 3]>, a: usize| {
            let part = |to: [f32; 3], from: [f32; 3]| f64::from(to[a]) - f64::from(from[a]);
            match (before, after) {
                (Some(before), Some(after)) => part(after, before) / 2.0,
                (Some(before), None) => part(here, before),
                (None, Some(after)) => part(after, here),
                (None, None) => 0.0,
            }
        };
        let (left, right) = (
            at(column.checked_sub(1), Some(row)),
            at(Some(column + 1), Some(row)),
        );
        let (above, below) = (
            at(Some(column), row.checked_sub(1)),
            at(Some(column), Some(row + 1)),
        );
        let d: [f64; 3] = std::array::from_fn(|a| {
            f64::from(here[a]) + dx * rise(left, right, a) + dy * rise(above, below, a)
        });
        let len = (d[0] * d[0] + d[1] * d[1] + d[2] * d[2]).sqrt();
        d.map(|v| v / len)
    }

    /// Return the rays of the pixels if the camera has a lens; `None` for a pinhole camera.
    #[must_use]
    pub fn lens_rays(&self) -> Option<&LensRays> {
        self.lens_rays.as_deref()
    }

    /// Return the shared rays of the camera's lens; `None` for a pinhole camera.
    ///
    /// While the caller keeps this reference, no other rays can have the same address.
    #[must_use]
    pub const fn shared_lens_rays(&self) -> Option<&Arc<LensRays>> {
        self.lens_rays.as_ref()
    }

    /// Return the pose of the camera.
    #[must_use]
    pub const fn lps_from_camera(&self) -> &Affine {
        &self.lps_from_camera
    }

    /// Return the camera centre, LPS mm.
    #[must_use]
    pub fn origin_lps(&self) -> [f64; 3] {
        self.lps_from_camera.column(3)
    }

    /// Return the focal length in pixels; for a camera with a lens, that in the middle of the picture.
    #[must_use]
    pub const fn focal_px(&self) -> f64 {
        self.focal_px
    }

    /// Return the width of the viewport, pixels.
    #[must_use]
    pub const fn width(&self) -> usize {
        self.width
    }

    /// Return the height of the viewport, pixels.
    #[must_use]
    pub const fn height(&self) -> usize {
        self.height
    }

    /// Return the ray through the centre of pixel (column, row); its direction is 0 if the pixel has no ray.
    #[must_use]
    pub fn ray(&self, column: usize, row: usize) -> PixelRay {
        if let Some(rays) = self.lens_rays() {
            let dir = rays.direction(column, row).map(f64::from);
            return PixelRay {
                origin_lps: self.origin_lps(),
                dir_lps: self.lps_from_camera.vector(dir),
            };
        }
        let x = (column as f64 + 0.5) - self.width as f64 / 2.0;
        let y = (row as f64 + 0.5) - self.height as f64 / 2.0;
        let len = (x * x + y * y + self.focal_px * self.focal_px).sqrt();
        PixelRay {
            origin_lps: self.origin_lps(),
            dir_lps: self
                .lps_from_camera
                .vector([x / len, y / len, self.focal_px / len]),
        }
    }

    /// Return the camera's centre and the step of a pixel's ray in voxel coordinates: `p(t) = origin + t_mm *
    /// direction`.
    #[must_use]
    pub fn ray_ijk(&self, grid: &Grid, column: usize, row: usize) -> ([f64; 3], [f64; 3]) {
        let ray = self.ray(column, row);
        (
            grid.ijk_from_lps().point(ray.origin_lps),
            grid.ijk_from_lps().vector(ray.dir_lps),
        )
    }
}

fn check_pose(lps_from_camera: &Affine) -> Result<(), GridError> {
    let position = lps_from_camera.column(3);
    if position.iter().any(|v| !v.is_finite()) {
        return Err(GridError::Transform {
            what: "lps_from_camera",
            reason: format!("its position is not finite: {position:?}"),
        });
    }
    // The tolerance of 1e-6 also accepts a pose that was multiplied many times during a long flight and converted to
    // and from JSON.
    if lps_from_camera.is_rigid(1e-6) {
        return Ok(());
    }
    Err(GridError::Transform {
        what: "lps_from_camera",
        reason: format!(
            "its axes are not unit vectors at right angles, right-handed: rows {:?}",
            lps_from_camera.rows()
        ),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{FieldShape, ImageField, Lens, Optics};

    #[test]
    fn a_pinhole_lens_has_the_rays_of_the_pinhole_formula() {
        let plain = Camera::new(Affine::IDENTITY, 1.7, 30, 20).unwrap();
        let optics = Optics::new(&Lens::Pinhole, Some(1.7), 30, 20).unwrap();
        let rays = LensRays::build(optics, &ImageField::FULL).unwrap();
        let lens = Camera::with_lens(Affine::IDENTITY, Arc::new(rays)).unwrap();
        for (column, row) in [(0, 0), (29, 19), (14, 3)] {
            let (a, b) = (
                plain.ray(column, row).dir_lps,
                lens.ray(column, row).dir_lps,
            );
            // The tolerance is needed because directions are stored in f32.
            assert!((0..3).all(|n| (a[n] - b[n]).abs() < 6e-8));
        }
    }

    #[test]
    fn a_ray_beside_a_pixels_centre_has_the_direction_of_the_lens_model() {
        let plain = Camera::new(Affine::IDENTITY, 1.7, 60, 40).unwrap();
        let optics = Optics::new(&Lens::Equidistant, Some(2.0), 60, 40).unwrap();
        let round = ImageField {
            shape: FieldShape::Round,
            ..ImageField::FULL
        };
        let rays = LensRays::build(optics.clone(), &round).unwrap();
        let lens = Camera::with_lens(Affine::IDENTITY, Arc::new(rays)).unwrap();
        let off =
            |a: [f64; 3], b: [f64; 3]| (0..3).map(|n| (a[n] - b[n]).abs()).fold(0.0, f64::max);
        for (column, row) in [(30, 20), (12, 17), (44, 30), (30, 0)] {
            let same = plain.direction_beside(column, row, [0.0; 2]);
            assert!(off(same, plain.ray(column, row).dir_lps) < 1e-15);
            // Half a pixel to the right is half a pixel to the left of the next pixel.
            let (here, next) = (
                plain.direction_beside(column, row, [0.5, 0.25]),
                plain.direction_beside(column + 1, row, [-0.5, 0.25]),
            );
            assert!(off(here, next) < 1e-15);
            let truth = optics
                .direction([column as f64 + 0.75, row as f64 + 0.8])
                .unwrap();
            // The tolerance is large because a pixel is 0.05 rad wide here, and a pixel at the rim has a neighbour on
            // one side only.
            assert!(off(lens.direction_beside(column, row, [0.25, 0.3]), truth) < 1e-3);
        }
        assert_eq!(lens.direction_beside(2, 2, [0.2, 0.2]), [0.0; 3]);
    }

    #[test]
    fn listed_directions_are_the_rays_of_a_picture_of_one_row() {
        let plain = Camera::new(Affine::IDENTITY, 1.7, 60, 40).unwrap();
        let listed = plain.listing(&[[0.0, 0.6, 0.8], [0.0; 3], [0.0, 0.0, 1.0]]);
        assert_eq!((listed.width(), listed.height()), (3, 1));
        assert_eq!(listed.ray(2, 0).dir_lps, [0.0, 0.0, 1.0]);
        assert_eq!(listed.ray(1, 0).dir_lps, [0.0; 3]);
        assert!((listed.ray(0, 0).dir_lps[1] - 0.6).abs() < 1e-7);
    }

    #[test]
    fn the_field_of_view_spans_the_shorter_side() {
        let cam = Camera::new(Affine::IDENTITY, 90f64.to_radians(), 300, 200).unwrap();
        // The centre of the outermost row is half a pixel inside the 45 degree edge.
        let d = cam.ray(150, 0).dir_lps;
        assert!((d[1] / d[2] + (100.0 - 0.5) / 100.0).abs() < 1e-12);
        assert!(d[1] < 0.0, "row 0 is the top, and +y is down");
    }

    #[test]
    fn fields_of_view_up_to_170_degrees_are_accepted_and_zero_or_larger_ones_rejected() {
        for deg in [60.0, 90.0, 120.0, 170.0f64] {
            assert!(Camera::new(Affine::IDENTITY, deg.to_radians(), 64, 64).is_ok());
        }
        for deg in [0.0, 171.0, 180.0, f64::NAN] {
            assert!(Camera::new(Affine::IDENTITY, deg.to_radians(), 64, 64).is_err());
        }
    }

    #[test]
    fn a_mirrored_pose_is_rejected() {
        let mirrored =
            Affine::from_columns([-1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.0; 3]);
        assert!(Camera::new(mirrored, 1.0, 64, 64).is_err());
    }
}
