//! Python bindings of `carina-raycast`, the casters and planes.
#![allow(
    clippy::needless_pass_by_value,
    reason = "Python hands its arguments over by value"
)]

use std::sync::{
    Arc, Mutex, OnceLock, PoisonError,
    atomic::{AtomicBool, Ordering},
};

use carina_grid::{Affine, Camera, Grid, GridError, VolumeView};
use carina_isoregion::SegmentTable;
use carina_raycast::{
    Appearance, ClassMap, DECORATION_CHANNELS, Decoration, Frame, FrameOptions, InstructionSet,
    Interpolation, Light, Method, NormalBricks, RaycastError, SampleBricks, Transfer, TriPlane,
    ValueMap, WallHeights, Window, cast_rows, cast_rows_until, cast_tri_plane,
    maximum_projections_by, pick, sample_plane_by, smoothed_mask,
};
use numpy::{
    PyArray1, PyArray2, PyArray3, PyArrayMethods, PyReadonlyArray2, PyReadonlyArray3,
    PyReadonlyArray4, PyUntypedArrayMethods,
};
use pyo3::prelude::*;

use crate::pool;
use crate::{
    arrays::{affine, grid, values, volume_array},
    errors::{IntoPy, carina_error},
    gpu::GpuScene,
    optics::{LensRays, camera},
};

impl IntoPy for RaycastError {
    fn into_py(self) -> PyErr {
        let class = if self.code().starts_with("geometry") {
            "GeometryError"
        } else {
            "RenderError"
        };
        carina_error(class, self.code(), &self.to_string())
    }
}

/// Build a transfer function from an (n, 5) array of points `[hu, r, g, b, alpha]`.
pub(crate) fn transfer(
    points: &PyReadonlyArray2<'_, f64>,
    reference_mm: f64,
    bin_hu: i32,
) -> PyResult<Transfer> {
    if points.shape()[1] != 5 {
        return Err(RaycastError::Transfer {
            reason: format!(
                "expected rows of hu, r, g, b, alpha, found shape {:?}",
                points.shape()
            ),
        }
        .into_py());
    }
    let rows = points.as_array();
    let rows = rows.rows().into_iter();
    let rows = rows.map(|row| std::array::from_fn(|c| row[c])).collect();
    Transfer::new(rows, reference_mm, bin_hu).map_err(IntoPy::into_py)
}

/// Colour and opacity that one ray step adds, for each value of a volume.
///
/// The table is a transfer function evaluated for one step length.
#[pyclass(frozen, module = "carina._core")]
struct TransferTable {
    inner: carina_raycast::TransferTable,
    /// Cached segment table of the last call of `segments`, with the class values for which it was built.
    ///
    /// Building a table takes as long as casting a small picture.
    segments: Mutex<Option<(Vec<i32>, Arc<SegmentTable>)>>,
}

impl TransferTable {
    /// Return the segment table of the classes; `class_values` contains one value of each class.
    fn segments(&self, class_values: &[i32]) -> Arc<SegmentTable> {
        let mut cached = self.segments.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some((values, table)) = cached.as_ref()
            && values == class_values
        {
            return Arc::clone(table);
        }
        let mut entries: Vec<[f32; 4]> =
            class_values.iter().map(|&v| self.inner.entry(v)).collect();
        // The table has an entry for every possible label, because searching for the highest label would take longer
        // than casting the picture.
        entries.resize(usize::from(u8::MAX), [0.0; 4]);
        let table = Arc::new(SegmentTable::new(&entries));
        *cached = Some((class_values.to_vec(), Arc::clone(&table)));
        table
    }
}

