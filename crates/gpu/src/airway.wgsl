// Airway view on a GPU: the scalar casters of crates/raycast (brute.rs, leap.rs, sampling.rs, frame.rs, light.rs,
// composite.rs), operation by operation. WGSL does not guarantee the bits of a division, a square root or a fused
// multiply-add, so the picture must equal that of the CPU within one grey level, not bit for bit.

override SHADED: bool = true;
override NEAREST: bool = false;
override LEAP: bool = true;
// Whether the kernel writes the results of each ray instead of colours, for the shading of walls and for depths.
override WALLS: bool = false;

// Number of samples that a ray takes after its first look-up that saved nothing (schedule of look-ups: see leap.rs).
const MIN_PATIENCE: u32 = 2u;
// Maximum number of samples between two look-ups of a ray.
const MAX_PATIENCE: u32 = 128u;
// Number of samples before the first look-up, for rays that start in no region.
const BLIND_SAMPLES: u32 = 8u;
// Minimum leap, in samples, that resets the patience of a ray.
override PAYING_LEAP: u32 = 1u;
// Number of steps per voxel along an axis on which a ray does not advance.
const FAR: f32 = 1e30;
// Maximum number of ray steps that a leap over a transparent region skips.
const MAX_STEPS: f32 = 1e9;
// Value of the first wall's position for a ray that meets no wall.
const NO_HIT: f32 = -1.0;

// Parameters of a picture, with the memory layout of `Uniforms` in uniforms.rs.
struct Frame {
    // Rows of the 3x3 matrix from unit directions in camera space to voxels per ray step.
    step_i: vec4<f32>,
    step_j: vec4<f32>,
    step_k: vec4<f32>,
    origin: vec4<f32>,
    // Distances from the origin to the faces of the volume's box, in voxels, subtracted in f64.
    to_low_face: vec4<f32>,
    to_high_face: vec4<f32>,
    // 1 if the origin is between the two faces of an axis.
    between_faces: vec4<u32>,
    // Index of the last voxel on each axis.
    last: vec4<i32>,
    // Metric of gradients per voxel, |gradient in LPS per mm|^2 = g^T metric g: xx, yy, zz, then 2xy, 2xz, 2yz.
    metric_square: vec4<f32>,
    metric_mixed: vec4<f32>,
    background: vec4<f32>,
    // Ambient, diffuse, specular, 1 / reach in mm.
    light: vec4<f32>,
    width: u32,
    num_rows: u32,
    shininess_log2: u32,
    table_last: i32,
    table_low_hu: i32,
    step_mm: f32,
    guard_vox: f32,
    // Transparency below which a ray stops.
    stop: f32,
    // Pinhole camera: focal length and half of the picture's size, in pixels.
    focal_px: f32,
    half_width: f32,
    half_height: f32,
    height: u32,
    // Row of the picture at which this band starts, and the row of the buffers of the picture to which it belongs.
    first_row: u32,
    out_row: u32,
    // 1 if the directions of the rays are in `directions`; 0 for a pinhole camera.
    has_lens: u32,
    // 1 if the pixels are darkened by the gains of the lens.
    darkens: u32,
    // 1 if the work of the band is counted.
    counts_work: u32,
    // Number of rows of the buffers of the picture, and the row of the picture at which they start.
    num_all_rows: u32,
    first_of_all: u32,
    unused: u32,
}

@group(0) @binding(0) var<uniform> frame: Frame;
@group(0) @binding(1) var volume: texture_3d<i32>;
@group(0) @binding(2) var radius: texture_3d<u32>;
// Premultiplied colour and opacity of one ray step by integer HU.
@group(0) @binding(3) var<storage, read> table: array<vec4<f32>>;
// Unit directions in camera space and gains of all pixels behind a lens; 0 0 0 for a pixel without a ray.
@group(0) @binding(4) var<storage, read> directions: array<vec4<f32>>;
// Rays of a band, five words per pixel: the bits of colour, transparency and first wall in steps.
@group(0) @binding(5) var<storage, read_write> walls: array<u32>;
// Numbers of samples, look-ups, leaps, skipped samples and shaded samples, each in two words, the lower first.
@group(0) @binding(6) var<storage, read_write> counts: array<atomic<u32>>;
// Colours of the picture, one word per pixel: RGBA, alpha 255.
@group(0) @binding(7) var<storage, read_write> pixels: array<u32>;

