/// What can go wrong on the way from a volume to a path.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum TrackError {
    /// The caller asked to stop.
    #[error("stopped on request")]
    Cancelled,
    /// Anatomy that the question needs is not in the volume.
    #[error("{0}")]
    NoResult(String),
    /// An argument is out of range.
    #[error("{what}: expected {expected}, found {found}")]
    Argument {
        /// Which argument.
        what: &'static str,
        /// Allowed values.
        expected: String,
        /// The refused value.
        found: String,
    },
    /// Edge costs span more than the integer queue can count.
    #[error(
        "the range of the path costs is too wide: the most expensive edge costs {ratio:.3e} times as much as the \
         cheapest; narrow the range of the costs"
    )]
    CostRange {
        /// Dearest over cheapest edge.
        ratio: f64,
    },
    /// A path costs more than the tracker can count.
    #[error(
        "a path costs more than {most:.3e}, the highest cost that the path search can represent to within 0.5 %; \
         search a smaller region, or narrow the range of the weights"
    )]
    CostOverflow {
        /// Greatest cost that can be counted.
        most: f64,
    },
}

impl TrackError {
    /// Stable code, shared with Python and the wire.
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

/// Whoever started long work: told how far it is, and asked whether to go on.
pub trait Watch: Sync {
    /// Called between chunks of work with the share done (0..1) of the present stage.
    fn go_on(&self, share: f64) -> Result<(), TrackError>;
}

/// Nobody watches: never stops.
#[derive(Debug, Clone, Copy)]
pub struct Unwatched;

impl Watch for Unwatched {
    fn go_on(&self, _share: f64) -> Result<(), TrackError> {
        Ok(())
    }
}
