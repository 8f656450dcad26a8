/// Errors of grids and cameras.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum GridError {
    /// An axis has no voxels, or there are more voxels than an index can count.
    #[error(
        "a volume must have at least one voxel along each axis and at most 2^31 in all; found shape (z, y, x) = {shape_zyx:?}"
    )]
    Shape {
        /// Rejected shape (z, y, x).
        shape_zyx: [usize; 3],
    },
    /// A transform cannot be inverted, contains NaN, or its last row is not 0 0 0 1.
    #[error("{what} is not a usable transform: {reason}")]
    Transform {
        /// Name of the rejected matrix.
        what: &'static str,
        /// Reason why the matrix is rejected.
        reason: String,
    },
    /// The number of a volume's values does not match its shape.
    #[error(
        "the volume's data contains {found} voxels, but its shape {shape_zyx:?} requires {expected}"
    )]
    Length {
        /// Shape (z, y, x) of the volume.
        shape_zyx: [usize; 3],
        /// Number of voxels of the shape.
        expected: usize,
        /// Number of values of the volume.
        found: usize,
    },
    /// A setting of a camera or lens is out of range.
    #[error("{what}: expected {expected}, found {found}")]
    Camera {
        /// Name of the rejected setting.
        what: &'static str,
        /// Values that the setting may have.
        expected: String,
        /// Value that the setting has.
        found: String,
    },
}

impl GridError {
    /// Return the stable code of the error, which Python and the wire protocol also use.
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
