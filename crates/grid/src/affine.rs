use crate::GridError;

/// Affine map between two 3D spaces: the upper three rows of a 4x4 matrix, column vectors, f64.
///
/// Name a value `a_from_b`, so that the names in a product match: `a_from_c = a_from_b.after(&b_from_c)`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Affine {
    rows: [[f64; 4]; 3],
}

impl Affine {
    /// Map that leaves every point unchanged.
    pub const IDENTITY: Self = Self {
        rows: [
            [1.0, 0.0, 0.0, 0.0],
            [0.0, 1.0, 0.0, 0.0],
            [0.0, 0.0, 1.0, 0.0],
        ],
    };

    /// Create a map from the upper three rows of a 4x4 matrix, whose last row is 0 0 0 1.
    #[must_use]
    pub const fn from_rows(rows: [[f64; 4]; 3]) -> Self {
        Self { rows }
    }

    /// Create a map from the images of the three axes and of the origin.
    #[must_use]
    pub fn from_columns(x: [f64; 3], y: [f64; 3], z: [f64; 3], origin: [f64; 3]) -> Self {
        Self {
            rows: std::array::from_fn(|r| [x[r], y[r], z[r], origin[r]]),
        }
    }

    /// Create a map from a row-major 4x4 matrix.
    ///
    /// # Errors
    ///
    /// Returns an error if the matrix is not affine, not finite, or singular.
    pub fn from_matrix(what: &'static str, matrix: &[[f64; 4]; 4]) -> Result<Self, GridError> {
        let refuse = |reason: &str| {
            Err(GridError::Transform {
                what,
                reason: reason.to_owned(),
            })
        };
        if matrix.iter().flatten().any(|v| !v.is_finite()) {
            return refuse("it holds values that are not finite");
        }
        if matrix[3] != [0.0, 0.0, 0.0, 1.0] {
            return refuse("its last row is not 0 0 0 1");
        }
        let affine = Self::from_rows([matrix[0], matrix[1], matrix[2]]);
        if affine.inverse().is_none() {
            return refuse("its determinant is 0");
        }
        Ok(affine)
    }

    /// Return the upper three rows of the map's 4x4 matrix.
    #[must_use]
    pub const fn rows(&self) -> &[[f64; 4]; 3] {
        &self.rows
    }

    /// Return the image of axis 0, 1 or 2 (a vector with length), or of the origin (3).
    #[must_use]
    pub fn column(&self, index: usize) -> [f64; 3] {
        std::array::from_fn(|r| self.rows[r][index])
    }

    /// Return the image of a point under the map.
    #[must_use]
    #[inline]
    pub fn point(&self, p: [f64; 3]) -> [f64; 3] {
        std::array::from_fn(|r| {
            let [a, b, c, d] = self.rows[r];
            a * p[0] + b * p[1] + c * p[2] + d
        })
    }

    /// Return the image of a direction or an offset under the map, without the translation.
    #[must_use]
    #[inline]
    pub fn vector(&self, v: [f64; 3]) -> [f64; 3] {
        std::array::from_fn(|r| {
            let [a, b, c, _] = self.rows[r];
            a * v[0] + b * v[1] + c * v[2]
        })
    }

    /// Return the composition of `self` after `first`: `a_from_c = a_from_b.after(&b_from_c)`.
    #[must_use]
    pub fn after(&self, first: &Self) -> Self {
        Self::from_columns(
            self.vector(first.column(0)),
            self.vector(first.column(1)),
            self.vector(first.column(2)),
            self.point(first.column(3)),
        )
    }

    /// Return the determinant of the map's linear part.
    #[must_use]
    pub fn determinant(&self) -> f64 {
        crate::dot(self.column(0), crate::cross(self.column(1), self.column(2)))
    }

