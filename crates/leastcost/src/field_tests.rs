//! Contract tests of the tracker over a volume of weights.
//!
//! The results equal those of Dijkstra's algorithm with a heap, resumed searches equal fresh ones, costs are accurate
//! within half a percent, and no path goes through walls or outside regions.

use std::ops::Range;

use carina_grid::{Affine, Grid, InstructionSet};
use proptest::prelude::*;

use crate::field::{EnterCost, MeanCost, Quanta, StepCost, VoxelField, least_costs};
use crate::field_a_star::least_path;
use crate::field_tracker::FieldTracker;
use crate::{TrackError, Unwatched, Watch};

/// Return an oblique grid with a different spacing on every axis.
fn grid(shape_ijk: [usize; 3], spacing: [f64; 3]) -> Grid {
    let (c, s) = (0.35f64.cos(), 0.35f64.sin());
    let matrix = [
        [c * spacing[0], -s * spacing[1], 0.0, 5.0],
        [s * spacing[0], c * spacing[1], 0.0, -7.0],
        [0.0, 0.0, spacing[2], 11.0],
        [0.0, 0.0, 0.0, 1.0],
    ];
    let [nx, ny, nz] = shape_ijk;
    Grid::new([nz, ny, nx], Affine::from_matrix("test", &matrix).unwrap()).unwrap()
}

#[derive(Debug, Clone)]
struct Scene {
    shape_ijk: [usize; 3],
    spacing: [f64; 3],
    values: Vec<f32>,
    mask: Option<Vec<u8>>,
    region: Option<[Range<usize>; 3]>,
    root: [usize; 3],
}

