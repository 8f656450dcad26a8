//! Python bindings of the cross-sections of airways: rays are cast once, then measured with one or several blurs.
#![allow(
    clippy::needless_pass_by_value,
    reason = "pyo3 hands arguments over by value"
)]

use carina_airpath::section::cross_section::{Plane, Section, cast_planes, voxel_in_plane_mm};
use carina_airpath::section::deblur::Blur;
use carina_airpath::section::profile::SectionLevels;
use carina_airpath::section::rays::{Cast, NUM_RAYS, plane_axes};
use carina_airpath::tree::smooth::Point;
use carina_grid::{Grid, VolumeView, unit};
use carina_leastcost::TrackError;
use numpy::ndarray::{Array1, Array2};
use numpy::{IntoPyArray, PyReadonlyArray2, PyReadonlyArray3};
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::arrays;
use crate::errors::IntoPy;
use crate::watch::PyWatch;

/// Rays that were cast in many planes across airways, with the edges found on them.
#[pyclass(frozen, module = "carina._core")]
struct SectionCasts {
    grid: Grid,
    levels: SectionLevels,
    casts: Vec<Cast>,
}

/// Cast 64 rays in each of several planes across airways.
#[pyfunction]
#[pyo3(signature = (values_zyx, lps_from_ijk, centres_lps, normals_lps, radius_mm, *, min_contrast, brightest_wall, wall_rise, noise, cancel=None, progress=None))]
fn cast_sections(
    py: Python<'_>,
    values_zyx: PyReadonlyArray3<'_, i16>,
    lps_from_ijk: PyReadonlyArray2<'_, f64>,
    centres_lps: Vec<[f64; 3]>,
    normals_lps: Vec<[f64; 3]>,
    radius_mm: Vec<f64>,
    min_contrast: f32,
    brightest_wall: f32,
    wall_rise: f32,
    noise: f32,
    cancel: Option<Py<PyAny>>,
    progress: Option<Py<PyAny>>,
) -> PyResult<SectionCasts> {
    let grid = arrays::grid(&values_zyx, &lps_from_ijk)?;
    let data = arrays::values("values_zyx", &values_zyx)?;
    if centres_lps.len() != normals_lps.len() || centres_lps.len() != radius_mm.len() {
        let (c, n, r) = (centres_lps.len(), normals_lps.len(), radius_mm.len());
        return Err(refused(
            "planes",
            "as many normals and radii as centres",
            format!("{c} centres, {n} normals, {r} radii"),
        ));
    }
    let planes = centres_lps
        .into_iter()
        .zip(normals_lps)
        .zip(radius_mm)
        .map(|((centre, normal), radius_mm)| plane(centre, normal, radius_mm))
        .collect::<PyResult<Vec<Plane>>>()?;
    let levels = SectionLevels {
        min_contrast,
        brightest_wall,
        wall_rise,
        noise,
    };
    let view = VolumeView::new(data, &grid).map_err(IntoPy::into_py)?;
    let watch = PyWatch::new(cancel, progress);
    let casts = py
        .detach(|| cast_planes(view, &planes, levels, &watch))
        .map_err(|e| watch.error(e))?;
    Ok(SectionCasts {
        grid,
        levels,
        casts,
    })
}

fn plane(centre: Point, normal: Point, radius_mm: f64) -> PyResult<Plane> {
    let normal_found = unit(normal).filter(|_| centre.iter().all(|v| v.is_finite()));
    // The limit of 60 mm is wider than any airway; it bounds the length of the rays.
    match normal_found {
        Some(normal) if (0.0..=60.0).contains(&radius_mm) => Ok(Plane {
            centre,
            normal,
            radius_mm,
        }),
        _ => Err(refused(
            "plane",
            "a finite centre, a normal with length and a radius of 0 to 60 mm",
            format!("{centre:?}, {normal:?}, {radius_mm}"),
        )),
    }
}

