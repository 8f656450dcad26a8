use carina_raycast::RaycastError;

/// Why there is no picture from the GPU. None of these is the viewer's fault: the CPU can render every one.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum GpuError {
    /// No such adapter.
    #[error("there is no graphics adapter {index}; this machine has {count}")]
    NoAdapter {
        /// What was asked for.
        index: usize,
        /// How many there are.
        count: usize,
    },
    /// The driver would not start, or the device is gone.
    #[error("the graphics device {name} cannot be used: {reason}")]
    Device {
        /// The adapter.
        name: String,
        /// In the driver's words.
        reason: String,
    },
    /// More than the device holds.
    #[error("{what} does not fit in the memory of the graphics device: {reason}")]
    DoesNotFit {
        /// The volume, the radius map, the picture.
        what: &'static str,
        /// What was asked for and what there is.
        reason: String,
    },
    /// Something that only the CPU's casters do.
    #[error("the graphics device cannot render this view: {reason}")]
    Unsupported {
        /// Which thing.
        reason: String,
    },
    /// Some pixels came back unwritten. The picture is refused: a wrong one is worse than none.
    #[error("the graphics device {name} left {num_missing} pixels of an image empty")]
    Incomplete {
        /// The adapter.
        name: String,
        /// Pixels without a colour.
        num_missing: usize,
    },
    /// The view itself.
    #[error(transparent)]
    Raycast(#[from] RaycastError),
}

impl GpuError {
    /// Stable code, shared with Python. `render.gpu-limit` is about this volume or view; after `render.gpu` the device is
    /// not to be used again.
    #[must_use]
    pub const fn code(&self) -> &'static str {
        match self {
            Self::Raycast(e) => e.code(),
            Self::DoesNotFit { .. } | Self::Unsupported { .. } => "render.gpu-limit",
            _ => "render.gpu",
        }
    }
}
