//! Upload of the anatomical data that the decoration of walls reads.

use carina_raycast::Decoration;

use crate::{Gpu, GpuDecoration, GpuError};

impl Gpu {
    /// Upload the anatomical data of airway walls.
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
