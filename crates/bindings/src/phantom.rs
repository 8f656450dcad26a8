//! Python bindings of `carina-phantom`, the phantom chest.

use carina_phantom::{Branch, Chest, ChestOptions, Lobe, PhantomError, TubeKind, Variants};
use numpy::{IntoPyArray, PyArray1, PyArrayMethods};
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyList};

use crate::errors::{IntoPy, carina_error};

impl IntoPy for PhantomError {
    fn into_py(self) -> PyErr {
        match self {
            Self::Grid(error) => error.into_py(),
            Self::Cancelled => carina_error("CancelledError", self.code(), &self.to_string()),
            Self::Option { .. } => carina_error("UsageError", self.code(), &self.to_string()),
        }
    }
}

/// Move the values of a volume into a `NumPy` array `[z, y, x]` without a copy.
fn volume<'py, T: numpy::Element>(
    py: Python<'py>,
    values: Vec<T>,
    shape_zyx: [usize; 3],
) -> PyResult<Bound<'py, PyAny>> {
    let flat: Bound<'py, PyArray1<T>> = values.into_pyarray(py);
    Ok(flat.reshape(shape_zyx)?.into_any())
}

fn branch<'py>(py: Python<'py>, branch: &Branch) -> PyResult<Bound<'py, PyDict>> {
    let dict = PyDict::new(py);
    dict.set_item("id", branch.id)?;
    dict.set_item("parent", branch.parent)?;
    dict.set_item("children", branch.children.clone())?;
    dict.set_item("generation", branch.generation)?;
    dict.set_item("name", branch.name)?;
    dict.set_item(
        "points",
        branch.points.iter().map(|p| p.to_vec()).collect::<Vec<_>>(),
    )?;
    dict.set_item("radius", branch.radius_mm.clone())?;
    dict.set_item("wall_mm", branch.wall_mm)?;
    Ok(dict)
}

