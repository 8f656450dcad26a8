//! Reference ray caster in f64, written from the formulas (docs/algorithms.md, paper 4.3) without the crates' code.
//!
//! The reference has its own camera, box, interpolation, gradients, table and light. The pictures of the casters may
//! differ from it only by rounding.

/// Rows of a 3x4 matrix, the last column of which is the translation.
pub(crate) type Matrix = [[f64; 4]; 3];

/// Fractions and reach of the light at the camera, `[ambient, diffuse, specular, log2 of the exponent, reach in mm]`.
pub(crate) type Shares = [f64; 5];

/// Volume with its transfer function and its light, for the reference ray caster.
pub(crate) struct World<'a> {
    /// Number of voxels of the volume along i, j, k.
    pub(crate) shape: [usize; 3],
    /// Values of the volume, `[k, j, i]`.
    pub(crate) hu: &'a [i16],
    pub(crate) lps_from_ijk: Matrix,
    /// Points of the transfer function, `[hu, r, g, b, alpha]` in ascending order; alpha is per mm.
    pub(crate) points: &'a [[f64; 5]],
    pub(crate) light: Option<Shares>,
    pub(crate) step_mm: f64,
    /// Transparency below which a ray stops.
    pub(crate) stop: f64,
}

/// Camera and size of a picture.
pub(crate) struct View {
    pub(crate) lps_from_camera: Matrix,
    pub(crate) fov_rad: f64,
    pub(crate) width: usize,
    pub(crate) height: usize,
}

fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    ]
}

fn column(m: &Matrix, c: usize) -> [f64; 3] {
    [m[0][c], m[1][c], m[2][c]]
}

/// Return the rows of the inverse of the first three columns, by Cramer's rule.
fn inverse(m: &Matrix) -> [[f64; 3]; 3] {
    let [a, b, c] = [column(m, 0), column(m, 1), column(m, 2)];
    let volume = dot(a, cross(b, c));
    [cross(b, c), cross(c, a), cross(a, b)].map(|row| row.map(|v| v / volume))
}

