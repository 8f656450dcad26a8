/// Errors of the input from which an `IsoRegion` map (radii of cubes of equal labels) is built.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum IsoRegionError {
    /// The number of labels does not match the shape of the volume.
    #[error(
        "the label volume contains {found} voxels, but its shape (z, y, x) = {shape_zyx:?} requires {expected}"
    )]
    Length {
        /// Shape (z, y, x) of the volume.
        shape_zyx: [usize; 3],
        /// Number of voxels that the given shape has.
        expected: usize,
        /// Number of labels that were passed.
        found: usize,
    },
    /// A table of colours over HU has no entry.
    #[error("the colour table is empty; it must cover every value of the volume")]
    EmptyTable,
    /// The caller cancelled the construction of the map.
    #[error("stopped while building the IsoRegion map")]
    Cancelled,
}

impl IsoRegionError {
    /// Return the stable code of the error, which Python and the wire protocol also use.
    #[must_use]
    pub const fn code(&self) -> &'static str {
        match self {
            Self::Length { .. } => "geometry.length",
            Self::EmptyTable => "render.transfer",
            Self::Cancelled => "cancelled",
        }
    }
}

/// Check that the number of labels (`found`) matches the shape of the volume.
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