fn refused(what: &'static str, expected: &str, found: String) -> PyErr {
    TrackError::Argument {
        what,
        expected: expected.to_owned(),
        found,
    }
    .into_py()
}

#[pymethods]
impl SectionCasts {
    fn __len__(&self) -> usize {
        self.casts.len()
    }

    /// Return the blur of the scan within and across slices in mm; None if too few rays met thick tissue.
    fn blur(&self, py: Python<'_>) -> Option<(f64, f64)> {
        py.detach(|| Blur::of_casts(&self.grid, &self.casts))
            .map(|b| (b.in_plane_mm, b.across_mm))
    }

    /// Measure the cross-sections of all planes; return a dict of arrays with one item per plane.
    ///
    /// `blur` is that within and across the slices in mm; without it the edges are at half maximum.
    fn measure<'py>(
        &self,
        py: Python<'py>,
        blur: Option<(f64, f64)>,
    ) -> PyResult<Bound<'py, PyDict>> {
        let blur =
            blur.map(|(in_plane_mm, across_mm)| Blur::new(&self.grid, in_plane_mm, across_mm));
        let sections: Vec<Section> = py.detach(|| {
            self.casts
                .iter()
                .map(|cast| {
                    let voxel_mm = voxel_in_plane_mm(&self.grid, plane_axes(cast.normal));
                    Section::of_cast(cast, blur.as_ref(), voxel_mm, self.levels)
                })
                .collect()
        });
        let dict = PyDict::new(py);
        let column = |of: &dyn Fn(&Section) -> f64| {
            Array1::from_iter(sections.iter().map(of)).into_pyarray(py)
        };
        let n = sections.len();
        dict.set_item(
            "centre_lps",
            Array2::from_shape_fn((n, 3), |(s, a)| sections[s].centre[a]).into_pyarray(py),
        )?;
        dict.set_item("area_mm2", column(&|s| s.area_mm2))?;
        dict.set_item("equivalent_mm", column(&|s| s.equivalent_mm))?;
        dict.set_item("min_mm", column(&|s| s.min_mm))?;
        dict.set_item("max_mm", column(&|s| s.max_mm))?;
        dict.set_item("wall_mm", column(&|s| s.wall_mm))?;
        dict.set_item("shift_mm", column(&|s| s.shift_mm))?;
        dict.set_item("equivalent_error_mm", column(&|s| s.equivalent_error_mm))?;
        dict.set_item("width_error_mm", column(&|s| s.width_error_mm))?;
        dict.set_item("wall_error_mm", column(&|s| s.wall_error_mm))?;
        dict.set_item("share", column(&|s| s.share))?;
        dict.set_item("wall_share", column(&|s| s.wall_share))?;
        dict.set_item("left_share", column(&|s| s.left_share))?;
        dict.set_item(
            "edge_mm",
            Array2::from_shape_fn((n, NUM_RAYS), |(s, r)| sections[s].edge_mm[r]).into_pyarray(py),
        )?;
        dict.set_item(
            "outer_mm",
            Array2::from_shape_fn((n, NUM_RAYS), |(s, r)| sections[s].outer_mm[r]).into_pyarray(py),
        )?;
        Ok(dict)
    }

    fn __repr__(&self) -> String {
        format!("SectionCasts(num_planes={})", self.casts.len())
    }
}

/// Return the two unit vectors (LPS) that span the plane across a direction: the directions of the rays at 0 and 90
/// degrees.
#[pyfunction]
fn section_axes(normal_lps: [f64; 3]) -> PyResult<([f64; 3], [f64; 3])> {
    Ok(plane_axes(plane([0.0; 3], normal_lps, 0.0)?.normal))
}

pub(crate) fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_function(wrap_pyfunction!(cast_sections, module)?)?;
    module.add_function(wrap_pyfunction!(section_axes, module)?)?;
    module.add_class::<SectionCasts>()?;
    Ok(())
}
