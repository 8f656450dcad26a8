//! Tests of the lumen's graph, wall distances, flood, trachea and branches on drawn airways, on anisotropic oblique
//! grids.

use carina_grid::{Affine, Grid, Ijk, Lps, VolumeView, dot, length};

use crate::find::flood::{FloodLimits, flood};
use crate::find::trachea::{AirLevels, Doubt, find_trachea};
use crate::tree::branches::{self, BranchLimits, find_branches};
use carina_leastcost::Unwatched;
use carina_leastcost::graph::Graph;
use carina_leastcost::lumen::{LumenCost, LumenGraph, WallLevels};
use carina_leastcost::tracker::Tracker;

/// Value levels of the drawn lumen and wall.
const LEVELS: WallLevels = WallLevels {
    core: -900.0,
    wall: -500.0,
    rise: 25.0,
};

/// Return a grid rotated about two axes, with three different spacings, so that swapped axes cannot pass.
fn oblique(shape_zyx: [usize; 3]) -> Grid {
    let (s, c) = (0.25f64.sin(), 0.25f64.cos());
    let (t, d) = (0.1f64.sin(), 0.1f64.cos());
    let x = [c, s * d, s * t].map(|v| v * 0.8);
    let y = [-s, c * d, c * t].map(|v| v * 0.9);
    let z = [0.0, -t, d].map(|v| v * 1.5);
    Grid::new(
        shape_zyx,
        Affine::from_columns(x, y, z, [-30.0, -20.0, -60.0]),
    )
    .unwrap()
}

/// Return the distance in mm of a point from a line segment.
fn off_segment(p: [f64; 3], a: [f64; 3], b: [f64; 3]) -> f64 {
    let d = [0, 1, 2].map(|i| b[i] - a[i]);
    let e = [0, 1, 2].map(|i| p[i] - a[i]);
    let t = (dot(e, d) / dot(d, d)).clamp(0.0, 1.0);
    length([0, 1, 2].map(|i| e[i] - t * d[i]))
}

type Tube = ([f64; 3], [f64; 3], f64);

/// Draw air inside the tubes, a wall of thickness `wall_mm` at 0 HU, and lung of -850 HU around the wall.
///
/// All edges are blurred over one voxel.
fn draw(grid: &Grid, tubes: &[Tube], wall_mm: f64) -> Vec<i16> {
    (0..grid.num_voxels())
        .map(|at| {
            let p = grid.to_lps(Ijk(grid.voxel(at).map(|v| v as f64))).0;
            let depth = tubes
                .iter()
                .map(|(a, b, r)| off_segment(p, *a, *b) - r)
                .fold(f64::INFINITY, f64::min);
            let blur = |edge: f64| ((depth - edge) / 0.9 + 0.5).clamp(0.0, 1.0);
            let inner = -1000.0 + 1000.0 * blur(0.0);
            (inner - 850.0 * blur(wall_mm)) as i16
        })
        .collect()
}

fn lumen_of(values: &[i16]) -> Vec<u8> {
    values.iter().map(|v| u8::from(*v < -500)).collect()
}

#[test]
fn the_wall_distance_in_the_middle_of_a_tube_equals_its_radius() {
    let grid = oblique([40, 40, 44]);
    let middle = grid.to_lps(Ijk([22.0, 20.0, 20.0])).0;
    let far = |sign: f64| [0, 1, 2].map(|i| middle[i] + sign * [8.0, 5.0, 60.0][i]);
    let tubes = [(far(-1.0), far(1.0), 5.0)];
    let values = draw(&grid, &tubes, 50.0);
    let view = VolumeView::new(&values, &grid).unwrap();
    let graph = LumenGraph::build(view, &lumen_of(&values), Some(LEVELS)).unwrap();
    let mut worst: f64 = 0.0;
    for node in 0..graph.num_nodes() as u32 {
        let voxel = graph.voxel(node);
        // Voxels near the volume's faces are left out, because the wall is cut off there.
        if !(6..34).contains(&voxel[2]) {
            continue;
        }
        let p = grid.to_lps(Ijk(voxel.map(|v| v as f64))).0;
        let truth = 5.0 - off_segment(p, tubes[0].0, tubes[0].1);
        worst = worst.max((graph.wall_mm(node) - truth).abs());
    }
    // The tolerance is 0.4 mm: crossings are found on grid edges only, 0.8 to 1.5 mm apart; whole voxels would have an
    // error of 0.75 mm.
    assert!(worst < 0.4, "{worst}");
}