var<workgroup> num_samples: atomic<u32>;
var<workgroup> num_lookups: atomic<u32>;
var<workgroup> num_leaps: atomic<u32>;
var<workgroup> num_skipped: atomic<u32>;
var<workgroup> num_lit: atomic<u32>;

struct Ray {
    // Step of the ray, in voxels.
    delta: vec3<f32>,
    first: u32,
    end: u32,
}

struct Cell {
    // Lower corner of the cell, and the position in the cell, 0 to 1.
    ijk: vec3<i32>,
    t: vec3<f32>,
}

// Work of a ray.
struct Work {
    samples: u32,
    lookups: u32,
    leaps: u32,
    skipped: u32,
    lit: u32,
}

struct Gathered {
    rgb: vec3<f32>,
    transparency: f32,
    hit: f32,
}

fn lerp(t: f32, a: f32, b: f32) -> f32 {
    return fma(t, b - a, a);
}

fn lerp_ints(t: f32, a: i32, b: i32) -> f32 {
    return fma(t, f32(b - a), f32(a));
}

fn voxel(i: i32, j: i32, k: i32) -> i32 {
    return textureLoad(volume, vec3<i32>(i, j, k), 0).x;
}

// Interpolate a row of two voxels along x.
fn row(t: f32, i: i32, i_next: i32, j: i32, k: i32) -> f32 {
    return lerp_ints(t, voxel(i, j, k), voxel(i_next, j, k));
}

fn held(p: vec3<f32>) -> vec3<f32> {
    return clamp(p, vec3<f32>(0.0), vec3<f32>(frame.last.xyz));
}

fn cell_of(p: vec3<f32>) -> Cell {
    let x = held(p);
    let ijk = min(vec3<i32>(x), max(frame.last.xyz - 1, vec3<i32>(0)));
    return Cell(ijk, x - vec3<f32>(ijk));
}

fn nearest(p: vec3<f32>) -> vec3<i32> {
    return vec3<i32>(held(p) + 0.5);
}

// Return the lower corner of the cell that contains p; beyond the last voxel, of the cell outside, whose radius is 0.
fn corner_of(p: vec3<f32>) -> vec3<i32> {
    return vec3<i32>(held(p));
}

fn value_in(cell: Cell) -> f32 {
    let a = cell.ijk;
    let b = min(a + 1, frame.last.xyz);
    let r00 = row(cell.t.x, a.x, b.x, a.y, a.z);
    let r10 = row(cell.t.x, a.x, b.x, b.y, a.z);
    let r01 = row(cell.t.x, a.x, b.x, a.y, b.z);
    let r11 = row(cell.t.x, a.x, b.x, b.y, b.z);
    return lerp(cell.t.z, lerp(cell.t.y, r00, r10), lerp(cell.t.y, r01, r11));
}

// Interpolate differences between two voxels at both corners of one row: along x, along y, along z.
fn slope_x(t: f32, i: vec4<i32>, j: i32, k: i32) -> f32 {
    let low = voxel(i.y, j, k);
    let high = voxel(i.z, j, k);
    return lerp_ints(t, high - voxel(i.x, j, k), voxel(i.w, j, k) - low);
}

fn slope_y(t: f32, i: vec2<i32>, before: i32, after: i32, k: i32) -> f32 {
    let low = voxel(i.x, after, k) - voxel(i.x, before, k);
    return lerp_ints(t, low, voxel(i.y, after, k) - voxel(i.y, before, k));
}

