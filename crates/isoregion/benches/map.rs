//! Benchmark of the radius map on every instruction set and in slabs, interleaved in one process: milliseconds and
//! ratios.
//!
//! `cargo bench -p carina-isoregion --bench map` builds the map of a noisy chest of 512 x 512 x 400 voxels; with a file
//! of raw int16 values of that shape as argument, the map of that file. Labels are the transparent run below -700 HU
//! and 16-HU bins above it, as in the comparison with other libraries (`benchmarks/isoregion.py`).

use std::time::Instant;

use carina_grid::InstructionSet;
use carina_isoregion::{MapBuilder, value_bin};

/// Number of voxels of the volume along z, y, x.
const SHAPE: [usize; 3] = [400, 512, 512];
/// Number of times that each variant is measured.
const REPEATS: usize = 7;

/// Return the values of a volume with air, a body, two lungs with vessels, and noise.
fn chest() -> Vec<i16> {
    let [nz, ny, nx] = SHAPE;
    let mut state = 1u64;
    let mut out = Vec::with_capacity(nz * ny * nx);
    for z in 0..nz {
        for y in 0..ny {
            for x in 0..nx {
                state = state
                    .wrapping_mul(6_364_136_223_846_793_005)
                    .wrapping_add(1_442_695_040_888_963_407);
                let noise = (state >> 58) as i32 - 32;
                let (u, v) = (x as f32 / nx as f32 - 0.5, y as f32 / ny as f32 - 0.5);
                let w = z as f32 / nz as f32 - 0.5;
                let body = u * u / 0.2 + v * v / 0.1 < 1.0;
                let lung = (u.abs() - 0.2).powi(2) / 0.02 + v * v / 0.05 + w * w / 0.2 < 1.0;
                let vessel = (x / 3 * 7 + y / 3 * 13 + z / 3 * 29) % 211 < 3;
                let hu = match (body, lung, vessel) {
                    (false, ..) => -1000,
                    (true, true, false) => -860,
                    _ => 40,
                };
                out.push((hu + noise) as i16);
            }
        }
    }
    out
}

/// Return the processor time that this thread has used, ms; `None` if the system does not report it.
fn cpu_ms() -> Option<f64> {
    let text = std::fs::read_to_string("/proc/thread-self/schedstat").ok()?;
    Some(text.split(' ').next()?.parse::<f64>().ok()? / 1e6)
}

fn main() {
    let path = std::env::args().skip(1).find(|a| !a.starts_with('-'));
    let hu: Vec<i16> = path.map_or_else(chest, |path| {
        let bytes = std::fs::read(path).expect("the volume");
        let values = bytes.as_chunks::<2>().0;
        values.iter().map(|v| i16::from_le_bytes(*v)).collect()
    });
    let labels: Vec<u8> = hu
        .iter()
        .map(|&v| {
            let bin = value_bin(v.into()) - value_bin(-700) + 2;
            if v < -700 { 1 } else { bin.min(255) as u8 }
        })
        .collect();
    let mut out = vec![1u8; hu.len()];
    let mut rows: Vec<(String, Vec<f64>)> = Vec::new();
    for _ in 0..REPEATS {
        let mut at = 0;
        for simd in InstructionSet::available() {
            for num_slabs in [1, 2] {
                for runs in [false, true] {
                    let builder = MapBuilder {
                        simd,
                        num_slabs,
                        cancelled: None,
                    };
                    let began = (Instant::now(), cpu_ms());
                    if runs {
                        builder
                            .run_cell_map(&hu, SHAPE, &[(i16::MIN, -701)], &mut out)
                            .expect("a map");
                    } else {
                        builder.radius_map(&labels, SHAPE, &mut out).expect("a map");
                    }
                    // One slab is built by this thread alone, and the thread's processor time excludes other load on
                    // the machine.
                    let ms = match (num_slabs, began.1.zip(cpu_ms())) {
                        (1, Some((before, after))) => after - before,
                        _ => began.0.elapsed().as_secs_f64() * 1e3,
                    };
                    if at == rows.len() {
                        let of = if runs { "values" } else { "labels" };
                        rows.push((format!("{} {num_slabs} slab {of}", simd.name()), vec![]));
                    }
                    rows[at].1.push(ms);
                    at += 1;
                }
            }
        }
    }
    for (name, mut ms) in rows {
        ms.sort_by(f64::total_cmp);
        println!(
            "{name:28} min {:6.1}  median {:6.1} ms",
            ms[0],
            ms[ms.len() / 2]
        );
    }
}
