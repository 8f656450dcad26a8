use carina_grid::GridError;

/// What can be wrong with the options of a phantom.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum PhantomError {
    /// An option is out of range.
    #[error("{what}: expected {expected}, found {found}")]
    Option {
        /// Which option.
        what: &'static str,
        /// Allowed values.
        expected: &'static str,
        /// The refused value.
        found: String,
    },
    /// The grid that the options ask for cannot exist.
    #[error(transparent)]
    Grid(#[from] GridError),
    /// The caller asked to stop.
    #[error("stopped while generating the phantom")]
    Cancelled,
}

impl PhantomError {
    /// Stable code, shared with Python and the wire.
    #[must_use]
    pub const fn code(&self) -> &'static str {
        match self {
            Self::Option { .. } => "phantom.option",
            Self::Grid(error) => error.code(),
            Self::Cancelled => "cancelled",
        }
    }
}
