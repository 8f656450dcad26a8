//! Coarse grid of anatomical data (position along and around the airway), from which rings, membranous wall and ridges
//! are drawn.
//!
//! The caller computes the grid along the patient's axes from the airway tree. The shading interpolates the grid at the
//! wall of each pixel. The casters do not read the grid, so it changes the colour of a wall but not its position
//! (docs/decisions/0133).

use crate::RaycastError;

/// Number of anatomical values in a cell of the grid.
///
/// The values are: phase of the rings along the airway; position across the airway, to the left and to the back, as
/// multiples of its radius; then, each from 0 to 1, strength of the rings, nearness to the trachea (for the colour),
/// strength of a fork's ridge, strength of the membranous wall, and regularity of the rings.
pub const CHANNELS: usize = 8;

/// Anatomical data of airway walls on a coarse grid; zeros where there is no wall.
#[derive(Debug, Clone, Copy)]
pub struct Decoration<'a> {
    /// Anatomical data of the decoration's cells, two items of four numbers per cell, x fastest.
    pub(crate) cells: &'a [[f32; 4]],
    pub(crate) shape_ijk: [i32; 3],
    pub(crate) origin_lps: [f32; 3],
    pub(crate) cells_per_mm: f32,
}

impl<'a> Decoration<'a> {
    /// Create a decoration from cells of [`CHANNELS`] finite numbers, `[z, y, x, channel]`.
    ///
    /// The centre of the first cell is at `origin_lps`.
    ///
    /// # Errors
    ///
    /// Returns an error if the number of values does not match the shape, or if a value is not valid.
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

    /// Return the values of the cells, two items of four numbers per cell, x fastest.
    #[must_use]
    pub const fn cells(&self) -> &'a [[f32; 4]] {
        self.cells
    }
}
