use carina_grid::GridError;
use carina_isoregion::IsoRegionError;

/// Errors of a view's settings, transfer function, grid or maps.
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
        /// Name of the rejected setting.
        what: &'static str,
        /// Description of the values that the setting may have.
        expected: String,
        /// Description of the value that was passed.
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
    /// Return the stable code of the error, which Python and the wire protocol also use.
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
