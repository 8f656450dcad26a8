//! Normals of walls, from a smoothed gradient of the volume.

use std::sync::Arc;

use crate::{
    Frame, NormalBricks, RaycastError, TransferTable,
    bricks::{AXIS_AT, AXIS_WEIGHT, CORNER_AT, CORNER_WEIGHT, MAX_BRICKS},
    frame::Ray,
    sampling::Lanes,
};

/// Distance in mm from a wall to the samples for its normal.
///
/// The noise of a CT has about this grain size; cartilage rings are several times as wide.
const NORMAL_REACH_MM: f64 = 0.9;
/// Minimum distance in voxels from a wall to the samples for its normal.
///
/// Within one voxel, values are linear and contain no noise to smooth.
const NORMAL_REACH_VOX: f64 = 0.8;
/// Half of the contrast between air and tissue, HU.
const HALF_CONTRAST_HU: f32 = 500.0;

/// Parameters of a frame for the normals of its walls.
///
/// The normal is a gradient over [`NORMAL_REACH_MM`], so that noise does not appear as a rough surface. Values are
/// limited to a range round the wall's own value: other structures behind or before the wall (vessels, bone, noise of
/// the air) do not influence the normal.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Normals {
    /// Distance in voxels, along each axis, from the wall to the samples from which its normal is computed.
    pub reach: [f32; 3],
    /// Lower and upper limit to which the sampled values are clamped before the gradient is computed.
    pub held: [f32; 2],
    /// Matrix from differences along the voxel axes to the inward normal in LPS, `inward = rows . differences`.
    ///
    /// The matrix is the transposed inverse of the voxel axes, divided by the reach.
    pub rows: [[f32; 3]; 3],
}

impl Normals {
    pub(crate) fn of(frame: &Frame<'_>) -> Self {
        let reach = frame
            .rest_spacing_mm
            .map(|spacing| (NORMAL_REACH_MM / spacing).max(NORMAL_REACH_VOX));
        let ijk_from_lps = frame.grid.ijk_from_lps();
        let rows = ijk_from_lps.rows();
        Self {
            reach: reach.map(|v| v as f32),
            held: held_between(frame.table),
            rows: std::array::from_fn(|x| std::array::from_fn(|a| (rows[a][x] / reach[a]) as f32)),
        }
    }

    /// Return the unit normal (LPS) of the wall at distance `hit` along a ray, on the camera's side.
    pub(crate) fn at(&self, frame: &Frame<'_>, ray: &Ray, hit: f32) -> [f32; 3] {
        let p: Lanes = std::array::from_fn(|a| hit.mul_add(ray.delta[a], ray.origin[a]));
        let [low, high] = self.held;
        let value = |p: Lanes| frame.field.value_in(&frame.field.cell(p));
        let held = |p: Lanes| value(p).max(low).min(high);
        let mut rise = [0.0f32; 3];
        for a in 0..3 {
            let (mut before, mut after) = (p, p);
            before[a] = (-AXIS_AT).mul_add(self.reach[a], p[a]);
            after[a] = AXIS_AT.mul_add(self.reach[a], p[a]);
            rise[a] = AXIS_WEIGHT * (held(after) - held(before));
        }
        for corner in 0..4 {
            // The difference between a corner of the cube and the opposite corner.
            let side = [1.0, [1.0f32, -1.0][corner & 1], [1.0f32, -1.0][corner >> 1]];
            let (mut before, mut after) = (p, p);
            for a in 0..3 {
                let off = side[a] * CORNER_AT;
                before[a] = (-off).mul_add(self.reach[a], p[a]);
                after[a] = off.mul_add(self.reach[a], p[a]);
            }
            let across = CORNER_WEIGHT * (held(after) - held(before));
            for a in 0..3 {
                rise[a] = side[a].mul_add(across, rise[a]);
            }
        }
        let inward: [f32; 3] = std::array::from_fn(|x| dot(rise, self.rows[x]));
        let lps_from_ijk = frame.grid.lps_from_ijk();
        let along = lps_from_ijk
            .vector([0, 1, 2].map(|a| f64::from(ray.delta[a])))
            .map(|v| v as f32 / frame.step_mm);
        let length = dot(inward, inward).sqrt();
        // A rise of at most 1e-3 HU over the box is a rounding error.
        if length <= 1e-3 {
            return along.map(|v| -v);
        }
        let outward = if dot(inward, along) < 0.0 { 1.0 } else { -1.0 } / length;
        inward.map(|v| outward * v)
    }
}

pub(crate) fn dot(u: [f32; 3], v: [f32; 3]) -> f32 {
    u[2].mul_add(v[2], u[1].mul_add(v[1], u[0] * v[0]))
}

/// Return the range of values that determines the normal of a wall.
///
/// The middle of the range is the middle of the transfer function's rise from transparent to opaque. The range includes
/// this rise and at least half of the contrast between air and tissue on each side of the middle, and is limited to the
/// values of the volume.
fn held_between(table: &TransferTable) -> [f32; 2] {
    let most = table.entries.iter().map(|e| e[3]).fold(0.0, f32::max);
    let opaque = table.entries.iter().position(|e| e[3] >= 0.9 * most);
    let (clear, opaque) = (table.first_visible, opaque.unwrap_or(0) as i32);
    let middle = table.lo_hu as f32 + 0.5 * (clear + opaque) as f32;
    let window = (0.8 * (opaque - clear) as f32)
        .max(HALF_CONTRAST_HU)
        .min(table.last as f32 / 2.0)
        .max(1.0);
    [middle - window, middle + window]
}

impl NormalBricks {
    /// Create an empty cache of wall normals for the volume and the transfer function of a frame.
    #[must_use]
    pub fn of(frame: &Frame<'_>) -> Self {
        Self::with_capacity(frame, MAX_BRICKS)
    }

    /// Create an empty cache of at most `most` bricks of wall normals, for the volume and the transfer function of a
    /// frame.
    #[must_use]
    pub fn with_capacity(frame: &Frame<'_>, most: usize) -> Self {
        let normals = Normals::of(frame);
        Self::new(frame.grid.shape_ijk(), normals.reach, normals.held, most)
    }

    /// Return whether the bricks were created for the shape and the parameters of a frame.
    ///
    /// The caller must ensure that the frame shows the same values.
    #[must_use]
    pub fn fit(&self, frame: &Frame<'_>) -> bool {
        let normals = Normals::of(frame);
        self.are(frame.grid.shape_ijk(), normals.reach, normals.held)
    }
}

impl Frame<'_> {
    /// Return the frame with cached bricks of wall normals of its volume.
    ///
    /// The caller must ensure that `bricks` was filled from the same values.
    ///
    /// # Errors
    ///
    /// Returns an error if the bricks are not for a volume of this shape and this transfer function.
    pub fn with_normals(mut self, bricks: Arc<NormalBricks>) -> Result<Self, RaycastError> {
        if !bricks.fit(&self) {
            return Err(RaycastError::Setting {
                what: "bricks of normals",
                expected: "those of this volume's shape and this transfer function".to_owned(),
                found: "others".to_owned(),
            });
        }
        self.bricks = Some(bricks);
        Ok(self)
    }
}
