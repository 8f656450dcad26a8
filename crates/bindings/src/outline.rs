//! Python binding of the outline of the lumen in a plane.
#![allow(
    clippy::needless_pass_by_value,
    reason = "pyo3 hands arguments over by value"
)]

use carina_airpath::outline::{self, PicturePoint};
use carina_grid::{Grid, GridError, VolumeView};
use carina_leastcost::lumen::WallLevels;
use numpy::ndarray::Array2;
use numpy::{
    IntoPyArray, PyArray2, PyArray3, PyArrayMethods, PyReadonlyArray2, PyReadonlyArray3,
    PyUntypedArrayMethods,
};
use pyo3::prelude::*;
use pyo3::types::PyBytes;

use crate::arrays;
use crate::errors::IntoPy;

/// Surface of the lumen of one volume, which planes can cut.
///
/// The arrays must not change while the object exists.
#[pyclass(frozen, module = "carina._core")]
pub(crate) struct LumenSurface {
    grid: Grid,
    values: Py<PyArray3<i16>>,
    lumen: Py<PyArray3<u8>>,
    levels: Option<WallLevels>,
    surface: outline::LumenSurface,
}

#[pymethods]
impl LumenSurface {
    #[new]
    #[pyo3(signature = (values_zyx, lps_from_ijk, lumen_zyx, *, levels))]
    fn new(
        py: Python<'_>,
        values_zyx: PyReadonlyArray3<'_, i16>,
        lps_from_ijk: PyReadonlyArray2<'_, f64>,
        lumen_zyx: PyReadonlyArray3<'_, u8>,
        levels: Option<(f32, f32, f32)>,
    ) -> PyResult<Self> {
        let grid = arrays::grid(&values_zyx, &lps_from_ijk)?;
        arrays::values("values_zyx", &values_zyx)?;
        let lumen = arrays::values("lumen_zyx", &lumen_zyx)?;
        if lumen_zyx.shape() != values_zyx.shape() {
            return Err(pyo3::exceptions::PyValueError::new_err(format!(
                "lumen_zyx: expected the volume's shape {:?}, found {:?}",
                values_zyx.shape(),
                lumen_zyx.shape()
            )));
        }
        let shape = grid.shape_ijk();
        let surface = py.detach(|| outline::LumenSurface::new(lumen, shape));
        Ok(Self {
            grid,
            values: (*values_zyx).clone().unbind(),
            lumen: (*lumen_zyx).clone().unbind(),
            levels: levels.map(|(core, wall, rise)| WallLevels { core, wall, rise }),
            surface,
        })
    }

    /// Cut the surface with the plane of a picture.
    ///
    /// Return the lines of the outline, each (n, 2) column and row; None if the outline has too many pieces.
    #[pyo3(signature = (lps_from_pixel, *, width, height))]
    fn cut<'py>(
        &self,
        py: Python<'py>,
        lps_from_pixel: PyReadonlyArray2<'py, f64>,
        width: usize,
        height: usize,
    ) -> PyResult<Option<Vec<Bound<'py, PyArray2<f64>>>>> {
        let lines = self.lines(py, &lps_from_pixel, (width, height), |lines| lines)?;
        Ok(lines.map(|lines| {
            lines
                .iter()
                .map(|line| {
                    Array2::from_shape_fn((line.len(), 2), |(n, a)| line[n][a]).into_pyarray(py)
                })
                .collect()
        }))
    }

    /// Cut the surface with the plane of a picture; return the lines as the bytes of the wire format.
    ///
    /// The lines are clipped to the picture. The result is None if the outline has too many pieces.
    #[pyo3(signature = (lps_from_pixel, *, width, height))]
    fn encoded<'py>(
        &self,
        py: Python<'py>,
        lps_from_pixel: PyReadonlyArray2<'py, f64>,
        width: usize,
        height: usize,
    ) -> PyResult<Option<Bound<'py, PyBytes>>> {
        let size = (width, height);
        let bytes = self.lines(py, &lps_from_pixel, size, |lines| {
            outline::encoded(&lines, size)
        })?;
        Ok(bytes.map(|bytes| PyBytes::new(py, &bytes)))
    }
}

impl LumenSurface {
    fn lines<T: Send>(
        &self,
        py: Python<'_>,
        lps_from_pixel: &PyReadonlyArray2<'_, f64>,
        size: (usize, usize),
        finish: impl FnOnce(Vec<Vec<PicturePoint>>) -> T + Send,
    ) -> PyResult<Option<T>> {
        let flat = || GridError::Transform {
            what: "lps_from_pixel",
            reason: "its determinant is 0".to_owned(),
        };
        let place = arrays::affine("lps_from_pixel", lps_from_pixel)?;
        let pixel_from_lps = place.inverse().ok_or_else(flat).map_err(IntoPy::into_py)?;
        let pixel_from_ijk = pixel_from_lps.after(self.grid.lps_from_ijk());
        let (values, lumen) = (
            self.values.bind(py).readonly(),
            self.lumen.bind(py).readonly(),
        );
        let view = VolumeView::new(arrays::values("values_zyx", &values)?, &self.grid)
            .map_err(IntoPy::into_py)?;
        let lumen = arrays::values("lumen_zyx", &lumen)?;
        Ok(py.detach(|| {
            let lines = self
                .surface
                .cut(view, lumen, self.levels, &pixel_from_ijk, size);
            lines.ok().map(finish)
        }))
    }
}

pub(crate) fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_class::<LumenSurface>()?;
    Ok(())
}