#[pymethods]
impl TransferTable {
    #[new]
    #[pyo3(signature = (points, *, reference_mm, step_mm, lo, hi, bin_hu=1))]
    fn new(
        points: PyReadonlyArray2<'_, f64>,
        reference_mm: f64,
        step_mm: f64,
        lo: i16,
        hi: i16,
        bin_hu: i32,
    ) -> PyResult<Self> {
        let transfer = transfer(&points, reference_mm, bin_hu)?;
        let inner = carina_raycast::TransferTable::new(&transfer, step_mm, lo, hi)
            .map_err(IntoPy::into_py)?;
        Ok(Self {
            inner,
            segments: Mutex::new(None),
        })
    }

    /// Return the premultiplied colour and opacity of one ray step at a value.
    fn entry(&self, value: i32) -> [f32; 4] {
        self.inner.entry(value)
    }

    fn __repr__(&self) -> String {
        format!("TransferTable(step_mm={})", self.inner.step_mm())
    }
}

/// Token with which another thread cancels the cast of a picture.
///
/// Use a new token for each picture: a cancelled token stays cancelled.
#[pyclass(frozen, module = "carina._core")]
#[derive(Default)]
struct CancelToken {
    set: AtomicBool,
}

#[pymethods]
impl CancelToken {
    #[new]
    fn new() -> Self {
        Self::default()
    }

    /// Cancel the cast that uses this token.
    fn cancel(&self) {
        self.set.store(true, Ordering::Relaxed);
    }

    #[getter]
    fn cancelled(&self) -> bool {
        self.set.load(Ordering::Relaxed)
    }

    fn __repr__(&self) -> String {
        format!("CancelToken(cancelled={})", self.cancelled())
    }
}

/// Cache of bricks of one volume that several pictures share: wall normals, and samples with their gradients.
///
/// A cache belongs to one array of values. The values must not change; use a new cache for each array.
#[pyclass(frozen, module = "carina._core")]
#[derive(Default)]
struct Bricks {
    slopes: Mutex<Option<Arc<NormalBricks>>>,
    samples: Mutex<Option<Arc<SampleBricks>>>,
}

/// Return the cached bricks if they fit; otherwise cache and return new bricks.
fn cached<T>(
    cached: &Mutex<Option<Arc<T>>>,
    fits: impl Fn(&T) -> bool,
    new: impl Fn() -> T,
) -> Arc<T> {
    let mut cached = cached.lock().unwrap_or_else(PoisonError::into_inner);
    if let Some(bricks) = cached.as_ref().filter(|bricks| fits(bricks)) {
        return Arc::clone(bricks);
    }
    Arc::clone(cached.insert(Arc::new(new())))
}

impl Bricks {
    /// Return a frame that reads its bricks (cubes of voxels) from a cache and adds missing ones.
    ///
    /// The cache starts empty again if the bricks do not fit the frame (another shape, or another transfer function for
    /// wall normals) or if the cache is full.
    fn attached_to<'a>(&self, frame: Frame<'a>) -> Result<Frame<'a>, RaycastError> {
        if frame.lights_walls() {
            let fits = |bricks: &NormalBricks| bricks.fit(&frame) && !bricks.is_full();
            let bricks = cached(&self.slopes, fits, || NormalBricks::of(&frame));
            return frame.with_normals(bricks);
        }
        if frame.lights_samples() {
            let shape = frame.shape_ijk();
            let fits = |bricks: &SampleBricks| bricks.fit(shape) && !bricks.is_full();
            let bricks = cached(&self.samples, fits, || SampleBricks::of(shape));
            return frame.with_samples(bricks);
        }
        Ok(frame)
    }
}

#[pymethods]
impl Bricks {
    #[new]
    fn new() -> Self {
        Self::default()
    }

    /// Return the number of cached bricks of normals and of samples.
    fn __len__(&self) -> usize {
        let slopes = self.slopes.lock().unwrap_or_else(PoisonError::into_inner);
        let samples = self.samples.lock().unwrap_or_else(PoisonError::into_inner);
        slopes.as_ref().map_or(0, |bricks| bricks.len())
            + samples.as_ref().map_or(0, |bricks| bricks.len())
    }