/// Generate a phantom chest; `proceed(fraction)` returns False to stop.
///
/// See `carina.phantom`.
#[pyfunction]
#[allow(
    clippy::fn_params_excessive_bools,
    reason = "the options of a chest, each by its name in Python"
)]
fn generate_chest<'py>(
    py: Python<'py>,
    seed: u64,
    spacing_mm: [f64; 3],
    generations: usize,
    stenosis: bool,
    nodule: bool,
    noise_hu: f64,
    neck: bool,
    tube: Option<&str>,
    resected: Option<&str>,
    variant: Option<&str>,
    box_lps: Option<[[f64; 3]; 2]>,
    with_distance: bool,
    proceed: &Bound<'py, PyAny>,
) -> PyResult<Bound<'py, PyDict>> {
    let tube = match tube {
        None => None,
        Some("endotracheal") => Some(TubeKind::Endotracheal),
        Some("tracheostomy") => Some(TubeKind::Tracheostomy),
        Some(other) => {
            return Err(PhantomError::Option {
                what: "tube",
                expected: "endotracheal or tracheostomy",
                found: other.to_owned(),
            }
            .into_py());
        }
    };
    let resected = match resected {
        None => None,
        Some(name) => Some(
            Lobe::ALL
                .into_iter()
                .find(|lobe| lobe.name() == name)
                .ok_or_else(|| {
                    PhantomError::Option {
                        what: "resected lobe",
                        expected: "RUL, RML, RLL, LUL or LLL",
                        found: name.to_owned(),
                    }
                    .into_py()
                })?,
        ),
    };
    let variants = match variant {
        None => Variants::default(),
        Some(name) => Variants::named(name, seed).ok_or_else(|| {
            PhantomError::Option {
                what: "variant",
                expected: "tracheal-bronchus, subsuperior, absent-rb7, trifurcations, left-isomerism or published",
                found: name.to_owned(),
            }
            .into_py()
        })?,
    };
    let options = ChestOptions {
        seed,
        spacing_mm,
        generations,
        stenosis,
        nodule,
        noise_hu,
        neck,
        tube,
        resected,
        variants,
        box_lps,
        with_distance,
    };
    let proceed = proceed.clone().unbind();
    let mut raised: Option<PyErr> = None;
    let made = py.detach(|| {
        Chest::generate(&options, &mut |fraction| {
            Python::attach(|py| {
                let answer = py
                    .check_signals()
                    .and_then(|()| proceed.call1(py, (fraction,))?.extract::<bool>(py));
                answer.unwrap_or_else(|error| {
                    raised = Some(error);
                    false
                })
            })
        })
    });
    if let Some(error) = raised {
        return Err(error);
    }
    let chest = made.map_err(IntoPy::into_py)?;
    let shape_zyx = chest.grid.shape_zyx();
    let out = PyDict::new(py);
    let rows = chest.grid.lps_from_ijk().rows();
    let mut matrix: Vec<Vec<f64>> = rows.iter().map(|r| r.to_vec()).collect();
    matrix.push(vec![0.0, 0.0, 0.0, 1.0]);
    out.set_item("lps_from_ijk", matrix)?;
    let branches = PyList::empty(py);
    for b in &chest.tree.branches {
        branches.append(branch(py, b)?)?;
    }
    out.set_item("branches", branches)?;
    if variant.is_some() {
        out.set_item("variants", variants.names())?;
    }
    if let Some(n) = chest.nodule {
        let dict = PyDict::new(py);
        dict.set_item("center_lps", n.centre_lps)?;
        dict.set_item("radius_mm", n.radius_mm)?;
        dict.set_item("branch_id", n.branch_id)?;
        dict.set_item("distance_mm", n.distance_mm)?;
        out.set_item("nodule", dict)?;
    }
    if let Some(s) = chest.stenosis {
        let dict = PyDict::new(py);
        dict.set_item("branch_id", s.branch_id)?;
        dict.set_item("center_lps", s.centre_lps)?;
        dict.set_item("length_mm", s.length_mm)?;
        dict.set_item("min_radius_mm", s.min_radius_mm)?;
        dict.set_item("reference_radius_mm", s.reference_radius_mm)?;
        out.set_item("stenosis", dict)?;
    }
    if let Some(cricoid) = chest.cricoid_lps {
        out.set_item("cricoid_lps", cricoid)?;
    }
    if let Some(tube) = chest.tube {
        let dict = PyDict::new(py);
        dict.set_item(
            "kind",
            match tube.kind {
                TubeKind::Endotracheal => "endotracheal",
                TubeKind::Tracheostomy => "tracheostomy",
            },
        )?;
        dict.set_item("tip_lps", tube.tip_lps)?;
        dict.set_item("above_carina_mm", tube.above_carina_mm)?;
        dict.set_item("outer_radius_mm", tube.outer_mm)?;
        dict.set_item("inner_radius_mm", tube.inner_mm)?;
        out.set_item("tube", dict)?;
    }
    if let Some(upper) = chest.upper_airway {
        out.set_item("upper_airway_zyx", volume(py, upper, shape_zyx)?)?;
    }
    out.set_item("hu_zyx", volume(py, chest.hu, shape_zyx)?)?;
    out.set_item("lumen_zyx", volume(py, chest.lumen, shape_zyx)?)?;
    if let Some(distance) = chest.lumen_distance_mm {
        out.set_item("lumen_distance_mm", volume(py, distance, shape_zyx)?)?;
    }
    Ok(out)
}

/// Return the signed distances from points to the lumen of a chest's airways; see `carina.phantom`.
#[pyfunction]
#[allow(
    clippy::needless_pass_by_value,
    reason = "PyO3 hands arrays over by value"
)]
fn chest_lumen_distances<'py>(
    py: Python<'py>,
    seed: u64,
    generations: usize,
    stenosis: bool,
    neck: bool,
    points_lps: numpy::PyReadonlyArray2<'py, f64>,
) -> PyResult<Bound<'py, PyArray1<f64>>> {
    let points = crate::scope_drive::points(&points_lps)?;
    let options = ChestOptions {
        seed,
        generations,
        stenosis,
        neck,
        ..ChestOptions::default()
    };
    let found = py
        .detach(|| Chest::lumen_distances_at(&options, &points))
        .map_err(IntoPy::into_py)?;
    Ok(found.into_pyarray(py))
}

pub(crate) fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_function(wrap_pyfunction!(chest_lumen_distances, module)?)?;
    module.add_function(wrap_pyfunction!(generate_chest, module)?)
}
