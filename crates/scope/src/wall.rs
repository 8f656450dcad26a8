//! Wall of the lumen as a signed distance field, which gives the distance from the wall and the direction away from it.
//!
//! Distances are samples on a lattice and are interpolated trilinearly. Only bricks of the lattice near the wall are
//! stored, because a trachea and its branches fill a small part of a large box.

use std::sync::Arc;

use carina_grid::Affine;

use crate::ScopeError;
use crate::ridge::{Ridge, Ridges};
use crate::tube::{BLOCKS, Bricks, Tube};

/// Number of cells of a brick on each axis; a brick stores one more sample, so that a cell never needs two bricks.
pub(crate) const CELLS: usize = 8;
/// Number of samples of the distance in a brick on each axis.
const SIDE: usize = CELLS + 1;
/// Number of samples of the distance in a brick.
pub(crate) const SAMPLES: usize = SIDE * SIDE * SIDE;
/// Number of bytes of the transform and of the shape at the start of a serialised field.
const HEAD_BYTES: usize = 8 * 15;
/// Maximum distance outside the lumen that is stored, mm; larger distances are limited to this one.
pub(crate) const OUTSIDE_MM: f64 = 2.5;
/// Maximum distance inside the lumen that is stored, mm, more than any scope's radius; larger distances are
/// limited to this one.
pub(crate) const INSIDE_MM: f64 = 4.5;
/// Number above which a number of type f64 has no fraction, 2^52.
const WHOLE: f64 = 4_503_599_627_370_496.0;
/// Entry of a brick (cube of samples) that is far outside the lumen.
const FAR_OUTSIDE: u32 = u32::MAX;
/// Entry of a brick (cube of samples) that is inside the lumen and far from the wall.
const FAR_INSIDE: u32 = u32::MAX - 1;

/// Content of a brick (cube of samples) of the lattice.
pub(crate) enum Brick {
    /// The brick is outside the lumen; all samples are farther than [`OUTSIDE_MM`] from the wall.
    Outside,
    /// The brick is inside the lumen; all samples are farther than [`INSIDE_MM`] from the wall.
    Inside,
    /// The brick is near the wall; the samples are stored, x fastest.
    Near(Vec<f32>),
}

impl Brick {
    /// Create a brick from its samples, which are stored only if the brick is near the wall.
    pub(crate) fn of(samples: Vec<f32>) -> Self {
        if samples.iter().all(|&d| f64::from(d) <= -OUTSIDE_MM) {
            Self::Outside
        } else if samples.iter().all(|&d| f64::from(d) >= INSIDE_MM) {
            Self::Inside
        } else {
            Self::Near(samples)
        }
    }
}

/// Signed distance field of a lumen's wall, in mm, positive in the lumen.
#[derive(Debug, Clone, PartialEq)]
pub struct WallField {
    lattice_from_lps: Affine,
    lps_from_lattice: Affine,
    /// Number of samples of the wall field along i, j, k.
    shape_ijk: [usize; 3],
    /// Indices of the wall field's last sample along i, j, k.
    last_ijk: [f64; 3],
    num_bricks: [usize; 3],
    brick_at: Arc<Vec<u32>>,
    samples: Arc<Vec<f32>>,
    /// Step of the finite differences in mm: half of the smallest sample spacing.
    step_mm: f64,
    /// Tube whose inside belongs to the lumen too; its wall is not sampled.
    tube: Option<Tube>,
    /// Deformation of the tissue since the samples were computed; `None` if the tissue is at rest.
    strain: Option<Strain>,
    /// Plates of tissue that belong to the wall, also inside the tube; they are not sampled.
    ridges: Option<Arc<Ridges>>,
}

/// Affine deformation of the tissue round the lumen.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Strain {
    rest_from_lps: Affine,
    /// Smallest factor by which the deformation changes a distance to a wall.
    least: f64,
}

impl Strain {
    /// Return the factor by which the deformation changes the distance to a plane wall with a unit normal at rest.
    fn factor(&self, normal: [f64; 3]) -> f64 {
        // A normal transforms by the inverse transpose of the deformation, whose length is the inverse of the factor.
        let rows = self.rest_from_lps.rows();
        let moved: [f64; 3] = std::array::from_fn(|a| {
            rows[0][a] * normal[0] + rows[1][a] * normal[1] + rows[2][a] * normal[2]
        });
        1.0 / carina_grid::length(moved)
    }
}

