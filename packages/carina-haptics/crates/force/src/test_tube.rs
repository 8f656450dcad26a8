//! Wall field of a straight airway, for tests.

use std::sync::{Arc, OnceLock};

use carina_grid::Affine;
use carina_scope::WallField;

/// Return the wall field of an airway of 9 mm radius along z, from z = -20 to 130 mm.
pub(crate) fn tube() -> Arc<WallField> {
    /// Wall field, computed on first use.
    static TUBE: OnceLock<Arc<WallField>> = OnceLock::new();
    TUBE.get_or_init(|| {
        let lps = Affine::from_columns(
            [0.5, 0.0, 0.0],
            [0.0, 0.5, 0.0],
            [0.0, 0.0, 0.5],
            [-15.0, -15.0, -20.0],
        );
        let shape = [60, 60, 300];
        let distances: Vec<f32> = (0..shape.iter().product::<usize>())
            .map(|n| {
                let at = lps.point([n % 60, n / 60 % 60, n / 3600].map(|v| v as f64));
                (9.0 - libm::hypot(at[0], at[1])) as f32
            })
            .collect();
        Arc::new(WallField::from_distances(&distances, shape, &lps).unwrap())
    })
    .clone()
}
