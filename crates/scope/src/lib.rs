//! The bronchoscope: how its tip follows a path (paper 3.2, path mode).
//!
//! A tracked path is a polyline, often a staircase of voxels. [`FlightCurve`] makes of it what a camera can ride on: a curve
//! that stays within a stated distance of the polyline, a gaze that turns slowly, and frames that do not spin about it.

mod curve;
mod error;
mod frames;
mod gaze;

pub use curve::{FlightCurve, Nearest};
pub use error::ScopeError;
pub use frames::rotation_minimizing_frames;
