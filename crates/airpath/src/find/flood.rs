//! Flood of the lumen from the trachea with a rising threshold of the voxel values, and detection of leaks
//! (docs/algorithms.md).
//!
//! The threshold rises one unit (HU) at a time. A voxel joins the lumen if its value is at most the threshold and it
//! touches the lumen by a face; the voxels that become reachable through it at the same threshold join with it. These
//! voxels are the *basin* behind that voxel, which is the basin's *entry*. In an airway, basins are small, or they are
//! tubes; where the flood breaks through a wall, the basin is the lung, which is huge. So a basin above a size limit is
//! a leak: its voxels are removed again, and a ball round its entry (the breach) stays closed permanently, while the
//! flood rises elsewhere. The threshold is therefore local: thick-walled airways are filled up to the half-maximum of
//! their wall, thin ones up to just below the threshold at which they would leak.
//!
//! Above the values of tracheal air with its noise, a second test examines the surroundings of a basin. The wall of an
//! airway is clearly brighter than the threshold; the surroundings of a dark pocket of lung are not.

use carina_grid::{Grid, VolumeView};

use carina_leastcost::{TrackError, Watch};

/// Thresholds (voxel values) and sizes that limit a flood of the airways.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FloodLimits {
    /// Threshold at which the flood starts; all voxels up to it that are connected with the seeds are lumen.
    pub first_level: i16,
    /// Maximum value of tracheal air with its noise; above this threshold the flood also tests what surrounds a basin.
    pub core_level: i16,
    /// Threshold at which the flood ends, half-way between lumen and wall.
    pub last_level: i16,
    /// Maximum volume in mm^3 of a basin (connected dark region) up to the core level; a larger basin is a leak.
    pub leak_mm3: f64,
    /// Maximum volume in mm^3 of a basin (connected dark region) above the core level; a larger basin is a leak.
    pub small_leak_mm3: f64,
    /// Radius of the ball round the entry of a leak that the flood no longer enters, mm.
    pub closed_radius_mm: f64,
    /// Minimum mean difference between the values round a basin and the threshold, required above the core level only.
    pub min_contrast: f64,
}

/// Lumen that a flood has filled, and the leaks that it has closed.
#[derive(Debug, Clone, PartialEq)]
pub struct Flood {
    /// Mask of the lumen: 1 inside, 0 outside.
    pub lumen: Vec<u8>,
    /// Number of voxels in the lumen that the flood found.
    pub num_voxels: usize,
    /// Voxel at which each closed leak left the airways, and the threshold at that time.
    pub leaks: Vec<([usize; 3], i16)>,
    /// Number of basins (connected dark regions) that were rejected because they have no wall around them.
    pub num_without_wall: usize,
}

/// State of a voxel that the flood has not met yet.
const UNKNOWN: u8 = 0;
/// State of a voxel in the lumen.
const LUMEN: u8 = 1;
/// State of a voxel whose value was above the threshold when the flood met it; the voxel is in the list of its value.
const WAITING: u8 = 2;
/// State of a voxel that the flood never enters, because it is part of a leak.
const CLOSED: u8 = 3;

/// Flood the airways from `seeds` (voxels of the trachea) up to the last level.
///
/// # Errors
///
/// Returns an error if an argument is not valid or `watch` stops the flood.
pub fn flood(
    values: VolumeView<'_, i16>,
    seeds: &[[usize; 3]],
    limits: &FloodLimits,
    watch: &impl Watch,
) -> Result<Flood, TrackError> {
    if limits.first_level > limits.last_level {
        return Err(TrackError::Argument {
            what: "lumen threshold",
            expected: format!("at least {} (air in the trachea)", limits.first_level),
            found: limits.last_level.to_string(),
        });
    }
    let mut rising = Rising::new(values, limits);
    for seed in seeds {
        rising.wait(values.grid().index(*seed) as u32);
    }
    let (first, last) = (limits.first_level, limits.last_level);
    for level in first..=last {
        watch.report_fraction(f64::from(level - first) / f64::from((last - first).max(1)))?;
        rising.rise_to(level, watch)?;
    }
    rising.fill_holes();
    Ok(rising.finish())
}

struct Rising<'a> {
    values: VolumeView<'a, i16>,
    limits: &'a FloodLimits,
    state: Vec<u8>,
    /// Voxels whose value was above the threshold, one list for each value from the first threshold on.
    waiting: Vec<Vec<u32>>,
    leak_vox: usize,
    small_leak_vox: usize,
    num_voxels: usize,
    leaks: Vec<([usize; 3], i16)>,
    num_without_wall: usize,
    basin: Vec<u32>,
    met: Vec<u32>,
}

