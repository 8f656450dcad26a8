//! Force feedback (paper 7): computation of a force from the position of a hand in the airways, 1,000 times a second.
//!
//! [`ForceModel`] is the force law, [`ForceLoop`] evaluates the law on its own thread. The wall is a
//! [`WallField`](carina_scope::WallField) of Carina.

mod device_space;
mod error;
mod force_loop;
mod law;
mod packet;
mod simulated_hand;
mod tick_clock;
mod tick_statistics;
mod vector;

#[cfg(test)]
mod force_loop_tests;
#[cfg(test)]
mod law_tests;
#[cfg(test)]
mod test_tube;

pub use error::ForceError;
pub use force_loop::{ForceLoop, LoopOptions, WanderingHand};
pub use law::{
    ForceLaw, ForceModel, HandForce, HandSample, LIMIT_N, MAX_STIFFNESS_N_PER_MM, SLEW_N_PER_MS,
};
pub use packet::{FORCE_BYTES, ForcePacket, SAMPLE_BYTES, SamplePacket};
pub use simulated_hand::SimulatedHand;
pub use tick_statistics::LoopFigures;
