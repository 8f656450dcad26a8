//! Source of the shader: the kernels, and the constants of `carina-raycast` that they share with the CPU.

use carina_raycast::{SharedValue, shading_constants};

/// Return the source of the module with all kernels.
pub(crate) fn source() -> String {
    let mut constants = shading_constants();
    let full_gain = u32::from(carina_grid::FULL_GAIN);
    constants.push(("FULL_GAIN", SharedValue::Unsigned(full_gain)));
    let declared: Vec<_> = constants
        .iter()
        .map(|(name, value)| format!("const {name} = {};\n", literal(value)))
        .collect();
    [
        &declared.concat(),
        include_str!("airway.wgsl"),
        include_str!("lighting.wgsl"),
        include_str!("slopes.wgsl"),
        include_str!("texture.wgsl"),
        include_str!("decoration.wgsl"),
        include_str!("film.wgsl"),
        include_str!("stages.wgsl"),
    ]
    .concat()
}

/// Return a value as a WGSL expression; the shortest decimal form of an f32 denotes exactly that f32.
fn literal(value: &SharedValue) -> String {
    let join = |items: Vec<String>| items.join(", ");
    let float = |v: &f32| format!("{v:?}f");
    let vector = |row: &[f32]| {
        let items = join(row.iter().map(float).collect());
        format!("vec{}<f32>({items})", row.len())
    };
    match value {
        SharedValue::Float(v) => float(v),
        SharedValue::Unsigned(v) => format!("{v}u"),
        SharedValue::Signed(v) => format!("{v}i"),
        SharedValue::Vector(row) => vector(row),
        SharedValue::SignedVector(row) => {
            let items = row.iter().map(|v| format!("{v}i")).collect();
            format!("vec{}<i32>({})", row.len(), join(items))
        }
        SharedValue::Rows(rows) => {
            format!(
                "array({})",
                join(rows.iter().map(|row| vector(row)).collect())
            )
        }
    }
}
