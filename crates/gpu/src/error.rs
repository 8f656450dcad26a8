use carina_raycast::RaycastError;

/// Errors of casts on the GPU.
///
/// After any of these errors the CPU can render the picture instead.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum GpuError {
    /// The machine has no adapter at the requested index.
    #[error("there is no graphics adapter {index}; this machine has {count}")]
    NoAdapter {
        /// Requested index of an adapter.
        index: usize,
        /// Number of adapters of this machine.
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
    /// The data need more memory than the device has.
    #[error("{what} does not fit in the memory of the graphics device: {reason}")]
    DoesNotFit {
        /// Name of the data: the volume, the radius map or the picture.
        what: &'static str,
        /// Required and available size as text.
        reason: String,
    },
    /// The frame needs a feature that only the CPU's casters have.
    #[error("the graphics device cannot render this view: {reason}")]
    Unsupported {
        /// Feature that the device lacks, or limit that the frame exceeds, as text.
        reason: String,
    },
    /// The device did not write some pixels.
    ///
    /// The picture is rejected, because a wrong picture is worse than none.
    #[error("the graphics device {name} left {num_missing} pixels of an image empty")]
    Incomplete {
        /// Name of the adapter.
        name: String,
        /// Number of pixels that were not written.
        num_missing: usize,
    },
    /// The settings of the view are not valid.
    #[error(transparent)]
    Raycast(#[from] RaycastError),
}

impl GpuError {
    /// Return the stable code of the error, which Python also uses.
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
