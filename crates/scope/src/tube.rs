//! Tube round an axis, whose inside a wall field adds to the lumen.
//!
//! A sampled field cuts off the peak of the distance on the axis of a narrow airway, by up to half of the spacing of its
//! samples. The wall of a tube is computed at each point, so its radius is exact on the axis.

use std::sync::Arc;

use carina_grid::dot;

use crate::ScopeError;

/// Distance outside the tube's wall up to which the distance to the tube is computed, mm.
const REACH_MM: f64 = 1.0;

/// Part of a tube between two points of its axis.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Part {
    from: [f64; 3],
    along: [f64; 3],
    /// Reciprocal of the squared length; 0 for a part without a length.
    per_square: f64,
    radius: f64,
    /// Increase of the radius along the part.
    more: f64,
}

impl Part {
    /// Return the larger of the distance to the wall of this part and a lower limit.
    fn at_least(&self, p: [f64; 3], limit_mm: f64) -> f64 {
        // A part whose largest radius is below the limit, or that is too far away, needs no square root.
        let spare = self.radius + self.more.max(0.0) - limit_mm;
        if spare <= 0.0 {
            return limit_mm;
        }
        let off: [f64; 3] = std::array::from_fn(|a| p[a] - self.from[a]);
        let t = (dot(off, self.along) * self.per_square).clamp(0.0, 1.0);
        let away: [f64; 3] = std::array::from_fn(|a| off[a] - t * self.along[a]);
        let square = dot(away, away);
        if square >= spare * spare {
            return limit_mm;
        }
        (self.radius + t * self.more - libm::sqrt(square)).max(limit_mm)
    }
}

/// Union of the balls along an axis, with the parts near each cell of a grid.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Tube {
    parts: Arc<Vec<Part>>,
    /// Position in `near` of the first part of each cell; one more entry marks the end.
    first: Arc<Vec<u32>>,
    near: Arc<Vec<u32>>,
}

impl Tube {
    /// Create a tube; `cell_of` returns the position of a point in a grid of cells, by an affine map.
    pub(crate) fn new(
        axis: &[[f64; 3]],
        radius: &[f64],
        num_cells: [usize; 3],
        cell_of: &impl Fn([f64; 3]) -> [f64; 3],
    ) -> Result<Self, ScopeError> {
        let refuse = |reason: &str| {
            Err(ScopeError::Wall {
                reason: reason.to_owned(),
            })
        };
        if axis.len() != radius.len() || axis.len() < 2 {
            return refuse("a tube needs two points or more, and a radius for each");
        }
        if axis.iter().flatten().any(|v| !v.is_finite()) {
            return refuse("a point of its tube is not finite");
        }
        if radius.iter().any(|&r| !(r.is_finite() && r > 0.0)) {
            return refuse("a radius of its tube is not above 0");
        }
        let parts: Vec<Part> = (1..axis.len())
            .map(|n| {
                let along: [f64; 3] = std::array::from_fn(|a| axis[n][a] - axis[n - 1][a]);
                let square = dot(along, along);
                Part {
                    from: axis[n - 1],
                    along,
                    per_square: if square > 1e-12 { 1.0 / square } else { 0.0 },
                    radius: radius[n - 1],
                    more: radius[n] - radius[n - 1],
                }
            })
            .collect();
        let num: usize = num_cells.iter().product();
        let mut members: Vec<(u32, u32)> = Vec::new();
        for (n, part) in parts.iter().enumerate() {
            let margin = part.radius.max(part.radius + part.more) + REACH_MM;
            let Some(cells) = cells_near(part, margin, num_cells, cell_of) else {
                continue;
            };
            let [x, y, z] = cells;
            for k in z.0..=z.1 {
                for j in y.0..=y.1 {
                    for i in x.0..=x.1 {
                        let cell = (k * num_cells[1] + j) * num_cells[0] + i;
                        members.push((cell as u32, n as u32));
                    }
                }
            }
        }
        members.sort_unstable();
        let mut first = vec![0u32; num + 1];
        for &(cell, _) in &members {
            first[cell as usize + 1] += 1;
        }
        for n in 0..num {
            first[n + 1] += first[n];
        }
        Ok(Self {
            parts: Arc::new(parts),
            first: Arc::new(first),
            near: Arc::new(members.into_iter().map(|(_, part)| part).collect()),
        })
    }

    /// Return the larger of the distance from a point in a cell to the tube's wall, and a lower limit.
    pub(crate) fn at_least(&self, cell: usize, p: [f64; 3], limit_mm: f64) -> f64 {
        self.near[self.first[cell] as usize..self.first[cell + 1] as usize]
            .iter()
            .fold(limit_mm, |best, &n| {
                self.parts[n as usize].at_least(p, best)
            })
    }

    /// Call `take` with the bytes of each part of the tube.
    pub(crate) fn for_each_part(&self, mut take: impl FnMut(&[u8])) {
        for part in self.parts.iter() {
            let [x, y, z] = part.from;
            let [dx, dy, dz] = part.along;
            for v in [x, y, z, dx, dy, dz, part.radius, part.more] {
                take(&v.to_le_bytes());
            }
        }
    }
}

/// Return the first and last cell on each axis within a margin of a part; `None` if the part is outside the grid.
fn cells_near(
    part: &Part,
    margin: f64,
    num_cells: [usize; 3],
    cell_of: &impl Fn([f64; 3]) -> [f64; 3],
) -> Option<[(usize, usize); 3]> {
    let mut low = [f64::INFINITY; 3];
    let mut high = [f64::NEG_INFINITY; 3];
    for corner in 0..16u32 {
        let end = if corner & 8 == 0 { 0.0 } else { 1.0 };
        let p: [f64; 3] = std::array::from_fn(|a| {
            let side = if corner >> a & 1 == 0 {
                -margin
            } else {
                margin
            };
            part.from[a] + end * part.along[a] + side
        });
        let at = cell_of(p);
        for a in 0..3 {
            low[a] = low[a].min(at[a]);
            high[a] = high[a].max(at[a]);
        }
    }
    let mut found = [(0, 0); 3];
    for a in 0..3 {
        if !(high[a] >= 0.0 && low[a] <= num_cells[a] as f64) {
            return None;
        }
        let last = num_cells[a] - 1;
        found[a] = (
            (low[a].max(0.0) as usize).min(last),
            (high[a] as usize).min(last),
        );
    }
    Some(found)
}