impl World<'_> {
    fn voxel(&self, at: [i64; 3]) -> f64 {
        let [i, j, k]: [usize; 3] =
            std::array::from_fn(|a| at[a].clamp(0, self.shape[a] as i64 - 1) as usize);
        f64::from(self.hu[(k * self.shape[1] + j) * self.shape[0] + i])
    }

    /// Interpolate trilinearly between the vectors that `read` returns at the eight voxels round a point.
    fn between(point: [f64; 3], read: impl Fn([i64; 3]) -> [f64; 3]) -> [f64; 3] {
        let mut sum = [0.0; 3];
        for corner in 0..8u32 {
            let mut weight = 1.0;
            let at = std::array::from_fn(|a| {
                let low = point[a].floor();
                let high = f64::from(corner >> a & 1);
                weight *= 1.0 - (point[a] - low - high).abs();
                (low + high) as i64
            });
            if weight > 0.0 {
                let value = read(at);
                for c in 0..3 {
                    sum[c] += weight * value[c];
                }
            }
        }
        sum
    }

    /// Return central differences per voxel at a voxel; the edge voxel itself replaces a missing neighbour.
    fn difference(&self, at: [i64; 3]) -> [f64; 3] {
        let at: [i64; 3] = std::array::from_fn(|a| at[a].clamp(0, self.shape[a] as i64 - 1));
        std::array::from_fn(|a| {
            let (mut before, mut after) = (at, at);
            before[a] -= 1;
            after[a] += 1;
            (self.voxel(after) - self.voxel(before)) / 2.0
        })
    }

    /// Return colour and opacity per mm of the transfer function at a value.
    ///
    /// Both are linear between points and constant beyond the ends. Of two points at one value, the later one applies.
    fn colour(&self, hu: f64) -> [f64; 4] {
        let part = |p: &[f64; 5]| [p[1], p[2], p[3], p[4]];
        let after = self.points.iter().position(|p| p[0] > hu);
        match after {
            None => part(&self.points[self.points.len() - 1]),
            Some(0) => part(&self.points[0]),
            Some(n) => {
                let (low, high) = (&self.points[n - 1], &self.points[n]);
                let t = (hu - low[0]) / (high[0] - low[0]);
                std::array::from_fn(|c| (1.0 - t) * low[c + 1] + t * high[c + 1])
            }
        }
    }

    /// Return the colour of one pixel, 0 to 255 before rounding.
    fn pixel(&self, view: &View, x: usize, y: usize) -> [f64; 3] {
        let ijk_from_lps = inverse(&self.lps_from_ijk);
        let shorter = view.width.min(view.height) as f64;
        let focal = shorter / 2.0 / (view.fov_rad / 2.0).tan();
        let camera = [
            x as f64 + 0.5 - view.width as f64 / 2.0,
            y as f64 + 0.5 - view.height as f64 / 2.0,
            focal,
        ];
        let length = dot(camera, camera).sqrt();
        let turn = |v: [f64; 3]| -> [f64; 3] {
            std::array::from_fn(|r| {
                let row = view.lps_from_camera[r];
                dot([row[0], row[1], row[2]], v)
            })
        };
        let dir = turn(camera.map(|v| v / length));
        let start = column(&view.lps_from_camera, 3);
        let offset = column(&self.lps_from_ijk, 3);
        let to_ijk = |v: [f64; 3]| ijk_from_lps.map(|row| dot(row, v));
        let origin = to_ijk(std::array::from_fn(|a| start[a] - offset[a]));
        let step = to_ijk(dir).map(|v| v * self.step_mm);
        let inside =
            |p: [f64; 3]| (0..3).all(|a| p[a] >= -0.5 && p[a] <= self.shape[a] as f64 - 0.5);
        // Interval of the ray in the box, in steps; the ray is sampled only there.
        let (mut from, mut to) = (0.0f64, f64::INFINITY);
        for a in 0..3 {
            let (low, high) = (-0.5 - origin[a], self.shape[a] as f64 - 0.5 - origin[a]);
            if step[a] == 0.0 {
                if low > 0.0 || high < 0.0 {
                    return [0.0; 3];
                }
            } else {
                let (near, far) = (low / step[a], high / step[a]);
                from = from.max(near.min(far));
                to = to.min(near.max(far));
            }
        }
        let (mut rgb, mut through) = ([0.0; 3], 1.0);
        let mut k = (from - 2.0).max(0.0).floor();
        while k <= to + 2.0 && through >= self.stop {
            let t = k + 0.5;
            k += 1.0;
            let point: [f64; 3] = std::array::from_fn(|a| origin[a] + t * step[a]);
            if !inside(point) {
                continue;
            }
            let value = Self::between(point, |at| [self.voxel(at), 0.0, 0.0])[0];
            let [r, g, b, alpha] = self.colour((value + 0.5).floor());
            if alpha <= 0.0 {
                continue;
            }
            let alpha = 1.0 - (1.0 - alpha).powf(self.step_mm);
            let (diffuse, white) = self.light.map_or((1.0, 0.0), |light| {
                let g_ijk = Self::between(point, |at| self.difference(at));
                let g_lps: [f64; 3] =
                    std::array::from_fn(|c| (0..3).map(|a| ijk_from_lps[a][c] * g_ijk[a]).sum());
                lit(light, g_lps, dir, t * self.step_mm)
            });
            for (c, part) in [r, g, b].into_iter().enumerate() {
                rgb[c] += through * alpha * (diffuse * part + white);
            }
            through *= 1.0 - alpha;
        }
        rgb.map(|v| (255.0 * v).min(255.0))
    }

    /// Return the picture, `[row, column, channel]`, 0 to 255 before rounding.
    pub(crate) fn picture(&self, view: &View) -> Vec<f64> {
        (0..view.height * view.width)
            .flat_map(|n| self.pixel(view, n % view.width, n / view.width))
            .collect()
    }
}

/// Return the fractions of the tissue's own colour and of white in a shaded sample.
fn lit(
    [ambient, diffuse, specular, log2, reach_mm]: Shares,
    gradient: [f64; 3],
    dir: [f64; 3],
    distance_mm: f64,
) -> (f64, f64) {
    let length = dot(gradient, gradient).sqrt();
    // Flat tissue has no direction, so only ambient light applies.
    let facing = if length < 1e-9 {
        0.0
    } else {
        (dot(gradient, dir).abs() / length).min(1.0)
    };
    let left = 1.0 / (1.0 + (distance_mm / reach_mm).powi(2));
    (
        (ambient + diffuse * facing) * left,
        specular * facing.powf(log2.exp2()) * left,
    )
}

/// Round a picture to 8 bits as the casters do.
pub(crate) fn to_8_bit(picture: &[f64]) -> Vec<u8> {
    picture.iter().map(|v| (v + 0.5) as u8).collect()
}
