//! Airway view on a GPU by compute shaders: the computations of `carina-raycast`, with pictures that are equal within
//! one grey level.
//!
//! The volume, the radius map, the transfer table and the rays' directions stay on the device; a picture needs one
//! small upload, one dispatch and one read-back. Voxels are read as integers and interpolated in f32 in the shader
//! (`airway.wgsl`), because a texture unit interpolates with 8-bit weights, which would create false walls.
//!
//! Without the feature `wgpu` this crate is empty and uses neither wgpu nor a driver. With the feature, drivers are
//! loaded when `adapters` or `Gpu::open` is called, not before.
#![cfg(feature = "wgpu")]

mod adapter;
mod cast;
mod decoration;
mod device;
mod error;
mod light_uniforms;
mod passes;
mod picture;
mod rays;
mod read_back;
mod resources;
mod shader;
mod slope_store;
mod slopes;
mod slot;
mod stages;
mod uniforms;
mod volume;

pub use adapter::{AdapterFacts, AdapterKind, adapters};
pub use device::Gpu;
pub use error::GpuError;
pub use resources::{GpuDecoration, GpuMap, GpuVolume, Resident};
