use carina_grid::GridError;

/// Errors of the options of a phantom.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum PhantomError {
    /// An option is out of range.
    #[error("{what}: expected {expected}, found {found}")]
    Option {
        /// Name of the rejected option.
        what: &'static str,
        /// Values that the option may have.
        expected: &'static str,
        /// Value that the option has.
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
    /// Return the stable code of the error, which Python and the wire protocol also use.
    #[must_use]
    pub const fn code(&self) -> &'static str {
        match self {
            Self::Option { .. } => "phantom.option",
            Self::Grid(error) => error.code(),
            Self::Cancelled => "cancelled",
        }
    }
}