impl WallField {
    /// Create a field from signed distances on a grid, positive in the lumen, `[z, y, x]` with x fastest.
    ///
    /// # Errors
    ///
    /// Returns an error if the number of distances does not match the shape, if a distance is NaN, or if there is no
    /// lumen.
    pub fn from_distances(
        distance_mm: &[f32],
        shape_ijk: [usize; 3],
        lps_from_ijk: &Affine,
    ) -> Result<Self, ScopeError> {
        if distance_mm.len() != shape_ijk.iter().product::<usize>() {
            return Err(ScopeError::Wall {
                reason: format!(
                    "expected a distance for each of {shape_ijk:?} samples, found {}",
                    distance_mm.len()
                ),
            });
        }
        if let Some(at) = distance_mm.iter().position(|d| d.is_nan()) {
            return Err(ScopeError::Wall {
                reason: format!("the distance of sample {at} is not a number"),
            });
        }
        let [nx, ny, _] = shape_ijk;
        Self::build(shape_ijk, *lps_from_ijk, |first| {
            let samples: Vec<f32> = (0..SAMPLES)
                .map(|n| {
                    let local = [n % SIDE, n / SIDE % SIDE, n / SIDE / SIDE];
                    let at: [usize; 3] =
                        std::array::from_fn(|a| (first[a] + local[a]).min(shape_ijk[a] - 1));
                    clamped(distance_mm[(at[2] * ny + at[1]) * nx + at[0]])
                })
                .collect();
            Brick::of(samples)
        })
    }

    /// Create a field of bricks; `brick` returns each brick from the lattice position of its first sample.
    pub(crate) fn build(
        shape_ijk: [usize; 3],
        lps_from_lattice: Affine,
        mut brick: impl FnMut([usize; 3]) -> Brick,
    ) -> Result<Self, ScopeError> {
        let Some(lattice_from_lps) = lps_from_lattice.inverse() else {
            return Err(ScopeError::Wall {
                reason: "the lattice has no volume".to_owned(),
            });
        };
        if shape_ijk.iter().any(|&n| n < 2) {
            return Err(ScopeError::Wall {
                reason: format!("expected two samples or more on each axis, found {shape_ijk:?}"),
            });
        }
        let num_bricks = shape_ijk.map(|n| (n - 1).div_ceil(CELLS));
        let mut brick_at = Vec::with_capacity(num_bricks.iter().product());
        let mut samples: Vec<f32> = Vec::new();
        for n in 0..num_bricks.iter().product::<usize>() {
            let [bx, by, _] = num_bricks;
            let first = [n % bx, n / bx % by, n / bx / by].map(|b| b * CELLS);
            brick_at.push(match brick(first) {
                Brick::Outside => FAR_OUTSIDE,
                Brick::Inside => FAR_INSIDE,
                Brick::Near(values) => {
                    samples.extend_from_slice(&values);
                    (samples.len() / SAMPLES - 1) as u32
                }
            });
        }
        if samples.is_empty() {
            return Err(ScopeError::Wall {
                reason: "the lattice contains no wall".to_owned(),
            });
        }
        let spacing = [0, 1, 2].map(|a| carina_grid::length(lps_from_lattice.column(a)));
        Ok(Self {
            lattice_from_lps,
            lps_from_lattice,
            shape_ijk,
            last_ijk: shape_ijk.map(|n| (n - 1) as f64),
            num_bricks,
            brick_at: Arc::new(brick_at),
            samples: Arc::new(samples),
            step_mm: 0.5 * spacing[0].min(spacing[1]).min(spacing[2]),
            tube: None,
            strain: None,
            ridges: None,
        })
    }

    /// Return a field whose lumen also contains a tube; the tube replaces an earlier one.
    ///
    /// The tube is the union of the balls round its axis, with radii that change linearly between the given points. Its
    /// wall is computed, not sampled, so a narrow tube has its full radius on its axis. Parts of the tube beyond the
    /// lattice are ignored.
    ///
    /// # Errors
    ///
    /// Returns an error if the numbers of points and radii differ, if there are fewer than two points, or if a value is
    /// not finite or a radius is not above 0.
    pub fn with_tube(&self, axis_lps: &[[f64; 3]], radius_mm: &[f64]) -> Result<Self, ScopeError> {
        self.with_tube_and_excess(axis_lps, radius_mm, &vec![0.0; radius_mm.len()])
    }

