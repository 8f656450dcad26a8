//! Rendering stages of a picture: kernels of the shader, their variants, and the resources that each kernel binds.

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
    /// Return the names and values of the kernel's override constants.
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

/// Rendering stage of a picture: one kernel of the shader.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub(crate) enum Stage {
    /// Cast the rays of a band.
    Cast,
    /// Cast a few rays over the whole picture, from which the exposure is computed.
    Meter,
    /// Compute the exposure from the rays of [`Stage::Meter`].
    Expose,
    /// Mark the bricks of slopes that the walls of a band need.
    Request,
    /// Compute the slopes of the bricks that [`Stage::Request`] marked.
    Fill,
    /// Shade the walls of a band.
    Light,
    /// List the pixels on silhouettes, where a near wall ends in front of a far wall.
    Mark,
    /// Cast and shade two rays for each pixel in the list of [`Stage::Mark`].
    Smooth,
}

/// All stages, in the order of the layouts in `Gpu::layouts`.
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

    /// Return the binding numbers of the stage's resources; a device supports at least eight storage buffers per stage.
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

/// Return the layout entry (kind of resource) of a binding number, equal to the shader's declaration.
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
