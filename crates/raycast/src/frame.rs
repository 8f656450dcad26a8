//! What all rays of a picture share, set up once in f64.

use std::sync::Arc;

use carina_grid::{Affine, Camera, Grid, VolumeView, clip_line_to_box, dot, length};

use crate::{
    Appearance, Decoration, Field, Light, NormalBricks, RaycastError, SampleBricks, TransferTable,
    composite::Gathered, sampling::Lanes,
};

/// Rays stop when less than this shines through: no channel can change by more than half a grey level any more.
pub const STOP_TRANSPARENCY: f32 = 1.0 / 512.0;

/// How a sample is read.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Interpolation {
    /// Between eight voxels.
    Trilinear,
    /// The nearest voxel, as in the paper; never shaded.
    Nearest,
}

/// Settings of a picture.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FrameOptions {
    /// How samples are read.
    pub interpolation: Interpolation,
    /// The light at the tip, or `None` for the transfer function's colours as they are.
    pub light: Option<Light>,
    /// Light, gloss and texture laid on the first wall after casting, in place of `light`.
    pub appearance: Option<Appearance>,
    /// Colour behind everything, 0..1.
    pub background: [f32; 3],
}

/// A picture to be cast: volume, transfer function, camera and settings.
#[derive(Debug, Clone)]
pub struct Frame<'a> {
    pub(crate) field: Field<'a>,
    pub(crate) table: &'a TransferTable,
    pub(crate) options: FrameOptions,
    /// What the lighting knows of the walls' places on their airways.
    pub(crate) decoration: Option<Decoration<'a>>,
    pub(crate) grid: &'a Grid,
    camera: Camera,
    pub(crate) ijk_from_camera: Affine,
    pub(crate) origin_ijk: [f64; 3],
    origin: Lanes,
    pub(crate) step_mm: f32,
    /// Gradients are per voxel; `|gradient in LPS per mm|^2 = g^T metric g`: xx, yy, zz, 2xy, 2xz, 2yz.
    pub(crate) metric: [f32; 6],
    /// Guard of a leap against f32 rounding of positions, voxels.
    pub(crate) guard_vox: f32,
    /// Rays stop when less than this shines through.
    pub(crate) stop: f32,
    /// Leaps also where brute force is quicker.
    pub(crate) always_leap: bool,
    /// Slopes of walls that earlier pictures have worked out.
    pub(crate) bricks: Option<Arc<NormalBricks>>,
    /// Values and gradients that earlier pictures have read.
    pub(crate) samples: Option<Arc<SampleBricks>>,
}

/// One ray: samples `first..end` at `origin + (k + 1/2) delta`.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Ray {
    pub origin: Lanes,
    pub delta: Lanes,
    pub first: u32,
    pub end: u32,
}

impl Ray {
    /// Position of sample `k`, as a product: no error adds up along the ray.
    #[inline(always)]
    pub(crate) fn at(&self, k: u32) -> Lanes {
        // Fewer than 2^31 steps: the signed conversion is the quick one.
        let t = k as i32 as f32 + 0.5;
        std::array::from_fn(|a| t.mul_add(self.delta[a], self.origin[a]))
    }
}

fn lanes(p: [f64; 3]) -> Lanes {
    [p[0] as f32, p[1] as f32, p[2] as f32, 0.0]
}

