//! From a volume to its airways' lumen.

pub mod evidence;
pub mod extension;
mod extension_levels;
mod extension_reach;
mod extension_verdict;
mod extension_ways;
pub mod flood;
mod lungs;
pub mod soft;
mod spots;
pub mod trachea;
pub mod tubeness;

#[cfg(test)]
mod extension_tests;
