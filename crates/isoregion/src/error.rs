/// Errors of the input of a map.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum IsoRegionError {
    /// The number of labels does not match the shape.
    #[error(
        "the label volume contains {found} voxels, but its shape (z, y, x) = {shape_zyx:?} requires {expected}"
    )]
    Length {
        /// Requested shape.
        shape_zyx: [usize; 3],
        /// Number of voxels of the shape.
        expected: usize,
        /// Number of voxels found.
        found: usize,
    },
    /// A table of colours covers no value.
    #[error("the colour table is empty; it must cover every value of the volume")]
    EmptyTable,
    /// The caller stopped the computation.
    #[error("stopped while building the IsoRegion map")]
    Cancelled,
}

impl IsoRegionError {
    /// Return the stable error code, shared with Python and the wire.
    #[must_use]
    pub const fn code(&self) -> &'static str {
        match self {
            Self::Length { .. } => "geometry.length",
            Self::EmptyTable => "render.transfer",
            Self::Cancelled => "cancelled",
        }
    }
}

/// Check that the number of labels matches the shape.
pub(crate) fn check_length(found: usize, shape_zyx: [usize; 3]) -> Result<(), IsoRegionError> {
    let expected = shape_zyx.iter().product();
    if found == expected {
        Ok(())
    } else {
        Err(IsoRegionError::Length {
            shape_zyx,
            expected,
            found,
        })
    }
}
