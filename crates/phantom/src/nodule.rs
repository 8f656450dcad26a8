//! Nodule in the lung of a phantom.

/// Round nodule of the lung.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Nodule {
    /// Centre of the nodule, LPS mm.
    pub centre_lps: [f64; 3],
    /// Radius of the nodule, mm.
    pub radius_mm: f64,
    /// Id of the airway that is nearest to the nodule.
    pub branch_id: usize,
    /// Distance of the nodule's centre from the centreline of that airway, mm.
    pub distance_mm: f64,
}