#[test]
fn a_diagonal_step_across_a_wall_has_no_edge() {
    let grid = oblique([3, 6, 6]);
    let mut values = vec![0i16; grid.num_voxels()];
    let (a, b, c) = ([2, 2, 1], [3, 3, 1], [2, 3, 1]);
    for voxel in [a, b] {
        values[grid.index(voxel)] = -1000;
    }
    let edges = |values: &[i16]| {
        let view = VolumeView::new(values, &grid).unwrap();
        let graph = LumenGraph::build(view, &lumen_of(values), Some(LEVELS)).unwrap();
        let mut count = 0;
        graph.for_each_edge(0, |_, _| count += 1);
        count
    };
    // Only the corners touch, with tissue between them.
    assert_eq!(edges(&values), 0);
    // With one corner open, the middle of the step is still -750 HU, which is not certainly air.
    values[grid.index(c)] = -1000;
    assert_eq!(edges(&values), 1, "the face neighbour only");
    // With both corners open, the middle of the step is certainly air.
    values[grid.index([3, 2, 1])] = -1000;
    assert_eq!(edges(&values), 3);
}

#[test]
fn a_path_stays_in_the_middle_of_the_lumen_and_its_cost_is_finite() {
    let grid = oblique([50, 40, 44]);
    let middle = grid.to_lps(Ijk([22.0, 20.0, 25.0])).0;
    let far = |sign: f64| [0, 1, 2].map(|i| middle[i] + sign * [6.0, -4.0, 30.0][i]);
    let tubes = [(far(-1.0), far(1.0), 5.0)];
    let values = draw(&grid, &tubes, 3.0);
    let view = VolumeView::new(&values, &grid).unwrap();
    // Use the drawn lumen instead of a threshold, because lung outside the wall is dark as well.
    let lumen: Vec<u8> = (0..grid.num_voxels())
        .map(|at| {
            let p = grid.to_lps(Ijk(grid.voxel(at).map(|v| v as f64))).0;
            u8::from(off_segment(p, far(-1.0), far(1.0)) < 5.0)
        })
        .collect();
    let graph = LumenGraph::build(view, &lumen, Some(LEVELS)).unwrap();
    let node = |p: [f64; 3]| {
        graph
            .nearest_node(&grid, grid.to_ijk(Lps(p)).0, 5.0)
            .unwrap()
            .0
    };
    let (root, target) = (node(far(0.8)), node(far(-0.8)));
    let cost = LumenCost(&graph);
    let mut tracker = Tracker::new(&graph, &cost, root).unwrap();
    assert!(tracker.solve_to(&graph, &cost, target, &Unwatched).unwrap());
    for node in tracker.path_to(target).unwrap() {
        let p = grid.to_lps(Ijk(graph.voxel(node).map(|v| v as f64))).0;
        // The tolerance is the in-plane diagonal of one voxel.
        assert!(off_segment(p, far(-1.0), far(1.0)) < 1.21);
    }
}

/// Return the tubes of a trachea that divides into two bronchi, each of which divides again, at positions on a grid.
fn airway(grid: &Grid) -> Vec<Tube> {
    let centre = grid
        .to_lps(Ijk(grid.shape_ijk().map(|n| (n as f64 - 1.0) / 2.0)))
        .0;
    let at = |x: f64, y: f64, z: f64| [centre[0] + x, centre[1] + y, centre[2] + z];
    vec![
        (at(0.0, 2.0, 60.0), at(0.0, 0.0, 5.0), 6.5),
        (at(0.0, 0.0, 5.0), at(-18.0, 1.0, -14.0), 5.0),
        (at(0.0, 0.0, 5.0), at(19.0, -1.0, -16.0), 4.6),
        (at(-18.0, 1.0, -14.0), at(-27.0, 4.0, -34.0), 3.2),
        (at(-18.0, 1.0, -14.0), at(-17.0, -8.0, -36.0), 3.0),
        (at(19.0, -1.0, -16.0), at(28.0, 3.0, -35.0), 3.0),
        (at(19.0, -1.0, -16.0), at(17.0, -9.0, -37.0), 2.8),
    ]
}

