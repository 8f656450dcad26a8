//! Lens models: conversion between pixels and directions, in f64 with `libm`, so that all platforms give the same bits.
//!
//! Sources: Brown-Conrady with the rational radial term as in `OpenCV`'s `calib3d` ("Camera Calibration and 3D
//! Reconstruction", detailed description); the angular polynomial of Kannala and Brandt 2006 as in `cv2.fisheye`.

use core::f64::consts::PI;

use crate::{Distortion, GridError};

/// Minimum field of view of a camera, 1 degree: a tele lens for a view of a landmark from outside.
pub const MIN_FOV_RAD: f64 = core::f64::consts::PI / 180.0;
/// Maximum field of view of a pinhole camera, 170 degrees: at 180 the image plane is infinite.
pub const MAX_FOV_RAD: f64 = 170.0 * core::f64::consts::PI / 180.0;

/// Maximum relative difference between the scales of width and height, if a calibration is used for another picture
/// size.
///
/// The tolerance allows for rounding to whole pixels.
const ASPECT_TOLERANCE: f64 = 0.01;

/// Result of a camera calibration, for example by `OpenCV` with a chessboard.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Calibration {
    /// Distortion model that was fitted.
    pub distortion: Distortion,
    /// Focal lengths fx and fy, pixels.
    pub focal_px: [f64; 2],
    /// Principal point in corner coordinates: `OpenCV`'s plus 1/2, because its pixel (0, 0) is the *centre* of the
    /// first pixel.
    pub centre_px: [f64; 2],
    /// Width and height of the calibration's pictures, pixels.
    pub size_px: [usize; 2],
}

/// Lens model without regard to the size of the picture.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Lens {
    /// Pinhole lens: straight lines stay straight.
    Pinhole,
    /// Equidistant lens: the distance from the middle of the picture is proportional to the angle from the axis.
    ///
    /// The field of view may exceed 170 degrees.
    Equidistant,
    /// Lens with distortion, whose focal length follows from the field of view.
    Distorted(Distortion),
    /// Calibrated lens, which has its own field of view.
    Calibrated(Calibration),
}

/// Lens in front of a picture of a given size: converts pixels to directions and directions to pixels.
#[derive(Debug, Clone, PartialEq)]
pub struct Optics {
    distortion: Distortion,
    focal_px: [f64; 2],
    centre_px: [f64; 2],
    size_px: [usize; 2],
    /// Largest argument of the lens's radial function for which the lens has a ray.
    limit: f64,
    /// Angle in radians between a ray and the lens axis that belongs to `limit`.
    limit_rad: f64,
    fov_rad: f64,
}

fn refuse<T>(what: &'static str, expected: String, found: String) -> Result<T, GridError> {
    Err(GridError::Camera {
        what,
        expected,
        found,
    })
}

impl Optics {
    /// Combine a lens with the size of a picture.
    ///
    /// `fov_rad` is the full angle across the shorter side; it must be `None` for a calibrated lens, which has its own.
    ///
    /// # Errors
    ///
    /// Returns an error if a value is out of range or the model folds back inside the image circle.
    pub fn new(
        lens: &Lens,
        fov_rad: Option<f64>,
        width: usize,
        height: usize,
    ) -> Result<Self, GridError> {
        if !(1..=8192).contains(&width) || !(1..=8192).contains(&height) {
            return refuse(
                "viewport",
                "1 to 8192 pixels on each side".to_owned(),
                format!("{width} x {height}"),
            );
        }
        let distortion = match lens {
            Lens::Pinhole => Distortion::NONE,
            Lens::Equidistant => Distortion::EQUIDISTANT,
            Lens::Distorted(distortion) => *distortion,
            Lens::Calibrated(calibration) => calibration.distortion,
        };
        if !distortion.is_finite() {
            return refuse(
                "lens",
                "distortion coefficients that are finite numbers".to_owned(),
                format!("{distortion:?}"),
            );
        }
        let (limit, limit_rad) = distortion.fold();
        let mut optics = Self {
            distortion,
            focal_px: [0.0; 2],
            centre_px: [width as f64 / 2.0, height as f64 / 2.0],
            size_px: [width, height],
            limit,
            limit_rad,
            fov_rad: 0.0,
        };
        match (lens, fov_rad) {
            (Lens::Calibrated(calibration), None) => optics.scale_calibration(calibration)?,
            (Lens::Calibrated(_), Some(_)) => {
                return refuse(
                    "field of view",
                    "none, since the calibration has its own".to_owned(),
                    format!("{:.2} degrees", fov_rad.unwrap_or(0.0).to_degrees()),
                );
            }
            (_, fov_rad) => optics.fit_field(fov_rad.unwrap_or(PI / 2.0))?,
        }
        optics.check_circle()?;
        Ok(optics)
    }