    fn __repr__(&self) -> String {
        format!("Bricks({} kept)", self.__len__())
    }
}

/// Return the instruction set with a name, or the default one for `None`.
///
/// The default is that of the environment variable `CARINA_SIMD` (for tests), or else the fastest set of this machine.
pub(crate) fn instruction_set(name: Option<&str>) -> PyResult<InstructionSet> {
    /// Value of the environment variable `CARINA_SIMD`, read on first use.
    static CHOSEN: OnceLock<Option<String>> = OnceLock::new();
    let chosen = || {
        std::env::var("CARINA_SIMD")
            .ok()
            .map(|name| name.trim().to_owned())
            .filter(|name| !name.is_empty())
    };
    let Some(name) = name.or_else(|| CHOSEN.get_or_init(chosen).as_deref()) else {
        return Ok(InstructionSet::best());
    };
    InstructionSet::named(name).ok_or_else(|| {
        let known: Vec<_> = InstructionSet::available()
            .into_iter()
            .map(InstructionSet::name)
            .collect();
        RaycastError::Setting {
            what: "instruction set",
            expected: format!("one that this machine has: {}", known.join(", ")),
            found: name.to_owned(),
        }
        .into_py()
    })
}

/// Statistics of a cast as a Python tuple.
///
/// The items are the numbers of rays, samples, look-ups, leaps, skipped samples, shaded samples and reads.
type PyStats = (u64, u64, u64, u64, u64, u64, u64);

/// Radius map for empty-space skipping, as passed from Python.
///
/// The variants are the radius map alone; labels, radius map and one value of each class for leaps over all classes;
/// words of labels and radii, one value of each label, and whether words are prefetched, for leaps over values.
#[derive(FromPyObject)]
enum LeapMap<'py> {
    Classes(
        PyReadonlyArray3<'py, u8>,
        PyReadonlyArray3<'py, u8>,
        Vec<i32>,
    ),
    Values(PyReadonlyArray3<'py, u16>, Vec<i32>, bool),
    Transparent(PyReadonlyArray3<'py, u8>),
}

/// Python object with the attributes of [`Appearance`]: light, gloss, texture and decoration.
#[derive(FromPyObject)]
struct PyAppearance {
    guides_mm: Vec<[f32; 3]>,
    exposure: Option<f32>,
    ambient: f32,
    wrap: f32,
    gloss: f32,
    shininess_log2: u32,
    paleness: f32,
    pale_hu: [f32; 2],
    texture: f32,
    vessels: f32,
    silhouettes: bool,
    specks: f32,
    secretions: f32,
    fog: f32,
    rings: f32,
    membrane: f32,
    hue: f32,
    spurs: f32,
}

impl PyAppearance {
    fn into_core(self) -> Appearance {
        let first = self.guides_mm.first().copied().unwrap_or_default();
        Appearance {
            guides_mm: [first, self.guides_mm.get(1).copied().unwrap_or(first)],
            exposure: self.exposure,
            ambient: self.ambient,
            wrap: self.wrap,
            gloss: self.gloss,
            shininess_log2: self.shininess_log2,
            paleness: self.paleness,
            pale_hu: self.pale_hu,
            texture: self.texture,
            vessels: self.vessels,
            silhouettes: self.silhouettes,
            specks: self.specks,
            secretions: self.secretions,
            fog: self.fog,
            rings: self.rings,
            membrane: self.membrane,
            hue: self.hue,
            spurs: self.spurs,
        }
    }
}

/// Python object with the attributes of [`Decoration`]: anatomical data of wall points.
#[derive(FromPyObject)]
struct PyDecoration<'py> {
    cells: PyReadonlyArray4<'py, f32>,
    origin_lps: [f32; 3],
    cell_mm: f32,
}

