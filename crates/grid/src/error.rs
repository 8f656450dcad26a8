/// What can be wrong with a grid or a camera.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum GridError {
    /// An axis without voxels, or more voxels than an index can count.
    #[error(
        "a volume must have at least one voxel along each axis and at most 2^31 in all; found shape (z, y, x) = {shape_zyx:?}"
    )]
    Shape {
        /// The refused shape.
        shape_zyx: [usize; 3],
    },
    /// The matrix cannot be inverted, holds NaN, or its last row is not 0 0 0 1.
    #[error("{what} is not a usable transform: {reason}")]
    Transform {
        /// Which matrix.
        what: &'static str,
        /// Why.
        reason: String,
    },
    /// Data and shape disagree.
    #[error(
        "the volume's data contains {found} voxels, but its shape {shape_zyx:?} requires {expected}"
    )]
    Length {
        /// The shape asked for.
        shape_zyx: [usize; 3],
        /// Voxels by shape.
        expected: usize,
        /// Voxels found.
        found: usize,
    },
    /// Field of view or viewport out of range.
    #[error("{what}: expected {expected}, found {found}")]
    Camera {
        /// Which setting.
        what: &'static str,
        /// Allowed values.
        expected: String,
        /// The refused value.
        found: String,
    },
}

impl GridError {
    /// Stable code, shared with Python and the wire.
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
