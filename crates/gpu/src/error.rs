use carina_raycast::RaycastError;

/// Errors of casts on the GPU.
///
/// None of them is caused by the viewer, and the CPU can render every picture instead.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum GpuError {
    /// There is no such adapter.
    #[error("there is no graphics adapter {index}; this machine has {count}")]
    NoAdapter {
        /// Requested index.
        index: usize,
        /// Number of adapters.
        count: usize,
    },
    /// The driver did not start, or the device is lost.
    #[error("the graphics device {name} cannot be used: {reason}")]
    Device {
        /// Name of the adapter.
        name: String,
        /// Message of the driver.
        reason: String,
    },
    /// The data do not fit on the device.
    #[error("{what} does not fit in the memory of the graphics device: {reason}")]
    DoesNotFit {
        /// The volume, the radius map or the picture.
        what: &'static str,
        /// Required and available size.
        reason: String,
    },
    /// The frame needs a feature that only the CPU's casters have.
    #[error("the graphics device cannot render this view: {reason}")]
    Unsupported {
        /// Explanation: the feature that the device lacks, or the limit that the frame exceeds.
        reason: String,
    },
    /// Some pixels were not written.
    ///
    /// The picture is rejected, because a wrong picture is worse than none.
    #[error("the graphics device {name} left {num_missing} pixels of an image empty")]
    Incomplete {
        /// Name of the adapter.
        name: String,
        /// Number of pixels without a colour.
        num_missing: usize,
    },
    /// The view is not valid.
    #[error(transparent)]
    Raycast(#[from] RaycastError),
}

impl GpuError {
    /// Return the stable error code, shared with Python.
    ///
    /// `render.gpu-limit` refers to this volume or view only; after `render.gpu` the device must not be used again.
    #[must_use]
    pub const fn code(&self) -> &'static str {
        match self {
            Self::Raycast(e) => e.code(),
            Self::DoesNotFit { .. } | Self::Unsupported { .. } => "render.gpu-limit",
            _ => "render.gpu",
        }
    }
}
