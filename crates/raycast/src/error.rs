use carina_grid::GridError;
use carina_isoregion::IsoRegionError;

/// Errors of views and their settings.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum RaycastError {
    /// A transfer function is not valid.
    #[error("the transfer function is not usable: {reason}")]
    Transfer {
        /// Reason why the transfer function is not valid.
        reason: String,
    },
    /// A setting is out of range.
    #[error("{what}: expected {expected}, found {found}")]
    Setting {
        /// Name of the setting.
        what: &'static str,
        /// Allowed values.
        expected: String,
        /// Rejected value.
        found: String,
    },
    /// A grid or a camera is not valid.
    #[error(transparent)]
    Grid(#[from] GridError),
    /// Labels or their map are not valid.
    #[error(transparent)]
    IsoRegion(#[from] IsoRegionError),
}

impl RaycastError {
    /// Return the stable error code, shared with Python and the wire.
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