fn slope_z(t: f32, i: vec2<i32>, j: i32, before: i32, after: i32) -> f32 {
    let low = voxel(i.x, j, after) - voxel(i.x, j, before);
    return lerp_ints(t, low, voxel(i.y, j, after) - voxel(i.y, j, before));
}

// Interpolate central differences per voxel at the eight corners; the edge voxel itself replaces a missing neighbour.
fn gradient_in(cell: Cell) -> vec3<f32> {
    let t = cell.t;
    let a = cell.ijk;
    let b = min(a + 1, frame.last.xyz);
    let before = max(a - 1, vec3<i32>(0));
    let after = min(a + 2, frame.last.xyz);
    let i = vec4<i32>(before.x, a.x, b.x, after.x);
    let ends = vec2<i32>(a.x, b.x);
    let dx = lerp(
        t.z,
        lerp(t.y, slope_x(t.x, i, a.y, a.z), slope_x(t.x, i, b.y, a.z)),
        lerp(t.y, slope_x(t.x, i, a.y, b.z), slope_x(t.x, i, b.y, b.z)),
    );
    let dy = lerp(
        t.z,
        lerp(t.y, slope_y(t.x, ends, before.y, b.y, a.z), slope_y(t.x, ends, a.y, after.y, a.z)),
        lerp(t.y, slope_y(t.x, ends, before.y, b.y, b.z), slope_y(t.x, ends, a.y, after.y, b.z)),
    );
    let dz = lerp(
        t.z,
        lerp(t.y, slope_z(t.x, ends, a.y, before.z, b.z), slope_z(t.x, ends, b.y, before.z, b.z)),
        lerp(t.y, slope_z(t.x, ends, a.y, a.z, after.z), slope_z(t.x, ends, b.y, a.z, after.z)),
    );
    return vec3<f32>(dx, dy, dz) * 0.5;
}

fn entry(hu: i32) -> vec4<f32> {
    return table[clamp(hu - frame.table_low_hu, 0, frame.table_last)];
}

// Return the absolute cosine between the surface normal and the ray.
fn facing(delta: vec3<f32>, g: vec3<f32>) -> f32 {
    let along = fma(g.z, delta.z, fma(g.y, delta.y, g.x * delta.x));
    let m = frame.metric_square;
    let n = frame.metric_mixed;
    let square = fma(g.x, m.x, fma(g.y, n.x, g.z * n.y)) * g.x + fma(g.y, m.y, g.z * n.z) * g.y + m.z * g.z * g.z;
    let length = sqrt(max(square, 0.0)) * frame.step_mm;
    // Flat tissue has no direction; 1e-6 HU/mm only prevents 0/0.
    return min(abs(along) / (length + 1e-6), 1.0);
}

// Return the fractions of a sample's own colour and of white in its shaded colour, at a distance from the camera.
fn shares(cosine: f32, distance_mm: f32) -> vec2<f32> {
    var highlight = cosine;
    for (var n = 0u; n < frame.shininess_log2; n++) {
        highlight *= highlight;
    }
    let part = distance_mm * frame.light.w;
    let left = 1.0 / fma(part, part, 1.0);
    return vec2<f32>(fma(cosine, frame.light.y, frame.light.x) * left, frame.light.z * highlight * left);
}

fn add(gathered: ptr<function, Gathered>, k: u32, rgb: vec3<f32>, alpha: f32) {
    let before = (*gathered).transparency;
    let after = before * (1.0 - alpha);
    (*gathered).rgb = fma(vec3<f32>(before), rgb, (*gathered).rgb);
    (*gathered).transparency = after;
    if before >= 0.5 && after < 0.5 {
        (*gathered).hit = f32(k) + (before - 0.5) / (before - after);
    }
}