impl<'a> Rising<'a> {
    fn new(values: VolumeView<'a, i16>, limits: &'a FloodLimits) -> Self {
        let grid = values.grid();
        let voxel_mm3 = grid.lps_from_ijk().determinant().abs();
        let num_levels =
            (i32::from(limits.last_level) - i32::from(limits.first_level) + 1) as usize;
        Self {
            values,
            limits,
            state: vec![UNKNOWN; grid.num_voxels()],
            waiting: vec![Vec::new(); num_levels],
            leak_vox: (limits.leak_mm3 / voxel_mm3) as usize,
            small_leak_vox: (limits.small_leak_mm3 / voxel_mm3) as usize,
            num_voxels: 0,
            leaks: Vec::new(),
            num_without_wall: 0,
            basin: Vec::new(),
            met: Vec::new(),
        }
    }

    fn wait(&mut self, voxel: u32) {
        let value = self.values.data()[voxel as usize];
        if value <= self.limits.last_level && self.state[voxel as usize] == UNKNOWN {
            let slot = (i32::from(value) - i32::from(self.limits.first_level)).max(0) as usize;
            self.waiting[slot].push(voxel);
            self.state[voxel as usize] = WAITING;
        }
    }

    fn rise_to(&mut self, level: i16, watch: &impl Watch) -> Result<(), TrackError> {
        let slot = (i32::from(level) - i32::from(self.limits.first_level)) as usize;
        let mut next = 0;
        // Voxels can be added to this level's list while it is processed.
        while next < self.waiting[slot].len() {
            let entry = self.waiting[slot][next];
            next += 1;
            if self.state[entry as usize] == WAITING {
                self.open(entry, level, watch)?;
            }
        }
        self.waiting[slot] = Vec::new();
        Ok(())
    }

    /// Add the basin (connected dark region) of one waiting voxel to the lumen, or reject it as a leak or as lung
    /// without wall.
    fn open(&mut self, entry: u32, level: i16, watch: &impl Watch) -> Result<(), TrackError> {
        let limit = if level > self.limits.core_level {
            self.small_leak_vox
        } else {
            self.leak_vox
        };
        self.basin.clear();
        self.met.clear();
        self.basin.push(entry);
        self.state[entry as usize] = LUMEN;
        let (mut around_sum, mut around_count, mut lumen_count) = (0i64, 0i64, 0i64);
        let mut next = 0;
        while next < self.basin.len() && self.basin.len() <= limit {
            let voxel = self.basin[next];
            next += 1;
            if next.is_multiple_of(1 << 16) {
                watch.report_fraction(0.0)?;
            }
            let (data, state) = (self.values.data(), &mut self.state);
            let (basin, met) = (&mut self.basin, &mut self.met);
            for_each_face(self.values.grid(), voxel as usize, |at| {
                let value = data[at];
                match state[at] {
                    UNKNOWN | WAITING if value <= level => {
                        // A waiting voxel at or below the level belongs to the list of this level.
                        state[at] = LUMEN;
                        basin.push(at as u32);
                    }
                    UNKNOWN => {
                        met.push(at as u32);
                        around_sum += i64::from(value);
                        around_count += 1;
                    }
                    WAITING | CLOSED => {
                        around_sum += i64::from(value);
                        around_count += 1;
                    }
                    _ => lumen_count += 1,
                }
            });
        }
        if self.basin.len() > limit {
            self.close(entry, level);
            return Ok(());
        }
        // A basin with lumen on most sides is noise inside the lumen or the rim of its wall, not a leak.
        if level > self.limits.core_level && around_count > lumen_count {
            let contrast = around_sum as f64 / around_count as f64 - f64::from(level);
            if contrast < self.limits.min_contrast {
                for at in &self.basin {
                    self.state[*at as usize] = CLOSED;
                }
                self.num_without_wall += 1;
                return Ok(());
            }
        }
        self.num_voxels += self.basin.len();
        for n in 0..self.met.len() {
            let at = self.met[n];
            self.wait(at);
        }
        Ok(())
    }

