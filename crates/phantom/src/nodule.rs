//! Nodule in the lung.

/// Round lesion.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Nodule {
    /// Centre, LPS mm.
    pub centre_lps: [f64; 3],
    /// Radius, mm.
    pub radius_mm: f64,
    /// Id of the nearest airway.
    pub branch_id: usize,
    /// Distance of its centre from that airway's centreline, mm.
    pub distance_mm: f64,
}