// Read sample k and add it to the ray; return false if the sample has no opacity.
fn add_sample(ray: Ray, k: u32, p: vec3<f32>, gathered: ptr<function, Gathered>) -> bool {
    if NEAREST {
        let v = nearest(p);
        let colour = entry(voxel(v.x, v.y, v.z));
        add(gathered, k, colour.rgb, colour.a);
        return colour.a > 0.0;
    }
    let cell = cell_of(p);
    let colour = entry(i32(floor(value_in(cell) + 0.5)));
    if colour.a <= 0.0 {
        return false;
    }
    var rgb = colour.rgb;
    if SHADED {
        let part = shares(facing(ray.delta, gradient_in(cell)), (f32(k) + 0.5) * frame.step_mm);
        rgb = fma(vec3<f32>(part.x), rgb, vec3<f32>(part.y * colour.a));
    }
    add(gathered, k, rgb, colour.a);
    return true;
}

fn place(ray: Ray, k: u32) -> vec3<f32> {
    // The position is a product, so no error accumulates along the ray.
    return fma(vec3<f32>(f32(k) + 0.5), ray.delta, frame.origin.xyz);
}

// Return the unit direction of a pixel's ray in camera space and the gain of the pixel; row 0 is the picture's first row.
fn direction_of(column: u32, row: u32) -> vec4<f32> {
    if frame.has_lens == 1u {
        return directions[row * frame.width + column];
    }
    return pinhole(f32(column) + 0.5, f32(row) + 0.5);
}

fn pinhole(x: f32, y: f32) -> vec4<f32> {
    let dir = vec3<f32>(x - frame.half_width, y - frame.half_height, frame.focal_px);
    return vec4<f32>(dir / sqrt(dot(dir, dir)), 1.0);
}

// Darken the levels of a pixel by its gain.
fn darkened(level: vec3<u32>, gain: f32) -> vec3<u32> {
    if frame.darkens == 0u {
        return level;
    }
    let part = u32(gain * f32(FULL_GAIN) + 0.5);
    return (level * part + FULL_GAIN / 2u) / FULL_GAIN;
}

fn store_pixel(index: u32, level: vec3<u32>) {
    pixels[index] = level.r | level.g << 8u | level.b << 16u | 0xff000000u;
}

// Return the levels of a colour from 0 to 1.
fn levels(colour: vec3<f32>) -> vec3<u32> {
    let bytes = fma(colour, vec3<f32>(255.0), vec3<f32>(0.5));
    return vec3<u32>(clamp(bytes, vec3<f32>(0.0), vec3<f32>(255.0)));
}

fn ray_along(dir: vec3<f32>) -> Ray {
    let delta = vec3<f32>(dot(frame.step_i.xyz, dir), dot(frame.step_j.xyz, dir), dot(frame.step_k.xyz, dir));
    var first = 0.0;
    var end = MAX_STEPS;
    var meets = any(dir != vec3<f32>(0.0));
    for (var a = 0; a < 3; a++) {
        // A slower ray moves by less than the leap's margin within MAX_STEPS, so it counts as not advancing on the axis.
        if abs(delta[a]) < 1e-12 {
            meets = meets && frame.between_faces[a] == 1u;
            continue;
        }
        let u = frame.to_low_face[a] / delta[a];
        let v = frame.to_high_face[a] / delta[a];
        // Sample k is at k + 1/2 steps; the part behind the camera starts at 0.
        first = max(first, ceil(min(u, v) - 0.5));
        end = min(end, floor(max(u, v) + 0.5));
    }
    if !meets || end <= first {
        return Ray(delta, 0u, 0u);
    }
    return Ray(delta, u32(first), u32(end));
}

// Return the largest number of steps from p that stay within `reach` of v on every axis.
fn steps_within(ray: Ray, p: vec3<f32>, v: vec3<f32>, reach: f32) -> u32 {
    var steps = MAX_STEPS;
    for (var a = 0; a < 3; a++) {
        var on = FAR;
        if abs(ray.delta[a]) > 1e-12 {
            let pace = 1.0 / ray.delta[a];
            on = fma(reach, abs(pace), (v[a] - p[a]) * pace);
        }
        steps = min(steps, on);
    }
    return u32(max(steps, 0.0));
}

