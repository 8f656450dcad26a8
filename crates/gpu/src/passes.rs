//! Compute pipelines of the rendering stages on the GPU, and the bind groups with the buffers of one picture.

use crate::{
    Gpu,
    device::lock,
    resources::{Resident, Slot},
    slope_store::SlopeStore,
    stages::{Stage, StageLayout, Variant},
};

/// Buffers of a picture that are not part of its slot: transfer table, ray directions and anatomical data.
pub(crate) struct Tables {
    pub(crate) transfer: wgpu::Buffer,
    pub(crate) directions: wgpu::Buffer,
    pub(crate) cells: wgpu::Buffer,
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

    /// Bind the buffers and textures of a picture to a stage's kernel.
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
