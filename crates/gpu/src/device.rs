//! Opened graphics device, with its queue, its pipelines and its error state.

use std::{
    collections::HashMap,
    sync::{
        Arc, Mutex, PoisonError,
        atomic::{AtomicU64, Ordering},
    },
};

use crate::{
    AdapterFacts, GpuError, GpuMap,
    adapter::found,
    resources::{Directions, Slot, TableOnDevice},
    shader,
    stages::{Stage, StageLayout, Variant},
};

/// Maximum number of bytes of a buffer that is requested from a device.
const MAX_BUFFER: u64 = 1 << 30;

/// Number that the next opened device gets.
static NEXT: AtomicU64 = AtomicU64::new(1);

/// Opened graphics device with the kernels of the airway view.
///
/// Several threads may cast pictures at the same time.
#[derive(Debug)]
pub struct Gpu {
    pub(crate) facts: AdapterFacts,
    pub(crate) device: wgpu::Device,
    pub(crate) queue: wgpu::Queue,
    /// Unique number of the device, which distinguishes its resources from those of other devices.
    pub(crate) id: u64,
    /// Pipeline layouts of the stages, in the order of `stages.rs`.
    pub(crate) layouts: Vec<StageLayout>,
    pub(crate) no_map: GpuMap,
    /// Empty buffer, bound in place of resources that a picture does not use.
    pub(crate) nothing: wgpu::Buffer,
    /// Free buffers of finished pictures, for reuse by later pictures.
    pub(crate) slots: Mutex<Vec<Slot>>,
    pub(crate) directions: Mutex<Vec<Directions>>,
    pub(crate) tables: Mutex<Vec<TableOnDevice>>,
    pub(crate) shader: wgpu::ShaderModule,
    pub(crate) pipelines: Mutex<HashMap<(Stage, Variant), wgpu::ComputePipeline>>,
    /// First error that the driver reported; `None` without an error.
    driver_error: Arc<Mutex<Option<String>>>,
}

/// Lock a mutex even after a panic in another thread.
///
/// The protected data are caches, which are consistent at every moment.
pub(crate) fn lock<T>(mutex: &Mutex<T>) -> std::sync::MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Gpu {
    /// Open the adapter at an index of [`crate::adapters`].
    ///
    /// # Errors
    ///
    /// Returns an error if there is no such adapter or the driver does not start.
    pub fn open(index: usize) -> Result<Self, GpuError> {
        let all = found();
        let Some((facts, adapter)) = all.get(index) else {
            return Err(GpuError::NoAdapter {
                index,
                count: all.len(),
            });
        };
        let refuse = |reason: String| GpuError::Device {
            name: facts.name.clone(),
            reason,
        };
        let limits = adapter.limits();
        let wanted = wgpu::Limits {
            max_texture_dimension_3d: limits.max_texture_dimension_3d,
            // Full pictures of large screens behind a lens need more than the default of 128 MB.
            max_storage_buffer_binding_size: limits.max_storage_buffer_binding_size.min(MAX_BUFFER),
            max_buffer_size: limits.max_buffer_size.min(MAX_BUFFER),
            ..wgpu::Limits::default()
        };
        let (device, queue) = pollster::block_on(adapter.request_device(&wgpu::DeviceDescriptor {
            label: Some("carina"),
            required_features: wgpu::Features::empty(),
            required_limits: wanted,
            memory_hints: wgpu::MemoryHints::MemoryUsage,
            ..Default::default()
        }))
        .map_err(|e| refuse(e.to_string()))?;
        let driver_error = Arc::new(Mutex::new(None));
        // The default handler would panic; this handler stores the error, and the next picture fails.
        let stored = Arc::clone(&driver_error);
        device.on_uncaptured_error(Arc::new(move |error: wgpu::Error| {
            lock(&stored).get_or_insert_with(|| error.to_string());
        }));
        let stored = Arc::clone(&driver_error);
        device.set_device_lost_callback(move |reason, message| {
            lock(&stored).get_or_insert_with(|| format!("lost ({reason:?}): {message}"));
        });
        let shader = device.create_shader_module(wgpu::ShaderModuleDescriptor {
            label: Some("airway"),
            source: wgpu::ShaderSource::Wgsl(shader::source().into()),
        });
        let id = NEXT.fetch_add(1, Ordering::Relaxed);
        let no_map = device.create_texture(&wgpu::TextureDescriptor {
            label: Some("no map"),
            size: wgpu::Extent3d::default(),
            mip_level_count: 1,
            sample_count: 1,
            dimension: wgpu::TextureDimension::D3,
            format: wgpu::TextureFormat::R8Uint,
            usage: wgpu::TextureUsages::TEXTURE_BINDING,
            view_formats: &[],
        });
        let gpu = Self {
            facts: facts.clone(),
            no_map: GpuMap {
                view: no_map.create_view(&wgpu::TextureViewDescriptor::default()),
                shape_zyx: [1; 3],
                owner: id,
            },
            layouts: StageLayout::all(&device),
            nothing: device.create_buffer(&wgpu::BufferDescriptor {
                label: Some("nothing"),
                size: 64,
                usage: wgpu::BufferUsages::STORAGE,
                mapped_at_creation: false,
            }),
            device,
            queue,
            id,
            slots: Mutex::default(),
            directions: Mutex::default(),
            tables: Mutex::default(),
            shader,
            pipelines: Mutex::default(),
            driver_error,
        };
        gpu.check_alive()?;
        Ok(gpu)
    }

    /// Return the description of the device's adapter.
    #[must_use]
    pub const fn adapter(&self) -> &AdapterFacts {
        &self.facts
    }

    /// Mark the device as lost, as after a driver reset, so that every later picture fails.
    ///
    /// The method is for tests of the fallback to the CPU.
    pub fn lose(&self) {
        self.device.destroy();
        let _ = self.device.poll(wgpu::PollType::Poll);
        lock(&self.driver_error).get_or_insert_with(|| "given up".to_owned());
    }

    /// Return an error if the driver has reported any problem, because no later result can be trusted.
    pub(crate) fn check_alive(&self) -> Result<(), GpuError> {
        match &*lock(&self.driver_error) {
            None => Ok(()),
            Some(reason) => Err(GpuError::Device {
                name: self.facts.name.clone(),
                reason: reason.clone(),
            }),
        }
    }

    /// Run `work` and return its result together with the error that the driver reported for it, if any.
    pub(crate) fn watched<T>(&self, work: impl FnOnce() -> T) -> (T, Option<String>) {
        let memory = self.device.push_error_scope(wgpu::ErrorFilter::OutOfMemory);
        let validation = self.device.push_error_scope(wgpu::ErrorFilter::Validation);
        let made = work();
        let errors = [validation, memory].map(|scope| pollster::block_on(scope.pop()));
        (
            made,
            errors.into_iter().flatten().next().map(|e| e.to_string()),
        )
    }

    /// Wait until the device has processed a submission; mark the device as lost if it does not answer in time.
    pub(crate) fn wait(&self, index: wgpu::SubmissionIndex) {
        let done = self.device.poll(wgpu::PollType::Wait {
            submission_index: Some(index),
            timeout: Some(self.facts.kind.patience()),
        });
        if let Err(e) = done {
            lock(&self.driver_error).get_or_insert_with(|| format!("no answer: {e}"));
        }
    }
}
