//! Python bindings of the lenses of `carina-grid`.
#![allow(
    clippy::needless_pass_by_value,
    reason = "Python hands its arguments over by value"
)]

use std::sync::Arc;

use carina_grid::{
    Affine, Calibration, Camera, Distortion, FieldShape, GridError, ImageField, Lens,
};
use carina_raycast::Focus;
use numpy::{
    PyArray1, PyArray2, PyArray3, PyArrayMethods, PyReadonlyArray2, PyReadonlyArray3,
    PyUntypedArrayMethods,
};
use pyo3::{exceptions::PyValueError, prelude::*};

use crate::{arrays::volume_array, errors::IntoPy};

/// Lens model combined with the size of a picture.
#[pyclass(frozen, module = "carina._core")]
struct Optics {
    inner: carina_grid::Optics,
}

fn distortion(model: &str, coefficients: &[f64]) -> PyResult<Distortion> {
    match (model, coefficients) {
        // The coefficients are in OpenCV's order.
        ("brown", &[k1, k2, p1, p2, k3, k4, k5, k6]) => Ok(Distortion::Brown {
            k: [k1, k2, k3, k4, k5, k6],
            p: [p1, p2],
        }),
        ("fisheye", &[k1, k2, k3, k4]) => Ok(Distortion::Fisheye {
            k: [k1, k2, k3, k4],
        }),
        _ => Err(PyValueError::new_err(format!(
            "expected brown with 8 coefficients or fisheye with 4; found {model} with {}",
            coefficients.len()
        ))),
    }
}

fn triples<const N: usize>(
    py: Python<'_>,
    points: &[Option<[f64; N]>],
) -> PyResult<Py<PyArray2<f64>>> {
    let flat: Vec<f64> = points
        .iter()
        .flat_map(|point| point.unwrap_or([f64::NAN; N]))
        .collect();
    Ok(PyArray1::from_vec(py, flat)
        .reshape([points.len(), N])?
        .unbind())
}

fn rows<const N: usize>(what: &str, array: &PyReadonlyArray2<'_, f64>) -> PyResult<Vec<[f64; N]>> {
    if array.shape()[1] != N {
        return Err(PyValueError::new_err(format!(
            "{what}: expected shape (n, {N}), found {:?}",
            array.shape()
        )));
    }
    let view = array.as_array();
    let row = |row: usize| std::array::from_fn(|a| view[[row, a]]);
    Ok((0..array.shape()[0]).map(row).collect())
}

#[pymethods]
impl Optics {
    #[new]
    #[pyo3(signature = (
        model, coefficients, *, width, height, fov_rad=None, focal_px=None, centre_px=None, calibrated_size_px=None
    ))]
    fn new(
        model: &str,
        coefficients: Vec<f64>,
        width: usize,
        height: usize,
        fov_rad: Option<f64>,
        focal_px: Option<[f64; 2]>,
        centre_px: Option<[f64; 2]>,
        calibrated_size_px: Option<[usize; 2]>,
    ) -> PyResult<Self> {
        let distortion = distortion(model, &coefficients)?;
        let lens = match (focal_px, centre_px, calibrated_size_px) {
            (Some(focal_px), Some(centre_px), Some(size_px)) => Lens::Calibrated(Calibration {
                distortion,
                focal_px,
                centre_px,
                size_px,
            }),
            _ => Lens::Distorted(distortion),
        };
        let inner =
            carina_grid::Optics::new(&lens, fov_rad, width, height).map_err(IntoPy::into_py)?;
        Ok(Self { inner })
    }

    /// Return the unit directions (n, 3) in camera space of points (n, 2) of the picture.
    ///
    /// The result is NaN where the lens has no direction.
    fn directions(
        &self,
        py: Python<'_>,
        pixels: PyReadonlyArray2<'_, f64>,
    ) -> PyResult<Py<PyArray2<f64>>> {
        let points: Vec<[f64; 2]> = rows("pixels", &pixels)?;
        let found: Vec<_> = points
            .into_iter()
            .map(|p| self.inner.direction(p))
            .collect();
        triples(py, &found)
    }

    /// Return the points (n, 2) of the picture for directions (n, 3) in camera space.
    ///
    /// The result is NaN for directions of which the lens has no image.
    fn pixels(
        &self,
        py: Python<'_>,
        directions: PyReadonlyArray2<'_, f64>,
    ) -> PyResult<Py<PyArray2<f64>>> {
        let points: Vec<[f64; 3]> = rows("directions", &directions)?;
        let found: Vec<_> = points.into_iter().map(|d| self.inner.pixel(d)).collect();
        triples(py, &found)
    }

    /// Compute the rays of all pixels inside the outline `shape` of the picture.
    #[pyo3(signature = (*, shape, edge_px, vignette))]
    fn rays(&self, py: Python<'_>, shape: &str, edge_px: f64, vignette: f64) -> PyResult<LensRays> {
        let shape = match shape {
            "none" => FieldShape::Full,
            "round" => FieldShape::Round,
            "octagon" => FieldShape::Octagon,
            _ => {
                return Err(GridError::Camera {
                    what: "mask",
                    expected: "none, round or octagon".to_owned(),
                    found: shape.to_owned(),
                }
                .into_py());
            }
        };
        let field = ImageField {
            shape,
            edge_px,
            vignette,
        };
        let inner = py
            .detach(|| carina_grid::LensRays::build(self.inner.clone(), &field))
            .map_err(IntoPy::into_py)?;
        Ok(LensRays {
            inner: Arc::new(inner),
        })
    }

    #[getter]
    fn fov_rad(&self) -> f64 {
        self.inner.fov_rad()
    }

    #[getter]
    fn limit_rad(&self) -> f64 {
        self.inner.limit_rad()
    }

    #[getter]
    fn focal_px(&self) -> (f64, f64) {
        self.inner.focal_px().into()
    }

    #[getter]
    fn centre_px(&self) -> (f64, f64) {
        self.inner.centre_px().into()
    }

    fn __repr__(&self) -> String {
        let [width, height] = self.inner.size_px();
        format!(
            "Optics(size={width}x{height}, fov_deg={:.1})",
            self.inner.fov_rad().to_degrees()
        )
    }
}