    /// Remove a leaking basin from the lumen and close the ball round its entry.
    fn close(&mut self, entry: u32, level: i16) {
        for at in &self.basin {
            self.state[*at as usize] = UNKNOWN;
        }
        let grid = self.values.grid();
        let centre = grid.voxel(entry as usize);
        self.leaks.push((centre, level));
        let (shape, spacing) = (grid.shape_ijk(), grid.spacing_mm());
        let reach: [usize; 3] =
            std::array::from_fn(|a| (self.limits.closed_radius_mm / spacing[a]) as usize);
        let low: [usize; 3] = std::array::from_fn(|a| centre[a].saturating_sub(reach[a]));
        let high: [usize; 3] = std::array::from_fn(|a| (centre[a] + reach[a]).min(shape[a] - 1));
        for k in low[2]..=high[2] {
            for j in low[1]..=high[1] {
                for i in low[0]..=high[0] {
                    let at = grid.index([i, j, k]);
                    let off = carina_grid::length([
                        (i as f64 - centre[0] as f64) * spacing[0],
                        (j as f64 - centre[1] as f64) * spacing[1],
                        (k as f64 - centre[2] as f64) * spacing[2],
                    ]);
                    if off <= self.limits.closed_radius_mm && self.state[at] != LUMEN {
                        self.state[at] = CLOSED;
                    }
                }
            }
        }
        self.state[entry as usize] = CLOSED;
    }

    /// Fill holes that the lumen encloses on all sides (noise, mucus, the wall of a tube), within the bounding box of
    /// the lumen.
    fn fill_holes(&mut self) {
        let grid = self.values.grid();
        let shape = grid.shape_ijk();
        let (mut low, mut high) = ([usize::MAX; 3], [0usize; 3]);
        for at in 0..self.state.len() {
            if self.state[at] == LUMEN {
                let voxel = grid.voxel(at);
                for axis in 0..3 {
                    low[axis] = low[axis].min(voxel[axis]);
                    high[axis] = high[axis].max(voxel[axis]);
                }
            } else {
                // From here on, `UNKNOWN` marks voxels that are not connected with the outside of the box.
                self.state[at] = UNKNOWN;
            }
        }
        if low[0] > high[0] {
            return;
        }
        let low: [usize; 3] = std::array::from_fn(|a| low[a].saturating_sub(1));
        let high: [usize; 3] = std::array::from_fn(|a| (high[a] + 1).min(shape[a] - 1));
        let mut open = Vec::new();
        for k in low[2]..=high[2] {
            for j in low[1]..=high[1] {
                let face = k == low[2] || k == high[2] || j == low[1] || j == high[1];
                let step = if face { 1 } else { (high[0] - low[0]).max(1) };
                for i in (low[0]..=high[0]).step_by(step) {
                    let at = grid.index([i, j, k]);
                    if self.state[at] == UNKNOWN {
                        self.state[at] = CLOSED;
                        open.push(at as u32);
                    }
                }
            }
        }
        while let Some(at) = open.pop() {
            let at = at as usize;
            let voxel = grid.voxel(at);
            for (axis, step) in [1, shape[0], shape[0] * shape[1]].into_iter().enumerate() {
                let before = (voxel[axis] > low[axis]).then(|| at - step);
                let after = (voxel[axis] < high[axis]).then(|| at + step);
                for next in before.into_iter().chain(after) {
                    if self.state[next] == UNKNOWN {
                        self.state[next] = CLOSED;
                        open.push(next as u32);
                    }
                }
            }
        }
        for k in low[2]..=high[2] {
            for j in low[1]..=high[1] {
                for i in low[0]..=high[0] {
                    let at = grid.index([i, j, k]);
                    if self.state[at] == UNKNOWN {
                        self.state[at] = LUMEN;
                        self.num_voxels += 1;
                    }
                }
            }
        }
    }

    fn finish(mut self) -> Flood {
        for state in &mut self.state {
            *state = u8::from(*state == LUMEN);
        }
        Flood {
            lumen: self.state,
            num_voxels: self.num_voxels,
            leaks: self.leaks,
            num_without_wall: self.num_without_wall,
        }
    }
}

/// Call `visit` with the index of each of the up to six voxels that share a face with voxel `at`.
fn for_each_face(grid: &Grid, at: usize, mut visit: impl FnMut(usize)) {
    let [nx, ny, nz] = grid.shape_ijk();
    let [i, j, k] = grid.voxel(at);
    if i > 0 {
        visit(at - 1);
    }
    if i + 1 < nx {
        visit(at + 1);
    }
    if j > 0 {
        visit(at - nx);
    }
    if j + 1 < ny {
        visit(at + nx);
    }
    if k > 0 {
        visit(at - nx * ny);
    }
    if k + 1 < nz {
        visit(at + nx * ny);
    }
}
