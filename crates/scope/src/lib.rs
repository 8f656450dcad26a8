//! Motion of a bronchoscope along a path (paper 3.2, path mode), and its bending and contact with the airway wall.
//!
//! A tracked path is a polyline, often with voxel steps. [`FlightCurve`] converts it to a path for a camera: a curve
//! that stays within a given distance of the polyline, a gaze that turns slowly, and frames that do not rotate about
//! the gaze.
//!
//! [`ScopeDrive`] simulates the instrument: insertion, roll and flexion move an elastic axis in a lumen. The lumen is a
//! [`WallField`], the signed distance to the wall.

mod axis;
mod body;
mod curve;
mod drive;
mod error;
mod feelers;
mod frames;
mod gaze;
mod nearest;
mod nearest_packet;
mod ridge;
mod tube;
mod vector8;
mod wall;
mod wall_mesh;

#[cfg(test)]
mod drive_tests;

pub use body::ScopeBody;
pub use curve::{FlightCurve, Nearest};
pub use drive::{Contact, ContactRecord, Limit, ScopeDrive, ScopeState};
pub use error::ScopeError;
pub use frames::rotation_minimising_frames;
pub use ridge::{MAX_RIDGES, Ridge};
pub use wall::WallField;
