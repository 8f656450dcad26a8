//! Operations on rows of bytes (one byte per voxel) in vector registers, for the computation of radius maps.

mod portable;
mod register;
#[cfg(target_arch = "x86_64")]
mod x86;

use carina_grid::InstructionSet;
use portable::Portable;
pub(crate) use register::Bytes;
#[cfg(target_arch = "x86_64")]
use x86::{Avx2, Avx512, Sse2};

/// Computation that the compiler translates once for each instruction set.
pub(crate) trait Kernel {
    /// Run the computation with the instruction set `b`.
    ///
    /// The method must be inlined, or it is compiled without the instruction set.
    fn run<B: Bytes>(self, b: B);
}

/// Run a kernel with the widest registers of an instruction set that are not longer than a row of `nx` voxels.
pub(crate) fn run<K: Kernel>(simd: InstructionSet, nx: usize, kernel: K) {
    #[cfg(target_arch = "x86_64")]
    {
        #[target_feature(enable = "avx512f,avx512bw,avx2,bmi1,bmi2,lzcnt,popcnt")]
        fn avx512<K: Kernel>(kernel: K) {
            // SAFETY: this function runs only on a machine with the instructions of its target features.
            kernel.run(unsafe { Avx512::new() });
        }
        #[target_feature(enable = "avx2,bmi1,bmi2,lzcnt,popcnt")]
        fn avx2<K: Kernel>(kernel: K) {
            // SAFETY: this function runs only on a machine with the instructions of its target features.
            kernel.run(unsafe { Avx2::new() });
        }
        if simd == InstructionSet::Avx512 && nx >= Avx512::N {
            // SAFETY: an `InstructionSet` value exists only on a machine that has the instructions of that set.
            // Benchmark: benches/map.rs.
            return unsafe { avx512(kernel) };
        }
        if matches!(simd, InstructionSet::Avx512 | InstructionSet::Avx2) && nx >= Avx2::N {
            // SAFETY: an `InstructionSet` value exists only on a machine that has the instructions of that set.
            return unsafe { avx2(kernel) };
        }
        if nx >= Sse2::N {
            return kernel.run(Sse2);
        }
    }
    #[cfg(not(target_arch = "x86_64"))]
    let _ = simd;
    if nx >= Portable::<16>::N {
        kernel.run(Portable::<16>);
    } else {
        kernel.run(Portable::<1>);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Check every operation of an instruction set against a plain loop that defines the operation.
    fn check<B: Bytes>(b: B) {
        let n = B::N;
        let load = |v: &[u8]| {
            assert!(v.len() >= n);
            // SAFETY: the array has at least as many bytes as a register.
            unsafe { b.load(v.as_ptr()) }
        };
        let values = |v: B::V| {
            let mut out = vec![0u8; n];
            // SAFETY: `out` has as many bytes as a register.
            unsafe { b.store(out.as_mut_ptr(), v) };
            out
        };
        let mut state = 9u64;
        for round in 0..200u64 {
            let mut random = || {
                state = state
                    .wrapping_mul(6_364_136_223_846_793_005)
                    .wrapping_add(1_442_695_040_888_963_407);
                (state >> 40) as u8
            };
            let p: Vec<u8> = (0..64).map(|_| random() % (1 + round as u8 % 7)).collect();
            let q: Vec<u8> = (0..64).map(|_| random()).collect();
            let (vp, vq) = (load(&p), load(&q));
            let each = |f: &dyn Fn(usize) -> u8| (0..n).map(f).collect::<Vec<_>>();
            assert_eq!(values(b.min(vp, vq)), each(&|i| p[i].min(q[i])));
            assert_eq!(values(b.add(vp, vq)), each(&|i| p[i].saturating_add(q[i])));
            assert_eq!(values(b.splat(q[3])), vec![q[3]; n]);
            assert_eq!(b.is_zero(vp), p[..n].iter().all(|&v| v == 0));
            assert!(b.is_zero(b.splat(0)) && b.same(vq, vq));
            assert_eq!(b.same(vp, vq), p[..n] == q[..n]);
            assert_eq!(
                values(b.previous(vp, vq)),
                each(&|i| if i == 0 { p[n - 1] } else { q[i - 1] })
            );
            assert_eq!(
                values(b.next(vp, vq)),
                each(&|i| if i == n - 1 { q[0] } else { p[i + 1] })
            );
            let bits = u64::from_le_bytes(q[..8].try_into().unwrap());
            assert_eq!(
                values(b.expand(bits)),
                each(&|i| if bits >> i & 1 == 1 { 255 } else { 0 })
            );
            assert_eq!(
                values(b.spread(vq)),
                each(&|i| {
                    (0..n)
                        .map(|j| q[j].saturating_add(i.abs_diff(j) as u8))
                        .min()
                        .unwrap()
                })
            );
            assert_eq!(values(b.rising()), each(&|i| i as u8 + 1));
            assert_eq!(values(b.falling()), each(&|i| (n - i) as u8));
            // SAFETY: both arrays have 64 bytes.
            let equal = unsafe { b.equal64(p.as_ptr(), q.as_ptr()) };
            let mut hu: Vec<i16> = (0..64).map(|i| i16::from_le_bytes([p[i], q[i]])).collect();
            hu[0] = i16::MIN;
            hu[1] = i16::MAX;
            for (lo, hi) in [
                (i16::MIN, -100),
                (-300, 4000),
                (77, i16::MAX),
                (hu[9], hu[9]),
            ] {
                // SAFETY: the array has 64 values.
                let within = unsafe { b.within64(hu.as_ptr(), lo, lo.abs_diff(hi)) };
                for i in 0..64 {
                    assert_eq!(equal >> i & 1 == 1, p[i] == q[i]);
                    assert_eq!(within >> i & 1 == 1, (lo..=hi).contains(&hu[i]));
                }
            }
        }
    }

    #[test]
    fn operations_of_every_instruction_set_equal_their_definitions() {
        check(Portable::<1>);
        check(Portable::<16>);
        #[cfg(target_arch = "x86_64")]
        {
            check(Sse2);
            if InstructionSet::Avx2.is_available() {
                // SAFETY: the test has checked that the machine has the instruction set.
                check(unsafe { Avx2::new() });
            }
            if InstructionSet::Avx512.is_available() {
                // SAFETY: the test has checked that the machine has the instruction set.
                check(unsafe { Avx512::new() });
            }
        }
        assert!(InstructionSet::Portable.is_available());
    }
}