impl PyDecoration<'_> {
    fn as_core(&self) -> PyResult<Decoration<'_>> {
        let &[nz, ny, nx, num_channels] = self.cells.shape() else {
            unreachable!("an array of four axes");
        };
        let numbers = self.cells.as_slice().map_err(|e| {
            pyo3::exceptions::PyValueError::new_err(format!(
                "decoration: {e}; expected C-contiguous cells"
            ))
        })?;
        // An empty shape makes `Decoration::new` reject cells with a wrong number of channels.
        let shape = if num_channels == DECORATION_CHANNELS {
            [nz, ny, nx]
        } else {
            [0; 3]
        };
        Decoration::new(numbers, shape, self.origin_lps, self.cell_mm).map_err(IntoPy::into_py)
    }
}

/// Return the grid of a deformed CT and the map from patient space to the CT at rest; `None` without a deformation.
///
/// The deformation maps positions of the CT at rest to patient space.
fn deformed_grid(
    rest: &Grid,
    lps_from_rest: Option<&PyReadonlyArray2<'_, f64>>,
) -> PyResult<Option<(Grid, Affine)>> {
    let Some(matrix) = lps_from_rest else {
        return Ok(None);
    };
    let lps_from_rest = affine("lps_from_rest", matrix)?;
    let rest_from_lps = lps_from_rest.inverse().ok_or_else(|| {
        GridError::Transform {
            what: "lps_from_rest",
            reason: "its determinant is 0".to_owned(),
        }
        .into_py()
    })?;
    let grid = Grid::new(rest.shape_zyx(), lps_from_rest.after(rest.lps_from_ijk()));
    Ok(Some((grid.map_err(IntoPy::into_py)?, rest_from_lps)))
}

const fn interpolation(nearest: bool) -> Interpolation {
    if nearest {
        Interpolation::Nearest
    } else {
        Interpolation::Trilinear
    }
}

