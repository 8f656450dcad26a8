//! The error of the force law and of the force loop.

/// A parameter of the law is out of range, or the loop cannot run.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("cannot compute the force: {reason}")]
pub struct ForceError {
    /// Cause in words.
    pub reason: String,
}

impl ForceError {
    /// Stable error code, the same in Python.
    #[must_use]
    pub const fn code(&self) -> &'static str {
        "scope.force"
    }
}
