/// Errors of the search for paths in a volume.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum TrackError {
    /// The caller stopped the search.
    #[error("stopped on request")]
    Cancelled,
    /// The volume does not contain a structure that the search needs, such as a trachea; the text names it.
    #[error("{0}")]
    NoResult(String),
    /// An argument is out of range.
    #[error("{what}: expected {expected}, found {found}")]
    Argument {
        /// Name of the rejected argument.
        what: &'static str,
        /// Values that the argument may have.
        expected: String,
        /// Value that the argument has.
        found: String,
    },
    /// The ratio between the most expensive and the cheapest edge is too large for the integer queue.
    #[error(
        "the range of the path costs is too wide: the most expensive edge costs {ratio:.3e} times as much as the \
         cheapest; narrow the range of the costs"
    )]
    CostRange {
        /// Ratio of the largest edge cost to the smallest.
        ratio: f64,
    },
    /// The cost of a path is larger than the tracker can represent.
    #[error(
        "a path costs more than {most:.3e}, the highest cost that the path search can represent to within 0.5 %; \
         search a smaller region, or narrow the range of the weights"
    )]
    CostOverflow {
        /// Largest path cost that can be represented.
        most: f64,
    },
}

impl TrackError {
    /// Return the stable code of the error, which Python and the wire protocol also use.
    #[must_use]
    pub const fn code(&self) -> &'static str {
        match self {
            Self::Cancelled => "cancelled",
            Self::NoResult(_) => "track.no-result",
            Self::Argument { .. } => "usage.track",
            Self::CostRange { .. } => "track.cost-range",
            Self::CostOverflow { .. } => "track.cost-overflow",
        }
    }
}

/// Observer of a long computation: receives the progress and can stop the computation.
pub trait Watch: Sync {
    /// Report the completed fraction (0 to 1) of the current stage of the computation.
    ///
    /// # Errors
    ///
    /// Returns an error if the computation must stop.
    fn report_fraction(&self, fraction: f64) -> Result<(), TrackError>;
}

/// Observer that never stops the computation.
#[derive(Debug, Clone, Copy)]
pub struct Unwatched;

impl Watch for Unwatched {
    fn report_fraction(&self, _fraction: f64) -> Result<(), TrackError> {
        Ok(())
    }
}
