//! The bronchoscope: how its tip follows a path (paper 3.2, path mode), and how it bends, touches and pushes back.
//!
//! A tracked path is a polyline, often a staircase of voxels. [`FlightCurve`] makes of it what a camera can ride on: a curve
//! that stays within a stated distance of the polyline, a gaze that turns slowly, and frames that do not spin about it.
//!
//! [`ScopeDrive`] is the instrument itself: insertion, roll and flexion move an elastic axis in a lumen, which is a
//! [`WallField`], the signed distance to the wall.

mod axis;
mod body;
mod curve;
mod device_space;
mod drive;
mod eight;
mod error;
mod feelers;
mod force;
mod force_loop;
mod frames;
mod gaze;
mod loop_figures;
mod nearest;
mod nearest_packet;
mod packet;
mod simulated;
mod ticking;
mod wall;
mod wall_mesh;

#[cfg(test)]
mod drive_tests;
#[cfg(test)]
mod force_loop_tests;
#[cfg(test)]
mod force_tests;

pub use body::ScopeBody;
pub use curve::{FlightCurve, Nearest};
pub use drive::{Contact, ContactRecord, Limit, ScopeDrive, ScopeState};
pub use error::ScopeError;
pub use force::{
    ForceLaw, ForceModel, HandForce, HandSample, LIMIT_N, MAX_STIFFNESS_N_PER_MM, SLEW_N_PER_MS,
};
pub use force_loop::{ForceLoop, LoopOptions, WanderingHand};
pub use frames::rotation_minimising_frames;
pub use loop_figures::LoopFigures;
pub use packet::{FORCE_BYTES, ForcePacket, SAMPLE_BYTES, SamplePacket};
pub use simulated::SimulatedHand;
pub use wall::WallField;
