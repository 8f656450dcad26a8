//! Contract tests of the casters, in one program, because each test program compiles the kernels and is linked
//! separately.

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