impl Scene {
    fn with<T>(&self, look: impl FnOnce(&VoxelField<'_>) -> T) -> T {
        let grid = grid(self.shape_ijk, self.spacing);
        let field = VoxelField::new(
            &grid,
            &self.values,
            self.region.clone(),
            self.mask.as_deref(),
        )
        .unwrap();
        look(&field)
    }
}

fn weight() -> BoxedStrategy<f32> {
    prop_oneof![
        6 => 0.5f32..60.0,
        2 => (1u8..9).prop_map(f32::from),
        1 => Just(f32::INFINITY),
        1 => Just(f32::NAN),
    ]
    .boxed()
}

fn whole_weight() -> BoxedStrategy<f32> {
    prop_oneof![
        6 => (0u16..300).prop_map(f32::from),
        1 => Just(f32::INFINITY),
    ]
    .boxed()
}

fn scene(weight: BoxedStrategy<f32>) -> impl Strategy<Value = Scene> {
    // Long and thin boxes are included; in some, every row has only border voxels.
    (1usize..12, 1usize..9, 1usize..7).prop_flat_map(move |(nx, ny, nz)| {
        let n = nx * ny * nz;
        let range = |n: usize| {
            (0..n, 0..n).prop_map(move |(a, b)| {
                let (low, high) = (a.min(b), a.max(b));
                low..high + 1
            })
        };
        let region =
            prop::option::of((range(nx), range(ny), range(nz)).prop_map(|(a, b, c)| [a, b, c]));
        let mask = prop::option::of(prop::collection::vec(prop::bool::weighted(0.8), n));
        let spacing = (0.4f64..2.0, 0.4f64..2.0, 0.4f64..3.0);
        (
            prop::collection::vec(weight.clone(), n),
            mask,
            region,
            spacing,
            any::<prop::sample::Index>(),
        )
            .prop_map(move |(mut values, mask, region, spacing, root)| {
                let region_of_root = region.clone().unwrap_or([0..nx, 0..ny, 0..nz]);
                let size: usize = region_of_root.iter().map(ExactSizeIterator::len).product();
                let at = root.index(size);
                let [a, b, _] = region_of_root.each_ref().map(ExactSizeIterator::len);
                let offset = [at % a, at / a % b, at / (a * b)];
                let root: [usize; 3] = std::array::from_fn(|x| region_of_root[x].start + offset[x]);
                let place = (root[2] * ny + root[1]) * nx + root[0];
                values[place] = 1.0;
                let mut mask: Option<Vec<u8>> = mask.map(|m| m.into_iter().map(u8::from).collect());
                if let Some(mask) = &mut mask {
                    mask[place] = 7;
                }
                Scene {
                    shape_ijk: [nx, ny, nz],
                    spacing: spacing.into(),
                    values,
                    mask,
                    region,
                    root,
                }
            })
    })
}

/// Return a strategy for scenes of several sweep tiles on every axis.
///
/// The weights are noise, or a few values (many paths cost the same), with or without walls.
fn wide_scene() -> impl Strategy<Value = Scene> {
    let shape = (14usize..54, 5usize..28, 3usize..26);
    (
        shape,
        any::<u64>(),
        0u8..4,
        prop::bool::ANY,
        any::<prop::sample::Index>(),
    )
        .prop_map(|((nx, ny, nz), seed, kind, masked, root)| {
            let mut state = seed | 1;
            let mut noise = || {
                state = state
                    .wrapping_mul(6_364_136_223_846_793_005)
                    .wrapping_add(1_442_695_040_888_963_407);
                (state >> 40) as f32 / (1u64 << 24) as f32
            };
            let n = nx * ny * nz;
            let mut values: Vec<f32> = (0..n)
                .map(|_| match kind {
                    0 => 1.0 + 40.0 * noise(),
                    1 => 1.0 + (2.0 * noise()).floor(),
                    // A maze: a third of the voxels are wall, half of them with the weight NaN.
                    2 if noise() < 0.35 => [f32::INFINITY, f32::NAN][usize::from(noise() < 0.5)],
                    2 => 1.0 + noise(),
                    // A fifth of the voxels are cheap and form thin paths through expensive tissue.
                    _ if noise() < 0.2 => 1.0,
                    _ => 60.0 + noise(),
                })
                .collect();
            let mut mask =
                masked.then(|| (0..n).map(|_| u8::from(noise() < 0.9)).collect::<Vec<_>>());
            let at = root.index(n);
            values[at] = 1.0;
            if let Some(mask) = &mut mask {
                mask[at] = 1;
            }
            Scene {
                shape_ijk: [nx, ny, nz],
                spacing: [0.7, 0.9, 1.3],
                values,
                mask,
                region: masked.then(|| {
                    let shape = [nx, ny, nz];
                    let root = [at % nx, at / nx % ny, at / (nx * ny)];
                    // The search box lacks one voxel on each axis, but contains the root.
                    std::array::from_fn(|a| usize::from(root[a] > 0)..shape[a])
                }),
                root: [at % nx, at / nx % ny, at / (nx * ny)],
            }
        })
}

/// Check that each node's cost by Dijkstra's algorithm with a heap equals its cost in the tracker and along its path.
fn equals_the_heap<C: StepCost>(
    field: &VoxelField<'_>,
    root: [usize; 3],
) -> Result<(), TestCaseError> {
    let mut tracker = FieldTracker::<C>::new(field, root).unwrap();
    tracker.solve_all(field, &Unwatched).unwrap();
    let truth = least_costs(field, tracker.quanta(), tracker.root());
    prop_assert_eq!(tracker.num_settled(), truth.iter().flatten().count());
    for (node, cost) in truth.iter().enumerate() {
        let node = node as u32;
        prop_assert_eq!(tracker.cost_quanta(field, node), *cost, "node {}", node);
        let Some(path) = tracker.path_to(node) else {
            continue;
        };
        prop_assert_eq!((path[0], path[path.len() - 1]), (tracker.root(), node));
        let mut sum = 0;
        for step in path.windows(2) {
            let mut edge = None;
            field.for_each_step(tracker.quanta(), step[0], |v, quanta| {
                if v == step[1] {
                    edge = Some(quanta);
                }
            });
            prop_assert!(edge.is_some(), "{:?} is no edge", step);
            sum += edge.unwrap();
        }
        prop_assert_eq!(Some(sum), *cost);
    }
    Ok(())
}

/// Check that costs and predecessors are equal for all instruction sets.
fn same_for_every_set<C: StepCost>(
    field: &VoxelField<'_>,
    root: [usize; 3],
) -> Result<(), TestCaseError> {
    let mut first: Option<FieldTracker<C>> = None;
    for simd in InstructionSet::available() {
        let mut tracker = FieldTracker::<C>::new(field, root).unwrap();
        tracker.simd = simd;
        tracker.solve_all(field, &Unwatched).unwrap();
        if let Some(first) = &first {
            for node in 0..field.num_nodes() as u32 {
                prop_assert_eq!(
                    tracker.predecessor(node),
                    first.predecessor(node),
                    "{:?}",
                    simd
                );
            }
            let last = field.num_nodes() as u32 - 1;
            prop_assert_eq!(
                tracker.cost_quanta(field, last),
                first.cost_quanta(field, last)
            );
        } else {
            first = Some(tracker);
        }
    }
    Ok(())
}

fn resumes<C: StepCost>(
    field: &VoxelField<'_>,
    root: [usize; 3],
    targets: &[prop::sample::Index],
) -> Result<(), TestCaseError> {
    let mut whole = FieldTracker::<C>::new(field, root).unwrap();
    whole.solve_all(field, &Unwatched).unwrap();
    let mut resumed = FieldTracker::<C>::new(field, root).unwrap();
    for target in targets {
        let target = target.index(field.num_nodes()) as u32;
        let (before, known) = (resumed.num_settled(), resumed.path_to(target).is_some());
        let reached = resumed.solve_to(field, target, &Unwatched).unwrap();
        prop_assert!(!known || resumed.num_settled() == before);
        prop_assert_eq!(reached, whole.path_to(target).is_some());
        prop_assert_eq!(resumed.path_to(target), whole.path_to(target));
    }
    resumed.solve_all(field, &Unwatched).unwrap();
    for node in 0..field.num_nodes() as u32 {
        prop_assert_eq!(resumed.predecessor(node), whole.predecessor(node));
    }
    Ok(())
}

/// Check that an A* path has the least cost (from the heap) and consists of steps that add up to this cost.
///
/// There must be no path if the heap finds none.
fn aimed_equals_the_heap<C: StepCost>(
    field: &VoxelField<'_>,
    root: [usize; 3],
    targets: &[prop::sample::Index],
) -> Result<(), TestCaseError> {
    let quanta = Quanta::<C>::choose(field).unwrap();
    let from = field.node_at_voxel(root).unwrap();
    let truth = least_costs(field, &quanta, from);
    let mut nodes: Vec<u32> = targets
        .iter()
        .map(|target| target.index(field.num_nodes()) as u32)
        .collect();
    nodes.push(from);
    for target in nodes {
        let found = least_path::<C>(field, root, target, &Unwatched).unwrap();
        prop_assert_eq!(
            found.as_ref().map(|found| found.cost_quanta),
            truth[target as usize]
        );
        let Some(found) = found else { continue };
        let path = &found.nodes;
        prop_assert_eq!((path[0], path[path.len() - 1]), (from, target));
        prop_assert!(found.num_settled >= path.len() && found.num_settled <= quanta.num_open);
        let mut sum = 0;
        for step in path.windows(2) {
            let mut edge = None;
            field.for_each_step(&quanta, step[0], |v, cost| {
                if v == step[1] {
                    edge = Some(cost);
                }
            });
            prop_assert!(edge.is_some(), "{:?} is no edge", step);
            sum += edge.unwrap();
        }
        prop_assert_eq!(sum, found.cost_quanta);
    }
    Ok(())
}

/// Return the cost of a path computed without rounding to quanta.
fn exact<C: StepCost>(field: &VoxelField<'_>, spacing: [f64; 3], path: &[u32]) -> f64 {
    path.windows(2)
        .map(|step| {
            let (a, b) = (field.voxel(step[0]), field.voxel(step[1]));
            let squares = (0..3).map(|x| ((b[x] as f64 - a[x] as f64) * spacing[x]).powi(2));
            let length = squares.sum::<f64>().sqrt();
            f64::from(C::weight(field.value(step[0]), field.value(step[1])))
                * C::factor(length as f32)
        })
        .sum()
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(400))]

    #[test]
    fn costs_by_both_ends_equal_those_of_the_heap(scene in scene(weight())) {
        scene.with(|field| equals_the_heap::<MeanCost>(field, scene.root))?;
    }

    #[test]
    fn costs_by_the_entered_voxel_equal_those_of_the_heap(scene in scene(weight())) {
        scene.with(|field| equals_the_heap::<EnterCost>(field, scene.root))?;
    }

    #[test]
    fn integer_costs_with_free_voxels_equal_those_of_the_heap_exactly(scene in scene(whole_weight())) {
        scene.with(|field| {
            equals_the_heap::<EnterCost>(field, scene.root)?;
            prop_assert_eq!(Quanta::<EnterCost>::choose(field).unwrap().unit, 1.0);
            Ok(())
        })?;
    }

    #[test]
    fn resumed_searches_equal_fresh_searches(
        scene in scene(weight()),
        targets in prop::collection::vec(any::<prop::sample::Index>(), 1..8),
    ) {
        scene.with(|field| {
            resumes::<MeanCost>(field, scene.root, &targets)?;
            resumes::<EnterCost>(field, scene.root, &targets)
        })?;
    }

    #[test]
    fn an_a_star_path_costs_as_much_as_that_of_the_heap(
        scene in prop_oneof![scene(weight()), scene((1.0f32..1.3).boxed())],
        targets in prop::collection::vec(any::<prop::sample::Index>(), 1..6),
    ) {
        scene.with(|field| {
            aimed_equals_the_heap::<MeanCost>(field, scene.root, &targets)?;
            aimed_equals_the_heap::<EnterCost>(field, scene.root, &targets)
        })?;
    }

    #[test]
    fn an_a_star_path_with_integer_costs_and_free_voxels_is_exact(
        scene in prop_oneof![scene(whole_weight()), scene((1u8..4).prop_map(f32::from).boxed())],
        targets in prop::collection::vec(any::<prop::sample::Index>(), 1..6),
    ) {
        scene.with(|field| aimed_equals_the_heap::<EnterCost>(field, scene.root, &targets))?;
    }

    #[test]
    fn costs_are_accurate_within_half_a_percent(scene in scene(weight())) {
        scene.with(|field| {
            let mut mean = FieldTracker::<MeanCost>::new(field, scene.root).unwrap();
            let mut enter = FieldTracker::<EnterCost>::new(field, scene.root).unwrap();
            mean.solve_all(field, &Unwatched).unwrap();
            enter.solve_all(field, &Unwatched).unwrap();
            for node in 0..field.num_nodes() as u32 {
                let Some(path) = mean.path_to(node) else { continue };
                let truth = exact::<MeanCost>(field, scene.spacing, &path);
                let found = mean.cost(field, node).unwrap();
                prop_assert!((found - truth).abs() <= 0.005 * truth, "{} {}", found, truth);
                let path = enter.path_to(node).unwrap();
                let truth = exact::<EnterCost>(field, scene.spacing, &path);
                let found = enter.cost(field, node).unwrap();
                prop_assert!((found - truth).abs() <= 0.005 * truth, "{} {}", found, truth);
            }
            Ok(())
        })?;
    }
}