/// Draw neck and mediastinum of soft tissue, two lungs at -880 HU, air outside the body, and the walled airway `tubes`.
fn chest(grid: &Grid, tubes: &[Tube]) -> Vec<i16> {
    let centre = grid
        .to_lps(Ijk(grid.shape_ijk().map(|n| (n as f64 - 1.0) / 2.0)))
        .0;
    (0..grid.num_voxels())
        .map(|at| {
            let p = grid.to_lps(Ijk(grid.voxel(at).map(|v| v as f64))).0;
            let q = [0, 1, 2].map(|i| p[i] - centre[i]);
            let depth = tubes
                .iter()
                .map(|(a, b, r)| off_segment(p, *a, *b) - r)
                .fold(f64::INFINITY, f64::min);
            let lung = |x: f64| {
                ((q[0] - x) / 24.0).powi(2) + (q[1] / 26.0).powi(2) + ((q[2] + 14.0) / 38.0).powi(2)
                    < 1.0
            };
            let body = (q[0] / 58.0).powi(2) + (q[1] / 36.0).powi(2) < 1.0;
            // Pseudo-random noise of up to 25 HU, computed from the voxel's index.
            let noise = ((at.wrapping_mul(2_654_435_761) >> 7) % 51) as f64 - 25.0;
            let around = if depth < 1.6 {
                0.0
            } else if lung(-30.0) || lung(30.0) {
                -880.0
            } else if body {
                30.0
            } else {
                -1000.0
            };
            let air = (0.5 - depth / 0.9).clamp(0.0, 1.0);
            (air * -1000.0 + (1.0 - air) * around + noise) as i16
        })
        .collect()
}

fn chest_grid(flips: [bool; 3]) -> Grid {
    let grid = oblique([92, 88, 150]);
    // A flip reverses an axis and moves the first voxel to its other end: the same positions in reverse storage order.
    let mut columns = [0, 1, 2].map(|a| grid.lps_from_ijk().column(a));
    let mut origin = grid.lps_from_ijk().column(3);
    for axis in 0..3 {
        if flips[axis] {
            let n = grid.shape_ijk()[axis] as f64 - 1.0;
            origin = [0, 1, 2].map(|i| origin[i] + n * columns[axis][i]);
            columns[axis] = columns[axis].map(|v| -v);
        }
    }
    Grid::new(
        grid.shape_zyx(),
        Affine::from_columns(columns[0], columns[1], columns[2], origin),
    )
    .unwrap()
}

/// Value levels of air, lung and tissue in the drawn chest.
const AIR: AirLevels = AirLevels {
    air: -800,
    tissue: -450,
    lung: Some((-950, -600)),
};

/// Limits with which the search runs in these tests.
const LIMITS: FloodLimits = FloodLimits {
    first_level: -1020,
    core_level: -950,
    last_level: -600,
    leak_mm3: 30_000.0,
    small_leak_mm3: 3_000.0,
    closed_radius_mm: 8.0,
    min_contrast: 60.0,
};

#[test]
fn the_trachea_is_found_for_every_axis_order_and_flip_of_the_grid() {
    for flips in [
        [false; 3],
        [true, false, false],
        [false, true, true],
        [true; 3],
    ] {
        let grid = chest_grid(flips);
        let tubes = airway(&grid);
        let values = chest(&grid, &tubes);
        let view = VolumeView::new(&values, &grid).unwrap();
        let found = find_trachea(view, AIR, &Unwatched).unwrap();
        let top = grid.to_lps(Ijk(found.voxels[0].map(|v| v as f64))).0;
        let bottom = grid
            .to_lps(Ijk(found.voxels[found.voxels.len() - 1].map(|v| v as f64)))
            .0;
        assert!(top[2] > bottom[2] + 25.0, "{flips:?} {top:?} {bottom:?}");
        // The slices are tilted, so the highest spot is a part of the rounded top.
        let off = off_segment(top, tubes[0].0, tubes[0].1);
        assert!(off < 5.0, "{off}");
        // The division is found in slices of 1.5 mm, up to one diameter below the intersection of the tubes' axes.
        let off = length([0, 1, 2].map(|i| found.carina_lps[i] - tubes[0].1[i]));
        assert!(off < 16.0, "{off}");
        let middle = found.diameters_mm[found.diameters_mm.len() / 2];
        assert!((middle - 13.0).abs() < 2.0, "{middle}");
    }
}

