use carina_grid::GridError;

/// Errors of the options of a phantom.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum PhantomError {
    /// An option is out of range.
    #[error("{what}: expected {expected}, found {found}")]
    Option {
        /// Name of the option.
        what: &'static str,
        /// Allowed values.
        expected: &'static str,
        /// Rejected value.
        found: String,
    },
    /// The grid of the options is not valid.
    #[error(transparent)]
    Grid(#[from] GridError),
    /// The caller stopped the computation.
    #[error("stopped while generating the phantom")]
    Cancelled,
}

impl PhantomError {
    /// Return the stable error code, shared with Python and the wire.
    #[must_use]
    pub const fn code(&self) -> &'static str {
        match self {
            Self::Option { .. } => "phantom.option",
            Self::Grid(error) => error.code(),
            Self::Cancelled => "cancelled",
        }
    }
}
