//! Pictures of what another caster has gathered: a graphics card's rays, lit here.

use std::ops::Range;

use crate::{
    CastStats, Frame, Gathered, InstructionSet, Method, RaycastError,
    lighting::Lighting,
    packet::{BAND_ROWS, light_rows},
    rows::{check, share},
};

/// Lights rows whose rays another caster has gathered, `[row, column]`, as [`cast_rows`] lights its own; `stats` are that
/// caster's. `method` measures the exposure.
pub fn light_gathered(
    frame: &Frame<'_>,
    method: Method<'_>,
    rows: Range<usize>,
    simd: InstructionSet,
    gathered: &[Gathered],
    stats: CastStats,
) -> Result<(Vec<u8>, CastStats), RaycastError> {
    check(frame, method, &rows, simd)?;
    let width = frame.camera().width();
    let refuse = |what: &'static str, expected: String, found: String| {
        Err(RaycastError::Setting {
            what,
            expected,
            found,
        })
    };
    let Some(light) = Lighting::exposed(frame, method) else {
        return refuse(
            "appearance",
            "one to light by".to_owned(),
            "none".to_owned(),
        );
    };
    if gathered.len() != rows.len() * width {
        let expected = format!("{} pixels", rows.len() * width);
        return refuse("gathered rays", expected, gathered.len().to_string());
    }
    let (rgb, lit) = share(&rows, (0u8, 3 * width), BAND_ROWS, None, |first, out| {
        let at = (first - rows.start) * width;
        let walls = &gathered[at..at + out.len() / 3];
        light_rows(frame, &light, simd, first, walls, out);
        CastStats::default().lit(walls)
    });
    let stats = CastStats {
        num_shaded: lit.num_shaded,
        num_loads: stats.num_loads + lit.num_loads,
        ..stats
    };
    Ok((rgb, stats))
}
