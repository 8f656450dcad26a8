//! Benchmark of packets against the scalar casters, interleaved in one process, on one thread: medians and ratios.
//!
//! `cargo bench -p carina-raycast --bench packets` casts a forked tube. With folders as arguments it casts the contents
//! of each folder: `NAME.i16` (HU, `[z, y, x]`), `NAME.u8` (map of cells) and `NAME.txt` (shape, `lps_from_ijk`, table,
//! transfer function, light, poses), given as `FOLDER/NAME`. `--quick` casts shaded leaps only, without the scalar
//! caster. `--shaded`, `--flat`, `--leap` and `--brute` limit the cases to those named. `--repeats=N` sets the number
//! of repeats, `--size=N` the size of the picture.
//!
//! Times are processor times of the thread, which other load on the machine affects less.

use std::{env, fs, sync::Arc};

use carina_grid::{Affine, Camera, Grid, VolumeView};
use carina_isoregion::{cell_map, class_labels};
use carina_raycast::{
    CastStats, Frame, FrameOptions, InstructionSet, Interpolation, Light, Method, SampleBricks,
    Transfer, TransferTable, cast_rows, cast_rows_scalar,
};

struct Case {
    name: String,
    grid: Grid,
    hu: Vec<i16>,
    radius: Vec<u8>,
    table: TransferTable,
    light: Light,
    poses: Vec<(String, Affine)>,
}

fn numbers(line: &str) -> Vec<f64> {
    line.split_whitespace()
        .map(|word| word.parse().unwrap_or(f64::INFINITY))
        .collect()
}

fn rows_of(v: &[f64]) -> Affine {
    let row = |r: usize| std::array::from_fn(|c| v[4 * r + c]);
    Affine::from_rows([row(0), row(1), row(2)])
}

fn read_case(path: &str) -> Case {
    let text = fs::read_to_string(format!("{path}.txt")).expect("the description");
    let lines: Vec<&str> = text.lines().collect();
    let shape = numbers(lines[0]);
    let values = numbers(lines[2]);
    let points = numbers(lines[3])
        .chunks_exact(5)
        .map(|p| [p[0], p[1], p[2], p[3], p[4]])
        .collect();
    let transfer = Transfer::new(points, values[0], 1).expect("a transfer function");
    let light = numbers(lines[4]);
    let bytes = fs::read(format!("{path}.i16")).expect("the volume");
    Case {
        name: path.rsplit('/').next().unwrap_or(path).to_owned(),
        grid: Grid::new(
            [0, 1, 2].map(|a| shape[a] as usize),
            rows_of(&numbers(lines[1])),
        )
        .expect("a grid"),
        hu: bytes
            .chunks_exact(2)
            .map(|b| i16::from_le_bytes([b[0], b[1]]))
            .collect(),
        radius: fs::read(format!("{path}.u8")).expect("the map"),
        table: TransferTable::new(&transfer, values[3], values[1] as i16, values[2] as i16)
            .expect("a table"),
        light: Light {
            ambient: light[0] as f32,
            diffuse: light[1] as f32,
            specular: light[2] as f32,
            shininess_log2: light[3] as u32,
            reach_mm: light[4] as f32,
        },
        poses: lines[5..]
            .iter()
            .filter_map(|line| line.split_once(' '))
            .map(|(name, v)| (name.to_owned(), rows_of(&numbers(v))))
            .collect(),
    }
}

/// Return a benchmark case: a tube of air 18 voxels wide that forks, in noisy tissue with an edge two voxels wide.
fn forked_tube() -> Case {
    let n = 192;
    let grid = Grid::new([n; 3], Affine::IDENTITY).expect("a grid");
    let mut state = 7u64;
    let hu: Vec<i16> = (0..grid.num_voxels())
        .map(|index| {
            let [x, y, z] = grid.voxel(index).map(|v| v as f64 - 95.5);
            let apart = (z + 20.0).max(0.0) * 0.6;
            let from_axis = ((x.abs() - apart).powi(2) + y * y).sqrt();
            let wall = (from_axis - 9.0).clamp(0.0, 2.0) / 2.0;
            state = state
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1);
            (-1000.0 + 1040.0 * wall) as i16 + (state >> 59) as i16
        })
        .collect();
    let points = vec![
        [-700.0, 0.8, 0.45, 0.4, 0.0],
        [-350.0, 0.8, 0.5, 0.45, 0.9],
        [100.0, 0.9, 0.8, 0.7, 0.9],
    ];
    let transfer = Transfer::new(points, 1.0, 1).expect("a transfer function");
    let labels = class_labels(&hu, -1100, &transfer.range(-1100, 3100), true)
        .expect("labels")
        .labels;
    let radius = cell_map(&labels, [n; 3]).expect("a map");
    Case {
        name: "forked tube".to_owned(),
        radius,
        hu,
        table: TransferTable::new(&transfer, 0.5, -1024, 3071).expect("a table"),
        light: Light {
            ambient: 0.26,
            diffuse: 0.98,
            specular: 0.35,
            shininess_log2: 5,
            reach_mm: 26.0,
        },
        poses: vec![(
            "stem".to_owned(),
            Affine::from_columns(
                [1.0, 0.0, 0.0],
                [0.0, 1.0, 0.0],
                [0.0, 0.0, 1.0],
                [97.0, 94.0, 30.0],
            ),
        )],
        grid,
    }
}

#[repr(C)]
struct Timespec {
    s: i64,
    ns: i64,
}

#[cfg(target_os = "linux")]
unsafe extern "C" {
    fn clock_gettime(clock: i32, time: *mut Timespec) -> i32;
}

