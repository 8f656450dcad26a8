//! Test that the shader is valid, which needs neither an adapter nor `wgpu`.
//!
//! A device would reject an invalid shader, and the CPU would then cast all pictures without any message.

#[path = "../src/shader.rs"]
mod shader;

use naga::{
    front::wgsl::parse_str,
    valid::{Capabilities, ValidationFlags, Validator},
};

#[test]
fn the_shader_is_valid() {
    let source = shader::source();
    let module =
        parse_str(&source).unwrap_or_else(|error| panic!("{}", error.emit_to_string(&source)));
    Validator::new(ValidationFlags::all(), Capabilities::empty())
        .validate(&module)
        .unwrap_or_else(|error| panic!("{}", error.emit_to_string(&source)));
}