proptest! {
    // The number of cases is small, because the scenes are large and are examined node by node.
    #![proptest_config(ProptestConfig::with_cases(24))]

    #[test]
    fn costs_over_several_tiles_equal_those_of_the_heap(scene in wide_scene(), first in any::<prop::sample::Index>()) {
        scene.with(|field| {
            equals_the_heap::<MeanCost>(field, scene.root)?;
            equals_the_heap::<EnterCost>(field, scene.root)?;
            resumes::<MeanCost>(field, scene.root, &[first])?;
            resumes::<EnterCost>(field, scene.root, &[first])
        })?;
    }

    #[test]
    fn the_tree_is_equal_for_every_instruction_set(scene in wide_scene()) {
        scene.with(|field| {
            same_for_every_set::<MeanCost>(field, scene.root)?;
            same_for_every_set::<EnterCost>(field, scene.root)
        })?;
    }
}

#[test]
fn rows_of_any_length_without_walls_are_recognised() {
    for nx in 1..40 {
        let values = vec![1.0f32; nx * 2];
        let grid = grid([nx, 2, 1], [1.0; 3]);
        let field = VoxelField::new(&grid, &values, None, None).unwrap();
        equals_the_heap::<MeanCost>(&field, [nx / 2, 1, 0]).unwrap();
        equals_the_heap::<EnterCost>(&field, [nx / 2, 0, 0]).unwrap();
    }
}