/// Cast rows of an airway view; return (rows, width, 3) uint8 colours and statistics.
#[pyfunction]
#[pyo3(signature = (
    hu_zyx, lps_from_ijk, table, lps_from_camera, *, fov_rad, width, height, rows=None, light=None, nearest=false,
    background=[0.0; 3], leap=None, simd=None, stop=None, lens=None, darken=true, gpu=None,
    stop_transparency=None, appearance=None, always_leap=false, bricks=None, decoration=None, lps_from_rest=None
))]
fn cast<'py>(
    py: Python<'py>,
    hu_zyx: PyReadonlyArray3<'py, i16>,
    lps_from_ijk: PyReadonlyArray2<'py, f64>,
    table: &Bound<'py, TransferTable>,
    lps_from_camera: PyReadonlyArray2<'py, f64>,
    fov_rad: f64,
    width: usize,
    height: usize,
    rows: Option<(usize, usize)>,
    light: Option<(f32, f32, f32, u32, f32)>,
    nearest: bool,
    background: [f32; 3],
    leap: Option<LeapMap<'py>>,
    simd: Option<&str>,
    stop: Option<Bound<'py, CancelToken>>,
    lens: Option<Bound<'py, LensRays>>,
    darken: bool,
    gpu: Option<Bound<'py, GpuScene>>,
    stop_transparency: Option<f32>,
    appearance: Option<PyAppearance>,
    always_leap: bool,
    bricks: Option<Bound<'py, Bricks>>,
    decoration: Option<PyDecoration<'py>>,
    lps_from_rest: Option<PyReadonlyArray2<'py, f64>>,
) -> PyResult<(Bound<'py, PyArray3<u8>>, PyStats)> {
    let rest = grid(&hu_zyx, &lps_from_ijk)?;
    let moved = deformed_grid(&rest, lps_from_rest.as_ref())?;
    let grid = moved.as_ref().map_or(&rest, |(grid, _)| grid);
    let volume = VolumeView::new(values("hu_zyx", &hu_zyx)?, grid).map_err(IntoPy::into_py)?;
    let pose = affine("lps_from_camera", &lps_from_camera)?;
    let camera = camera(pose, fov_rad, width, height, lens.as_ref())?;
    let tables = table.get();
    let table = &tables.inner;
    let options = FrameOptions {
        interpolation: interpolation(nearest),
        light: light.map(
            |(ambient, diffuse, specular, shininess_log2, reach_mm)| Light {
                ambient,
                diffuse,
                specular,
                shininess_log2,
                reach_mm,
            },
        ),
        appearance: appearance.map(PyAppearance::into_core),
        background,
    };
    let mut frame = Frame::new(volume, table, camera, options).map_err(IntoPy::into_py)?;
    if let Some((_, rest_from_lps)) = &moved {
        frame = frame.deformed(*rest_from_lps, &rest);
    }
    if let Some(transparency) = stop_transparency {
        frame = frame.stopping_at(transparency).map_err(IntoPy::into_py)?;
    }
    let anatomy = decoration.as_ref().map(PyDecoration::as_core).transpose()?;
    if let Some(anatomy) = anatomy {
        frame = frame.decorated_by(anatomy);
    }
    if always_leap {
        frame = frame.leaping_always();
    }
    if let Some(bricks) = bricks {
        frame = bricks.get().attached_to(frame).map_err(IntoPy::into_py)?;
    }
    let simd = instruction_set(simd)?;
    let (start, end) = rows.unwrap_or((0, height));
    let segments;
    let method = match &leap {
        None => Method::Brute,
        Some(LeapMap::Transparent(radius)) => {
            Method::LeapTransparent(values("radius_zyx", radius)?)
        }
        Some(LeapMap::Values(words, label_values, prefetch)) => {
            segments = tables.segments(label_values);
            Method::LeapValues(ValueMap {
                words: values("words_zyx", words)?,
                segments: &segments,
                prefetch: *prefetch,
            })
        }
        Some(LeapMap::Classes(labels, radius, class_values)) => {
            let labels = values("labels_zyx", labels)?;
            segments = tables.segments(class_values);
            Method::LeapClasses(ClassMap {
                labels,
                radius: values("radius_zyx", radius)?,
                segments: &segments,
            })
        }
    };
    let stop = stop.as_ref().map(|token| &token.get().set);
    let done = match (&gpu, stop) {
        // A cast on the GPU takes milliseconds, so it is cancelled only before it starts.
        (Some(_), Some(stop)) if stop.load(Ordering::Relaxed) => None,
        (Some(scene), _) => {
            let decoration = decoration.as_ref().map(|object| &object.cells).zip(anatomy);
            let scene = scene.get();
            Some(scene.cast(py, &frame, &hu_zyx, start..end, decoration, darken)?)
        }
        (None, None) => {
            pool::detached(py, || cast_rows(&frame, method, start..end, simd).map(Some))
                .map_err(IntoPy::into_py)?
        }
        (None, Some(stop)) => pool::detached(py, || {
            cast_rows_until(&frame, method, start..end, simd, stop)
        })
        .map_err(IntoPy::into_py)?,
    };
    let done = done.map(|(mut rgb, stats)| {
        // A graphics device has darkened its picture itself.
        if let Some(rays) = frame
            .camera()
            .lens_rays()
            .filter(|_| darken && gpu.is_none())
        {
            pool::detached(py, || rays.shade_rows(start, &mut rgb));
        }
        (rgb, stats)
    });
    let Some((rgb, s)) = done else {
        return Err(carina_error(
            "CancelledError",
            "cancelled",
            "the picture was given up for a newer one",
        ));
    };
    let stats = (
        s.num_rays,
        s.num_samples,
        s.num_lookups,
        s.num_leaps,
        s.num_skipped,
        s.num_shaded,
        s.num_loads,
    );
    Ok((volume_array(py, rgb, [end - start, width, 3])?, stats))
}

type PySurface<'py> = (
    Bound<'py, PyArray2<f32>>,
    Bound<'py, PyArray3<f64>>,
    Bound<'py, PyArray3<f32>>,
);