    /// Return the inverse map; `None` if the map is singular.
    #[must_use]
    pub fn inverse(&self) -> Option<Self> {
        let (x, y, z) = (self.column(0), self.column(1), self.column(2));
        let volume = crate::length(x) * crate::length(y) * crate::length(z);
        let det = self.determinant();
        // The limit is relative to the volume of the box of the axes, so that a grid of 0.01 mm voxels does not count
        // as singular.
        if !det.is_finite() || det.abs() <= 1e-9 * volume || volume == 0.0 {
            return None;
        }
        // Rows of the inverse are cross products of the columns.
        let r0 = crate::cross(y, z).map(|v| v / det);
        let r1 = crate::cross(z, x).map(|v| v / det);
        let r2 = crate::cross(x, y).map(|v| v / det);
        let o = self.column(3);
        Some(Self::from_rows(
            [r0, r1, r2].map(|r| [r[0], r[1], r[2], -crate::dot(r, o)]),
        ))
    }

    /// Return true if the map's axes have length 1 and are perpendicular and right-handed, within `tolerance`.
    #[must_use]
    pub fn is_rigid(&self, tolerance: f64) -> bool {
        let axes = [self.column(0), self.column(1), self.column(2)];
        (0..3).all(|a| {
            (0..3).all(|b| {
                (crate::dot(axes[a], axes[b]) - f64::from(u8::from(a == b))).abs() <= tolerance
            })
        }) && self.determinant() > 0.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn oblique(angles: [f64; 3], spacing: [f64; 3], origin: [f64; 3]) -> Affine {
        let (s, c) = (angles.map(libm::sin), angles.map(libm::cos));
        let rot = |axis: usize, sin: f64, cos: f64| {
            let (a, b) = ((axis + 1) % 3, (axis + 2) % 3);
            let mut rows = *Affine::IDENTITY.rows();
            rows[a][a] = cos;
            rows[b][b] = cos;
            rows[a][b] = -sin;
            rows[b][a] = sin;
            Affine::from_rows(rows)
        };
        let r = rot(0, s[0], c[0])
            .after(&rot(1, s[1], c[1]))
            .after(&rot(2, s[2], c[2]));
        Affine::from_columns(
            r.column(0).map(|v| v * spacing[0]),
            r.column(1).map(|v| v * spacing[1]),
            r.column(2).map(|v| v * spacing[2]),
            origin,
        )
    }

    proptest! {
        #[test]
        fn the_inverse_map_returns_every_point(
            angles in prop::array::uniform3(-3.0f64..3.0),
            spacing in prop::array::uniform3(0.05f64..9.0),
            origin in prop::array::uniform3(-500.0f64..500.0),
            p in prop::array::uniform3(-600.0f64..600.0),
        ) {
            let a = oblique(angles, spacing, origin);
            let back = a.inverse().unwrap().point(a.point(p));
            for axis in 0..3 {
                // The tolerance of 1e-9 allows for some 2000 mm through two maps in f64, divided by the smallest
                // spacing.
                prop_assert!((back[axis] - p[axis]).abs() < 1e-9);
            }
        }

        #[test]
        fn a_composed_map_equals_the_successive_application_of_its_parts(
            first in prop::array::uniform3(-3.0f64..3.0),
            second in prop::array::uniform3(-3.0f64..3.0),
            p in prop::array::uniform3(-100.0f64..100.0),
        ) {
            let a = oblique(first, [0.7, 0.8, 2.5], [1.0, 2.0, 3.0]);
            let b = oblique(second, [1.0, 1.0, 1.0], [-4.0, 5.0, 6.0]);
            let (whole, parts) = (b.after(&a).point(p), b.point(a.point(p)));
            for axis in 0..3 {
                prop_assert!((whole[axis] - parts[axis]).abs() < 1e-9);
            }
        }
    }

    #[test]
    fn a_singular_or_non_finite_matrix_is_rejected() {
        let mut m = [
            [1.0, 0.0, 0.0, 0.0],
            [0.0, 1.0, 0.0, 0.0],
            [0.0, 0.0, 1.0, 0.0],
            [0.0, 0.0, 0.0, 1.0],
        ];
        assert!(Affine::from_matrix("test", &m).is_ok());
        m[2][2] = 0.0;
        assert!(Affine::from_matrix("test", &m).is_err());
        m[2][2] = f64::NAN;
        assert!(Affine::from_matrix("test", &m).is_err());
        m[2][2] = 1.0;
        m[3][0] = 0.1;
        assert!(Affine::from_matrix("test", &m).is_err());
    }
}
