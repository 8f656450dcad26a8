//! What a wall's place on its airway is: phase of the rings, front and back, and which parts of decoration belong there.
//!
//! A coarse grid along the patient's axes, made from the airway tree by whoever knows anatomy. The lighting reads it at
//! the wall of each pixel, between its cells; casting never sees it, so it moves no surface (docs/decisions/0105).

use crate::RaycastError;

/// Numbers in a cell: phase of the rings, place across the airway to the left and to the back in radii; then, 0..1, rings,
/// proximal colour, ridge of a fork, membranous wall and evenness of the rings.
pub const CHANNELS: usize = 8;

/// Anatomy of walls on a coarse grid; zeros where there is none.
#[derive(Debug, Clone, Copy)]
pub struct Decoration<'a> {
    /// Two for each cell, x fastest.
    pub(crate) cells: &'a [[f32; 4]],
    pub(crate) shape_ijk: [i32; 3],
    pub(crate) origin_lps: [f32; 3],
    pub(crate) cells_per_mm: f32,
}

impl<'a> Decoration<'a> {
    /// Cells of [`CHANNELS`] finite numbers, `[z, y, x, channel]`, the first one's middle at `origin_lps`.
    pub fn new(
        numbers: &'a [f32],
        shape_zyx: [usize; 3],
        origin_lps: [f32; 3],
        cell_mm: f32,
    ) -> Result<Self, RaycastError> {
        let refuse = |expected: &str, found: String| {
            Err(RaycastError::Setting {
                what: "decoration",
                expected: expected.to_owned(),
                found,
            })
        };
        let num_cells = shape_zyx
            .iter()
            .try_fold(1usize, |product, &n| product.checked_mul(n))
            .filter(|&n| n < 1 << 29);
        let (cells, rest) = numbers.as_chunks::<4>();
        if shape_zyx.iter().any(|&n| n < 2)
            || !rest.is_empty()
            || num_cells.is_none_or(|n| 2 * n != cells.len())
        {
            return refuse(
                "two cells or more along each axis, of 8 numbers each",
                format!("{} numbers for {shape_zyx:?} cells", numbers.len()),
            );
        }
        if !(0.1..=100.0).contains(&cell_mm) || origin_lps.iter().any(|v| !v.is_finite()) {
            return refuse(
                "cells of 0.1 to 100 mm at a finite place",
                format!("{cell_mm} mm at {origin_lps:?}"),
            );
        }
        let [nz, ny, nx] = shape_zyx.map(|n| n as i32);
        Ok(Self {
            cells,
            shape_ijk: [nx, ny, nz],
            origin_lps,
            cells_per_mm: 1.0 / cell_mm,
        })
    }
}
