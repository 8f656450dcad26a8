//! Dimensions of the scope, and the pose of its tip.

use carina_grid::{dot, length};

use crate::ScopeError;

/// Distance between the nodes of the scope's axis, mm.
pub(crate) const NODE_MM: f64 = 2.0;

/// Dimensions of a scope.
///
/// Lengths are in mm, angles in radians.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ScopeBody {
    /// Radius of the rigid tip and of the bending section, mm.
    pub tip_radius_mm: f64,
    /// Radius of the insertion tube, mm.
    pub tube_radius_mm: f64,
    /// Length of the rigid tip, mm.
    pub rigid_mm: f64,
    /// Length of the bending section, mm.
    pub bending_mm: f64,
    /// Largest upward flexion of the tip, radians.
    pub up_rad: f64,
    /// Largest downward flexion of the tip, radians, as a positive number.
    pub down_rad: f64,
    /// Working length of the scope, mm.
    pub length_mm: f64,
}

impl ScopeBody {
    /// Check the dimensions and return them unchanged.
    ///
    /// # Errors
    ///
    /// Returns an error if a dimension is out of range.
    pub fn checked(self) -> Result<Self, ScopeError> {
        let within = |what: &str, value: f64, low: f64, high: f64| {
            if (low..=high).contains(&value) {
                return Ok(());
            }
            Err(ScopeError::Scope {
                reason: format!("expected {what} from {low} to {high}, found {value}"),
            })
        };
        // Below 0.7 mm the tip would be smaller than its rounded edge; 3.9 mm is less than half of the range of the
        // field.
        within("a tip radius (mm)", self.tip_radius_mm, 0.7, 3.9)?;
        within("a tube radius (mm)", self.tube_radius_mm, 0.5, 3.9)?;
        within("a rigid tip (mm)", self.rigid_mm, 2.0, 20.0)?;
        within("a bending section (mm)", self.bending_mm, 10.0, 100.0)?;
        within("a flexion upwards (rad)", self.up_rad, 0.0, 4.0)?;
        within("a flexion downwards (rad)", self.down_rad, 0.0, 4.0)?;
        within("a working length (mm)", self.length_mm, 100.0, 1000.0)?;
        Ok(self)
    }

    pub(crate) fn rigid_nodes(&self) -> usize {
        ((self.rigid_mm / NODE_MM).round() as usize).max(1)
    }

    pub(crate) fn bending_nodes(&self) -> usize {
        ((self.bending_mm / NODE_MM).round() as usize).max(2)
    }

    /// Return the radius of the scope in mm at a distance behind the face.
    pub(crate) fn radius_mm(&self, behind_mm: f64) -> f64 {
        if behind_mm < (self.rigid_nodes() + self.bending_nodes()) as f64 * NODE_MM {
            self.tip_radius_mm
        } else {
            self.tube_radius_mm
        }
    }
}

/// Pose of the tip: the centre of its face and its unit axes, LPS.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Tip {
    pub(crate) at: [f64; 3],
    pub(crate) right: [f64; 3],
    pub(crate) down: [f64; 3],
    pub(crate) forward: [f64; 3],
}

impl Tip {
    pub(crate) fn place(&self, f: [f64; 3]) -> [f64; 3] {
        std::array::from_fn(|a| {
            self.at[a] + f[0] * self.right[a] + f[1] * self.down[a] + f[2] * self.forward[a]
        })
    }
}

/// Plane through which the scope enters the lumen; nothing behind this plane is checked against the wall.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Entry {
    pub(crate) at: [f64; 3],
    pub(crate) into: [f64; 3],
}

impl Entry {
    pub(crate) fn depth_mm(&self, p: [f64; 3]) -> f64 {
        dot(std::array::from_fn(|a| p[a] - self.at[a]), self.into)
    }
}

pub(crate) fn distance(a: [f64; 3], b: [f64; 3]) -> f64 {
    length(std::array::from_fn(|k| a[k] - b[k]))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Dimensions of the scope in these tests.
    const BODY: ScopeBody = ScopeBody {
        tip_radius_mm: 2.45,
        tube_radius_mm: 2.45,
        rigid_mm: 10.0,
        bending_mm: 40.0,
        up_rad: 3.1,
        down_rad: 2.27,
        length_mm: 600.0,
    };

    #[test]
    fn scope_dimensions_out_of_range_are_rejected() {
        assert!(BODY.checked().is_ok());
        assert!(
            ScopeBody {
                tip_radius_mm: f64::NAN,
                ..BODY
            }
            .checked()
            .is_err()
        );
        assert!(
            ScopeBody {
                bending_mm: 0.0,
                ..BODY
            }
            .checked()
            .is_err()
        );
    }
}
