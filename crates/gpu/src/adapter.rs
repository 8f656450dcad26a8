//! Graphics adapters of this machine, found through the drivers.

use std::{sync::OnceLock, time::Duration};

/// Kind of a graphics adapter, as the driver reports it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum AdapterKind {
    /// Graphics card with its own memory.
    Discrete,
    /// Graphics unit that is part of the processor.
    Integrated,
    /// Adapter provided by a virtual machine.
    Virtual,
    /// Program that emulates a graphics card (lavapipe, WARP).
    ///
    /// Such a program is never faster than the casters of `carina-raycast` on the same cores.
    Software,
    /// Unknown, because the driver does not report the kind.
    Unknown,
}

impl AdapterKind {
    /// Return the name of the kind as text.
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

    /// Return the longest time for which this process waits for a device to finish its work; a device that takes longer
    /// counts as lost.
    ///
    /// Any useful device casts a picture faster. A software device runs on the processor's cores, which other programs
    /// may occupy for minutes, so its limit is longer.
    pub(crate) const fn patience(self) -> Duration {
        match self {
            Self::Software => Duration::from_secs(600),
            Self::Discrete | Self::Integrated | Self::Virtual | Self::Unknown => {
                Duration::from_secs(20)
            }
        }
    }
}

/// Description of a graphics adapter: its name, interface, driver and kind, shown to users.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct AdapterFacts {
    /// Name of the adapter as reported by the driver.
    pub name: String,
    /// Graphics interface: Vulkan, Metal or Dx12.
    pub api: String,
    /// Name and version of the driver, as far as the driver reports them.
    pub driver: String,
    /// Kind of the adapter.
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

    /// Return the rank of the adapter; adapters with a lower rank are tried first.
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

/// Return the wgpu instance that all devices of this process share.
///
/// The instance is created on first use, which loads the drivers.
fn instance() -> &'static wgpu::Instance {
    /// wgpu instance of this process.
    static INSTANCE: OnceLock<wgpu::Instance> = OnceLock::new();
    INSTANCE.get_or_init(|| {
        let mut wanted = wgpu::InstanceDescriptor::new_without_display_handle();
        wanted.backends = wgpu::Backends::PRIMARY;
        // The validation layers of the drivers are off, because the only shader is tested, and they cost time and print
        // messages.
        wanted.flags = wgpu::InstanceFlags::empty();
        // A volume that would displace the desktop from graphics memory is rejected.
        wanted.memory_budget_thresholds.for_resource_creation = Some(90);
        wgpu::Instance::new(wanted)
    })
}

/// Return all adapters, the probably fastest first; the order is the same during the whole process.
pub(crate) fn found() -> &'static [(AdapterFacts, wgpu::Adapter)] {
    /// Adapters of this machine; the search runs on first use.
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

/// Return the adapters of this machine, the likely fastest first: discrete, integrated, virtual, software.
///
/// The first call loads the graphics drivers, which takes tens of milliseconds.
#[must_use]
pub fn adapters() -> Vec<AdapterFacts> {
    found().iter().map(|(facts, _)| facts.clone()).collect()
}