/// Find the first wall on each ray of some rows of a picture, or of one pixel (column, row).
///
/// Return depths in mm (rows, width), and positions and normals (rows, width, 3) in LPS; NaN for a ray without a wall.
#[pyfunction]
#[pyo3(signature = (
    hu_zyx, lps_from_ijk, table, lps_from_camera, *, fov_rad, width, height, rows=None, pixel=None, nearest=false,
    radius_zyx=None, simd=None, lens=None, lps_from_rest=None
))]
fn cast_surface<'py>(
    py: Python<'py>,
    hu_zyx: PyReadonlyArray3<'py, i16>,
    lps_from_ijk: PyReadonlyArray2<'py, f64>,
    table: &Bound<'py, TransferTable>,
    lps_from_camera: PyReadonlyArray2<'py, f64>,
    fov_rad: f64,
    width: usize,
    height: usize,
    rows: Option<(usize, usize)>,
    pixel: Option<(usize, usize)>,
    nearest: bool,
    radius_zyx: Option<PyReadonlyArray3<'py, u8>>,
    simd: Option<&str>,
    lens: Option<Bound<'py, LensRays>>,
    lps_from_rest: Option<PyReadonlyArray2<'py, f64>>,
) -> PyResult<PySurface<'py>> {
    let rest = grid(&hu_zyx, &lps_from_ijk)?;
    let moved = deformed_grid(&rest, lps_from_rest.as_ref())?;
    let grid = moved.as_ref().map_or(&rest, |(grid, _)| grid);
    let volume = VolumeView::new(values("hu_zyx", &hu_zyx)?, grid).map_err(IntoPy::into_py)?;
    let pose = affine("lps_from_camera", &lps_from_camera)?;
    let camera = camera(pose, fov_rad, width, height, lens.as_ref())?;
    let options = FrameOptions {
        interpolation: interpolation(nearest),
        light: None,
        appearance: None,
        background: [0.0; 3],
    };
    let table = &table.get().inner;
    let mut frame = Frame::new(volume, table, camera, options).map_err(IntoPy::into_py)?;
    if let Some((_, rest_from_lps)) = &moved {
        frame = frame.deformed(*rest_from_lps, &rest);
    }
    let simd = instruction_set(simd)?;
    let method = match &radius_zyx {
        None => Method::Brute,
        Some(radius) => Method::LeapTransparent(values("radius_zyx", radius)?),
    };
    let (shape, hits) = if let Some((column, row)) = pixel {
        (
            [1, 1],
            vec![pick(&frame, method, column, row).map_err(IntoPy::into_py)?],
        )
    } else {
        let (start, end) = rows.unwrap_or((0, height));
        let cast = || carina_raycast::cast_surface(&frame, method, start..end, simd);
        let (hits, _) = py.detach(cast).map_err(IntoPy::into_py)?;
        ([end - start, width], hits)
    };
    let depth = hits
        .iter()
        .map(|hit| hit.map_or(f32::NAN, |hit| hit.depth_mm));
    let depth = PyArray1::from_iter(py, depth).reshape(shape)?;
    let points = hits
        .iter()
        .flat_map(|hit| hit.map_or([f64::NAN; 3], |hit| hit.position_lps));
    let points = PyArray1::from_iter(py, points).reshape([shape[0], shape[1], 3])?;
    let normals = hits
        .iter()
        .flat_map(|hit| hit.map_or([f32::NAN; 3], |hit| hit.normal_lps));
    let normals = PyArray1::from_iter(py, normals).reshape([shape[0], shape[1], 3])?;
    Ok((depth, points, normals))
}

type GreyAndInside<'py> = (Bound<'py, PyArray2<u8>>, Bound<'py, PyArray2<u8>>);