fn cube(n: usize, value: f32) -> Scene {
    Scene {
        shape_ijk: [n; 3],
        spacing: [1.0; 3],
        values: vec![value; n * n * n],
        mask: None,
        region: None,
        root: [0; 3],
    }
}

/// Observer that stops the search at every check but the last few.
struct StopTimes(std::sync::atomic::AtomicUsize);

impl Watch for StopTimes {
    fn report_fraction(&self, fraction: f64) -> Result<(), TrackError> {
        assert!((0.0..=1.0).contains(&fraction));
        let stop = |left: usize| left.checked_sub(1);
        let order = std::sync::atomic::Ordering::Relaxed;
        match self.0.fetch_update(order, order, stop) {
            Ok(_) => Err(TrackError::Cancelled),
            Err(_) => Ok(()),
        }
    }
}

fn goes_on_where_it_stopped<C: StepCost>() {
    let scene = cube(64, 2.0);
    scene.with(|field| {
        let mut whole = FieldTracker::<C>::new(field, scene.root).unwrap();
        whole.solve_all(field, &Unwatched).unwrap();
        let mut stopped = FieldTracker::<C>::new(field, scene.root).unwrap();
        let watch = StopTimes(2.into());
        for _ in 0..2 {
            assert_eq!(stopped.solve_all(field, &watch), Err(TrackError::Cancelled));
            assert!(stopped.num_settled() < field.num_nodes());
        }
        stopped.solve_all(field, &watch).unwrap();
        assert_eq!(stopped.num_settled(), field.num_nodes());
        for node in 0..field.num_nodes() as u32 {
            assert_eq!(stopped.path_to(node), whole.path_to(node));
        }
    });
}

