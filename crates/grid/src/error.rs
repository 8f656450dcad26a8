/// Errors of grids and cameras.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum GridError {
    /// An axis has no voxels, or there are more voxels than an index can count.
    #[error(
        "a volume must have at least one voxel along each axis and at most 2^31 in all; found shape (z, y, x) = {shape_zyx:?}"
    )]
    Shape {
        /// Rejected shape.
        shape_zyx: [usize; 3],
    },
    /// The matrix cannot be inverted, contains NaN, or its last row is not 0 0 0 1.
    #[error("{what} is not a usable transform: {reason}")]
    Transform {
        /// Name of the matrix.
        what: &'static str,
        /// Reason of the error.
        reason: String,
    },
    /// The number of values does not match the shape.
    #[error(
        "the volume's data contains {found} voxels, but its shape {shape_zyx:?} requires {expected}"
    )]
    Length {
        /// Requested shape.
        shape_zyx: [usize; 3],
        /// Number of voxels of the shape.
        expected: usize,
        /// Number of values found.
        found: usize,
    },
    /// The field of view or the viewport is out of range.
    #[error("{what}: expected {expected}, found {found}")]
    Camera {
        /// Name of the setting.
        what: &'static str,
        /// Allowed values.
        expected: String,
        /// Rejected value.
        found: String,
    },
}

impl GridError {
    /// Return the stable error code, shared with Python and the wire.
    #[must_use]
    pub const fn code(&self) -> &'static str {
        match self {
            Self::Shape { .. } => "geometry.shape",
            Self::Transform { .. } => "geometry.transform",
            Self::Length { .. } => "geometry.length",
            Self::Camera { .. } => "render.camera",
        }
    }
}
