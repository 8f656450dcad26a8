//! Window and level of a picture: conversion of voxel values to grey levels.

use crate::RaycastError;

/// Window and level: the voxel values that become black and white.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Window {
    lo: f32,
    scale: f32,
}

impl Window {
    /// Create a window from `level - width / 2` (black) to `level + width / 2` (white).
    ///
    /// # Errors
    ///
    /// Returns an error if the width is not above 0 or the level is not finite.
    pub fn new(width_hu: f64, level_hu: f64) -> Result<Self, RaycastError> {
        if !(width_hu.is_finite() && width_hu > 0.0 && level_hu.is_finite()) {
            return Err(RaycastError::Setting {
                what: "window",
                expected: "a width above 0 and a finite level".to_owned(),
                found: format!("width {width_hu}, level {level_hu}"),
            });
        }
        Ok(Self {
            lo: (level_hu - width_hu / 2.0) as f32,
            scale: (255.0 / width_hu) as f32,
        })
    }

    /// Return the grey level of a voxel value, 0 to 255.
    #[inline(always)]
    #[must_use]
    pub fn grey(&self, value: f32) -> u8 {
        // The cast saturates below 0 and above 255.
        (value - self.lo).mul_add(self.scale, 0.5) as u8
    }

    /// Return the voxel value that is black, and the number of grey levels per unit of voxel value.
    pub(crate) const fn ramp(self) -> (f32, f32) {
        (self.lo, self.scale)
    }
}