/// Return the range of rows (first, one after the last) of a picture; all rows if `rows` is `None`.
pub(crate) fn rows_of(
    rows: Option<(usize, usize)>,
    height: usize,
) -> PyResult<std::ops::Range<usize>> {
    let (start, end) = rows.unwrap_or((0, height));
    if start < end && end <= height {
        return Ok(start..end);
    }
    Err(RaycastError::Setting {
        what: "rows",
        expected: format!("a first row and one after the last, in 0 to {height}"),
        found: format!("{start} to {end}"),
    }
    .into_py())
}

/// Sample rows of a plane; return grey levels and a mask of the pixels inside the volume, both (rows, width) uint8.
#[pyfunction]
#[pyo3(signature = (hu_zyx, lps_from_ijk, lps_from_pixel, *, width, height, window_hu, rows=None))]
fn cut_plane<'py>(
    py: Python<'py>,
    hu_zyx: PyReadonlyArray3<'py, i16>,
    lps_from_ijk: PyReadonlyArray2<'py, f64>,
    lps_from_pixel: PyReadonlyArray2<'py, f64>,
    width: usize,
    height: usize,
    window_hu: (f64, f64),
    rows: Option<(usize, usize)>,
) -> PyResult<GreyAndInside<'py>> {
    let grid = grid(&hu_zyx, &lps_from_ijk)?;
    let volume = VolumeView::new(values("hu_zyx", &hu_zyx)?, &grid).map_err(IntoPy::into_py)?;
    let place = affine("lps_from_pixel", &lps_from_pixel)?;
    let window = Window::new(window_hu.0, window_hu.1).map_err(IntoPy::into_py)?;
    let simd = instruction_set(None)?;
    let rows = rows_of(rows, height)?;
    let num_rows = rows.len();
    let image = pool::detached(py, || {
        sample_plane_by(volume, &place, width, rows, window, simd)
    })
    .map_err(IntoPy::into_py)?;
    let array = |data: Vec<u8>| PyArray1::from_vec(py, data).reshape([num_rows, width]);
    Ok((array(image.grey)?, array(image.inside)?))
}

/// Render rows of the tri-plane view in occlusion order; return (rows, width, 3) uint8.
#[pyfunction]
#[pyo3(signature = (
    hu_zyx, lps_from_ijk, centre_lps, lps_from_camera, *, fov_rad, width, height, window_hu, clear_below=None,
    background=[0; 3], brightness=[1.0; 3], rows=None
))]
fn tri_plane<'py>(
    py: Python<'py>,
    hu_zyx: PyReadonlyArray3<'py, i16>,
    lps_from_ijk: PyReadonlyArray2<'py, f64>,
    centre_lps: [f64; 3],
    lps_from_camera: PyReadonlyArray2<'py, f64>,
    fov_rad: f64,
    width: usize,
    height: usize,
    window_hu: (f64, f64),
    clear_below: Option<f32>,
    background: [u8; 3],
    brightness: [f32; 3],
    rows: Option<(usize, usize)>,
) -> PyResult<Bound<'py, PyArray3<u8>>> {
    let grid = grid(&hu_zyx, &lps_from_ijk)?;
    let volume = VolumeView::new(values("hu_zyx", &hu_zyx)?, &grid).map_err(IntoPy::into_py)?;
    let pose = affine("lps_from_camera", &lps_from_camera)?;
    let camera = Camera::new(pose, fov_rad, width, height).map_err(IntoPy::into_py)?;
    let planes = TriPlane {
        centre_lps,
        window: Window::new(window_hu.0, window_hu.1).map_err(IntoPy::into_py)?,
        clear_below,
        background,
        brightness,
    };
    let rows = rows_of(rows, height)?;
    let num_rows = rows.len();
    let rgb = pool::detached(py, || cast_tri_plane(volume, &planes, &camera, rows));
    volume_array(py, rgb, [num_rows, width, 3])
}

