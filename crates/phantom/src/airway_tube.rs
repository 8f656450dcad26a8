//! Tube in the trachea that keeps the airway open, either through the larynx or through the front of the neck.

use carina_grid::{cross, dot, length};

use crate::airways::AirwayTree;
use crate::neck::Neck;
use crate::random::Random;
use crate::shapes::{Piece, SIGMA_MM, along, cover, direction, hermite, mix, sub};

/// Route by which a tube enters the trachea.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum TubeKind {
    /// Through the mouth and the larynx.
    Endotracheal,
    /// Through a stoma in the front of the neck.
    Tracheostomy,
}

/// Ground truth of a tube in the trachea.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TubeTruth {
    /// Route on which the tube enters the trachea.
    pub kind: TubeKind,
    /// Centre of the tube's open end in the trachea, LPS mm.
    pub tip_lps: [f64; 3],
    /// Distance from the tube's end to the carina along the trachea's centreline, mm.
    pub above_carina_mm: f64,
    /// Radius of the tube's outer surface, mm.
    pub outer_mm: f64,
    /// Radius of the tube's inner surface, mm.
    pub inner_mm: f64,
}

/// Geometry of a tube from which the values of voxels are computed.
#[derive(Debug, Clone)]
pub(crate) struct AirwayTube {
    pub(crate) truth: TubeTruth,
    pub(crate) pieces: Vec<Piece>,
    wall_hu: f64,
    /// Lowest and highest height z of the fluid that is on the cuff round the tube, mm.
    fluid_z: [f64; 2],
}

/// Distance from the tube's end to its cuff, and length of the cuff, mm.
const CUFF_MM: [f64; 2] = [16.0, 24.0];
/// Minimum and largest height of the column of fluid on the cuff, mm.
const FLUID_MM: [f64; 2] = [5.0, 12.0];
/// CT value of the radio-opaque line in the tube's wall, HU.
const LINE_HU: f64 = 1500.0;
/// Half of the width of the radio-opaque line in the tube's wall, mm.
const HALF_LINE_MM: f64 = 0.6;
/// CT value of the fluid on the cuff, HU.
const FLUID_HU: f64 = 12.0;

impl AirwayTube {
    pub(crate) fn new(
        kind: TubeKind,
        seed: u64,
        tree: &AirwayTree,
        neck: Option<&Neck>,
        chest_skin: impl Fn(f64) -> [f64; 3],
    ) -> Self {
        let mut random = Random::new(seed, 9);
        let trachea = &tree.branches[0].points;
        let outer_mm = random.range(4.6, 5.6);
        let inner_mm = outer_mm - random.range(1.1, 1.5);
        let wanted = match kind {
            // The cuff and the fluid on it must be below the cricoid.
            TubeKind::Endotracheal => {
                let most = trachea[0][2] - CUFF_MM[0] - CUFF_MM[1] - FLUID_MM[1] - 4.0;
                random.range(22.0, 58.0f64.min(most))
            }
            TubeKind::Tracheostomy => random.range(30.0, 55.0),
        };
        // The end of the tube is searched from the carina upwards.
        let mut above_carina_mm = 0.0;
        let mut tip = trachea.len() - 1;
        while tip > 1 && above_carina_mm < wanted {
            above_carina_mm += length(sub(trachea[tip], trachea[tip - 1]));
            tip -= 1;
        }
        // The tube touches the front or the back wall of the trachea instead of being in its middle.
        let lean = random.range(-1.6, 2.2);
        let moved = |p: [f64; 3]| [p[0], p[1] + lean, p[2]];
        let mut points: Vec<[f64; 3]> = Vec::new();
        if let (TubeKind::Tracheostomy, Some(neck)) = (kind, neck) {
            let stoma_z = neck.cricoid_lps[2] - random.range(8.0, 15.0);
            // The bend begins below the stoma.
            let bend_z = stoma_z - 14.0;
            points.extend(
                trachea[1..=tip]
                    .iter()
                    .rev()
                    .filter(|p| p[2] < bend_z)
                    .map(|&p| moved(p)),
            );
            let from = points
                .last()
                .copied()
                .unwrap_or_else(|| moved(trachea[tip]));
            let skin = neck.front_y(stoma_z, chest_skin(stoma_z));
            let out = [from[0], skin - 14.0, stoma_z + 4.0];
            let reach = length(sub(out, from));
            let leave = direction(match points.len() {
                0 | 1 => [0.0, -0.1, 1.0],
                n => sub(points[n - 1], points[n - 2]),
            })
            .map(|v| v * 0.9 * reach);
            let arrive = [0.0, -1.3 * reach, 0.0];
            let num = (reach / 1.5).ceil() as usize;
            points.extend(
                (1..=num).map(|n| hermite(from, leave, out, arrive, n as f64 / num as f64)),
            );
        } else {
            points.extend(trachea[..=tip].iter().rev().map(|&p| moved(p)));
            if let Some(neck) = neck {
                // The displacement from the middle decreases to 0 within a few points, up to the path through the
                // larynx.
                let way = neck.way_up();
                points.truncate(points.len().saturating_sub(6));
                points.extend_from_slice(&way[2..]);
            } else {
                let last = points[points.len() - 1];
                points.push(along(
                    last,
                    40.0,
                    direction(sub(last, points[points.len() - 2])),
                ));
            }
        }
        let tip_lps = points[0];
        let cuff = tip_lps[2] + CUFF_MM[0] + CUFF_MM[1];
        let fluid = random.range(FLUID_MM[0], FLUID_MM[1]);
        let pieces = points
            .windows(2)
            .map(|w| Piece {
                start: w[0],
                end: w[1],
                start_radius: outer_mm,
                end_radius: outer_mm,
            })
            .collect();
        let fluid_z = match kind {
            TubeKind::Endotracheal => [cuff, cuff + fluid],
            TubeKind::Tracheostomy => [f64::INFINITY; 2],
        };
        Self {
            truth: TubeTruth {
                kind,
                tip_lps,
                above_carina_mm,
                outer_mm,
                inner_mm,
            },
            pieces,
            wall_hu: random.range(150.0, 300.0),
            fluid_z,
        }
    }