    /// Return a field with a tube, whose sampled wall is too wide near the axis and is moved inwards by an excess.
    ///
    /// The excess in mm, 0 or more, changes linearly between the given points.
    ///
    /// # Errors
    ///
    /// Returns an error as [`WallField::with_tube`] does, or if the excess is not valid.
    pub fn with_tube_and_excess(
        &self,
        axis_lps: &[[f64; 3]],
        radius_mm: &[f64],
        excess_mm: &[f64],
    ) -> Result<Self, ScopeError> {
        if self.strain.is_some() {
            return Err(ScopeError::Wall {
                reason: "it is deformed; add the tube to the wall at rest".to_owned(),
            });
        }
        let tube = Tube::new(axis_lps, radius_mm, excess_mm, self)?;
        Ok(Self {
            tube: Some(tube),
            ..self.clone()
        })
    }

    /// Return the field of the same wall after an affine deformation of the tissue, given as a map from rest to patient
    /// space. The samples are shared.
    ///
    /// A distance is that at rest times the factor of the nearest wall's direction, which is exact for a plane wall. The
    /// limits of the distance are multiplied by the smallest factor.
    ///
    /// # Errors
    ///
    /// Returns an error if the map is singular or mirrors the tissue, or if the field is already deformed.
    pub fn deformed(&self, lps_from_rest: &Affine) -> Result<Self, ScopeError> {
        let refuse = |reason: &str| {
            Err(ScopeError::Wall {
                reason: reason.to_owned(),
            })
        };
        if self.strain.is_some() {
            return refuse("it is already deformed; deform the wall at rest");
        }
        let Some(rest_from_lps) = lps_from_rest
            .inverse()
            .filter(|_| lps_from_rest.determinant() > 0.0)
        else {
            return refuse("the deformation is singular or mirrors the tissue");
        };
        Ok(Self {
            strain: Some(Strain {
                rest_from_lps,
                least: 1.0 / largest_stretch(&rest_from_lps),
            }),
            ..self.clone()
        })
    }

    /// Return a field whose wall also contains ridges; they replace earlier ones.
    ///
    /// A ridge is part of the wall also inside a tube ([`WallField::with_tube`]).
    ///
    /// # Errors
    ///
    /// Returns an error if there are more than [`crate::MAX_RIDGES`] ridges, if one of them is not a plate, or if the
    /// field is deformed.
    pub fn with_ridges(&self, ridges: &[Ridge]) -> Result<Self, ScopeError> {
        if self.strain.is_some() {
            return Err(ScopeError::Wall {
                reason: "ridges are added to the wall at rest, before it is deformed".to_owned(),
            });
        }
        let [nx, ny, _] = self.num_bricks;
        let corner = |at: [f64; 3]| self.to_lps(at);
        let half_mm = 0.5
            * (0..4u32)
                .map(|n| {
                    let low = std::array::from_fn(|a| f64::from(a > 0 && n >> (a - 1) & 1 == 1));
                    let high = low.map(|v: f64| 1.0 - v);
                    crate::body::distance(corner(high), corner(low))
                })
                .fold(0.0, f64::max);
        let made = Ridges::new(ridges, self.brick_at.len(), |n| {
            let brick = [n % nx, n / nx % ny, n / nx / ny];
            (corner(brick.map(|b| b as f64 + 0.5)), half_mm)
        })?;
        Ok(Self {
            ridges: Some(Arc::new(made)),
            ..self.clone()
        })
    }

    /// Return whether the field is that of a deformed tissue ([`WallField::deformed`]).
    #[must_use]
    pub const fn is_deformed(&self) -> bool {
        self.strain.is_some()
    }

    /// Return whether all of the wall is sampled: the field contains neither a tube nor ridges.
    #[must_use]
    pub const fn is_sampled(&self) -> bool {
        self.tube.is_none() && self.ridges.is_none()
    }

    /// Return the transform from the lattice of samples to patient space.
    #[must_use]
    pub const fn lps_from_lattice(&self) -> &Affine {
        &self.lps_from_lattice
    }

    /// Return the memory of the stored samples in bytes.
    #[must_use]
    pub fn num_bytes(&self) -> usize {
        self.samples.len() * size_of::<f32>()
    }

    /// Call `take` with the serialised field as successive parts; equal fields give equal bytes.
    ///
    /// The bytes of a field with a tube or ridges identify the field but cannot be decoded.
    pub fn for_each_part(&self, mut take: impl FnMut(&[u8])) {
        for row in self.lps_from_lattice.rows() {
            for v in row {
                take(&v.to_le_bytes());
            }
        }
        for n in self.shape_ijk {
            take(&(n as u64).to_le_bytes());
        }
        let mut piece = Vec::new();
        for brick in self.brick_at.iter() {
            piece.extend_from_slice(&brick.to_le_bytes());
        }
        take(&piece);
        for brick in self.samples.chunks(SAMPLES) {
            piece.clear();
            for v in brick {
                piece.extend_from_slice(&v.to_le_bytes());
            }
            take(&piece);
        }
        if let Some(tube) = &self.tube {
            tube.for_each_part(&mut take);
        }
        if let Some(strain) = &self.strain {
            for v in strain.rest_from_lps.rows().iter().flatten() {
                take(&v.to_le_bytes());
            }
        }
        if let Some(ridges) = &self.ridges {
            ridges.for_each_part(take);
        }
    }