/// Return the processor time that this thread has used, ms.
#[cfg(target_os = "linux")]
fn thread_ms() -> f64 {
    /// Number of the thread's processor clock in Linux.
    const CLOCK_THREAD_CPUTIME_ID: i32 = 3;
    let mut time = Timespec { s: 0, ns: 0 };
    // SAFETY: the function writes one timespec, and `Timespec` has the layout of that struct on 64-bit Linux.
    let failed = unsafe { clock_gettime(CLOCK_THREAD_CPUTIME_ID, &raw mut time) };
    assert_eq!(failed, 0, "the thread's clock");
    time.s as f64 * 1e3 + time.ns as f64 * 1e-6
}

/// Return the time since the first call, ms, on systems other than Linux.
#[cfg(not(target_os = "linux"))]
fn thread_ms() -> f64 {
    /// Time of the first call of `thread_ms`.
    static START: std::sync::OnceLock<std::time::Instant> = std::sync::OnceLock::new();
    START
        .get_or_init(std::time::Instant::now)
        .elapsed()
        .as_secs_f64()
        * 1e3
}

fn median(times: &mut [f64]) -> f64 {
    times.sort_by(f64::total_cmp);
    times[times.len() / 2]
}

struct Choice {
    quick: bool,
    shading: Vec<bool>,
    leap: bool,
    brute: bool,
    repeats: usize,
    size: usize,
}

impl Choice {
    fn from_arguments() -> Self {
        let has = |name: &str| env::args().any(|a| a == name);
        let number = |name: &str| env::args().find_map(|a| a.strip_prefix(name)?.parse().ok());
        let quick = has("--quick");
        let mut shading = vec![];
        if quick || has("--shaded") || !has("--flat") {
            shading.push(true);
        }
        if !quick && (has("--flat") || !has("--shaded")) {
            shading.push(false);
        }
        Self {
            quick,
            shading,
            leap: quick || has("--leap") || !has("--brute"),
            brute: !quick && (has("--brute") || !has("--leap")),
            repeats: number("--repeats=").unwrap_or(if quick { 25 } else { 7 }),
            size: number("--size=").unwrap_or(512),
        }
    }
}

fn bench(case: &Case, choice: &Choice) {
    let volume = VolumeView::new(&case.hu, &case.grid).expect("a volume");
    // The portable kernel is left out if a better one exists, because it calls a function for each fused multiply-add.
    let mut casters: Vec<(bool, InstructionSet)> = InstructionSet::available()
        .into_iter()
        .skip(1)
        .map(|simd| (false, simd))
        .collect();
    // The scalar caster is compiled for the best instruction set.
    if !choice.quick {
        casters.insert(0, (true, InstructionSet::best()));
    }
    for (name, pose) in &case.poses {
        for &shaded in &choice.shading {
            let options = FrameOptions {
                interpolation: Interpolation::Trilinear,
                light: shaded.then_some(case.light),
                appearance: None,
                background: [0.0; 3],
            };
            let camera = Camera::new(*pose, std::f64::consts::FRAC_PI_2, choice.size, choice.size)
                .expect("camera");
            let samples = Arc::new(SampleBricks::of(case.grid.shape_ijk()));
            let frame = Frame::new(volume, &case.table, camera, options)
                .and_then(|frame| frame.with_samples(samples))
                .expect("a frame");
            let mut methods = vec![];
            if choice.leap {
                methods.push(("leap", Method::LeapTransparent(&case.radius)));
            }
            if choice.brute {
                methods.push(("brute", Method::Brute));
            }
            // All methods and sets alternate, so that other load on the machine affects them equally.
            let mut times = vec![vec![Vec::new(); casters.len()]; methods.len()];
            let mut stats = vec![CastStats::default(); methods.len()];
            let mut truth = None;
            for _ in 0..choice.repeats {
                for (m, &(_, method)) in methods.iter().enumerate() {
                    for (n, &(scalar, simd)) in casters.iter().enumerate() {
                        let start = thread_ms();
                        let cast = if scalar { cast_rows_scalar } else { cast_rows };
                        let out = cast(&frame, method, 0..choice.size, simd).expect("a picture");
                        times[m][n].push(thread_ms() - start);
                        stats[m] = out.1;
                        assert!(
                            *truth.get_or_insert_with(|| out.0.clone()) == out.0,
                            "{simd:?}"
                        );
                    }
                }
            }
            for (m, (method_name, _)) in methods.iter().enumerate() {
                let per_ray = |n: u64| n as f64 / stats[m].num_rays as f64;
                print!(
                    "{:8} {name:10} {:6} {method_name:5} per ray {:5.1} samples {:4.1} look-ups {:4.1} leaps:",
                    case.name,
                    if shaded { "shaded" } else { "flat" },
                    per_ray(stats[m].num_samples),
                    per_ray(stats[m].num_lookups),
                    per_ray(stats[m].num_leaps),
                );
                let ms: Vec<f64> = times[m].iter_mut().map(|t| median(t)).collect();
                for (&(scalar, simd), (ms_of, t)) in casters.iter().zip(ms.iter().zip(&times[m])) {
                    let name = if scalar { "scalar" } else { simd.name() };
                    print!("  {name} {ms_of:6.1} (min {:5.1}) ms", t[0]);
                    if !choice.quick && !scalar {
                        print!(" {:.2}x", ms[0] / ms_of);
                    }
                }
                println!();
            }
        }
    }
}

fn main() {
    rayon::ThreadPoolBuilder::new()
        .num_threads(1)
        .use_current_thread()
        .build_global()
        .expect("one thread");
    let choice = Choice::from_arguments();
    let paths: Vec<String> = env::args()
        .skip(1)
        .filter(|a| !a.starts_with("--"))
        .collect();
    if paths.is_empty() {
        bench(&forked_tube(), &choice);
    }
    for path in paths {
        bench(&read_case(&path), &choice);
    }
}
