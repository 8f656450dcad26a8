//! Distortion models of lenses: their radial functions, the inverse functions, and the angles at which they fold back.
//!
//! A model *folds back* at the angle from the axis beyond which the distance from the middle decreases.

use core::f64::consts::PI;

/// Maximum angle from the axis for which a perspective model has a point on the picture: 89.99 degrees, in radians.
const MAX_PERSPECTIVE_ANGLE_RAD: f64 = 89.99 * PI / 180.0;
/// Step of the search for the angle at which a model folds back: 0.01 degrees, in radians.
const FOLD_STEP_RAD: f64 = 0.01 * PI / 180.0;
/// Deviation of the image of a lens from the ideal image.
///
/// Lengths are in focal lengths, angles in radians.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Distortion {
    /// Distortion on the plane at distance 1 (`OpenCV`'s default model).
    ///
    /// `x' = x R(r) + 2 p1 x y + p2 (r^2 + 2 x^2)`, y alike, with
    /// `R = (1 + k1 r^2 + k2 r^4 + k3 r^6) / (1 + k4 r^2 + k5 r^4 + k6 r^6)`.
    Brown {
        /// Coefficients k1 to k6 of the radial part.
        k: [f64; 6],
        /// Coefficients p1 and p2 of the tangential part.
        p: [f64; 2],
    },
    /// Distortion by the angle from the axis (`cv2.fisheye`): `r' = a (1 + k1 a^2 + k2 a^4 + k3 a^6 + k4 a^8)`.
    Fisheye {
        /// Coefficients k1 to k4 of the polynomial.
        k: [f64; 4],
    },
}

impl Distortion {
    /// Perspective image without distortion.
    pub(crate) const NONE: Self = Self::Brown {
        k: [0.0; 6],
        p: [0.0; 2],
    };
    /// Equidistant image without distortion.
    pub(crate) const EQUIDISTANT: Self = Self::Fisheye { k: [0.0; 4] };

    pub(crate) fn is_finite(&self) -> bool {
        match self {
            Self::Brown { k, p } => k.iter().chain(p).all(|v| v.is_finite()),
            Self::Fisheye { k } => k.iter().all(|v| v.is_finite()),
        }
    }

    /// Return the argument of the radial function for an angle: the tangent of the angle (Brown), or the angle
    /// (fisheye).
    pub(crate) fn argument(&self, angle_rad: f64) -> f64 {
        match self {
            Self::Brown { .. } => libm::tan(angle_rad),
            Self::Fisheye { .. } => angle_rad,
        }
    }

    pub(crate) fn widest_angle_rad(&self) -> f64 {
        match self {
            Self::Brown { .. } => MAX_PERSPECTIVE_ANGLE_RAD,
            Self::Fisheye { .. } => PI,
        }
    }

    /// Return the value of the radial function and its derivative at `u`; NaN at a pole of the model.
    ///
    /// The value is the distance from the middle of the picture in focal lengths.
    pub(crate) fn radial(&self, u: f64) -> (f64, f64) {
        let s = u * u;
        match self {
            Self::Brown { k, .. } => {
                let above = 1.0 + s * (k[0] + s * (k[1] + s * k[2]));
                let below = 1.0 + s * (k[3] + s * (k[4] + s * k[5]));
                if below <= 0.0 {
                    return (f64::NAN, f64::NAN);
                }
                // The derivatives d/ds of the numerator and the denominator.
                let above_s = k[0] + s * (2.0 * k[1] + s * 3.0 * k[2]);
                let below_s = k[3] + s * (2.0 * k[4] + s * 3.0 * k[5]);
                let ratio = above / below;
                (
                    u * ratio,
                    ratio + 2.0 * s * (above_s - ratio * below_s) / below,
                )
            }
            Self::Fisheye { k } => (
                u * (1.0 + s * (k[0] + s * (k[1] + s * (k[2] + s * k[3])))),
                1.0 + s * (3.0 * k[0] + s * (5.0 * k[1] + s * (7.0 * k[2] + s * 9.0 * k[3]))),
            ),
        }
    }

    /// Return the largest argument up to which the radial function grows, and the angle that belongs to it.
    pub(crate) fn fold(&self) -> (f64, f64) {
        let grows = |angle: f64| {
            let (r, slope) = self.radial(self.argument(angle));
            r.is_finite() && slope > 0.0
        };
        let widest = self.widest_angle_rad();
        let steps = (widest / FOLD_STEP_RAD) as usize;
        let mut angle = widest;
        if let Some(n) = (1..=steps).find(|&n| !grows(n as f64 * FOLD_STEP_RAD)) {
            let (mut low, mut high) = ((n - 1) as f64 * FOLD_STEP_RAD, n as f64 * FOLD_STEP_RAD);
            while high - low > 1e-12 {
                let middle = f64::midpoint(low, high);
                if grows(middle) {
                    low = middle;
                } else {
                    high = middle;
                }
            }
            angle = low;
        }
        (self.argument(angle), angle)
    }

    /// Return the argument, up to `limit`, at which the radial function is `r`; `None` if there is none.
    ///
    /// The method is Newton's inside a bracket that only shrinks.
    pub(crate) fn inverse(&self, r: f64, limit: f64) -> Option<f64> {
        if *self == Self::NONE || *self == Self::EQUIDISTANT {
            return (r <= limit).then_some(r);
        }
        if r > self.radial(limit).0 {
            return None;
        }
        let (mut low, mut high) = (0.0, limit);
        let mut u = r.min(limit);
        for _ in 0..200 {
            let (value, slope) = self.radial(u);
            if value < r {
                low = u;
            } else {
                high = u;
            }
            let newton = u - (value - r) / slope;
            let next = if newton > low && newton < high {
                newton
            } else {
                f64::midpoint(low, high)
            };
            if (next - u).abs() <= 1e-15 * u.abs().max(1e-300) {
                return Some(next);
            }
            u = next;
        }
        Some(u)
    }
}
