//! Tube round an axis, whose inside a wall field adds to the lumen.
//!
//! A sampled field cuts off the peak of the distance on the axis of a narrow airway, by up to half of the spacing of its
//! samples. The wall of a tube is computed at each point, so its radius is exact on the axis.
//!
//! A drive calls for millions of distances, so each small block of the lattice lists only those parts of the tube that
//! may determine the distance at a point of the block. The other parts need no test, and the distances are the same.

use std::sync::Arc;

use carina_grid::dot;

use crate::ScopeError;
use crate::body::distance;

/// Distance outside the tube's wall up to which the distance to the tube is computed, mm.
const REACH_MM: f64 = 1.0;
/// Number of blocks of a brick on each axis.
pub(crate) const BLOCKS: usize = 8;
/// Number of groups of blocks of a brick on each axis; the parts of a block are chosen among those of its group.
const GROUPS: usize = 4;
/// Number of blocks of a group of blocks on each axis.
const GROUP: usize = BLOCKS / GROUPS;
/// Minimum difference of the distances, mm, by which a part of the tube must be farther than another part before a
/// block leaves it out.
///
/// The margin exceeds the rounding errors of the distances, so that results are the same, bit for bit, with and without
/// the lists.
const GUARD_MM: f64 = 1e-6;
/// Entry of a brick (cube of samples) that the tube does not reach.
const NO_BLOCK: u32 = u32::MAX;

/// Piece of a tube between two points of its axis.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Part {
    from: [f64; 3],
    along: [f64; 3],
    /// Reciprocal of the squared length; 0 for a part without a length.
    per_square: f64,
    radius: f64,
    /// Increase of the radius along the piece, mm.
    more: f64,
    /// Distance in mm by which the sampled wall near this part of the tube is moved inwards.
    excess: f64,
    /// Increase of `excess` along the piece, mm.
    more_excess: f64,
}

impl Part {
    /// Return the negative distance from a point to the axis of this part, and its largest change in mm per mm.
    fn nearness(&self, p: [f64; 3]) -> (f64, f64) {
        (-libm::sqrt(self.away(p).1), 1.0)
    }

    /// Return the position along this part nearest to a point (0 at its start, 1 at its end), and the squared distance
    /// in mm to it.
    fn away(&self, p: [f64; 3]) -> (f64, f64) {
        let off: [f64; 3] = std::array::from_fn(|a| p[a] - self.from[a]);
        let t = (dot(off, self.along) * self.per_square).clamp(0.0, 1.0);
        let away: [f64; 3] = std::array::from_fn(|a| off[a] - t * self.along[a]);
        (t, dot(away, away))
    }

    /// Return the distance from a point to the wall of this part, and the largest change of this distance in mm per mm.
    fn distance(&self, p: [f64; 3]) -> (f64, f64) {
        let (t, square) = self.away(p);
        let mm = self.radius + t * self.more - libm::sqrt(square);
        (mm, 1.0 + self.more.abs() * libm::sqrt(self.per_square))
    }

    /// Return the larger of the distance to the wall of this part and a lower limit.
    fn at_least(&self, p: [f64; 3], limit_mm: f64) -> f64 {
        // A part whose largest radius is below the limit, or that is too far away, needs no square root.
        let spare = self.radius + self.more.max(0.0) - limit_mm;
        if spare <= 0.0 {
            return limit_mm;
        }
        let (t, square) = self.away(p);
        if square >= spare * spare {
            return limit_mm;
        }
        (self.radius + t * self.more - libm::sqrt(square)).max(limit_mm)
    }
}

/// Interface to the wall field's lattice of bricks (cubes of samples) that a tube uses.
pub(crate) trait Bricks {
    /// Return the number of bricks of the wall field on each axis.
    fn num(&self) -> [usize; 3];
    /// Return the position of a point in bricks.
    fn position_in_bricks(&self, p_lps: [f64; 3]) -> [f64; 3];
    /// Return the point at a position in bricks, LPS mm.
    fn to_lps(&self, at: [f64; 3]) -> [f64; 3];
    /// Return the least sampled distance in a block of a brick, mm.
    fn least_mm(&self, brick: usize, block: [usize; 3]) -> f64;
}