    /// Decode a field from the joined parts of [`WallField::for_each_part`].
    ///
    /// # Errors
    ///
    /// Returns an error if the bytes are not a field.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, ScopeError> {
        let refuse = |reason: &str| ScopeError::Wall {
            reason: format!("the bytes are not those of a wall: {reason}"),
        };
        let (head, rest) = bytes
            .split_at_checked(HEAD_BYTES)
            .ok_or_else(|| refuse("they are too short"))?;
        let word = |n: usize| -> [u8; 8] { std::array::from_fn(|k| head[8 * n + k]) };
        let rows: [[f64; 4]; 3] =
            std::array::from_fn(|r| std::array::from_fn(|c| f64::from_le_bytes(word(4 * r + c))));
        let lps_from_lattice = Affine::from_rows(rows);
        if rows.iter().flatten().any(|v| !v.is_finite()) {
            return Err(refuse("the lattice is not finite"));
        }
        let shape = [12, 13, 14].map(|n| u64::from_le_bytes(word(n)));
        // 2^16 samples on an axis are 26 m; the limit prevents an overflow of the products below.
        if shape.iter().any(|n| !(2..=1 << 16).contains(n)) {
            return Err(refuse("the shape of the lattice is out of range"));
        }
        let shape_ijk = shape.map(|n| n as usize);
        let num_bricks = shape_ijk.map(|n| (n - 1).div_ceil(CELLS));
        let (bricks, samples) = rest
            .split_at_checked(4 * num_bricks.iter().product::<usize>())
            .ok_or_else(|| refuse("they are too short"))?;
        let brick_at: Vec<u32> = bricks
            .chunks_exact(4)
            .map(|b| u32::from_le_bytes([b[0], b[1], b[2], b[3]]))
            .collect();
        if samples.is_empty() || samples.len() % (4 * SAMPLES) != 0 {
            return Err(refuse("samples are missing"));
        }
        let num_stored = samples.len() / (4 * SAMPLES);
        if brick_at
            .iter()
            .any(|&b| b < FAR_INSIDE && b as usize >= num_stored)
        {
            return Err(refuse("a brick has no samples"));
        }
        let samples: Vec<f32> = samples
            .chunks_exact(4)
            .map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]]))
            .collect();
        if samples.iter().any(|d| d.is_nan()) {
            return Err(refuse("a distance is not a number"));
        }
        let Some(lattice_from_lps) = lps_from_lattice.inverse() else {
            return Err(refuse("the lattice has no volume"));
        };
        let spacing = [0, 1, 2].map(|a| carina_grid::length(lps_from_lattice.column(a)));
        Ok(Self {
            lattice_from_lps,
            lps_from_lattice,
            shape_ijk,
            last_ijk: shape_ijk.map(|n| (n - 1) as f64),
            num_bricks,
            brick_at: Arc::new(brick_at),
            samples: Arc::new(samples),
            step_mm: 0.5 * spacing[0].min(spacing[1]).min(spacing[2]),
            tube: None,
            strain: None,
            ridges: None,
        })
    }

    /// Return the distance from a point to the wall in mm, positive in the lumen.
    ///
    /// The distance is limited to -2.5 mm outside (also beyond the lattice, and for a NaN) and to 4.5 mm inside.
    #[must_use]
    pub fn distance_mm(&self, p_lps: [f64; 3]) -> f64 {
        self.distance_up_to(p_lps, f64::INFINITY)
    }

    /// Return the distance from a point to the wall in mm, if it is below a limit.
    ///
    /// Otherwise the result may be any value from the limit to the distance. The method is faster than
    /// [`WallField::distance_mm`], because the distance to the tube is not computed where the samples reach the limit.
    pub(crate) fn distance_up_to(&self, p_lps: [f64; 3], limit_mm: f64) -> f64 {
        match &self.strain {
            None => self.distance_at_rest(p_lps, limit_mm),
            Some(strain) => self.strained_distance(strain, p_lps),
        }
    }

    fn strained_distance(&self, strain: &Strain, p_lps: [f64; 3]) -> f64 {
        let p = strain.rest_from_lps.point(p_lps);
        let factor = carina_grid::unit(self.slope_at_rest(p))
            .map_or(strain.least, |normal| strain.factor(normal));
        (factor * self.distance_at_rest(p, f64::INFINITY))
            .clamp(-OUTSIDE_MM * strain.least, INSIDE_MM * strain.least)
    }

    /// Return the differences of the distance at rest over twice the step along each axis.
    fn slope_at_rest(&self, p: [f64; 3]) -> [f64; 3] {
        let h = self.step_mm;
        std::array::from_fn(|a| {
            let (mut low, mut high) = (p, p);
            low[a] -= h;
            high[a] += h;
            self.distance_at_rest(high, f64::INFINITY) - self.distance_at_rest(low, f64::INFINITY)
        })
    }

    fn distance_at_rest(&self, p_lps: [f64; 3], limit_mm: f64) -> f64 {
        let at = self.lattice_from_lps.point(p_lps);
        let mut cell = [0usize; 3];
        let mut share = [0.0; 3];
        for a in 0..3 {
            // The comparison is negated so that a NaN counts as outside.
            if !(at[a] >= 0.0 && at[a] <= self.last_ijk[a]) {
                return -OUTSIDE_MM;
            }
            // A sum with 2^52 rounds to a whole number, which is the low half of its bits: conversions take longer.
            let mut whole = (at[a] + WHOLE) - WHOLE;
            if whole > at[a] {
                whole -= 1.0;
            }
            whole = whole.min(self.last_ijk[a] - 1.0);
            cell[a] = (whole + WHOLE).to_bits() as u32 as usize;
            share[a] = at[a] - whole;
        }
        let b = cell.map(|c| c / CELLS);
        let n = (b[2] * self.num_bricks[1] + b[1]) * self.num_bricks[0] + b[0];
        let sampled = self.sampled_mm(n, cell, b, share);
        let mm = match &self.tube {
            Some(tube) => {
                let block = std::array::from_fn(|a| (cell[a] - b[a] * CELLS) * BLOCKS / CELLS);
                let narrowed = if tube.has_excess() {
                    (sampled - tube.excess_mm(n, block, p_lps)).max(-OUTSIDE_MM)
                } else {
                    sampled
                };
                if narrowed < limit_mm {
                    tube.at_least(n, block, p_lps, narrowed)
                } else {
                    narrowed
                }
            }
            None => sampled,
        };
        match &self.ridges {
            Some(ridges) => ridges.at_most(n, p_lps, mm).max(-OUTSIDE_MM),
            None => mm,
        }
    }

    /// Return the distance in mm at a position in a cell of brick `n`; `b` are the indices of the brick, `share` is the
    /// position in the cell, 0 to 1 on each axis.
    fn sampled_mm(&self, n: usize, cell: [usize; 3], b: [usize; 3], share: [f64; 3]) -> f64 {
        let brick = self.brick_at[n];
        if brick >= FAR_INSIDE {
            return if brick == FAR_INSIDE {
                INSIDE_MM
            } else {
                -OUTSIDE_MM
            };
        }
        let local: [usize; 3] = std::array::from_fn(|a| cell[a] - b[a] * CELLS);
        let first = brick as usize * SAMPLES + (local[2] * SIDE + local[1]) * SIDE + local[0];
        let corners = &self.samples[first..first + SIDE * SIDE + SIDE + 2];
        let value = |offset: usize| f64::from(corners[offset]);
        let mix = |a: f64, b: f64, t: f64| a + t * (b - a);
        let row = |offset: usize| mix(value(offset), value(offset + 1), share[0]);
        let plane = |offset: usize| mix(row(offset), row(offset + SIDE), share[1]);
        mix(plane(0), plane(SIDE * SIDE), share[2])
    }

    /// Return the unit direction (LPS) in which the distance to the wall increases; `None` where the distance is
    /// constant.
    #[must_use]
    pub fn away_from_wall(&self, p_lps: [f64; 3]) -> Option<[f64; 3]> {
        let Some(strain) = &self.strain else {
            return carina_grid::unit(self.slope_at_rest(p_lps));
        };
        let normal = self.slope_at_rest(strain.rest_from_lps.point(p_lps));
        let rows = strain.rest_from_lps.rows();
        carina_grid::unit(std::array::from_fn(|a| {
            rows[0][a] * normal[0] + rows[1][a] * normal[1] + rows[2][a] * normal[2]
        }))
    }
}

