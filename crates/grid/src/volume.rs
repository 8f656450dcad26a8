use crate::{Affine, GridError};

/// Point in patient space, LPS mm.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Lps(pub [f64; 3]);

/// Point in voxel coordinates: (0, 0, 0) is the centre of the first voxel.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Ijk(pub [f64; 3]);

/// Convert a triple from array order `(z, y, x)` to `(i, j, k)`.
///
/// Only this function and [`zyx_from_ijk`] swap the order.
#[must_use]
pub const fn ijk_from_zyx<T: Copy>(zyx: [T; 3]) -> [T; 3] {
    [zyx[2], zyx[1], zyx[0]]
}

/// Convert a triple from `(i, j, k)` to array order `(z, y, x)`.
#[must_use]
pub const fn zyx_from_ijk<T: Copy>(ijk: [T; 3]) -> [T; 3] {
    [ijk[2], ijk[1], ijk[0]]
}

/// Shape of a voxel grid and its transform to patient space.
#[derive(Debug, Clone, PartialEq)]
pub struct Grid {
    shape_ijk: [usize; 3],
    spacing_mm: [f64; 3],
    lps_from_ijk: Affine,
    ijk_from_lps: Affine,
}

impl Grid {
    /// Create a grid of `shape_zyx` voxels with the transform `lps_from_ijk`.
    ///
    /// # Errors
    ///
    /// Returns an error if an axis has no voxels, if there are too many voxels, or if the transform cannot be inverted.
    pub fn new(shape_zyx: [usize; 3], lps_from_ijk: Affine) -> Result<Self, GridError> {
        let count = shape_zyx.iter().try_fold(1usize, |n, &s| n.checked_mul(s));
        if !matches!(count, Some(1..=0x7fff_ffff)) {
            return Err(GridError::Shape { shape_zyx });
        }
        let ijk_from_lps = lps_from_ijk.inverse().ok_or_else(|| GridError::Transform {
            what: "lps_from_ijk",
            reason: "its determinant is 0".to_owned(),
        })?;
        Ok(Self {
            shape_ijk: ijk_from_zyx(shape_zyx),
            spacing_mm: std::array::from_fn(|a| crate::length(lps_from_ijk.column(a))),
            lps_from_ijk,
            ijk_from_lps,
        })
    }

    /// Return the number of voxels of the grid along i, j, k.
    #[must_use]
    pub const fn shape_ijk(&self) -> [usize; 3] {
        self.shape_ijk
    }

    /// Return the shape `(z, y, x)` of an array on this grid.
    #[must_use]
    pub const fn shape_zyx(&self) -> [usize; 3] {
        zyx_from_ijk(self.shape_ijk)
    }

    /// Return the number of voxels of the grid.
    #[must_use]
    pub const fn num_voxels(&self) -> usize {
        self.shape_ijk[0] * self.shape_ijk[1] * self.shape_ijk[2]
    }

    /// Return the distance between neighbouring voxel centres along i, j, k, mm.
    #[must_use]
    pub const fn spacing_mm(&self) -> [f64; 3] {
        self.spacing_mm
    }

    /// Return the smallest of the three spacings, mm.
    #[must_use]
    pub fn min_spacing_mm(&self) -> f64 {
        self.spacing_mm.into_iter().fold(f64::INFINITY, f64::min)
    }

    /// Return the transform from voxel coordinates to patient space.
    #[must_use]
    pub const fn lps_from_ijk(&self) -> &Affine {
        &self.lps_from_ijk
    }

    /// Return the transform from patient space to voxel coordinates.
    #[must_use]
    pub const fn ijk_from_lps(&self) -> &Affine {
        &self.ijk_from_lps
    }

    /// Convert a point from voxel coordinates to patient space.
    #[must_use]
    pub fn to_lps(&self, p: Ijk) -> Lps {
        Lps(self.lps_from_ijk.point(p.0))
    }

    /// Convert a point from patient space to voxel coordinates.
    #[must_use]
    pub fn to_ijk(&self, p: Lps) -> Ijk {
        Ijk(self.ijk_from_lps.point(p.0))
    }

    /// Return the voxel that contains a point; `None` outside the grid.
    #[must_use]
    pub fn voxel_at(&self, p: Ijk) -> Option<[usize; 3]> {
        let mut voxel = [0; 3];
        for axis in 0..3 {
            let nearest = (p.0[axis] + 0.5).floor();
            if !(nearest >= 0.0 && nearest < self.shape_ijk[axis] as f64) {
                return None;
            }
            voxel[axis] = nearest as usize;
        }
        Some(voxel)
    }

