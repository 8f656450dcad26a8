//! Loads from a separate memory address for each lane, without gather instructions.
//!
//! On some machines single loads and insertions take half to two thirds of the time of the gather instructions
//! (docs/decisions/0103); on others they take more ([`super::gathers`]).

use std::{
    arch::x86_64::{
        __m128i, _mm_castpd_si128, _mm_castps_si128, _mm_castsi128_pd, _mm_castsi128_ps,
        _mm_cvtsi32_si128, _mm_insert_epi8, _mm_insert_epi16, _mm_insert_epi32, _mm_loadh_pd,
        _mm_loadl_epi64, _mm_loadu_si128, _mm_setr_epi8, _mm_shuffle_ps,
    },
    sync::atomic::{AtomicI32, Ordering},
};

use super::lanes::Array;

/// Return the memory addresses of the voxels of lanes `n..n + 4`.
///
/// # Safety
///
/// The voxels must be in the data.
#[inline(always)]
pub(super) unsafe fn lane_pointers(
    data: *const i16,
    index: &Array<i32>,
    n: usize,
) -> [*const i16; 4] {
    // SAFETY: the caller guarantees that the voxels are in the data; indices are not negative.
    unsafe {
        [
            data.add(index[n] as u32 as usize),
            data.add(index[n + 1] as u32 as usize),
            data.add(index[n + 2] as u32 as usize),
            data.add(index[n + 3] as u32 as usize),
        ]
    }
}

/// Load two successive voxels for each of four lanes, as 32-bit words.
///
/// # Safety
///
/// The voxels must be in the data, and the machine must have SSE 4.1.
#[inline(always)]
pub(super) unsafe fn four_pairs(lanes: [*const i16; 4], offset: i32) -> __m128i {
    // SAFETY: the caller guarantees SSE 4.1 and that the voxels are in the data.
    unsafe {
        let pair = |n: usize| {
            lanes[n]
                .offset(offset as isize)
                .cast::<i32>()
                .read_unaligned()
        };
        let v = _mm_cvtsi32_si128(pair(0));
        let v = _mm_insert_epi32::<1>(v, pair(1));
        let v = _mm_insert_epi32::<2>(v, pair(2));
        _mm_insert_epi32::<3>(v, pair(3))
    }
}

/// Load four successive voxels for each of four lanes: the first two and the last two, as 32-bit words.
///
/// # Safety
///
/// The voxels must be in the data, and the machine must have SSE 2.
#[inline(always)]
pub(super) unsafe fn four_quads(lanes: [*const i16; 4], offset: i32) -> [__m128i; 2] {
    // SAFETY: the caller guarantees SSE 2 and that the voxels are in the data.
    unsafe {
        let at = |n: usize| lanes[n].offset(offset as isize);
        let two = |n: usize| {
            let low = _mm_castsi128_pd(_mm_loadl_epi64(at(n).cast()));
            _mm_castsi128_ps(_mm_castpd_si128(_mm_loadh_pd(low, at(n + 1).cast())))
        };
        let (a, b) = (two(0), two(2));
        [
            _mm_castps_si128(_mm_shuffle_ps::<0x88>(a, b)),
            _mm_castps_si128(_mm_shuffle_ps::<0xdd>(a, b)),
        ]
    }
}

/// Return the byte shuffle that interleaves two groups of four int16: both first numbers, both second numbers and so
/// on.
///
/// # Safety
///
/// The machine must have SSE 2.
#[inline(always)]
pub(super) unsafe fn interleaved() -> __m128i {
    // SAFETY: the caller guarantees SSE 2.
    unsafe { _mm_setr_epi8(0, 1, 8, 9, 2, 3, 10, 11, 4, 5, 12, 13, 6, 7, 14, 15) }
}

/// Load eight successive int16 of a brick.
///
/// # Safety
///
/// The numbers must be in the data, and the machine must have SSE 2.
#[inline(always)]
pub(super) unsafe fn eight_numbers(data: *const i16, offset: i32) -> __m128i {
    // SAFETY: the caller guarantees SSE 2 and that the numbers are in the data; the load needs no alignment.
    unsafe { _mm_loadu_si128(data.offset(offset as isize).cast()) }
}

/// Load the table entries of the bricks of lanes `n..n + 4`.
///
/// # Safety
///
/// The entries must be in the table, and the machine must have SSE 4.1.
#[inline(always)]
pub(super) unsafe fn four_links(table: *const AtomicI32, index: &Array<i32>, n: usize) -> __m128i {
    // SAFETY: the caller guarantees SSE 4.1 and that the links are in the table; indices are not negative.
    unsafe {
        let link = |lane: usize| {
            let link = &*table.add(index[n + lane] as u32 as usize);
            link.load(Ordering::Acquire)
        };
        let v = _mm_cvtsi32_si128(link(0));
        let v = _mm_insert_epi32::<1>(v, link(1));
        let v = _mm_insert_epi32::<2>(v, link(2));
        _mm_insert_epi32::<3>(v, link(3))
    }
}

/// Load one voxel for each of lanes `n..n + 8`.
///
/// # Safety
///
/// The voxels must be in the data, and the machine must have SSE 2.
#[inline(always)]
pub(super) unsafe fn eight_voxels(data: *const i16, index: &Array<i32>, n: usize) -> __m128i {
    // SAFETY: the caller guarantees SSE 2 and that the voxels are in the data.
    unsafe {
        let voxel = |lane: usize| i32::from(*data.add(index[n + lane] as u32 as usize));
        let v = _mm_cvtsi32_si128(voxel(0) & 0xffff);
        let v = _mm_insert_epi16::<1>(v, voxel(1));
        let v = _mm_insert_epi16::<2>(v, voxel(2));
        let v = _mm_insert_epi16::<3>(v, voxel(3));
        let v = _mm_insert_epi16::<4>(v, voxel(4));
        let v = _mm_insert_epi16::<5>(v, voxel(5));
        let v = _mm_insert_epi16::<6>(v, voxel(6));
        _mm_insert_epi16::<7>(v, voxel(7))
    }
}

/// Load one byte for each of lanes `n..n + 4`, into the lowest 32 bits.
///
/// # Safety
///
/// The bytes must be in the data, and the machine must have SSE 4.1.
#[inline(always)]
pub(super) unsafe fn four_bytes(data: *const u8, index: &Array<i32>, n: usize) -> __m128i {
    // SAFETY: the caller guarantees SSE 4.1 and that the bytes are in the data.
    unsafe {
        let byte = |lane: usize| i32::from(*data.add(index[n + lane] as u32 as usize));
        let v = _mm_cvtsi32_si128(byte(0));
        let v = _mm_insert_epi8::<1>(v, byte(1));
        let v = _mm_insert_epi8::<2>(v, byte(2));
        _mm_insert_epi8::<3>(v, byte(3))
    }
}