/// Return the largest factor by which a map changes a length: the largest singular value of its matrix.
fn largest_stretch(map: &Affine) -> f64 {
    // The power iteration with the symmetric matrix `M^T M`, whose largest eigenvalue is the square of the factor. The
    // row sums of the absolute values bound the eigenvalue, so the bound is safe before the iteration has converged.
    let columns = [0, 1, 2].map(|c| map.column(c));
    let mut square: [[f64; 3]; 3] =
        std::array::from_fn(|a| std::array::from_fn(|b| carina_grid::dot(columns[a], columns[b])));
    let mut exponent = 1.0;
    let mut log_scale = 0.0;
    for _ in 0..10 {
        // The matrix is squared repeatedly: its row-sum norm to the power of 1/2^n approaches the eigenvalue from above.
        let norm = row_sum(&square);
        log_scale = 2.0 * (log_scale + libm::log(norm));
        exponent *= 2.0;
        let scaled = square.map(|row| row.map(|v| v / norm));
        square = std::array::from_fn(|a| {
            std::array::from_fn(|b| (0..3).map(|k| scaled[a][k] * scaled[k][b]).sum())
        });
    }
    libm::sqrt(libm::exp(
        (log_scale + libm::log(row_sum(&square))) / exponent,
    ))
}

fn row_sum(matrix: &[[f64; 3]; 3]) -> f64 {
    matrix
        .iter()
        .map(|row| row.iter().map(|v| v.abs()).sum())
        .fold(0.0, f64::max)
}

