/// Errors of paths, walls and scopes.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum ScopeError {
    /// The points are not a path.
    #[error("cannot fly along this path: {reason}")]
    Path {
        /// Reason why the points are not a path.
        reason: String,
    },
    /// The up direction of a curve has no length, or is along the first gaze.
    #[error("cannot orient the view: the up direction {reason}")]
    Up {
        /// Reason why the up direction is not valid.
        reason: &'static str,
    },
    /// The allowed deviation of a curve from its path is too small for smoothing, or not a length.
    #[error(
        "the largest deviation from the path must be between 0.2 and 10 mm; found {found_mm} mm"
    )]
    Deviation {
        /// Rejected length, mm.
        found_mm: f64,
    },
    /// The wall field cannot be computed.
    #[error("cannot compute the distances to the wall: {reason}")]
    Wall {
        /// Reason why the wall field cannot be computed.
        reason: String,
    },
    /// The dimensions of a scope are not valid, or the scope cannot be placed at the requested position.
    #[error("cannot drive this scope: {reason}")]
    Scope {
        /// Reason of the error.
        reason: String,
    },
    /// The caller stopped the computation.
    #[error("stopped")]
    Cancelled,
}

impl ScopeError {
    /// Return the stable code of the error, which Python and the wire protocol also use.
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
