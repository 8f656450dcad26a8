//! Error of the force law and of the force loop.

/// Error for a parameter of the law that is out of range, or for a loop that cannot run.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("cannot compute the force: {reason}")]
pub struct ForceError {
    /// Reason of the error as text.
    pub reason: String,
}

impl ForceError {
    /// Return the stable code of the error, which Python also uses.
    #[must_use]
    pub const fn code(&self) -> &'static str {
        "scope.force"
    }
}
