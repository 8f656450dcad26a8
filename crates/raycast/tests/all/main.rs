//! The contracts of the casters, in one program: each program of tests is compiled with the kernels and linked anew.

mod anatomy;
mod appearance;
mod bad_input;
mod casters;
mod decoration;
mod lenses;
mod loads;
mod packets;
mod reference;
mod scene;
mod silhouettes;
mod stop;
mod surface;
mod truth;