// Return true if the camera is in a region of the map; the result is the same for all rays.
fn starts_in_region() -> bool {
    let inside = all(frame.between_faces.xyz == vec3<u32>(1u));
    return inside && textureLoad(radius, corner_of(frame.origin.xyz), 0).x > 0u;
}

// Cast a ray and add its work to `work`.
fn gather(ray: Ray, work: ptr<function, Work>) -> Gathered {
    var gathered = Gathered(vec3<f32>(0.0), 1.0, NO_HIT);
    var k = ray.first;
    var lookups = 0u;
    var leaps = 0u;
    var skipped = 0u;
    var lit = 0u;
    var ask_at = ray.first;
    var patience = MIN_PATIENCE;
    if LEAP && !starts_in_region() {
        ask_at += BLIND_SAMPLES;
        patience = 2u * BLIND_SAMPLES;
    }
    while k < ray.end {
        let p = place(ray, k);
        if LEAP {
            if k >= ask_at {
                let v = corner_of(p);
                lookups += 1u;
                let r = textureLoad(radius, v, 0).x;
                if r > 0u {
                    // All corners of this sample and of the next n samples are in the cube.
                    let reach = f32(r) + (-0.5 - frame.guard_vox);
                    let n = steps_within(ray, p, vec3<f32>(v) + 0.5, reach);
                    let passed = min(n + 1u, ray.end - k);
                    leaps += 1u;
                    skipped += passed;
                    if passed >= PAYING_LEAP {
                        patience = MIN_PATIENCE;
                    }
                    k += passed;
                    continue;
                }
                ask_at = k + patience;
                patience = min(2u * patience, MAX_PATIENCE);
            }
        }
        k += 1u;
        if add_sample(ray, k - 1u, p, &gathered) {
            lit += 1u;
            ask_at = max(ask_at, k + 1u);
            if gathered.transparency < frame.stop {
                break;
            }
        }
    }
    (*work).samples += k - ray.first - skipped;
    (*work).lookups += lookups;
    (*work).leaps += leaps;
    (*work).skipped += skipped;
    (*work).lit += lit;
    return gathered;
}

// Add the work of a thread to that of its workgroup.
fn add_work(work: Work) {
    atomicAdd(&num_samples, work.samples);
    atomicAdd(&num_lookups, work.lookups);
    atomicAdd(&num_leaps, work.leaps);
    atomicAdd(&num_skipped, work.skipped);
    atomicAdd(&num_lit, work.lit);
}

// Add a number to a counter of two words.
fn count(counter: u32, number: u32) {
    let before = atomicAdd(&counts[2u * counter], number);
    if before + number < before {
        atomicAdd(&counts[2u * counter + 1u], 1u);
    }
}

// Add the work of a workgroup to that of the picture.
fn count_work() {
    count(0u, atomicLoad(&num_samples));
    count(1u, atomicLoad(&num_lookups));
    count(2u, atomicLoad(&num_leaps));
    count(3u, atomicLoad(&num_skipped));
    count(4u, atomicLoad(&num_lit));
}

@compute @workgroup_size(8, 8)
fn cast_airway(@builtin(global_invocation_id) at: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    if at.x < frame.width && at.y < frame.num_rows {
        let pixel = at.y * frame.width + at.x;
        let direction = direction_of(at.x, frame.first_row + at.y);
        var work = Work();
        let gathered = gather(ray_along(direction.xyz), &work);
        add_work(work);
        if WALLS {
            let words = bitcast<vec4<u32>>(vec4<f32>(gathered.rgb, gathered.transparency));
            for (var c = 0u; c < 4u; c++) {
                walls[5u * pixel + c] = words[c];
            }
            walls[5u * pixel + 4u] = bitcast<u32>(gathered.hit);
        } else {
            let over = fma(vec3<f32>(gathered.transparency), frame.background.rgb, gathered.rgb);
            store_pixel(frame.out_row * frame.width + pixel, darkened(levels(over), direction.w));
        }
    }
    workgroupBarrier();
    if lane == 0u && frame.counts_work == 1u {
        count_work();
    }
}
