//! Which graphics adapters this machine has.

use std::{sync::OnceLock, time::Duration};

/// What an adapter is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum AdapterKind {
    /// A card with memory of its own.
    Discrete,
    /// A part of the processor.
    Integrated,
    /// Handed on by a virtual machine.
    Virtual,
    /// A program that plays a graphics card (lavapipe, WARP). Never faster than our own casters on the same cores.
    Software,
    /// The driver does not say.
    Unknown,
}

impl AdapterKind {
    /// In words.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Discrete => "discrete",
            Self::Integrated => "integrated",
            Self::Virtual => "virtual",
            Self::Software => "software",
            Self::Unknown => "unknown",
        }
    }

    /// Longer than any picture takes on a device that is worth using; then the device counts as lost. One in software
    /// works on the processor's cores, which other programs may have for minutes: it is slow and not dead.
    pub(crate) const fn patience(self) -> Duration {
        match self {
            Self::Software => Duration::from_secs(600),
            Self::Discrete | Self::Integrated | Self::Virtual | Self::Unknown => {
                Duration::from_secs(20)
            }
        }
    }
}

/// An adapter, in words that a person can look up.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct AdapterFacts {
    /// As the driver names it.
    pub name: String,
    /// Vulkan, Metal or Dx12.
    pub api: String,
    /// Driver and its version, as far as the driver says.
    pub driver: String,
    /// What it is.
    pub kind: AdapterKind,
}

impl AdapterFacts {
    pub(crate) fn of(info: &wgpu::AdapterInfo) -> Self {
        let words = [info.driver.trim(), info.driver_info.trim()];
        Self {
            name: info.name.clone(),
            api: info.backend.to_string(),
            driver: words
                .into_iter()
                .filter(|word| !word.is_empty())
                .collect::<Vec<_>>()
                .join(" "),
            kind: match info.device_type {
                wgpu::DeviceType::DiscreteGpu => AdapterKind::Discrete,
                wgpu::DeviceType::IntegratedGpu => AdapterKind::Integrated,
                wgpu::DeviceType::VirtualGpu => AdapterKind::Virtual,
                wgpu::DeviceType::Cpu => AdapterKind::Software,
                wgpu::DeviceType::Other => AdapterKind::Unknown,
            },
        }
    }

    /// Lower is tried first.
    const fn rank(&self) -> u8 {
        match self.kind {
            AdapterKind::Discrete => 0,
            AdapterKind::Integrated => 1,
            AdapterKind::Virtual => 2,
            AdapterKind::Unknown => 3,
            AdapterKind::Software => 4,
        }
    }
}

/// The instance behind all devices: one per process, made on first use, which is when drivers are loaded.
fn instance() -> &'static wgpu::Instance {
    static INSTANCE: OnceLock<wgpu::Instance> = OnceLock::new();
    INSTANCE.get_or_init(|| {
        let mut wanted = wgpu::InstanceDescriptor::new_without_display_handle();
        wanted.backends = wgpu::Backends::PRIMARY;
        // Our one shader is tested; the drivers' validation layers cost time and print.
        wanted.flags = wgpu::InstanceFlags::empty();
        // A volume that would push the desktop out of graphics memory is refused, not squeezed in.
        wanted.memory_budget_thresholds.for_resource_creation = Some(90);
        wgpu::Instance::new(wanted)
    })
}

/// All adapters, the likely fastest first; the order holds for the process.
pub(crate) fn found() -> &'static [(AdapterFacts, wgpu::Adapter)] {
    static FOUND: OnceLock<Vec<(AdapterFacts, wgpu::Adapter)>> = OnceLock::new();
    FOUND.get_or_init(|| {
        let adapters = pollster::block_on(instance().enumerate_adapters(wgpu::Backends::PRIMARY));
        let mut found: Vec<_> = adapters
            .into_iter()
            .map(|adapter| (AdapterFacts::of(&adapter.get_info()), adapter))
            .collect();
        found.sort_by_key(|(facts, _)| facts.rank());
        found
    })
}

/// The adapters of this machine, the likely fastest first: discrete, integrated, virtual, software.
///
/// Loads the graphics drivers on the first call, which takes tens of milliseconds.
#[must_use]
pub fn adapters() -> Vec<AdapterFacts> {
    found().iter().map(|(facts, _)| facts.clone()).collect()
}