    /// Create a placeholder without a lens for a list of single rays, which has only the number of rays.
    pub(crate) const fn of_list(num_rays: usize) -> Self {
        Self {
            distortion: Distortion::NONE,
            focal_px: [1.0; 2],
            centre_px: [0.0; 2],
            size_px: [num_rays, 1],
            limit: f64::INFINITY,
            limit_rad: PI / 2.0,
            fov_rad: PI / 2.0,
        }
    }

    /// Set the focal length so that a field of view covers the shorter side of the picture.
    fn fit_field(&mut self, fov_rad: f64) -> Result<(), GridError> {
        let found = format!("{:.2} degrees", fov_rad.to_degrees());
        if !(MIN_FOV_RAD - 1e-12..=MAX_FOV_RAD + 1e-12).contains(&fov_rad) {
            return refuse("field of view", "1 to 170 degrees".to_owned(), found);
        }
        if fov_rad / 2.0 >= self.limit_rad {
            let widest = 2.0 * self.limit_rad.to_degrees();
            return refuse(
                "field of view",
                format!(
                    "less than {widest:.1} degrees, where this lens model folds back on itself"
                ),
                found,
            );
        }
        let half = self
            .distortion
            .radial(self.distortion.argument(fov_rad / 2.0))
            .0;
        let side = self.size_px[0].min(self.size_px[1]) as f64;
        self.focal_px = [side / 2.0 / half; 2];
        self.fov_rad = fov_rad;
        Ok(())
    }

    fn scale_calibration(&mut self, calibration: &Calibration) -> Result<(), GridError> {
        let (from, to) = (calibration.size_px, self.size_px);
        if from.contains(&0) || from.iter().any(|&side| side > 1 << 20) {
            return refuse(
                "calibration's image size",
                "1 to 1048576 pixels on each side".to_owned(),
                format!("{} x {}", from[0], from[1]),
            );
        }
        let scale = [0, 1].map(|a| to[a] as f64 / from[a] as f64);
        // In small pictures, rounding to whole pixels changes the ratio of the scales by more.
        let rounding = 1.0 / to[0].min(to[1]) as f64;
        if (scale[0] / scale[1] - 1.0).abs() > ASPECT_TOLERANCE + rounding {
            let fit = to[0] as f64 * from[1] as f64 / from[0] as f64;
            return refuse(
                "picture size",
                format!(
                    "the proportions of the calibration's {} x {}, such as {} x {:.0}",
                    from[0], from[1], to[0], fit
                ),
                format!("{} x {}", to[0], to[1]),
            );
        }
        for a in 0..2 {
            let (focal, centre) = (calibration.focal_px[a], calibration.centre_px[a]);
            if !(focal.is_finite() && focal > 0.0) {
                return refuse(
                    "calibration's focal length",
                    "a number of pixels above 0".to_owned(),
                    format!("{focal}"),
                );
            }
            if !(0.0..=from[a] as f64).contains(&centre) {
                return refuse(
                    "calibration's principal point",
                    format!("0 to {} pixels", from[a]),
                    format!("{centre}"),
                );
            }
            self.focal_px[a] = focal * scale[a];
            self.centre_px[a] = centre * scale[a];
        }
        let [w, h] = to.map(|side| side as f64);
        let ends = if w < h {
            [[0.0, h / 2.0], [w, h / 2.0]]
        } else {
            [[w / 2.0, 0.0], [w / 2.0, h]]
        };
        if let [Some(a), Some(b)] = ends.map(|end| self.direction(end)) {
            // The field of view is the sum of the half angles on either side of the axis, which need not be in the
            // middle.
            let angle = |d: [f64; 3]| libm::atan2((d[0] * d[0] + d[1] * d[1]).sqrt(), d[2]);
            self.fov_rad = angle(a) + angle(b);
        }
        Ok(())
    }