impl Bricks for WallField {
    fn num(&self) -> [usize; 3] {
        self.num_bricks
    }

    fn position_in_bricks(&self, p_lps: [f64; 3]) -> [f64; 3] {
        self.lattice_from_lps.point(p_lps).map(|v| v / CELLS as f64)
    }

    fn to_lps(&self, at: [f64; 3]) -> [f64; 3] {
        self.lps_from_lattice.point(at.map(|v| v * CELLS as f64))
    }

    fn least_mm(&self, brick: usize, block: [usize; 3]) -> f64 {
        /// Number of cells between samples in a block, on each axis.
        const SIZE: usize = CELLS / BLOCKS;
        let stored = self.brick_at[brick];
        if stored >= FAR_INSIDE {
            return if stored == FAR_INSIDE {
                INSIDE_MM
            } else {
                -OUTSIDE_MM
            };
        }
        let mut least = f64::INFINITY;
        for k in SIZE * block[2]..=SIZE * (block[2] + 1) {
            for j in SIZE * block[1]..=SIZE * (block[1] + 1) {
                for i in SIZE * block[0]..=SIZE * (block[0] + 1) {
                    let n = stored as usize * SAMPLES + (k * SIDE + j) * SIDE + i;
                    least = least.min(f64::from(self.samples[n]));
                }
            }
        }
        least
    }
}

pub(crate) fn clamped(distance_mm: f32) -> f32 {
    distance_mm.clamp(-OUTSIDE_MM as f32, INSIDE_MM as f32)
}

#[cfg(test)]
mod tests {
    use super::*;
    use carina_grid::length;

    /// Return the wall field of a tube along z, on anisotropic samples rotated by 30 degrees.
    fn tube(radius: f64) -> WallField {
        let (s, c) = (0.5, libm::sqrt(0.75));
        let lps = Affine::from_columns(
            [0.5 * c, 0.5 * s, 0.0],
            [-0.6 * s, 0.6 * c, 0.0],
            [0.0, 0.0, 0.9],
            [-8.0, -14.0, -20.0],
        );
        let shape = [50, 44, 45];
        let distances: Vec<f32> = (0..shape.iter().product::<usize>())
            .map(|n| {
                let p = lps.point([(n % 50) as f64, (n / 50 % 44) as f64, (n / 50 / 44) as f64]);
                (radius - libm::hypot(p[0], p[1])) as f32
            })
            .collect();
        WallField::from_distances(&distances, shape, &lps).unwrap()
    }

    #[test]
    fn the_distance_in_a_tube_is_its_radius_minus_the_distance_from_its_axis() {
        let field = tube(4.0);
        for (x, y) in [(1.5, 0.3), (-2.0, 1.9), (3.2, -2.0), (3.5, 3.0)] {
            let truth = 4.0 - libm::hypot(x, y);
            let found = field.distance_mm([x, y, 1.3]);
            // The tolerance is h^2 / (8 r) for samples 0.6 mm apart and a radius of curvature of 1.5 mm.
            assert!((found - truth).abs() < 0.03, "{found} {truth}");
            let away = field.away_from_wall([x, y, 1.3]).unwrap();
            let inwards = [-x, -y, 0.0].map(|v| v / libm::hypot(x, y));
            assert!(length(std::array::from_fn(|a| away[a] - inwards[a])) < 0.1);
        }
    }