#[test]
fn a_stopped_tracker_resumes_with_equal_results() {
    goes_on_where_it_stopped::<MeanCost>();
    goes_on_where_it_stopped::<EnterCost>();
}

#[test]
fn a_target_near_the_root_settles_few_voxels() {
    let scene = cube(64, 1.0);
    scene.with(|field| {
        let near = field.node_at_voxel([3, 2, 1]).unwrap();
        let mut tracker = FieldTracker::<MeanCost>::new(field, scene.root).unwrap();
        assert!(tracker.solve_to(field, near, &Unwatched).unwrap());
        assert!(tracker.num_settled() < 200, "{}", tracker.num_settled());
    });
}

#[test]
fn an_a_star_search_in_a_uniform_field_settles_few_voxels() {
    let scene = cube(64, 1.0);
    scene.with(|field| {
        let far = field.node_at_voxel([63, 40, 21]).unwrap();
        let enter = least_path::<EnterCost>(field, scene.root, far, &Unwatched).unwrap();
        assert_eq!(enter.unwrap().num_settled, 64);
        let mean = least_path::<MeanCost>(field, scene.root, far, &Unwatched).unwrap();
        let settled = mean.unwrap().num_settled;
        assert!(settled < field.num_nodes() / 4, "{settled}");
    });
}

#[test]
fn an_a_star_search_can_be_stopped_and_rejects_invalid_arguments() {
    let mut scene = cube(64, 1.0);
    scene.with(|field| {
        let error = least_path::<EnterCost>(field, scene.root, u32::MAX, &Unwatched).unwrap_err();
        assert_eq!(error.code(), "usage.track");
        let error = least_path::<EnterCost>(field, [64, 0, 0], 0, &Unwatched).unwrap_err();
        assert_eq!(error.code(), "usage.track");
    });
    // The target is behind a wall, so all voxels before the wall are settled.
    scene.values[64 * 64 * 62..64 * 64 * 63].fill(f32::INFINITY);
    scene.with(|field| {
        let last = field.num_nodes() as u32 - 1;
        let watch = StopTimes(1.into());
        let stopped = least_path::<MeanCost>(field, scene.root, last, &watch);
        assert_eq!(stopped, Err(TrackError::Cancelled));
        let none = least_path::<MeanCost>(field, scene.root, last, &watch);
        assert_eq!(none, Ok(None));
    });
}

