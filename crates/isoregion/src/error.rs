/// What can be wrong with the input of a map.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum IsoRegionError {
    /// Labels and shape disagree.
    #[error(
        "the label volume contains {found} voxels, but its shape (z, y, x) = {shape_zyx:?} requires {expected}"
    )]
    Length {
        /// The shape asked for.
        shape_zyx: [usize; 3],
        /// Voxels by shape.
        expected: usize,
        /// Voxels found.
        found: usize,
    },
    /// A table of colours that covers no value.
    #[error("the colour table is empty; it must cover every value of the volume")]
    EmptyTable,
    /// The caller asked to stop.
    #[error("stopped while building the IsoRegion map")]
    Cancelled,
}

impl IsoRegionError {
    /// Stable code, shared with Python and the wire.
    #[must_use]
    pub const fn code(&self) -> &'static str {
        match self {
            Self::Length { .. } => "geometry.length",
            Self::EmptyTable => "render.transfer",
            Self::Cancelled => "cancelled",
        }
    }
}

/// Refuses labels that do not fill the shape.
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