#[test]
fn a_tube_that_divides_without_lungs_beside_it_is_rejected_as_trachea() {
    // The same tubes without lungs around them look like bowel in an abdomen.
    let grid = chest_grid([false; 3]);
    let tubes = airway(&grid);
    let mut values = chest(&grid, &tubes);
    for value in &mut values {
        if (-960..-700).contains(value) {
            *value = 30;
        }
    }
    let view = VolumeView::new(&values, &grid).unwrap();
    assert!(find_trachea(view, AIR, &Unwatched).is_err());
    let without = AirLevels { lung: None, ..AIR };
    assert!(find_trachea(view, without, &Unwatched).is_ok());
}

#[test]
fn a_trachea_without_bronchi_is_rejected_and_one_with_a_single_bronchus_has_a_doubt() {
    let grid = chest_grid([false; 3]);
    let found = |num_tubes: usize| {
        let values = chest(&grid, &airway(&grid)[..num_tubes]);
        let view = VolumeView::new(&values, &grid).unwrap();
        find_trachea(view, AIR, &Unwatched)
    };
    assert_eq!(found(1).unwrap_err().code(), "track.no-result");
    let one = found(2).unwrap();
    assert_eq!(one.doubts, [Doubt::OneBronchus]);
    let both = found(7).unwrap();
    assert_eq!(both.doubts, []);
    assert_eq!(one.voxels[0], both.voxels[0]);
}

#[test]
fn a_narrow_bronchus_or_a_collapsed_lung_adds_a_doubt_to_an_equal_trachea() {
    let grid = chest_grid([false, true, false]);
    let whole = airway(&grid);
    let find = |values: &[i16]| {
        let view = VolumeView::new(values, &grid).unwrap();
        find_trachea(view, AIR, &Unwatched).unwrap()
    };
    let healthy = find(&chest(&grid, &whole));
    let mut narrowed = whole[..3].to_vec();
    narrowed[2].2 = 2.1;
    let narrow = find(&chest(&grid, &narrowed));
    assert_eq!(narrow.doubts, [Doubt::NarrowBronchus]);
    assert_eq!(narrow.voxels[0], healthy.voxels[0]);
    // Replace the air of the left lung (+x) with soft tissue, as in a collapsed lung.
    let mut collapsed = chest(&grid, &whole);
    for (at, value) in collapsed.iter_mut().enumerate() {
        let x = grid.to_lps(Ijk(grid.voxel(at).map(|v| v as f64))).0[0];
        if (-960..-700).contains(value) && x > whole[0].1[0] {
            *value = 30;
        }
    }
    let one_lung = find(&collapsed);
    assert_eq!(one_lung.doubts, [Doubt::OneLung]);
    assert_eq!(one_lung.voxels[0], healthy.voxels[0]);
}

#[test]
fn a_main_bronchus_is_rejected_as_trachea_if_the_volume_begins_below_the_carina() {
    let grid = chest_grid([false; 3]);
    let centre = airway(&grid)[0].1;
    let at = |x: f64, y: f64, z: f64| [centre[0] + x, centre[1] + y, centre[2] + z];
    // Each tube is long and divides between the lungs; only the other tube beside it shows that it is a main bronchus.
    let side = |s: f64| {
        let fork = at(18.0 * s, 0.0, -5.0);
        [
            (at(15.0 * s, 0.0, 45.0), fork, 5.0),
            (fork, at(32.0 * s, 3.0, -30.0), 3.4),
            (fork, at(6.0 * s, -3.0, -30.0), 3.4),
        ]
    };
    let find = |tubes: &[Tube]| {
        let values = chest(&grid, tubes);
        let view = VolumeView::new(&values, &grid).unwrap();
        find_trachea(view, AIR, &Unwatched)
    };
    assert!(find(&side(-1.0)).is_ok(), "alone it would pass");
    let both = [side(-1.0), side(1.0)].concat();
    let error = find(&both).unwrap_err();
    assert!(error.to_string().contains("beside"), "{error}");
}

