//! Arrival times of a front whose speed depends on the voxel (fast-marching method).
//!
//! Source: J. A. Sethian, A fast marching level set method for monotonically advancing fronts, PNAS 93, 1996. The
//! update is of first order and upwind. Voxels are cubes of side 1. ITK's `FastMarchingImageFilter` gives the same times
//! up to rounding.

use std::cmp::Reverse;
use std::collections::BinaryHeap;

/// State of a voxel.
#[derive(Clone, Copy, PartialEq, Eq)]
enum State {
    Far,
    Start,
    Trial,
    Done,
}

/// Return the time at which a front reaches each voxel, infinite where it does not.
///
/// # Arguments
///
/// * `speed` - speed in voxels per unit of time; the front never enters a voxel of speed 0. Indices run x fastest.
/// * `starts` - voxels `(i, j, k)` that the front leaves at time 0.
///
/// # Panics
///
/// Panics if `speed` does not have one value per voxel of `shape_ijk`, or a start is outside the grid.
#[must_use]
pub fn arrival_times(speed: &[f32], shape_ijk: [usize; 3], starts: &[[usize; 3]]) -> Vec<f32> {
    let [nx, ny, nz] = shape_ijk;
    assert_eq!(speed.len(), nx * ny * nz, "one value per voxel");
    let strides = [1, nx, nx * ny];
    let mut times = vec![f32::INFINITY; speed.len()];
    let mut states = vec![State::Far; speed.len()];
    // Times are not negative, so their bits have the order of the numbers.
    let mut queue: BinaryHeap<Reverse<(u32, usize)>> = BinaryHeap::new();
    for start in starts {
        assert!(
            (0..3).all(|axis| start[axis] < shape_ijk[axis]),
            "a start in the grid"
        );
        let index = (start[2] * ny + start[1]) * nx + start[0];
        times[index] = 0.0;
        states[index] = State::Start;
        queue.push(Reverse((0, index)));
    }
    while let Some(Reverse((bits, index))) = queue.pop() {
        // An entry is stale if the voxel has an earlier time or was taken from the queue before.
        if states[index] == State::Done || times[index].to_bits() != bits {
            continue;
        }
        states[index] = State::Done;
        let ijk = [index % nx, index / nx % ny, index / nx / ny];
        for axis in 0..3 {
            for forward in [false, true] {
                let Some(next) = neighbour(index, ijk, axis, forward, shape_ijk, strides) else {
                    continue;
                };
                if matches!(states[next], State::Done | State::Start) {
                    continue;
                }
                let time = upwind_time(next, speed[next], shape_ijk, strides, &times, &states);
                if time.is_finite() {
                    times[next] = time;
                    states[next] = State::Trial;
                    queue.push(Reverse((time.to_bits(), next)));
                }
            }
        }
    }
    times
}

/// Return the index of a voxel's neighbour on one axis; `None` outside the grid.
fn neighbour(
    index: usize,
    ijk: [usize; 3],
    axis: usize,
    forward: bool,
    shape_ijk: [usize; 3],
    strides: [usize; 3],
) -> Option<usize> {
    if forward {
        (ijk[axis] + 1 < shape_ijk[axis]).then(|| index + strides[axis])
    } else {
        (ijk[axis] > 0).then(|| index - strides[axis])
    }
}

/// Solve the upwind equation of one voxel with the times of its neighbours that the front has passed.
fn upwind_time(
    index: usize,
    speed: f32,
    shape_ijk: [usize; 3],
    strides: [usize; 3],
    times: &[f32],
    states: &[State],
) -> f32 {
    let [nx, ny, _] = shape_ijk;
    let ijk = [index % nx, index / nx % ny, index / nx / ny];
    let mut passed: [f64; 3] = std::array::from_fn(|axis| {
        [false, true]
            .into_iter()
            .filter_map(|forward| neighbour(index, ijk, axis, forward, shape_ijk, strides))
            .filter(|&next| states[next] == State::Done)
            .map(|next| f64::from(times[next]))
            .fold(f64::INFINITY, f64::min)
    });
    passed.sort_unstable_by(f64::total_cmp);
    // sum over axes of max(time - passed, 0)^2 = 1 / speed^2; axes join in the order of their times.
    let (mut a, mut b) = (0.0, 0.0);
    let mut c = -(1.0 / f64::from(speed)).powi(2);
    let mut time = f64::INFINITY;
    for before in passed {
        if !(before.is_finite() && time >= before) {
            break;
        }
        a += 1.0;
        b += before;
        c += before * before;
        // Rounding can make the discriminant of equal times slightly negative.
        time = ((b * b - a * c).max(0.0).sqrt() + b) / a;
    }
    time as f32
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn front_of_constant_speed_takes_the_distance_along_an_axis() {
        let times = arrival_times(&[2.0; 5], [5, 1, 1], &[[1, 0, 0]]);
        assert_eq!(times, [0.5, 0.0, 0.5, 1.0, 1.5]);
    }

    #[test]
    fn front_does_not_enter_voxels_without_speed() {
        let mut speed = vec![1.0; 9];
        speed[1] = 0.0;
        speed[4] = 0.0;
        let times = arrival_times(&speed, [3, 3, 1], &[[0, 0, 0]]);
        assert_eq!([times[1], times[4]], [f32::INFINITY; 2]);
        // The way round the obstacle: straight steps of 1, and one diagonal update at a time.
        assert_eq!([times[3], times[6], times[7]], [1.0, 2.0, 3.0]);
        assert!(times[2].is_finite() && times[2] > times[8]);
    }

    #[test]
    fn two_fronts_meet_with_the_upwind_time_of_both() {
        // A voxel diagonal to the start, with neighbours at 1 and 1: (t - 1)^2 + (t - 1)^2 = 1.
        let times = arrival_times(&[1.0; 4], [2, 2, 1], &[[0, 0, 0]]);
        assert!((times[3] - (1.0 + 0.5_f32.sqrt())).abs() < 1e-6);
    }

    #[test]
    fn front_through_an_open_box_is_within_first_order_of_the_distance() {
        let n = 21;
        let times = arrival_times(&vec![1.0; n * n * n], [n; 3], &[[10, 10, 10]]);
        for k in 0..n {
            for j in 0..n {
                for i in 0..n {
                    let far = [i, j, k]
                        .map(|at| (at as f32 - 10.0).powi(2))
                        .iter()
                        .sum::<f32>()
                        .sqrt();
                    let time = times[(k * n + j) * n + i];
                    // The scheme of first order overestimates most along the diagonal: 1.45 voxels at the corners.
                    assert!(time >= far - 1e-4 && time <= far + 1.46, "{time} {far}");
                }
            }
        }
    }
}
