//! Data that all rays of a picture share, computed once in f64.

use std::sync::Arc;

use carina_grid::{Affine, Camera, Grid, VolumeView, clip_line_to_box, dot, length};

use crate::{
    Appearance, Decoration, Field, Light, NormalBricks, RaycastError, SampleBricks, TransferTable,
    composite::Gathered, sampling::Lanes,
};

/// Transparency below which a ray stops; the remaining samples can change no channel by more than half a grey level.
pub const STOP_TRANSPARENCY: f32 = 1.0 / 512.0;

/// Method by which a sample is computed from the voxels round it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Interpolation {
    /// Trilinear interpolation between eight voxels.
    Trilinear,
    /// Value of the nearest voxel, as in the paper; such samples are never shaded.
    Nearest,
}

/// Interpolation, lighting and background of a picture.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FrameOptions {
    /// Interpolation of the volume's values at samples between voxels.
    pub interpolation: Interpolation,
    /// Light at the tip; `None` for the unshaded colours of the transfer function.
    pub light: Option<Light>,
    /// Light, gloss and texture that are applied to the first wall after casting, in place of `light`.
    pub appearance: Option<Appearance>,
    /// Background colour, 0 to 1.
    pub background: [f32; 3],
}

/// Picture to be cast: volume, transfer function, camera and settings.
#[derive(Debug, Clone)]
pub struct Frame<'a> {
    pub(crate) field: Field<'a>,
    pub(crate) table: &'a TransferTable,
    pub(crate) options: FrameOptions,
    /// Anatomical data at the walls, for the shading.
    pub(crate) decoration: Option<Decoration<'a>>,
    pub(crate) grid: &'a Grid,
    /// Map from patient space to the tissue's position in the CT at rest; `None` if the tissue is at rest.
    pub(crate) rest_from_lps: Option<Affine>,
    /// Distances between the voxel centres of the undeformed CT along its three axes, mm.
    pub(crate) rest_spacing_mm: [f64; 3],
    camera: Camera,
    pub(crate) ijk_from_camera: Affine,
    pub(crate) origin_ijk: [f64; 3],
    origin: Lanes,
    pub(crate) step_mm: f32,
    /// Metric that gives the length of a gradient `g` per voxel: `|gradient in LPS per mm|^2 = g^T metric g`; the items
    /// are xx, yy, zz, 2xy, 2xz, 2yz.
    pub(crate) metric: [f32; 6],
    /// Distance in voxels by which a leap (skipped part of a ray) stays inside the cube of equal labels, to allow for
    /// f32 rounding of positions.
    pub(crate) guard_vox: f32,
    /// Transparency below which a ray stops.
    pub(crate) stop: f32,
    /// Whether rays leap (skip uniform regions) even if the trial rays of a picture show that brute force is faster.
    pub(crate) always_leap: bool,
    /// Cache of wall normals from earlier pictures of the volume.
    pub(crate) bricks: Option<Arc<NormalBricks>>,
    /// Cache of values and gradients from earlier pictures of the volume.
    pub(crate) samples: Option<Arc<SampleBricks>>,
}

/// One ray of a picture, with samples `first..end` at `origin + (k + 1/2) delta`.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Ray {
    pub origin: Lanes,
    pub delta: Lanes,
    pub first: u32,
    pub end: u32,
}

impl Ray {
    /// Return the position of sample `k`, computed as a product so that no error accumulates along the ray.
    #[inline(always)]
    pub(crate) fn at(&self, k: u32) -> Lanes {
        // A ray has fewer than 2^31 steps, and the signed conversion is faster.
        let t = k as i32 as f32 + 0.5;
        std::array::from_fn(|a| t.mul_add(self.delta[a], self.origin[a]))
    }
}

fn lanes(p: [f64; 3]) -> Lanes {
    [p[0] as f32, p[1] as f32, p[2] as f32, 0.0]
}

impl<'a> Frame<'a> {
    /// Prepare a picture of a volume.
    ///
    /// # Errors
    ///
    /// Returns an error if a number of the light or of the appearance is not valid, if both are set, or if one of them
    /// is set and samples have the value of the nearest voxel.
    pub fn new(
        volume: VolumeView<'a, i16>,
        table: &'a TransferTable,
        camera: Camera,
        options: FrameOptions,
    ) -> Result<Self, RaycastError> {
        if let Some(light) = &options.light {
            light.check()?;
            if options.interpolation == Interpolation::Nearest {
                return Err(RaycastError::Setting {
                    what: "shading",
                    expected: "off with nearest-voxel sampling, which has no gradient".to_owned(),
                    found: "on".to_owned(),
                });
            }
        }
        if let Some(appearance) = &options.appearance {
            appearance.check()?;
            if options.light.is_some() || options.interpolation == Interpolation::Nearest {
                return Err(RaycastError::Setting {
                    what: "appearance",
                    expected: "sampling between voxels and no light at every sample".to_owned(),
                    found: format!("{:?}, light {:?}", options.interpolation, options.light),
                });
            }
        }
        let grid = volume.grid();
        let ijk_from_lps = grid.ijk_from_lps();
        let origin_ijk = ijk_from_lps.point(camera.origin_lps());
        let rows = ijk_from_lps.rows().map(|r| [r[0], r[1], r[2]]);
        let m = |a: usize, b: usize| dot(rows[a], rows[b]);
        let longest = grid.shape_ijk().into_iter().max().unwrap_or(1) as f64;
        Ok(Self {
            field: Field::new(volume),
            table,
            options,
            decoration: None,
            grid,
            rest_from_lps: None,
            rest_spacing_mm: grid.spacing_mm(),
            ijk_from_camera: ijk_from_lps.after(camera.lps_from_camera()),
            camera,
            origin_ijk,
            origin: lanes(origin_ijk),
            step_mm: table.step_mm() as f32,
            metric: [
                m(0, 0),
                m(1, 1),
                m(2, 2),
                2.0 * m(0, 1),
                2.0 * m(0, 2),
                2.0 * m(1, 2),
            ]
            .map(|v| v as f32),
            // f32 coordinates up to 4096 are accurate to 2.5e-4 voxels; longer axes get a proportionally larger margin.
            guard_vox: (1e-3 * (longest / 4096.0).max(1.0)) as f32,
            stop: STOP_TRANSPARENCY,
            always_leap: false,
            bricks: None,
            samples: None,
        })
    }