    /// Return whether there is fluid round the tube at a height.
    fn has_fluid(&self, z: f64) -> bool {
        (self.fluid_z[0]..self.fluid_z[1]).contains(&z)
    }

    /// Return the value of a voxel with the tube: air in the tube, its wall, fluid round it on the cuff.
    ///
    /// `hu` is the value without the tube.
    pub(crate) fn lay_over(
        &self,
        hu: f64,
        p: [f64; 3],
        near: &[u32],
        offsets: &[[f64; 3]],
        to_lumen: f64,
    ) -> f64 {
        let mut hu = hu;
        if self.has_fluid(p[2]) {
            hu = mix(hu, FLUID_HU, cover(to_lumen, SIGMA_MM));
        }
        if near.is_empty() {
            return hu;
        }
        let each = 1.0 / offsets.len() as f64;
        let (mut outside, mut own) = (0.0, 0.0);
        for o in offsets {
            let Some((away, wall_hu)) = self.at(std::array::from_fn(|a| p[a] + o[a]), near) else {
                outside += each;
                continue;
            };
            let outer = cover(away - self.truth.outer_mm, SIGMA_MM);
            let inner = cover(away - self.truth.inner_mm, SIGMA_MM);
            outside += each * (1.0 - outer);
            own += each * ((outer - inner) * wall_hu - 1000.0 * inner);
        }
        hu * outside + own
    }

    /// Return the distance from the tube's axis to a point, and the HU of the tube's wall there.
    ///
    /// The tube ends flat at its tip. The result is `None` beyond the ends of the tube.
    fn at(&self, p: [f64; 3], near: &[u32]) -> Option<(f64, f64)> {
        let mut best: Option<(f64, u32)> = None;
        for &n in near {
            let (away, _) = self.pieces[n as usize].axis_distance(p);
            if best.is_none_or(|(least, _)| away < least) {
                best = Some((away, n));
            }
        }
        let (away, n) = best?;
        let piece = &self.pieces[n as usize];
        let axis = direction(sub(piece.end, piece.start));
        let before = n == 0 && dot(sub(p, piece.start), axis) < 0.0;
        let behind = n as usize + 1 == self.pieces.len() && dot(sub(p, piece.end), axis) > 0.0;
        // The tube is open at both ends.
        if before || behind {
            return None;
        }
        // The radio-opaque line runs along the tube's front.
        let front = direction(cross([1.0, 0.0, 0.0], axis));
        let from = sub(p, piece.start);
        let off = along(from, -dot(from, axis), axis);
        let across = along(off, -dot(off, front), front);
        let is_line = dot(off, front) > 0.0 && length(across) < HALF_LINE_MM;
        Some((away, if is_line { LINE_HU } else { self.wall_hu }))
    }
}