/// Union of the balls along an axis, with the parts that matter in each block of a lattice.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Tube {
    parts: Arc<Vec<Part>>,
    /// Number of each brick's first block, or [`NO_BLOCK`] for a brick that the tube does not reach.
    block_at: Arc<Vec<u32>>,
    /// Position in `near` of the first part of each block; one more entry marks the end.
    first: Arc<Vec<u32>>,
    near: Arc<Vec<u32>>,
    /// The same for the parts that may be nearest to a point of a block; empty without an excess.
    first_nearest: Arc<Vec<u32>>,
    nearest: Arc<Vec<u32>>,
}

impl Tube {
    /// Create a tube in the lumen of a lattice; the sampled wall near a point of the axis is moved inwards by `excess`.
    pub(crate) fn new(
        axis: &[[f64; 3]],
        radius: &[f64],
        excess: &[f64],
        bricks: &impl Bricks,
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
        if excess.len() != radius.len() || excess.iter().any(|&e| !(e.is_finite() && e >= 0.0)) {
            return refuse("the excess of its lumen needs a value of 0 or more for each point");
        }
        let most_excess = excess.iter().copied().fold(0.0, f64::max);
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
                    excess: excess[n - 1],
                    more_excess: excess[n] - excess[n - 1],
                }
            })
            .collect();
        let num = bricks.num();
        let mut members: Vec<(u32, u32)> = Vec::new();
        for (n, part) in parts.iter().enumerate() {
            let margin = part.radius.max(part.radius + part.more) + REACH_MM + most_excess;
            let Some([x, y, z]) = bricks_near(part, margin, bricks) else {
                continue;
            };
            for k in z.0..=z.1 {
                for j in y.0..=y.1 {
                    for i in x.0..=x.1 {
                        let brick = (k * num[1] + j) * num[0] + i;
                        members.push((brick as u32, n as u32));
                    }
                }
            }
        }
        members.sort_unstable();
        let half_mm = [GROUPS, BLOCKS].map(|num| half_of_block_mm(bricks, num));
        let mut block_at = vec![NO_BLOCK; num.iter().product()];
        let (mut first, mut near) = (vec![0], Vec::new());
        let (mut first_nearest, mut nearest) = (Vec::new(), Vec::new());
        if most_excess > 0.0 {
            first_nearest.push(0);
        }
        let mut lists: Vec<Vec<u32>> = vec![Vec::new(); BLOCKS * BLOCKS * BLOCKS];
        let mut nearest_lists = lists.clone();
        for own in members.chunk_by(|a, b| a.0 == b.0) {
            let brick = own[0].0 as usize;
            let place = [
                brick % num[0],
                brick / num[0] % num[1],
                brick / num[0] / num[1],
            ];
            let middle = |cell: [usize; 3], per_brick: usize| {
                bricks.to_lps(std::array::from_fn(|a| {
                    place[a] as f64 + (cell[a] as f64 + 0.5) / per_brick as f64
                }))
            };
            let all: Vec<u32> = own.iter().map(|&(_, part)| part).collect();
            for group in cells(GROUPS) {
                let blocks = cells(GROUP)
                    .map(|at| std::array::from_fn(|a| GROUP * group[a] + at[a]))
                    .map(|block| (block, bricks.least_mm(brick, block)));
                let least = blocks
                    .clone()
                    .map(|(_, mm)| mm)
                    .fold(f64::INFINITY, f64::min);
                let least = least - most_excess;
                let at = middle(group, GROUPS);
                let some = superior(&all, least, half_mm[0], |n| parts[n].distance(at));
                let close = superior(&all, f64::NEG_INFINITY, half_mm[0], |n| {
                    parts[n].nearness(at)
                });
                for (block, least) in blocks {
                    let (at, n) = (middle(block, BLOCKS), number(block));
                    let least = least - most_excess;
                    lists[n] = superior(&some, least, half_mm[1], |n| parts[n].distance(at));
                    if most_excess > 0.0 {
                        nearest_lists[n] = superior(&close, f64::NEG_INFINITY, half_mm[1], |n| {
                            parts[n].nearness(at)
                        });
                    }
                }
            }
            block_at[brick] = (first.len() - 1) as u32;
            for list in &lists {
                near.extend(list);
                first.push(near.len() as u32);
            }
            for list in nearest_lists.iter().filter(|_| most_excess > 0.0) {
                nearest.extend(list);
                first_nearest.push(nearest.len() as u32);
            }
        }
        Ok(Self {
            parts: Arc::new(parts),
            block_at: Arc::new(block_at),
            first: Arc::new(first),
            near: Arc::new(near),
            first_nearest: Arc::new(first_nearest),
            nearest: Arc::new(nearest),
        })
    }

    /// Return whether the sampled wall is moved inwards near some part of the tube.
    pub(crate) fn has_excess(&self) -> bool {
        !self.first_nearest.is_empty()
    }

    /// Return the distance in mm by which the sampled wall is moved inwards near a point in a block of a brick.
    pub(crate) fn excess_mm(&self, brick: usize, block: [usize; 3], p: [f64; 3]) -> f64 {
        let first = self.block_at[brick];
        if !self.has_excess() || first == NO_BLOCK {
            return 0.0;
        }
        let n = first as usize + number(block);
        let mut found = (f64::INFINITY, 0.0);
        for &n in &self.nearest[self.first_nearest[n] as usize..self.first_nearest[n + 1] as usize]
        {
            let part = &self.parts[n as usize];
            let (t, square) = part.away(p);
            if square < found.0 {
                found = (square, part.excess + t * part.more_excess);
            }
        }
        found.1
    }

    /// Return the larger of the distance from a point in a block of a brick to the tube's wall, and a lower limit.
    pub(crate) fn at_least(
        &self,
        brick: usize,
        block: [usize; 3],
        p: [f64; 3],
        limit_mm: f64,
    ) -> f64 {
        let first = self.block_at[brick];
        if first == NO_BLOCK {
            return limit_mm;
        }
        let n = first as usize + number(block);
        self.near[self.first[n] as usize..self.first[n + 1] as usize]
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
            if self.has_excess() {
                take(&part.excess.to_le_bytes());
                take(&part.more_excess.to_le_bytes());
            }
        }
    }
}