    /// Set a stop limit other than [`STOP_TRANSPARENCY`], for comparisons with renderers that use another limit.
    ///
    /// # Errors
    ///
    /// Returns an error if `transparency` is not from 1/65536 to 1/4.
    pub fn stopping_at(mut self, transparency: f32) -> Result<Self, RaycastError> {
        // With a limit above 1/2 a ray would stop before its first wall; with a very small limit a ray through fog
        // would not end.
        if !(1.0 / 65_536.0..=0.25).contains(&transparency) {
            return Err(RaycastError::Setting {
                what: "transparency at which rays stop",
                expected: "1/65536 to 1/4".to_owned(),
                found: transparency.to_string(),
            });
        }
        self.stop = transparency;
        Ok(self)
    }

    /// Return the frame of a deformed CT with the map from patient space to the CT at rest and the grid of the CT at
    /// rest.
    ///
    /// Texture and decoration are fixed to the tissue, and the normals read the same voxels as at rest, so that the
    /// cached bricks remain valid while the patient breathes.
    #[must_use]
    pub const fn deformed(mut self, rest_from_lps: Affine, rest: &Grid) -> Self {
        self.rest_from_lps = Some(rest_from_lps);
        self.rest_spacing_mm = rest.spacing_mm();
        self
    }

    /// Set the anatomical data that the decoration of an appearance needs.
    #[must_use]
    pub const fn decorated_by(mut self, decoration: Decoration<'a>) -> Self {
        self.decoration = Some(decoration);
        self
    }

    /// Return the frame with cached bricks of its volume's values and gradients, which the shading of samples reads.
    ///
    /// The caller must ensure that `samples` was filled from the same values.
    ///
    /// # Errors
    ///
    /// Returns an error if the bricks are not for a volume of this shape.
    pub fn with_samples(mut self, samples: Arc<SampleBricks>) -> Result<Self, RaycastError> {
        if !samples.fit(self.shape_ijk()) {
            return Err(RaycastError::Setting {
                what: "bricks of values",
                expected: "those of this volume's shape".to_owned(),
                found: "others".to_owned(),
            });
        }
        self.samples = Some(samples);
        Ok(self)
    }

    /// Return the frame with rays that always leap (skip uniform regions), for benchmarks of the leaps.
    #[must_use]
    pub const fn leaping_always(mut self) -> Self {
        self.always_leap = true;
        self
    }

    /// Return true if the first walls of this frame are shaded after casting.
    #[must_use]
    pub const fn lights_walls(&self) -> bool {
        self.options.appearance.is_some()
    }

    /// Return the number of voxels of the volume along each axis.
    #[must_use]
    pub fn shape_ijk(&self) -> [usize; 3] {
        self.grid.shape_ijk()
    }

    /// Return true if the samples of this frame are shaded while rays are cast.
    #[must_use]
    pub const fn lights_samples(&self) -> bool {
        self.options.light.is_some()
    }

    /// Return the camera of the picture.
    #[must_use]
    pub const fn camera(&self) -> &Camera {
        &self.camera
    }

    /// Return a frame of the same scene with one row of rays in the given directions of camera space.
    ///
    /// Single rays can thus be cast and shaded with the same operations as whole pictures.
    pub(crate) fn listing(&self, directions: &[[f32; 3]]) -> Self {
        Self {
            camera: self.camera.listing(directions),
            ..self.clone()
        }
    }

    /// Return the camera's centre in voxels.
    #[inline(always)]
    pub(crate) fn origin3(&self) -> [f32; 3] {
        [self.origin[0], self.origin[1], self.origin[2]]
    }

    /// Return the camera's centre in voxels; `None` if it is outside the volume.
    pub(crate) fn inside(&self) -> Option<Lanes> {
        let n = self.grid.shape_ijk();
        let inside = (0..3).all(|a| (-0.5..=n[a] as f64 - 0.5).contains(&self.origin_ijk[a]));
        inside.then_some(self.origin)
    }

