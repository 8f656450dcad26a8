//! Stages of a picture on the device: entry points of the shader and the resources that each binds.

use crate::{
    Gpu,
    device::{Variant, lock},
    resources::Resident,
    slope_store::SlopeStore,
    slot::Slot,
};

/// Stage of a picture: one kernel of the shader.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub(crate) enum Stage {
    /// Cast the rays of a band.
    Cast,
    /// Cast the rays from which the exposure is computed.
    Meter,
    /// Compute the exposure.
    Expose,
    /// Request the bricks of slopes that a band needs.
    Request,
    /// Fill the requested bricks.
    Fill,
    /// Shade the walls of a band.
    Light,
    /// List the pixels on silhouettes.
    Mark,
    /// Cast and shade two rays for each listed pixel.
    Smooth,
}

/// All stages.
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
    const fn entry(self) -> &'static str {
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
    const fn bindings(self) -> &'static [u32] {
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
    bindings: wgpu::BindGroupLayout,
    pipeline: wgpu::PipelineLayout,
}

/// Buffers of a picture that are not in its slot.
pub(crate) struct Tables {
    pub(crate) transfer: wgpu::Buffer,
    pub(crate) directions: wgpu::Buffer,
    pub(crate) cells: wgpu::Buffer,
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

impl Gpu {
    fn layout_of(&self, stage: Stage) -> &StageLayout {
        &self.layouts[stage as usize]
    }

    /// Return the compute pipeline of a stage, which is compiled on first use.
    pub(crate) fn pipeline(&self, stage: Stage, variant: Variant) -> wgpu::ComputePipeline {
        // Only the stages that cast rays differ between variants.
        let variant = match stage {
            Stage::Cast | Stage::Meter | Stage::Smooth => variant,
            _ => Variant::default(),
        };
        let constants = variant.constants();
        let make = || {
            self.device
                .create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
                    label: Some(stage.entry()),
                    layout: Some(&self.layout_of(stage).pipeline),
                    module: &self.shader,
                    entry_point: Some(stage.entry()),
                    compilation_options: wgpu::PipelineCompilationOptions {
                        constants: &constants,
                        ..Default::default()
                    },
                    cache: None,
                })
        };
        let mut pipelines = lock(&self.pipelines);
        pipelines
            .entry((stage, variant))
            .or_insert_with(make)
            .clone()
    }

    /// Bind the resources of a stage.
    pub(crate) fn bound(
        &self,
        stage: Stage,
        resident: &Resident<'_>,
        tables: &Tables,
        slot: &Slot,
        slopes: Option<&SlopeStore>,
    ) -> wgpu::BindGroup {
        let nothing = &self.nothing;
        let entry = |&binding: &u32| {
            let resource = match binding {
                1 => wgpu::BindingResource::TextureView(&resident.volume.view),
                2 => wgpu::BindingResource::TextureView(&resident.map.unwrap_or(&self.no_map).view),
                _ => match binding {
                    0 => &slot.uniforms,
                    3 => &tables.transfer,
                    4 => &tables.directions,
                    5 => &slot.walls,
                    6 => &slot.counts,
                    7 => &slot.pixels,
                    8 => &slot.light,
                    9 => &tables.cells,
                    10 => slopes.map_or(nothing, |slopes| &slopes.bricks),
                    11 => slopes.map_or(nothing, |slopes| &slopes.slopes),
                    12 => &slot.depths,
                    _ => &slot.state,
                }
                .as_entire_binding(),
            };
            wgpu::BindGroupEntry { binding, resource }
        };
        let entries: Vec<_> = stage.bindings().iter().map(entry).collect();
        self.device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some(stage.entry()),
            layout: &self.layout_of(stage).bindings,
            entries: &entries,
        })
    }
}
