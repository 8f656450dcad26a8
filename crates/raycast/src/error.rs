use carina_grid::GridError;
use carina_isoregion::IsoRegionError;

/// What can be wrong with a view.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum RaycastError {
    /// A transfer function that cannot be used.
    #[error("the transfer function is not usable: {reason}")]
    Transfer {
        /// Why.
        reason: String,
    },
    /// A setting out of range.
    #[error("{what}: expected {expected}, found {found}")]
    Setting {
        /// Which setting.
        what: &'static str,
        /// Allowed values.
        expected: String,
        /// The refused value.
        found: String,
    },
    /// Grid or camera.
    #[error(transparent)]
    Grid(#[from] GridError),
    /// Labels or their map.
    #[error(transparent)]
    IsoRegion(#[from] IsoRegionError),
}

impl RaycastError {
    /// Stable code, shared with Python and the wire.
    #[must_use]
    pub const fn code(&self) -> &'static str {
        match self {
            Self::Transfer { .. } => "render.transfer",
            Self::Setting { .. } => "render.setting",
            Self::Grid(e) => e.code(),
            Self::IsoRegion(e) => e.code(),
        }
    }
}