    /// Check that the model has a direction for every point of the image circle.
    ///
    /// Outside the circle, the image ends at the angle at which the model folds back.
    fn check_circle(&self) -> Result<(), GridError> {
        let [w, h] = self.size_px.map(|side| side as f64);
        let radius = w.min(h) / 2.0 * (1.0 - 1e-9);
        for n in 0..256 {
            let angle = f64::from(n) * (PI / 128.0);
            let at = [
                w / 2.0 + radius * libm::cos(angle),
                h / 2.0 + radius * libm::sin(angle),
            ];
            if self.direction(at).is_none() {
                return self.refuse_fold();
            }
        }
        Ok(())
    }

    pub(crate) fn refuse_fold<T>(&self) -> Result<T, GridError> {
        refuse(
            "lens",
            "a model that grows from the middle to the edge of the image circle".to_owned(),
            format!(
                "one that folds back {:.1} degrees from the axis, inside the picture",
                self.limit_rad.to_degrees()
            ),
        )
    }

    /// Return the distorted position of a point of the plane at distance 1, and the matrix of the derivatives.
    ///
    /// The function is only for [`Distortion::Brown`].
    fn bend(&self, x: f64, y: f64) -> ([f64; 2], [[f64; 2]; 2]) {
        let Distortion::Brown { p: [p1, p2], .. } = self.distortion else {
            unreachable!("called for perspective models only")
        };
        let u = (x * x + y * y).sqrt();
        let (r, slope) = self.distortion.radial(u);
        let ratio = if u > 0.0 { r / u } else { 1.0 };
        // d ratio / d(x, y) = (slope - ratio) / u^2 * (x, y).
        let bend = if u > 0.0 {
            (slope - ratio) / (u * u)
        } else {
            0.0
        };
        let s = u * u;
        (
            [
                x * ratio + 2.0 * p1 * x * y + p2 * (s + 2.0 * x * x),
                y * ratio + p1 * (s + 2.0 * y * y) + 2.0 * p2 * x * y,
            ],
            [
                [
                    ratio + x * x * bend + 2.0 * p1 * y + 6.0 * p2 * x,
                    x * y * bend + 2.0 * p1 * x + 2.0 * p2 * y,
                ],
                [
                    x * y * bend + 2.0 * p1 * x + 2.0 * p2 * y,
                    ratio + y * y * bend + 6.0 * p1 * y + 2.0 * p2 * x,
                ],
            ],
        )
    }

    /// Return the unit direction, in camera space, of a point of the picture (corner coordinates).
    ///
    /// The result is `None` beyond the angle at which the model folds back, and behind an angular model.
    #[must_use]
    pub fn direction(&self, pixel: [f64; 2]) -> Option<[f64; 3]> {
        let [x, y] = [0, 1].map(|a| (pixel[a] - self.centre_px[a]) / self.focal_px[a]);
        let r = (x * x + y * y).sqrt();
        match self.distortion {
            Distortion::Fisheye { .. } => {
                let angle = self.distortion.inverse(r, self.limit)?;
                let across = if r > 0.0 { libm::sin(angle) / r } else { 0.0 };
                Some([x * across, y * across, libm::cos(angle)])
            }
            Distortion::Brown { p, .. } => {
                let [x, y] = if p == [0.0; 2] {
                    let u = self.distortion.inverse(r, self.limit)?;
                    let scale = if r > 0.0 { u / r } else { 1.0 };
                    [x * scale, y * scale]
                } else {
                    self.straighten([x, y], r)?
                };
                let length = (x * x + y * y + 1.0).sqrt();
                Some([x / length, y / length, 1.0 / length])
            }
        }
    }

