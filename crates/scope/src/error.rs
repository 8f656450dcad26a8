/// What can be wrong with a path to fly on.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum ScopeError {
    /// The points do not make a path.
    #[error("cannot fly on this path: {reason}")]
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
    #[error("the largest deviation from the path must be from 0.2 to 10 mm; found {found_mm} mm")]
    Deviation {
        /// The refused length.
        found_mm: f64,
    },
}

impl ScopeError {
    /// Stable code, shared with Python and the wire.
    #[must_use]
    pub const fn code(&self) -> &'static str {
        match self {
            Self::Path { .. } => "navigate.path",
            Self::Up { .. } => "navigate.up",
            Self::Deviation { .. } => "navigate.deviation",
        }
    }
}
