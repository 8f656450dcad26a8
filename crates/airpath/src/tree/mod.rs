//! Branches of the airway tree, with their centrelines and radii.

pub mod branch;
pub mod branch_radii;
pub mod branches;
mod centre;
pub mod smooth;
pub mod tree_edit;
mod tube;

#[cfg(test)]
mod branch_radii_tests;
#[cfg(test)]
mod centre_tests;