    /// Return an upper bound of the number of steps of any ray.
    ///
    /// The bound is the distance to the farthest corner of the box plus the box's diagonal.
    pub(crate) fn most_steps(&self) -> f64 {
        let lps_from_ijk = self.grid.lps_from_ijk();
        let camera = self.camera.origin_lps();
        let n = self.grid.shape_ijk();
        let farthest = (0..8)
            .map(|corner| {
                let ijk = std::array::from_fn(|a| {
                    if corner >> a & 1 == 1 {
                        n[a] as f64
                    } else {
                        -1.0
                    }
                });
                let p = lps_from_ijk.point(ijk);
                length(std::array::from_fn(|a| p[a] - camera[a]))
            })
            .fold(0.0, f64::max);
        farthest / self.table.step_mm() + 2.0
    }

    /// Return one step of a pixel's ray in camera space, mm; 0 for a pixel without a ray.
    #[inline(always)]
    fn step(&self, column: usize, row: usize) -> [f64; 3] {
        let step_mm = self.table.step_mm();
        if let Some(rays) = self.camera.lens_rays() {
            return rays.direction(column, row).map(|v| f64::from(v) * step_mm);
        }
        let x = (column as f64 + 0.5) - self.camera.width() as f64 / 2.0;
        let y = (row as f64 + 0.5) - self.camera.height() as f64 / 2.0;
        let z = self.camera.focal_px();
        let scale = step_mm / length([x, y, z]);
        [x * scale, y * scale, z * scale]
    }

    /// Return the ray of a pixel, clipped to the box of the voxels.
    #[inline(always)]
    pub(crate) fn ray(&self, column: usize, row: usize) -> Ray {
        let delta = self.ijk_from_camera.vector(self.step(column, row));
        // This pixel has no ray, because it is outside the lens's image or the picture's outline.
        if self.camera.lens_rays().is_some() && delta == [0.0; 3] {
            return Ray {
                origin: self.origin,
                delta: lanes(delta),
                first: 0,
                end: 0,
            };
        }
        let n = self.grid.shape_ijk();
        let (first, end) =
            clip_line_to_box(self.origin_ijk, delta, [-0.5; 3], n.map(|n| n as f64 - 0.5)).map_or(
                (0, 0),
                |(t_in, t_out)| {
                    // Sample k is at t = k + 1/2 steps. The casts saturate, so the part of the ray behind the camera is
                    // left out.
                    ((t_in - 0.5).ceil() as u32, (t_out + 0.5).floor() as u32)
                },
            );
        Ray {
            origin: self.origin,
            delta: lanes(delta),
            first,
            end,
        }
    }

    /// Read sample `k` and add it to the ray; return false if the sample has no opacity.
    #[inline(always)]
    pub(crate) fn add_sample<const SHADED: bool, const NEAREST: bool, const HITS: bool>(
        &self,
        ray: &Ray,
        k: u32,
        p: Lanes,
        gathered: &mut Gathered,
    ) -> bool {
        if NEAREST {
            let [r, g, b, alpha] = self
                .table
                .at_hu(i32::from(self.field.voxel(self.field.nearest(p).0)));
            gathered.add::<HITS>(k, [r, g, b], alpha);
            return alpha > 0.0;
        }
        let cell = self.field.cell(p);
        let [r, g, b, alpha] = self.table.at(self.field.value_in(&cell));
        // Skipping a sample without opacity changes no bit. Opacities are never negative.
        if alpha <= 0.0 {
            return false;
        }
        let rgb = match &self.options.light {
            Some(light) if SHADED => {
                let facing = self.facing(ray, self.field.gradient_in(&cell));
                let (diffuse, white) = light.factors(facing, (k as f32 + 0.5) * self.step_mm);
                let white = white * alpha;
                [r, g, b].map(|c| diffuse.mul_add(c, white))
            }
            _ => [r, g, b],
        };
        gathered.add::<HITS>(k, rgb, alpha);
        true
    }

    /// Return the absolute cosine between the surface normal, from the gradient `g`, and the ray.
    ///
    /// Without the sign, a thin wall whose far slope is sampled has the same light as its near slope.
    #[inline(always)]
    fn facing(&self, ray: &Ray, g: [f32; 3]) -> f32 {
        // Both are in LPS per mm: g_lps = ijk_from_lps^T g, so g_lps . dir_lps = g . (ijk_from_lps dir_lps) = g . delta
        // / step.
        let along = g[2].mul_add(
            ray.delta[2],
            g[1].mul_add(ray.delta[1], g[0] * ray.delta[0]),
        );
        let [xx, yy, zz, xy, xz, yz] = self.metric;
        let square = g[0].mul_add(xx, g[1].mul_add(xy, g[2] * xz)) * g[0]
            + g[1].mul_add(yy, g[2] * yz) * g[1]
            + zz * g[2] * g[2];
        let length = square.max(0.0).sqrt() * self.step_mm;
        // Flat tissue has no direction; 1e-6 HU/mm only prevents 0/0.
        (along.abs() / (length + 1e-6)).min(1.0)
    }
}
