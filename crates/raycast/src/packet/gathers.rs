//! Measurement that decides whether gather instructions or single loads read voxels on this machine.
//!
//! Gathers are faster on Intel's server processors since Sapphire Rapids, slower on Zen 4 and Zen 5, and several times
//! slower where microcode mitigates Gather Data Sampling. No feature flag distinguishes these machines, a virtual
//! machine may hide the model, and the results are equal. So both variants are timed once per process
//! (docs/decisions/0103).

use std::{
    hint::black_box,
    sync::OnceLock,
    time::{Duration, Instant},
};

use super::{
    avx2, avx512,
    lanes::{Array, Lanes, MAX_LANES},
};
use crate::InstructionSet;

/// Return true if gather instructions read voxels faster than single loads on this machine.
///
/// The first call for an instruction set takes some fifty microseconds.
pub(super) fn gathers_are_faster(simd: InstructionSet) -> bool {
    /// Result for AVX2 and for AVX-512, measured on first use.
    static ARE_FASTER: [OnceLock<bool>; 2] = [OnceLock::new(), OnceLock::new()];
    match simd {
        InstructionSet::Avx2 if simd.is_available() => *ARE_FASTER[0].get_or_init(|| {
            // SAFETY: `simd.is_available()` has confirmed that the machine has the instruction set. Benchmark:
            // `carina bench isoregion`, the oblique slice.
            faster(|data, gathers| unsafe { read_avx2(data, gathers) })
        }),
        InstructionSet::Avx512 if simd.is_available() => *ARE_FASTER[1].get_or_init(|| {
            // SAFETY: `simd.is_available()` has confirmed that the machine has the instruction set.
            faster(|data, gathers| unsafe { read_avx512(data, gathers) })
        }),
        _ => false,
    }
}

/// Number of voxels along each row of the test data.
const SIDE: usize = 64;
/// Number of reads in one timed round.
const READS: usize = 64;
/// Number of timed rounds of each variant.
const ROUNDS: usize = 9;

/// Return whether the shortest time with gathers is below the shortest time without, over alternating rounds.
///
/// The data that `read` reads fit the nearest cache.
fn faster(read: impl Fn(&[i16], bool) -> i32) -> bool {
    let data: Vec<i16> = (0..SIDE * SIDE).map(|n| n as i16).collect();
    let mut least = [Duration::MAX; 2];
    for _ in 0..ROUNDS {
        for (least, gathers) in least.iter_mut().zip([false, true]) {
            let started = Instant::now();
            black_box(read(black_box(&data), gathers));
            *least = started.elapsed().min(*least);
        }
    }
    least[1] < least[0]
}

#[target_feature(enable = "avx512f,avx512bw,avx512dq,avx512vl,avx2,fma,bmi1,bmi2,lzcnt,popcnt")]
fn read_avx512(data: &[i16], gathers: bool) -> i32 {
    // SAFETY: this function runs only on a machine with the instructions of its target features.
    read(unsafe { avx512::Avx512::new(gathers) }, data)
}

#[target_feature(enable = "avx2,fma,bmi1,bmi2,lzcnt,popcnt")]
fn read_avx2(data: &[i16], gathers: bool) -> i32 {
    // SAFETY: this function runs only on a machine with the instructions of its target features.
    read(unsafe { avx2::Avx2::new(gathers) }, data)
}

/// Read the rows of consecutive cells along a diagonal, and return the sum of their voxels.
#[inline(always)]
fn read<L: Lanes>(l: L, data: &[i16]) -> i32 {
    assert!(data.len() >= SIDE * SIDE);
    let mut places: Array<i32> = [0; MAX_LANES];
    for (n, place) in places.iter_mut().enumerate() {
        *place = (n * (SIDE + 1)) as i32;
    }
    let places = l.load_i(&places);
    let mut sum = l.splat_i(0);
    for n in 0..READS as i32 {
        let base = l.add_i(places, l.splat_i(n % 16));
        let side = SIDE as i32;
        let offsets = [0, side, 8 * side, 9 * side];
        // SAFETY: a lane's index is at most 31 * 65 + 15, and the farthest pair is 9 * 64 and one more beyond that
        // index: 2607 of 4096 values. Benchmark: `carina bench isoregion`, the oblique slice.
        let pairs = unsafe { l.pairs(data.as_ptr(), base, offsets) };
        for pair in pairs {
            sum = l.add_i(sum, pair);
        }
    }
    let sum = l.store_i(sum);
    (0..L::N).fold(0, |a, n| a.wrapping_add(sum[n]))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Return the pair of voxels at one index per lane twice: read by the instruction set, and read one by one.
    fn pairs_of<L: Lanes>(l: L, data: &[i16], places: &Array<i32>, offset: i32) -> [Vec<i32>; 2] {
        let reach = |place: i32| usize::try_from(place + offset).unwrap();
        assert!(places[..L::N].iter().all(|&p| reach(p) + 1 < data.len()));
        // SAFETY: the assertion above guarantees that every pair is in the data. Speed is not relevant in a test.
        let [found] = unsafe { l.pairs(data.as_ptr(), l.load_i(places), [offset]) };
        let expected = (0..L::N).map(|n| {
            let at = reach(places[n]);
            i32::from(data[at + 1]) << 16 | i32::from(data[at]) & 0xffff
        });
        [l.store_i(found)[..L::N].to_vec(), expected.collect()]
    }

    #[target_feature(enable = "avx512f,avx512bw,avx512dq,avx512vl,avx2,fma,bmi1,bmi2,lzcnt,popcnt")]
    fn pairs_avx512(
        gathers: bool,
        data: &[i16],
        places: &Array<i32>,
        offset: i32,
    ) -> [Vec<i32>; 2] {
        // SAFETY: this function runs only on a machine with the instructions of its target features.
        pairs_of(
            unsafe { avx512::Avx512::new(gathers) },
            data,
            places,
            offset,
        )
    }

    #[target_feature(enable = "avx2,fma,bmi1,bmi2,lzcnt,popcnt")]
    fn pairs_avx2(gathers: bool, data: &[i16], places: &Array<i32>, offset: i32) -> [Vec<i32>; 2] {
        // SAFETY: this function runs only on a machine with the instructions of its target features.
        pairs_of(unsafe { avx2::Avx2::new(gathers) }, data, places, offset)
    }

    #[test]
    fn gathers_and_single_loads_read_equal_voxels() {
        let mut state = 11u64;
        let mut random = |n: usize| {
            state = state
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1);
            (state >> 33) as usize % n
        };
        let data: Vec<i16> = (0..5000).map(|_| random(1 << 16) as u16 as i16).collect();
        for _ in 0..200 {
            let offset = random(200) as i32 - 100;
            let mut places: Array<i32> = [0; MAX_LANES];
            for place in &mut places {
                *place = 100 + random(data.len() - 201) as i32;
            }
            for gathers in [false, true] {
                if InstructionSet::Avx512.is_available() {
                    // SAFETY: the test has checked that the machine has the instruction set. Speed is not relevant in a
                    // test.
                    let [found, expected] =
                        unsafe { pairs_avx512(gathers, &data, &places, offset) };
                    assert_eq!(found, expected, "AVX-512, gathers: {gathers}");
                }
                if InstructionSet::Avx2.is_available() {
                    // SAFETY: the test has checked that the machine has the instruction set.
                    let [found, expected] = unsafe { pairs_avx2(gathers, &data, &places, offset) };
                    assert_eq!(found, expected, "AVX2, gathers: {gathers}");
                }
            }
        }
    }
}
