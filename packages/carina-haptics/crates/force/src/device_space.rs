//! Coordinate space of a force device.

use carina_grid::{Affine, cross, dot, length};

use crate::ForceError;
use crate::law::{HandForce, HandSample};

/// Transform from the space of a device to LPS: a rotation, a translation and one scale.
pub(crate) struct DeviceSpace {
    lps_from_device: Affine,
    scale: f64,
}

impl DeviceSpace {
    /// Identity, for samples that are in LPS.
    pub(crate) const LPS: Self = Self {
        lps_from_device: Affine::IDENTITY,
        scale: 1.0,
    };

    pub(crate) fn new(lps_from_device: Affine) -> Result<Self, ForceError> {
        let axes = [0, 1, 2].map(|a| lps_from_device.column(a));
        let scale = length(axes[0]);
        let is_even = axes
            .iter()
            .all(|a| (length(*a) - scale).abs() <= 1e-6 * scale);
        let is_square =
            (0..3).all(|a| dot(axes[a], axes[(a + 1) % 3]).abs() <= 1e-6 * scale * scale);
        // A scale above 1 would enlarge every tremor, and the stiffness for the hand grows with the scale.
        if !(is_even && is_square && (0.05..=1.0).contains(&scale)) {
            return Err(ForceError {
                reason: "the device's space may only be rotated, shifted and scaled equally on all axes, by 0.05 to \
                         1 mm in the lumen per mm of hand movement"
                    .to_owned(),
            });
        }
        if dot(cross(axes[0], axes[1]), axes[2]) <= 0.0 {
            return Err(ForceError {
                reason: "the device's space is mirrored: the hand's left would be the scope's right; its three axes \
                         must be right-handed"
                    .to_owned(),
            });
        }
        Ok(Self {
            lps_from_device,
            scale,
        })
    }

    pub(crate) fn to_lps(&self, hand: &HandSample) -> HandSample {
        HandSample {
            at_lps: self.lps_from_device.point(hand.at_lps),
            velocity_mm_s: self.lps_from_device.vector(hand.velocity_mm_s),
            forward_lps: self
                .lps_from_device
                .vector(hand.forward_lps)
                .map(|v| v / self.scale),
        }
    }

    pub(crate) fn to_device(&self, felt: &HandForce) -> HandForce {
        let turned = |v: [f64; 3]| {
            std::array::from_fn(|a| dot(self.lps_from_device.column(a), v) / self.scale)
        };
        HandForce {
            force_n: turned(felt.force_n),
            torque_n_mm: turned(felt.torque_n_mm),
            ..*felt
        }
    }
}
