//! Stages of a picture: kernels of the shader, their variants, and the resources that each binds.

/// Variant of the kernel, given by the override constants of `airway.wgsl`.
#[allow(
    clippy::struct_excessive_bools,
    reason = "each is one override of the shader, and all combine"
)]
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Hash)]
pub(crate) struct Variant {
    pub(crate) shaded: bool,
    pub(crate) nearest: bool,
    pub(crate) leap: bool,
    pub(crate) walls: bool,
}

impl Variant {
    /// Return the names and values of the override constants.
    pub(crate) fn constants(self) -> Vec<(&'static str, f64)> {
        let switches = [
            ("SHADED", self.shaded),
            ("NEAREST", self.nearest),
            ("LEAP", self.leap),
            ("WALLS", self.walls),
        ]
        .map(|(name, on)| (name, f64::from(u8::from(on))));
        let paying_leap = carina_raycast::paying_leap(self.nearest);
        [&switches[..], &[("PAYING_LEAP", f64::from(paying_leap))]].concat()
    }
}

/// Stage of a picture: one kernel of the shader.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub(crate) enum Stage {
    /// Cast the rays of a band.
    Cast,
    /// Cast the rays from which the exposure is computed.
    Meter,
    /// Compute the exposure from the metered rays.
    Expose,
    /// Request the bricks of slopes that a band needs.
    Request,
    /// Compute the slopes of the requested bricks.
    Fill,
    /// Shade the walls of a band.
    Light,
    /// List the pixels that are on silhouettes.
    Mark,
    /// Cast and shade two rays for each listed pixel.
    Smooth,
}

/// All stages, in the order of the layouts of a device.
const STAGES: [Stage; 8] = [
    Stage::Cast,
    Stage::Meter,
    Stage::Expose,
    Stage::Request,
    Stage::Fill,
    Stage::Light,
    Stage::Mark,
    Stage::Smooth,
];

impl Stage {
    /// Return the name of the stage's entry point.
    pub(crate) const fn entry(self) -> &'static str {
        match self {
            Self::Cast => "cast_airway",
            Self::Meter => "meter",
            Self::Expose => "expose",
            Self::Request => "request_bricks",
            Self::Fill => "fill_bricks",
            Self::Light => "light_walls",
            Self::Mark => "mark_silhouettes",
            Self::Smooth => "smooth_silhouettes",
        }
    }

    /// Return the numbers of the resources that the stage binds; a stage may bind eight storage buffers on any device.
    pub(crate) const fn bindings(self) -> &'static [u32] {
        match self {
            Self::Cast => &[0, 1, 2, 3, 4, 5, 6, 7],
            Self::Meter => &[0, 1, 2, 3, 4, 8, 9, 10, 11, 13],
            Self::Expose => &[8, 13],
            Self::Request => &[0, 4, 5, 8, 10, 11],
            Self::Fill => &[0, 1, 8, 10, 11],
            Self::Light => &[0, 1, 4, 5, 7, 8, 9, 10, 11, 12, 13],
            Self::Mark => &[0, 4, 12, 13],
            Self::Smooth => &[0, 1, 2, 3, 4, 6, 7, 8, 9, 10, 11, 13],
        }
    }
}

/// Pipeline layout of a stage, with the layout of its resources.
#[derive(Debug)]
pub(crate) struct StageLayout {
    pub(crate) bindings: wgpu::BindGroupLayout,
    pub(crate) pipeline: wgpu::PipelineLayout,
}

impl StageLayout {
    /// Create the layouts of all stages, in the order of [`STAGES`].
    pub(crate) fn all(device: &wgpu::Device) -> Vec<Self> {
        let layout = |stage: Stage| {
            let entries: Vec<_> = stage.bindings().iter().map(|&n| layout_entry(n)).collect();
            let bindings = device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
                label: Some(stage.entry()),
                entries: &entries,
            });
            let pipeline = device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
                label: Some(stage.entry()),
                bind_group_layouts: &[Some(&bindings)],
                immediate_size: 0,
            });
            Self { bindings, pipeline }
        };
        STAGES.into_iter().map(layout).collect()
    }
}

/// Return the kind of the resource with a number, as the shader declares it.
fn layout_entry(binding: u32) -> wgpu::BindGroupLayoutEntry {
    let texture = |sample_type| wgpu::BindingType::Texture {
        sample_type,
        view_dimension: wgpu::TextureViewDimension::D3,
        multisampled: false,
    };
    let buffer = |ty| wgpu::BindingType::Buffer {
        ty,
        has_dynamic_offset: false,
        min_binding_size: None,
    };
    let ty = match binding {
        0 | 8 => buffer(wgpu::BufferBindingType::Uniform),
        1 => texture(wgpu::TextureSampleType::Sint),
        2 => texture(wgpu::TextureSampleType::Uint),
        3 | 4 | 9 => buffer(wgpu::BufferBindingType::Storage { read_only: true }),
        _ => buffer(wgpu::BufferBindingType::Storage { read_only: false }),
    };
    wgpu::BindGroupLayoutEntry {
        binding,
        visibility: wgpu::ShaderStages::COMPUTE,
        ty,
        count: None,
    }
}
