//! Vessels of the phantom's lungs: arteries beside the bronchi, smaller arteries beyond them, veins between.
//!
//! Vessels give a lung a realistic appearance, with bright tubes beside the dark airways, which an airway search must
//! distinguish. They are not part of the ground truth.

use carina_grid::{dot, length};

use crate::airways::AirwayTree;
use crate::body::lung_distance;
use crate::random::Random;
use crate::shapes::{Piece, along, direction, hermite, mix, normals, sub, tilted};

/// Open end of a vessel during the construction of the phantom, from which further vessels may grow.
struct End {
    at: [f64; 3],
    dir: [f64; 3],
    radius: f64,
    depth: usize,
}

/// Radius in mm below which vessels are not drawn, because they are part of the lung's texture.
const THINNEST_MM: f64 = 0.5;

/// Return the pieces (straight tubes) of all vessels of the lungs.
pub(crate) fn vessels(seed: u64, tree: &AirwayTree) -> Vec<Piece> {
    let mut pieces = Vec::new();
    let mut ends = arteries(tree, &mut pieces);
    ends.extend(veins(tree, &mut Random::new(seed, 4), &mut pieces));
    divide(ends, &mut Random::new(seed, 3), &mut pieces);
    pieces
}

/// Add one artery along each bronchus from the lobar bronchi on, whose wall touches that of the bronchus.
///
/// Return the ends of the arteries.
fn arteries(tree: &AirwayTree, pieces: &mut Vec<Piece>) -> Vec<End> {
    // Direction from the bronchus to the artery at the end of each branch, transported along the branches without
    // twist.
    let mut offsets: Vec<[f64; 3]> = vec![[0.0; 3]; tree.branches.len()];
    let mut ends = Vec::new();
    for branch in &tree.branches {
        if branch.generation < 2 {
            continue;
        }
        let parent = branch.parent.unwrap_or(0);
        let before = offsets[parent];
        let dir = branch.tip_direction();
        // On the right the artery enters in front of and lateral to the bronchi, on the left above them; further out
        // the artery stays on that side.
        let wanted = if length(before) > 0.0 {
            before
        } else if branch.points[0][0] < 0.0 {
            [-0.6, -0.7, 0.3]
        } else {
            [0.5, 0.2, 0.8]
        };
        let across = along(wanted, -dot(wanted, dir), dir);
        let side = if length(across) > 0.2 * length(wanted) {
            direction(across)
        } else {
            normals(dir).0
        };
        let radius = 0.85 * branch.tip_radius() + 0.25 * branch.wall_mm;
        let apart = branch.tip_radius() + branch.wall_mm + radius + 0.2;
        let after = side.map(|v| v * apart);
        offsets[branch.id] = after;
        let start_radius = 0.85 * branch.radius_mm[0] + 0.25 * branch.wall_mm;
        let num = ((branch.length_mm() / 2.5).ceil() as usize).max(3);
        let place = |i: usize| {
            let t = i as f64 / num as f64;
            let ease = t * t * (3.0 - 2.0 * t);
            let (p, _) = tree.place(branch.id, t);
            // The children of the carina start on the bronchus itself, and so do the first arteries.
            std::array::from_fn(|a| p[a] + mix(before[a], after[a], ease))
        };
        for i in 0..num {
            let t = |i: usize| i as f64 / num as f64;
            pieces.push(Piece {
                start: place(i),
                end: place(i + 1),
                start_radius: mix(start_radius, radius, t(i)),
                end_radius: mix(start_radius, radius, t(i + 1)),
            });
        }
        if branch.children.is_empty() {
            ends.push(End {
                at: place(num),
                dir,
                radius: radius * 0.95,
                depth: 0,
            });
        }
    }
    ends
}

/// Add veins from the left atrium to the positions between the segments, and return their ends.
fn veins(tree: &AirwayTree, random: &mut Random, pieces: &mut Vec<Piece>) -> Vec<End> {
    let mut ends = Vec::new();
    for branch in &tree.branches {
        let Some(name) = branch.name else { continue };
        let segment = (name.starts_with("RB") || name.starts_with("LB"))
            && branch
                .children
                .iter()
                .all(|&c| tree.branches[c].name.is_none());
        if !segment {
            continue;
        }
        let right = name.starts_with('R');
        let upper = branch.tip()[2] > -48.0 || branch.tip()[1] < -22.0;
        let root = match (right, upper) {
            (true, true) => [-27.0, -12.0, -48.0],
            (true, false) => [-25.0, 10.0, -66.0],
            (false, true) => [34.0, -14.0, -48.0],
            (false, false) => [34.0, 10.0, -64.0],
        };
        let out = branch.tip_direction();
        let (across, up) = normals(out);
        let aside = tilted(
            out,
            across,
            up,
            random.range(0.0, core::f64::consts::TAU),
            0.5 * core::f64::consts::PI,
        );
        let far = along(along(branch.tip(), 12.0, out), 11.0, aside);
        let reach = length(sub(far, root));
        let leave = direction([if right { -1.0 } else { 1.0 }, 0.0, out[2]]).map(|v| v * reach);
        let arrive = out.map(|v| v * reach * 0.8);
        let num = (reach / 4.0).ceil() as usize;
        let radius = |t: f64| mix(4.6, 2.0, t.sqrt());
        let place = |t: f64| hermite(root, leave, far, arrive, t);
        for i in 0..num {
            let (s, e) = (i as f64 / num as f64, (i + 1) as f64 / num as f64);
            pieces.push(Piece {
                start: place(s),
                end: place(e),
                start_radius: radius(s),
                end_radius: radius(e),
            });
            // Small side branches along the vein.
            if i % 4 == 3 && s > 0.45 {
                let dir = direction(sub(place(e), place(s)));
                ends.push(End {
                    at: place(e),
                    dir: random.near(dir, 1.1),
                    radius: 0.6 * radius(e),
                    depth: 1,
                });
            }
        }
        ends.push(End {
            at: far,
            dir: out,
            radius: 1.9,
            depth: 0,
        });
    }
    ends
}

/// Divide vessels at their ends repeatedly, until they are too thin or reach the pleura.
fn divide(mut ends: Vec<End>, random: &mut Random, pieces: &mut Vec<Piece>) {
    while let Some(end) = ends.pop() {
        if end.radius < THINNEST_MM || end.depth > 7 {
            continue;
        }
        let (across, up) = normals(end.dir);
        let turn = random.range(0.0, core::f64::consts::TAU);
        for side in [0.0, core::f64::consts::PI] {
            let radius = end.radius * random.range(0.66, 0.86);
            let dir = tilted(end.dir, across, up, turn + side, random.range(0.3, 0.75));
            let reach = (5.0 * radius + 6.5) * random.range(0.7, 1.3);
            let bend = random.near(dir, 0.5);
            let middle = along(end.at, 0.5 * reach, dir);
            let tip = along(middle, 0.5 * reach, bend);
            if lung_distance(tip) > -2.0 - radius {
                continue;
            }
            let between = 0.5 * (end.radius + radius);
            for (start, stop, start_radius, end_radius) in [
                (end.at, middle, between, radius),
                (middle, tip, radius, 0.95 * radius),
            ] {
                pieces.push(Piece {
                    start,
                    end: stop,
                    start_radius,
                    end_radius,
                });
            }
            ends.push(End {
                at: tip,
                dir: direction(sub(tip, middle)),
                radius: 0.95 * radius,
                depth: end.depth + 1,
            });
        }
    }
}