/// Rays of all pixels of a picture behind a lens, with the relative brightness of each pixel.
#[pyclass(frozen, module = "carina._core")]
pub(crate) struct LensRays {
    pub(crate) inner: Arc<carina_grid::LensRays>,
}

#[pymethods]
impl LensRays {
    fn __repr__(&self) -> String {
        format!(
            "LensRays(size={}x{})",
            self.inner.width(),
            self.inner.height()
        )
    }
}

/// Create the camera of a picture: a pinhole camera, or one with the given lens, whose size must be that of the
/// picture.
pub(crate) fn camera(
    pose: Affine,
    fov_rad: f64,
    width: usize,
    height: usize,
    lens: Option<&Bound<'_, LensRays>>,
) -> PyResult<Camera> {
    let Some(lens) = lens else {
        return Camera::new(pose, fov_rad, width, height).map_err(IntoPy::into_py);
    };
    let rays = &lens.get().inner;
    if (rays.width(), rays.height()) != (width, height) {
        return Err(GridError::Camera {
            what: "picture size",
            expected: format!("the lens's {} x {}", rays.width(), rays.height()),
            found: format!("{width} x {height}"),
        }
        .into_py());
    }
    Camera::with_lens(pose, Arc::clone(rays)).map_err(IntoPy::into_py)
}

/// Blur a picture (h, w, 3) by its depth map (h, w) in mm (NaN: no wall), then darken it by the gains of its lens.
#[pyfunction]
#[pyo3(signature = (rgb, depth_mm, *, near_mm, far_mm, lens=None))]
fn defocus<'py>(
    py: Python<'py>,
    rgb: PyReadonlyArray3<'py, u8>,
    depth_mm: PyReadonlyArray2<'py, f32>,
    near_mm: f32,
    far_mm: f32,
    lens: Option<Bound<'py, LensRays>>,
) -> PyResult<Bound<'py, PyArray3<u8>>> {
    let &[height, width, channels] = rgb.shape() else {
        unreachable!("an array of three axes")
    };
    let rays = lens.as_ref().map(|lens| &*lens.get().inner);
    let fits = rays.is_none_or(|rays| (rays.width(), rays.height()) == (width, height));
    if channels != 3 || depth_mm.shape() != [height, width] || !fits {
        return Err(PyValueError::new_err(format!(
            "expected a picture (h, w, 3) with depth and lens of its size; found {:?} and {:?}",
            rgb.shape(),
            depth_mm.shape()
        )));
    }
    let (values, depth) = (rgb.as_slice()?, depth_mm.as_slice()?);
    let focus = Focus { near_mm, far_mm };
    let blurred = py
        .detach(|| {
            carina_raycast::defocus(values, depth, width, focus, rays).map(|mut blurred| {
                if let Some(rays) = rays {
                    rays.shade_rows(0, &mut blurred);
                }
                blurred
            })
        })
        .map_err(IntoPy::into_py)?;
    volume_array(py, blurred, [height, width, 3])
}

pub(crate) fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_class::<Optics>()?;
    module.add_class::<LensRays>()?;
    module.add_function(wrap_pyfunction!(defocus, module)?)?;
    Ok(())
}