    #[test]
    fn points_outside_the_lattice_and_nan_are_outside_the_lumen() {
        let field = tube(4.0);
        assert_eq!(field.distance_mm([0.0, 0.0, 900.0]), -OUTSIDE_MM);
        assert_eq!(field.distance_mm([f64::NAN, 0.0, 0.0]), -OUTSIDE_MM);
        assert!(field.away_from_wall([0.0, 0.0, 900.0]).is_none());
    }

    #[test]
    fn nan_distances_and_a_wrong_number_of_distances_are_rejected() {
        assert!(WallField::from_distances(&[1.0; 7], [2, 2, 2], &Affine::IDENTITY).is_err());
        assert!(WallField::from_distances(&[f32::NAN; 8], [2, 2, 2], &Affine::IDENTITY).is_err());
        assert!(WallField::from_distances(&[-9.0; 8], [2, 2, 2], &Affine::IDENTITY).is_err());
    }

    #[test]
    fn a_tube_along_the_axis_widens_the_lumen_to_its_radius() {
        let field = tube(1.5);
        let axis: Vec<[f64; 3]> = (0..25).map(|n| [0.0, 0.0, -12.0 + f64::from(n)]).collect();
        let radii: Vec<f64> = (0..25).map(|n| 1.7 + 0.01 * f64::from(n)).collect();
        let wide = field.with_tube(&axis, &radii).unwrap();
        assert!(!wide.is_sampled() && field.is_sampled());
        for (x, y, z) in [
            (0.0, 0.0, 0.0),
            (0.9, -0.4, 3.3),
            (1.4, 0.5, -7.6),
            (1.9, 0.7, 0.4),
        ] {
            let truth = 1.82 + 0.01 * z - libm::hypot(x, y);
            let found = wide.distance_mm([x, y, z]);
            assert!((found - truth).abs() < 1e-3, "{found} {truth}");
        }
        // The axis of the sampled tube has lost a part of its peak.
        assert!(field.distance_mm([0.1, 0.1, 0.3]) < 1.45);
        // Beyond the end of the tube the field is unchanged.
        for p in [[0.3, 0.2, -18.5], [0.3, 0.2, 17.0]] {
            assert!((wide.distance_mm(p) - field.distance_mm(p)).abs() < 1e-12);
        }
        assert!(bytes_of(&wide) != bytes_of(&field));
    }

    #[test]
    fn a_tube_never_makes_the_lumen_narrower() {
        let field = tube(4.0);
        let narrow = field
            .with_tube(&[[0.0, 0.0, -9.0], [0.0, 0.0, 9.0]], &[0.8, 0.8])
            .unwrap();
        for n in 0..200 {
            let p = [0.02 * f64::from(n) - 2.0, 0.7, 0.08 * f64::from(n) - 8.0];
            assert_eq!(narrow.distance_mm(p), field.distance_mm(p));
        }
    }

    #[test]
    fn ridges_limit_the_distance_everywhere_near_them_also_inside_a_tube() {
        let axis = [[0.0, 0.0, -9.0], [0.0, 0.0, 9.0]];
        let field = tube(1.5).with_tube(&axis, &[3.0, 3.0]).unwrap();
        let ridge = Ridge {
            middle: [0.4, 0.3, 1.0],
            sides: [[0.0, 1.5, 0.0], [0.0, 0.0, 2.0]],
            half_mm: 0.2,
        };
        let with = field.with_ridges(&[ridge]).unwrap();
        assert!(!with.is_sampled() && bytes_of(&with) != bytes_of(&field));
        for n in 0..2000 {
            let at = f64::from(n);
            let p = [
                3.0 * libm::sin(at),
                3.0 * libm::cos(1.7 * at),
                8.0 * libm::sin(0.61 * at),
            ];
            let off = [
                (p[0] - 0.4).abs(),
                ((p[1] - 0.3).abs() - 1.5).max(0.0),
                ((p[2] - 1.0).abs() - 2.0).max(0.0),
            ];
            let truth = field.distance_mm(p).min(length(off) - 0.2);
            assert!((with.distance_mm(p) - truth).abs() < 1e-9, "{p:?}");
        }
    }

    #[test]
    fn a_tube_of_wrong_sizes_is_rejected() {
        let field = tube(4.0);
        let ends = [[0.0, 0.0, -9.0], [0.0, 0.0, 9.0]];
        assert!(field.with_tube(&ends, &[1.0]).is_err());
        assert!(field.with_tube(&ends[..1], &[1.0]).is_err());
        assert!(field.with_tube(&ends, &[1.0, 0.0]).is_err());
        assert!(field.with_tube(&ends, &[1.0, f64::NAN]).is_err());
        assert!(
            field
                .with_tube(&[[f64::INFINITY; 3], ends[1]], &[1.0, 1.0])
                .is_err()
        );
    }

