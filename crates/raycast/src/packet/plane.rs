//! A row of a plane, as many pixels at once as a register has lanes: [`crate::sample_plane`] lane by lane.

#[cfg(target_arch = "x86_64")]
use super::{avx2, avx512};
use super::{
    lanes::{Array, Lanes, MAX_LANES},
    voxels::Voxels,
};
use crate::{Field, InstructionSet, Window};

/// What all rows of a plane share.
#[derive(Clone, Copy)]
pub(crate) struct PlaneRows<'a> {
    voxels: Voxels<'a>,
    /// Last coordinates within the box of the voxels.
    end: [f32; 3],
    along_row: [f32; 3],
    window: Window,
    simd: InstructionSet,
}

impl<'a> PlaneRows<'a> {
    /// `None` where pixels are taken one by one: without instructions for gathers, which is slower, for volumes beyond
    /// 32-bit indices, and for one voxel along x.
    pub(crate) fn of(
        field: &Field<'a>,
        along_row: [f32; 3],
        window: Window,
        simd: InstructionSet,
    ) -> Option<Self> {
        let gathers = matches!(simd, InstructionSet::Avx2 | InstructionSet::Avx512);
        Some(Self {
            voxels: Voxels::of(field).filter(|_| gathers)?,
            end: [0, 1, 2].map(|a| field.last[a] + 0.5),
            along_row,
            window,
            simd,
        })
    }

    /// One row of pixels from voxel coordinates `start`; both slices hold zeros.
    pub(crate) fn sample(&self, start: [f32; 3], grey: &mut [u8], inside: &mut [u8]) {
        match self.simd {
            #[cfg(target_arch = "x86_64")]
            // SAFETY: the instruction set is only handed out where the machine has it. Benchmark: `carina bench
            // isoregion`, the oblique slice.
            InstructionSet::Avx512 => unsafe { self.sample_avx512(start, grey, inside) },
            #[cfg(target_arch = "x86_64")]
            // SAFETY: as above.
            InstructionSet::Avx2 => unsafe { self.sample_avx2(start, grey, inside) },
            _ => unreachable!("`of` makes no rows for it"),
        }
    }

    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx512f,avx512bw,avx512dq,avx512vl,avx2,fma,bmi1,bmi2,lzcnt,popcnt")]
    fn sample_avx512(&self, start: [f32; 3], grey: &mut [u8], inside: &mut [u8]) {
        // SAFETY: this function runs only where the machine has the instructions.
        self.row(unsafe { avx512::Avx512::new() }, start, grey, inside);
    }

    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2,fma,bmi1,bmi2,lzcnt,popcnt")]
    fn sample_avx2(&self, start: [f32; 3], grey: &mut [u8], inside: &mut [u8]) {
        // SAFETY: this function runs only where the machine has the instructions.
        self.row(unsafe { avx2::Avx2::new() }, start, grey, inside);
    }

    #[inline(always)]
    fn row<L: Lanes>(&self, l: L, start: [f32; 3], grey: &mut [u8], inside: &mut [u8]) {
        let mut centres: Array<f32> = [0.0; MAX_LANES];
        for n in 0..MAX_LANES {
            centres[n] = n as f32 + 0.5;
        }
        let all = u32::MAX >> (32 - L::N);
        let centres = l.fill(l.splat(0.0), all, &centres);
        let width = grey.len();
        let mut column = 0;
        while column < width {
            let t = l.add(l.splat(column as f32), centres);
            let mut p = [t; 3];
            // True of every number; a coordinate that is none lies nowhere.
            let mut within = l.less(l.splat(-1.0), l.splat(0.0));
            for a in 0..3 {
                p[a] = l.fma(t, l.splat(self.along_row[a]), l.splat(start[a]));
                within = l.and(within, l.less(l.splat(f32::NEG_INFINITY), p[a]));
                within = l.without(within, l.less(p[a], l.splat(-0.5)));
                within = l.without(within, l.less(l.splat(self.end[a]), p[a]));
            }
            let within = l.bits(within);
            if within != 0 {
                let value = self.voxels.value(l, &self.voxels.cells(l, p));
                let (lo, scale) = self.window.ramp();
                let level = l.fma(l.sub(value, l.splat(lo)), l.splat(scale), l.splat(0.5));
                let level = l.min(l.max(level, l.splat(0.0)), l.splat(255.0));
                let level = l.store_i(l.whole(level));
                if within == all && column + L::N <= width {
                    let grey = &mut grey[column..column + L::N];
                    for n in 0..L::N {
                        grey[n] = level[n] as u8;
                    }
                    inside[column..column + L::N].fill(1);
                    column += L::N;
                    continue;
                }
                for n in 0..L::N.min(width - column) {
                    let set = (within >> n & 1) as u8;
                    inside[column + n] = set;
                    grey[column + n] = level[n] as u8 * set;
                }
            }
            column += L::N;
        }
    }
}
