//! The airway view on a GPU, by compute shaders: the maths of `carina-raycast`, within one grey level.
//!
//! The volume, the radius map, the transfer table and the rays' directions stay on the device; a picture costs one small
//! upload, one dispatch and one read-back. Voxels are read as the integers that they are and interpolated in f32 in the
//! shader (`airway.wgsl`): a texture unit's own interpolation has 8-bit weights, a wall of its own making.
//!
//! Without the feature `wgpu` this crate is empty, and neither wgpu nor a driver is touched. With it, drivers are loaded
//! when [`adapters`] or [`Gpu::open`] is called, not before.
#![cfg(feature = "wgpu")]

mod adapter;
mod cast;
mod device;
mod error;
mod rays;
mod resources;
mod slot;
mod uniforms;
mod volume;

pub use adapter::{AdapterFacts, AdapterKind, adapters};
pub use device::Gpu;
pub use error::GpuError;
pub use resources::{GpuMap, GpuVolume};
