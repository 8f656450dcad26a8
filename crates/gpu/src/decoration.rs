//! Upload of the grid of anatomical data, from which rings, membranous wall and ridges are drawn on walls.

use carina_raycast::Decoration;

use crate::{Gpu, GpuDecoration, GpuError};

impl Gpu {
    /// Upload the grid of anatomical data of airway walls to the device.
    ///
    /// # Errors
    ///
    /// Returns an error if the data do not fit or the device is lost.
    pub fn upload_decoration(
        &self,
        decoration: &Decoration<'_>,
    ) -> Result<GpuDecoration, GpuError> {
        let cells = decoration.cells();
        self.check_alive()?;
        Ok(GpuDecoration {
            cells: self.filled("the decoration", bytemuck::cast_slice(cells))?,
            num_numbers: 4 * cells.len(),
            owner: self.id,
        })
    }
}
