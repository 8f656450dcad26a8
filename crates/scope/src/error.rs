/// What can be wrong with a path, a wall or a scope.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum ScopeError {
    /// The points do not make a path.
    #[error("cannot fly along this path: {reason}")]
    Path {
        /// Why.
        reason: String,
    },
    /// The up direction has no length, or lies along the first gaze.
    #[error("cannot orient the view: the up direction {reason}")]
    Up {
        /// Why.
        reason: &'static str,
    },
    /// The allowed deviation is too small to smooth with, or not a length.
    #[error(
        "the largest deviation from the path must be between 0.2 and 10 mm; found {found_mm} mm"
    )]
    Deviation {
        /// The refused length.
        found_mm: f64,
    },
    /// The wall's field cannot be made.
    #[error("cannot compute the distances to the wall: {reason}")]
    Wall {
        /// Why.
        reason: String,
    },
    /// A scope's sizes are unusable, or it cannot be put where it was asked for.
    #[error("cannot drive this scope: {reason}")]
    Scope {
        /// Why.
        reason: String,
    },
    /// The caller stopped the work.
    #[error("stopped")]
    Cancelled,
}

impl ScopeError {
    /// Stable code, shared with Python and the wire.
    #[must_use]
    pub const fn code(&self) -> &'static str {
        match self {
            Self::Path { .. } => "navigate.path",
            Self::Up { .. } => "navigate.up",
            Self::Deviation { .. } => "navigate.deviation",
            Self::Wall { .. } => "scope.wall",
            Self::Scope { .. } => "scope.drive",
            Self::Cancelled => "cancelled",
        }
    }
}
