//! Measurement of cross-sections of an airway.

pub mod blurred_tube;
pub mod cross_section;
pub mod deblur;
pub mod profile;
pub mod rays;

#[cfg(test)]
mod section_tests;
