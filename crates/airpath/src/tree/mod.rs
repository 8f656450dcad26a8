//! Branches of the airway tree, with their centrelines and radii.

pub mod branch;
pub mod branches;
pub mod calibre;
mod centre;
pub mod smooth;
pub mod tree_edit;
mod tube;

#[cfg(test)]
mod calibre_tests;
#[cfg(test)]
mod centre_tests;