impl<'a> Frame<'a> {
    /// Sets a picture up.
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
            // Coordinates up to 4096 are good to 2.5e-4 in f32; longer axes get a guard in proportion.
            guard_vox: (1e-3 * (longest / 4096.0).max(1.0)) as f32,
            stop: STOP_TRANSPARENCY,
            always_leap: false,
            bricks: None,
            samples: None,
        })
    }

    /// The same with another stop limit than [`STOP_TRANSPARENCY`]: to compare with renderers that have another.
    pub fn stopping_at(mut self, transparency: f32) -> Result<Self, RaycastError> {
        // Above 1/2 the first wall would be lost; below, a ray through fog has no end.
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

    /// The same with walls whose place on their airway is known, for the parts of an appearance that are fixed to anatomy.
    #[must_use]
    pub const fn decorated_by(mut self, decoration: Decoration<'a>) -> Self {
        self.decoration = Some(decoration);
        self
    }

    /// The same with bricks of values and gradients that earlier pictures of this volume have filled: light at every sample
    /// is read from them.
    ///
    /// `samples` must have been filled from the same values, which is the caller's word.
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

    /// The same with leaps also where a trial says that brute force is quicker: to measure what they do there.
    #[must_use]
    pub const fn leaping_always(mut self) -> Self {
        self.always_leap = true;
        self
    }

    /// True if first walls are lit after casting.
    #[must_use]
    pub const fn lights_walls(&self) -> bool {
        self.options.appearance.is_some()
    }

    /// Voxels of the volume along each axis.
    #[must_use]
    pub fn shape_ijk(&self) -> [usize; 3] {
        self.grid.shape_ijk()
    }

    /// True if samples are lit while rays are cast.
    #[must_use]
    pub const fn lights_samples(&self) -> bool {
        self.options.light.is_some()
    }

    /// The camera.
    #[must_use]
    pub const fn camera(&self) -> &Camera {
        &self.camera
    }

    /// The same with rays in these directions of camera space, as a picture of one row: what casts and lights pictures does
    /// so with single rays, by the same operations.
    pub(crate) fn listing(&self, directions: &[[f32; 3]]) -> Self {
        Self {
            camera: self.camera.listing(directions),
            ..self.clone()
        }
    }

    /// The camera's centre, voxels.
    #[inline(always)]
    pub(crate) fn origin3(&self) -> [f32; 3] {
        [self.origin[0], self.origin[1], self.origin[2]]
    }

    /// The camera's centre if it lies in the volume, voxels.
    pub(crate) fn inside(&self) -> Option<Lanes> {
        let n = self.grid.shape_ijk();
        let inside = (0..3).all(|a| (-0.5..=n[a] as f64 - 0.5).contains(&self.origin_ijk[a]));
        inside.then_some(self.origin)
    }

    /// No ray has more steps than this: the way to the farthest corner of the box and back over it.
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

    /// One step of a pixel's ray in camera space, mm.
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

    /// The ray of a pixel, clipped to the box of the voxels.
    #[inline(always)]
    pub(crate) fn ray(&self, column: usize, row: usize) -> Ray {
        let delta = self.ijk_from_camera.vector(self.step(column, row));
        // No light falls on this pixel: its lens or its mask has no ray for it.
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
                    // Sample k is at t = k + 1/2 steps. The casts saturate: what lies behind the camera starts at 0.
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

    /// Reads sample `k` and adds it; false if it has no opacity.
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
        // Adding nothing changes no bit. Opacities are 0 or more.
        if alpha <= 0.0 {
            return false;
        }
        let rgb = match &self.options.light {
            Some(light) if SHADED => {
                let facing = self.facing(ray, self.field.gradient_in(&cell));
                let (own, white) = light.shares(facing, (k as f32 + 0.5) * self.step_mm);
                let white = white * alpha;
                [r, g, b].map(|c| own.mul_add(c, white))
            }
            _ => [r, g, b],
        };
        gathered.add::<HITS>(k, rgb, alpha);
        true
    }

    /// Cosine between the surface normal and the ray, without sign: a thin wall that a sample meets on its far slope is
    /// lit like its near one.
    #[inline(always)]
    fn facing(&self, ray: &Ray, g: [f32; 3]) -> f32 {
        // Both in LPS per mm: g_lps = ijk_from_lps^T g, so g_lps . dir_lps = g . (ijk_from_lps dir_lps) = g . delta /
        // step.
        let along = g[2].mul_add(
            ray.delta[2],
            g[1].mul_add(ray.delta[1], g[0] * ray.delta[0]),
        );
        let [xx, yy, zz, xy, xz, yz] = self.metric;
        let square = g[0].mul_add(xx, g[1].mul_add(xy, g[2] * xz)) * g[0]
            + g[1].mul_add(yy, g[2] * yz) * g[1]
            + zz * g[2] * g[2];
        let length = square.max(0.0).sqrt() * self.step_mm;
        // Flat tissue has no direction; 1e-6 HU/mm only keeps 0/0 away.
        (along.abs() / (length + 1e-6)).min(1.0)
    }
}