type ThreeProjections<'py> = (
    Bound<'py, PyArray2<i16>>,
    Bound<'py, PyArray2<i16>>,
    Bound<'py, PyArray2<i16>>,
);

/// Return the maximum intensity projections of a volume along i `[k, j]`, j `[k, i]` and k `[j, i]`.
#[pyfunction]
fn project_maximum<'py>(
    py: Python<'py>,
    hu_zyx: PyReadonlyArray3<'py, i16>,
) -> PyResult<ThreeProjections<'py>> {
    let shape = hu_zyx.shape();
    let (nk, nj, ni) = (shape[0], shape[1], shape[2]);
    let grid = carina_grid::Grid::new([nk, nj, ni], carina_grid::Affine::IDENTITY)
        .map_err(IntoPy::into_py)?;
    let volume = VolumeView::new(values("hu_zyx", &hu_zyx)?, &grid).map_err(IntoPy::into_py)?;
    let simd = instruction_set(None)?;
    let out = pool::detached(py, || maximum_projections_by(volume, simd));
    let array = |data: Vec<i16>, shape: [usize; 2]| PyArray1::from_vec(py, data).reshape(shape);
    Ok((
        array(out.along_i, [nk, nj])?,
        array(out.along_j, [nk, ni])?,
        array(out.along_k, [nj, ni])?,
    ))
}

/// Raise the values round a lumen, in place, so that the airway wall is opaque; the volume should be a copy.
#[pyfunction]
fn raise_wall(
    py: Python<'_>,
    mut values_zyx: numpy::PyReadwriteArray3<'_, i16>,
    lumen_zyx: PyReadonlyArray3<'_, u8>,
    part_zyx: [(usize, usize); 3],
    open_below: i16,
    heights: [Vec<i16>; 3],
) -> PyResult<()> {
    let shape = [
        lumen_zyx.shape()[0],
        lumen_zyx.shape()[1],
        lumen_zyx.shape()[2],
    ];
    let lumen = values("lumen_zyx", &lumen_zyx)?;
    let values = values_zyx.as_slice_mut()?;
    let heights = WallHeights {
        lumen: &heights[0],
        shell: &heights[1],
        backing: &heights[2],
    };
    pool::detached(py, || {
        carina_raycast::raise_wall(values, lumen, shape, part_zyx, open_below, heights)
    })
    .map_err(IntoPy::into_py)
}

/// Blur a mask to a smooth field with values of 0 to 1024.
#[pyfunction]
fn smooth_mask<'py>(
    py: Python<'py>,
    mask_zyx: PyReadonlyArray3<'py, u8>,
) -> PyResult<Bound<'py, PyArray3<i16>>> {
    let shape = [
        mask_zyx.shape()[0],
        mask_zyx.shape()[1],
        mask_zyx.shape()[2],
    ];
    let mask = values("mask_zyx", &mask_zyx)?;
    let field = pool::detached(py, || smoothed_mask(mask, shape));
    volume_array(py, field, shape)
}

/// Return the name of the instruction set that the casters use by default.
#[pyfunction]
pub(crate) fn best_instruction_set() -> PyResult<&'static str> {
    Ok(instruction_set(None)?.name())
}

pub(crate) fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_class::<TransferTable>()?;
    module.add_class::<CancelToken>()?;
    module.add_class::<Bricks>()?;
    module.add_function(wrap_pyfunction!(cast, module)?)?;
    module.add_function(wrap_pyfunction!(cast_surface, module)?)?;
    module.add_function(wrap_pyfunction!(cut_plane, module)?)?;
    module.add_function(wrap_pyfunction!(tri_plane, module)?)?;
    module.add_function(wrap_pyfunction!(project_maximum, module)?)?;
    module.add_function(wrap_pyfunction!(raise_wall, module)?)?;
    module.add_function(wrap_pyfunction!(smooth_mask, module)?)?;
    module.add_function(wrap_pyfunction!(best_instruction_set, module)?)?;
    Ok(())
}