#[test]
fn the_flood_does_not_enter_the_lung_through_a_hole_in_the_wall() {
    let grid = chest_grid([false; 3]);
    let tubes = airway(&grid);
    let mut values = chest(&grid, &tubes);
    // The breach in the wall is a channel of lung density from the right main bronchus to the lung.
    let from = [0, 1, 2].map(|i| 0.5 * (tubes[1].0[i] + tubes[1].1[i]));
    let to = [from[0] - 16.0, from[1] - 6.0, from[2] - 2.0];
    let depth = |p: [f64; 3]| {
        tubes
            .iter()
            .map(|(a, b, r)| off_segment(p, *a, *b) - r)
            .fold(f64::INFINITY, f64::min)
    };
    for at in 0..values.len() {
        let p = grid.to_lps(Ijk(grid.voxel(at).map(|v| v as f64))).0;
        if off_segment(p, from, to) < 1.5 && depth(p) > 0.0 {
            values[at] = -870;
        }
    }
    let view = VolumeView::new(&values, &grid).unwrap();
    let seeds = find_trachea(view, AIR, &Unwatched).unwrap().voxels;
    let found = flood(view, &seeds, &LIMITS, &Unwatched).unwrap();
    assert!(!found.leaks.is_empty(), "the breach must be met");
    let (mut outside, mut inside, mut missed) = (0, 0, 0);
    for at in 0..values.len() {
        let p = grid.to_lps(Ijk(grid.voxel(at).map(|v| v as f64))).0;
        let d = depth(p);
        if found.lumen[at] == 1 && d > 2.0 {
            outside += 1;
        }
        if d < -1.0 {
            inside += 1;
            missed += usize::from(found.lumen[at] == 0);
        }
    }
    assert_eq!(outside, 0);
    assert_eq!(missed, 0, "of {inside}");
}