    #[test]
    fn a_deformed_tube_has_the_distances_of_its_deformed_wall() {
        let field = tube(4.0);
        // The tube is narrowed to a share of 0.7, stretched along its axis and sheared; its wall stays round.
        let map = Affine::from_rows([
            [0.7, 0.0, 0.04, 1.0],
            [0.0, 0.7, -0.03, -2.0],
            [0.0, 0.0, 1.05, 3.0],
        ]);
        let moved = field.deformed(&map).unwrap();
        for rest in [[1.5, 0.3, 1.3], [-2.0, 1.9, 4.0], [3.2, -2.0, -5.0]] {
            let p = map.point(rest);
            // The wall is an oblique cylinder, whose distance is that across it times the cosine of its slope.
            let across = 0.7 * (4.0 - libm::hypot(rest[0], rest[1]));
            let found = moved.distance_mm(p);
            // The tolerance is that of the tube at rest plus the shear's 0.1 % of 2.8 mm.
            assert!((found - across).abs() < 0.035, "{found} {across}");
            let away = moved.away_from_wall(p).unwrap();
            let inwards = [-rest[0], -rest[1], 0.0].map(|v| v / libm::hypot(rest[0], rest[1]));
            assert!(length(std::array::from_fn(|a| away[a] - inwards[a])) < 0.12);
        }
        assert!(moved.deformed(&map).is_err() && moved.is_deformed());
        assert!(
            moved
                .with_tube(&[[0.0, 0.0, -9.0], [0.0, 0.0, 9.0]], &[0.8, 0.8])
                .is_err()
        );
        let mirror =
            Affine::from_columns([-1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.0; 3]);
        assert!(field.deformed(&mirror).is_err());
        assert!(bytes_of(&moved) != bytes_of(&field));
    }

    #[test]
    fn a_field_deformed_by_the_identity_equals_the_field() {
        let field = tube(4.0);
        let moved = field.deformed(&Affine::IDENTITY).unwrap();
        for n in 0..200 {
            let p = [0.02 * f64::from(n) - 2.0, 0.7, 0.08 * f64::from(n) - 8.0];
            assert!((moved.distance_mm(p) - field.distance_mm(p)).abs() < 1e-12);
            assert_eq!(moved.away_from_wall(p), field.away_from_wall(p));
        }
    }

    #[test]
    fn the_largest_stretch_of_a_map_is_its_largest_singular_value() {
        let turned = Affine::from_rows([
            [0.6, -0.8 * 1.3, 0.0, 5.0],
            [0.8, 0.6 * 1.3, 0.0, 0.0],
            [0.0, 0.0, 0.9, 0.0],
        ]);
        // The row sums exceed the eigenvalue by a factor of up to 3 to the power of 1/1024.
        assert!((largest_stretch(&turned) - 1.3).abs() < 2e-3);
        assert!((largest_stretch(&Affine::IDENTITY) - 1.0).abs() < 1e-12);
    }

    fn bytes_of(field: &WallField) -> Vec<u8> {
        let mut bytes = Vec::new();
        field.for_each_part(|part| bytes.extend_from_slice(part));
        bytes
    }

    #[test]
    fn a_field_decoded_from_its_bytes_equals_the_field() {
        let field = tube(4.0);
        assert_eq!(WallField::from_bytes(&bytes_of(&field)), Ok(field));
    }

    #[test]
    fn damaged_bytes_of_a_field_are_rejected() {
        let good = bytes_of(&tube(4.0));
        for short in [0, 8, HEAD_BYTES, HEAD_BYTES + 3, good.len() - 1] {
            assert!(WallField::from_bytes(&good[..short]).is_err(), "{short}");
        }
        // The damaged parts are a row of the matrix, a size of the lattice, the number of a brick, and a sample.
        for (at, bytes) in [
            (0, f64::NAN.to_le_bytes()),
            (0, 0.0f64.to_le_bytes()),
            (8 * 12, u64::MAX.to_le_bytes()),
            (8 * 12, 1u64.to_le_bytes()),
            (HEAD_BYTES, (1u64 << 20).to_le_bytes()),
            (good.len() - 8, u64::MAX.to_le_bytes()),
        ] {
            let mut bad = good.clone();
            bad[at..at + 8].copy_from_slice(&bytes);
            if at == 0 && bytes == [0; 8] {
                bad[..24].fill(0);
            }
            assert!(WallField::from_bytes(&bad).is_err(), "{at}");
        }
    }
}
