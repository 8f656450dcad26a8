//! Shading of pictures whose rays were gathered by another caster, such as a graphics card.

use std::ops::Range;

use crate::{
    CastStats, Frame, Gathered, InstructionSet, Method, RaycastError,
    lighting::Lighting,
    rows::check,
    shaded_walls::{Walls, light_walls, rows_to_gather},
};

/// Shade rows whose rays another caster has gathered; return RGB and statistics as [`cast_rows`] does for its own rays.
///
/// `gathered` contains the rays of the rows [`rows_to_gather`], `[row, column]`, and `stats` are the statistics of the
/// other caster. `method` measures the exposure and casts the additional rays at silhouettes.
///
/// # Errors
///
/// Returns an error if a setting is not valid, or if `gathered` has the wrong length.
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
    let all = rows_to_gather(frame, &rows);
    if gathered.len() != all.len() * width {
        let expected = format!(
            "{} pixels, of rows {} to {}",
            all.len() * width,
            all.start,
            all.end
        );
        return refuse("gathered rays", expected, gathered.len().to_string());
    }
    let (before, gathered) = gathered.split_at((rows.start - all.start) * width);
    let (walls, after) = gathered.split_at(rows.len() * width);
    let beside = [before, after].map(|walls| walls.iter().map(|wall| wall.hit).collect::<Vec<_>>());
    let lit_by = (&rows, &Walls::Gathered(walls));
    let (rgb, lit) = light_walls(frame, method, &light, (true, simd), lit_by, &beside, None);
    let stats = CastStats {
        num_rays: walls.len() as u64,
        num_shaded: lit.num_shaded,
        ..stats.plus(lit)
    };
    Ok((rgb, stats))
}