#[test]
fn the_tree_has_the_drawn_branches_and_children_begin_where_their_parent_ends() {
    let grid = chest_grid([false, true, false]);
    let tubes = airway(&grid);
    let values = chest(&grid, &tubes);
    let view = VolumeView::new(&values, &grid).unwrap();
    let seeds = find_trachea(view, AIR, &Unwatched).unwrap().voxels;
    let found = flood(view, &seeds, &LIMITS, &Unwatched).unwrap();
    let graph = LumenGraph::build(view, &found.lumen, Some(LEVELS)).unwrap();
    let (root, _) = graph
        .nearest_node(&grid, seeds[0].map(|v| v as f64), 3.0)
        .unwrap();
    let cost = LumenCost(&graph);
    let mut tracker = Tracker::new(&graph, &cost, root).unwrap();
    tracker.solve_all(&graph, &cost, &Unwatched).unwrap();
    let limits = BranchLimits::for_grid(&grid);
    let branches = find_branches(&graph, &tracker, &grid, &limits, &Unwatched).unwrap();
    let generations: Vec<u32> = branches.iter().map(|b| b.generation).collect();
    assert_eq!(branches.len(), 7, "{generations:?}");
    for generation in 0..3 {
        let count = generations.iter().filter(|g| **g == generation).count();
        assert_eq!(count, 1 << generation);
    }
    for branch in &branches {
        if let Some(parent) = branch.parent {
            let last = branches[parent].points[branches[parent].points.len() - 1];
            assert_eq!(branch.points[0].map(f64::to_bits), last.map(f64::to_bits));
        }
        assert_eq!(branch.points.len(), branch.radius_mm.len());
        for p in &branch.points {
            assert!(graph.holds(grid.to_ijk(Lps(*p)).0), "{p:?}");
        }
        // The radius in the middle is that of a drawn tube, within half a voxel's diagonal.
        let middle = branch.points[branch.points.len() / 2];
        let tube = tubes
            .iter()
            .min_by(|a, b| off_segment(middle, a.0, a.1).total_cmp(&off_segment(middle, b.0, b.1)))
            .unwrap();
        let radius = branch.radius_mm[branch.points.len() / 2];
        let off = off_segment(middle, tube.0, tube.1);
        assert!(off < 1.5, "{off}");
        // The tolerance of 0.8 mm is half a voxel along the axis.
        let free = radius + off;
        assert!((free - tube.2).abs() < 0.8, "{radius} {off} {}", tube.2);
    }
    // Every lumen voxel belongs to a branch, and those near a tip to that tip's branch.
    let of_node = branches::branch_of_nodes(&graph, &branches);
    assert!(of_node.iter().all(|b| (*b as usize) < branches.len()));
    for (b, branch) in branches.iter().enumerate() {
        let tip = branch.nodes[branch.nodes.len() - 1];
        assert_eq!(of_node[tip as usize] as usize, b);
    }
    // The tree to two tips on the right has the airway's forks: trachea, right bronchus, and the two tips.
    let tips: Vec<u32> = branches
        .iter()
        .filter(|b| b.generation == 2 && b.points[0][0] < tubes[0].1[0])
        .map(|b| b.nodes[b.nodes.len() - 1])
        .collect();
    assert_eq!(tips.len(), 2);
    let part = branches::branches_to(&graph, &tracker, &grid, &limits, &tips, &branches);
    let generations: Vec<u32> = part.iter().map(|b| b.generation).collect();
    assert_eq!(generations.iter().max(), Some(&2), "{generations:?}");
    assert_eq!(part.len(), 4, "{generations:?}");
    // The nodes of an edited tree's branches are found along their centrelines, so nodes may repeat; repeated nodes
    // must not form a cycle.
    let mut wavering = branches.clone();
    for branch in &mut wavering {
        let middle = branch.nodes.len() / 2;
        if middle > 0 {
            let back = [branch.nodes[middle - 1], branch.nodes[middle]];
            branch
                .nodes
                .splice(middle..=middle, [back[1], back[0], back[1]]);
        }
    }
    let same = branches::branches_to(&graph, &tracker, &grid, &limits, &tips, &wavering);
    assert_eq!(same, part);
}

#[test]
fn the_nearest_lumen_voxel_equals_that_of_an_exhaustive_search() {
    let grid = oblique([20, 24, 70]);
    let mut state = 7u64;
    let mut noise = || {
        state = state
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        (state >> 40) as f64 / (1u64 << 24) as f64
    };
    let lumen: Vec<u8> = (0..grid.num_voxels())
        .map(|_| u8::from(noise() < 0.004))
        .collect();
    let values = vec![-1000i16; grid.num_voxels()];
    let view = VolumeView::new(&values, &grid).unwrap();
    let graph = LumenGraph::build(view, &lumen, None).unwrap();
    let shape = grid.shape_ijk();
    for at in 0..400 {
        // Positions inside the volume, outside, and on the corners of voxels, where several voxels are equally near.
        let mut ijk: [f64; 3] = std::array::from_fn(|a| (1.6 * noise() - 0.3) * shape[a] as f64);
        if at % 2 == 0 {
            ijk = ijk.map(|v| v.floor() + 0.5);
        }
        for reach_mm in [2.0, 9.0, 60.0] {
            let mut expected: Option<(u32, f64)> = None;
            for node in 0..graph.num_nodes() as u32 {
                let voxel = graph.voxel(node);
                let off = std::array::from_fn(|a| voxel[a] as f64 - ijk[a]);
                let distance = length(grid.lps_from_ijk().vector(off));
                if distance <= reach_mm && expected.is_none_or(|(_, least)| distance < least) {
                    expected = Some((node, distance));
                }
            }
            assert_eq!(graph.nearest_node(&grid, ijk, reach_mm), expected);
        }
    }
}
