//! Opened devices of this machine, and functions that upload test scenes to them.

use std::sync::OnceLock;

use carina_gpu::{Gpu, GpuMap, GpuVolume, Resident, adapters};

/// Return an opened device for every adapter of this machine.
///
/// `make test-gpu` sets `CARINA_GPU_REQUIRED`; a machine without an adapter then fails the tests.
pub(crate) fn gpus() -> &'static [Gpu] {
    /// Devices, opened on first use.
    static GPUS: OnceLock<Vec<Gpu>> = OnceLock::new();
    GPUS.get_or_init(|| {
        let all: Vec<Gpu> = (0..adapters().len())
            .map(|index| Gpu::open(index).expect("an adapter that is listed opens"))
            .collect();
        for gpu in &all {
            println!("tested on {:?}", gpu.adapter());
        }
        if all.is_empty() {
            assert!(
                std::env::var_os("CARINA_GPU_REQUIRED").is_none(),
                "no graphics adapter, not even a software one: install mesa-vulkan-drivers"
            );
            println!(
                "SKIPPED: no graphics adapter (Debian: mesa-vulkan-drivers has one in software)"
            );
        }
        all
    })
}

/// Return a scene on the device without anatomical data.
pub(crate) fn on<'a>(volume: &'a GpuVolume, map: Option<&'a GpuMap>) -> Resident<'a> {
    Resident {
        volume,
        map,
        decoration: None,
    }
}
