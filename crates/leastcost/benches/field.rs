//! Benchmark of whole least-cost trees: ns per voxel in a noisy field with a cheap tree of tubes, both costs, one
//! thread.
//!
//! `cargo bench -p carina-leastcost --bench field [FILE.f32 NX NY NZ I J K]`: a raw field and the root's voxel.

use std::time::Instant;

use carina_grid::{Affine, Grid};
use carina_leastcost::Unwatched;
use carina_leastcost::field::{EnterCost, MeanCost, StepCost, VoxelField};
use carina_leastcost::field_tracker::FieldTracker;

/// Return the processor time that this thread has used, in s, because other processes may load the machine.
///
/// If the system reports no processor time (only Linux does), the result is the time since `since`.
fn cpu_s(since: Instant) -> f64 {
    std::fs::read_to_string("/proc/thread-self/schedstat")
        .ok()
        .and_then(|text| text.split(' ').next()?.parse::<f64>().ok())
        .map_or_else(|| since.elapsed().as_secs_f64(), |ns| 1e-9 * ns)
}

fn time<C: StepCost>(what: &str, field: &VoxelField<'_>, root: [usize; 3]) {
    for _ in 0..3 {
        let clock = Instant::now();
        let started = cpu_s(clock);
        let mut tracker = FieldTracker::<C>::new(field, root).expect("a field that can be tracked");
        let made = cpu_s(clock) - started;
        tracker
            .solve_all(field, &Unwatched)
            .expect("nobody stops it");
        let took = cpu_s(clock) - started;
        let voxels = field.num_nodes() as f64;
        let (kept, queue) = tracker.num_bytes();
        println!(
            "{what}: {:.0} ms ({:.0} to begin), {:.1} ns a voxel, {:.2} + {:.2} bytes a voxel",
            1e3 * took,
            1e3 * made,
            1e9 * took / voxels,
            kept as f64 / voxels,
            queue as f64 / voxels
        );
    }
}

fn main() {
    let arguments: Vec<String> = std::env::args()
        .skip(1)
        .filter(|a| a != "--bench")
        .collect();
    let number = |at: usize, otherwise: usize| {
        arguments
            .get(at)
            .map_or(otherwise, |text| text.parse().expect("a whole number"))
    };
    let shape = [number(1, 160), number(2, 150), number(3, 140)];
    let root = [number(4, 80), number(5, 75), number(6, 70)];
    let num_voxels: usize = shape.iter().product();
    let values: Vec<f32> = if let Some(file) = arguments.first() {
        std::fs::read(file)
            .expect("a file")
            .as_chunks::<4>()
            .0
            .iter()
            .map(|bytes| f32::from_le_bytes(*bytes))
            .collect()
    } else {
        let mut state = 1u64;
        let mut noise = || {
            state = state
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1);
            (state >> 40) as f32 / (1u64 << 24) as f32
        };
        (0..num_voxels)
            .map(|at| {
                let tube = at % shape[0] % 40 < 4 && at / shape[0] % shape[1] % 40 < 4;
                1.0 + noise() + if tube { 0.0 } else { 10.0 * noise() }
            })
            .collect()
    };
    let matrix = [
        [0.7, 0.0, 0.0, 0.0],
        [0.0, 0.7, 0.0, 0.0],
        [0.0, 0.0, 1.0, 0.0],
        [0.0, 0.0, 0.0, 1.0],
    ];
    let affine = Affine::from_matrix("bench", &matrix).expect("a matrix");
    let grid = Grid::new([shape[2], shape[1], shape[0]], affine).expect("a grid");
    let field = VoxelField::new(&grid, &values, None, None).expect("a field");
    time::<EnterCost>("by the voxel entered", &field, root);
    time::<MeanCost>("by both ends", &field, root);
}