/// Return the positions of `num` cells on each axis, x fastest.
fn cells(num: usize) -> impl Iterator<Item = [usize; 3]> + Clone {
    (0..num * num * num).map(move |n| [n % num, n / num % num, n / num / num])
}

/// Return the number of a block among the blocks of its brick.
const fn number(block: [usize; 3]) -> usize {
    (block[2] * BLOCKS + block[1]) * BLOCKS + block[0]
}

/// Return those of some parts whose value may be the largest one at a point within `half_mm` of a point.
///
/// `value` returns the value of a part at that point, and its largest change per mm. The largest value is at least
/// `least` everywhere there.
fn superior(
    some: &[u32],
    least: f64,
    half_mm: f64,
    value: impl Fn(usize) -> (f64, f64),
) -> Vec<u32> {
    let ranges: Vec<(f64, f64)> = some
        .iter()
        .map(|&n| {
            let (mm, change) = value(n as usize);
            (mm - change * half_mm, mm + change * half_mm)
        })
        .collect();
    let least = ranges.iter().map(|range| range.0).fold(least, f64::max);
    some.iter()
        .zip(&ranges)
        .filter(|(_, range)| range.1 >= least - GUARD_MM)
        .map(|(&n, _)| n)
        .collect()
}

/// Return the largest distance of a point of a cell from its middle, mm; a brick has `per_brick` cells on each axis.
fn half_of_block_mm(bricks: &impl Bricks, per_brick: usize) -> f64 {
    let origin = bricks.to_lps([0.0; 3]);
    (0..4u32)
        .map(|n| {
            let corner: [f64; 3] = std::array::from_fn(|a| {
                let sign = if a > 0 && n >> (a - 1) & 1 == 1 {
                    -1.0
                } else {
                    1.0
                };
                sign * 0.5 / per_brick as f64
            });
            distance(bricks.to_lps(corner), origin)
        })
        .fold(0.0, f64::max)
}

/// Return the first and last brick on each axis within a margin of a part; `None` if the part is outside the lattice.
fn bricks_near(part: &Part, margin: f64, bricks: &impl Bricks) -> Option<[(usize, usize); 3]> {
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
        let at = bricks.position_in_bricks(p);
        for a in 0..3 {
            low[a] = low[a].min(at[a]);
            high[a] = high[a].max(at[a]);
        }
    }
    let num = bricks.num();
    let mut found = [(0, 0); 3];
    for a in 0..3 {
        if !(high[a] >= 0.0 && low[a] <= num[a] as f64) {
            return None;
        }
        let last = num[a] - 1;
        found[a] = (
            (low[a].max(0.0) as usize).min(last),
            (high[a] as usize).min(last),
        );
    }
    Some(found)
}