    /// Return the array index of voxel `(i, j, k)`.
    #[must_use]
    pub const fn index(&self, ijk: [usize; 3]) -> usize {
        (ijk[2] * self.shape_ijk[1] + ijk[1]) * self.shape_ijk[0] + ijk[0]
    }

    /// Return the voxel at an array index.
    #[must_use]
    pub const fn voxel(&self, index: usize) -> [usize; 3] {
        let (nx, ny) = (self.shape_ijk[0], self.shape_ijk[1]);
        [index % nx, index / nx % ny, index / nx / ny]
    }
}

/// Borrowed voxel values of a volume with their grid.
#[derive(Debug, Clone, Copy)]
pub struct VolumeView<'a, T> {
    data: &'a [T],
    grid: &'a Grid,
}

impl<'a, T: Copy> VolumeView<'a, T> {
    /// Create a view of the voxel values of a volume, which are in `[z, y, x]` order, x fastest.
    ///
    /// # Errors
    ///
    /// Returns an error if the number of values does not match the grid.
    pub fn new(data: &'a [T], grid: &'a Grid) -> Result<Self, GridError> {
        if data.len() != grid.num_voxels() {
            return Err(GridError::Length {
                shape_zyx: grid.shape_zyx(),
                expected: grid.num_voxels(),
                found: data.len(),
            });
        }
        Ok(Self { data, grid })
    }

    /// Return all voxel values, x fastest.
    #[must_use]
    pub const fn data(&self) -> &'a [T] {
        self.data
    }

    /// Return the grid of the voxel values.
    #[must_use]
    pub const fn grid(&self) -> &'a Grid {
        self.grid
    }

    /// Return the value of the voxel at these indices.
    #[must_use]
    pub fn at(&self, ijk: [usize; 3]) -> T {
        self.data[self.grid.index(ijk)]
    }

    /// Return the value of the voxel at signed indices; outside the volume, that of the nearest voxel.
    #[must_use]
    pub fn at_clamped(&self, ijk: [isize; 3]) -> T {
        let shape = self.grid.shape_ijk();
        self.at(std::array::from_fn(|a| {
            ijk[a].clamp(0, shape[a] as isize - 1) as usize
        }))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn grid() -> Grid {
        // The grid is anisotropic and oblique, so that swapped axes cannot pass.
        let lps_from_ijk = Affine::from_columns(
            [0.0, 0.7, 0.0],
            [-0.8, 0.0, 0.0],
            [0.0, 0.0, 2.5],
            [10.0, -20.0, 30.0],
        );
        Grid::new([4, 5, 6], lps_from_ijk).unwrap()
    }

    #[test]
    fn array_positions_run_x_fastest() {
        let g = grid();
        assert_eq!(g.shape_ijk(), [6, 5, 4]);
        assert_eq!(g.index([1, 0, 0]), 1);
        assert_eq!(g.index([0, 1, 0]), 6);
        assert_eq!(g.index([0, 0, 1]), 30);
        for index in 0..g.num_voxels() {
            assert_eq!(g.index(g.voxel(index)), index);
        }
    }

    #[test]
    fn voxel_centres_map_to_patient_space_and_back() {
        let g = grid();
        assert_eq!(g.to_lps(Ijk([0.0, 0.0, 0.0])), Lps([10.0, -20.0, 30.0]));
        assert_eq!(
            g.to_lps(Ijk([1.0, 1.0, 1.0])),
            Lps([10.0 - 0.8, -20.0 + 0.7, 32.5])
        );
        assert_eq!(g.spacing_mm(), [0.7, 0.8, 2.5]);
    }

    #[test]
    fn a_voxel_extends_half_a_voxel_round_its_centre() {
        let g = grid();
        assert_eq!(g.voxel_at(Ijk([-0.5, 4.49, 3.0])), Some([0, 4, 3]));
        assert_eq!(g.voxel_at(Ijk([-0.51, 0.0, 0.0])), None);
        assert_eq!(g.voxel_at(Ijk([0.0, 4.5, 0.0])), None);
        assert_eq!(g.voxel_at(Ijk([f64::NAN, 0.0, 0.0])), None);
    }

    #[test]
    fn empty_axes_and_wrong_array_lengths_are_rejected() {
        assert_eq!(
            Grid::new([4, 0, 6], Affine::IDENTITY).unwrap_err().code(),
            "geometry.shape"
        );
        assert!(Grid::new([1 << 20, 1 << 20, 1], Affine::IDENTITY).is_err());
        assert_eq!(
            VolumeView::new(&[0i16; 7], &grid()).unwrap_err().code(),
            "geometry.length"
        );
    }
}