#[test]
fn memory_per_voxel_is_within_the_documented_limits() {
    let scene = cube(96, 1.5);
    let voxels = scene.values.len() as f64;
    scene.with(|field| {
        let mut mean = FieldTracker::<MeanCost>::new(field, scene.root).unwrap();
        let mut enter = FieldTracker::<EnterCost>::new(field, scene.root).unwrap();
        mean.solve_all(field, &Unwatched).unwrap();
        enter.solve_all(field, &Unwatched).unwrap();
        assert!(mean.num_bytes().0 as f64 <= 5.2 * voxels);
        // The memory is one bit per voxel and a rim of one voxel, rounded up to bytes.
        assert!(enter.num_bytes().0 as f64 <= 1.2 * voxels);
        assert!((mean.num_bytes().1 as f64) < voxels);
        assert!((enter.num_bytes().1 as f64) < voxels);
    });
}

#[test]
fn invalid_fields_and_roots_are_rejected_with_a_message() {
    let code = |scene: &Scene| {
        scene.with(|field| {
            let error = FieldTracker::<MeanCost>::new(field, scene.root).unwrap_err();
            assert!(error.to_string().len() > 20, "{error}");
            error.code()
        })
    };
    let mut scene = cube(4, 1.0);
    scene.values[5] = -1.0;
    assert_eq!(code(&scene), "usage.track");
    scene.values[5] = 0.0;
    assert_eq!(code(&scene), "usage.track");
    scene.values[5] = 1e9;
    assert_eq!(code(&scene), "track.cost-range");
    scene.values = vec![f32::INFINITY; 64];
    assert_eq!(code(&scene), "track.no-result");
    scene.values = vec![1.0; 64];
    scene.root = [4, 0, 0];
    assert_eq!(code(&scene), "usage.track");
    scene.root = [3, 3, 3];
    scene.mask = Some(vec![0; 64]);
    assert_eq!(code(&scene), "track.no-result");

    let plain = grid([4, 4, 4], [1.0; 3]);
    let values = vec![1.0; 64];
    for region in [[0..4, 0..5, 0..4], [0..4, 2..2, 0..4]] {
        let error = VoxelField::new(&plain, &values, Some(region), None).unwrap_err();
        assert_eq!(error.code(), "usage.track");
    }
    assert!(VoxelField::new(&plain, &values[1..], None, None).is_err());
    assert!(VoxelField::new(&plain, &values, None, Some(&[1; 63])).is_err());
}

#[test]
fn a_path_cost_beyond_the_representable_range_returns_an_error() {
    // A corridor of the most expensive voxels follows a voxel that makes the quantum small: 128 quanta times 15,000 per
    // voxel.
    let n = 2_000;
    let mut values = vec![15_000.0f32; n];
    values[0] = 1.0;
    let grid = grid([n, 1, 1], [1.0; 3]);
    let field = VoxelField::new(&grid, &values, None, None).unwrap();
    let mut tracker = FieldTracker::<MeanCost>::new(&field, [0, 0, 0]).unwrap();
    let error = tracker.solve_all(&field, &Unwatched).unwrap_err();
    assert_eq!(error.code(), "track.cost-overflow");
    // Costs that were settled before the error stay correct.
    assert!(tracker.cost(&field, 100).unwrap() > 1.4e6);
    // `EnterCost` stores no cost per voxel, so no cost can overflow.
    let mut enter = FieldTracker::<EnterCost>::new(&field, [0, 0, 0]).unwrap();
    enter.solve_all(&field, &Unwatched).unwrap();
    assert_eq!(
        enter.cost(&field, n as u32 - 1),
        Some((n - 1) as f64 * 15_000.0)
    );
}
