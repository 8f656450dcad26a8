//! Segmentation of the airway lumen in a volume.

pub mod evidence_path;
pub mod extension;
mod extension_levels;
mod extension_reach;
mod extension_verdict;
mod extension_ways;
pub mod flood;
mod lung_sample;
mod lungs;
pub mod pieces;
pub mod soft;
mod spots;
pub mod thin;
mod thin_paths;
mod thin_profile;
pub mod trachea;
mod tube_filter;
pub mod tubeness;

#[cfg(test)]
mod extension_tests;
#[cfg(test)]
mod thin_tests;