    /// Return the undistorted position of a point, by Newton's method in two dimensions; `None` if it does not
    /// converge.
    ///
    /// The method is needed for models with a tangential part.
    fn straighten(&self, bent: [f64; 2], r: f64) -> Option<[f64; 2]> {
        // The tangential part is small, so the iteration starts at the solution of the radial part alone, or at the end
        // of the radial function's range.
        let u = self.distortion.inverse(r, self.limit).unwrap_or(self.limit);
        let scale = if r > 0.0 { u / r } else { 1.0 };
        let [mut x, mut y] = bent.map(|v| v * scale);
        for _ in 0..100 {
            let (at, j) = self.bend(x, y);
            let det = j[0][0] * j[1][1] - j[0][1] * j[1][0];
            // The mapping is turned inside out, so the point is beyond the angle at which the model folds back.
            if !(det > 0.0 && det.is_finite()) {
                return None;
            }
            let off = [at[0] - bent[0], at[1] - bent[1]];
            let step = [
                (j[1][1] * off[0] - j[0][1] * off[1]) / det,
                (j[0][0] * off[1] - j[1][0] * off[0]) / det,
            ];
            (x, y) = (x - step[0], y - step[1]);
            if step[0].abs() + step[1].abs() <= 1e-14 * (1.0 + x.abs() + y.abs()) {
                return ((x * x + y * y).sqrt() <= self.limit).then_some([x, y]);
            }
        }
        None
    }

    /// Return the point of the picture, in corner coordinates, of a direction (camera space, any length above 0).
    ///
    /// The point may be outside the picture. The result is `None` if the lens has no image of the direction.
    #[must_use]
    pub fn pixel(&self, direction: [f64; 3]) -> Option<[f64; 2]> {
        let [x, y, z] = direction;
        if !(x.is_finite() && y.is_finite() && z.is_finite()) {
            return None;
        }
        let across = (x * x + y * y).sqrt();
        let at = match self.distortion {
            Distortion::Fisheye { .. } => {
                let angle = libm::atan2(across, z);
                // The direction straight behind the camera has no defined side.
                if angle > self.limit || (across == 0.0 && z <= 0.0) {
                    return None;
                }
                let scale = if across > 0.0 {
                    self.distortion.radial(angle).0 / across
                } else {
                    0.0
                };
                [x * scale, y * scale]
            }
            Distortion::Brown { .. } => {
                if z <= 0.0 || across / z > self.limit {
                    return None;
                }
                self.bend(x / z, y / z).0
            }
        };
        Some([0, 1].map(|a| self.centre_px[a] + self.focal_px[a] * at[a]))
    }

    /// Return the brightness of the image of a uniform field in a direction, relative to the middle of the picture.
    ///
    /// The brightness combines the apparent size of the pupil seen from the side and the area in the picture of a solid
    /// angle. For a pinhole it is the cos^4 law.
    #[must_use]
    pub fn natural_light(&self, direction: [f64; 3]) -> f64 {
        let [x, y, z] = direction;
        let sine = (x * x + y * y).sqrt();
        if z <= 0.0 {
            return 0.0;
        }
        if sine < 1e-9 {
            return 1.0;
        }
        let angle = libm::atan2(sine, z);
        let (r, slope) = self.distortion.radial(self.distortion.argument(angle));
        let per_rad = match self.distortion {
            Distortion::Brown { .. } => slope / (z * z),
            Distortion::Fisheye { .. } => slope,
        };
        (z * sine / (r * per_rad)).clamp(0.0, 1.0)
    }

    /// Return true if the four quarters of the picture are mirror images of each other.
    #[must_use]
    pub fn is_symmetric(&self) -> bool {
        let [w, h] = self.size_px.map(|side| side as f64);
        let straight = match self.distortion {
            Distortion::Brown { p, .. } => p == [0.0; 2],
            Distortion::Fisheye { .. } => true,
        };
        straight && self.centre_px == [w / 2.0, h / 2.0] && self.focal_px[0] == self.focal_px[1]
    }

    /// Return the full field of view across the shorter side of the picture, radians.
    #[must_use]
    pub const fn fov_rad(&self) -> f64 {
        self.fov_rad
    }

    /// Return the largest angle from the axis of a direction in the picture, radians.
    #[must_use]
    pub const fn limit_rad(&self) -> f64 {
        self.limit_rad
    }

    /// Return the focal lengths along the width and the height, pixels.
    #[must_use]
    pub const fn focal_px(&self) -> [f64; 2] {
        self.focal_px
    }

    /// Return the position of the lens's axis in the picture, in corner coordinates, pixels.
    #[must_use]
    pub const fn centre_px(&self) -> [f64; 2] {
        self.centre_px
    }

    /// Return the distortion model of the lens.
    #[must_use]
    pub const fn distortion(&self) -> Distortion {
        self.distortion
    }

    /// Return the width and the height of the picture, pixels.
    #[must_use]
    pub const fn size_px(&self) -> [usize; 2] {
        self.size_px
    }
}
